//! From a scene to a trained model: align, sweep, start, train.

use super::adjust::{self, AdjustInput};
use super::budget::{Budget, Pace};
use super::config::{Align, PointingMethod, SatelliteConfig};
use super::ground::Ground;
use super::shadow_prior::{self, MaskError};
use super::views;
use super::{estimate, initial, measure, radiometry};
use crate::cli::Session;
use crate::run::checkpoint::{CheckpointError, Keeper, Kept, Prepared};
use crate::scene::{Area, Scene, SceneImage};
use glam::Vec3;
use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
use heliosplat::model::{Parameters, SceneModel, View};
use heliosplat::render::PassOptions;
use heliosplat::start::{Surface, SweepView, align::estimate_shifts, sweep::sweep};
use heliosplat::train::{EarlyStop, StepReport, TrainError, TrainOptions, Trainer};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_rpc::RpcError;
use heliosplat_rpc::adjust::BiasModel;
use std::collections::BTreeMap;
use std::time::Instant;

/// Why a model could not be fitted.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// Fewer than two images show the common ground.
    #[error("{images} of the scene's images show the ground that at least two have in common; two are needed")]
    TooFewViews {
        /// How many do.
        images: usize,
    },
    /// Training would take more memory than it may.
    #[error(
        "--memory: training needs about {needed_gib:.2} GiB and {limit_gib:.2} GiB are allowed; give more, fewer images, or a coarser model with --set start.cell_gsd={cell_gsd:.2}"
    )]
    Memory {
        /// What it needs, GiB.
        needed_gib: f64,
        /// What it may take, GiB.
        limit_gib: f64,
        /// What would fit: width of a cell, ground sampling distances.
        cell_gsd: f64,
    },
    /// A mask of shadows that cannot be used.
    #[error(transparent)]
    Mask(#[from] MaskError),
    /// Training gave up.
    #[error("training stopped: {0}")]
    Train(#[from] TrainError),
    /// A checkpoint is at fault, or cannot be written.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
}

/// The losses of one step.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CurvePoint {
    /// The step.
    pub step: usize,
    /// Mean absolute difference to the images, smoothed.
    pub l1: f64,
    /// Named losses, unweighted.
    pub losses: BTreeMap<String, f64>,
    /// Mean absolute difference on tiles that are not learnt from.
    pub held_out_l1: Option<f64>,
    /// How good the model was by then, where that was asked.
    pub accuracy: Option<Accuracy>,
}

/// How good a model is while it is trained.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Accuracy {
    /// Mean height error against truth, protocol `raw`, metres.
    pub height_mae_m: Option<f64>,
    /// PSNR of some images held out, decibels.
    pub psnr_db: Option<f64>,
}

/// Measures a model in training without changing it.
pub(crate) type Probe<'a> = dyn Fn(&Parameters) -> Option<Accuracy> + 'a;

/// Steps between two points of the curve.
const CURVE_EVERY: usize = 25;
/// About as many points of it have an accuracy.
const PROBES: usize = 12;

/// What a fit may take.
#[derive(Debug, Clone, Copy, Default)]
pub struct Limits {
    /// Time.
    pub budget: Option<Budget>,
    /// Memory, bytes.
    pub memory: Option<u64>,
}

/// How a fit that has a model to show ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// As it should.
    Done,
    /// The user stopped it; its state is kept in a checkpoint.
    Interrupted,
    /// Training could not go on; the model is the last good state.
    GaveUp(TrainError),
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
    /// The surface that training started from.
    pub surface: Surface,
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

/// Corrections of the images' pointing, pixels; zero where the configuration or the estimate says so.
fn align(ground: &Ground, rasters: &[Raster], config: &SatelliteConfig, gsd_m: f64) -> Vec<[f32; 2]> {
    let none = vec![[0.0; 2]; ground.images.len()];
    if config.cameras.align == Align::Off {
        return none;
    }
    let views = ground.sweep_views(rasters, &none);
    let by_shifts = || estimate_shifts(&views, &ground.request(config.start.cell_gsd * gsd_m));
    let shifts = match config.cameras.method {
        PointingMethod::Shifts => by_shifts(),
        PointingMethod::Ties => shifts_by_ties(ground, &views, gsd_m).unwrap_or_else(|error| {
            tracing::warn!("whole images are compared, because ties do not tell: {error}");
            by_shifts()
        }),
    };
    let largest = shifts.iter().flatten().fold(0.0f32, |a, &b| a.max(b.abs()));
    tracing::info!(largest_px = largest, "pointing of the images relative to each other");
    if config.cameras.align == Align::On || largest > config.cameras.threshold_px {
        shifts
    } else {
        none
    }
}

fn shifts_by_ties(ground: &Ground, views: &[SweepView], gsd_m: f64) -> Result<Vec<[f32; 2]>, RpcError> {
    // Patches of whole pixels, however coarse the model's cells are.
    let input = AdjustInput {
        ground,
        views,
        cell_m: gsd_m,
    };
    Ok(adjust::shifts(&input.adjust(BiasModel::Translation, &|_| {})?))
}

/// The image whose colour is the model's: the one under the highest sun, where least lies in shadow.
fn reference(images: &[&SceneImage]) -> usize {
    let elevation = |i: usize| images[i].sun.elevation_rad;
    (0..images.len())
        .max_by(|&a, &b| elevation(a).total_cmp(&elevation(b)).then(b.cmp(&a)))
        .unwrap_or(0)
}

/// A nadir camera over an area of the scene frame.
pub fn nadir_camera(area: &Area, gsd_m: f64) -> ProjectiveCamera {
    let size = |length: f64| ((length / gsd_m).round() as usize).max(1);
    let size = (size(area.east_m - area.west_m), size(area.north_m - area.south_m));
    ProjectiveCamera::nadir(area.west_m + 0.5 * gsd_m, area.north_m - 0.5 * gsd_m, gsd_m, size)
}

/// A scene's surface before any training, and what it was found with.
struct Swept<'a> {
    ground: Ground<'a>,
    surface: Surface,
    /// Number of bands of the images.
    bands: usize,
    /// Pointing corrections, pixels.
    shifts_px: Vec<[f32; 2]>,
    /// Seconds spent on alignment and on the sweep.
    seconds: [f64; 2],
}

impl<'a> Swept<'a> {
    fn new(scene: &'a Scene, config: &SatelliteConfig, session: &Session) -> Result<Self, FitError> {
        let started = Instant::now();
        let ground = Ground::new(scene, scene.training(), config.start.margin_m)?;
        let rasters = ground.rasters();
        let shifts_px = align(&ground, &rasters, config, scene.gsd_m);
        let aligned = started.elapsed();
        let bands = rasters.first().map_or(0, |raster| raster.bands);
        let request = ground.request(config.start.cell_gsd * scene.gsd_m);
        let progress = session.progress("sweep", 100);
        let indices = ground.vegetation_indices(&rasters);
        let mut views = ground.sweep_views(&rasters, &shifts_px);
        for (view, index) in views.iter_mut().zip(indices.iter().flatten()) {
            view.index = Some(index);
        }
        let surface = sweep(&views, &request, &|share| progress.set((100.0 * share) as u64));
        Ok(Self {
            surface,
            bands,
            ground,
            shifts_px,
            seconds: [aligned.as_secs_f64(), (started.elapsed() - aligned).as_secs_f64()],
        })
    }

    /// The same as it was found out before; `None` where it is not of this scene.
    fn again(scene: &'a Scene, config: &SatelliteConfig, prepared: Prepared) -> Result<Option<Self>, FitError> {
        let ground = Ground::new(scene, scene.training(), config.start.margin_m)?;
        let fits = prepared.shifts_px.len() == ground.images.len() && prepared.surface.is_whole();
        let bands = ground.images.first().map_or(0, |image| image.pixels.bands);
        Ok(fits.then_some(Self {
            ground,
            surface: prepared.surface,
            bands,
            shifts_px: prepared.shifts_px,
            seconds: prepared.seconds,
        }))
    }

    /// What need not be found out again.
    fn prepared(&self) -> Prepared {
        Prepared {
            surface: self.surface.clone(),
            shifts_px: self.shifts_px.clone(),
            seconds: self.seconds,
        }
    }
}

/// The surface that all views of `scene` find together, without training.
///
/// # Errors
/// [`FitError::TooFewViews`] when too few images show the common ground.
pub fn sweep_only(scene: &Scene, config: &SatelliteConfig, session: &Session) -> Result<Surface, FitError> {
    Swept::new(scene, config, session).map(|swept| swept.surface)
}

/// Fits a model to `scene`, or goes on from where a fit of it was interrupted; `keeper` keeps its state meanwhile.
///
/// # Errors
/// [`FitError`] when too few images show the common ground, training gives up, or the state cannot be kept or taken up.
pub fn fit(
    scene: &Scene,
    config: &SatelliteConfig,
    session: &Session,
    limits: &Limits,
    mut keeper: Keeper,
    kept: Option<Kept>,
) -> Result<Fitted, FitError> {
    let (prepared, course, state) = kept.map_or((None, None, None), |kept| {
        (kept.prepared, Some(kept.course), Some(kept.trainer))
    });
    let again = match prepared {
        Some(prepared) => Swept::again(scene, config, prepared)?,
        None => None,
    };
    let swept = match again {
        Some(swept) => swept,
        None => Swept::new(scene, config, session)?,
    };
    keeper.prepared = Some(swept.prepared());
    keeper.course = course.unwrap_or_default();
    let Swept {
        ground,
        surface,
        bands,
        mut shifts_px,
        seconds: [align_s, sweep_s],
    } = swept;
    let swept = Instant::now();

    let image_colour = config.model.image_colour.unwrap_or(ground.images.len() > 1);
    let model = ShadowGs::new(ShadowGsOptions {
        bands,
        images: ground.images.len(),
        reference: reference(&ground.images),
        image_colour,
        near_light: config.model.near_light,
        degree: config.model.sh_degree,
        facing: config.model.facing,
        opaqueness_weight: config.model.opaqueness_weight,
        // The plan has decided it by now.
        prior_weight: match config.model.shadow_prior {
            Some(true) => config.model.prior_weight,
            _ => 0.0,
        },
        pointing: config.cameras.refine,
    });
    let covered = ground.covered(&surface, config.start.coverage);
    let mut parameters = Parameters {
        gaussians: initial::gaussians_on(&surface, &covered, &config.start, model.feature_groups()),
        globals: model.initial_globals(config.model.sky),
    };
    tracing::info!(
        gaussians = parameters.gaussians.count,
        cells = surface.altitude.len(),
        "start"
    );
    let mut views: Vec<View> = (0..ground.images.len())
        .map(|i| views::view(ground.images[i], &ground.crops[i], shifts_px[i], i))
        .collect();
    if model.options.prior_weight > 0.0 {
        give_priors(&mut views, &ground, &surface, config)?;
    }
    let mut options = config.train.clone().for_views(views.len());
    let steps = options.iterations;
    options.gsd_m = scene.gsd_m as f32;
    let memory_estimate = fit_into_memory(limits.memory, scene, &parameters, &views, config, &mut options)?;
    let pass = PassOptions {
        projection: options.projection,
        trace: options.trace,
        ..PassOptions::default()
    };
    radiometry::initialise(&model, &mut parameters, &mut views, pass, config.model.sky);
    let initialised = swept.elapsed();

    let bounds = bounds(&ground);
    let nadir = nadir_camera(&scene.area, scene.gsd_m);
    let mut trainer = Trainer::new(&model, views, parameters, options, bounds, Some(nadir))?;
    if let Some(state) = state {
        tracing::info!(step = state.steps(), of = steps, "training goes on");
        trainer.restore(state).map_err(|error| keeper.does_not_fit(&error))?;
    }
    let trained = {
        let probe = measure::height_probe(scene, pass.projection);
        train(trainer, steps, session, limits.budget, keeper, probe.as_deref())?
    };
    for (image, shift) in shifts_px.iter_mut().enumerate() {
        let moved = model.pointing(&trained.parameters, image);
        *shift = [shift[0] + moved[0], shift[1] + moved[1]];
    }
    Ok(Fitted {
        parameters: trained.parameters,
        early_stop: trained.early_stop,
        rejected: trained.rejected,
        curve: trained.curve,
        ending: trained.ending,
        memory_estimate,
        model,
        images: ground.images.iter().map(|image| image.name.clone()).collect(),
        shifts_px,
        surface,
        seconds: [
            align_s,
            sweep_s,
            initialised.as_secs_f64(),
            (swept.elapsed() - initialised).as_secs_f64(),
        ],
    })
}

/// Tells each view what it seems to be lit by: from the user's masks, else from its own darkness.
fn give_priors(
    views: &mut [View],
    ground: &Ground,
    surface: &Surface,
    config: &SatelliteConfig,
) -> Result<(), MaskError> {
    let priors = match &config.model.shadow_masks {
        Some(folder) => {
            let images = ground.images.iter().zip(&ground.crops);
            images
                .map(|(image, crop)| shadow_prior::from_folder(folder, image, crop))
                .collect::<Result<Vec<_>, _>>()?
        }
        None => {
            let (rasters, cameras): (Vec<_>, Vec<_>) = views.iter().map(|view| (&view.image, view.camera)).unzip();
            shadow_prior::found(ground, &rasters, surface, &cameras)
        }
    };
    for (view, lit) in views.iter_mut().zip(priors) {
        view.lit = Some(lit);
    }
    Ok(())
}

/// Limits the Gaussians to what `limit` bytes hold; returns what training will take at most.
fn fit_into_memory(
    limit: Option<u64>,
    scene: &Scene,
    parameters: &Parameters,
    views: &[View],
    config: &SatelliteConfig,
    options: &mut TrainOptions,
) -> Result<f64, FitError> {
    let count = parameters.gaussians.count;
    let pixels = |view: &View| view.image.plane_len() as f64;
    let largest = views.iter().map(pixels).fold(0.0, f64::max);
    let bands = views.first().map_or(0, |v| v.image.bands);
    let held = estimate::held_bytes(scene) + estimate::copies_bytes(views.iter().map(pixels).sum(), bands);
    let bytes = |gaussians: f64| held + estimate::training_bytes(gaussians, views.len(), bands, largest);
    estimate::must_fit(bytes(count as f64), limit, config)?;
    if let Some(limit) = limit {
        let most = estimate::gaussians_within(limit as f64 - held, views.len(), bands, largest);
        options.density.cap = options.density.cap.min(most as usize);
    }
    let grown = count as f64 * options.growth();
    Ok(bytes(grown.min(options.density.cap.max(count) as f64)).max(crate::run::peak_rss_bytes() as f64))
}

/// Outside of this box Gaussians are pruned, metres.
fn bounds(ground: &Ground) -> (Vec3, Vec3) {
    let (area, slack) = (&ground.area, 2.0);
    (
        Vec3::new(
            (area.west_m - slack) as f32,
            (area.south_m - slack) as f32,
            (ground.up_m.0 - slack) as f32,
        ),
        Vec3::new(
            (area.east_m + slack) as f32,
            (area.north_m + slack) as f32,
            (ground.up_m.1 + slack) as f32,
        ),
    )
}

/// What training leaves.
pub(crate) struct Trained {
    pub(crate) parameters: Parameters,
    pub(crate) early_stop: EarlyStop,
    pub(crate) rejected: usize,
    pub(crate) curve: Vec<CurvePoint>,
    pub(crate) ending: Ending,
}

/// Trains to the end, or until the user or the time stops it.
pub(crate) fn train(
    mut trainer: Trainer,
    steps: usize,
    session: &Session,
    budget: Option<Budget>,
    mut keeper: Keeper,
    probe: Option<&Probe>,
) -> Result<Trained, FitError> {
    let probe_every = CURVE_EVERY * (steps / CURVE_EVERY / PROBES).max(1);
    let progress = session.progress("train", steps as u64);
    progress.set(trainer.steps() as u64);
    let mut pace = Pace::new(trainer.views());
    let mut ending = Ending::Done;
    while !trainer.finished() && !session.stopped() {
        let begun = Instant::now();
        let report = match trainer.step() {
            Ok(report) => report,
            Err(error @ TrainError::NotFinite { .. }) if trainer.steps() > trainer.rejected() => {
                ending = Ending::GaveUp(error);
                break;
            }
            Err(error) => return Err(error.into()),
        };
        pace.add(begun.elapsed());
        if let Some(budget) = budget {
            let steps = budget.steps(report.step, pace.step_s());
            trainer.set_iterations(steps);
            progress.set_total(steps as u64);
        }
        let course = &mut keeper.course;
        let l1 = course.smoothed.map_or(report.l1, |old| 0.95 * old + 0.05 * report.l1);
        course.smoothed = Some(l1);
        progress.set(report.step as u64);
        if report.step % CURVE_EVERY == 0 {
            progress.say(&format!("L1 {l1:.4} gaussians {}", report.gaussians));
            let probe = probe.filter(|_| report.step % probe_every == 0);
            course.curve.push(CurvePoint {
                held_out_l1: trainer.held_out_l1(),
                accuracy: probe.and_then(|probe| probe(&trainer.parameters)),
                ..point(&report, l1)
            });
        }
        if report.step % 100 == 0 {
            let StepReport {
                step, gaussians, pairs, ..
            } = report;
            tracing::info!(step, l1, gaussians, pairs, "training");
        }
        keeper.step_done(&trainer);
    }
    if ending == Ending::Done && !trainer.finished() {
        ending = Ending::Interrupted;
        keeper.keep(&trainer)?;
    }
    let rejected = trainer.rejected();
    let (parameters, early_stop) = trainer.into_best();
    Ok(Trained {
        parameters,
        early_stop,
        rejected,
        curve: keeper.course.curve,
        ending,
    })
}

fn point(report: &StepReport, l1: f64) -> CurvePoint {
    let losses = report
        .losses
        .iter()
        .map(|(name, value)| ((*name).to_owned(), *value))
        .collect();
    CurvePoint {
        step: report.step,
        l1,
        losses,
        held_out_l1: None,
        accuracy: None,
    }
}
