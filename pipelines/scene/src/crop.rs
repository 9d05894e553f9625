//! What a view needs of an image: the crop that shows an area, its camera in f32, its sun, and its date.

use crate::{Area, ImageSun, Scene, SceneImage};
use glam::{DVec3, Vec3};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_rpc::ProjectiveMap;
use std::collections::BTreeMap;

/// Pixels kept around the area, so that losses with a window and splats that straddle the edge see their surroundings.
const MARGIN_PX: f64 = 8.0;

/// A rectangle of an image, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Crop {
    /// First column.
    pub col0: usize,
    /// First row.
    pub row0: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Crop {
    /// The smallest rectangle of an image that shows all of `area` between two altitudes (metres, scene frame); `None` when
    /// the image shows none of it.
    pub fn of(image: &SceneImage, area: &Area, up_m: (f64, f64)) -> Option<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for x in [area.west_m, area.east_m] {
            for y in [area.south_m, area.north_m] {
                for z in [up_m.0, up_m.1] {
                    let at = image.pinhole.map.project(nalgebra::Vector3::new(x, y, z));
                    for axis in 0..2 {
                        low[axis] = low[axis].min(at[axis]);
                        high[axis] = high[axis].max(at[axis]);
                    }
                }
            }
        }
        let limits = [image.pixels.width as f64, image.pixels.height as f64];
        let first = [0, 1].map(|a| (low[a] - MARGIN_PX).floor().max(0.0));
        let last = [0, 1].map(|a| (high[a] + MARGIN_PX).ceil().min(limits[a] - 1.0));
        (last[0] - first[0] >= 16.0 && last[1] - first[1] >= 16.0).then(|| Self {
            col0: first[0] as usize,
            row0: first[1] as usize,
            width: (last[0] - first[0]) as usize + 1,
            height: (last[1] - first[1]) as usize + 1,
        })
    }

    /// The pixels of the rectangle.
    pub fn cut(&self, raster: &Raster) -> Raster {
        let mut out = Raster::filled(self.width, self.height, raster.bands, f32::NAN);
        for band in 0..raster.bands {
            for row in 0..self.height {
                let from = (band * raster.height + self.row0 + row) * raster.width + self.col0;
                let to = (band * self.height + row) * self.width;
                out.values[to..to + self.width].copy_from_slice(&raster.values[from..from + self.width]);
            }
        }
        out
    }
}

/// The engine's camera of a rectangle of the image that `map` sees, its projections moved by `shift_px`.
pub fn camera(map: &ProjectiveMap, crop: &Crop, shift_px: [f32; 2]) -> ProjectiveCamera {
    let moved = |row: [f64; 4], by: f64| {
        // (u·p + u0)/(1 + w·p) + by = ((u + by·w)·p + u0 + by)/(1 + w·p)
        [
            row[0] + by * map.w[0],
            row[1] + by * map.w[1],
            row[2] + by * map.w[2],
            row[3] + by,
        ]
    };
    let u = moved(map.u, f64::from(shift_px[0]) - crop.col0 as f64);
    let v = moved(map.v, f64::from(shift_px[1]) - crop.row0 as f64);
    ProjectiveCamera::new(u, v, map.w, (crop.width, crop.height), -DVec3::Z)
}

/// Unit vector toward a sun, scene frame; `None` where it is unknown.
pub fn direction(sun: &ImageSun) -> Option<Vec3> {
    let direction = sun.position?.direction_enu();
    Some(Vec3::new(direction.x as f32, direction.y as f32, direction.z as f32))
}

/// A number per image that two images share when they are of one date (the same day, or without times the same sun). An image of
/// which neither is known has a date of its own: nothing says that its light is that of another.
pub fn date_groups(images: &[&SceneImage]) -> Vec<u32> {
    let mut known = BTreeMap::new();
    images
        .iter()
        .enumerate()
        .map(|(place, image)| {
            let key = match (image.time, image.sun.position) {
                (Some(time), _) => format!("{}", time.as_second().div_euclid(86_400)),
                (None, Some(sun)) => format!(
                    "{:.0} {:.0}",
                    sun.azimuth_rad.to_degrees(),
                    sun.elevation_rad.to_degrees()
                ),
                (None, None) => format!("image {place}"),
            };
            let next = known.len() as u32;
            *known.entry(key).or_insert(next)
        })
        .collect()
}

/// Altitudes of a scene relative to its frame's origin, metres.
pub fn altitude_range(scene: &Scene) -> (f64, f64) {
    let origin = scene.origin().height_m;
    (scene.altitude_range_m.0 - origin, scene.altitude_range_m.1 - origin)
}

/// `area` grown by `margin_m` on all sides.
pub fn grown(area: &Area, margin_m: f64) -> Area {
    Area {
        west_m: area.west_m - margin_m,
        south_m: area.south_m - margin_m,
        east_m: area.east_m + margin_m,
        north_m: area.north_m + margin_m,
    }
}
