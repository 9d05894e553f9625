//! The trainer: one view per step, for any model.

mod cached_visibility;
mod camera_turns;
mod checkpoint;
mod cpu;
pub mod device;
mod fault;
mod holdout;
mod options;
mod pyramid;

pub use camera_turns::CameraTurn;
pub use checkpoint::{STATE_VERSION, StateError, TrainerState};
pub use cpu::{LAMBDA_SSIM, PHOTOMETRIC_WEIGHT, update};
pub use fault::{Fault, GRADIENT_MAX, TrainError};
pub use holdout::EarlyStop;
pub use options::TrainOptions;

use crate::camera::ProjectiveCamera;
use crate::gaussians::{FEATURES, LOG_SCALE, OPACITY, POSITION, ROTATION};
use crate::model::{NamedLoss, Parameters, SceneModel, View};
use crate::optim::density::UNTIL_FRACTION;
use crate::optim::{LearningRate, ParameterGroup, exponential_decay};
use crate::timeline::stage;
use camera_turns::{moved_px, turned, without_gauge};
use cpu::Cpu;
use device::{Descent, Device, Rates, Step, Tables};
use glam::{DVec3, Vec3};
use holdout::Holdout;
use pyramid::{Pyramid, PyramidLevel};
use rand::{SeedableRng, seq::SliceRandom};
use rand_pcg::Pcg32;

/// Rejected steps in a row, or steps that saw no Gaussian, after which training stops.
const REJECTED_LIMIT: usize = 20;
/// Learning rate of log scales.
const LOG_SCALE_RATE: f32 = 5e-3;
/// Learning rate of rotations.
const ROTATION_RATE: f32 = 2e-3;
/// Bounds of opacity logits.
const OPACITY_BOUNDS: (f32, f32) = (-12.0, 12.0);

/// Report of one step.
#[derive(Debug, Clone, Default)]
pub struct StepReport {
    /// Number of the step, counted from one.
    pub step: usize,
    /// Index of the view.
    pub view: usize,
    /// Named loss values, unweighted.
    pub losses: Vec<NamedLoss>,
    /// Mean absolute difference to the image over the pixels trained on.
    pub l1: f64,
    /// Number of (splat, pixel) pairs of the forward pass.
    pub pairs: u64,
    /// Number of Gaussians after the step.
    pub gaussians: usize,
    /// Fault that rejected the step, if any.
    pub rejected: Option<Fault>,
}

/// State of a training between two steps: views, options and random order do not determine it.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
struct StepState {
    tables: Tables,
    /// Rotations of the views' cameras about their centres, axis times angle, radians; `None` where they do not turn.
    turns: Option<Vec<DVec3>>,
    step: usize,
    rejected: usize,
    rejected_in_a_row: usize,
    unseen_in_a_row: usize,
}

/// A model in training.
pub struct Trainer<'a> {
    model: &'a dyn SceneModel,
    /// The images; held-out pixels have weight zero.
    views: Vec<View>,
    /// Cameras of the views as they were given.
    cameras: Vec<ProjectiveCamera>,
    options: TrainOptions,
    nadir: Option<ProjectiveCamera>,
    bounds: (Vec3, Vec3),
    now: StepState,
    /// Learning rates of the model's groups, in the order of the tables; those of the core groups are options.
    feature_rates: Vec<LearningRate>,
    global_rates: Vec<LearningRate>,
    holdout: Holdout,
    pyramid: Pyramid,
    cpu: Cpu,
    /// The device that computes steps in place of the processor.
    device: Option<Box<dyn Device + 'a>>,
    /// True if the device has not yet taken over the tables as they are.
    moved: bool,
    order: Vec<usize>,
}

impl<'a> Trainer<'a> {
    /// A trainer of `model` on `views`, from `parameters`; Gaussians that leave `bounds` (metres) are pruned. With a
    /// `nadir` camera, the shadow consistency loss also applies with view and light at the zenith.
    ///
    /// # Errors
    /// Without views, pixels that count or Gaussians, when an option is out of range, or when `parameters` have other
    /// groups than the model or numbers that are not finite.
    pub fn new(
        model: &'a dyn SceneModel,
        mut views: Vec<View>,
        parameters: Parameters,
        options: TrainOptions,
        bounds: (Vec3, Vec3),
        nadir: Option<ProjectiveCamera>,
    ) -> Result<Self, TrainError> {
        if views.is_empty() {
            return Err(TrainError::NoViews);
        }
        if parameters.gaussians.count == 0 {
            return Err(TrainError::Empty);
        }
        options.check()?;
        fault::check_start(&parameters)?;
        let (features, globals) = (model.feature_parameters(), model.global_parameters());
        fault::check_groups(model.name(), &parameters, &features, &globals)?;
        let rates = |groups: Vec<ParameterGroup>| groups.into_iter().map(|group| group.rate).collect();
        let holdout = Holdout::new(&mut views, &options);
        fault::check_pixels(&views)?;
        Ok(Self {
            feature_rates: rates(features),
            global_rates: rates(globals),
            pyramid: Pyramid::new(&views, &options),
            holdout,
            cpu: Cpu::new(&parameters),
            device: None,
            moved: true,
            order: Vec::new(),
            cameras: views.iter().map(|view| view.camera).collect(),
            now: StepState {
                tables: Tables::new(parameters, views.len()),
                turns: camera_turns::begin(&options, views.len()),
                step: 0,
                rejected: 0,
                rejected_in_a_row: 0,
                unseen_in_a_row: 0,
            },
            model,
            views,
            options,
            nadir,
            bounds,
        })
    }

    /// Changes the number of steps, for callers that have measured the time per step. Learning rates and other
    /// schedules follow.
    pub fn set_iterations(&mut self, iterations: usize) {
        self.options.iterations = iterations;
    }

    /// Number of views.
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// The trained parameters; those of the latest [`Self::fetch`] where a device computes the steps.
    pub fn parameters(&self) -> &Parameters {
        &self.now.tables.parameters
    }

    /// Name of the device that computes the steps.
    pub fn device(&self) -> &str {
        self.device.as_deref().map_or(self.cpu.name(), Device::name)
    }

    /// Number of steps done.
    pub fn steps(&self) -> usize {
        self.now.step
    }

    /// Number of steps rejected because of a number that is not finite.
    pub fn rejected(&self) -> usize {
        self.now.rejected
    }

    /// Mean absolute difference on the held-out tiles, from the latest visit of each view; `None` where none are held
    /// out.
    pub fn held_out_l1(&self) -> Option<f64> {
        self.holdout.mean()
    }

    /// True if all steps are done, or the held-out tiles stopped improving.
    pub fn finished(&self) -> bool {
        self.now.step >= self.options.iterations || self.holdout.stop()
    }

    /// The final state: the best on held-out tiles when early stopping is on and has one, else the last.
    pub fn into_best(self) -> (Parameters, EarlyStop) {
        let (parameters, early_stop, _) = self.into_best_and_views();
        (parameters, early_stop)
    }

    /// The best parameters and the training views; held-out pixels of the views have weight zero.
    pub fn into_best_and_views(self) -> (Parameters, EarlyStop, Vec<View>) {
        let summary = self.holdout.summary(self.now.step);
        let best = self.holdout.into_best().unwrap_or(self.now.tables.parameters);
        (best, summary, self.views)
    }

    /// Share of training done after `steps` steps.
    fn fraction(&self, steps: usize) -> f32 {
        steps as f32 / self.options.iterations.max(1) as f32
    }

    /// Views come in a new random order every epoch; the order depends on the seed and the epoch alone.
    fn next_view(&mut self) -> usize {
        let place = self.now.step % self.views.len();
        if place == 0 || self.order.len() != self.views.len() {
            let epoch = (self.now.step / self.views.len()) as u64;
            self.order = (0..self.views.len()).collect();
            self.order.shuffle(&mut Pcg32::seed_from_u64(
                self.options.seed.wrapping_mul(1_000_003) ^ epoch,
            ));
        }
        self.order[place]
    }

    /// This trainer, with its steps computed by `device`, which turns no cameras.
    pub fn on(mut self, device: Box<dyn Device + 'a>) -> Self {
        self.device = Some(device);
        self.now.turns = None;
        self
    }

    /// Brings the parameters and the state up to date where a device keeps its own. Nothing else reads them back.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device fails.
    pub fn fetch(&mut self) -> Result<(), TrainError> {
        let device: &mut dyn Device = match &mut self.device {
            Some(device) if !self.moved => &mut **device,
            _ => return Ok(()),
        };
        device.fetch(&mut self.now.tables)
    }

    /// Runs one step.
    ///
    /// A step whose losses or gradients are not finite changes nothing but the counts of steps and of rejected ones.
    ///
    /// # Errors
    /// When too many steps in a row are rejected or see no Gaussian, when none is left, or when a device fails. The
    /// parameters are then those of the last good state.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let index = self.next_view();
        let (descent, full_size) = self.descend(index)?;
        if full_size {
            self.holdout.record(index, descent.held_out);
        }
        self.now.step += 1;
        match &descent.rejected {
            None => {
                self.now.rejected_in_a_row = 0;
                if let Some(turn) = descent.turn {
                    self.turn_camera(index, turn);
                }
                self.control_density()?;
            }
            Some(fault) => self.reject(fault, index)?,
        }
        self.settle_cameras();
        let (views, unseen) = (self.views.len(), &mut self.now.unseen_in_a_row);
        *unseen = if descent.pairs == 0 { *unseen + 1 } else { 0 };
        if *unseen >= REJECTED_LIMIT.max(views) {
            return Err(TrainError::NothingSeen { steps: *unseen });
        }
        let part = stage("hold out");
        if self.holdout.compares(self.now.step, views) {
            self.fetch()?;
            self.holdout.epoch_done(self.now.step, &self.now.tables.parameters);
        }
        drop(part);
        let gaussians = self.now.tables.parameters.gaussians.count;
        if gaussians == 0 {
            return Err(TrainError::Empty);
        }
        Ok(StepReport {
            step: self.now.step,
            view: index,
            losses: descent.losses,
            l1: descent.l1,
            pairs: descent.pairs,
            gaussians,
            rejected: descent.rejected,
        })
    }

    /// Computes a step on view `index`, where it belongs; true if the view had its full size.
    fn descend(&mut self, index: usize) -> Result<(Descent, bool), TrainError> {
        let rates = self.rates();
        let part = stage("view");
        self.pyramid.follow(&self.views, self.fraction(self.now.step));
        let PyramidLevel { view, full_size } = self.pyramid.level(&self.views, index);
        drop(part);
        let step = Step {
            model: self.model,
            options: &self.options,
            done: self.now.step,
            index,
            view,
            full_size,
            camera: &self.views[index].camera,
            nadir: self.nadir.as_ref(),
            turns: self.now.turns.is_some(),
            held: self.holdout.held(index),
            rates: &rates,
        };
        let tables = &mut self.now.tables;
        let device: &mut dyn Device = match &mut self.device {
            Some(device) => &mut **device,
            None => &mut self.cpu,
        };
        if std::mem::take(&mut self.moved) {
            device.put(tables)?;
        }
        Ok((device.step(&step, tables)?, full_size))
    }

    /// Turns the camera of view `index` further, from the second epoch on.
    fn turn_camera(&mut self, index: usize, turn: DVec3) {
        let (views, step) = (self.views.len(), self.now.step);
        if let Some(turns) = self.now.turns.as_mut().filter(|_| step > views) {
            turns[index] += turn;
            self.place_camera(index);
        }
    }

    /// After each epoch the turns lose what a movement of the scene explains, and cameras that turn out to be right go
    /// back to where they were given, for good.
    fn settle_cameras(&mut self) {
        let (views, step) = (self.views.len(), self.now.step);
        let Some(turns) = self.now.turns.as_mut().filter(|_| step.is_multiple_of(views)) else {
            return;
        };
        let eyes = self
            .cameras
            .iter()
            .map(|camera| camera.eye().unwrap_or(Vec3::Z).as_dvec3());
        without_gauge(turns, &eyes.collect::<Vec<DVec3>>());
        if step >= camera_turns::FIRST_DECISION * views && camera_turns::are_noise(&self.cameras, turns) {
            self.now.turns = None;
        }
        (0..views).for_each(|view| self.place_camera(view));
    }

    /// Puts the camera of view `index` where its turn leaves it.
    fn place_camera(&mut self, index: usize) {
        let turn = self.now.turns.as_ref().map_or(DVec3::ZERO, |turns| turns[index]);
        let camera = turned(&self.cameras[index], turn);
        self.views[index].camera = camera;
        self.pyramid.place_camera(index, &camera);
    }

    /// True if cameras may turn in the steps to come.
    pub fn may_turn_cameras(&self) -> bool {
        self.now.turns.is_some()
    }

    /// Turns of the cameras, by view; empty where cameras stay as they were given, or hardly move.
    pub fn camera_turns(&self) -> Vec<CameraTurn> {
        let cameras = self.views.iter().zip(&self.cameras);
        let found = self.now.turns.iter();
        let found = found.filter(|turns| !camera_turns::are_noise(&self.cameras, turns));
        let turns = cameras.zip(found.flatten());
        let turn = |((view, camera), turn): ((&View, &ProjectiveCamera), &DVec3)| CameraTurn {
            image: view.name.clone(),
            radians: turn.to_array(),
            pixels: moved_px(camera, *turn),
        };
        turns.map(turn).collect()
    }

    /// Counts a rejected step, which must change nothing.
    fn reject(&mut self, fault: &Fault, view: usize) -> Result<(), TrainError> {
        self.now.rejected += 1;
        self.now.rejected_in_a_row += 1;
        let name = &self.views[view].name;
        tracing::warn!(step = self.now.step, view = %name, "step rejected: {fault}");
        if self.now.rejected_in_a_row < REJECTED_LIMIT {
            return Ok(());
        }
        Err(TrainError::NotFinite {
            rejected: self.now.rejected_in_a_row,
            fault: fault.clone(),
            view: name.clone(),
        })
    }

    /// Rates of the update at the end of this step.
    fn rates(&self) -> Rates {
        let o = &self.options;
        let f = self.fraction(self.now.step + 1);
        let mut rates = vec![0.0; FEATURES];
        rates[POSITION] = exponential_decay(o.position_rate_gsd, o.position_rate_gsd * o.final_rate, f) * o.gsd_m;
        let rate_factor = o.rate_factor();
        rates[LOG_SCALE] = rate_factor * LOG_SCALE_RATE;
        rates[ROTATION] = ROTATION_RATE;
        rates[OPACITY] = rate_factor * o.opacity_rate;
        let feature_factor = rate_factor * exponential_decay(1.0, o.final_rate.max(0.1), f);
        rates.extend(self.feature_rates.iter().map(|rate| feature_factor * rate.at(f)));
        let per_gaussian = PHOTOMETRIC_WEIGHT / self.now.tables.parameters.gaussians.count.max(1) as f32;
        Rates {
            gaussians: rates,
            globals: self.global_rates.iter().map(|rate| rate.at(f)).collect(),
            beta1: o.beta1(),
            prior: (
                per_gaussian * o.prior_weights.0 / (3.0 * o.gsd_m),
                per_gaussian * o.prior_weights.1,
            ),
            log_scale: ((o.scale_gsd.0 * o.gsd_m).ln(), (o.scale_gsd.1 * o.gsd_m).ln()),
            opacity: OPACITY_BOUNDS,
        }
    }

    fn control_density(&mut self) -> Result<(), TrainError> {
        let (d, step) = (&self.options.density, self.now.step);
        let due = d.every > 0 && step >= d.from && step.is_multiple_of(d.every);
        if !due || step as f32 > UNTIL_FRACTION * self.options.iterations as f32 {
            return Ok(());
        }
        let _part = stage("density");
        self.fetch()?;
        self.moved = true;
        let (d, tables) = (&self.options.density, &mut self.now.tables);
        let seed = self.options.seed.wrapping_add(step as u64);
        let gaussians = &mut tables.parameters.gaussians;
        let rebuild = tables
            .statistics
            .apply(gaussians, d, self.options.gsd_m, self.bounds, seed);
        tables.gaussians_adam.follow(&rebuild.sources, rebuild.fresh);
        self.cpu.occluders = None;
        tables.cached_visibility.fill(None);
        tables.neighbours = None;
        tracing::debug!(
            step,
            gaussians = gaussians.count,
            pruned = rebuild.pruned,
            added = gaussians.count - rebuild.fresh,
            "density"
        );
        Ok(())
    }
}
