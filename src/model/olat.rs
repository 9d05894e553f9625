//! One light at a time (OLAT): surfaces under a known point light, with traced shadow, shared specular lobes and
//! subsurface scattering.
//!
//! After SSD-GS (2026) and GS³ (Bi et al. 2024), per Gaussian and evaluated at its centre, for a light of unit strength
//!
//! ```text
//! C = ((c_d f_d + c_s f_s) S + c_v f_v) · D² / (d² + r²)
//! f_d = cosE(n·ω_i) / π                    cosE(c) = (ELU(c) + t) / (1 + t): a cosine with a gradient on the dark side
//! f_s = Σ_j a_j G_j(h) · F(ω_i·h) / (ω_i·h)² · cosE(n·ω_i)        eight shared lobes, Schlick's F, F0 per Gaussian
//! f_v = R(r; σ_s', σ_a)        subsurface scattering: a dipole whose three numbers a network predicts
//! ```
//!
//! Scattered light enters elsewhere on the object, so the shadow does not dim it. `S` is the transmittance toward the
//! light, whose logit the shadow network may move (it reads position, direction and the Gaussian's material embedding),
//! `d` the distance to the light, `r` its radius (at least a thousandth of `D`), `D` the distance at which a light
//! counts as one. The normal `n` and the lobes' frames turn with a frame per Gaussian of its own. Lights add up, so
//! strength and colour of a light multiply its image: the model itself has lights of strength one. Parallel light has
//! no distance and no falloff.
//!
//! Not in the papers: F0 per Gaussian, and Fresnel over the squared cosine. Limits: the shadow is traced from the
//! centre only, and scattering sees no neighbours, only the predicted distance.

mod groups;
mod network_pass;
mod networks;
mod options;
mod surface;

pub use options::{Component, OlatOptions};
pub use surface::LOBES;

use super::background::{COLOURS, depth_normal_loss};
use super::shadow_gs::{softplus, softplus_inverse};
use super::{Background, Context, NamedLoss, Parameters, SceneModel, Seen};
use crate::gaussians::{FEATURES, POSITION, Table, logit, normalised, sigmoid};
use crate::optim::ParameterGroup;
use crate::splat::{MapGradients, Maps};
use glam::Vec3;
use groups::{Feature, LOBE_FRAME, LOBE_GROUPS, LOBE_SCALE, Shared};
use rayon::prelude::*;
use std::f32::consts::PI;
use surface::{LightGeometry, Lobes, OlatSurface, SurfaceGradient};

/// Number of initial orientations of the lobes' long axes, spread evenly over half a circle. With a single one, a
/// Gaussian whose frame lies across the grain would have to turn through worse fits, and gets stuck; with several, the
/// lobes' weights alone reach a near one (docs/lab/objects.md).
const ORIENTATIONS: usize = 4;
/// Index of the group of diffuse colours, before the softplus.
pub const DIFFUSE: usize = FEATURES;
/// Index of the group of frames: quaternion `x, y, z, w` that turns the surface's own z axis to its normal.
pub const FRAME: usize = FEATURES + 1;
/// Index of the group of specular colours, before the softplus.
pub const SPECULAR: usize = FEATURES + 2;
/// Index of the group of the lobes' weights, before the softplus.
pub const WEIGHT: usize = FEATURES + 3;
/// Index of the group of F0, reflectance at normal incidence, before the sigmoid.
pub const F0: usize = FEATURES + 4;
/// Initial colour of scattered light, of which the dipole shows a fraction.
const INITIAL_SCATTERED: f32 = 0.1;
/// Initial scale of the networks' last layer, relative to its others: they start with little effect.
const NETWORK_OUTPUT_SCALE: f32 = 0.1;
/// Initial F0: that of plastics and most other dielectrics.
const DIELECTRIC_F0: f32 = 0.04;
/// Initial specular colour, nearly zero.
const INITIAL_SPECULAR: f32 = 0.02;

/// The model of one light at a time.
#[derive(Debug, Clone)]
pub struct Olat {
    /// Options of the model.
    pub options: OlatOptions,
}

impl Olat {
    /// A model of these options.
    pub fn new(options: OlatOptions) -> Self {
        Self { options }
    }

    /// Index of the group of material embeddings, which the networks read; `None` where both are off.
    pub fn embedding_group(&self) -> Option<usize> {
        self.options.feature_index(Feature::Embedding)
    }

    /// Index of the group of colours of scattered light, before the softplus; `None` where nothing scatters.
    pub fn scattered_group(&self) -> Option<usize> {
        self.options.feature_index(Feature::Scattered)
    }

    /// Shared parameters at the start: lobes around the normal, from narrow to wide, cycling through the orientations;
    /// networks with little effect.
    pub fn initial_globals(&self) -> Table {
        let mut table = Table::zeros(self.global_groups(), 1);
        if let Some(group) = self.options.shared_index(Shared::ScatteringNetwork) {
            let weights = self.options.scattering_network().initial(1, NETWORK_OUTPUT_SCALE);
            table.group_mut(group).copy_from_slice(&weights);
        }
        if let Some(group) = self.options.shared_index(Shared::ShadowNetwork) {
            let weights = self.options.shadow_network().initial(2, NETWORK_OUTPUT_SCALE);
            table.group_mut(group).copy_from_slice(&weights);
        }
        if self.options.specular {
            for j in 0..LOBES {
                let half_turn = 0.5 * PI * (j % ORIENTATIONS) as f32 / ORIENTATIONS as f32;
                table.group_mut(LOBE_FRAME)[j * 4 + 2] = half_turn.sin();
                table.group_mut(LOBE_FRAME)[j * 4 + 3] = half_turn.cos();
                // Relative widths of 2.5 and 1, where the largest is ten (GS³).
                table.group_mut(LOBE_SCALE)[j * 2..j * 2 + 2].copy_from_slice(&[-1.098_61, -2.197_2]);
            }
        }
        table
    }

    /// Sets the initial diffuse colour (red, green, blue) and frame (quaternion `x, y, z, w`) of Gaussian `g`,
    /// and the initial values of its other groups.
    pub fn paint(&self, gaussians: &mut Table, g: usize, colour: [f32; 3], frame: [f32; 4]) {
        for (k, value) in colour.into_iter().enumerate() {
            gaussians.group_mut(DIFFUSE)[g * COLOURS + k] = softplus_inverse(value.max(1e-3));
        }
        gaussians.group_mut(FRAME)[g * 4..g * 4 + 4].copy_from_slice(&frame);
        if self.options.specular {
            gaussians.group_mut(SPECULAR)[g * COLOURS..(g + 1) * COLOURS].fill(softplus_inverse(INITIAL_SPECULAR));
            gaussians.group_mut(F0)[g] = logit(DIELECTRIC_F0);
        }
        if let Some(group) = self.scattered_group() {
            gaussians.group_mut(group)[g * COLOURS..(g + 1) * COLOURS].fill(softplus_inverse(INITIAL_SCATTERED));
        }
    }

    /// True if normals are rasterised, behind the colours.
    fn shows_normals(&self) -> bool {
        self.options.normal_weight > 0.0 || self.options.shows == Component::Normal
    }

    fn lobes(&self, globals: &Table) -> Option<Lobes> {
        self.options.specular.then(|| {
            let [frames, scales, sigmas] = LOBE_GROUPS.map(|group| globals.group(group));
            Lobes::new(frames, scales, sigmas)
        })
    }

    fn surface(&self, gaussians: &Table, g: usize) -> OlatSurface {
        let values = |group: usize, width: usize| &gaussians.group(group)[g * width..(g + 1) * width];
        let positive = |values: &[f32], k: usize| softplus(values[k]);
        let frame = values(FRAME, 4);
        let mut surface = OlatSurface {
            diffuse: std::array::from_fn(|k| positive(values(DIFFUSE, COLOURS), k)),
            frame: [frame[0], frame[1], frame[2], frame[3]],
            specular: [0.0; COLOURS],
            weights: [0.0; LOBES],
            f0: DIELECTRIC_F0,
        };
        if self.options.specular {
            surface.specular = std::array::from_fn(|k| positive(values(SPECULAR, COLOURS), k));
            surface.weights = std::array::from_fn(|j| positive(values(WEIGHT, LOBES), j));
            surface.f0 = sigmoid(gaussians.group(F0)[g]);
        }
        surface
    }

    fn light_geometry(&self, context: &Context, g: usize) -> Option<LightGeometry> {
        let position = context.parameters.gaussians.position(g);
        let light = context.light?;
        Some(LightGeometry::new(
            position,
            &light,
            context.camera,
            self.options.distance,
            self.options.radius,
        ))
    }
}

/// Unit normal of the surface of Gaussian `g`.
fn normal(gaussians: &Table, g: usize) -> Vec3 {
    let q = &gaussians.group(FRAME)[g * 4..g * 4 + 4];
    normalised([q[0], q[1], q[2], q[3]]) * Vec3::Z
}

impl SceneModel for Olat {
    fn name(&self) -> &'static str {
        "olat"
    }

    fn feature_parameters(&self) -> Vec<ParameterGroup> {
        self.options.feature_parameters()
    }

    fn global_parameters(&self) -> Vec<ParameterGroup> {
        self.options.shared_parameters()
    }

    fn channels(&self) -> usize {
        if self.shows_normals() { 2 * COLOURS } else { COLOURS }
    }

    fn needs_transmittance(&self) -> bool {
        self.options.shadow
    }

    fn features(&self, context: &Context, seen: &Seen, out: &mut [f32]) {
        let (gaussians, lobes) = (&context.parameters.gaussians, self.lobes(&context.parameters.globals));
        let shows = self.options.shows;
        let networks = self.evaluate_networks(context, seen);
        out.par_chunks_mut(seen.stride)
            .with_min_len(256)
            .enumerate()
            .for_each(|(s, feature)| {
                let g = seen.projected.gaussian[s] as usize;
                let transmittance = networks.transmittance[s];
                if self.shows_normals() {
                    feature[COLOURS..2 * COLOURS].copy_from_slice(&normal(gaussians, g).to_array());
                }
                // Without a light a Gaussian is dark.
                let Some(geometry) = self.light_geometry(context, g) else {
                    return;
                };
                let surface = self.surface(gaussians, g);
                let shaded = surface.shade(lobes.as_ref(), &geometry);
                let scattered = networks.scattered(self, gaussians, s, g);
                for k in 0..COLOURS {
                    feature[k] = match shows {
                        Component::All | Component::Normal => {
                            ((shaded.diffuse[k] + shaded.specular[k]) * transmittance + scattered[k]) * geometry.falloff
                        }
                        Component::Diffuse => shaded.diffuse[k] * geometry.falloff,
                        Component::Specular => shaded.specular[k] * geometry.falloff,
                        Component::Shadow => transmittance,
                        Component::Scattering => scattered[k] * geometry.falloff,
                    };
                }
            });
    }

    fn features_backward(
        &self,
        context: &Context,
        seen: &Seen,
        d_features: &[f32],
        grads: &mut Parameters,
        d_transmittance: &mut [f32],
    ) {
        let (gaussians, lobes) = (&context.parameters.gaussians, self.lobes(&context.parameters.globals));
        let networks = self.evaluate_networks(context, seen);
        let mut parts: Vec<SurfaceGradient> = d_features
            .par_chunks(seen.stride)
            .with_min_len(256)
            .enumerate()
            .map(|(s, d)| {
                let g = seen.projected.gaussian[s] as usize;
                let Some(geometry) = self.light_geometry(context, g) else {
                    return SurfaceGradient::default();
                };
                let surface = self.surface(gaussians, g);
                let mut part =
                    surface.shade_backward(lobes.as_ref(), &geometry, networks.transmittance[s], [d[0], d[1], d[2]]);
                if self.shows_normals() {
                    part.turn_normal(&surface, Vec3::from_slice(&d[COLOURS..2 * COLOURS]));
                }
                part
            })
            .collect();
        self.networks_backward(context, seen, &networks, d_features, (&mut parts, grads));
        for (slot, part) in d_transmittance.iter_mut().zip(&parts) {
            *slot += part.transmittance;
        }
        let indices = &seen.projected.gaussian;
        let table = &mut grads.gaussians;
        let add = |slots: &mut [f32], values: &[f32]| slots.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        table.add_to_group(POSITION, indices, |s, slots| add(slots, &parts[s].position.to_array()));
        table.add_to_group(FRAME, indices, |s, slots| add(slots, &parts[s].frame));
        // The slope of the softplus is the sigmoid of its argument.
        let mut through = |group: usize, values: &(dyn Fn(usize) -> [f32; LOBES] + Sync)| {
            let width = gaussians.groups[group].spec.width;
            table.add_to_group(group, indices, |s, slots| {
                let g = indices[s] as usize;
                let (raw, d) = (&gaussians.group(group)[g * width..(g + 1) * width], values(s));
                for (k, slot) in slots.iter_mut().enumerate() {
                    *slot += d[k] * sigmoid(raw[k]);
                }
            });
        };
        let three = |v: [f32; COLOURS]| std::array::from_fn(|k| if k < COLOURS { v[k] } else { 0.0 });
        through(DIFFUSE, &|s| three(parts[s].diffuse));
        if lobes.is_some() {
            through(SPECULAR, &|s| three(parts[s].specular));
            through(WEIGHT, &|s| parts[s].weights);
            table.add_to_group(F0, indices, |s, slots| {
                let share = sigmoid(gaussians.group(F0)[indices[s] as usize]);
                slots[0] += parts[s].f0 * share * (1.0 - share);
            });
            let raw = LOBE_GROUPS.map(|group| context.parameters.globals.group(group));
            for (group, values) in LOBE_GROUPS.into_iter().zip(Lobes::gradients(raw, &parts)) {
                add(grads.globals.group_mut(group), &values);
            }
        }
    }

    fn background(&self) -> Background {
        (self.options.background, self.options.coverage)
    }

    fn map_losses(&self, context: &Context, maps: &Maps, d_maps: &mut MapGradients) -> Vec<NamedLoss> {
        let (weight, edge) = (self.options.normal_weight, self.options.normal_edge);
        depth_normal_loss(context.camera, maps, weight, edge, d_maps)
    }
}
