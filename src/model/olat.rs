//! One light at a time: what a surface reflects of a point light, and how much of that light reaches it.
//!
//! After SSD-GS (2026) and GS³ (Bi et al. 2024), per Gaussian and evaluated at its centre, for a light of unit strength
//!
//! ```text
//! C = ((c_d f_d + c_s f_s) S + c_v f_v) · D² / (d² + r²)
//! f_d = cosE(n·ω_i) / π                    cosE(c) = (ELU(c) + t) / (1 + t): a cosine with a gradient on the dark side
//! f_s = Σ_j a_j G_j(h) · F(ω_i·h) / (ω_i·h)² · cosE(n·ω_i)        eight lobes that all share, Schlick's F with an F0 of the Gaussian's
//! f_v = R(r; σ_s', σ_a)        what scatters under the surface: a dipole, of which a network predicts the three numbers
//! ```
//!
//! Light that scatters comes from elsewhere on the object, so the shadow does not dim it. `S` is the transmittance toward the light
//! (another network may move its logit by what it makes of place, direction and a code of the Gaussian), `d` its distance, `r` its radius
//! (a thousandth of `D` at least), `D` the distance at which a light counts as one.
//! The normal `n` and the lobes' frames turn with a frame per Gaussian of its own. Lights add up, so strength and colour of a light
//! multiply its image: the model itself knows lights of strength one. Parallel light has no distance and falls off nowhere.

mod ask;
mod networks;
mod surface;

use super::network::Network;
use super::over::{COLOURS, normals_of_depth, over, over_backward};
use super::shadow_gs::{softplus, softplus_inverse};
use super::{Context, NamedLoss, Parameters, SceneModel, Seen};
use crate::gaussians::{FEATURES, GroupSpec, POSITION, Table, logit, normalised, sigmoid};
use crate::optim::exponential_decay;
use crate::raster::Raster;
use crate::splat::{MapGradients, Maps};
use glam::Vec3;
use networks::{CODE, SCATTER_INPUTS, SHADOW_INPUTS, network};
use rayon::prelude::*;
use std::f32::consts::PI;
use surface::{Lobes, Place, Surface, SurfaceGradient};

/// Lobes that all Gaussians share.
pub const LOBES: usize = 8;
/// Directions in which lobes are longest at the start, evenly over half a circle: a Gaussian whose frame lies across the grain would
/// have to turn through shapes that are worse, and stays where it is; so it chooses first (docs/lab/objects.md).
const ORIENTATIONS: usize = 4;
/// Index of the group of diffuse colours, before the softplus.
pub const DIFFUSE: usize = FEATURES;
/// Index of the group of frames: quaternion `x, y, z, w` that turns the surface's own z axis to its normal.
pub const FRAME: usize = FEATURES + 1;
/// Index of the group of glossy colours, before the softplus.
pub const SPECULAR: usize = FEATURES + 2;
/// Index of the group of the lobes' weights, before the softplus.
pub const WEIGHT: usize = FEATURES + 3;
/// Index of the group of reflectances head on, before the sigmoid.
pub const HEAD_ON: usize = FEATURES + 4;
/// Indices of the shared groups: frames, relative widths and widths of the lobes.
const LOBE_FRAME: usize = 0;
const LOBE_SCALE: usize = 1;
const LOBE_SIGMA: usize = 2;
/// Share of training from which on gloss joins. SSD-GS has 16 of 100: by then normals have turned to make highlights of what is matte, and do
/// not find back (docs/lab/objects.md).
const SPECULAR_FROM: f32 = 0.05;
/// Share of training from which on the lobes change their shape (SSD-GS: 22 of 100).
const LOBES_FROM: f32 = 0.08;
/// What is left of the rates of surfaces at the end of training: highlights that all share tremble otherwise.
const RATE_AT_END: f32 = 0.1;
/// Share of training from which on light scatters (SSD-GS: 9 of 100).
const SCATTERING_FROM: f32 = 0.09;
/// Share of training from which on shadows are refined (SSD-GS: 5 of 100).
const REFINED_FROM: f32 = 0.05;
/// Scattered light before it joins, of which the dipole shows a fraction.
const LITTLE_SCATTERS: f32 = 0.1;
/// What networks say at first, relative to their layers.
const QUIET: f32 = 0.1;
/// Reflectance head on before it is known: that of plastics and of most that is no metal.
const PLASTIC: f32 = 0.04;
/// Gloss before it joins: as good as none.
const NO_GLOSS: f32 = 0.02;

/// What the model is made of.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OlatOptions {
    /// Whether surfaces are glossy.
    pub specular: bool,
    /// Whether the light that reaches a surface is traced.
    pub shadow: bool,
    /// Whether light scatters under the surface.
    pub scattering: bool,
    /// Whether a network refines the shadows.
    pub refined: bool,
    /// Units of the hidden layers of both networks.
    pub width: usize,
    /// Their hidden layers.
    pub hidden: usize,
    /// Half of the side of the cube that positions lie in.
    pub half_size: f32,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Whether images have coverage as a fourth band.
    pub coverage: bool,
    /// Distance at which a light of strength one counts as one.
    pub distance: f32,
    /// Radius of the lights.
    pub radius: f32,
    /// How much normals agree with those of the depth.
    pub normal_weight: f32,
    /// Depths that differ by more than this are an edge, not a slope.
    pub normal_edge: f32,
    /// What is shown of the light that surfaces reflect.
    pub shows: Component,
}

/// Parts of the light.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Component {
    /// All of it.
    #[default]
    All,
    /// What is reflected evenly, in shadow too.
    Diffuse,
    /// What is reflected as by a mirror, in shadow too.
    Specular,
    /// How much of the light arrives.
    Shadow,
    /// What comes out of the surface after it went in elsewhere.
    Scattering,
    /// The normals of the frames behind the colours, where a model rasterises them.
    Normal,
}

impl Default for OlatOptions {
    fn default() -> Self {
        Self {
            specular: true,
            shadow: true,
            scattering: false,
            refined: false,
            width: 32,
            hidden: 3,
            half_size: 1.0,
            background: [0.0; 3],
            coverage: false,
            distance: 1.0,
            radius: 0.0,
            normal_weight: 0.0,
            normal_edge: 0.1,
            shows: Component::All,
        }
    }
}

/// The model.
#[derive(Debug, Clone)]
pub struct Olat {
    /// What it is made of.
    pub options: OlatOptions,
}

impl Olat {
    /// A model of these options.
    pub fn new(options: OlatOptions) -> Self {
        Self { options }
    }

    fn scatterer(&self) -> Network {
        network(
            SCATTER_INPUTS,
            COLOURS,
            self.options.width.max(1),
            self.options.hidden.max(1),
        )
    }

    fn refiner(&self) -> Network {
        network(SHADOW_INPUTS, 1, self.options.width.max(1), self.options.hidden.max(1))
    }

    /// Whether Gaussians have a code that networks read.
    fn coded(&self) -> bool {
        self.options.scattering || self.options.refined
    }

    /// Index of the group of codes; that of the colours of scattered light stands behind it.
    pub fn code_group(&self) -> usize {
        if self.options.specular { HEAD_ON + 1 } else { SPECULAR }
    }

    /// Index of the first shared group of a network.
    fn networks_at(&self) -> usize {
        if self.options.specular { LOBE_SIGMA + 1 } else { 0 }
    }

    /// Shared parameters at the start: lobes around the normal, from narrow to wide and turned in turns; networks that say little.
    pub fn initial_globals(&self) -> Table {
        let mut table = Table::zeros(self.global_groups(), 1);
        let at = self.networks_at();
        if self.options.scattering {
            table.group_mut(at).copy_from_slice(&self.scatterer().initial(1, QUIET));
        }
        if self.options.refined {
            let at = at + usize::from(self.options.scattering);
            table.group_mut(at).copy_from_slice(&self.refiner().initial(2, QUIET));
        }
        if self.options.specular {
            for j in 0..LOBES {
                let half_turn = 0.5 * PI * (j % ORIENTATIONS) as f32 / ORIENTATIONS as f32;
                table.group_mut(LOBE_FRAME)[j * 4 + 2] = half_turn.sin();
                table.group_mut(LOBE_FRAME)[j * 4 + 3] = half_turn.cos();
                // Widths of 2.5 and 1 of ten (GS³).
                table.group_mut(LOBE_SCALE)[j * 2..j * 2 + 2].copy_from_slice(&[-1.098_61, -2.197_2]);
            }
        }
        table
    }

    /// Sets what Gaussian `g` is at the start: its diffuse colour and its frame.
    pub fn paint(&self, gaussians: &mut Table, g: usize, colour: [f32; 3], frame: [f32; 4]) {
        for (k, value) in colour.into_iter().enumerate() {
            gaussians.group_mut(DIFFUSE)[g * COLOURS + k] = softplus_inverse(value.max(1e-3));
        }
        gaussians.group_mut(FRAME)[g * 4..g * 4 + 4].copy_from_slice(&frame);
        if self.options.specular {
            gaussians.group_mut(SPECULAR)[g * COLOURS..(g + 1) * COLOURS].fill(softplus_inverse(NO_GLOSS));
            gaussians.group_mut(HEAD_ON)[g] = logit(PLASTIC);
        }
        if self.options.scattering {
            let at = self.code_group() + 1;
            gaussians.group_mut(at)[g * COLOURS..(g + 1) * COLOURS].fill(softplus_inverse(LITTLE_SCATTERS));
        }
    }

    /// Whether normals are rasterised, behind the colours.
    fn shows_normals(&self) -> bool {
        self.options.normal_weight > 0.0 || self.options.shows == Component::Normal
    }

    fn lobes(&self, globals: &Table) -> Option<Lobes> {
        self.options.specular.then(|| {
            Lobes::new(
                globals.group(LOBE_FRAME),
                globals.group(LOBE_SCALE),
                globals.group(LOBE_SIGMA),
            )
        })
    }

    fn surface(&self, gaussians: &Table, g: usize) -> Surface {
        let part = |group: usize, width: usize| &gaussians.group(group)[g * width..(g + 1) * width];
        let positive = |values: &[f32], k: usize| softplus(values[k]);
        let frame = part(FRAME, 4);
        let mut surface = Surface {
            diffuse: std::array::from_fn(|k| positive(part(DIFFUSE, COLOURS), k)),
            frame: [frame[0], frame[1], frame[2], frame[3]],
            specular: [0.0; COLOURS],
            weights: [0.0; LOBES],
            head_on: PLASTIC,
        };
        if self.options.specular {
            surface.specular = std::array::from_fn(|k| positive(part(SPECULAR, COLOURS), k));
            surface.weights = std::array::from_fn(|j| positive(part(WEIGHT, LOBES), j));
            surface.head_on = sigmoid(gaussians.group(HEAD_ON)[g]);
        }
        surface
    }

    fn place(&self, context: &Context, g: usize) -> Option<Place> {
        let position = context.parameters.gaussians.position(g);
        let light = context.light?;
        Some(Place::new(
            position,
            &light,
            context.camera,
            self.options.distance,
            self.options.radius,
        ))
    }
}

/// The normal of the surface of Gaussian `g`.
fn normal(gaussians: &Table, g: usize) -> Vec3 {
    let q = &gaussians.group(FRAME)[g * 4..g * 4 + 4];
    normalised([q[0], q[1], q[2], q[3]]) * Vec3::Z
}

impl SceneModel for Olat {
    fn name(&self) -> &'static str {
        "olat"
    }

    fn feature_groups(&self) -> Vec<GroupSpec> {
        let mut groups = vec![GroupSpec::new("diffuse", COLOURS), GroupSpec::new("frame", 4)];
        if self.options.specular {
            groups.push(GroupSpec::new("specular", COLOURS));
            groups.push(GroupSpec::new("lobe_weight", LOBES));
            groups.push(GroupSpec::new("head_on", 1));
        }
        if self.coded() {
            groups.push(GroupSpec::new("code", CODE));
        }
        if self.options.scattering {
            groups.push(GroupSpec::new("scattered", COLOURS));
        }
        groups
    }

    fn global_groups(&self) -> Vec<GroupSpec> {
        let mut groups = Vec::new();
        if self.options.specular {
            groups.push(GroupSpec::new("lobe_frame", LOBES * 4));
            groups.push(GroupSpec::new("lobe_scale", LOBES * 2));
            groups.push(GroupSpec::new("lobe_sigma", LOBES));
        }
        if self.options.scattering {
            groups.push(GroupSpec::new("scatterer", self.scatterer().weights()));
        }
        if self.options.refined {
            groups.push(GroupSpec::new("refiner", self.refiner().weights()));
        }
        groups
    }

    fn learning_rate(&self, group: &str, progress: f32) -> f32 {
        let from = |start: f32, rate: f32| if progress >= start { rate } else { 0.0 };
        let falling = |start: f32, rate: f32| from(start, exponential_decay(rate, RATE_AT_END * rate, progress));
        match group {
            "diffuse" => falling(0.0, 3e-2),
            "frame" => falling(0.0, 2e-2),
            "specular" => falling(SPECULAR_FROM, 0.1),
            "head_on" => falling(SPECULAR_FROM, 6e-2),
            "lobe_weight" => falling(SPECULAR_FROM, 3e-2),
            "scattered" => from(SCATTERING_FROM, 1e-2),
            "scatterer" => from(SCATTERING_FROM, 2e-3),
            "refiner" => from(REFINED_FROM, 2e-3),
            "code" => from(REFINED_FROM, 5e-3),
            _ => falling(LOBES_FROM, 2e-2),
        }
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
        let added = self.ask(context, seen);
        out.par_chunks_mut(seen.stride)
            .with_min_len(256)
            .enumerate()
            .for_each(|(s, feature)| {
                let g = seen.projected.gaussian[s] as usize;
                let lit = added.lit[s];
                if self.shows_normals() {
                    feature[COLOURS..2 * COLOURS].copy_from_slice(&normal(gaussians, g).to_array());
                }
                // Without a light it is dark.
                let Some(place) = self.place(context, g) else { return };
                let surface = self.surface(gaussians, g);
                let shaded = surface.shade(lobes.as_ref(), &place);
                let scattered = added.scattered(self, gaussians, s, g);
                for k in 0..COLOURS {
                    feature[k] = match shows {
                        Component::All | Component::Normal => {
                            ((shaded.diffuse[k] + shaded.specular[k]) * lit + scattered[k]) * place.falling
                        }
                        Component::Diffuse => shaded.diffuse[k] * place.falling,
                        Component::Specular => shaded.specular[k] * place.falling,
                        Component::Shadow => lit,
                        Component::Scattering => scattered[k] * place.falling,
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
        let added = self.ask(context, seen);
        let mut parts: Vec<SurfaceGradient> = d_features
            .par_chunks(seen.stride)
            .with_min_len(256)
            .enumerate()
            .map(|(s, d)| {
                let g = seen.projected.gaussian[s] as usize;
                let Some(place) = self.place(context, g) else {
                    return SurfaceGradient::default();
                };
                let surface = self.surface(gaussians, g);
                let mut part = surface.shade_backward(lobes.as_ref(), &place, added.lit[s], [d[0], d[1], d[2]]);
                if self.shows_normals() {
                    part.turn_normal(&surface, Vec3::from_slice(&d[COLOURS..2 * COLOURS]));
                }
                part
            })
            .collect();
        self.ask_backward(context, seen, &added, d_features, (&mut parts, grads));
        for (slot, part) in d_transmittance.iter_mut().zip(&parts) {
            *slot += part.transmittance;
        }
        let indices = &seen.projected.gaussian;
        let table = &mut grads.gaussians;
        let add = |slots: &mut [f32], values: &[f32]| slots.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        table.add_to_group(POSITION, indices, |s, slots| add(slots, &parts[s].position.to_array()));
        table.add_to_group(FRAME, indices, |s, slots| add(slots, &parts[s].frame));
        // Of a softplus: the sigmoid of its argument.
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
        if let Some(lobes) = &lobes {
            through(SPECULAR, &|s| three(parts[s].specular));
            through(WEIGHT, &|s| parts[s].weights);
            table.add_to_group(HEAD_ON, indices, |s, slots| {
                let share = sigmoid(gaussians.group(HEAD_ON)[indices[s] as usize]);
                slots[0] += parts[s].head_on * share * (1.0 - share);
            });
            let mut shared = lobes.gradients(&context.parameters.globals, &parts);
            for (group, values) in shared.iter_mut().enumerate() {
                add(grads.globals.group_mut(group), values);
            }
        }
    }

    fn compose(&self, _context: &Context, maps: &Maps) -> Raster {
        over(maps, self.options.background, self.options.coverage)
    }

    fn compose_backward(
        &self,
        _context: &Context,
        _maps: &Maps,
        d_image: &Raster,
        d_maps: &mut MapGradients,
        _grads: &mut Parameters,
    ) {
        over_backward(d_image, self.options.background, self.options.coverage, d_maps);
    }

    fn map_losses(&self, context: &Context, maps: &Maps, _: &[f32], d_maps: &mut MapGradients) -> Vec<NamedLoss> {
        let (weight, edge) = (self.options.normal_weight, self.options.normal_edge);
        normals_of_depth(context.camera, maps, weight, edge, d_maps)
    }
}
