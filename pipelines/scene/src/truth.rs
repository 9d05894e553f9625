//! Truth of a scene: removal of truth on other ground, and true errors of synthetic cameras.

use super::{Area, Scene, Truth};
use heliosplat_raster::{Crs, CrsTransform, GeoTransform, RasterFile};
use heliosplat_rpc::{GeoPoint, LocalFrame};
use std::collections::BTreeMap;
use std::path::Path;

/// Removes truth on other ground than the scene, with a warning. Truth without a position is kept.
pub(super) fn keep_if_here(truth: &mut Truth, frame: &LocalFrame, area: &Area, warnings: &mut Vec<String>) {
    let Some(path) = truth.dsm.as_deref() else { return };
    let Some(ground) = ground_of(path, frame) else { return };
    if ground.intersection(area).is_none() {
        warnings.push(format!(
            "{}: this truth is on other ground than the scene, left out",
            path.display()
        ));
        truth.dsm = None;
        truth.classes = None;
        truth.relit = None;
    }
}

/// Bounding rectangle of a truth raster in the frame, metres; `None` where the raster or its position cannot be read.
fn ground_of(path: &Path, frame: &LocalFrame) -> Option<Area> {
    let file = RasterFile::open(path).ok()?;
    let (width, height) = file.size();
    let transform = match file.geo_transform() {
        Some(transform) => transform,
        None => {
            let text = heliosplat_raster::bounded::read_text(&path.with_extension("txt")).ok()?;
            GeoTransform::from_region_text(&text, height)?
        }
    };
    let crs = match file.crs() {
        Some(crs) => crs,
        None => Crs::utm(frame.origin).ok()?,
    };
    let to_lon_lat = CrsTransform::to_lon_lat(&crs).ok()?;
    let mut area: Option<Area> = None;
    let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
    for (col, row) in [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)] {
        let [x, y] = transform.map_from_pixel(col, row);
        let (lon_deg, lat_deg) = to_lon_lat.apply(x, y).ok()?;
        let at = frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, frame.origin.height_m));
        let known = area.get_or_insert(Area {
            west_m: at.x,
            south_m: at.y,
            east_m: at.x,
            north_m: at.y,
        });
        known.west_m = known.west_m.min(at.x);
        known.east_m = known.east_m.max(at.x);
        known.south_m = known.south_m.min(at.y);
        known.north_m = known.north_m.max(at.y);
    }
    area.filter(|area| area.west_m.is_finite() && area.north_m.is_finite())
}

impl Scene {
    /// Error that a synthetic scene put into each image's camera (columns, rows; pixels), by image name; `None` for
    /// other scenes.
    pub fn true_camera_biases_px(&self) -> Option<BTreeMap<String, [f64; 2]>> {
        #[derive(serde::Deserialize)]
        struct Summary {
            images: Vec<Made>,
        }
        #[derive(serde::Deserialize)]
        struct Made {
            name: String,
            pointing_bias_px: [f64; 2],
        }
        let text = heliosplat_raster::bounded::read_text(&self.source.join("truth/summary.json")).ok()?;
        let summary: Summary = serde_json::from_str(&text).ok()?;
        let made = summary.images.into_iter();
        Some(made.map(|image| (image.name, image.pointing_bias_px)).collect())
    }
}
