//! Inputs of a fit: images converted for a kind of model, initial Gaussians, shared parameters.

use super::capture::{Capture, Frame};
use super::config::{ModelKind, ObjectConfig};
use super::model::Kind;
use super::pixels::Encoding;
use super::start::{self, Seed, Start};
use super::views::{self, Preparation};
use glam::{Quat, Vec3};
use heliosplat::gaussians::Table;
use heliosplat::model::olat::{Component, Olat, OlatOptions};
use heliosplat::model::radiance::{Radiance, RadianceOptions};
use heliosplat::model::reflective::{Reflective, ReflectiveOptions};
use heliosplat::model::{Parameters, SceneModel};
use heliosplat_grid::statistics::upper_median;
use heliosplat_scene::Split;
use std::f32::consts::PI;

/// Side of the box outside which Gaussians are pruned, relative to the cube that the cameras see or to the hull's box.
const SLACK: f32 = 1.1;
/// Initial opacity of the Gaussians: half, because the hull is only near the surface.
const OPACITY: f32 = 0.5;
/// Weight of the agreement of normals with those of the depth under one lamp at a time; a high one keeps highlights in
/// one piece (docs/lab/objects.md).
const OLAT_NORMALS: f32 = 0.3;
/// Weight of the agreement of normals with those of the depth, in constant surroundings.
const REFLECTIVE_NORMALS: f32 = 0.05;
/// Normals of depths are compared over steps of this many pixels at most.
const EDGE_PX: f64 = 6.0;

/// Conversion of the images of `capture` for a model of `kind`.
fn preparation(capture: &Capture, kind: ModelKind, config: &ObjectConfig) -> Preparation {
    let (background, why) = views::background(capture, config.model.background);
    let [red, green, blue] = background;
    tracing::info!("background: red {red:.2}, green {green:.2}, blue {blue:.2} ({why})");
    let olat = kind == ModelKind::Olat;
    let display = capture.frames.iter().any(|f| f.picture.encoding == Encoding::Display);
    let intensities: Vec<[f64; 3]> = capture.frames.iter().filter_map(|f| f.light?.intensity).collect();
    let median = |k: usize| {
        let mut values: Vec<f64> = intensities.iter().map(|i| i[k]).filter(|&i| i > 0.0).collect();
        upper_median(&mut values).unwrap_or(1.0)
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
        let mut gaussians = start::gaussians(start, OPACITY, Radiance::new(options.clone()).feature_groups());
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
        distance: upper_median(&mut distances).map_or(1.0, |d| d as f32),
        radius: config.model.light_radius,
        normal_weight: OLAT_NORMALS,
        normal_edge: (EDGE_PX * capture.pixel_size) as f32,
        shows: Component::All,
    };
    let model = Olat::new(options.clone());
    let mut gaussians = start::gaussians(start, OPACITY, model.feature_groups());
    for (i, seed) in start.seeds.iter().enumerate() {
        // The median colour is raised: it is seen under slanting light and often in shadow.
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
        width: config.model.network_width,
        hidden: config.model.network_layers,
        half_size: capture.half_size as f32,
        normal_weight: REFLECTIVE_NORMALS,
        normal_edge: (EDGE_PX * capture.pixel_size) as f32,
        display,
        background: preparation.background,
        coverage: preparation.coverage,
        ..ReflectiveOptions::default()
    };
    let model = Reflective::new(options.clone());
    let mut gaussians = start::gaussians(start, OPACITY, model.feature_groups());
    for (i, seed) in start.seeds.iter().enumerate() {
        model.paint(&mut gaussians, i, seed.colour, frame_of(seed));
    }
    let globals = model.initial_globals(config.train.seed);
    (Kind::Reflective(options), Parameters { gaussians, globals })
}

/// The quaternion that turns the z axis to a seed's normal.
fn frame_of(seed: &Seed) -> [f32; 4] {
    let normal = Some(seed.normal).filter(|normal| *normal != Vec3::ZERO);
    Quat::from_rotation_arc(Vec3::Z, normal.unwrap_or(Vec3::Z)).to_array()
}

/// Inputs of a training.
pub(super) struct FitInput {
    /// Kind of model with its options.
    pub(super) kind: Kind,
    /// Conversion of the images.
    pub(super) preparation: Preparation,
    /// Initial parameters.
    pub(super) parameters: Parameters,
    /// Opposite corners of the box outside which Gaussians are pruned, in the frame of the model.
    pub(super) bounds: (Vec3, Vec3),
    /// Place of the initial Gaussians, in words.
    pub(super) how: &'static str,
}

/// Inputs of a fit of a model of `kind` to some frames of `capture`.
pub(super) fn input(capture: &Capture, kind: ModelKind, config: &ObjectConfig, frames: &[&Frame]) -> FitInput {
    let preparation = preparation(capture, kind, config);
    let (points, centre, half_size) = (&capture.points, capture.centre, capture.half_size);
    let start = start::start(frames, points, centre, half_size, &config.start, config.train.seed);
    let (kind, parameters) = begin(capture, kind, config, &preparation, &start);
    FitInput {
        kind,
        preparation,
        parameters,
        bounds: bounds(capture, &start),
        how: start.how,
    }
}

/// The box outside which Gaussians are pruned: a little more than the cube that the cameras see, and for a start on the
/// hull, which contains the object, a little more than its box.
fn bounds(capture: &Capture, start: &Start) -> (Vec3, Vec3) {
    let reach = Vec3::splat(SLACK * capture.half_size as f32);
    if !start.on_hull {
        return (-reach, reach);
    }
    let centres = || start.seeds.iter().map(|seed| seed.position);
    let (low, high) = (centres().fold(reach, Vec3::min), centres().fold(-reach, Vec3::max));
    let slack = (SLACK - 1.0) * (high - low);
    (low - slack, high + slack)
}
