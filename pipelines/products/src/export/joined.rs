//! One tileset over several, such as those of the blocks of a mosaic.

use super::ExportError;
use heliosplat_exchange::tiles::{ESRI_CRS, GENERATOR};
use heliosplat_raster::{RasterError, bounded, write_atomically};
use heliosplat_rpc::frame::geo_from_ecef;
use nalgebra::{Matrix4, Vector3, Vector4};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// West, south, east, north, radians, and lowest and highest altitude, metres; or the same of a projected system.
type Region = [f64; 6];

/// Volumes and coordinate system of tilesets in a projected system; `None` unless all have the same.
#[derive(Default)]
struct OnMap {
    crs: Value,
    whole: Option<Region>,
    parts: Vec<Region>,
}

impl OnMap {
    fn of(tilesets: &[Value]) -> Option<Self> {
        let mut all = Self::default();
        for tileset in tilesets {
            let crs = tileset["extensions"].get(ESRI_CRS)?;
            let root = &tileset["root"];
            let place = |point: Vector3<f64>| [point.x, point.y, point.z];
            let part = extent(root, &root["extensions"][ESRI_CRS]["transform"], place)?;
            if !all.parts.is_empty() && *crs != all.crs {
                return None;
            }
            all.crs = crs.clone();
            all.whole = Some(all.whole.map_or(part, |whole| united(whole, part)));
            all.parts.push(part);
        }
        Some(all)
    }
}

/// Box of an extent.
fn volume([west, south, east, north, low, high]: Region) -> [f64; 12] {
    let [x, y, z] = [(west, east), (south, north), (low, high)].map(|(a, b)| (0.5 * (a + b), 0.5 * (b - a)));
    [x.0, y.0, z.0, x.1, 0.0, 0.0, 0.0, y.1, 0.0, 0.0, 0.0, z.1]
}

/// Writes a tileset that shows other tilesets, each with its address relative to the file and its own file.
///
/// # Errors
/// When a tileset cannot be read or is not one of ours, or the file cannot be written.
pub fn join_tilesets(path: &Path, parts: &[(String, PathBuf)]) -> Result<(), ExportError> {
    let mut children = Vec::with_capacity(parts.len());
    let mut tilesets = Vec::with_capacity(parts.len());
    let mut whole: Option<Region> = None;
    let mut coarsest: f64 = 0.0;
    for (uri, file) in parts {
        let damaged = |reason: &str| RasterError::Damaged(file.clone(), reason.to_owned());
        let text = bounded::read_text(file).map_err(|error| damaged(&error.to_string()))?;
        let tileset: Value = serde_json::from_str(&text).map_err(|error| damaged(&error.to_string()))?;
        let root = &tileset["root"];
        let region = extent(root, &root["transform"], on_earth).ok_or_else(|| damaged("it has no box on Earth"))?;
        let error_m = root["geometricError"].as_f64().unwrap_or(0.0);
        coarsest = coarsest.max(tileset["geometricError"].as_f64().unwrap_or(error_m));
        whole = Some(whole.map_or(region, |whole| united(whole, region)));
        children.push(json!({
            "boundingVolume": {"region": region}, "geometricError": error_m, "content": {"uri": uri},
        }));
        tilesets.push(tileset);
    }
    // A viewer loads the parts as soon as one of them is in sight.
    let error_m = coarsest * (parts.len().max(1) as f64).sqrt();
    let mut joined = json!({
        "asset": {"version": "1.1", "generator": GENERATOR},
        "geometricError": error_m,
        "root": {"boundingVolume": {"region": whole}, "geometricError": error_m, "refine": "ADD"},
    });
    if let Some(map) = OnMap::of(&tilesets)
        && let Some(whole) = map.whole
    {
        let on_map = |region: Region| json!({ESRI_CRS: {"boundingVolume": {"box": volume(region)}}});
        joined["extensionsUsed"] = json!([ESRI_CRS]);
        joined["extensions"] = json!({ ESRI_CRS: map.crs });
        joined["root"]["extensions"] = on_map(whole);
        for (child, &part) in children.iter_mut().zip(&map.parts) {
            child["extensions"] = on_map(part);
        }
    }
    joined["root"]["children"] = json!(children);
    Ok(write_atomically(path, format!("{joined:#}\n").as_bytes())?)
}

/// Longitude and latitude in radians and altitude of a place in Earth-centred, Earth-fixed metres.
fn on_earth(place: Vector3<f64>) -> [f64; 3] {
    let geo = geo_from_ecef(place);
    [geo.lon_deg.to_radians(), geo.lat_deg.to_radians(), geo.height_m]
}

/// Extent of the box of a tile after a transform, in the coordinates of `place`; `None` where it has no box.
fn extent(tile: &Value, transform: &Value, place: impl Fn(Vector3<f64>) -> [f64; 3]) -> Option<Region> {
    let numbers = |value: &Value| -> Option<Vec<f64>> { value.as_array()?.iter().map(Value::as_f64).collect() };
    let volume = numbers(&tile["boundingVolume"]["box"]).filter(|volume| volume.len() == 12)?;
    let transform = numbers(transform).filter(|matrix| matrix.len() == 16)?;
    let transform = Matrix4::from_column_slice(&transform);
    let mut region: Option<Region> = None;
    for corner in 0..8 {
        let side = |axis: usize| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
        let at = |k: usize| volume[k] + (0..3).map(|axis| side(axis) * volume[3 + 3 * axis + k]).sum::<f64>();
        let [x, y, z] = place((transform * Vector4::new(at(0), at(1), at(2), 1.0)).xyz());
        let point = [x, y, x, y, z, z];
        region = Some(region.map_or(point, |region| united(region, point)));
    }
    region
}

fn united(a: Region, b: Region) -> Region {
    let low = |k: usize| f64::min(a[k], b[k]);
    let high = |k: usize| f64::max(a[k], b[k]);
    [low(0), low(1), high(2), high(3), low(4), high(5)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::ecef_from_enu;
    use heliosplat_rpc::{GeoPoint, LocalFrame};

    #[test]
    fn a_tileset_over_others_has_their_region() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let parts = [36.90, 36.92].map(|lon_deg| {
            let frame = LocalFrame::new(GeoPoint::new(lon_deg, 37.5, 700.0));
            let volume = [0.0, 0.0, 25.0, 500.0, 0.0, 0.0, 0.0, 400.0, 0.0, 0.0, 0.0, 25.0];
            let root =
                json!({"boundingVolume": {"box": volume}, "transform": ecef_from_enu(&frame), "geometricError": 7.0});
            let file = folder.path().join(format!("{lon_deg}.json"));
            let text = json!({"geometricError": 900.0, "root": root}).to_string();
            std::fs::write(&file, text).expect("written");
            (format!("../{lon_deg}/tileset.json"), file)
        });
        let path = folder.path().join("tileset.json");
        join_tilesets(&path, &parts).expect("joined");
        let read: Value = serde_json::from_str(&std::fs::read_to_string(&path).expect("text")).expect("JSON");
        let region =
            |tile: &Value| -> Region { serde_json::from_value(tile["boundingVolume"]["region"].clone()).expect("six") };
        let whole = region(&read["root"]);
        // 500 m of longitude and 400 m of latitude on either side.
        let metres = [6_378_137.0 * 37.5f64.to_radians().cos(), 6_371_000.0];
        assert!(((36.90f64.to_radians() - whole[0]) * metres[0] - 500.0).abs() < 3.0);
        assert!(((whole[2] - 36.92f64.to_radians()) * metres[0] - 500.0).abs() < 3.0);
        assert!(((whole[3] - 37.5f64.to_radians()) * metres[1] - 400.0).abs() < 3.0);
        assert!((whole[4] - 700.0).abs() < 0.1 && (whole[5] - 750.0).abs() < 0.1);
        let children = read["root"]["children"].as_array().expect("two");
        assert_eq!(children.len(), 2);
        assert_eq!(children[1]["content"]["uri"], "../36.92/tileset.json");
        assert!(region(&children[0])[2] < region(&children[1])[0]);
        assert!(read["root"]["geometricError"].as_f64().expect("a number") > 900.0);
    }
}
