//! Steps on the CPU, on the trainer's own tables.

use super::cached_visibility::CachedVisibility;
use super::camera_turns;
use super::device::{CPU, Descent, Device, Rates, Step, Tables};
use super::fault::{self, TrainError};
use super::holdout;
use crate::gaussians::{FEATURES, LOG_SCALE, OPACITY, Table, sigmoid};
use crate::loss::photometric::photometric;
use crate::loss::shadow::{ConsistencyPass, consistency};
use crate::loss::smoothness::{Neighbours, total_variation};
use crate::model::{Context, Parameters};
use crate::render::{Lit, Pass, PassOptions};
use crate::splat::project::project;
use crate::splat::{Depths, ProjectionOptions};
use crate::timeline::stage;
use crate::trace::{OccluderGradients, Occluders};
use rayon::prelude::*;

/// Steps between two builds of the occluders' hierarchy, if light is traced by one. In between it is refitted to
/// Gaussians that have moved by hundredths of their size.
const HIERARCHY_EVERY: usize = 25;
/// Weight of the photometric loss; the other weights are relative to it.
pub const PHOTOMETRIC_WEIGHT: f32 = 10.0;
/// Share of SSIM in the photometric loss (Kerbl et al. 2023); without it `olat` loses 0.4 dB (docs/lab/objects.md).
pub const LAMBDA_SSIM: f32 = 0.2;

/// Numbers per parallel job; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1 << 14;

/// The processor, with the memory that steps share.
pub(super) struct Cpu {
    gradients: Parameters,
    pub(super) occluders: Option<Occluders>,
    /// Step at which the occluders were made.
    pub(super) occluders_step: usize,
}

impl Device for Cpu {
    fn name(&self) -> &str {
        CPU
    }

    fn step(&mut self, step: &Step, tables: &mut Tables) -> Result<Descent, TrainError> {
        if light_is_due(step, tables) {
            let _part = stage("occluders");
            self.refresh_occluders(step, tables);
        }
        let part = stage("clear");
        self.gradients.gaussians.reset(tables.parameters.gaussians.count);
        self.gradients.globals.reset(1);
        drop(part);
        let mut descent = self.descend_view(step, tables);
        if consistency_is_due(step) {
            let _part = stage("shadow consistency");
            let loss = self.descend_consistency(step, tables);
            descent.losses.push(("shadow_consistency", loss));
        }
        if step.options.smoothness_weight > 0.0 {
            let _part = stage("smoothness");
            descent
                .losses
                .push(("smoothness", self.descend_smoothness(step, tables)));
        }
        let part = stage("check");
        descent.rejected = fault::of_step(&descent.losses, &self.gradients);
        drop(part);
        if descent.rejected.is_none() {
            let _part = stage("update");
            update(tables, &mut self.gradients, step.rates);
        } else {
            // The cached visibility of a rejected step may be unsound.
            tables.cached_visibility[step.index] = None;
        }
        Ok(descent)
    }
}

/// True if this step traces light: for its view, or for shadow consistency.
fn light_is_due(step: &Step, tables: &Tables) -> bool {
    let cached = tables.cached_visibility[step.index]
        .as_ref()
        .is_some_and(|cached| cached.is_fresh(step.options.light_every));
    (!cached && step.view.light.is_some()) || consistency_is_due(step)
}

/// Gradients of light that reach occluders in this step.
fn occluder_gradients(step: &Step) -> OccluderGradients {
    match step.options.occluder_gradients {
        true => OccluderGradients::Sampled {
            seed: step.options.seed.wrapping_mul(1_000_003) ^ step.done as u64,
        },
        false => OccluderGradients::None,
    }
}

fn consistency_is_due(step: &Step) -> bool {
    step.options.consistency_weight > 0.0 && step.done.is_multiple_of(step.options.consistency_every.max(1))
}

impl Cpu {
    /// The processor, for tables like `parameters`.
    pub(super) fn new(parameters: &Parameters) -> Self {
        Self {
            gradients: parameters.zeros_like(),
            occluders: None,
            occluders_step: 0,
        }
    }

    /// Occluders are always those of the current step. A hierarchy over them, where one is used, is expensive to build:
    /// it is refitted to them, and rebuilt after some steps or when the number of Gaussians changes. Light passes
    /// through those that are not in the view.
    fn refresh_occluders(&mut self, step: &Step, tables: &Tables) {
        if !step.model.needs_transmittance() {
            return;
        }
        let gaussians = &tables.parameters.gaussians;
        let fresh = step.done < self.occluders_step + HIERARCHY_EVERY;
        match &mut self.occluders {
            Some(occluders) if fresh && occluders.list.len() == gaussians.count => occluders.renew(gaussians),
            occluders => {
                *occluders = Some(Occluders::tracing_by(step.options.sun_visibility, gaussians));
                self.occluders_step = step.done;
            }
        }
        let appearance = Some(step.view.appearance);
        let present = step.model.present(&tables.parameters, appearance);
        if let (Some(occluders), Some(present)) = (&mut self.occluders, present) {
            occluders.hide(&present);
        }
    }

    fn descend_view(&mut self, step: &Step, tables: &mut Tables) -> Descent {
        let (options, view, index) = (step.options, step.view, step.index);
        let context = Context {
            parameters: &tables.parameters,
            camera: &view.camera,
            light: view.light,
            appearance: Some(view.appearance),
        };
        let pass_options = PassOptions {
            projection: ProjectionOptions::default(),
            occluder_gradients: occluder_gradients(step),
            normals: false,
            depths: Depths::Mean,
        };
        let before = tables.cached_visibility[index].take();
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
        let pass = Pass::new(step.model, context, lit, pass_options);
        let part = stage("losses");
        let image = pass.image();
        let truth = view.truth(&image);
        let (photo, mut d_image) = photometric(&image, &truth, &view.weight, LAMBDA_SSIM);
        let scaled = d_image.values.par_iter_mut().with_min_len(CHUNK);
        scaled.for_each(|d| *d *= PHOTOMETRIC_WEIGHT);
        let held_out = step
            .full_size
            .then(|| holdout::loss(step.held, &image, &truth))
            .flatten();
        let mut losses = vec![("photometric", photo)];
        let mut d_maps = pass.zero_gradients();
        step.model
            .compose_backward(&context, &pass.maps, &d_image, &mut d_maps, &mut self.gradients);
        losses.extend(step.model.map_losses(&context, &pass.maps, &mut d_maps));
        if let Some(prior) = &view.visibility_prior {
            losses.extend(
                step.model
                    .light_prior_loss(&pass.maps, prior, &view.weight, &mut d_maps),
            );
        }
        let turn = step
            .turns
            .then(|| camera_turns::toward(&view.camera, &image, &truth, &view.weight));
        let l1 = mean_absolute(&image.values, &truth.values);
        let pairs = pass.maps.pairs;
        drop((image, d_image));
        drop(part);
        let behind = pass.backward(d_maps, &mut self.gradients);
        let _part = stage("statistics");
        tables.statistics.add(
            &behind.projected,
            &behind.splats,
            view.camera.width * view.camera.height,
        );
        let traced = cached.is_none().then(|| {
            let count = tables.parameters.gaussians.count;
            CachedVisibility::traced(
                (&behind.projected.gaussian, count),
                &behind.transmittances,
                &behind.d_transmittances,
                before.as_ref(),
            )
        });
        tables.cached_visibility[index] = traced.or_else(|| before.map(CachedVisibility::used));
        Descent {
            losses,
            l1,
            held_out,
            pairs,
            turn: turn.flatten(),
            rejected: None,
        }
    }

    /// Shadow consistency: in turn for the step's own view and, where there is one, from the zenith.
    fn descend_consistency(&mut self, step: &Step, tables: &Tables) -> f64 {
        let turn = step.done / step.options.consistency_every.max(1);
        let camera = match step.nadir {
            Some(nadir) if turn % 2 == 1 => nadir,
            _ => step.camera,
        };
        let Some(occluders) = &self.occluders else { return 0.0 };
        let gaussians = &tables.parameters.gaussians;
        let projection = ProjectionOptions::default();
        let mut projected = project(gaussians, camera, &projection);
        let appearance = Some(step.view.appearance);
        if let Some(present) = step.model.present(&tables.parameters, appearance) {
            projected.keep(&present);
        }
        let pass = ConsistencyPass {
            camera,
            projection: &projection,
            occluder_gradients: occluder_gradients(step),
            occluders,
            // Evaluated on one step in `consistency_every` only, with a weight larger by that factor.
            weight: step.options.consistency_weight * step.options.consistency_every.max(1) as f32,
        };
        consistency(gaussians, &projected, &pass, &mut self.gradients.gaussians)
    }

    /// Smoothness of the model's first feature, in the units of a mean over the pixels of the step's view.
    fn descend_smoothness(&mut self, step: &Step, tables: &mut Tables) -> f64 {
        let gaussians = &tables.parameters.gaussians;
        let Some(feature) = gaussians.groups.get(FEATURES) else {
            return 0.0;
        };
        let neighbours = tables
            .neighbours
            .get_or_insert_with(|| Neighbours::new(gaussians, step.options.gsd_m));
        let camera = step.camera;
        total_variation(
            neighbours,
            (&feature.values, feature.spec.width),
            camera.width * camera.height,
            PHOTOMETRIC_WEIGHT * step.options.smoothness_weight,
            self.gradients.gaussians.group_mut(FEATURES),
        )
    }
}

/// Adds the gradients of the prior, see [`Rates::prior`].
fn add_prior(gaussians: &Table, (scale, opacity): (f32, f32), gradients: &mut Table) {
    let mut add = |group: usize, slope: &(dyn Fn(f32) -> f32 + Sync)| {
        let slots = gradients.group_mut(group).par_iter_mut().with_min_len(CHUNK);
        slots
            .zip(gaussians.group(group))
            .for_each(|(slot, value)| *slot += slope(*value));
    };
    if scale > 0.0 {
        add(LOG_SCALE, &|log_scale| scale * log_scale.exp());
    }
    if opacity > 0.0 {
        add(OPACITY, &|logit| {
            let absorbed = sigmoid(logit);
            opacity * absorbed * (1.0 - absorbed)
        });
    }
}

/// Adds the gradients of the prior, takes a step of Adam, and keeps scales and opacities in bounds.
pub fn update(tables: &mut Tables, gradients: &mut Parameters, rates: &Rates) {
    let Parameters { gaussians, globals } = &mut tables.parameters;
    add_prior(gaussians, rates.prior, &mut gradients.gaussians);
    tables
        .gaussians_adam
        .step_with(rates.beta1, gaussians, &gradients.gaussians, &rates.gaussians);
    tables
        .globals_adam
        .step_with(rates.beta1, globals, &gradients.globals, &rates.globals);
    let mut clamp = |group: usize, (least, most): (f32, f32)| {
        let values = gaussians.group_mut(group).par_iter_mut();
        values.for_each(|value| *value = value.clamp(least, most));
    };
    clamp(LOG_SCALE, rates.log_scale);
    clamp(OPACITY, rates.opacity);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::{POSITION, core_groups, logit};

    #[test]
    fn the_prior_has_the_slopes_of_summed_scales_and_opacities() {
        let mut gaussians = Table::zeros(core_groups(), 2);
        gaussians
            .group_mut(LOG_SCALE)
            .copy_from_slice(&[0.1, -0.7, 0.4, 1.0, -2.0, 0.0]);
        gaussians.group_mut(OPACITY).copy_from_slice(&[logit(0.2), logit(0.9)]);
        let (scale, opacity) = (0.3, 0.7);
        let prior = |gaussians: &Table| -> f32 {
            let scales = gaussians.group(LOG_SCALE).iter().map(|log| scale * log.exp());
            let opacities = gaussians.group(OPACITY).iter().map(|&logit| opacity * sigmoid(logit));
            scales.chain(opacities).sum()
        };
        let mut gradients = gaussians.zeros_like();
        add_prior(&gaussians, (scale, opacity), &mut gradients);
        for (group, numbers) in [(LOG_SCALE, 6), (OPACITY, 2)] {
            for number in 0..numbers {
                let moved = |by: f32| {
                    let mut moved = gaussians.clone();
                    moved.group_mut(group)[number] += by;
                    prior(&moved)
                };
                let slope = (moved(1e-2) - moved(-1e-2)) / 2e-2;
                assert!(
                    (gradients.group(group)[number] - slope).abs() < 1e-3,
                    "{group} {number}"
                );
            }
        }
        assert!(gradients.group(POSITION).iter().all(|d| *d == 0.0));
    }
}
