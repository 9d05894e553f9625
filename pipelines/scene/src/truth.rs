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
        let path = path.display();
        let text = format!("{path}: this truth is on other ground than the scene, left out");
        warnings.push(text);
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
    let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
    let corner = |(col, row): (f64, f64)| {
        let [x, y] = transform.map_from_pixel(col, row);
        let (lon_deg, lat_deg) = to_lon_lat.apply(x, y).ok()?;
        let at = frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, frame.origin.height_m));
        Some([at.x, at.y])
    };
    let corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)].map(corner);
    let area = Area::covering(corners.into_iter().collect::<Option<Vec<_>>>()?);
    (area.west_m.is_finite() && area.north_m.is_finite()).then_some(area)
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
