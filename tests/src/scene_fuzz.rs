//! Whole small scenes with random faults, whose surfaces are compared with the truth in units of their stated
//! deviations.
//!
//! A scene is a terrain of our own, or streets and trees of the generator, with none to three faults. The program may
//! refuse it, leave the ground unknown, or warn; a surface without a warning is to be right.

pub mod delivery;
pub mod faults;
mod synthetic;

use crate::terrain::TerrainRequest;
use delivery::{Scene, Truth};
use faults::Fault;
use heliosplat::Raster;
use heliosplat_fitting::settings::Preset;
use heliosplat_products::dsm::{Dsm, of_surface};
use heliosplat_products::nadir::GroundExtent;
use heliosplat_raster::geoid::Undulation;
use heliosplat_raster::{CrsTransform, Geoid};
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::preprocess::open_and_sweep;
use heliosplat_scene::{Index, IngestOptions};
use heliosplat_session::Session;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::fmt::Debug;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// Share of the known cells that may be wrong by more than four stated deviations.
const WRONG: f64 = 0.02;
/// Fewer known cells are too few for a share.
const FEWEST: usize = 100;
/// Distance from a step of the ground within which a wrong height counts apart, pixels.
const BESIDE_STEPS_PX: usize = 3;
/// Cells of a wrong surface on which a common translation is looked for.
const MOST_TRIED: usize = 400;

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

/// Warnings of scenes without faults: they are too small for many ties.
const USUAL: [&str; 2] = ["Too few tie points", "acquisition time"];

/// A known cell of a surface.
#[derive(Debug, Clone, Copy)]
pub struct Cell {
    /// Longitude and latitude, degrees.
    pub place_deg: [f64; 2],
    /// Height and its stated deviation, metres.
    pub height_m: [f32; 2],
    /// Probability of the height.
    pub probability: f32,
    /// Number of images that see it.
    pub views: f32,
    /// Error, metres.
    pub error_m: f32,
}

impl Cell {
    fn is_within(&self, deviations: f32) -> bool {
        self.error_m.abs() <= deviations * self.height_m[1]
    }
}

/// A surface compared with the truth.
#[derive(Debug, Clone)]
pub struct Compared {
    /// Its known cells.
    pub cells: Vec<Cell>,
    /// Share of the ground in two or more images that is known, 0 to 1.
    pub known: f64,
    /// Warnings of the program, without those that scenes without faults cause too.
    pub warnings: Vec<String>,
}

impl Compared {
    /// Share of the known cells whose error is within some standard deviations.
    pub fn within(&self, deviations: f32) -> f64 {
        let inside = self.cells.iter().filter(|cell| cell.is_within(deviations));
        inside.count() as f64 / self.cells.len().max(1) as f64
    }

    /// Mean absolute error, metres.
    pub fn mae_m(&self) -> f64 {
        let sum: f64 = self.cells.iter().map(|cell| f64::from(cell.error_m.abs())).sum();
        sum / self.cells.len().max(1) as f64
    }

    /// Median error, metres.
    pub fn median_m(&self) -> f32 {
        let mut errors: Vec<f32> = self.cells.iter().map(|cell| cell.error_m).collect();
        errors.sort_by(f32::total_cmp);
        errors.get(errors.len() / 2).copied().unwrap_or(f32::NAN)
    }

    fn is_wrong(&self) -> bool {
        1.0 - self.within(4.0) > WRONG
    }

    /// True if the errors are too many even where heights within some pixels of a step may be those of either side.
    fn is_wrong_off_steps(&self, truth: &Truth) -> bool {
        let is_off = |cell: &&Cell| {
            let error_m = truth.error_m(cell.place_deg, cell.height_m[0], BESIDE_STEPS_PX);
            !cell.is_within(4.0) && error_m.is_some_and(|error_m| !Cell { error_m, ..**cell }.is_within(4.0))
        };
        let off = self.cells.iter().filter(is_off).count();
        off as f64 > WRONG * self.cells.len() as f64
    }

    /// Moves the surface by the common translation of up to `most_m` metres that makes it agree best with the truth.
    fn align(&mut self, truth: &Truth, (most_m, step_m): (f64, f64)) {
        let steps = (most_m / step_m).ceil() as i32;
        let every = self.cells.len().div_ceil(MOST_TRIED).max(1);
        let tried: Vec<Cell> = self.cells.iter().copied().step_by(every).collect();
        let mut best = (tried.iter().filter(|cell| cell.is_within(4.0)).count(), [0.0; 3]);
        for (col, row) in (-steps..=steps).flat_map(|row| (-steps..=steps).map(move |col| (col, row))) {
            let by_m = [f64::from(col) * step_m, f64::from(row) * step_m];
            if by_m[0].hypot(by_m[1]) > most_m {
                continue;
            }
            let errors = |up_m: f32| tried.iter().filter_map(move |cell| moved(cell, truth, by_m, up_m));
            let mut sorted: Vec<f32> = errors(0.0).map(|cell| cell.error_m).collect();
            sorted.sort_by(f32::total_cmp);
            let Some(&middle) = sorted.get(sorted.len() / 2) else {
                continue;
            };
            let agreeing = errors(-middle).filter(|cell| cell.is_within(4.0)).count();
            if agreeing > best.0 {
                best = (agreeing, [by_m[0], by_m[1], f64::from(-middle)]);
            }
        }
        let [east, north, up] = best.1;
        let cells = self.cells.iter();
        self.cells = cells
            .filter_map(|cell| moved(cell, truth, [east, north], up as f32))
            .collect();
    }
}

/// A cell of a surface that is moved east, north and up, metres.
fn moved(cell: &Cell, truth: &Truth, [east_m, north_m]: [f64; 2], up_m: f32) -> Option<Cell> {
    let [longitude, latitude] = cell.place_deg;
    let per_degree = crate::scenes::METRES_PER_DEGREE;
    let longitude = longitude + east_m / per_degree / latitude.to_radians().cos();
    let mut moved = *cell;
    moved.place_deg = [longitude, latitude + north_m / per_degree];
    moved.height_m[0] += up_m;
    moved.error_m = truth.error_m(moved.place_deg, moved.height_m[0], 1)?;
    Some(moved)
}

/// Parameters of a scene.
#[derive(Debug, Clone)]
pub struct FuzzRequest {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Faults of the scene, in the order of [`Fault::ALL`].
    pub faults: Vec<Fault>,
}

/// Outcome of a scene.
#[derive(Debug)]
pub enum Outcome {
    /// The program refused it.
    Refused(String),
    /// Hardly any ground is known.
    Empty,
    /// The surface is right.
    Right(Compared),
    /// The surface is wrong beside steps only.
    Steps(Compared),
    /// The surface is wrong, and the program warned.
    Warned(Compared),
    /// The surface is wrong without a warning.
    Silent(Compared),
    /// The program panicked.
    Panicked,
}

impl FuzzRequest {
    /// Random faults: one scene in ten has none, the others one to three, and one in twenty a further one.
    pub fn of_seed(seed: u64) -> Self {
        let mut rng = Pcg32::seed_from_u64(seed ^ 0x5eed);
        let count = [0, 1, 1, 1, 1, 1, 2, 2, 2, 3][rng.random_range(0..10)];
        let mut faults: Vec<Fault> = (0..count)
            .map(|_| Fault::ALL[rng.random_range(0..Fault::ALL.len())])
            .collect();
        let mut apart = Pcg32::seed_from_u64(seed ^ 0xfee7);
        if apart.random_range(0..20) == 0 {
            faults.push(Fault::APART[apart.random_range(0..Fault::APART.len())]);
        }
        faults.sort();
        faults.dedup();
        Self { seed, faults }
    }

    /// Makes the scene.
    pub fn scene(&self) -> Scene {
        let mut rng = Pcg32::seed_from_u64(self.seed);
        let of_terrain = self.faults.iter().any(|fault| fault.is_of_terrain());
        let mut scene = match of_terrain || rng.random_range(0..3) > 0 {
            true => {
                let gsd_m = 0.3 * (2.0f64 / 0.3).powf(rng.random_range(0.0..1.0));
                let mut request = TerrainRequest {
                    views: rng.random_range(3..6),
                    size: [56, 64, 72, 80][rng.random_range(0..4)],
                    gsd_m,
                    hills_m: 1.5 * gsd_m / 0.5,
                    ..TerrainRequest::new(self.seed)
                };
                self.faults.iter().for_each(|fault| fault.ask(&mut request, &mut rng));
                let mut scene = request.scene();
                add_bands(&mut scene, &mut rng);
                scene
            }
            false => synthetic::scene(&mut rng),
        };
        // From the ground to the cameras: water lies where the right cameras see it.
        for fault in self.faults.iter().rev() {
            fault.apply(&mut scene, &mut rng);
        }
        scene
    }

    /// Makes the scene in a folder, sweeps it and compares the surface with the truth.
    pub fn outcome(&self, folder: &Path) -> Outcome {
        let scene = self.scene();
        scene.write(folder);
        let heard = Warnings::default();
        let swept = || tracing::subscriber::with_default(heard.clone(), || compared(&scene, folder));
        let Ok(swept) = catch_unwind(AssertUnwindSafe(swept)) else {
            return Outcome::Panicked;
        };
        let mut found = match swept {
            Ok(found) => found,
            Err(reason) => return Outcome::Refused(reason),
        };
        found.warnings = heard.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        found
            .warnings
            .retain(|warning| !USUAL.iter().any(|usual| warning.contains(usual)));
        if found.is_wrong() && scene.datum_px > 0.0 {
            found.align(&scene.truth, (scene.datum_px.min(40.0) * scene.gsd_m, scene.gsd_m));
        }
        match (found.cells.len() < FEWEST, found.is_wrong(), found.warnings.is_empty()) {
            (true, ..) => Outcome::Empty,
            (_, false, _) => Outcome::Right(found),
            (_, true, _) if !found.is_wrong_off_steps(&scene.truth) => Outcome::Steps(found),
            (_, true, false) => Outcome::Warned(found),
            (_, true, true) => Outcome::Silent(found),
        }
    }
}

/// Gives some scenes three or four bands of unlike contrast.
fn add_bands(scene: &mut Scene, rng: &mut Pcg32) {
    let bands = [1, 1, 1, 3, 4][rng.random_range(0..5)];
    let gains: Vec<f32> = (0..bands).map(|_| rng.random_range(0.6..1.4)).collect();
    for image in scene.images.iter_mut().filter(|_| bands > 1) {
        let grey = &image.pixels;
        let mut pixels = Raster::filled(grey.width, grey.height, bands, 0.0);
        for (band, gain) in gains.iter().enumerate() {
            for (value, grey) in pixels.plane_mut(band).iter_mut().zip(&grey.values) {
                *value = gain * grey * rng.random_range(0.99..1.01);
            }
        }
        image.pixels = pixels;
        let names = ["red", "green", "blue", "near_infrared"];
        image.band_names = names[..bands].iter().map(|name| (*name).to_owned()).collect();
    }
}

/// Sweeps a written scene, and compares the surface with the truth.
///
/// # Errors
/// The message of the program where it refuses the scene.
pub fn compared(scene: &Scene, folder: &Path) -> Result<Compared, String> {
    let options = IngestOptions {
        altitude_range_m: scene.stated_m,
        ..IngestOptions::default()
    };
    let config = SatelliteConfig::resolve(Preset::Fast, &[], 1).map_err(|error| error.to_string())?;
    let index = Index::open(folder, options.rpc).map_err(|error| error.to_string())?;
    let swept = open_and_sweep(&index, &options, &config, &Session::quiet());
    let (found, surface) = swept.map_err(|error| error.to_string())?;
    // A vertical part is split off as the program does.
    let definition = scene.crs.as_deref().map(Geoid::of_definition).transpose();
    let geoid = definition
        .map_err(|error| error.to_string())?
        .and_then(|(_, geoid)| geoid);
    let crs = scene.crs.as_deref().and_then(|crs| crs.split('+').next());
    let dsm = of_surface(&GroundExtent::from(&found), &surface, found.gsd_m, crs);
    let dsm = dsm.and_then(|dsm| match geoid {
        Some(geoid) => dsm.above(geoid),
        None => Ok(dsm),
    });
    let dsm = dsm.map_err(|error| error.to_string())?;
    let seen = surface.views.iter().filter(|&&views| views >= 2).count();
    Ok(Compared {
        cells: cells(&dsm, &scene.truth)?,
        known: (0..surface.altitude.len())
            .filter(|&cell| surface.is_known(cell))
            .count() as f64
            / seen.max(1) as f64,
        warnings: Vec::new(),
    })
}

fn cells(dsm: &Dsm, truth: &Truth) -> Result<Vec<Cell>, String> {
    let to_lon_lat = CrsTransform::to_lon_lat(&dsm.grid.crs).expect("a coordinate system");
    let geoid = dsm.geoid.map(Undulation::new).transpose();
    let geoid = geoid.map_err(|error| error.to_string())?;
    let known = (0..dsm.raster.plane_len()).filter(|&cell| !dsm.raster.plane(0)[cell].is_nan());
    let of_cell = |cell: usize| {
        let (col, row) = (cell % dsm.raster.width, cell / dsm.raster.width);
        let [x, y] = dsm.grid.transform.map_from_pixel(col as f64, row as f64);
        let (longitude, latitude) = to_lon_lat.apply(x, y).ok()?;
        let [mut height, deviation, probability, views] = [0, 1, 2, 3].map(|band| dsm.raster.plane(band)[cell]);
        if let Some(geoid) = &geoid {
            height += geoid.at(longitude, latitude).ok()? as f32;
        }
        Some(Cell {
            place_deg: [longitude, latitude],
            height_m: [height, deviation],
            probability,
            views,
            error_m: truth.error_m([longitude, latitude], height, 1)?,
        })
    };
    Ok(known.filter_map(of_cell).collect())
}
