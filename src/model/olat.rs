//! One light at a time: what a surface reflects of a point light, and how much of that light reaches it.
//!
//! After SSD-GS (2026) and GS³ (Bi et al. 2024), per Gaussian and evaluated at its centre, for a light of unit strength
//!
//! ```text
//! C = ((c_d f_d + c_s f_s) S + c_v f_v) · D² / (d² + r²)
//! f_d = cosE(n·ω_i) / π                    cosE(c) = (ELU(c) + t) / (1 + t): a cosine with a gradient on the dark side
//! f_s = Σ_j a_j G_j(h) · F(ω_i·h) · cosE(n·ω_i)        eight lobes that all share, Schlick's F with F0 = 0.04
//! f_v = R(r; σ_s', σ_a)        what scatters under the surface: a dipole, of which a network predicts the three numbers
//! ```
//!
//! Light that scatters comes from elsewhere on the object, so the shadow does not dim it. `S` is the transmittance toward the light
//! (another network may move its logit by what it makes of place, direction and a code of the Gaussian), `d` its distance, `r` its radius, `D` the distance at which a light counts as one.
//! The normal `n` and the lobes' frames turn with a frame per Gaussian of its own. Lights add up, so strength and colour of a light
//! multiply its image: the model itself knows lights of strength one. Parallel light has no distance and falls off nowhere.

mod networks;
mod surface;

use super::network::Network;
use super::over::{COLOURS, over, over_backward};
use super::shadow_gs::{softplus, softplus_inverse};
use super::{Context, NamedLoss, Parameters, SceneModel, Seen};
use crate::gaussians::{FEATURES, GroupSpec, POSITION, Table, normalised, rotation_backward, sigmoid};
use crate::raster::Raster;
use crate::splat::{MapGradients, Maps};
use glam::{Mat3, Vec3};
use networks::{
    CODE, SCATTER_INPUTS, SHADOW_INPUTS, Told, ToldGradient, network, refined, refined_backward, scattered,
    scattered_backward, scattering_told_backward, shadow_told_backward,
};
use rayon::prelude::*;
use surface::{Lobes, Place, Surface, SurfaceGradient};

/// Lobes that all Gaussians share.
pub const LOBES: usize = 8;
/// Index of the group of diffuse colours, before the softplus.
pub const DIFFUSE: usize = FEATURES;
/// Index of the group of frames: quaternion `x, y, z, w` that turns the surface's own z axis to its normal.
pub const FRAME: usize = FEATURES + 1;
/// Index of the group of glossy colours, before the softplus.
pub const SPECULAR: usize = FEATURES + 2;
/// Index of the group of the lobes' weights, before the softplus.
pub const WEIGHT: usize = FEATURES + 3;
/// Indices of the shared groups: frames, relative widths and widths of the lobes.
const LOBE_FRAME: usize = 0;
const LOBE_SCALE: usize = 1;
const LOBE_SIGMA: usize = 2;
/// Share of training from which on gloss joins (SSD-GS: 16 of 100).
const SPECULAR_FROM: f32 = 0.16;
/// Share of training from which on the lobes change their shape (SSD-GS: 22 of 100).
const LOBES_FROM: f32 = 0.22;
/// Share of training from which on light scatters (SSD-GS: 9 of 100).
const SCATTERING_FROM: f32 = 0.09;
/// Share of training from which on shadows are refined (SSD-GS: 5 of 100).
const REFINED_FROM: f32 = 0.05;
/// Scattered light before it joins, of which the dipole shows a fraction.
const LITTLE_SCATTERS: f32 = 0.1;
/// What networks say at first, relative to their layers.
const QUIET: f32 = 0.1;
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
        if self.options.specular { WEIGHT + 1 } else { SPECULAR }
    }

    /// Index of the first shared group of a network.
    fn networks_at(&self) -> usize {
        if self.options.specular { LOBE_SIGMA + 1 } else { 0 }
    }

    /// Shared parameters at the start: lobes around the normal, from narrow to wide; networks that say little.
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
                table.group_mut(LOBE_FRAME)[j * 4 + 3] = 1.0;
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
        }
        if self.options.scattering {
            let at = self.code_group() + 1;
            gaussians.group_mut(at)[g * COLOURS..(g + 1) * COLOURS].fill(softplus_inverse(LITTLE_SCATTERS));
        }
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
        };
        if self.options.specular {
            surface.specular = std::array::from_fn(|k| positive(part(SPECULAR, COLOURS), k));
            surface.weights = std::array::from_fn(|j| positive(part(WEIGHT, LOBES), j));
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

/// What networks add to the splats of a view.
struct Added {
    /// Light that reaches each splat.
    lit: Vec<f32>,
    /// What each network was told and gave; empty where there is none.
    scatter: (Vec<f32>, Vec<f32>),
    refine: (Vec<f32>, Vec<f32>),
}

impl Added {
    /// Colours of the light that scatters out of a splat's Gaussian.
    fn scattered(&self, model: &Olat, gaussians: &Table, s: usize, g: usize) -> [f32; COLOURS] {
        if self.scatter.1.is_empty() {
            return [0.0; COLOURS];
        }
        let colours = &gaussians.group(model.code_group() + 1)[g * COLOURS..(g + 1) * COLOURS];
        let value = scattered(three(&self.scatter.1, s));
        std::array::from_fn(|k| softplus(colours[k]) * value)
    }
}

fn three(values: &[f32], row: usize) -> [f32; COLOURS] {
    std::array::from_fn(|k| values[row * COLOURS + k])
}

impl Olat {
    fn told<'a>(&self, gaussians: &'a Table, g: usize) -> Told<'a> {
        let q = &gaussians.group(FRAME)[g * 4..g * 4 + 4];
        Told {
            place: gaussians.position(g) / self.options.half_size,
            normal: normalised([q[0], q[1], q[2], q[3]]) * Vec3::Z,
            code: &gaussians.group(self.code_group())[g * CODE..(g + 1) * CODE],
        }
    }

    /// Asks the networks that there are.
    fn ask(&self, context: &Context, seen: &Seen) -> Added {
        let (gaussians, globals) = (&context.parameters.gaussians, &context.parameters.globals);
        let mut added = Added {
            lit: seen.transmittance.to_vec(),
            scatter: Default::default(),
            refine: Default::default(),
        };
        if context.light.is_none() || !self.coded() {
            return added;
        }
        let indices = &seen.projected.gaussian;
        let at = self.networks_at();
        let tell = |inputs: usize, write: &(dyn Fn(usize, Told, &Place, &mut [f32]) + Sync)| -> Vec<f32> {
            let mut lines = vec![0.0; indices.len() * inputs];
            lines
                .par_chunks_mut(inputs)
                .with_min_len(256)
                .enumerate()
                .for_each(|(s, line)| {
                    let g = indices[s] as usize;
                    if let Some(place) = self.place(context, g) {
                        write(s, self.told(gaussians, g), &place, line);
                    }
                });
            lines
        };
        if self.options.scattering {
            let told = tell(SCATTER_INPUTS, &|_, told, place, line| told.of_scattering(place, line));
            let gave = self.scatterer().forward(globals.group(at), &told);
            added.scatter = (told, gave);
        }
        if self.options.refined {
            let told = tell(SHADOW_INPUTS, &|s, told, place, line| {
                told.of_shadow(place, seen.transmittance[s], line);
            });
            let at = at + usize::from(self.options.scattering);
            let gave = self.refiner().forward(globals.group(at), &told);
            for (lit, &out) in added.lit.iter_mut().zip(&gave) {
                *lit = refined(*lit, out);
            }
            added.refine = (told, gave);
        }
        added
    }

    /// Back through the networks: adds to the parts' positions, frames and transmittances, to codes, colours and weights.
    fn ask_backward(
        &self,
        context: &Context,
        seen: &Seen,
        added: &Added,
        d_features: &[f32],
        (parts, grads): (&mut [SurfaceGradient], &mut Parameters),
    ) {
        let (gaussians, globals) = (&context.parameters.gaussians, &context.parameters.globals);
        if context.light.is_none() || !self.coded() {
            return;
        }
        let indices = &seen.projected.gaussian;
        let mut told = vec![ToldGradient::default(); indices.len()];
        let mut d_falling = vec![0.0; indices.len()];
        let at = self.networks_at();
        let add = |slots: &mut [f32], values: &[f32]| slots.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        if self.options.scattering {
            let (lines, gave) = &added.scatter;
            let (mut d_gave, mut d_colours) = (vec![0.0; gave.len()], vec![[0.0; COLOURS]; indices.len()]);
            for (s, &g) in indices.iter().enumerate() {
                let Some(place) = self.place(context, g as usize) else {
                    continue;
                };
                let raw = &gaussians.group(self.code_group() + 1)[g as usize * COLOURS..];
                let (out, d) = (three(gave, s), &d_features[s * seen.stride..]);
                let value = scattered(out);
                let mut d_value = 0.0;
                for k in 0..COLOURS {
                    let colour = softplus(raw[k]);
                    d_colours[s][k] = d[k] * value * place.falling * sigmoid(raw[k]);
                    d_value += d[k] * colour * place.falling;
                    d_falling[s] += d[k] * colour * value;
                }
                d_gave[s * COLOURS..(s + 1) * COLOURS].copy_from_slice(&scattered_backward(out, d_value));
            }
            let (d_lines, d_weights) = self.scatterer().backward(globals.group(at), lines, &d_gave);
            add(grads.globals.group_mut(at), &d_weights);
            for (s, told) in told.iter_mut().enumerate() {
                let line = s * SCATTER_INPUTS..(s + 1) * SCATTER_INPUTS;
                scattering_told_backward(&lines[line.clone()], &d_lines[line], told);
            }
            let group = self.code_group() + 1;
            grads
                .gaussians
                .add_to_group(group, indices, |s, slots| add(slots, &d_colours[s]));
        }
        if self.options.refined {
            let (lines, gave) = &added.refine;
            let at = at + usize::from(self.options.scattering);
            let mut d_gave = vec![0.0; gave.len()];
            for (s, part) in parts.iter_mut().enumerate() {
                (part.transmittance, d_gave[s]) = refined_backward(seen.transmittance[s], gave[s], part.transmittance);
            }
            let (d_lines, d_weights) = self.refiner().backward(globals.group(at), lines, &d_gave);
            add(grads.globals.group_mut(at), &d_weights);
            for (s, (told, part)) in told.iter_mut().zip(parts.iter_mut()).enumerate() {
                let line = s * SHADOW_INPUTS..(s + 1) * SHADOW_INPUTS;
                part.transmittance += shadow_told_backward(&lines[line.clone()], &d_lines[line], told);
            }
        }
        for (s, (part, told)) in parts.iter_mut().zip(&told).enumerate() {
            let g = indices[s] as usize;
            let Some(place) = self.place(context, g) else { continue };
            part.position +=
                told.place / self.options.half_size + place.position_gradient(told.to_light, told.to_eye, d_falling[s]);
            let q = &gaussians.group(FRAME)[g * 4..g * 4 + 4];
            let d_frame = Mat3::from_cols(Vec3::ZERO, Vec3::ZERO, told.normal);
            add(&mut part.frame, &rotation_backward([q[0], q[1], q[2], q[3]], d_frame));
        }
        let group = self.code_group();
        grads
            .gaussians
            .add_to_group(group, indices, |s, slots| add(slots, &told[s].code));
    }
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
        match group {
            "diffuse" => 1e-2,
            "frame" => 1e-2,
            "specular" | "lobe_weight" => from(SPECULAR_FROM, 1e-2),
            "scattered" => from(SCATTERING_FROM, 1e-2),
            "scatterer" => from(SCATTERING_FROM, 2e-3),
            "refiner" => from(REFINED_FROM, 2e-3),
            "code" => from(REFINED_FROM, 5e-3),
            _ => from(LOBES_FROM, 5e-3),
        }
    }

    fn channels(&self) -> usize {
        COLOURS
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
                surface.shade_backward(lobes.as_ref(), &place, added.lit[s], [d[0], d[1], d[2]])
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

    fn map_losses(&self, _: &Context, _: &Maps, _: &[f32], _: &mut MapGradients) -> Vec<NamedLoss> {
        Vec::new()
    }
}
