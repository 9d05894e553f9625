//! Images as large as those of a satellite that take hardly any space on the disk: sparse GeoTIFFs in tiles, with
//! rational cameras.

use gdal::raster::{Buffer, RasterCreationOptions};
use gdal::{Dataset, DriverManager, Metadata};
use heliosplat_rpc::Rpc;
use heliosplat_rpc::write::gdal_domain;
use std::path::Path;

/// Writes an image of `size_px` by `size_px` pixels of 16 bits in `bands` bands without storing any pixel; returns it
/// open for writing.
pub fn empty(path: &Path, size_px: usize, bands: usize, rpc: &Rpc) -> Dataset {
    let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL writes GeoTIFF");
    let options = ["TILED=YES", "SPARSE_OK=TRUE", "BIGTIFF=YES", "INTERLEAVE=PIXEL"];
    let options = RasterCreationOptions::from_iter(options);
    let mut image = driver
        .create_with_band_type_with_options::<u16, _>(path, size_px, size_px, bands, &options)
        .expect("created");
    for (key, value) in gdal_domain(rpc) {
        image.set_metadata_item(&key, &value, "RPC").expect("a camera");
    }
    image
}

/// Puts every image of a folder into the middle of a canvas of `size_px` by `size_px` pixels in another folder, and
/// copies all other files. `rpc` reads the camera of an image.
pub fn scene(from: &Path, to: &Path, size_px: usize, rpc: &dyn Fn(&Path) -> Rpc) {
    std::fs::create_dir_all(to).expect("made");
    for entry in std::fs::read_dir(from).expect("listable").flatten() {
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        if path.extension().is_some_and(|extension| extension == "tif") {
            image(&path, &target, size_px, &rpc(&path));
        } else if path.is_file() {
            std::fs::copy(&path, &target).expect("copied");
        }
    }
}

fn image(from: &Path, to: &Path, size_px: usize, rpc: &Rpc) {
    let source = Dataset::open(from).expect("an image");
    let (width, height) = source.raster_size();
    let (col0, row0) = ((size_px - width) / 2, (size_px - height) / 2);
    let mut target = empty(
        to,
        size_px,
        source.raster_count(),
        &rpc.cropped(-(col0 as f64), -(row0 as f64)),
    );
    for item in source.metadata_domain("").into_iter().flatten() {
        if let Some((key, value)) = item.split_once('=') {
            target.set_metadata_item(key, value, "").expect("an item");
        }
    }
    for band in 1..=source.raster_count() {
        let (read, mut written) = (source.rasterband(band), target.rasterband(band).expect("a band"));
        let read = read.expect("a band");
        written
            .set_description(&read.description().expect("a name"))
            .expect("a name");
        let pixels: Buffer<u16> = read
            .read_as((0, 0), (width, height), (width, height), None)
            .expect("pixels");
        let mut pixels = Buffer::new((width, height), pixels.data().to_vec());
        written
            .write((col0 as isize, row0 as isize), (width, height), &mut pixels)
            .expect("written");
    }
}
