//! A terrain with known heights, and images of it by a plain renderer with exact parallel cameras.
//!
//! The terrain is a slope with hills and buildings, of random albedo, under the sun of each date with cast shadows.
//! Heights are known at each cell of half a pixel.

use super::scene_fuzz::delivery::{Image, Scene, Truth};
use super::scenes::{METRES_PER_DEGREE, parallel_camera};
use heliosplat::Raster;
use heliosplat_rpc::GeoPoint;
use heliosplat_rpc::sun::sun_position;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// Longitude and latitude of the terrain, degrees, and altitude of its middle, metres.
const PLACE: [f64; 2] = [36.91, 37.58];
const GROUND_M: f64 = 700.0;
/// Cells of the terrain each way.
const CELLS: usize = 288;
/// Cells of a pixel each way.
const PIXEL_CELLS: f64 = 2.0;
/// Samples of a pixel each way.
const SAMPLES: usize = 2;
/// Depth of a step along a ray, cells.
const RAY_STEP_CELLS: f64 = 0.8;
/// Times that the last step is halved.
const HALVINGS: usize = 4;

/// Cover of level ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cover {
    /// Looks different in each image, as water does.
    Water,
    /// Is of one brightness.
    Plain,
}

/// Heights and albedo.
#[derive(Clone)]
pub struct Terrain {
    cell_m: f64,
    height_m: Vec<f32>,
    albedo: Vec<f32>,
    low_m: f32,
    high_m: f32,
    covered: Vec<usize>,
}

/// Smooth noise of a wavelength in cells, -1 to 1.
fn noise(rng: &mut Pcg32, wavelength: usize) -> Vec<f32> {
    let side = CELLS / wavelength + 2;
    let nodes: Vec<f32> = (0..side * side).map(|_| rng.random_range(-1.0..1.0)).collect();
    let at = |i: usize| {
        let (col, row) = (i % CELLS, i / CELLS);
        let part = |v: usize| (v % wavelength) as f32 / wavelength as f32;
        let node = |dc: usize, dr: usize| nodes[(row / wavelength + dr) * side + col / wavelength + dc];
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let (c, r) = (part(col), part(row));
        mix(mix(node(0, 0), node(1, 0), c), mix(node(0, 1), node(1, 1), c), r)
    };
    (0..CELLS * CELLS).map(at).collect()
}

impl Terrain {
    fn new(rng: &mut Pcg32, request: &TerrainRequest) -> Self {
        let cell_m = request.gsd_m / PIXEL_CELLS;
        let slope: [f32; 2] = [rng.random_range(-0.08..0.08), rng.random_range(-0.08..0.08)];
        let hills = noise(rng, 96);
        let height_m = (0..CELLS * CELLS)
            .map(|i| {
                let [x, y] = [i % CELLS, i / CELLS].map(|v| (v as f32 - CELLS as f32 / 2.0) * cell_m as f32);
                GROUND_M as f32 + slope[0] * x - slope[1] * y + request.hills_m as f32 * hills[i]
            })
            .collect();
        let mut albedo = vec![0.5f32; CELLS * CELLS];
        for (wavelength, strength) in [(2, 0.12), (4, 0.12), (10, 0.10), (24, 0.10)] {
            for (albedo, noise) in albedo.iter_mut().zip(noise(rng, wavelength)) {
                *albedo += strength * noise;
            }
        }
        if request.periodic {
            let period = rng.random_range(8..28usize);
            for i in (0..CELLS * CELLS).filter(|i| i % CELLS > CELLS / 2) {
                let is_dark = (i % CELLS) % period < period / 2 && (i / CELLS) % period < period / 2;
                albedo[i] = if is_dark { 0.25 } else { 0.6 };
            }
        }
        let mut terrain = Self {
            cell_m,
            height_m,
            albedo,
            low_m: 0.0,
            high_m: 0.0,
            covered: Vec::new(),
        };
        let buildings = rng.random_range(1..5);
        for _ in 0..buildings {
            let size: [usize; 2] = [rng.random_range(20..56), rng.random_range(20..56)];
            let tall = rng.random_range(3.0..12.0);
            terrain.raise(rng, size, tall);
        }
        if request.tower {
            let tall = rng.random_range(20.0..40.0);
            terrain.raise(rng, [28, 28], tall);
        }
        if request.cover.is_some() {
            terrain.level(rng);
        }
        terrain
    }

    /// Levels a side of the ground, which a [`Cover`] lies on.
    fn level(&mut self, rng: &mut Pcg32) {
        let turn: f64 = rng.random_range(0.0..std::f64::consts::TAU);
        let edge = rng.random_range(0.0..0.15) * CELLS as f64;
        let is_covered = |cell: &usize| {
            let [col, row] = [cell % CELLS, cell / CELLS].map(|v| v as f64 - CELLS as f64 / 2.0);
            col * turn.cos() + row * turn.sin() > edge
        };
        self.covered = (0..CELLS * CELLS).filter(is_covered).collect();
        for &cell in &self.covered {
            (self.height_m[cell], self.albedo[cell]) = (self.low_m, 0.2);
        }
    }

    /// Adds a building of `wide` by `high` cells, `tall` metres above the ground, at a random place.
    fn raise(&mut self, rng: &mut Pcg32, [wide, high]: [usize; 2], tall: f32) {
        let margin = CELLS / 4;
        let col0 = rng.random_range(margin..CELLS - margin - wide);
        let row0 = rng.random_range(margin..CELLS - margin - high);
        let roof = self.height_m[(row0 + high / 2) * CELLS + col0 + wide / 2] + tall;
        let shade: f32 = rng.random_range(-0.2..0.3);
        for row in row0..row0 + high {
            for col in col0..col0 + wide {
                let cell = row * CELLS + col;
                self.height_m[cell] = self.height_m[cell].max(roof);
                self.albedo[cell] = (self.albedo[cell] + shade).clamp(0.1, 0.95);
            }
        }
        self.low_m = self.height_m.iter().copied().fold(f32::MAX, f32::min);
        self.high_m = self.height_m.iter().copied().fold(f32::MIN, f32::max);
    }

    /// The cell of a place, metres east and north of the middle; the nearest one beyond the edge.
    fn cell_of(&self, x_m: f64, y_m: f64) -> usize {
        let at = |v: f64| ((v / self.cell_m) + CELLS as f64 / 2.0).clamp(0.0, CELLS as f64 - 1.0) as usize;
        at(-y_m) * CELLS + at(x_m)
    }

    /// The lowest and highest height within some pixels of a place (longitude and latitude, degrees), metres.
    pub(super) fn heights_around(&self, longitude_deg: f64, latitude_deg: f64, reach_px: usize) -> (f32, f32) {
        let per_longitude = METRES_PER_DEGREE * PLACE[1].to_radians().cos();
        let x_m = (longitude_deg - PLACE[0]) * per_longitude;
        let y_m = (latitude_deg - PLACE[1]) * METRES_PER_DEGREE;
        let (mut low, mut high) = (f32::MAX, f32::MIN);
        let reach = reach_px * PIXEL_CELLS as usize;
        let side = 2 * reach + 1;
        for step in 0..side * side {
            let [dx, dy] = [step % side, step / side].map(|s| (s as f64 - reach as f64) * self.cell_m);
            let height = self.height_m[self.cell_of(x_m + dx, y_m + dy)];
            (low, high) = (low.min(height), high.max(height));
        }
        (low, high)
    }

    /// Radiance of each cell under a sun: its albedo without a sun, a small part of it in the shade.
    fn lit(&self, toward: Option<[f64; 3]>) -> Vec<f32> {
        let Some([east, north, up]) = toward.filter(|toward| toward[2] > 0.1) else {
            return self.albedo.clone();
        };
        let level = east.hypot(north).max(1e-6);
        let (dx, dy, rise) = (
            east / level * self.cell_m,
            north / level * self.cell_m,
            (up / level * self.cell_m) as f32,
        );
        let of = |i: usize| {
            let [col, row] = [i % CELLS, i / CELLS].map(|v| v as f64 - CELLS as f64 / 2.0 + 0.5);
            let (x, y) = (col * self.cell_m, -row * self.cell_m);
            let mut ray = self.height_m[i] + 0.05;
            let mut steps = 0.0;
            while ray < self.high_m {
                steps += 1.0;
                ray += rise;
                if self.height_m[self.cell_of(x + steps * dx, y + steps * dy)] > ray {
                    return self.albedo[i] * 0.25;
                }
            }
            self.albedo[i]
        };
        (0..CELLS * CELLS).map(of).collect()
    }

    /// An image of `lit` cells.
    fn image(&self, lit: &[f32], size: usize, tilt: [f64; 2]) -> Raster {
        let mut raster = Raster::filled(size, size, 1, 0.0);
        let (middle, gsd_m) = ((size as f64 - 1.0) / 2.0, PIXEL_CELLS * self.cell_m);
        for (index, value) in raster.values.iter_mut().enumerate() {
            for sample in 0..SAMPLES * SAMPLES {
                let inside = |s: usize| (s as f64 + 0.5) / SAMPLES as f64 - 0.5;
                let x = ((index % size) as f64 - middle + inside(sample % SAMPLES)) * gsd_m;
                let y = -((index / size) as f64 - middle + inside(sample / SAMPLES)) * gsd_m;
                let hit_at = |height: f64| {
                    let above = height - GROUND_M;
                    let cell = self.cell_of(x - tilt[0] * above, y - tilt[1] * above);
                    (f64::from(self.height_m[cell]) >= height || height < f64::from(self.low_m)).then_some(cell)
                };
                let mut height = f64::from(self.high_m);
                let mut hit = loop {
                    match hit_at(height) {
                        Some(cell) => break cell,
                        None => height -= RAY_STEP_CELLS * self.cell_m,
                    }
                };
                // The surface lies within the last step.
                let mut step = RAY_STEP_CELLS * self.cell_m;
                for _ in 0..HALVINGS {
                    step /= 2.0;
                    if let Some(cell) = hit_at(height + step) {
                        (hit, height) = (cell, height + step);
                    }
                }
                *value += lit[hit] / (SAMPLES * SAMPLES) as f32;
            }
        }
        raster
    }
}

/// Parameters of a scene of a terrain.
#[derive(Debug, Clone)]
pub struct TerrainRequest {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of images.
    pub views: usize,
    /// Width and height of the images, pixels.
    pub size: usize,
    /// Ground sampling distance, metres.
    pub gsd_m: f64,
    /// Height of hills 48 pixels wide, metres.
    pub hills_m: f64,
    /// Largest angle between the images, degrees; drawn where `None`.
    pub convergence_deg: Option<f64>,
    /// Random error of each camera, pixels: one standard deviation in each axis.
    pub pointing_px: f64,
    /// True if half of the ground repeats itself, as orchards and parking places do.
    pub periodic: bool,
    /// True for a tower of 20 to 40 m.
    pub tower: bool,
    /// True if a building stands in some of the images only.
    pub change: bool,
    /// Cover of a side of the ground.
    pub cover: Option<Cover>,
}

impl TerrainRequest {
    /// Gentle ground at half a metre a pixel, in three images of 64 pixels.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            views: 3,
            size: 64,
            gsd_m: 0.5,
            hills_m: 1.5,
            convergence_deg: None,
            pointing_px: 0.1,
            periodic: false,
            tower: false,
            change: false,
            cover: None,
        }
    }

    /// Makes the scene.
    pub fn scene(&self) -> Scene {
        let mut rng = Pcg32::seed_from_u64(self.seed);
        let terrain = Terrain::new(&mut rng, self);
        let mut other = terrain.clone();
        if self.change {
            let tall = rng.random_range(4.0..12.0);
            other.raise(&mut rng, [40, 40], tall);
        }
        let images = self.images((&terrain, &other), &mut rng);
        let (low, high) = (f64::from(terrain.low_m), f64::from(terrain.high_m.max(other.high_m)));
        let truth = match self.change {
            true => vec![terrain, other],
            false => vec![terrain],
        };
        Scene {
            images,
            truth: Truth::Terrains(truth),
            gsd_m: self.gsd_m,
            altitude_m: (low, high),
            stated_m: Some((low - rng.random_range(5.0..40.0), high + rng.random_range(5.0..40.0))),
            crs: None,
            datum_px: 0.0,
        }
    }

    fn images(&self, (terrain, other): (&Terrain, &Terrain), rng: &mut Pcg32) -> Vec<Image> {
        let views = self.views;
        let spread = match self.convergence_deg {
            Some(degrees) => degrees.to_radians().tan(),
            None => rng.random_range(0.2..0.7),
        };
        let turn: f64 = rng.random_range(0.0..std::f64::consts::TAU);
        let lean: [f64; 2] = [rng.random_range(-0.15..0.15), rng.random_range(-0.15..0.15)];
        let tilts: Vec<[f64; 2]> = (0..views)
            .map(|view| {
                let along = spread * (view as f64 / (views as f64 - 1.0) - 0.5);
                let across = spread * rng.random_range(-0.3..0.3);
                let (sin, cos) = turn.sin_cos();
                [
                    lean[0] + along * cos - across * sin,
                    lean[1] + along * sin + across * cos,
                ]
            })
            .collect();
        // The order of the dates is not that of the directions, or shadows would move as the ground does.
        let first_date = rng.random_range(0..5);
        let place = GeoPoint::new(PLACE[0], PLACE[1], GROUND_M);
        let mut images = Vec::new();
        for (view, tilt) in tilts.iter().enumerate() {
            let shown = if view < views / 2 { other } else { terrain };
            let date = DATES[(first_date + 2 * view) % DATES.len()];
            let time: jiff::Timestamp = moment(date).parse().expect("a time");
            let toward = sun_position(time, place).direction_enu();
            let mut lit = shown.lit(Some([toward.x, toward.y, toward.z]));
            if self.cover == Some(Cover::Water) {
                shown
                    .covered
                    .iter()
                    .for_each(|&cell| lit[cell] = rng.random_range(0.1..0.3));
            }
            let mut pixels = shown.image(&lit, self.size, *tilt);
            let gain = rng.random_range(600.0..1200.0);
            for value in &mut pixels.values {
                *value = 100.0 + gain * *value;
            }
            let rpc = parallel_camera(self.size, self.gsd_m, PLACE, *tilt);
            images.push(Image::new(format!("view_{view}"), pixels, rpc, date));
        }
        for image in &mut images {
            for value in &mut image.pixels.values {
                *value *= 1.0 + 0.01 * (rng.random_range(-1.0f32..1.0) + rng.random_range(-1.0f32..1.0));
            }
        }
        for image in &mut images {
            let mut error = || self.pointing_px * (0..3).map(|_| rng.random_range(-1.0..1.0)).sum::<f64>();
            image.rpc = image.rpc.cropped(error(), error());
        }
        images
    }
}

/// Dates of the images: each of its own day.
const DATES: [&str; 5] = [
    "20160423083400",
    "20160601084100",
    "20160815082900",
    "20161002083800",
    "20170312084500",
];

/// A date of Sat-NeRF as RFC 3339.
fn moment(date: &str) -> String {
    let part = |range: std::ops::Range<usize>| &date[range];
    format!(
        "{}-{}-{}T{}:{}:{}Z",
        part(0..4),
        part(4..6),
        part(6..8),
        part(8..10),
        part(10..12),
        part(12..14)
    )
}
