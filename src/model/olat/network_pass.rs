//! The networks of the model evaluated for all splats of a view, and their backward pass.
//!
//! Forward ([`Olat::evaluate_networks`]): encode the inputs of every splat, one row each; run the network over all
//! rows; keep inputs and outputs. Backward ([`Olat::networks_backward`]): gradients of the outputs, back through the
//! network to weights and input rows, back through the encoding to position, directions, normal and embedding, and from
//! there to the parameters. A network that the options switch off has no rows.

use super::groups::{Feature, Shared};
use super::networks::{
    EMBEDDING, InputGradient, NetworkInput, SCATTER_INPUTS, SHADOW_INPUTS, encode_scattering_backward,
    encode_shadow_backward, refined_shadow, refined_shadow_backward, scattered, scattered_backward,
};
use super::surface::{LightGeometry, SurfaceGradient};
use super::{FRAME, Olat, normal};
use crate::gaussians::{Table, rotation_backward, sigmoid};
use crate::model::background::COLOURS;
use crate::model::shadow_gs::softplus;
use crate::model::{Context, Parameters, Seen};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Writes the inputs of a network for a splat.
type Encoder<'a> = dyn Fn(usize, NetworkInput, &LightGeometry, &mut [f32]) + Sync + 'a;

/// Inputs and outputs of one network, row after row; empty where it is off.
#[derive(Default)]
struct NetworkRows {
    inputs: Vec<f32>,
    outputs: Vec<f32>,
}

/// Outputs of the networks for the splats of a view.
pub(super) struct NetworkOutput {
    /// Share of the light that reaches each splat: the traced transmittance, refined where the shadow network is on.
    pub(super) transmittance: Vec<f32>,
    scattering: NetworkRows,
    shadow: NetworkRows,
}

impl NetworkOutput {
    /// Colours of the light that scatters out of splat `s`, which is Gaussian `g`.
    pub(super) fn scattered(&self, model: &Olat, gaussians: &Table, s: usize, g: usize) -> [f32; COLOURS] {
        let Some(group) = model.options.feature_index(Feature::Scattered) else {
            return [0.0; COLOURS];
        };
        if self.scattering.outputs.is_empty() {
            return [0.0; COLOURS];
        }
        let colours = &gaussians.group(group)[g * COLOURS..(g + 1) * COLOURS];
        let value = scattered(three(&self.scattering.outputs, s));
        std::array::from_fn(|k| softplus(colours[k]) * value)
    }
}

fn three(values: &[f32], row: usize) -> [f32; COLOURS] {
    std::array::from_fn(|k| values[row * COLOURS + k])
}

impl Olat {
    fn network_input<'a>(&self, gaussians: &'a Table, embeddings: &'a [f32], g: usize) -> NetworkInput<'a> {
        NetworkInput {
            position: gaussians.position(g) / self.options.half_size,
            normal: normal(gaussians, g),
            embedding: &embeddings[g * EMBEDDING..(g + 1) * EMBEDDING],
        }
    }

    /// Evaluates the networks that the options switch on; without a light, none.
    pub(super) fn evaluate_networks(&self, context: &Context, seen: &Seen) -> NetworkOutput {
        let (gaussians, globals) = (&context.parameters.gaussians, &context.parameters.globals);
        let mut out = NetworkOutput {
            transmittance: seen.transmittance.to_vec(),
            scattering: NetworkRows::default(),
            shadow: NetworkRows::default(),
        };
        let Some(embedding) = self.options.feature_index(Feature::Embedding) else {
            return out;
        };
        if context.light.is_none() {
            return out;
        }
        let (indices, embeddings) = (&seen.projected.gaussian, gaussians.group(embedding));
        let encode = |inputs: usize, write: &Encoder| -> Vec<f32> {
            let mut rows = vec![0.0; indices.len() * inputs];
            rows.par_chunks_mut(inputs)
                .with_min_len(256)
                .enumerate()
                .for_each(|(s, row)| {
                    let g = indices[s] as usize;
                    if let Some(geometry) = self.light_geometry(context, g) {
                        write(s, self.network_input(gaussians, embeddings, g), &geometry, row);
                    }
                });
            rows
        };
        if let Some(group) = self.options.shared_index(Shared::ScatteringNetwork) {
            let inputs = encode(SCATTER_INPUTS, &|_, input, geometry, row| {
                input.encode_scattering(geometry, row);
            });
            let outputs = self.options.scattering_network().forward(globals.group(group), &inputs);
            out.scattering = NetworkRows { inputs, outputs };
        }
        if let Some(group) = self.options.shared_index(Shared::ShadowNetwork) {
            let inputs = encode(SHADOW_INPUTS, &|s, input, geometry, row| {
                input.encode_shadow(geometry, seen.transmittance[s], row);
            });
            let outputs = self.options.shadow_network().forward(globals.group(group), &inputs);
            for (transmittance, &output) in out.transmittance.iter_mut().zip(&outputs) {
                *transmittance = refined_shadow(*transmittance, output);
            }
            out.shadow = NetworkRows { inputs, outputs };
        }
        out
    }

    /// Backward of [`Self::evaluate_networks`], whose result was `output`: adds to the positions, frames and
    /// transmittances of `parts`, and to the gradients of embeddings, colours of scattered light and weights in
    /// `grads`.
    pub(super) fn networks_backward(
        &self,
        context: &Context,
        seen: &Seen,
        output: &NetworkOutput,
        d_features: &[f32],
        (parts, grads): (&mut [SurfaceGradient], &mut Parameters),
    ) {
        let (gaussians, globals) = (&context.parameters.gaussians, &context.parameters.globals);
        let Some(embedding) = self.options.feature_index(Feature::Embedding) else {
            return;
        };
        if context.light.is_none() {
            return;
        }
        let indices = &seen.projected.gaussian;
        let mut input_gradients = vec![InputGradient::default(); indices.len()];
        let mut d_falloff = vec![0.0; indices.len()];
        let add = |slots: &mut [f32], values: &[f32]| slots.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        if let (Some(group), Some(colour_group)) = (
            self.options.shared_index(Shared::ScatteringNetwork),
            self.options.feature_index(Feature::Scattered),
        ) {
            let NetworkRows { inputs, outputs } = &output.scattering;
            let (mut d_outputs, mut d_colours) = (vec![0.0; outputs.len()], vec![[0.0; COLOURS]; indices.len()]);
            for (s, &g) in indices.iter().enumerate() {
                let Some(geometry) = self.light_geometry(context, g as usize) else {
                    continue;
                };
                let raw = &gaussians.group(colour_group)[g as usize * COLOURS..];
                let (out, d) = (three(outputs, s), &d_features[s * seen.stride..]);
                let value = scattered(out);
                let mut d_value = 0.0;
                for k in 0..COLOURS {
                    let colour = softplus(raw[k]);
                    d_colours[s][k] = d[k] * value * geometry.falloff * sigmoid(raw[k]);
                    d_value += d[k] * colour * geometry.falloff;
                    d_falloff[s] += d[k] * colour * value;
                }
                d_outputs[s * COLOURS..(s + 1) * COLOURS].copy_from_slice(&scattered_backward(out, d_value));
            }
            let network = self.options.scattering_network();
            let (d_inputs, d_weights) = network.backward(globals.group(group), inputs, &d_outputs);
            add(grads.globals.group_mut(group), &d_weights);
            for (s, gradient) in input_gradients.iter_mut().enumerate() {
                let row = s * SCATTER_INPUTS..(s + 1) * SCATTER_INPUTS;
                encode_scattering_backward(&inputs[row.clone()], &d_inputs[row], gradient);
            }
            grads
                .gaussians
                .add_to_group(colour_group, indices, |s, slots| add(slots, &d_colours[s]));
        }
        if let Some(group) = self.options.shared_index(Shared::ShadowNetwork) {
            let NetworkRows { inputs, outputs } = &output.shadow;
            let mut d_outputs = vec![0.0; outputs.len()];
            for (s, part) in parts.iter_mut().enumerate() {
                (part.transmittance, d_outputs[s]) =
                    refined_shadow_backward(seen.transmittance[s], outputs[s], part.transmittance);
            }
            let network = self.options.shadow_network();
            let (d_inputs, d_weights) = network.backward(globals.group(group), inputs, &d_outputs);
            add(grads.globals.group_mut(group), &d_weights);
            for (s, (gradient, part)) in input_gradients.iter_mut().zip(parts.iter_mut()).enumerate() {
                let row = s * SHADOW_INPUTS..(s + 1) * SHADOW_INPUTS;
                part.transmittance += encode_shadow_backward(&inputs[row.clone()], &d_inputs[row], gradient);
            }
        }
        for (s, (part, input)) in parts.iter_mut().zip(&input_gradients).enumerate() {
            let g = indices[s] as usize;
            let Some(geometry) = self.light_geometry(context, g) else {
                continue;
            };
            part.position += input.position / self.options.half_size
                + geometry.position_gradient(input.to_light, input.to_eye, d_falloff[s]);
            let q = &gaussians.group(FRAME)[g * 4..g * 4 + 4];
            let d_frame = Mat3::from_cols(Vec3::ZERO, Vec3::ZERO, input.normal);
            add(&mut part.frame, &rotation_backward([q[0], q[1], q[2], q[3]], d_frame));
        }
        grads.gaussians.add_to_group(embedding, indices, |s, slots| {
            add(slots, &input_gradients[s].embedding);
        });
    }
}
