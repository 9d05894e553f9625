//! From a capture to a trained model.

use super::capture::{Capture, Frame};
use super::config::{ModelKind, ObjectConfig};
use super::measure;
use super::pixels::Encoding;
use super::plan::{self, Plan};
use super::run::{self, Kind, ObjectModel};
use super::start::{self, Seed, Start};
use super::views::{self, Preparation};
use crate::cli::Session;
use crate::run::checkpoint::{Keeper, Kept};
use crate::satellite::budget::Budget;
use crate::satellite::fit::{CurvePoint, Ending, FitError, train};
use crate::scene::Split;
use glam::{Quat, Vec3};
use heliosplat::gaussians::Table;
use heliosplat::model::olat::{Component, Olat, OlatOptions};
use heliosplat::model::radiance::{Radiance, RadianceOptions};
use heliosplat::model::reflective::{Reflective, ReflectiveOptions};
use heliosplat::model::{Parameters, SceneModel, View};
use heliosplat::train::Trainer;
use std::f32::consts::PI;
use std::time::Instant;

/// Gaussians that leave the cube that cameras see by this much of it are pruned.
const SLACK: f32 = 1.1;
/// How much normals agree with those of the depth where the configuration leaves it open: under one lamp at a time, where a firm hold
/// keeps highlights in one piece (docs/lab/objects.md).
const OLAT_NORMALS: f32 = 0.3;
/// And in surroundings that stay.
const REFLECTIVE_NORMALS: f32 = 0.05;
/// Normals of depths are compared over steps of this many pixels at most.
const EDGE_PX: f64 = 6.0;

/// A trained model and how it came about.
pub struct Fitted {
    /// The model.
    pub model: ObjectModel,
    /// What was fitted, and why.
    pub plan: Plan,
    /// How Gaussians started, in words.
    pub start: &'static str,
    /// How many did.
    pub started: usize,
    /// Steps done.
    pub iterations: usize,
    /// Steps rejected because of a number that is not finite.
    pub rejected: usize,
    /// Seconds before training and in it.
    pub seconds: [f64; 2],
    /// The course of training.
    pub curve: Vec<CurvePoint>,
    /// How training ended.
    pub ending: Ending,
}

/// What the images of `capture` are made for a model of `kind`.
fn preparation(capture: &Capture, kind: ModelKind, config: &ObjectConfig) -> Preparation {
    let (background, why) = views::background(capture, config.model.background);
    tracing::info!(?background, why, "background");
    let olat = kind == ModelKind::Olat;
    let display = capture.frames.iter().any(|f| f.picture.encoding == Encoding::Display);
    let intensities: Vec<[f64; 3]> = capture.frames.iter().filter_map(|f| f.light?.intensity).collect();
    let median = |k: usize| {
        let mut values: Vec<f64> = intensities.iter().map(|i| i[k]).filter(|&i| i > 0.0).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(1.0)
    };
    Preparation {
        background,
        coverage: capture.has_coverage(),
        // Light adds up in linear values only.
        linear: olat && display,
        unit_light: (olat && !intensities.is_empty()).then(|| [median(0), median(1), median(2)]),
    }
}

/// The model of a capture, and its parameters at the start.
fn begin(
    capture: &Capture,
    kind: ModelKind,
    config: &ObjectConfig,
    preparation: &Preparation,
    start: &Start,
) -> (Kind, Parameters) {
    let Preparation {
        background, coverage, ..
    } = *preparation;
    if kind == ModelKind::Reflective {
        return begin_reflective(capture, config, preparation, start);
    }
    if kind != ModelKind::Olat {
        let options = RadianceOptions {
            degree: config.model.sh_degree,
            background,
            coverage,
        };
        let mut gaussians = start::gaussians(
            start,
            config.start.opacity,
            Radiance::new(options.clone()).feature_groups(),
        );
        for (i, seed) in start.seeds.iter().enumerate() {
            Radiance::paint(&mut gaussians, i, seed.colour);
        }
        let globals = Table::zeros(Vec::new(), 1);
        return (Kind::Radiance(options), Parameters { gaussians, globals });
    }
    let mut distances: Vec<f64> = capture
        .of(Split::Train)
        .filter_map(|f| Some((f.light?.position - capture.centre).length()))
        .collect();
    distances.sort_by(f64::total_cmp);
    let options = OlatOptions {
        specular: config.model.specular,
        shadow: config.model.shadow,
        scattering: config.model.scattering,
        refined: config.model.refined_shadow && config.model.shadow,
        width: config.model.network_width,
        hidden: config.model.network_layers,
        half_size: capture.half_size as f32,
        background,
        coverage,
        distance: distances.get(distances.len() / 2).map_or(1.0, |&d| d as f32),
        radius: config.model.light_radius,
        normal_weight: config.model.normal_weight.unwrap_or(OLAT_NORMALS),
        normal_edge: (EDGE_PX * capture.pixel_size) as f32,
        shows: Component::All,
    };
    let model = Olat::new(options.clone());
    let mut gaussians = start::gaussians(start, config.start.opacity, model.feature_groups());
    for (i, seed) in start.seeds.iter().enumerate() {
        // Seen in the median under slanting light and often in shadow.
        let colour = seed.colour.map(|c| (2.0 * PI * c).clamp(0.05, 3.0));
        model.paint(&mut gaussians, i, colour, frame_of(seed));
    }
    let globals = model.initial_globals();
    (Kind::Olat(options), Parameters { gaussians, globals })
}

/// A reflective model at the start.
fn begin_reflective(
    capture: &Capture,
    config: &ObjectConfig,
    preparation: &Preparation,
    start: &Start,
) -> (Kind, Parameters) {
    let display = !preparation.linear && capture.frames.iter().any(|f| f.picture.encoding == Encoding::Display);
    let options = ReflectiveOptions {
        specular: config.model.specular,
        degree: config.model.sh_degree,
        width: config.model.decoder_width,
        hidden: config.model.decoder_layers,
        half_size: capture.half_size as f32,
        normal_weight: config.model.normal_weight.unwrap_or(REFLECTIVE_NORMALS),
        normal_edge: (EDGE_PX * capture.pixel_size) as f32,
        display,
        background: preparation.background,
        coverage: preparation.coverage,
        ..ReflectiveOptions::default()
    };
    let model = Reflective::new(options.clone());
    let mut gaussians = start::gaussians(start, config.start.opacity, model.feature_groups());
    for (i, seed) in start.seeds.iter().enumerate() {
        model.paint(&mut gaussians, i, seed.colour, frame_of(seed));
    }
    let globals = model.initial_globals(config.train.seed);
    (Kind::Reflective(options), Parameters { gaussians, globals })
}

/// The quaternion that turns the z axis to a seed's normal.
fn frame_of(seed: &Seed) -> [f32; 4] {
    let normal = if seed.normal == Vec3::ZERO {
        Vec3::Z
    } else {
        seed.normal
    };
    Quat::from_rotation_arc(Vec3::Z, normal).to_array()
}

/// What training begins with.
pub(super) struct FitInput {
    /// The model.
    pub(super) kind: Kind,
    /// What images are made.
    pub(super) preparation: Preparation,
    /// Where parameters start.
    pub(super) parameters: Parameters,
    /// How Gaussians started, in words.
    pub(super) how: &'static str,
}

/// What a fit of a model of `kind` to some frames of `capture` begins with.
pub(super) fn input(capture: &Capture, kind: ModelKind, config: &ObjectConfig, frames: &[&Frame]) -> FitInput {
    let preparation = preparation(capture, kind, config);
    let (centre, half_size) = (capture.centre, capture.half_size);
    let start = start::start(frames, centre, half_size, &config.start, config.train.seed);
    let (kind, parameters) = begin(capture, kind, config, &preparation, &start);
    FitInput {
        kind,
        preparation,
        parameters,
        how: start.how,
    }
}

/// Gaussians that leave this are pruned.
pub(super) fn bounds(capture: &Capture) -> (Vec3, Vec3) {
    let reach = Vec3::splat(SLACK * capture.half_size as f32);
    (-reach, reach)
}

/// Fits a model to `capture`, or goes on from where a fit of it was interrupted; `keeper` keeps its state meanwhile.
///
/// # Errors
/// [`FitError`] when training gives up.
pub fn fit(
    capture: &Capture,
    config: &ObjectConfig,
    session: &Session,
    budget: Option<Budget>,
    mut keeper: Keeper,
    kept: Option<Kept>,
) -> Result<Fitted, FitError> {
    let begun = Instant::now();
    let plan = plan::plan(capture, config, session)?;
    tracing::info!(kind = ?plan.kind, specular = plan.specular, scattering = plan.scattering, why = plan.reason, "model");
    let mut planned = config.clone();
    planned.model.specular = plan.specular;
    planned.model.scattering = plan.scattering;
    let frames: Vec<&Frame> = capture.of(Split::Train).collect();
    let FitInput {
        kind,
        preparation,
        parameters,
        how,
    } = input(capture, plan.kind, &planned, &frames);
    tracing::info!(gaussians = parameters.gaussians.count, how, "start");
    let model = kind.model();
    let views: Vec<View> = frames
        .iter()
        .enumerate()
        .filter_map(|(i, frame)| views::view(frame, capture.centre, &preparation, i))
        .collect();
    let mut options = config.train.clone().for_views(views.len());
    options.gsd_m = capture.pixel_size as f32;
    let steps = options.iterations;
    let started = parameters.gaussians.count;
    let begins = parameters.globals.clone();
    let prepared = begun.elapsed();
    let mut trainer = Trainer::new(&*model, views, parameters, options, bounds(capture), None)?;
    if let Some(kept) = kept {
        tracing::info!(step = kept.trainer.steps(), of = steps, "training goes on");
        keeper.course = kept.course;
        trainer
            .restore(kept.trainer)
            .map_err(|error| keeper.does_not_fit(&error))?;
    }
    let probe = measure::psnr_probe(capture, run::file(capture, config, kind.clone(), preparation, begins));
    let trained = train(trainer, steps, session, budget, keeper, probe.as_deref())?;
    let file = run::file(capture, config, kind, preparation, trained.parameters.globals.clone());
    Ok(Fitted {
        model: ObjectModel {
            model: file.kind.model(),
            parameters: trained.parameters,
            file,
        },
        plan,
        start: how,
        started,
        iterations: trained.early_stop.steps,
        rejected: trained.rejected,
        seconds: [prepared.as_secs_f64(), (begun.elapsed() - prepared).as_secs_f64()],
        curve: trained.curve,
        ending: trained.ending,
    })
}
