//! The rational camera of an image: which of its sources is used, and what it must be turned into for a crop.

use super::entry::ImageEntry;
use super::files::{Folders, file_name};
use super::sidecars::belonging_texts;
use super::{RpcPreference, SceneError};
use heliosplat_raster::{GeoTransform, RasterFile};
use heliosplat_rpc::{ImagePoint, Rpc, read};
use std::collections::BTreeMap;
use std::path::Path;

/// A camera and where it comes from.
#[derive(Debug, Clone)]
pub(super) struct FoundCamera {
    pub(super) rpc: Rpc,
    pub(super) source: String,
}

/// Two cameras of one image that differ by more than this are worth a warning, pixels.
const WORTH_A_WARNING_PX: f64 = 0.5;

/// Finds the camera of an image. A file named in `scene.toml` wins; then a Sat-NeRF JSON and what GDAL found (tag or
/// sidecar) are compared, and `preference` decides where they differ; then come sidecars GDAL does not know.
pub(super) fn find(
    file: &RasterFile,
    entry: &ImageEntry,
    preference: RpcPreference,
    folders: &Folders,
    warnings: &mut Vec<String>,
) -> Result<FoundCamera, SceneError> {
    if let Some(path) = entry.said.as_ref().and_then(|said| said.rpc.as_ref()) {
        return from_text_file(path, folders);
    }
    let image = from_gdal(file, warnings)?;
    let json = entry
        .json
        .as_deref()
        .map(|json| from_text_file(json, folders))
        .transpose()?;
    match (image, json) {
        (Some(image), Some(json)) => Ok(chosen(file, image, json, preference, warnings)),
        (Some(camera), None) | (None, Some(camera)) => Ok(camera),
        (None, None) => match sidecar(file.path(), folders)? {
            Some(camera) => Ok(camera),
            None => Err(SceneError::NoRpc(file.path().to_owned())),
        },
    }
}

/// The camera in a text file of any known format.
///
/// # Errors
/// [`SceneError::BadRpc`] when it holds none.
pub(super) fn from_text_file(path: &Path, folders: &Folders) -> Result<FoundCamera, SceneError> {
    let text = folders.text(path)?;
    let rpc = read::rpc_from_text(&file_name(path), &text).map_err(|error| SceneError::BadRpc {
        path: path.to_owned(),
        reason: error.to_string(),
    })?;
    Ok(FoundCamera {
        rpc,
        source: file_name(path),
    })
}

/// The camera GDAL found in the file or beside it, in the pixel coordinates of this file.
pub(super) fn from_gdal(file: &RasterFile, warnings: &mut Vec<String>) -> Result<Option<FoundCamera>, SceneError> {
    let items = file.domain("RPC");
    if items.is_empty() {
        return Ok(None);
    }
    let rpc = read::gdal_domain(&items).map_err(|error| SceneError::BadRpc {
        path: file.path().to_owned(),
        reason: error.to_string(),
    })?;
    let mut camera = FoundCamera {
        rpc,
        source: "image".to_owned(),
    };
    if let Some((crop, origin)) = crop_in_full_image(file, &camera.rpc) {
        camera.rpc = crop.camera(&camera.rpc);
        let [col0, row0] = crop.first;
        camera.source = format!("image, shifted by the crop origin ({col0}, {row0}) of its {origin}");
        warnings.push(format!(
            "{}: its RPC is that of the full image; shifted by the crop origin column {col0}, row {row0} of its {origin}",
            file.path().display()
        ));
    }
    Ok(Some(camera))
}

/// Where a file's pixels lie in the image its RPC is for.
#[derive(Debug, Clone, Copy, PartialEq)]
struct CropInFull {
    /// Column and row of the full image that the outer corner of the first pixel falls on, counted from the full image's
    /// outer corner.
    first: [f64; 2],
    /// Pixels of the full image per pixel of the file, columns and rows.
    factor: [f64; 2],
}

impl CropInFull {
    /// The camera in the file's own pixels.
    fn camera(&self, full: &Rpc) -> Rpc {
        // Corners count from 0 at the outer edge, our pixel centres from 0 half a pixel inside.
        let moved = |offset: f64, axis: usize| (offset + 0.5 - self.first[axis]) / self.factor[axis] - 0.5;
        Rpc {
            sample_offset: moved(full.sample_offset, 0),
            line_offset: moved(full.line_offset, 1),
            sample_scale: full.sample_scale / self.factor[0],
            line_scale: full.line_scale / self.factor[1],
            ..full.clone()
        }
    }
}

/// The crop a file is of the image its RPC is for, where the file keeps the two apart, and what says so.
fn crop_in_full_image(file: &RasterFile, rpc: &Rpc) -> Option<(CropInFull, &'static str)> {
    if let Some(crop) = nitf_chip(&file.domain("")) {
        return Some((crop, "NITF ICHIPB record"));
    }
    // Some writers of crops (shareloc, picanteo) store the origin as a geotransform in pixels, without a coordinate
    // system. A transform in map units has one, or its pixels are not one unit wide.
    if file.crs().is_some() {
        return None;
    }
    let first = pixel_origin(&file.geo_transform()?)?;
    let (width, height) = file.size();
    let centre = |origin: f64, size: usize| origin + size as f64 / 2.0;
    let outside = |value: f64, offset: f64, scale: f64| ((value - offset) / scale).abs() > 1.2;
    // A crop whose RPC was shifted already and whose transform was kept: the shift would leave the camera's domain.
    let shifted_twice = outside(centre(first[1], height), rpc.line_offset, rpc.line_scale)
        || outside(centre(first[0], width), rpc.sample_offset, rpc.sample_scale);
    let crop = CropInFull {
        first,
        factor: [1.0; 2],
    };
    (!shifted_twice).then_some((crop, "geotransform"))
}

/// Origin of a geotransform that counts in whole image pixels; `None` for any other and for the identity.
fn pixel_origin(transform: &GeoTransform) -> Option<[f64; 2]> {
    let six = transform.to_gdal();
    let unit_steps = six[1] == 1.0 && six[2] == 0.0 && six[4] == 0.0 && six[5].abs() == 1.0;
    let first = [six[0], six[3]];
    (unit_steps && first != [0.0; 2]).then_some(first)
}

/// The chip a NITF file is (STDI-0002, ICHIPB): OP are corners of the chip, FI the same corners in the full image, both
/// with 0.5 at the centre of the first pixel.
fn nitf_chip(items: &BTreeMap<String, String>) -> Option<CropInFull> {
    let value = |name: &str| items.get(&format!("ICHIP_{name}"))?.trim().parse::<f64>().ok();
    let axis = |name: &str| -> Option<(f64, f64)> {
        let (chip, chip_end) = (value(&format!("OP_{name}_11"))?, value(&format!("OP_{name}_22"))?);
        let (full, full_end) = (value(&format!("FI_{name}_11"))?, value(&format!("FI_{name}_22"))?);
        let factor = (full_end - full) / (chip_end - chip);
        (factor.is_finite() && factor > 0.0).then_some((full - chip * factor, factor))
    };
    let ((col0, col_factor), (row0, row_factor)) = (axis("COL")?, axis("ROW")?);
    let crop = CropInFull {
        first: [col0, row0],
        factor: [col_factor, row_factor],
    };
    let is_whole = crop.first == [0.0; 2] && crop.factor == [1.0; 2];
    (!is_whole).then_some(crop)
}

fn chosen(
    file: &RasterFile,
    image: FoundCamera,
    json: FoundCamera,
    preference: RpcPreference,
    warnings: &mut Vec<String>,
) -> FoundCamera {
    let apart_px = disagreement_px(&image.rpc, &json.rpc, file.size());
    let (used, other) = match preference {
        RpcPreference::Json => (json, image),
        RpcPreference::Image => (image, json),
    };
    if apart_px.is_none_or(|apart| apart > WORTH_A_WARNING_PX) {
        let apart = apart_px.map_or("by an unknown amount".to_owned(), |apart| format!("by {apart:.1} px"));
        warnings.push(format!(
            "{}: two RPC cameras differ {apart}; used: {}, ignored: {} (--rpc image|json chooses)",
            file.path().display(),
            used.source,
            other.source
        ));
    }
    used
}

/// Largest distance between two cameras over an image, pixels; `None` where the first cannot be localised.
fn disagreement_px(a: &Rpc, b: &Rpc, (width, height): (usize, usize)) -> Option<f64> {
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
    let mut largest: f64 = 0.0;
    for (col, row) in [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)] {
        for step in [-0.5, 0.5] {
            let height_m = a.height_offset_m + step * a.height_scale_m;
            let ground = a.localise(ImagePoint { col, row }, height_m).ok()?;
            let seen = b.project(ground);
            largest = largest.max((seen.col - col).hypot(seen.row - row));
        }
    }
    largest.is_finite().then_some(largest)
}

/// The camera of the first file beside an image that belongs to it by its name and that can be read.
fn sidecar(image: &Path, folders: &Folders) -> Result<Option<FoundCamera>, SceneError> {
    for path in belonging_texts(image, folders)? {
        if let Ok(rpc) = read::rpc_from_text(&file_name(&path), &folders.text(&path)?) {
            let source = file_name(&path);
            return Ok(Some(FoundCamera { rpc, source }));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_geotransform_in_pixels_is_a_crop_origin_and_one_in_metres_is_not() {
        let crop = GeoTransform::from_gdal([5000.0, 1.0, 0.0, 5000.0, 0.0, 1.0]);
        assert_eq!(pixel_origin(&crop), Some([5000.0, 5000.0]));
        let half = GeoTransform::from_gdal([12114.5, 1.0, 0.0, 300.0, 0.0, -1.0]);
        assert_eq!(pixel_origin(&half), Some([12114.5, 300.0]));
        let identity = GeoTransform::from_gdal([0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(pixel_origin(&identity), None);
        let map = GeoTransform::from_gdal([312_000.0, 0.5, 0.0, 4_160_000.0, 0.0, -0.5]);
        assert_eq!(pixel_origin(&map), None);
    }

    fn chip(last: f64) -> BTreeMap<String, String> {
        let corners = [
            ("OP", 0.5, 0.5, 999.5, 999.5),
            ("FI", 2500.5, 1200.5, 2500.5 + last, 1200.5 + last),
        ];
        let mut items = BTreeMap::new();
        for (of, row, col, row_end, col_end) in corners {
            for (name, value) in [
                ("ROW_11", row),
                ("COL_11", col),
                ("ROW_22", row_end),
                ("COL_22", col_end),
            ] {
                items.insert(format!("ICHIP_{of}_{name}"), value.to_string());
            }
        }
        items
    }

    #[test]
    fn a_nitf_chip_starts_where_its_record_says() {
        let crop = nitf_chip(&chip(999.0)).expect("a chip");
        assert_eq!((crop.first, crop.factor), ([1200.0, 2500.0], [1.0, 1.0]));
    }

    #[test]
    fn a_reduced_chip_keeps_the_place_of_its_pixels() {
        // Two pixels of the full image per pixel: chip position 0.5 is full position 2500.5, 1.5 is 2502.5.
        let crop = nitf_chip(&chip(1998.0)).expect("a chip");
        assert_eq!(crop.factor, [2.0, 2.0]);
        let chip_row = |full_corner: f64| (full_corner - crop.first[1]) / crop.factor[1];
        assert_eq!((chip_row(2500.5), chip_row(2502.5)), (0.5, 1.5));
    }
}
