//! From a scene to a trained model: align, sweep, start, train.

use super::beginning::{self, Beginning, SKY};
use super::config::SatelliteConfig;
use super::error::FitError;
use super::one_light::{self, OneLight};
use super::plan::{Decisions, Light};
use super::preprocess::{Preprocess, Preprocessed};
use super::{clouds, daylight, linear, probe, radiometry, short_fit, suns};
use heliosplat::ProjectiveCamera;
use heliosplat::model::shadow_gs::ShadowGs;
use heliosplat::model::Parameters;
use heliosplat::splat::rasterise::MOST_CHANNELS;
use heliosplat::timeline::stage;
use heliosplat::train::{EarlyStop, Trainer};
use heliosplat_fitting::budget::Budget;
use heliosplat_fitting::checkpoint::{CheckpointWriter, LoadedCheckpoint};
use heliosplat_fitting::curve::CurvePoint;
use heliosplat_fitting::training::{Ending, TrainingError, train};
use heliosplat_products::daylight::Daylight;
use heliosplat_scene::{Area, ImageSun, KnownTiles, Scene};
use heliosplat_session::Session;
use heliosplat_stereo::Surface;
use heliosplat_stereo::bridged::Lowered;
use heliosplat_stereo::change::Changes;
use std::time::Instant;

/// Short fits that are made for the sake of suns, at most: each finds fewer than the one before.
const MOST_SHORT_FITS: usize = 3;
/// Share of a limit of time after which none is begun.
const BUDGET_FOR_SUNS: f64 = 0.3;

/// What a fit may take.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Time.
    pub budget: Option<Budget>,
    /// Memory, bytes.
    pub memory: Option<u64>,
}

/// A trained model and how it came about.
pub struct Fitted {
    /// The model.
    pub model: ShadowGs,
    /// Its parameters.
    pub parameters: Parameters,
    /// Names of the images trained on, in the order of their colours.
    pub images: Vec<String>,
    /// Pointing corrections, pixels, in that order.
    pub shifts_px: Vec<[f32; 2]>,
    /// Where each image has data and no clouds; `None`: everywhere.
    pub known: Vec<Option<KnownTiles>>,
    /// What was decided, after suns were searched.
    pub decisions: Decisions,
    /// The suns of the scene's images, in the scene's order.
    pub suns: Vec<ImageSun>,
    /// Share of each image that is left out because clouds hide the ground there, 0 to 1, in that order.
    pub clouded: Vec<f64>,
    /// How bright the ground is under any sun; `None` without light.
    pub daylight: Option<Daylight>,
    /// The surface that training started from.
    pub surface: Surface,
    /// What of that surface was lowered because it bridged ground in shade; `None` where fewer than two suns are known.
    pub lowered: Option<Lowered>,
    /// What changed between the images.
    pub changes: Changes,
    /// How training ended.
    pub early_stop: EarlyStop,
    /// Steps rejected because of a number that is not finite.
    pub rejected: usize,
    /// Seconds spent on alignment, sweep, start and training.
    pub seconds: [f64; 4],
    /// The course of training.
    pub curve: Vec<CurvePoint>,
    /// How training ended.
    pub ending: Ending,
    /// The most memory that training was expected to take when it began, bytes.
    pub memory_estimate: f64,
}

/// A nadir camera over an area of the scene frame.
pub fn nadir_camera(area: &Area, gsd_m: f64) -> ProjectiveCamera {
    let size = |length: f64| ((length / gsd_m).round() as usize).max(1);
    let size = (size(area.east_m - area.west_m), size(area.north_m - area.south_m));
    ProjectiveCamera::nadir(area.west_m + 0.5 * gsd_m, area.north_m - 0.5 * gsd_m, gsd_m, size)
}

/// Fits a model to `scene`, or goes on from the `checkpoint` of a fit that was interrupted; `checkpoints` writes its state meanwhile.
///
/// # Errors
/// [`FitError`] when too few images show the common ground, training gives up, or the state cannot be kept or taken up.
pub fn fit(
    scene: &Scene,
    config: &SatelliteConfig,
    decisions: &Decisions,
    session: &Session,
    limits: &Limits,
    mut checkpoints: CheckpointWriter<Preprocessed>,
    checkpoint: Option<LoadedCheckpoint<Preprocessed>>,
) -> Result<Fitted, FitError> {
    let bands = scene.bands().len();
    if decisions.near_light && !channels_fit(bands) {
        return Err(FitError::Channels {
            bands,
            most: MOST_CHANNELS,
        });
    }
    let (preprocessed, log, state) = checkpoint.map_or((None, None, None), |checkpoint| {
        (checkpoint.preprocessed, Some(checkpoint.log), Some(checkpoint.trainer))
    });
    let again = match preprocessed {
        Some(preprocessed) => Preprocess::again(scene, preprocessed)?,
        None => None,
    };
    let Preprocess { ground, found } = match again {
        Some(swept) => swept,
        None => {
            let mut swept = Preprocess::new(scene, config, decisions, session)?;
            suns::search(scene, &mut swept);
            let suns = suns::of_ground(scene, &swept.ground, &swept.found.shadow_suns);
            if swept.sweep_under(suns, scene, config, decisions, session) {
                suns::search(scene, &mut swept);
            }
            let mut fits = 0;
            let has_time = || limits.budget.is_none_or(|budget| budget.spent() < BUDGET_FOR_SUNS);
            while fits < MOST_SHORT_FITS && has_time() && suns::are_in_doubt(&swept.found.shadow_suns) {
                fits += 1;
                let altitude_m = short_fit::altitudes(scene, config, decisions, &swept, limits.memory, session)?;
                if !suns::search_again(scene, &mut swept, &altitude_m) {
                    break;
                }
                let suns = suns::of_ground(scene, &swept.ground, &swept.found.shadow_suns);
                swept.sweep_under(suns, scene, config, decisions, session);
            }
            swept
        }
    };
    checkpoints.preprocessed = Some(found.clone());
    checkpoints.log = log.unwrap_or_default();
    let swept = Instant::now();
    let part = stage("start");

    let all_suns = suns::after(scene, &found.shadow_suns);
    let (suns, decisions) = suns::decided(scene, &ground, &found.shadow_suns, decisions);
    let decisions = &decisions;
    if decisions.light == Light::LeftOut || decisions.only_known_suns {
        tracing::warn!("{}", decisions.light_reason());
    }
    let Beginning {
        model,
        mut parameters,
        mut views,
    } = Beginning::new(&ground, &found, &suns, decisions, config)?;
    tracing::info!(
        "start: {} Gaussians on {} cells",
        parameters.gaussians.count,
        found.surface.altitude.len()
    );
    let known = views.iter().map(|view| {
        let known: Vec<bool> = view.weight.iter().map(|&weight| weight > 0.0).collect();
        KnownTiles::of(view.image.width, &known)
    });
    let known = known.collect();
    let mut options = beginning::train_options(config, scene, views.len());
    let steps = options.iterations;
    let memory_estimate = beginning::fit_into_memory(limits.memory, scene, &parameters, &views, config, &mut options)?;
    drop(part);
    let part = stage("colours");
    let shades = radiometry::initialise(&model, &mut parameters, &mut views, SKY);
    let nadir = nadir_camera(&scene.area, scene.gsd_m);
    let one_light = OneLight::of(&suns, model.options.reference);
    let darkest = one_light::darkest(&views[model.options.reference].image);
    if let Some(light) = &one_light {
        light.settle(&model, &mut parameters, &nadir, scene.gsd_m, Some(&darkest));
    }
    linear::begin(&model, &mut parameters, &views);
    drop(part);
    let initialised = swept.elapsed();
    let part = stage("train");

    let bounds = beginning::bounds(&ground);
    if decisions.only_known_suns {
        beginning::keep_known_suns(&mut views);
    }
    let mut trainer = Trainer::new(&model, views, parameters, options, bounds, Some(nadir))?;
    if let Some(state) = state {
        tracing::info!("training is resumed at step {} of {steps}", state.steps());
        let restored = trainer.restore(state).map_err(|error| checkpoints.does_not_fit(&error));
        restored.map_err(TrainingError::from)?;
    }
    let mut trained = {
        let reference = ground.images.get(model.options.reference);
        let probe = probe::height_probe(scene, reference.and_then(|image| image.vegetation_index()));
        train(trainer, steps, session, limits.budget, checkpoints, probe.as_deref())?
    };
    drop(part);
    {
        let _part = stage("albedo");
        linear::finish(&model, &mut trained.parameters, &trained.views);
    }
    let daylight = {
        let _part = stage("daylight");
        if let Some(light) = &one_light {
            light.settle(&model, &mut trained.parameters, &nadir, scene.gsd_m, None);
        }
        let elevations: Vec<Option<f64>> = suns.iter().map(|sun| Some(sun.position?.elevation_rad)).collect();
        let evidence = daylight::evidence(&model, &trained.parameters, &elevations, &shades);
        daylight::fit(&evidence, elevations[model.options.reference], bands)
    };
    if let Some(light) = &daylight {
        tracing::info!("{}", light.in_words());
    }
    Ok(Fitted {
        daylight,
        parameters: trained.parameters,
        early_stop: trained.early_stop,
        rejected: trained.rejected,
        curve: trained.curve,
        ending: trained.ending,
        memory_estimate,
        model,
        images: ground.images.iter().map(|image| image.name.clone()).collect(),
        clouded: found.clouds.iter().map(|mask| clouds::share(mask)).collect(),
        shifts_px: found.shifts_px,
        known,
        suns: all_suns,
        decisions: decisions.clone(),
        surface: found.surface,
        lowered: found.lowered,
        changes: found.changes,
        seconds: [
            found.seconds[0],
            found.seconds[1],
            initialised.as_secs_f64(),
            (swept.elapsed() - initialised).as_secs_f64(),
        ],
    })
}

/// Whether near-surface light, visibility and a normal can be rendered beside `bands` bands.
fn channels_fit(bands: usize) -> bool {
    2 * bands + 1 + 3 <= MOST_CHANNELS
}
