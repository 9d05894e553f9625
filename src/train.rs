//! The trainer: one view per step, for any model.

mod cached_visibility;
mod checkpoint;
mod fault;
mod holdout;
mod options;
mod pyramid;

pub use checkpoint::{STATE_VERSION, StateError, TrainerState};
pub use fault::{Fault, TrainError};
pub use holdout::EarlyStop;
pub use options::TrainOptions;

use crate::camera::ProjectiveCamera;
use crate::gaussians::{FEATURES, LOG_SCALE, OPACITY, POSITION, ROTATION};
use crate::loss::photometric::photometric;
use crate::loss::shadow::{ConsistencyPass, consistency};
use crate::loss::smoothness::{Neighbours, total_variation};
use crate::model::{Context, NamedLoss, Parameters, SceneModel, View};
use crate::optim::density::UNTIL_FRACTION;
use crate::optim::{Adam, DensityStatistics, LearningRate, ParameterGroup, exponential_decay};
use crate::render::{Lit, Pass, PassOptions};
use crate::splat::project::project;
use crate::splat::{Depths, ProjectionOptions};
use crate::timeline::stage;
use crate::trace::{OccluderGradients, Occluders};
use cached_visibility::CachedVisibility;
use glam::Vec3;
use holdout::Holdout;
use pyramid::{Pyramid, PyramidLevel};
use rand::{SeedableRng, seq::SliceRandom};
use rand_pcg::Pcg32;
use rayon::prelude::*;

/// Rejected steps in a row, or steps that saw no Gaussian, after which training stops.
const REJECTED_LIMIT: usize = 20;
/// Steps between two builds of the occluders' hierarchy, if light is traced by one. In between it is refitted to
/// Gaussians that have moved by hundredths of their size.
const HIERARCHY_EVERY: usize = 25;
/// Learning rate of log scales.
const LOG_SCALE_RATE: f32 = 5e-3;
/// Learning rate of rotations.
const ROTATION_RATE: f32 = 2e-3;
/// Weight of the photometric loss; the other weights are relative to it.
const PHOTOMETRIC_WEIGHT: f32 = 10.0;
/// Share of SSIM in the photometric loss (Kerbl et al. 2023); without it `olat` loses 0.4 dB (docs/lab/objects.md).
const LAMBDA_SSIM: f32 = 0.2;

/// Numbers per parallel job; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1 << 14;

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
    parameters: Parameters,
    gaussians_adam: Adam,
    globals_adam: Adam,
    statistics: DensityStatistics,
    cached_visibility: Vec<Option<CachedVisibility>>,
    /// Neighbours of the Gaussians when their number last changed; the current positions do not determine them.
    neighbours: Option<Neighbours>,
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
    options: TrainOptions,
    nadir: Option<ProjectiveCamera>,
    bounds: (Vec3, Vec3),
    now: StepState,
    /// Learning rates of the model's groups, in the order of the tables; those of the core groups are options.
    feature_rates: Vec<LearningRate>,
    global_rates: Vec<LearningRate>,
    holdout: Holdout,
    pyramid: Pyramid,
    gradients: Parameters,
    occluders: Option<Occluders>,
    occluders_step: usize,
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
            gradients: parameters.zeros_like(),
            occluders: None,
            occluders_step: 0,
            order: Vec::new(),
            now: StepState {
                gaussians_adam: Adam::new(&parameters.gaussians),
                globals_adam: Adam::new(&parameters.globals),
                statistics: DensityStatistics::new(parameters.gaussians.count),
                cached_visibility: vec![None; views.len()],
                neighbours: None,
                step: 0,
                rejected: 0,
                rejected_in_a_row: 0,
                unseen_in_a_row: 0,
                parameters,
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

    /// The trained parameters.
    pub fn parameters(&self) -> &Parameters {
        &self.now.parameters
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
        let best = self.holdout.into_best().unwrap_or(self.now.parameters);
        (best, summary, self.views)
    }

    fn fraction(&self) -> f32 {
        self.now.step as f32 / self.options.iterations.max(1) as f32
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

    /// True if this step traces light: for its view, or for shadow consistency.
    fn light_is_due(&self, index: usize) -> bool {
        let cached = self.now.cached_visibility[index]
            .as_ref()
            .is_some_and(|cached| cached.is_fresh(self.options.light_every));
        (!cached && self.views[index].light.is_some()) || self.consistency_is_due()
    }

    /// Gradients of light that reach occluders in this step.
    fn occluder_gradients(&self) -> OccluderGradients {
        match self.options.occluder_gradients {
            true => OccluderGradients::Sampled {
                seed: self.options.seed.wrapping_mul(1_000_003) ^ self.now.step as u64,
            },
            false => OccluderGradients::None,
        }
    }

    fn consistency_is_due(&self) -> bool {
        self.options.consistency_weight > 0.0 && self.now.step.is_multiple_of(self.options.consistency_every.max(1))
    }

    /// Occluders are always those of the current step. A hierarchy over them, where one is used, is expensive to build:
    /// it is refitted to them, and rebuilt after some steps or when the number of Gaussians changes. Light passes
    /// through those that are not in the view.
    fn refresh_occluders(&mut self, view: usize) {
        if !self.model.needs_transmittance() {
            return;
        }
        let gaussians = &self.now.parameters.gaussians;
        let fresh = self.now.step < self.occluders_step + HIERARCHY_EVERY;
        match &mut self.occluders {
            Some(occluders) if fresh && occluders.list.len() == gaussians.count => occluders.renew(gaussians),
            occluders => {
                *occluders = Some(Occluders::tracing_by(self.options.sun_visibility, gaussians));
                self.occluders_step = self.now.step;
            }
        }
        let appearance = Some(self.views[view].appearance);
        let present = self.model.present(&self.now.parameters, appearance);
        if let (Some(occluders), Some(present)) = (&mut self.occluders, present) {
            occluders.hide(&present);
        }
    }

    /// Runs one step.
    ///
    /// A step whose losses or gradients are not finite changes nothing but the counts of steps and of rejected ones.
    ///
    /// # Errors
    /// When too many steps in a row are rejected or see no Gaussian, or none is left. The parameters are then those of
    /// the last good state.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let index = self.next_view();
        if self.light_is_due(index) {
            let _part = stage("occluders");
            self.refresh_occluders(index);
        }
        let part = stage("clear");
        self.gradients.gaussians.reset(self.now.parameters.gaussians.count);
        self.gradients.globals.reset(1);
        drop(part);
        let mut report = self.descend_view(index);
        if self.consistency_is_due() {
            let _part = stage("shadow consistency");
            report
                .losses
                .push(("shadow_consistency", self.descend_consistency(index)));
        }
        if self.options.smoothness_weight > 0.0 {
            let _part = stage("smoothness");
            report.losses.push(("smoothness", self.descend_smoothness(index)));
        }
        self.now.step += 1;
        report.step = self.now.step;
        let part = stage("check");
        report.rejected = fault::of_step(&report.losses, &self.gradients);
        drop(part);
        match &report.rejected {
            None => {
                self.now.rejected_in_a_row = 0;
                let _part = stage("update");
                self.update();
                self.control_density();
            }
            Some(fault) => self.reject(fault, index)?,
        }
        let (views, unseen) = (self.views.len(), &mut self.now.unseen_in_a_row);
        *unseen = if report.pairs == 0 { *unseen + 1 } else { 0 };
        if *unseen >= REJECTED_LIMIT.max(views) {
            return Err(TrainError::NothingSeen { steps: *unseen });
        }
        let part = stage("hold out");
        self.holdout.epoch_done(report.step, views, &self.now.parameters);
        drop(part);
        report.gaussians = self.now.parameters.gaussians.count;
        if report.gaussians == 0 {
            return Err(TrainError::Empty);
        }
        Ok(report)
    }

    /// Counts a rejected step, which must change nothing.
    fn reject(&mut self, fault: &Fault, view: usize) -> Result<(), TrainError> {
        self.now.rejected += 1;
        self.now.rejected_in_a_row += 1;
        // The cached visibility of a rejected step may be unsound.
        self.now.cached_visibility[view] = None;
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

    fn descend_view(&mut self, index: usize) -> StepReport {
        let part = stage("view");
        self.pyramid.follow(&self.views, self.fraction());
        let PyramidLevel { view, full_size } = self.pyramid.level(&self.views, index);
        drop(part);
        let options = &self.options;
        let context = Context {
            parameters: &self.now.parameters,
            camera: &view.camera,
            light: view.light,
            appearance: Some(view.appearance),
        };
        let pass_options = PassOptions {
            projection: ProjectionOptions::default(),
            occluder_gradients: self.occluder_gradients(),
            normals: false,
            depths: Depths::Mean,
        };
        let before = self.now.cached_visibility[index].take();
        let cached = before.as_ref().filter(|before| before.is_fresh(options.light_every));
        let kept = before
            .as_ref()
            .and_then(|before| before.kept(options.negligible_light_every));
        let lit = match (cached, &self.occluders, &before, &kept) {
            (Some(cached), ..) => Lit::Given(&cached.values),
            (None, Some(occluders), Some(before), Some(kept)) => Lit::TracedExcept {
                occluders,
                known: &before.values,
                kept,
            },
            (None, Some(occluders), ..) => Lit::Traced(occluders),
            (None, None, ..) => Lit::Everywhere,
        };
        let pass = Pass::new(self.model, context, lit, pass_options);
        let part = stage("losses");
        let image = pass.image();
        let truth = view.truth(&image);
        let (photo, mut d_image) = photometric(&image, &truth, &view.weight, LAMBDA_SSIM);
        let scaled = d_image.values.par_iter_mut().with_min_len(CHUNK);
        scaled.for_each(|d| *d *= PHOTOMETRIC_WEIGHT);
        let held_out = full_size.then(|| self.holdout.loss(index, &image, &truth)).flatten();
        let mut losses = vec![("photometric", photo)];
        let mut d_maps = pass.zero_gradients();
        self.model
            .compose_backward(&context, &pass.maps, &d_image, &mut d_maps, &mut self.gradients);
        losses.extend(self.model.map_losses(&context, &pass.maps, &mut d_maps));
        if let Some(prior) = &view.visibility_prior {
            losses.extend(
                self.model
                    .light_prior_loss(&pass.maps, prior, &view.weight, &mut d_maps),
            );
        }
        let l1 = mean_absolute(&image.values, &truth.values);
        let pairs = pass.maps.pairs;
        drop((image, d_image));
        drop(part);
        let behind = pass.backward(d_maps, &mut self.gradients);
        let _part = stage("statistics");
        self.now.statistics.add(
            &behind.projected,
            &behind.splats,
            view.camera.width * view.camera.height,
        );
        let traced = cached.is_none().then(|| {
            let count = self.now.parameters.gaussians.count;
            CachedVisibility::traced(
                (&behind.projected.gaussian, count),
                &behind.transmittances,
                &behind.d_transmittances,
                before.as_ref(),
            )
        });
        self.now.cached_visibility[index] = traced.or_else(|| before.map(CachedVisibility::used));
        if full_size {
            self.holdout.record(index, held_out);
        }
        StepReport {
            view: index,
            losses,
            l1,
            pairs,
            ..StepReport::default()
        }
    }

    /// Shadow consistency: in turn for the step's own view and, where there is one, from the zenith.
    fn descend_consistency(&mut self, index: usize) -> f64 {
        let turn = self.now.step / self.options.consistency_every.max(1);
        let camera = match &self.nadir {
            Some(nadir) if turn % 2 == 1 => nadir,
            _ => &self.views[index].camera,
        };
        let Some(occluders) = &self.occluders else { return 0.0 };
        let gaussians = &self.now.parameters.gaussians;
        let projection = ProjectionOptions::default();
        let mut projected = project(gaussians, camera, &projection);
        let appearance = Some(self.views[index].appearance);
        if let Some(present) = self.model.present(&self.now.parameters, appearance) {
            projected.keep(&present);
        }
        let pass = ConsistencyPass {
            camera,
            projection: &projection,
            occluder_gradients: self.occluder_gradients(),
            occluders,
            // Evaluated on one step in `consistency_every` only, with a weight larger by that factor.
            weight: self.options.consistency_weight * self.options.consistency_every.max(1) as f32,
        };
        consistency(gaussians, &projected, &pass, &mut self.gradients.gaussians)
    }

    /// Smoothness of the model's first feature, in the units of a mean over the pixels of the step's view.
    fn descend_smoothness(&mut self, index: usize) -> f64 {
        let gaussians = &self.now.parameters.gaussians;
        let Some(feature) = gaussians.groups.get(FEATURES) else {
            return 0.0;
        };
        let neighbours = self
            .now
            .neighbours
            .get_or_insert_with(|| Neighbours::new(gaussians, self.options.gsd_m));
        let camera = &self.views[index].camera;
        total_variation(
            neighbours,
            (&feature.values, feature.spec.width),
            camera.width * camera.height,
            PHOTOMETRIC_WEIGHT * self.options.smoothness_weight,
            self.gradients.gaussians.group_mut(FEATURES),
        )
    }

    fn update(&mut self) {
        let o = &self.options;
        let f = self.fraction();
        let mut rates = vec![0.0; FEATURES];
        rates[POSITION] = exponential_decay(o.position_rate_gsd, o.position_rate_gsd * o.final_rate, f) * o.gsd_m;
        let rate_factor = o.rate_factor();
        rates[LOG_SCALE] = rate_factor * LOG_SCALE_RATE;
        rates[ROTATION] = ROTATION_RATE;
        rates[OPACITY] = rate_factor * o.opacity_rate;
        let feature_factor = rate_factor * exponential_decay(1.0, o.final_rate.max(0.1), f);
        rates.extend(self.feature_rates.iter().map(|rate| feature_factor * rate.at(f)));
        let beta1 = o.beta1();
        let (now, gradients) = (&mut self.now, &self.gradients);
        let Parameters { gaussians, globals } = &mut now.parameters;
        now.gaussians_adam
            .step_with(beta1, gaussians, &gradients.gaussians, &rates);
        let rates: Vec<f32> = self.global_rates.iter().map(|rate| rate.at(f)).collect();
        now.globals_adam.step_with(beta1, globals, &gradients.globals, &rates);
        let (least, most) = ((o.scale_gsd.0 * o.gsd_m).ln(), (o.scale_gsd.1 * o.gsd_m).ln());
        let mut clamp = |group: usize, least: f32, most: f32| {
            let values = gaussians.group_mut(group).par_iter_mut();
            values.for_each(|value| *value = value.clamp(least, most));
        };
        clamp(LOG_SCALE, least, most);
        clamp(OPACITY, -12.0, 12.0);
    }

    fn control_density(&mut self) {
        let (d, now, gsd_m) = (&self.options.density, &mut self.now, self.options.gsd_m);
        let due = d.every > 0 && now.step >= d.from && now.step.is_multiple_of(d.every);
        if !due || now.step as f32 > UNTIL_FRACTION * self.options.iterations as f32 {
            return;
        }
        let seed = self.options.seed.wrapping_add(now.step as u64);
        let gaussians = &mut now.parameters.gaussians;
        let rebuild = now.statistics.apply(gaussians, d, gsd_m, self.bounds, seed);
        now.gaussians_adam.follow(&rebuild.sources, rebuild.fresh);
        self.occluders = None;
        now.cached_visibility.fill(None);
        now.neighbours = None;
        tracing::debug!(
            step = now.step,
            gaussians = gaussians.count,
            pruned = rebuild.pruned,
            added = gaussians.count - rebuild.fresh,
            "density"
        );
    }
}

fn mean_absolute(a: &[f32], b: &[f32]) -> f64 {
    let of_chunk = |(a, b): (&[f32], &[f32])| {
        let (mut sum, mut count) = (0.0f64, 0usize);
        for (a, b) in a.iter().zip(b) {
            if b.is_finite() {
                sum += f64::from((a - b).abs());
                count += 1;
            }
        }
        (sum, count)
    };
    let chunks: Vec<(f64, usize)> = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK)).map(of_chunk).collect();
    let (sum, count) = chunks.iter().fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    sum / count.max(1) as f64
}
