//! The rational camera of an image: selection among its sources, and conversion for a crop.

use super::entry::ImageEntry;
use super::files::Folders;
use super::names::{file_name, folder_of};
use super::sidecars::belonging_texts;
use super::{Result, RpcPreference, SceneError};
use heliosplat_raster::{Crs, GeoTransform, RasterFile};
use heliosplat_rpc::{ImagePoint, Rpc, read};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest distance of a crop's origin from whole pixels, pixels: RPC offsets are written with two decimals.
const WHOLE_PX: f64 = 0.02;

/// A camera and its source.
#[derive(Debug, Clone)]
pub(super) struct FoundCamera {
    /// The camera.
    pub(super) rpc: Rpc,
    /// Its source: `image` or a file name.
    pub(super) source: String,
    kind: Kind,
}

/// Place where a camera is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// A Sat-NeRF JSON.
    Json,
    /// A vendor's file beside the image, or GDAL's `.aux.xml`.
    Sidecar,
    /// The image file itself.
    Tag,
}

/// The cameras of an image.
#[derive(Debug, Clone)]
pub(super) struct Cameras {
    /// The camera in use.
    pub(super) used: FoundCamera,
    /// All other cameras.
    pub(super) others: Vec<FoundCamera>,
    /// Unreadable camera files, with the reason.
    pub(super) unread: Vec<(PathBuf, String)>,
}

/// Finds the cameras of an image. A camera named in `scene.toml` is the only one. Among the others `preference`
/// decides; by default the order is JSON, sidecar, tag, but the tag of a crop precedes the sidecar of the whole image.
/// Sidecars are read by our own readers, and by GDAL where these find none.
pub(super) fn find(
    file: &RasterFile,
    entry: &ImageEntry,
    preference: RpcPreference,
    folders: &Folders,
    warnings: &mut Vec<String>,
) -> Result<Cameras> {
    if let Some(path) = entry.said.as_ref().and_then(|said| said.rpc.as_ref()) {
        let (used, others, unread) = (from_text_file(path, folders)?, Vec::new(), Vec::new());
        return Ok(Cameras { used, others, unread });
    }
    let json = entry.json.as_deref();
    let (mut all, mut unread) = of_files(file, json, folders)?;
    if let Some(json) = json {
        let kind = Kind::Json;
        all.push(FoundCamera {
            kind,
            ..from_text_file(json, folders)?
        });
    }
    let of = |kind: Kind| all.iter().find(|camera| camera.kind == kind);
    let tag_first = (of(Kind::Tag).zip(of(Kind::Sidecar)))
        .is_some_and(|(tag, sidecar)| is_of_crop(&tag.rpc, &sidecar.rpc, file.size()));
    use Kind::{Json, Sidecar, Tag};
    let order = match preference {
        RpcPreference::Json if tag_first => [Json, Tag, Sidecar],
        RpcPreference::Json => [Json, Sidecar, Tag],
        RpcPreference::Image if tag_first => [Tag, Sidecar, Json],
        RpcPreference::Image | RpcPreference::Sidecar => [Sidecar, Tag, Json],
        RpcPreference::Tag => [Tag, Sidecar, Json],
    };
    all.sort_by_key(|camera| order.iter().position(|kind| *kind == camera.kind));
    let mut others = all.into_iter();
    let path = || file.path().to_owned();
    let Some(used) = others.next() else {
        return Err(match unread.is_empty() {
            false => {
                let (path, reason) = unread.remove(0);
                SceneError::BadRpc(path, reason)
            }
            true if map_frame(file).is_some() => SceneError::MapProjected(path()),
            true => SceneError::NoRpc(path()),
        });
    };
    if let Some((_, shift)) = used.source.split_once(", shifted by ") {
        let path = file.path().display();
        warnings.push(format!("{path}: its RPC is that of the full image; shifted by {shift}"));
    }
    let others = others.collect();
    Ok(Cameras { used, others, unread })
}

/// Geotransform and coordinate system of a map-projected file. `None` for a rotated geotransform: frames fitted to the
/// corners of a raw image, such as those of NITF headers, are rotated and may be off by hundreds of pixels.
pub(super) fn map_frame(file: &RasterFile) -> Option<(GeoTransform, Crs)> {
    let transform = file.geo_transform()?;
    let [_, _, turned, _, too, _] = transform.to_gdal();
    (turned == 0.0 && too == 0.0).then_some((transform, file.crs()?))
}

/// The camera in a text file of any known format.
///
/// # Errors
/// [`SceneError::BadRpc`] when the file contains no camera.
pub(super) fn from_text_file(path: &Path, folders: &Folders) -> Result<FoundCamera> {
    let (source, kind) = (file_name(path), Kind::Sidecar);
    let rpc = read::rpc_from_text(&source, &folders.text(path)?);
    let rpc = rpc.map_err(|error| SceneError::BadRpc(path.to_owned(), error.to_string()))?;
    Ok(FoundCamera { rpc, source, kind })
}

/// Cameras, and unreadable camera files with the reason.
type Readable = (Vec<FoundCamera>, Vec<(PathBuf, String)>);

/// Cameras from the files beside an image and from its tag, in pixels of the image file.
fn of_files(file: &RasterFile, json: Option<&Path>, folders: &Folders) -> Result<Readable> {
    let (mut found, mut unread) = (Vec::new(), Vec::new());
    let mut take = |rpc: Result<Rpc, read::ReadError>, path: &Path, source: String, kind: Kind| match rpc {
        Ok(rpc) => found.push(in_own_pixels(file, FoundCamera { rpc, source, kind })),
        Err(error) => unread.push((path.to_owned(), error.to_string())),
    };
    let mut has_sidecar = false;
    for path in belonging_texts(file.path(), folders)? {
        if Some(path.as_path()) == json {
            continue;
        }
        let name = file_name(&path);
        let rpc = read::rpc_from_text(&name, &folders.text(&path)?);
        if rpc.is_ok() || is_camera_file(&name.to_lowercase()) {
            has_sidecar = true;
            take(rpc, &path, name, Kind::Sidecar);
        }
    }
    let by_gdal = file.domain("RPC");
    if let Some(path) = beside_with_rpc(file.path(), folders)? {
        has_sidecar = true;
        take(read::gdal_domain(&by_gdal), &path, file_name(&path), Kind::Sidecar);
    }
    let (tag, source) = (file.own_domain("RPC"), "image".to_owned());
    if !tag.is_empty() {
        take(read::gdal_domain(&tag), file.path(), source, Kind::Tag);
    } else if !has_sidecar && !by_gdal.is_empty() {
        take(read::gdal_domain(&by_gdal), file.path(), source, Kind::Sidecar);
    }
    Ok((found, unread))
}

/// True if `name` (in lower case) is that of a file with nothing but a camera.
fn is_camera_file(name: &str) -> bool {
    let ends = [".rpb", ".rpc", "_rpc.txt", "_rpc.xml"];
    name.starts_with("rpc_") && name.ends_with(".xml") || ends.iter().any(|end| name.ends_with(end))
}

/// GDAL's `.aux.xml` beside an image, if it contains an RPC.
fn beside_with_rpc(image: &Path, folders: &Folders) -> Result<Option<PathBuf>> {
    let name = format!("{}.aux.xml", file_name(image)).to_lowercase();
    let Some(path) = folders.by_name(folder_of(image))?.get(&name).cloned() else {
        return Ok(None);
    };
    let has_rpc = folders.text(&path)?.contains("domain=\"RPC\"");
    Ok(has_rpc.then_some(path))
}

/// Converts the camera of a full image into that of the crop in the file; other cameras are unchanged.
fn in_own_pixels(file: &RasterFile, mut camera: FoundCamera) -> FoundCamera {
    if let Some((crop, origin)) = crop_in_full_image(file, &camera.rpc) {
        camera.rpc = crop.camera(&camera.rpc);
        let [col0, row0] = crop.first;
        camera.source += &format!(", shifted by the crop origin column {col0}, row {row0} of its {origin}");
    }
    camera
}

/// The vendor's camera of an image: its first sidecar, else its tag; in pixels of the image file.
pub(super) fn of_vendor(file: &RasterFile, folders: &Folders) -> Result<Option<Rpc>> {
    let (all, _) = of_files(file, None, folders)?;
    Ok(all.into_iter().next().map(|camera| camera.rpc))
}

/// True if the image is a crop whose tag was moved along while the sidecar of the whole image was copied unchanged: the
/// tag is the sidecar shifted right and down by whole pixels, and the image ends inside the sidecar's domain.
fn is_of_crop(tag: &Rpc, sidecar: &Rpc, (width, height): (usize, usize)) -> bool {
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
    let moved = |(col, row): (f64, f64)| {
        let seen = sidecar.project(tag.localise(ImagePoint { col, row }, tag.height_offset_m).ok()?);
        Some([seen.col - col, seen.row - row])
    };
    let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)].map(moved);
    let Some(first) = corners[0] else {
        return false;
    };
    let is_whole = |corner: &Option<[f64; 2]>| {
        corner.is_some_and(|corner| (0..2).all(|axis| (corner[axis] - first[axis].round()).abs() < WHOLE_PX))
    };
    let ends = [
        sidecar.sample_offset + sidecar.sample_scale.abs() - right,
        sidecar.line_offset + sidecar.line_scale.abs() - bottom,
    ];
    let is_inside = (0..2).all(|axis| first[axis] > -WHOLE_PX && first[axis] < ends[axis] + 1.0);
    corners.iter().all(is_whole) && is_inside
}

/// Position of a file's pixels in the full image of its RPC.
#[derive(Debug, Clone, Copy, PartialEq)]
struct CropInFull {
    /// Column and row of the outer corner of the first pixel, counted from the outer corner of the full image.
    first: [f64; 2],
    /// Pixels of the full image per pixel of the file, along columns and rows.
    factor: [f64; 2],
}

impl CropInFull {
    /// The camera in pixels of the file.
    fn camera(&self, full: &Rpc) -> Rpc {
        // Corners are counted from the outer edge; our pixel centres start half a pixel inside.
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

/// Crop of the full image that a file contains, and the record that states it; `None` where file and RPC have the same
/// pixels.
fn crop_in_full_image(file: &RasterFile, rpc: &Rpc) -> Option<(CropInFull, &'static str)> {
    if let Some(crop) = nitf_chip(&file.domain("")) {
        return Some((crop, "NITF ICHIPB record"));
    }
    // Some writers of crops (shareloc, picanteo) store the crop's origin as a geotransform in pixels, without a
    // coordinate system. A transform in map units has one, or its pixels are not one unit wide.
    if file.crs().is_some() {
        return None;
    }
    let first = pixel_origin(&file.geo_transform()?)?;
    let (width, height) = file.size();
    let centre = |origin: f64, size: usize| origin + size as f64 / 2.0;
    let outside = |value: f64, offset: f64, scale: f64| ((value - offset) / scale).abs() > 1.2;
    // The RPC was shifted already and the transform kept: another shift would leave the camera's domain.
    let shifted_twice = outside(centre(first[1], height), rpc.line_offset, rpc.line_scale)
        || outside(centre(first[0], width), rpc.sample_offset, rpc.sample_scale);
    let factor = [1.0; 2];
    (!shifted_twice).then_some((CropInFull { first, factor }, "geotransform"))
}

/// Origin of a geotransform with pixel steps of one; `None` for any other transform and for the identity.
fn pixel_origin(transform: &GeoTransform) -> Option<[f64; 2]> {
    let six = transform.to_gdal();
    let unit_steps = six[1] == 1.0 && six[2] == 0.0 && six[4] == 0.0 && six[5].abs() == 1.0;
    let first = [six[0], six[3]];
    (unit_steps && first != [0.0; 2]).then_some(first)
}

/// Crop of a NITF chip (STDI-0002, ICHIPB): OP are corners of the chip, FI the same corners in the full image, both
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
    let (first, factor) = ([col0, row0], [col_factor, row_factor]);
    let is_whole = first == [0.0; 2] && factor == [1.0; 2];
    (!is_whole).then_some(CropInFull { first, factor })
}

/// Largest half range of heights over which two cameras are compared, metres: half of the range of heights on Earth.
const HEIGHTS_M: f64 = 4500.0;

/// Largest distance between two cameras at the corners of an image and two heights, pixels; `None` where the first
/// camera cannot be localised or a distance is not finite. Size is columns and rows.
pub(super) fn apart_px(a: &Rpc, b: &Rpc, (width, height): (usize, usize)) -> Option<f64> {
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
    let mut largest: f64 = 0.0;
    for (col, row) in [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)] {
        let half_m = (0.5 * a.height_scale_m.abs()).min(HEIGHTS_M);
        for step_m in [-half_m, half_m] {
            let height_m = a.height_offset_m + step_m;
            let ground = a.localise(ImagePoint { col, row }, height_m).ok()?;
            let seen = b.project(ground);
            largest = largest.max((seen.col - col).hypot(seen.row - row));
        }
    }
    largest.is_finite().then_some(largest)
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
        // Two pixels of the full image per chip pixel: chip position 0.5 is full position 2500.5, and 1.5 is 2502.5.
        let crop = nitf_chip(&chip(1998.0)).expect("a chip");
        assert_eq!(crop.factor, [2.0, 2.0]);
        let chip_row = |full_corner: f64| (full_corner - crop.first[1]) / crop.factor[1];
        assert_eq!((chip_row(2500.5), chip_row(2502.5)), (0.5, 1.5));
    }
}
