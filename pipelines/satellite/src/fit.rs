//! From a scene to a trained model: prepare, initialise, colour, train, finish.

use super::config::SatelliteConfig;
use super::error::SatelliteError;
use super::initial_state::{self, InitialState, SKY};
use super::plan::{Decisions, Lighting};
use super::preprocess::{Preprocess, Preprocessed};

use super::{probe, short_fit, suns};
use heliosplat::ProjectiveCamera;
use heliosplat::model::shadow_gs::ShadowGs;
use heliosplat::model::{Parameters, View};
use heliosplat::splat::rasterise::MOST_CHANNELS;
use heliosplat::timeline::stage;
use heliosplat::train::{TrainOptions, Trainer, TrainerState};
use heliosplat_fitting::budget::Budget;
use heliosplat_fitting::checkpoint::{CheckpointWriter, LoadedCheckpoint};
use heliosplat_fitting::training::{Trained, TrainingError, train};
use heliosplat_radiometry::colours::{self, Shades};
use heliosplat_radiometry::daylight::{self, Daylight};
use heliosplat_radiometry::linear;
use heliosplat_radiometry::one_light::{self, OneLight};
use heliosplat_scene::{Area, ImageSun, KnownTiles, Scene};
use heliosplat_session::Session;
use std::time::Instant;

/// Largest number of short fits for the estimate of suns: each finds fewer suns than the one before.
const MOST_SHORT_FITS: usize = 3;
/// Share of a time limit after which no short fit is started.
const BUDGET_FOR_SUNS: f64 = 0.3;

/// Request for a fit.
#[derive(Clone, Copy)]
pub struct FitRequest<'a> {
    /// Scene to fit.
    pub scene: &'a Scene,
    /// Configuration of the run.
    pub config: &'a SatelliteConfig,
    /// Plan of the scene.
    pub decisions: &'a Decisions,
    /// Time limit of the run; `None` for no limit.
    pub budget: Option<Budget>,
    /// Memory limit of the process, bytes; `None` for no limit.
    pub memory: Option<u64>,
    /// Terminal of the user: progress and interruption.
    pub session: &'a Session,
}

/// A trained model, with the data of its training.
pub struct Fitted {
    /// The model.
    pub model: ShadowGs,
    /// Parameters of the model and course of training, without the views.
    pub trained: Trained,
    /// Initial surface, and all other results before training.
    pub found: Preprocessed,
    /// Plan after the search for suns.
    pub decisions: Decisions,
    /// Sun of each image of the scene.
    pub suns: Vec<ImageSun>,
    /// Names of the training images, in the order of their colours.
    pub images: Vec<String>,
    /// Tiles with data and without clouds, for each training image; `None` where that is the whole image.
    pub known: Vec<Option<KnownTiles>>,
    /// Brightness of the ground under any sun; `None` for a model without light.
    pub daylight: Option<Daylight>,
    /// Largest memory of training as estimated at its start, bytes.
    pub memory_estimate: f64,
    /// Seconds of the start, and of training.
    pub seconds: [f64; 2],
}

/// A model before its first step.
struct Start {
    initial: InitialState,
    /// Suns of the training images.
    suns: Vec<ImageSun>,
    decisions: Decisions,
    options: TrainOptions,
    known: Vec<Option<KnownTiles>>,
    memory_estimate: f64,
}

/// Initial colours, as far as the end of a fit needs them.
struct Colours {
    shades: Shades,
    one_light: Option<OneLight>,
}

/// Nadir camera over an area of the scene's frame, with pixels of `gsd_m` metres.
pub fn nadir_camera(area: &Area, gsd_m: f64) -> ProjectiveCamera {
    let size = |length: f64| ((length / gsd_m).round() as usize).max(1);
    let size = (size(area.east_m - area.west_m), size(area.north_m - area.south_m));
    ProjectiveCamera::nadir(area.west_m + 0.5 * gsd_m, area.north_m - 0.5 * gsd_m, gsd_m, size)
}

impl FitRequest<'_> {
    /// Fits a model, or continues an interrupted fit from its `checkpoint`; `checkpoints` writes the state.
    ///
    /// # Errors
    /// [`SatelliteError`] when too few images show the common ground, training fails, or the state cannot be written or
    /// restored.
    pub fn run(
        &self,
        mut checkpoints: CheckpointWriter<Preprocessed>,
        checkpoint: Option<LoadedCheckpoint<Preprocessed>>,
    ) -> Result<Fitted, SatelliteError> {
        self.check_channels()?;
        let (kept, log, state) = checkpoint.map_or((None, None, None), |checkpoint| {
            (checkpoint.preprocessed, Some(checkpoint.log), Some(checkpoint.trainer))
        });
        let swept = self.prepare(kept)?;
        checkpoints.preprocessed = Some(swept.found.clone());
        checkpoints.log = log.unwrap_or_default();
        let clock = Instant::now();
        let mut start = self.begin(&swept)?;
        let colours = self.colour(&mut start);
        let start_s = clock.elapsed().as_secs_f64();
        let mut trained = self.train(&swept, &mut start, checkpoints, state)?;
        let daylight = self.finish(&start, &colours, &mut trained);
        let Preprocess { ground, found } = swept;
        Ok(Fitted {
            model: start.initial.model,
            trained,
            suns: suns::after(self.scene, &found.shadow_suns),
            found,
            decisions: start.decisions,
            images: ground.images.iter().map(|image| image.name.clone()).collect(),
            known: start.known,
            daylight,
            memory_estimate: start.memory_estimate,
            seconds: [start_s, clock.elapsed().as_secs_f64() - start_s],
        })
    }

    /// Checks that the engine can render near-surface light, visibility and a normal along with the bands.
    fn check_channels(&self) -> Result<(), SatelliteError> {
        let bands = self.scene.bands().len();
        match self.decisions.near_light && 2 * bands + 1 + 3 > MOST_CHANNELS {
            true => Err(SatelliteError::Input(format!(
                "model.near_light: {bands} bands of albedo and as many of near-surface light are more than the {MOST_CHANNELS} channels of the rasteriser; leave it off, or give images of fewer bands"
            ))),
            false => Ok(()),
        }
    }

    /// Swept surface, and suns estimated from its shadows: the `kept` results, if they are of this scene.
    fn prepare(&self, kept: Option<Preprocessed>) -> Result<Preprocess<'_>, SatelliteError> {
        let (scene, config) = (self.scene, self.config);
        let (decisions, session) = (self.decisions, self.session);
        if let Some(kept) = kept
            && let Some(swept) = Preprocess::again(scene, kept)?
        {
            return Ok(swept);
        }
        let mut swept = Preprocess::new(scene, config, decisions, session)?;
        suns::search(scene, &mut swept);
        if self.sweep_under_found_suns(&mut swept) {
            suns::search(scene, &mut swept);
        }
        let has_time = || self.budget.is_none_or(|budget| budget.spent() < BUDGET_FOR_SUNS);
        for _ in 0..MOST_SHORT_FITS {
            if !has_time() || !suns::are_undecided(&swept.found.shadow_suns) {
                break;
            }
            let altitude_m = short_fit::altitudes((scene, config, decisions), self.memory, &swept, session)?;
            if !suns::search_again(scene, &mut swept, &altitude_m) {
                break;
            }
            self.sweep_under_found_suns(&mut swept);
        }
        Ok(swept)
    }

    /// Sweeps again if the suns estimated from shadows group the images into other passes. Returns true after a sweep.
    fn sweep_under_found_suns(&self, swept: &mut Preprocess) -> bool {
        let suns = suns::of_ground(self.scene, &swept.ground, &swept.found.shadow_suns);
        swept.sweep_under(suns, self.scene, self.config, self.decisions, self.session)
    }

    /// Gaussians on the swept surface, under the suns that are known so far.
    fn begin(&self, swept: &Preprocess) -> Result<Start, SatelliteError> {
        let _part = stage("start");
        let &Self { scene, config, .. } = self;
        let Preprocess { ground, found } = swept;
        let (suns, decisions) = suns::decided(scene, ground, &found.shadow_suns, self.decisions);
        if decisions.light == Lighting::LeftOut || decisions.only_known_suns {
            tracing::warn!("{}", decisions.light_reason());
        }
        let initial = InitialState::new(ground, found, &suns, &decisions, config)?;
        let InitialState { parameters, views, .. } = &initial;
        tracing::debug!(
            "start: {} Gaussians on {} cells",
            parameters.gaussians.count,
            found.surface.altitude.len()
        );
        let known = |view: &View| {
            let known: Vec<bool> = view.weight.iter().map(|&weight| weight > 0.0).collect();
            KnownTiles::of(view.image.width, &known)
        };
        let mut options = initial_state::train_options(config, scene, views.len());
        Ok(Start {
            known: views.iter().map(known).collect(),
            memory_estimate: initial_state::fit_into_memory(
                self.memory,
                scene,
                parameters,
                views,
                config,
                &mut options,
            )?,
            initial,
            suns,
            decisions,
            options,
        })
    }

    /// Initialises the albedo of the Gaussians and the colours of the images.
    fn colour(&self, start: &mut Start) -> Colours {
        let _part = stage("colours");
        let initial = &mut start.initial;
        let (model, parameters, views) = (&initial.model, &mut initial.parameters, &mut initial.views);
        let shades = colours::initialise(model, parameters, views, SKY);
        let one_light = OneLight::of(&start.suns, model.options.reference);
        if let Some(light) = &one_light {
            let darkest = one_light::darkest(&views[model.options.reference].image);
            light.estimate_air(model, parameters, &self.nadir(), self.scene.gsd_m, Some(&darkest));
        }
        linear::begin(model, parameters, views);
        Colours { shades, one_light }
    }

    /// Trains to the end, or until the user or the time limit stops it.
    fn train(
        &self,
        swept: &Preprocess,
        start: &mut Start,
        checkpoints: CheckpointWriter<Preprocessed>,
        state: Option<TrainerState>,
    ) -> Result<Trained, SatelliteError> {
        let _part = stage("train");
        let initial = &mut start.initial;
        let (model, parameters, views) = (&initial.model, &mut initial.parameters, &mut initial.views);
        let (parameters, mut views) = (std::mem::take(parameters), std::mem::take(views));
        if start.decisions.only_known_suns {
            initial_state::keep_known_suns(&mut views);
        }
        let steps = start.options.iterations;
        let bounds = initial_state::bounds(&swept.ground);
        let options = start.options.clone();
        let mut trainer = Trainer::new(model, views, parameters, options, bounds, Some(self.nadir()))?;
        if let Some(state) = state {
            tracing::info!("Training continues after step {} of {steps}", state.steps());
            let restored = trainer.restore(state).map_err(|error| checkpoints.does_not_fit(&error));
            restored.map_err(TrainingError::from)?;
        }
        let reference = swept.ground.images.get(model.options.reference);
        let probe = probe::height_probe(self.scene, reference.and_then(|image| image.vegetation_index()));
        let (session, budget) = (self.session, self.budget);
        Ok(train(trainer, steps, session, budget, checkpoints, probe.as_deref())?)
    }

    /// Solves the albedo again, and fits the brightness of the ground under any sun.
    fn finish(&self, start: &Start, colours: &Colours, trained: &mut Trained) -> Option<Daylight> {
        let model = &start.initial.model;
        let views = std::mem::take(&mut trained.views);
        let parameters: &mut Parameters = &mut trained.parameters;
        let part = stage("albedo");
        linear::finish(model, parameters, &views);
        drop(part);
        let _part = stage("daylight");
        if let Some(light) = &colours.one_light {
            light.estimate_air(model, parameters, &self.nadir(), self.scene.gsd_m, None);
        }
        let elevation = |sun: &ImageSun| Some(sun.position?.elevation_rad);
        let elevations: Vec<Option<f64>> = start.suns.iter().map(elevation).collect();
        let evidence = daylight::evidence(model, parameters, &elevations, &colours.shades);
        let bands = self.scene.bands().len();
        let daylight = daylight::fit(&evidence, elevations[model.options.reference], bands)?;
        tracing::debug!("{}", daylight.in_words());
        Some(daylight)
    }

    fn nadir(&self) -> ProjectiveCamera {
        nadir_camera(&self.scene.area, self.scene.gsd_m)
    }
}
