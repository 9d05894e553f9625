//! The networks of a view, asked and walked back.

use super::networks::{
    CODE, SCATTER_INPUTS, SHADOW_INPUTS, Told, ToldGradient, refined, refined_backward, scattered, scattered_backward,
    scattering_told_backward, shadow_told_backward,
};
use super::surface::{Place, SurfaceGradient};
use super::{FRAME, Olat, normal};
use crate::gaussians::{Table, rotation_backward, sigmoid};
use crate::model::over::COLOURS;
use crate::model::shadow_gs::softplus;
use crate::model::{Context, Parameters, Seen};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Writes what a network is told of a splat.
type Writer<'a> = dyn Fn(usize, Told, &Place, &mut [f32]) + Sync + 'a;

/// What networks add to the splats of a view.
pub(super) struct Added {
    /// Light that reaches each splat.
    pub(super) lit: Vec<f32>,
    /// What each network was told and gave; empty where there is none.
    scatter: (Vec<f32>, Vec<f32>),
    refine: (Vec<f32>, Vec<f32>),
}

impl Added {
    /// Colours of the light that scatters out of a splat's Gaussian.
    pub(super) fn scattered(&self, model: &Olat, gaussians: &Table, s: usize, g: usize) -> [f32; COLOURS] {
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
        Told {
            place: gaussians.position(g) / self.options.half_size,
            normal: normal(gaussians, g),
            code: &gaussians.group(self.code_group())[g * CODE..(g + 1) * CODE],
        }
    }

    /// Asks the networks that there are.
    pub(super) fn ask(&self, context: &Context, seen: &Seen) -> Added {
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
        let tell = |inputs: usize, write: &Writer| -> Vec<f32> {
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
    pub(super) fn ask_backward(
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
