//! Truth rasters as distributed: georeferenced, or positioned by a text file as in DFC2019.

use super::{EvaluateError, Result};
use heliosplat::Raster;
use heliosplat_raster::{Crs, CrsTransform, GeoRaster, GeoTransform, RasterError, RasterFile};
use heliosplat_rpc::GeoPoint;
use std::path::Path;

/// Reads a truth DSM. Without a geotransform its place is read from the text of the same name (`X_DSM.txt`: easting and
/// northing of the lower-left corner, size in pixels, metres per pixel), in the UTM zone of the prediction. A missing
/// coordinate system is added to `warnings`.
///
/// # Errors
/// [`EvaluateError`] when the file cannot be read, or no place is stated.
pub(super) fn read(path: &Path, prediction: &GeoRaster, warnings: &mut Vec<String>) -> Result<GeoRaster> {
    let file = RasterFile::open(path)?;
    let mut raster = file.read_heights(0)?;
    blank_absurd_heights(&mut raster);
    let (transform, crs) = match file.geo_transform() {
        Some(transform) => (transform, file.crs()),
        None => (placed_by_text(path, &raster)?, utm_zone(prediction)),
    };
    if crs.is_none() {
        let path = path.display();
        let text = format!("{path}: has no coordinate system; that of the prediction is assumed");
        warnings.push(text);
    }
    Ok(GeoRaster {
        raster,
        transform,
        crs: crs.or_else(|| prediction.crs.clone()),
        band_names: Vec::new(),
    })
}

/// Reads LAS classes on the truth's grid.
///
/// # Errors
/// [`EvaluateError`] when the file cannot be read, or has other numbers of columns and rows than the truth.
pub(super) fn read_classes(path: &Path, truth: &Raster) -> Result<Raster> {
    let file = RasterFile::open(path)?;
    let classes = file.read(file.whole(), &[0])?;
    if (classes.width, classes.height) == (truth.width, truth.height) {
        return Ok(classes);
    }
    let (path, width, height) = (path.display(), classes.width, classes.height);
    Err(EvaluateError::Refused(format!(
        "{path}: {width} x {height} pixels, but the truth has {} x {}; classes must lie on the truth's grid",
        truth.width, truth.height
    )))
}

/// Airborne DSMs mark missing cells with -9999, -32767 or 1e38 and often forget to declare it.
fn blank_absurd_heights(raster: &mut Raster) {
    for value in &mut raster.values {
        if !(-1000.0..=10_000.0).contains(value) {
            *value = f32::NAN;
        }
    }
}

fn placed_by_text(path: &Path, raster: &Raster) -> Result<GeoTransform> {
    let text_path = path.with_extension("txt");
    if !text_path.is_file() {
        return Err(RasterError::NotGeoreferenced(path.to_owned()).into());
    }
    let text = heliosplat_raster::bounded::read_text(&text_path).unwrap_or_default();
    GeoTransform::from_region_text(&text, raster.height).ok_or_else(|| {
        let text = text_path.display();
        EvaluateError::Refused(format!(
            "{text}: expected four numbers (easting, northing, size in pixels, metres per pixel), found none; correct or remove it"
        ))
    })
}

/// UTM zone for a text file, which states none: that of the prediction, or of the prediction's middle where it is in
/// another coordinate system.
fn utm_zone(prediction: &GeoRaster) -> Option<Crs> {
    let crs = prediction.crs.as_ref()?;
    if crs.name().contains("UTM zone") {
        return Some(crs.clone());
    }
    let (width, height) = (prediction.raster.width as f64, prediction.raster.height as f64);
    let [x, y] = prediction.transform.map_from_pixel(0.5 * width, 0.5 * height);
    let (lon_deg, lat_deg) = CrsTransform::to_lon_lat(crs).ok()?.apply(x, y).ok()?;
    let middle = GeoPoint::new(lon_deg, lat_deg, 0.0);
    Crs::utm(middle).ok()
}
