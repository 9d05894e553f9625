//! Writing: cloud-optimised GeoTIFFs and plain GeoTIFFs, whole or not at all.
//!
//! GDAL writes into memory; the finished bytes go to a temporary file beside the target, which is renamed when it is
//! complete. A full disk or a refused permission is therefore an error of the operating system with its own name, and
//! the target is never incomplete.

use super::{Crs, GeoTransform, RasterError, Result, drivers, messages, temporary};
use gdal::raster::{Buffer, ColorInterpretation, GdalType, RasterBand, RasterCreationOptions};
use gdal::{Dataset, DriverManager, Metadata};
use heliosplat::Raster;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// No-data value of the float rasters that we write.
pub const NODATA: f32 = -9999.0;

/// A raster to write, with its descriptions, georeference and metadata.
#[derive(Debug, Clone, Copy)]
pub struct ImageSpec<'a> {
    /// The values; `NaN` becomes nodata in float files and 0 in integer files.
    pub raster: &'a Raster,
    /// One description per band, or empty.
    pub band_descriptions: &'a [&'a str],
    /// One unit per band, or empty.
    pub band_units: &'a [&'a str],
    /// Geotransform and coordinate system, if it has them.
    pub georeference: Option<(&'a GeoTransform, &'a Crs)>,
    /// Items of the default metadata domain.
    pub metadata: &'a [(String, String)],
    /// Items of the `RPC` domain (pixel centres at integers), if it has a rational camera.
    pub rpc: &'a [(String, String)],
}

impl<'a> ImageSpec<'a> {
    /// A raster without descriptions, georeference and metadata.
    pub fn plain(raster: &'a Raster) -> Self {
        Self {
            raster,
            band_descriptions: &[],
            band_units: &[],
            georeference: None,
            metadata: &[],
            rpc: &[],
        }
    }
}

/// The sample type of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SampleType {
    /// 8 bits, 0..=255.
    U8,
    /// 16 bits, 0..=65535.
    U16,
    /// 32-bit float.
    F32,
}

/// Meaning of the bytes of an 8-bit raster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bytes {
    /// Yes and no: 1, 0, and 255 where nothing is known. Overviews show the most frequent value.
    Mask,
    /// Shades from 1 to 255, 0 where nothing is known. Overviews show the mean.
    Shades,
}

impl Bytes {
    /// No-data value.
    pub fn nodata(self) -> u8 {
        match self {
            Self::Mask => 255,
            Self::Shades => 0,
        }
    }
}

/// Writes a float32 cloud-optimised GeoTIFF: tiled, deflated, overviews, nodata -9999, statistics. It has no predictor,
/// because Whitebox and others read predictors wrongly.
///
/// # Errors
/// [`RasterError::DiskFull`], [`RasterError::Permission`] or [`RasterError::Write`]; nothing is left behind.
pub fn write_cog(path: &Path, spec: &ImageSpec) -> Result<()> {
    let dataset = in_memory(path, spec, SampleType::F32)?;
    write_copy(path, &dataset, "COG", &cog_options("AVERAGE"))
}

/// Writes an int32 cloud-optimised GeoTIFF of the values after `convert`; 0, `NaN` and infinities become 0, its nodata.
/// Overviews show the nearest cell: a mean of dates is no date.
///
/// # Errors
/// A full disk, a refused permission or another failure to write, as [`write_cog`].
pub fn write_integer_cog(path: &Path, spec: &ImageSpec, convert: impl Fn(f32) -> i32) -> Result<()> {
    let is_known = |value: &f32| value.is_finite() && *value != 0.0;
    let converted = |value: f32| Some(value).filter(is_known).map_or(0, &convert);
    let dataset = build(path, spec, converted, Some(0.0))?;
    write_copy(path, &dataset, "COG", &cog_options("NEAREST"))
}

/// Writes an 8-bit cloud-optimised GeoTIFF; values are rounded and clamped to 0..=255, and `NaN` becomes the nodata of
/// `bytes`.
///
/// # Errors
/// A full disk, a refused permission or another failure to write, as [`write_cog`].
pub fn write_byte_cog(path: &Path, spec: &ImageSpec, bytes: Bytes) -> Result<()> {
    let nodata = bytes.nodata();
    let resampling = if bytes == Bytes::Mask { "MODE" } else { "AVERAGE" };
    let convert = |value: f32| if value.is_nan() { nodata } else { value.round() as u8 };
    let dataset = build(path, spec, convert, Some(f32::from(nodata)))?;
    write_copy(path, &dataset, "COG", &cog_options(resampling))
}

/// Options of GDAL's COG driver; `resampling` is that of the overviews.
pub(super) fn cog_options(resampling: &str) -> [String; 6] {
    [
        "COMPRESS=DEFLATE".into(),
        "BLOCKSIZE=256".into(),
        "OVERVIEWS=AUTO".into(),
        format!("RESAMPLING={resampling}"),
        "BIGTIFF=IF_SAFER".into(),
        // One and two threads give the same bytes.
        format!("NUM_THREADS={}", rayon::current_num_threads()),
    ]
}

/// Writes a plain deflated GeoTIFF with samples of the given type. Integers are rounded and clamped, `NaN` becomes 0;
/// floats have nodata -9999.
///
/// # Errors
/// A full disk, a refused permission or another failure to write, as [`write_cog`].
pub fn write_geotiff(path: &Path, spec: &ImageSpec, sample: SampleType) -> Result<()> {
    let predictor = format!("PREDICTOR={}", if sample == SampleType::F32 { 3 } else { 2 });
    let options = ["COMPRESS=DEFLATE", &predictor, "INTERLEAVE=BAND", "BIGTIFF=IF_SAFER"];
    let dataset = in_memory(path, spec, sample)?;
    write_copy(path, &dataset, "GTiff", &options)
}

/// Copies an image to a plain deflated GeoTIFF, its samples and metadata as they are, with another rational camera:
/// items of GDAL's `RPC` domain (pixel centres at integers).
///
/// # Errors
/// A full disk, a refused permission or another failure to write, as [`write_cog`]; those of
/// [`super::RasterFile::open`] for the image.
pub fn copy_with_rpc(image: &Path, target: &Path, rpc: &[(String, String)]) -> Result<()> {
    let source = super::RasterFile::open(image)?;
    let copy = messages::collect_strictly(|| {
        let driver = drivers::memory()?;
        let mut copy = (source.dataset()).create_copy(&driver, "", &RasterCreationOptions::new())?;
        for (key, value) in rpc {
            copy.set_metadata_item(key, value, "RPC")?;
        }
        Ok(copy)
    })
    .map_err(|reason| RasterError::Write(target.to_owned(), reason))?;
    write_copy(target, &copy, "GTiff", &["COMPRESS=DEFLATE", "BIGTIFF=IF_SAFER"])
}

fn in_memory(path: &Path, spec: &ImageSpec, sample: SampleType) -> Result<Dataset> {
    match sample {
        SampleType::F32 => build(path, spec, with_nodata, Some(NODATA)),
        // `as` saturates and turns NaN into 0.
        SampleType::U8 => build(path, spec, |value| value.round() as u8, None),
        SampleType::U16 => build(path, spec, |value| value.round() as u16, None),
    }
}

/// A value in a float file.
pub(super) fn with_nodata(value: f32) -> f32 {
    if value.is_finite() { value } else { NODATA }
}

/// A dataset of the values after `convert`, in memory; `path` is for the error.
fn build<T: GdalType + Copy>(
    path: &Path,
    spec: &ImageSpec,
    convert: impl Fn(f32) -> T,
    nodata: Option<f32>,
) -> Result<Dataset> {
    let raster = spec.raster;
    let size = (raster.width, raster.height);
    messages::collect_strictly(|| {
        let driver = drivers::memory()?;
        let mut dataset = driver.create_with_band_type::<T, _>("", size.0, size.1, raster.bands)?;
        describe(&mut dataset, spec, nodata)?;
        for index in 0..raster.bands {
            let mut band = dataset.rasterband(index + 1)?;
            let values = raster.plane(index).iter().map(|&value| convert(value)).collect();
            band.write((0, 0), size, &mut Buffer::new(size, values))?;
        }
        Ok(dataset)
    })
    .map_err(|reason| RasterError::Write(path.to_owned(), reason))
}

/// Sets georeference, metadata, descriptions, units and nodata of a dataset.
pub(super) fn describe(dataset: &mut Dataset, spec: &ImageSpec, nodata: Option<f32>) -> gdal::errors::Result<()> {
    if let Some((transform, crs)) = spec.georeference {
        dataset.set_geo_transform(&transform.to_gdal())?;
        dataset.set_projection(crs.wkt())?;
    }
    for (key, value) in spec.metadata {
        dataset.set_metadata_item(key, value, "")?;
    }
    for (key, value) in spec.rpc {
        dataset.set_metadata_item(key, value, "RPC")?;
    }
    for index in 0..spec.raster.bands {
        let mut band = dataset.rasterband(index + 1)?;
        if let Some(nodata) = nodata {
            band.set_no_data_value(Some(f64::from(nodata)))?;
        }
        if let Some(colour) = interpretation(spec.band_descriptions.get(index), spec.raster.bands) {
            band.set_color_interpretation(colour)?;
        }
        if let Some(text) = spec.band_descriptions.get(index) {
            band.set_description(text)?;
        }
        if let Some(unit) = spec.band_units.get(index) {
            set_unit(&band, unit)?;
        }
    }
    Ok(())
}

/// Writes minimum, maximum, mean and standard deviation into the metadata of each band that has known values.
pub(super) fn add_statistics(dataset: &Dataset) {
    for index in 1..=dataset.raster_count() {
        let found = messages::collect(|| dataset.rasterband(index)?.get_statistics(true, false));
        if let Err(reason) = found {
            tracing::debug!("no statistics: {reason}");
        }
    }
}

/// The colour interpretation of a band by its description: programs show red, green and blue as such, and one band
/// alone in grey.
fn interpretation(description: Option<&&str>, bands: usize) -> Option<ColorInterpretation> {
    Some(match description.copied() {
        Some("red") => ColorInterpretation::RedBand,
        Some("green") => ColorInterpretation::GreenBand,
        Some("blue") => ColorInterpretation::BlueBand,
        _ if bands == 1 => ColorInterpretation::GrayIndex,
        _ => return None,
    })
}

/// Sets the unit of a band; the crate gdal has no setter.
#[allow(unsafe_code, reason = "the crate gdal has no name for this function")]
fn set_unit(band: &RasterBand, unit: &str) -> gdal::errors::Result<()> {
    let text = std::ffi::CString::new(unit)?;
    // SAFETY: the band's dataset is borrowed and so still open; GDAL copies the text, which outlives the call.
    unsafe { gdal_sys::GDALSetRasterUnitType(band.c_rasterband(), text.as_ptr()) };
    Ok(())
}

/// A file in GDAL's memory, gone when dropped.
struct MemoryFile(PathBuf);

impl MemoryFile {
    fn new() -> Self {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let number = COUNTER.fetch_add(1, Ordering::Relaxed);
        Self(PathBuf::from(format!("/vsimem/heliosplat_{number}.tif")))
    }
}

impl Drop for MemoryFile {
    fn drop(&mut self) {
        // The file is already gone when its bytes were taken.
        let _ = messages::collect(|| gdal::vsi::unlink_mem_file(&self.0));
    }
}

fn write_copy<S: AsRef<str>>(path: &Path, dataset: &Dataset, driver: &str, options: &[S]) -> Result<()> {
    let memory = MemoryFile::new();
    if driver == "COG" {
        add_statistics(dataset);
    }
    let bytes = messages::collect_strictly(|| {
        let driver = DriverManager::get_driver_by_name(driver)?;
        let options = RasterCreationOptions::from_iter(options.iter().map(AsRef::as_ref));
        dataset.create_copy(&driver, &memory.0, &options)?.close()?;
        gdal::vsi::get_vsi_mem_file_bytes_owned(&memory.0)
    })
    .map_err(|reason| RasterError::Write(path.to_owned(), reason))?;
    write_atomically(path, &bytes)
}

/// Writes `bytes` to a temporary file beside `path` and renames it. Parent folders are created, and a symbolic link is
/// kept: its target is replaced.
///
/// # Errors
/// A full disk, a refused permission or another failure to write, as [`write_cog`].
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically_with(path, |file| file.write_all(bytes))
}

/// Writes a file by `fill`, completely or not at all, as [`write_atomically`] does.
///
/// # Errors
/// A full disk, a refused permission or another failure to write, as [`write_cog`].
pub fn write_atomically_with(path: &Path, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    let failed = |error: &std::io::Error| RasterError::from_io(path, error);
    let target = temporary::target(path);
    let mut file = temporary::file_beside(&target).map_err(|error| failed(&error))?;
    fill(file.as_file_mut()).map_err(|error| failed(&error))?;
    file.as_file().sync_all().map_err(|error| failed(&error))?;
    file.persist(&target).map_err(|error| failed(&error.error))?;
    Ok(())
}

/// Removes a file, if it exists.
///
/// # Errors
/// A refused permission or another failure to remove, as [`write_cog`].
pub fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(RasterError::from_io(path, &error)),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GeoRaster, RasterFile};

    fn sample_raster(width: usize, height: usize, bands: usize) -> Raster {
        let mut raster = Raster::filled(width, height, bands, 0.0);
        for (index, value) in raster.values.iter_mut().enumerate() {
            *value = (index % 977) as f32 * 0.25 - 20.0;
        }
        raster.values[5] = f32::NAN;
        raster
    }

    #[test]
    fn a_cog_comes_back_as_it_was_and_says_it_is_one() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("new/dsm.tif");
        let raster = sample_raster(700, 530, 3);
        let transform = GeoTransform::north_up(312_000.0, 4_160_500.0, 0.5);
        let crs = Crs::from_epsg(32637).expect("UTM 37N");
        let spec = ImageSpec {
            band_descriptions: &["altitude", "standard deviation", "coverage"],
            band_units: &["metre", "metre", "1"],
            georeference: Some((&transform, &crs)),
            metadata: &[("SEED".to_owned(), "7".to_owned())],
            ..ImageSpec::plain(&raster)
        };
        write_cog(&path, &spec).expect("written");

        let file = RasterFile::open(&path).expect("readable");
        assert_eq!(
            file.domain("IMAGE_STRUCTURE").get("LAYOUT").map(String::as_str),
            Some("COG")
        );
        assert_eq!(file.domain("").get("SEED").map(String::as_str), Some("7"));
        assert_eq!(file.bands[2].description, "coverage");
        assert_eq!(file.bands[0].nodata, Some(-9999.0));
        assert_eq!(file.bands[1].unit, "metre");
        let back = GeoRaster::read(&path).expect("georeferenced");
        assert_eq!(back.transform, transform);
        assert_eq!(back.crs.expect("a CRS").definition(), "EPSG:32637");
        for (got, want) in back.raster.values.iter().zip(&raster.values) {
            assert!(got == want || (got.is_nan() && want.is_nan()), "{got} {want}");
        }
        let left: Vec<_> = std::fs::read_dir(path.parent().expect("a parent"))
            .expect("listable")
            .collect();
        assert_eq!(left.len(), 1, "only the product is left");
    }

    #[test]
    fn integers_are_rounded_clamped_and_an_rpc_domain_is_kept() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("image.tif");
        let raster = Raster {
            width: 4,
            height: 1,
            bands: 1,
            values: vec![-3.0, 1.6, 70_000.0, f32::NAN],
        };
        write_geotiff(&path, &ImageSpec::plain(&raster), SampleType::U16).expect("written");
        let back = RasterFile::open(&path).expect("readable").read_all().expect("pixels");
        assert_eq!(back.values, vec![0.0, 2.0, 65535.0, 0.0]);
    }

    #[test]
    fn a_target_that_cannot_be_a_folder_is_a_clear_error() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let blocker = folder.path().join("file");
        std::fs::write(&blocker, b"x").expect("written");
        let error = write_cog(&blocker.join("dsm.tif"), &ImageSpec::plain(&sample_raster(8, 8, 1)))
            .expect_err("a file is no folder");
        assert!(error.to_string().contains("dsm.tif"), "{error}");
        assert!(!error.is_input_fault());
    }

    #[test]
    fn a_full_disk_is_named_and_leaves_nothing() {
        // /dev/full refuses every byte the way a full disk does; it exists on Linux only.
        let full = Path::new("/dev/full");
        if !full.exists() {
            return;
        }
        let mut file = std::fs::OpenOptions::new().write(true).open(full).expect("writable");
        let error = file.write_all(b"x").expect_err("it is full");
        let error = RasterError::from_io(Path::new("dsm.tif"), &error);
        assert!(matches!(error, RasterError::DiskFull(_)), "{error}");
    }
}
