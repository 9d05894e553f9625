//! Small scenes of a terrain with known heights and deliberate faults, made by a plain renderer with exact parallel
//! cameras.
//!
//! The terrain is a slope with some buildings, of random albedo, under the sun of each date with cast shadows. Heights
//! are known at each cell of a quarter of a metre, so that the errors of a surface can be compared with its standard
//! deviations.

use super::scenes::{METRES_PER_DEGREE, parallel_camera};
use heliosplat::Raster;
use heliosplat_fitting::settings::Preset;
use heliosplat_products::dsm::{Dsm, of_surface};
use heliosplat_products::nadir::GroundExtent;
use heliosplat_raster::{CrsTransform, ImageSpec, SampleType, write_geotiff};
use heliosplat_rpc::sun::sun_position;
use heliosplat_rpc::{GeoPoint, Rpc, write};
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::preprocess::open_and_sweep;
use heliosplat_scene::{Index, IngestOptions};
use heliosplat_session::Session;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::fmt::Debug;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// Longitude and latitude of the terrain, degrees, and altitude of its middle, metres.
const PLACE: [f64; 2] = [36.91, 37.58];
const GROUND_M: f64 = 700.0;
/// Width of a cell of the terrain, metres, and cells each way.
const CELL_M: f64 = 0.25;
const CELLS: usize = 288;
/// Ground sampling distance of the images, metres.
const GSD_M: f64 = 0.5;
/// Samples of a pixel each way.
const SAMPLES: usize = 2;

/// Fault or difficulty of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// No fault.
    None,
    /// The pointing of one camera is wrong by tens of pixels.
    Pointing,
    /// One camera belongs to an image of half the resolution.
    Halved,
    /// One camera counts its rows from below.
    Mirrored,
    /// Two images have each other's cameras.
    Swapped,
    /// All images are one image and its camera.
    OneImage,
    /// Two images show the same pixels, under their own cameras.
    SamePixels,
    /// One image exists twice.
    Copied,
    /// All images look from nearly the same direction.
    NoBase,
    /// Images have collars of zeros that nothing declares.
    BlackCollar,
    /// Images have collars of noise that nothing declares.
    NoiseCollar,
    /// Images have collars of one bright value that nothing declares.
    WhiteCollar,
    /// A building stands in some of the images only.
    Change,
    /// One image is a negative.
    Negative,
    /// A part of the ground looks different in each image, as water does.
    Water,
    /// Bright blobs hide parts of some images.
    Clouds,
    /// The stated altitudes exclude the ground, or a part of it.
    Altitudes,
    /// Half of the ground repeats itself, as orchards and parking places do.
    Periodic,
    /// A tower of 20 to 40 m stands in the scene.
    Tower,
    /// Each image has a date that is not its own.
    Dates,
    /// A part of each image is saturated.
    Saturated,
    /// The pixels of one image are of another place.
    OtherPlace,
    /// One image is noisier than its texture.
    Noise,
}

impl Fault {
    /// All faults.
    pub const ALL: [Self; 23] = [
        Self::None,
        Self::Pointing,
        Self::Halved,
        Self::Mirrored,
        Self::Swapped,
        Self::OneImage,
        Self::SamePixels,
        Self::Copied,
        Self::NoBase,
        Self::BlackCollar,
        Self::NoiseCollar,
        Self::WhiteCollar,
        Self::Change,
        Self::Negative,
        Self::Water,
        Self::Clouds,
        Self::Altitudes,
        Self::Periodic,
        Self::Tower,
        Self::Dates,
        Self::Saturated,
        Self::OtherPlace,
        Self::Noise,
    ];
}

/// Heights and albedo.
#[derive(Clone)]
struct Terrain {
    height_m: Vec<f32>,
    albedo: Vec<f32>,
    low_m: f32,
    high_m: f32,
}

/// The cell of a place, metres east and north of the middle; the nearest one beyond the edge.
fn cell_of(x_m: f64, y_m: f64) -> usize {
    let at = |v: f64| ((v / CELL_M) + CELLS as f64 / 2.0).clamp(0.0, CELLS as f64 - 1.0) as usize;
    at(-y_m) * CELLS + at(x_m)
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
    fn new(rng: &mut Pcg32, faults: &[Fault]) -> Self {
        let slope: [f32; 2] = [rng.random_range(-0.08..0.08), rng.random_range(-0.08..0.08)];
        let hills = noise(rng, 96);
        let mut height_m: Vec<f32> = (0..CELLS * CELLS)
            .map(|i| {
                let [x, y] = [i % CELLS, i / CELLS].map(|v| (v as f32 - CELLS as f32 / 2.0) * CELL_M as f32);
                GROUND_M as f32 + slope[0] * x - slope[1] * y + 1.5 * hills[i]
            })
            .collect();
        let mut albedo = vec![0.5f32; CELLS * CELLS];
        for (wavelength, strength) in [(2, 0.12), (4, 0.12), (10, 0.10), (24, 0.10)] {
            for (albedo, noise) in albedo.iter_mut().zip(noise(rng, wavelength)) {
                *albedo += strength * noise;
            }
        }
        if faults.contains(&Fault::Periodic) {
            let period = rng.random_range(8..28usize);
            for i in (0..CELLS * CELLS).filter(|i| i % CELLS > CELLS / 2) {
                let is_dark = (i % CELLS) % period < period / 2 && (i / CELLS) % period < period / 2;
                albedo[i] = if is_dark { 0.25 } else { 0.6 };
            }
        }
        let buildings = rng.random_range(1..5);
        for _ in 0..buildings {
            let size: [usize; 2] = [rng.random_range(20..56), rng.random_range(20..56)];
            let tall = rng.random_range(3.0..12.0);
            raise(rng, &mut height_m, &mut albedo, size, tall);
        }
        if faults.contains(&Fault::Tower) {
            let tall = rng.random_range(20.0..40.0);
            raise(rng, &mut height_m, &mut albedo, [28, 28], tall);
        }
        let mut terrain = Self {
            height_m,
            albedo,
            low_m: 0.0,
            high_m: 0.0,
        };
        terrain.limit();
        terrain
    }

    fn limit(&mut self) {
        self.low_m = self.height_m.iter().copied().fold(f32::MAX, f32::min);
        self.high_m = self.height_m.iter().copied().fold(f32::MIN, f32::max);
    }

    /// The lowest and highest height within half a metre of a place.
    fn heights_around(&self, x_m: f64, y_m: f64) -> (f32, f32) {
        let (mut low, mut high) = (f32::MAX, f32::MIN);
        for step in 0..25 {
            let [dx, dy] = [step % 5, step / 5].map(|s| (f64::from(s) - 2.0) * CELL_M);
            let height = self.height_m[cell_of(x_m + dx, y_m + dy)];
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
            east / level * CELL_M,
            north / level * CELL_M,
            (up / level * CELL_M) as f32,
        );
        let of = |i: usize| {
            let [col, row] = [i % CELLS, i / CELLS].map(|v| v as f64 - CELLS as f64 / 2.0 + 0.5);
            let (x, y) = (col * CELL_M, -row * CELL_M);
            let mut ray = self.height_m[i] + 0.05;
            let mut steps = 0.0;
            while ray < self.high_m {
                steps += 1.0;
                ray += rise;
                if self.height_m[cell_of(x + steps * dx, y + steps * dy)] > ray {
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
        let middle = (size as f64 - 1.0) / 2.0;
        for (index, value) in raster.values.iter_mut().enumerate() {
            for sample in 0..SAMPLES * SAMPLES {
                let inside = |s: usize| (s as f64 + 0.5) / SAMPLES as f64 - 0.5;
                let x = ((index % size) as f64 - middle + inside(sample % SAMPLES)) * GSD_M;
                let y = -((index / size) as f64 - middle + inside(sample / SAMPLES)) * GSD_M;
                let mut height = f64::from(self.high_m);
                let hit = loop {
                    let above = height - GROUND_M;
                    let cell = cell_of(x - tilt[0] * above, y - tilt[1] * above);
                    if f64::from(self.height_m[cell]) >= height || height < f64::from(self.low_m) {
                        break cell;
                    }
                    height -= 0.2;
                };
                *value += lit[hit] / (SAMPLES * SAMPLES) as f32;
            }
        }
        raster
    }
}

/// Adds a building of `wide` by `high` cells, `tall` metres above the ground, at a random place.
fn raise(rng: &mut Pcg32, height_m: &mut [f32], albedo: &mut [f32], [wide, high]: [usize; 2], tall: f32) {
    let margin = CELLS / 4;
    let col0 = rng.random_range(margin..CELLS - margin - wide);
    let row0 = rng.random_range(margin..CELLS - margin - high);
    let roof = height_m[(row0 + high / 2) * CELLS + col0 + wide / 2] + tall;
    let shade: f32 = rng.random_range(-0.2..0.3);
    for row in row0..row0 + high {
        for col in col0..col0 + wide {
            let cell = row * CELLS + col;
            height_m[cell] = height_m[cell].max(roof);
            albedo[cell] = (albedo[cell] + shade).clamp(0.1, 0.95);
        }
    }
}

/// Parameters of a scene.
#[derive(Debug, Clone)]
pub struct SceneRequest {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of images.
    pub views: usize,
    /// Width and height of the images, pixels.
    pub size: usize,
    /// Faults of the scene.
    pub faults: Vec<Fault>,
    /// Angle between the outermost images, degrees; drawn where `None`.
    pub convergence_deg: Option<f64>,
    /// Random error of each camera, pixels: one standard deviation in each axis.
    pub pointing_px: f64,
}

impl SceneRequest {
    /// Random request: three to five images with up to two faults.
    pub fn of_seed(seed: u64) -> Self {
        let mut rng = Pcg32::seed_from_u64(seed ^ 0x5eed);
        let mut faults: Vec<Fault> = (0..rng.random_range(0..3))
            .map(|_| Fault::ALL[rng.random_range(0..Fault::ALL.len())])
            .collect();
        faults.dedup();
        Self {
            seed,
            views: rng.random_range(3..6),
            size: [48, 56, 64][rng.random_range(0..3usize)],
            faults,
            convergence_deg: None,
            pointing_px: 0.1,
        }
    }

    fn has(&self, fault: Fault) -> bool {
        self.faults.contains(&fault)
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

/// Collects the warnings of one thread.
#[derive(Clone, Default)]
struct Warnings(Arc<Mutex<Vec<String>>>);

impl Subscriber for Warnings {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        *metadata.level() <= Level::WARN
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        event.record(&mut self.clone());
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

impl Visit for Warnings {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            all.push(format!("{value:?}"));
        }
    }
}

/// Errors of a surface against the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Compared {
    /// Number of known cells.
    pub known: usize,
    /// Shares of them whose error is within one, two and four standard deviations.
    pub within: [f64; 3],
    /// Mean absolute error, metres.
    pub mae_m: f64,
    /// Median of the signed errors, metres.
    pub median_m: f64,
    /// Warnings of the program, without those that scenes without faults cause too.
    pub warnings: Vec<String>,
}

/// Makes a scene in a folder, sweeps it, and compares the surface with the truth.
///
/// # Errors
/// The message of the program where it refuses the scene.
pub fn made_and_swept(request: &SceneRequest, folder: &Path) -> Result<Compared, String> {
    let heard = Warnings::default();
    let swept = tracing::subscriber::with_default(heard.clone(), || swept(request, folder));
    let mut found = swept?;
    let heard = heard.0.lock().unwrap_or_else(PoisonError::into_inner);
    found.warnings.extend(heard.iter().cloned());
    found
        .warnings
        .retain(|warning| !USUAL.iter().any(|usual| warning.contains(usual)));
    Ok(found)
}

/// Warnings of scenes without faults: they are too small for many ties.
const USUAL: [&str; 2] = ["Too few tie points", "acquisition time"];

fn swept(request: &SceneRequest, folder: &Path) -> Result<Compared, String> {
    let mut rng = Pcg32::seed_from_u64(request.seed);
    let terrain = Terrain::new(&mut rng, &request.faults);
    let mut other = terrain.clone();
    if request.has(Fault::Change) {
        let tall = rng.random_range(4.0..12.0);
        raise(&mut rng, &mut other.height_m, &mut other.albedo, [40, 40], tall);
        other.limit();
    }
    let stated_m = write_scene(request, (&terrain, &other), &mut rng, folder);
    let options = IngestOptions {
        altitude_range_m: Some(stated_m),
        ..IngestOptions::default()
    };
    let config = SatelliteConfig::resolve(Preset::Fast, &[], 1).map_err(|error| error.to_string())?;
    let index = Index::open(folder, options.rpc).map_err(|error| error.to_string())?;
    let swept = open_and_sweep(&index, &options, &config, &Session::quiet());
    let (scene, surface) = swept.map_err(|error| error.to_string())?;
    let dsm = of_surface(&GroundExtent::from(&scene), &surface, GSD_M, None).map_err(|error| error.to_string())?;
    Ok(compare(&dsm, &[&terrain, &other], scene.warnings))
}

/// Compares a surface with the truth. On changed ground both terrains count as true: few images do not determine the
/// later one.
fn compare(dsm: &Dsm, terrains: &[&Terrain; 2], warnings: Vec<String>) -> Compared {
    let to_lon_lat = CrsTransform::to_lon_lat(&dsm.grid.crs).expect("a coordinate system");
    let per_longitude = METRES_PER_DEGREE * PLACE[1].to_radians().cos();
    let mut errors: Vec<[f32; 2]> = Vec::new();
    for cell in 0..dsm.raster.plane_len() {
        let (altitude, deviation) = (dsm.raster.plane(0)[cell], dsm.raster.plane(1)[cell]);
        if altitude.is_nan() {
            continue;
        }
        let (col, row) = (cell % dsm.raster.width, cell / dsm.raster.width);
        let [x, y] = dsm.grid.transform.map_from_pixel(col as f64, row as f64);
        let (lon, lat) = to_lon_lat.apply(x, y).expect("inside");
        let (east, north) = ((lon - PLACE[0]) * per_longitude, (lat - PLACE[1]) * METRES_PER_DEGREE);
        let error_of = |terrain: &&Terrain| {
            let (low, high) = terrain.heights_around(east, north);
            altitude - altitude.clamp(low, high)
        };
        let [error, of_other] = terrains.map(|terrain| error_of(&terrain));
        let error = if of_other.abs() < error.abs() { of_other } else { error };
        if error.abs() > 4.0 * deviation && std::env::var_os("HELIOSPLAT_SCENES_CELLS").is_some() {
            let [coverage, views] = [2, 3].map(|band| dsm.raster.plane(band)[cell]);
            println!("{col} {row}: {altitude:.1} is off by {error:.1} ± {deviation:.2}, {coverage:.2}, {views} views");
        }
        errors.push([error, deviation]);
    }
    let known = errors.len();
    let share = |times: f32| {
        let inside = errors
            .iter()
            .filter(|[error, deviation]| error.abs() <= times * deviation);
        inside.count() as f64 / known.max(1) as f64
    };
    let mut sorted: Vec<f32> = errors.iter().map(|[error, _]| *error).collect();
    sorted.sort_by(f32::total_cmp);
    Compared {
        known,
        within: [share(1.0), share(2.0), share(4.0)],
        mae_m: sorted.iter().map(|error| f64::from(error.abs())).sum::<f64>() / known.max(1) as f64,
        median_m: sorted.get(known / 2).copied().map_or(f64::NAN, f64::from),
        warnings,
    }
}

/// Writes the images; returns the altitudes that are stated, metres.
fn write_scene(
    request: &SceneRequest,
    (terrain, other): (&Terrain, &Terrain),
    rng: &mut Pcg32,
    folder: &Path,
) -> (f64, f64) {
    let (views, size) = (request.views, request.size);
    let spread = match request.convergence_deg {
        Some(degrees) => degrees.to_radians().tan(),
        None if request.has(Fault::NoBase) => rng.random_range(0.0..0.03),
        None => rng.random_range(0.2..0.7),
    };
    let turn: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let lean: [f64; 2] = [rng.random_range(-0.15..0.15), rng.random_range(-0.15..0.15)];
    let mut tilts: Vec<[f64; 2]> = (0..views)
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
    if request.has(Fault::OneImage) {
        tilts = vec![tilts[0]; views];
    }
    // The order of the dates is not that of the directions, or shadows would move as the ground does.
    let first_date = rng.random_range(0..5);
    let date_of = |view: usize| DATES[(first_date + 2 * view) % 5];
    let place = GeoPoint {
        lon_deg: PLACE[0],
        lat_deg: PLACE[1],
        height_m: GROUND_M,
    };
    let mut images: Vec<Raster> = (0..views)
        .map(|view| {
            let shown = if view < views / 2 { other } else { terrain };
            let time: jiff::Timestamp = moment(date_of(view)).parse().expect("a time");
            let toward = sun_position(time, place).direction_enu();
            let lit = shown.lit(Some([toward.x, toward.y, toward.z]));
            let mut image = shown.image(&lit, size, tilts[view]);
            let gain = rng.random_range(600.0..1200.0);
            image.values.iter_mut().for_each(|value| *value = 100.0 + gain * *value);
            image
        })
        .collect();
    if request.has(Fault::OneImage) {
        images = vec![images[views - 1].clone(); views];
    }
    spoil(request, &mut images, &mut tilts, rng);
    for image in &mut images {
        for value in &mut image.values {
            *value *= 1.0 + 0.01 * (rng.random_range(-1.0f32..1.0) + rng.random_range(-1.0f32..1.0));
        }
    }
    if request.has(Fault::OneImage) {
        images = vec![images[0].clone(); views];
    }
    collars(request, &mut images, rng);
    let mut cameras: Vec<Rpc> = tilts
        .iter()
        .map(|tilt| {
            let rpc = parallel_camera(size, GSD_M, PLACE, *tilt);
            let error = |rng: &mut Pcg32| {
                let sum: f64 = (0..3).map(|_| rng.random_range(-1.0..1.0)).sum();
                request.pointing_px * sum
            };
            rpc.cropped(error(rng), error(rng))
        })
        .collect();
    misplace(request, &mut cameras, rng);
    for (view, (image, rpc)) in images.iter().zip(&cameras).enumerate() {
        let date = if request.has(Fault::Dates) {
            date_of(view + 1)
        } else {
            date_of(view)
        };
        write_view(folder, &format!("view_{view}"), image, rpc, date);
    }
    if request.has(Fault::Copied) {
        write_view(folder, "view_0_copy", &images[0], &cameras[0], date_of(0));
    }
    let (low, high) = (f64::from(terrain.low_m), f64::from(terrain.high_m.max(other.high_m)));
    match request.has(Fault::Altitudes) {
        true => {
            let by = rng.random_range(-40.0..40.0);
            (low - 10.0 + by, high + 10.0 + by)
        }
        false => (low - rng.random_range(5.0..40.0), high + rng.random_range(5.0..40.0)),
    }
}

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

/// Faults of pixels.
fn spoil(request: &SceneRequest, images: &mut [Raster], tilts: &mut [[f64; 2]], rng: &mut Pcg32) {
    let size = request.size;
    let one = rng.random_range(0..images.len());
    let next = (one + 1) % images.len();
    for fault in &request.faults {
        match fault {
            Fault::SamePixels => images[one] = images[next].clone(),
            Fault::Negative => images[one].values.iter_mut().for_each(|value| *value = 1400.0 - *value),
            Fault::OtherPlace => images[one].values.rotate_left(size * size / 2 + 17),
            Fault::Noise => {
                let values = images[one].values.iter_mut();
                values.for_each(|value| *value += rng.random_range(-400.0..400.0));
            }
            Fault::Water => {
                for (image, tilt) in images.iter_mut().zip(tilts.iter()) {
                    // The water is at the same ground in every image.
                    let moved = (tilt[0] * 2.0 / GSD_M) as isize;
                    for index in (0..size * size).filter(|i| ((i % size) as isize - moved) < size as isize / 3) {
                        image.values[index] = 200.0 + rng.random_range(-20.0..20.0);
                    }
                }
            }
            Fault::Clouds => {
                for image in images.iter_mut().take(2) {
                    let [x, y]: [usize; 2] = [rng.random_range(0..size), rng.random_range(0..size)];
                    let radius = rng.random_range(6.0..16.0);
                    for index in 0..size * size {
                        let (dx, dy) = ((index % size) as f64 - x as f64, (index / size) as f64 - y as f64);
                        if dx.hypot(dy) < radius {
                            image.values[index] = 1900.0 + rng.random_range(-60.0..60.0);
                        }
                    }
                }
            }
            Fault::Saturated => {
                let limit = rng.random_range(350.0..600.0);
                let values = images.iter_mut().flat_map(|image| &mut image.values);
                values.for_each(|value| *value = value.min(limit));
            }
            _ => {}
        }
    }
}

/// Fills a wedge of each image, at another angle each, with a collar: pixels without ground.
fn collars(request: &SceneRequest, images: &mut [Raster], rng: &mut Pcg32) {
    let size = request.size as f64;
    let fill = |fault: &Fault| match fault {
        Fault::BlackCollar => Some(0.0),
        Fault::WhiteCollar => Some(60_000.0),
        Fault::NoiseCollar => Some(f32::NAN),
        _ => None,
    };
    let Some(fill) = request.faults.iter().find_map(fill) else {
        return;
    };
    for image in images {
        let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
        let (sin, cos) = angle.sin_cos();
        let limit = size * rng.random_range(0.15..0.4);
        for index in 0..image.values.len() {
            let (x, y) = (
                (index % request.size) as f64 - size / 2.0,
                (index / request.size) as f64 - size / 2.0,
            );
            if x * cos + y * sin > limit {
                image.values[index] = if fill.is_nan() {
                    rng.random_range(100.0..1100.0)
                } else {
                    fill
                };
            }
        }
    }
}

/// Faults of cameras.
fn misplace(request: &SceneRequest, cameras: &mut [Rpc], rng: &mut Pcg32) {
    let one = rng.random_range(0..cameras.len());
    for fault in &request.faults {
        match fault {
            Fault::Pointing => {
                let by = |rng: &mut Pcg32| -> f64 {
                    let far = rng.random_range(10.0..40.0);
                    if rng.random_range(0..2) == 0 { far } else { -far }
                };
                cameras[one] = cameras[one].cropped(by(rng), by(rng));
            }
            Fault::Halved => {
                let rpc = &mut cameras[one];
                rpc.sample_offset /= 2.0;
                rpc.line_offset /= 2.0;
                rpc.sample_scale /= 2.0;
                rpc.line_scale /= 2.0;
            }
            Fault::Mirrored => {
                let rpc = &mut cameras[one];
                rpc.line_numerator
                    .iter_mut()
                    .for_each(|coefficient| *coefficient = -*coefficient);
            }
            Fault::Swapped => {
                let next = (one + 1) % cameras.len();
                cameras.swap(one, next);
            }
            _ => {}
        }
    }
}

fn write_view(folder: &Path, name: &str, image: &Raster, rpc: &Rpc, date: &str) {
    let rpc: Vec<(String, String)> = write::gdal_domain(rpc).into_iter().collect();
    let spec = ImageSpec {
        rpc: &rpc,
        ..ImageSpec::plain(image)
    };
    let path = folder.join(format!("{name}.tif"));
    write_geotiff(&path, &spec, SampleType::U16).expect("the image is written");
    let text = format!("{{\"img\": \"{name}.tif\", \"acquisition_date\": \"{date}\"}}");
    std::fs::write(path.with_extension("json"), text).expect("the JSON is written");
}
