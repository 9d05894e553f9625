//! What a training will take, before it begins: memory and time.
//!
//! The constants of memory were fitted to runs on `block` and a town (0.17 to 0.62 million Gaussians), those of time, on one core, to runs
//! of all presets on `block` 31 and of short ones on `tiny`, `town` and `city` (docs/lab/speed.md); `metrics.json` keeps the estimates
//! beside what was used.

use super::config::{ModelOptions, SatelliteConfig};
use super::error::FitError;
use super::ground;
use super::sweep_memory::search_bytes;
use super::trial::WORTH_STEPS;
use heliosplat::bench_fixture::{Descent, Lighting, Site};
use heliosplat::shade::sh::functions;
use heliosplat::timeline;
use heliosplat::trace::transmittance;
use heliosplat::train::TrainOptions;
use heliosplat_scene::crop;
use heliosplat_scene::survey::Survey;
use heliosplat_scene::{Area, Scene, SceneImage};
use heliosplat_stereo::height_levels;
use std::time::{Duration, Instant};

pub use super::sweep_memory::PROGRAM_BYTES;

/// Gaussians per cell of the ground grid, for times: walls and doubtful ground add to one each (1.3 to 2.3 were seen).
const GAUSSIANS_PER_CELL: f64 = 1.55;
/// The same for memory, which is to suffice.
const MANY_GAUSSIANS_PER_CELL: f64 = 1.8;
/// Tables of all parameters that training holds: values, gradients, two moments, the best state.
const TABLES: f64 = 5.0;
/// Bytes per Gaussian of what one step makes besides: splats, lists of tiles, gradients, ellipses on the plane of the sun,
/// neighbours.
const STEP_BYTES_PER_GAUSSIAN: f64 = 580.0;
/// What the allocator keeps at hand, bytes.
const SPARE_BYTES: f64 = 64.0 * 1_048_576.0;
/// Planes of 32-bit numbers per pixel of the largest view that one step makes, besides those per channel.
const PLANES: f64 = 24.0;
/// The same per channel.
const PLANES_PER_CHANNEL: f64 = 4.0;
/// Seconds before the first step per cell that an image shows and other image: search, start, colours.
const START_S_PER_CELL: f64 = 2.05e-5;
/// Seconds before the first step per image: reading, ties.
const START_S_PER_VIEW: f64 = 0.26;
/// Seconds per Gaussian and step, without light.
const STEP_S_PER_GAUSSIAN: f64 = 5.5e-7;
/// Seconds per Gaussian that an image shows to trace light once, with gradients.
const TRACE_S_PER_GAUSSIAN: f64 = 1.25e-6;
/// The same for shadow consistency.
const CONSISTENCY_S_PER_GAUSSIAN: f64 = 6.3e-7;
/// Seconds after training per Gaussian that an image shows and image, and as much again for those trained on: albedo, evaluation.
const VIEW_S_PER_GAUSSIAN: f64 = 1.53e-6;
/// The same per pixel.
const VIEW_S_PER_PIXEL: f64 = 2.5e-6;
/// Seconds per Gaussian for products and report.
const PRODUCT_S_PER_GAUSSIAN: f64 = 3.2e-6;
/// What the planner's short fits take, in steps of the training (21 to 40 were seen).
const TRIALS_AS_STEPS: f64 = 30.0;
/// Seconds of one step of the small site, and of its light, on a core of the machine that the seconds above were measured on.
const REFERENCE_S: f64 = 0.037;
/// Cores that are measured, at most.
const MOST_CORES: usize = 4;
/// How often each is, at least.
const FEWEST_OF_A_CORE: usize = 2;
/// How long the machine's speed is measured, at least and at most.
const BRIEFLY: Duration = Duration::from_millis(350);
const AT_LENGTH: Duration = Duration::from_secs(5);
/// How long it is measured where that is all that will be known of it, in times of a run.
const MEASURED_SHARE: f64 = 0.2;
/// Share of the steps after which a state can be the best, from which on epochs without progress count (`src/train/holdout.rs`).
const KEPT_FROM: f64 = 0.25;
/// Most time for the search for suns, in times before the first step (1.4 to 3.4 were seen where short fits were made).
const SUNS_AS_STARTS: f64 = 3.4;
/// Share of a view's Gaussians whose light hardly matters to it (0.24 to 0.42 were seen, docs/lab/speed.md).
const NEGLIGIBLE_SHARE: f64 = 0.33;
/// Share of the time on one core that more of them do not shorten (0.05 to 0.08 were seen on 4 to 16 threads).
const ONE_CORE_SHARE: f64 = 0.08;

/// What a run will take.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Estimate {
    /// Gaussians at the start.
    pub gaussians: f64,
    /// Most memory, bytes.
    pub peak_bytes: f64,
    /// The same if there were one Gaussian per cell and no more.
    pub least_bytes: f64,
    /// Steps.
    pub steps: usize,
    /// Seconds before the first step.
    pub start_s: f64,
    /// Seconds in all, with all steps.
    pub seconds: f64,
    /// Whether training may stop before its last step, where held-out tiles say so: then `seconds` is the most.
    #[serde(default)]
    pub at_most: bool,
    /// Seconds more, at most, to search for suns that are unknown: searches, short fits and further sweeps; 0 where all are known.
    #[serde(default)]
    pub suns_s: f64,
}

impl Estimate {
    /// How long it will take, in words.
    pub fn time_in_words(&self) -> String {
        let most = if self.at_most { "at most " } else { "" };
        let suns = match self.suns_s > 0.0 {
            true => format!(", and up to {:.0} s more to find unknown suns", self.suns_s),
            false => String::new(),
        };
        format!("{most}{:.0} s{suns}", self.seconds)
    }

    /// Seconds in all, once the start is over: it took `start_s` seconds, from which the speed of the machine is known, and the search for
    /// suns `suns_s` more.
    pub fn seconds_after_start(&self, start_s: f64, suns_s: f64) -> f64 {
        start_s + suns_s + (self.seconds - self.start_s) * start_s / self.start_s
    }
}

/// How fast this machine is, on the threads that it is given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Speed {
    /// How much slower it is than one core of the machine the constants are from.
    pub slowness: f64,
    /// By how much the time of a fixed piece of work varies, some 50 ms on one core: one standard deviation, relative to the mean.
    pub varies_by: f64,
}

/// How much slower this machine is, measured in half a second.
pub fn slowness() -> f64 {
    measured_speed(BRIEFLY).slowness
}

/// The speed of this machine, measured for longer where runs are longer, up to five seconds: `run_s` are the seconds that one takes on a
/// machine of a slowness.
pub fn speed_for(run_s: impl Fn(f64) -> f64) -> Speed {
    let speed = measured_speed(BRIEFLY);
    let wanted = Duration::try_from_secs_f64(MEASURED_SHARE * run_s(speed.slowness)).unwrap_or(AT_LENGTH);
    if wanted <= BRIEFLY {
        return speed;
    }
    let wanted = wanted.min(AT_LENGTH);
    tracing::info!("measuring the speed of this machine for {:.1} s", wanted.as_secs_f64());
    measured_speed(wanted)
}

/// Single cores are measured, since work small enough to be measured quickly is too small for many. What else the machine does, and how
/// fast its processors run meanwhile, slow a training down in the mean: so this is one.
fn measured_speed(measured: Duration) -> Speed {
    let threads = rayon::current_num_threads();
    let share = ONE_CORE_SHARE + (1.0 - ONE_CORE_SHARE) / threads as f64;
    let on_a_core = || {
        let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().ok()?;
        Some(one_thread.install(|| one_core_seconds(measured)))
    };
    let on_all = || {
        std::thread::scope(|scope| {
            let cores: Vec<_> = (0..threads.min(MOST_CORES)).map(|_| scope.spawn(on_a_core)).collect();
            let measured = cores.into_iter().filter_map(|core| core.join().ok().flatten());
            measured.flatten().collect::<Vec<f64>>()
        })
    };
    let seconds = match threads {
        // The leading thread waits for one other: work on one core, as the timeline counts it.
        1 => timeline::beside(on_all, || ()).0,
        _ => on_all(),
    };
    // None where no thread could be had: then nothing is known.
    let count = seconds.len().max(1) as f64;
    let mean = seconds.iter().sum::<f64>() / count;
    let variance = seconds.iter().map(|seconds| (seconds - mean).powi(2)).sum::<f64>() / count;
    Speed {
        slowness: share * if mean > 0.0 { mean / REFERENCE_S } else { 1.0 },
        varies_by: if mean > 0.0 { variance.sqrt() / mean } else { 0.0 },
    }
}

/// Seconds of a step of the small site and of its light, again and again for the time that they are `measured`, after a first that does not
/// count: in it memory is new.
fn one_core_seconds(measured: Duration) -> Vec<f64> {
    let site = Site::new(40_000, 320, 0.6);
    let mut lighting = Lighting::new(&site);
    let mut descent = Descent::new(Site::new(40_000, 320, 0.6));
    let mut both = || {
        let begun = Instant::now();
        std::hint::black_box(lighting.step(transmittance));
        std::hint::black_box(descent.step());
        begun.elapsed().as_secs_f64()
    };
    both();
    let begun = Instant::now();
    let mut seconds = Vec::new();
    while seconds.len() < FEWEST_OF_A_CORE || begun.elapsed() < measured {
        seconds.push(both());
    }
    seconds
}

/// Bytes that the process holds when its scene is open: itself and the images. What the system says it holds is no measure: an
/// allocator keeps what was freed.
pub fn held_bytes(scene: &Scene) -> f64 {
    let values: usize = scene.images.iter().map(|image| image.pixels.values.len()).sum();
    PROGRAM_BYTES + 4.0 * values as f64
}

/// Pixels of all images.
fn pixels(scene: &Scene) -> f64 {
    let of = |image: &SceneImage| (image.pixels.width * image.pixels.height) as f64;
    scene.images.iter().map(of).sum()
}

/// Bytes of the copies of `pixels` that are swept and trained on, the latter with weights.
pub fn copies_bytes(pixels: f64, bands: usize) -> f64 {
    4.0 * pixels * (2.0 * bands as f64 + 1.0)
}

/// Bytes that training adds to what the process holds when it begins: `gaussians` at most, `pixels` of the largest view.
pub fn training_bytes(gaussians: f64, views: usize, bands: usize, pixels: f64) -> f64 {
    let width = 11.0 + bands as f64;
    let per_gaussian = TABLES * 4.0 * width + 4.0 * views as f64 + STEP_BYTES_PER_GAUSSIAN;
    let planes = PLANES + PLANES_PER_CHANNEL * (bands as f64 + 4.0);
    SPARE_BYTES + gaussians * per_gaussian + pixels * planes * 4.0
}

/// Bytes per Gaussian of what `model` has besides one albedo per band: near-surface light, and harmonics of both. What
/// short fits may add counts only when they have: under a limit of memory nothing is tried that would not fit.
pub fn light_bytes(model: &ModelOptions, bands: usize) -> f64 {
    let parts = if model.near_light == Some(true) { 2 } else { 1 };
    TABLES * 4.0 * ((parts * functions(model.sh_degree.unwrap_or(0)) - 1) * bands) as f64
}

/// The most Gaussians that `limit` bytes hold, where `bytes` says how much so many take: each as much as the next.
pub fn gaussians_within(limit: f64, bytes: impl Fn(f64) -> f64) -> f64 {
    let fixed = bytes(0.0);
    let each = bytes(1.0) - fixed;
    ((limit - fixed) / each).max(0.0)
}

/// What decides how much a training takes, besides its configuration.
#[derive(Debug, Clone, Copy)]
pub struct Extent {
    /// The ground, metres.
    pub area: Area,
    /// Ground sampling distance, metres.
    pub gsd_m: f64,
    /// Bands of every image.
    pub bands: usize,
    /// Images.
    pub images: usize,
    /// Those of them that are trained on.
    pub training: usize,
    /// Pixels of an image that show the ground, in the mean.
    pub image_pixels: f64,
    /// Metres from the lowest to the highest altitude that is searched.
    pub altitudes_m: f64,
    /// Largest base-to-height ratio of two images.
    pub widest_base_to_height: f64,
}

impl From<&Scene> for Extent {
    fn from(scene: &Scene) -> Self {
        Self {
            area: scene.area,
            gsd_m: scene.gsd_m,
            bands: scene.bands().len(),
            images: scene.images.len(),
            training: scene.training().count(),
            image_pixels: pixels(scene) / scene.images.len().max(1) as f64,
            altitudes_m: scene.altitude_range_m.1 - scene.altitude_range_m.0,
            widest_base_to_height: ground::Ground::new(scene, scene.training())
                .map_or(0.0, |ground| ground.widest_base_to_height()),
        }
    }
}

impl From<&Survey<'_>> for Extent {
    fn from(survey: &Survey<'_>) -> Self {
        let (low_m, high_m) = survey.altitude_range_m;
        let (images, training) = survey.images();
        Self {
            area: *survey.area(),
            gsd_m: survey.gsd_m,
            bands: survey.bands,
            images,
            training,
            image_pixels: survey.pixels() / images.max(1) as f64,
            altitudes_m: high_m - low_m,
            widest_base_to_height: survey.widest_base_to_height,
        }
    }
}

/// Refuses a scene whose training will not fit into `limit` bytes, before a pixel of it is read.
///
/// # Errors
/// [`FitError::Memory`].
pub fn must_fit_unread(survey: &Survey, limit: Option<u64>, config: &SatelliteConfig) -> Result<(), FitError> {
    let held = PROGRAM_BYTES + 4.0 * survey.bands as f64 * survey.pixels();
    // Memory does not depend on how fast the machine is.
    let estimate = estimate_of(&survey.into(), config, 1.0, held);
    must_fit(estimate.least_bytes, limit, config)
}

/// What training `scene` will take on a machine of this [`slowness`]; the scene's images are in memory already.
pub fn estimate(scene: &Scene, config: &SatelliteConfig, slowness: f64) -> Estimate {
    let known = estimate_of(&scene.into(), config, slowness, held_bytes(scene));
    let all_known = scene.images.iter().all(|image| image.sun.position.is_some());
    Estimate {
        suns_s: if all_known { 0.0 } else { SUNS_AS_STARTS * known.start_s },
        ..known
    }
}

/// The same of any ground whose suns are all known, in a process that holds `held` bytes when training begins, the images among them.
pub fn estimate_of(extent: &Extent, config: &SatelliteConfig, slowness: f64, held: f64) -> Estimate {
    let &Extent {
        gsd_m,
        bands,
        images,
        training,
        image_pixels,
        altitudes_m,
        widest_base_to_height,
        ..
    } = extent;
    let area = crop::grown(&extent.area, ground::MARGIN_M);
    let cell_m = config.start.cell_gsd * gsd_m;
    let cells = (area.east_m - area.west_m) * (area.north_m - area.south_m) / (cell_m * cell_m);
    let gaussians = GAUSSIANS_PER_CELL * cells;
    let steps = config.train.clone().for_views(training).iterations;
    let trials = if steps < WORTH_STEPS { 0.0 } else { TRIALS_AS_STEPS };
    let pixels = cells * config.start.cell_gsd * config.start.cell_gsd * 1.2;
    let fixed = held + copies_bytes(training as f64 * pixels, bands);
    let light = light_bytes(&config.model, bands);
    let training_bytes = |gaussians: f64| training_bytes(gaussians, training, bands, pixels) + gaussians * light;
    let levels = height_levels(altitudes_m as f32, cell_m as f32, widest_base_to_height as f32);
    let search = search_bytes(cells, levels, training as f64 * pixels);
    let peak = |gaussians: f64| fixed + training_bytes(gaussians).max(search);
    let cells_seen = (image_pixels / (config.start.cell_gsd * config.start.cell_gsd)).min(cells);
    let gaussians_seen = GAUSSIANS_PER_CELL * cells_seen;
    let views = training as f64;
    let start_s = (START_S_PER_CELL * cells_seen * (views - 1.0).max(0.0) + START_S_PER_VIEW * views) * slowness;
    let growth = config.train.clone().for_views(training).growth();
    let without_light = STEP_S_PER_GAUSSIAN * gaussians;
    let step_s =
        (without_light + light_s_per_gaussian(&config.train) * gaussians_seen) * 0.5 * (1.0 + growth) * slowness;
    let evaluation = VIEW_S_PER_GAUSSIAN * gaussians_seen * growth * (images as f64 + views)
        + VIEW_S_PER_PIXEL * image_pixels * images as f64;
    let after_s = (evaluation + PRODUCT_S_PER_GAUSSIAN * gaussians * growth) * slowness;
    Estimate {
        gaussians,
        peak_bytes: peak(MANY_GAUSSIANS_PER_CELL * cells * growth),
        least_bytes: peak(cells),
        steps,
        start_s,
        seconds: start_s + (steps as f64 + trials) * step_s + after_s,
        at_most: may_stop_early(&config.train, steps, training),
        suns_s: 0.0,
    }
}

/// Whether so many steps leave room for as many epochs without progress as end a training of so many views.
fn may_stop_early(train: &TrainOptions, steps: usize, views: usize) -> bool {
    let waited = train.patience.saturating_mul(views) as f64;
    train.patience > 0 && waited < (1.0 - KEPT_FROM) * steps as f64
}

/// Seconds per Gaussian and step, in the mean, to trace light: for the step's view, and twice where shadow consistency is due.
fn light_s_per_gaussian(train: &TrainOptions) -> f64 {
    let every = |steps: usize| 1.0 / steps.max(1) as f64;
    let consistency = if train.consistency_weight > 0.0 {
        CONSISTENCY_S_PER_GAUSSIAN * 2.0 * every(train.consistency_every)
    } else {
        0.0
    };
    let sits_out = NEGLIGIBLE_SHARE * (1.0 - every(train.negligible_light_every));
    TRACE_S_PER_GAUSSIAN * every(train.light_every) * (1.0 - sits_out) + consistency
}

/// Refuses a scene that will not fit into `limit` bytes, with what would.
///
/// # Errors
/// When `needed` is more.
pub fn must_fit(needed: f64, limit: Option<u64>, config: &SatelliteConfig) -> Result<(), FitError> {
    let gib = |bytes: f64| bytes / f64::from(1 << 30);
    match limit.map(|bytes| bytes as f64) {
        Some(limit) if needed > limit => Err(FitError::Memory {
            needed_gib: gib(needed),
            limit_gib: gib(limit),
            cell_gsd: config.start.cell_gsd * (needed / limit).sqrt() * 1.05,
        }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat_fitting::settings::Preset;

    const EXTENT: Extent = Extent {
        area: Area {
            west_m: 0.0,
            south_m: 0.0,
            east_m: 100.0,
            north_m: 100.0,
        },
        gsd_m: 0.5,
        bands: 4,
        images: 12,
        training: 10,
        image_pixels: 3e4,
        altitudes_m: 40.0,
        widest_base_to_height: 0.5,
    };

    #[test]
    fn what_fits_is_what_was_asked_for() {
        let bytes = |gaussians: f64| training_bytes(gaussians, 10, 4, 2.5e5);
        assert!((gaussians_within(bytes(1e6), bytes) - 1e6).abs() < 1.0);
        assert!(gaussians_within(1e6, bytes) == 0.0);
    }

    #[test]
    fn light_takes_memory_only_where_it_is_asked_for() {
        let mut model = ModelOptions::default();
        assert!(light_bytes(&model, 4) == 0.0);
        model.sh_degree = Some(2);
        assert!(light_bytes(&model, 4) == TABLES * 4.0 * 32.0);
    }

    #[test]
    fn a_scene_that_is_too_large_is_told_what_would_fit() {
        let config = SatelliteConfig::default();
        assert!(must_fit(1e9, None, &config).is_ok() && must_fit(1e9, Some(1 << 30), &config).is_ok());
        let error = must_fit(4e9, Some(1 << 30), &config)
            .expect_err("too large")
            .to_string();
        assert!(error.contains("start.cell_gsd=2.0"), "{error}");
    }

    #[test]
    fn more_takes_longer() {
        let config = SatelliteConfig::default();
        let seconds = |extent: Extent, slowness| estimate_of(&extent, &config, slowness, 1e8).seconds;
        let usual_s = seconds(EXTENT, 1.0);
        let larger_images = Extent {
            image_pixels: 2.0 * EXTENT.image_pixels,
            ..EXTENT
        };
        let more_images = Extent {
            images: 24,
            training: 22,
            ..EXTENT
        };
        assert!(seconds(larger_images, 1.0) > usual_s && seconds(more_images, 1.0) > usual_s);
        assert!((seconds(EXTENT, 3.0) - 3.0 * usual_s).abs() < 1e-9 * usual_s);
        // More than the ground there is no image shows.
        let beyond = |image_pixels| seconds(Extent { image_pixels, ..EXTENT }, 1.0);
        assert!(beyond(1e6) - beyond(1e5) < beyond(1e5));
    }

    #[test]
    fn a_time_is_the_most_where_training_may_stop_early() {
        let of = |preset: Preset| {
            let config = SatelliteConfig::resolve(preset, &[], 1).expect("a preset");
            estimate_of(&EXTENT, &config, 1.0, 1e8)
        };
        assert!(of(Preset::Best).at_most && !of(Preset::Fast).at_most && !of(Preset::Preview).at_most);
        let mut estimate = of(Preset::Best);
        (estimate.seconds, estimate.suns_s) = (628.6, 0.0);
        assert_eq!(estimate.time_in_words(), "at most 629 s");
        (estimate.at_most, estimate.suns_s) = (false, 90.2);
        assert_eq!(
            estimate.time_in_words(),
            "629 s, and up to 90 s more to find unknown suns"
        );
        (estimate.start_s, estimate.seconds) = (20.0, 120.0);
        assert_eq!(estimate.seconds_after_start(30.0, 7.0), 187.0);
    }
}
