//! Readers of images, which read files: GDAL's formats, and the pictures of captures.

use gdal::DriverManager;
use heliosplat::Raster;
use heliosplat_objects::pixels;
use heliosplat_raster::{ImageSpec, RasterFile, SampleType, Window, write_geotiff};
use std::path::Path;
use tempfile::tempdir;

/// Most pixels of a picture that is decoded here.
const PICTURE_PX: usize = 1 << 14;

fn in_a_file(name: &str, bytes: &[u8], read: impl FnOnce(&Path) -> bool) -> bool {
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("written");
    read(&path)
}

/// Reads a raster of any format that GDAL recognises: its metadata, and means of its first pixels. True if it is
/// accepted.
pub fn raster_file(bytes: &[u8]) -> bool {
    in_a_file("a.img", bytes, |path| {
        let Ok(file) = RasterFile::open(path) else {
            return false;
        };
        let (width, height) = file.size();
        let window = Window {
            width: width.min(64),
            height: height.min(64),
            ..file.whole()
        };
        let _ = (file.crs(), file.geo_transform(), file.domain("RPC"));
        file.read_reduced(window, 2, &[0]).is_ok()
    })
}

/// Reads a picture of a capture: PNG, JPEG or EXR. True if it is accepted.
pub fn picture_file(bytes: &[u8]) -> bool {
    in_a_file("a.png", bytes, |path| match pixels::size_px(path) {
        Ok([width, height]) if width * height <= PICTURE_PX => pixels::read(path).is_ok(),
        known => known.is_ok(),
    })
}

fn bytes_of(name: &str, write: impl FnOnce(&Path)) -> Vec<u8> {
    let folder = tempdir().expect("a temporary folder");
    let path = folder.path().join(name);
    write(&path);
    std::fs::read(path).expect("readable")
}

/// Rasters in three formats: GeoTIFF, HFA and NITF.
pub(super) fn raster_files() -> Vec<Vec<u8>> {
    let raster = Raster::filled(16, 12, 2, 7.0);
    let tiff = bytes_of("a.tif", |path| {
        write_geotiff(path, &ImageSpec::plain(&raster), SampleType::U16).expect("written");
    });
    let of = |driver: &str| {
        bytes_of("a.img", |path| {
            let driver = DriverManager::get_driver_by_name(driver).expect("a format of GDAL");
            drop(driver.create_with_band_type::<u8, _>(path, 16, 12, 1).expect("created"));
        })
    };
    vec![tiff, of("HFA"), of("NITF")]
}

/// Pictures in two formats: PNG with coverage and EXR.
pub(super) fn picture_files() -> Vec<Vec<u8>> {
    let of = |name: &str, picture: image::DynamicImage| bytes_of(name, |path| picture.save(path).expect("written"));
    vec![
        of("a.png", image::RgbaImage::new(5, 4).into()),
        of("a.exr", image::Rgb32FImage::new(5, 4).into()),
    ]
}
