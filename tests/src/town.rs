//! A pair of images of a town without end: of any size, anywhere on Earth, made in seconds.
//!
//! Houses with flat roofs on rolling ground, textured by noise. Nothing is lit and nothing repeats; two parallel
//! cameras look from two sides. Its purpose is size; `heliosplat synth` makes realistic scenes.

use crate::scenes::parallel_camera;
use heliosplat::Raster;
use heliosplat_raster::{ImageSpec, SampleType, write_geotiff};
use heliosplat_rpc::write;
use rayon::prelude::*;
use serde_json::json;
use std::path::Path;

/// Lowest and highest altitude that the images' JSON states, metres.
pub const ALTITUDES_M: [f64; 2] = [690.0, 730.0];
/// Width of a plot with one house, metres.
const PLOT_M: f64 = 40.0;
/// Bounds of roofs and ground, metres above the base, the altitude at which the lean of the cameras displaces nothing.
const HIGHEST_M: f64 = 24.0;
const LOWEST_M: f64 = -6.0;

/// Parameters of a pair of images.
#[derive(Debug, Clone, Copy)]
pub struct Pair {
    /// Width and height of both images, pixels.
    pub size_px: usize,
    /// Ground sampling distance, metres.
    pub gsd_m: f64,
    /// Longitude and latitude of their middle, degrees.
    pub centre_deg: [f64; 2],
    /// Displacement of both images to the east and to the west per metre of height, metres.
    pub lean: f64,
}

impl Pair {
    /// A pair with pixels of half a metre and a base-to-height ratio of 0.4.
    pub fn new(size_px: usize, centre_deg: [f64; 2]) -> Self {
        Self {
            size_px,
            gsd_m: 0.5,
            centre_deg,
            lean: 0.2,
        }
    }

    /// Writes the images with their cameras, and JSON files that state dates and altitudes.
    pub fn write(&self, folder: &Path) {
        std::fs::create_dir_all(folder).expect("a folder");
        for (name, tilt) in [("east", [self.lean, 0.03]), ("west", [-self.lean, -0.03])] {
            let rpc = parallel_camera(self.size_px, self.gsd_m, self.centre_deg, tilt);
            let items: Vec<(String, String)> = write::gdal_domain(&rpc).into_iter().collect();
            let raster = self.image(tilt);
            // Half past ten in the morning, wherever that is.
            let minutes = ((10.5 - self.centre_deg[0] / 15.0).rem_euclid(24.0) * 60.0) as u32;
            let date = format!("20160423{:02}{:02}00", minutes / 60, minutes % 60);
            let spec = ImageSpec {
                rpc: &items,
                ..ImageSpec::plain(&raster)
            };
            let path = folder.join(format!("{name}.tif"));
            write_geotiff(&path, &spec, SampleType::U16).expect("the image is written");
            let said = json!({
                "img": format!("{name}.tif"), "min_alt": ALTITUDES_M[0], "max_alt": ALTITUDES_M[1],
                "acquisition_date": date, "rpc": write::satnerf_json_rpc(&rpc),
            });
            std::fs::write(path.with_extension("json"), said.to_string()).expect("the JSON is written");
        }
    }

    fn image(&self, tilt: [f64; 2]) -> Raster {
        let mut raster = Raster::filled(self.size_px, self.size_px, 1, 0.0);
        let middle = (self.size_px as f64 - 1.0) / 2.0;
        let rows = raster.values.par_chunks_mut(self.size_px).enumerate();
        rows.for_each(|(row, line)| {
            for (col, value) in line.iter_mut().enumerate() {
                let at = [(col as f64 - middle) * self.gsd_m, (middle - row as f64) * self.gsd_m];
                *value = seen(at, tilt) as f32;
            }
        });
        raster
    }
}

/// Brightness along a ray that meets the base at `at` (east, north, metres).
fn seen(at: [f64; 2], tilt: [f64; 2]) -> f64 {
    let ground = |z: f64| [0, 1].map(|axis| at[axis] - tilt[axis] * z);
    let below = |z: f64| surface(ground(z)) >= z;
    let (mut above, mut z) = (HIGHEST_M, HIGHEST_M);
    while z > LOWEST_M && !below(z) {
        (above, z) = (z, z - 1.0);
    }
    // Bisection between the last point in the air and the first below the surface.
    for _ in 0..6 {
        let middle = 0.5 * (above + z);
        if below(middle) {
            z = middle;
        } else {
            above = middle;
        }
    }
    let [x, y] = ground(z);
    let is_wall = surface([x, y]) - z > 0.5;
    let noise = 0.45 * value_noise([x, y], 1.1, 1)
        + 0.3 * value_noise([x, y], 2.7, 2)
        + 0.25 * value_noise([x, y], 11.0, 3)
        + 0.5 * value_noise([z, x + y], 1.3, 4) * f64::from(u8::from(is_wall));
    300.0 + 250.0 * noise + 150.0 * f64::from(u8::from(surface([x, y]) > terrain([x, y]) + 1.0))
}

/// Altitude of roofs and ground above the base at `at` (east and north of the middle, metres), metres.
pub fn surface(at: [f64; 2]) -> f64 {
    let plot = at.map(|v| (v / PLOT_M).floor());
    let random = |what: u64| hash(plot.map(|v| v as i64), what);
    let middle = [0, 1].map(|axis| (plot[axis] + 0.4 + 0.2 * random(axis as u64)) * PLOT_M);
    let half = [0, 1].map(|axis| 6.0 + 6.0 * random(2 + axis as u64));
    let inside = (0..2).all(|axis| (at[axis] - middle[axis]).abs() < half[axis]);
    match inside && random(4) > 0.2 {
        true => terrain(middle) + 4.0 + 10.0 * random(5),
        false => terrain(at),
    }
}

fn terrain([x, y]: [f64; 2]) -> f64 {
    2.5 * (x / 90.0).sin() * (y / 70.0).cos() + 2.0 * (x / 310.0 + y / 230.0).sin()
}

/// Smooth noise of 0 to 1 whose spots are `size` metres wide.
fn value_noise(at: [f64; 2], size: f64, what: u64) -> f64 {
    let place = at.map(|v| v / size);
    let cell = place.map(|v| v.floor() as i64);
    let [fx, fy] = place.map(|v| {
        let t = v - v.floor();
        t * t * (3.0 - 2.0 * t)
    });
    let corner = |dx: i64, dy: i64| hash([cell[0] + dx, cell[1] + dy], what + 10);
    let north = corner(0, 0) * (1.0 - fx) + corner(1, 0) * fx;
    let south = corner(0, 1) * (1.0 - fx) + corner(1, 1) * fx;
    north * (1.0 - fy) + south * fy
}

/// A number of 0 to 1 that follows from a place and a purpose (the finaliser of SplitMix64).
fn hash([x, y]: [i64; 2], what: u64) -> f64 {
    let mut bits = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (y as u64).rotate_left(32) ^ (what << 17);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (bits ^ (bits >> 31)) as f64 / u64::MAX as f64
}
