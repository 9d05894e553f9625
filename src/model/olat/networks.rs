//! The two small networks of the model: their inputs and the meaning of their outputs.
//!
//! The *scattering network* predicts distance, scattering and absorption of the dipole of [`crate::shade::dipole`]; the
//! *shadow network* moves the logit of the traced transmittance (SSD-GS). Both read encoded vectors,
//! `x, sin x, cos x, sin 2x, cos 2x` per component, and the material embedding of the Gaussian, six trained numbers
//! that only the networks interpret.

use super::surface::LightGeometry;
use crate::gaussians::sigmoid;
use crate::model::background::COLOURS;
use crate::model::network::Network;
use crate::shade::dipole::Medium;
use glam::Vec3;

/// Numbers of the material embedding of a Gaussian.
pub(super) const EMBEDDING: usize = 6;
/// Numbers of an encoded vector: for each component `x`, the five values `x, sin x, cos x, sin 2x, cos 2x`.
const ENCODED: usize = 15;
/// Inputs of the scattering network: position, directions to light and eye, normal, embedding.
pub(super) const SCATTER_INPUTS: usize = 3 * ENCODED + 3 + EMBEDDING;
/// Inputs of the shadow network: position, direction to the light, embedding, transmittance.
pub(super) const SHADOW_INPUTS: usize = 2 * ENCODED + EMBEDDING + 1;
/// Transmittances are refined between these, where their logits are moderate.
const SHADOW_RANGE: (f32, f32) = (0.02, 0.98);

/// Shape of a network of `inputs` inputs, `outputs` outputs and `hidden` hidden layers of `width` units.
pub(super) fn network(inputs: usize, outputs: usize, width: usize, hidden: usize) -> Network {
    Network {
        inputs,
        width,
        hidden,
        outputs,
    }
}

/// Encodes a vector in the first [`ENCODED`] numbers of `out`.
fn encode(v: Vec3, out: &mut [f32]) {
    for (k, x) in v.to_array().into_iter().enumerate() {
        let ((s, c), (s2, c2)) = (x.sin_cos(), (2.0 * x).sin_cos());
        out[k * 5..k * 5 + 5].copy_from_slice(&[x, s, c, s2, c2]);
    }
}

/// Gradient of the vector, from its encoding and the gradient `d` of that.
fn encode_backward(encoded: &[f32], d: &[f32]) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|k| {
        let (t, d) = (&encoded[k * 5..k * 5 + 5], &d[k * 5..k * 5 + 5]);
        d[0] + d[1] * t[2] - d[2] * t[1] + 2.0 * (d[3] * t[4] - d[4] * t[3])
    }))
}

/// Inputs of the networks from a Gaussian, besides the directions to light and eye.
pub(super) struct NetworkInput<'a> {
    /// Position of the Gaussian over half the side of the cube that contains the positions, about -1 to 1.
    pub(super) position: Vec3,
    /// Unit normal of the surface.
    pub(super) normal: Vec3,
    /// Material embedding, [`EMBEDDING`] numbers.
    pub(super) embedding: &'a [f32],
}

/// Gradients of a loss to the networks' inputs before encoding.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct InputGradient {
    /// Gradient to the scaled position.
    pub(super) position: Vec3,
    /// Gradient to the direction to the light.
    pub(super) to_light: Vec3,
    /// Gradient to the direction to the eye.
    pub(super) to_eye: Vec3,
    /// Gradient to the normal.
    pub(super) normal: Vec3,
    /// Gradient to the material embedding.
    pub(super) embedding: [f32; EMBEDDING],
}

impl InputGradient {
    fn add_embedding(&mut self, d: &[f32]) {
        self.embedding.iter_mut().zip(d).for_each(|(s, d)| *s += d);
    }
}

impl NetworkInput<'_> {
    /// Writes the inputs of the scattering network.
    pub(super) fn encode_scattering(&self, geometry: &LightGeometry, out: &mut [f32]) {
        encode(self.position, &mut out[..ENCODED]);
        encode(geometry.to_light, &mut out[ENCODED..2 * ENCODED]);
        encode(geometry.to_eye, &mut out[2 * ENCODED..3 * ENCODED]);
        out[3 * ENCODED..3 * ENCODED + 3].copy_from_slice(&self.normal.to_array());
        out[3 * ENCODED + 3..].copy_from_slice(self.embedding);
    }

    /// Writes the inputs of the shadow network.
    pub(super) fn encode_shadow(&self, geometry: &LightGeometry, transmittance: f32, out: &mut [f32]) {
        encode(self.position, &mut out[..ENCODED]);
        encode(geometry.to_light, &mut out[ENCODED..2 * ENCODED]);
        out[2 * ENCODED..2 * ENCODED + EMBEDDING].copy_from_slice(self.embedding);
        out[2 * ENCODED + EMBEDDING] = transmittance;
    }
}

/// Backward of [`NetworkInput::encode_scattering`]: adds to `out` from the gradient `d` of the inputs.
pub(super) fn encode_scattering_backward(encoded: &[f32], d: &[f32], out: &mut InputGradient) {
    out.position += encode_backward(&encoded[..ENCODED], &d[..ENCODED]);
    out.to_light += encode_backward(&encoded[ENCODED..2 * ENCODED], &d[ENCODED..2 * ENCODED]);
    out.to_eye += encode_backward(&encoded[2 * ENCODED..3 * ENCODED], &d[2 * ENCODED..3 * ENCODED]);
    out.normal += Vec3::from_slice(&d[3 * ENCODED..3 * ENCODED + 3]);
    out.add_embedding(&d[3 * ENCODED + 3..]);
}

/// Backward of [`NetworkInput::encode_shadow`]: adds to `out`, and returns the gradient of the transmittance.
pub(super) fn encode_shadow_backward(encoded: &[f32], d: &[f32], out: &mut InputGradient) -> f32 {
    out.position += encode_backward(&encoded[..ENCODED], &d[..ENCODED]);
    out.to_light += encode_backward(&encoded[ENCODED..2 * ENCODED], &d[ENCODED..2 * ENCODED]);
    out.add_embedding(&d[2 * ENCODED..2 * ENCODED + EMBEDDING]);
    d[2 * ENCODED + EMBEDDING]
}

/// Distance and medium from the scattering network's outputs, in the ranges of SSD-GS, and their slopes to the outputs.
fn medium(out: [f32; COLOURS]) -> (f32, Medium, [f32; COLOURS]) {
    let s = out.map(sigmoid);
    let slope = |k: usize, reach: f32| reach * s[k] * (1.0 - s[k]);
    let medium = Medium {
        scattering: 2.0 * s[1] + 0.05,
        absorption: 2.0 * s[2] + 0.05,
    };
    (3.0 * s[0] + 0.1, medium, [slope(0, 3.0), slope(1, 2.0), slope(2, 2.0)])
}

/// Light that scatters out per incoming light, before the colour, from the scattering network's outputs: the dipole
/// profile at the predicted distance.
pub(super) fn scattered(out: [f32; COLOURS]) -> f32 {
    let (distance, medium, _) = medium(out);
    medium.profile(distance).value
}

/// Backward of [`scattered`]: gradients of the network's outputs `out`, from the gradient `d` of the result.
pub(super) fn scattered_backward(out: [f32; COLOURS], d: f32) -> [f32; COLOURS] {
    let (distance, medium, slopes) = medium(out);
    let found = medium.profile(distance);
    [
        d * found.distance * slopes[0],
        d * found.scattering * slopes[1],
        d * found.absorption * slopes[2],
    ]
}

/// A transmittance, 0 to 1, whose logit is moved by the shadow network's output `out`.
pub(super) fn refined_shadow(transmittance: f32, out: f32) -> f32 {
    let t = transmittance.clamp(SHADOW_RANGE.0, SHADOW_RANGE.1);
    // σ(ln(t / (1-t)) + x) without the logarithm.
    t / (t + (1.0 - t) * (-out).exp())
}

/// Backward of [`refined_shadow`]: gradients of the transmittance and of the network's output, from the gradient `d` of
/// the result.
pub(super) fn refined_shadow_backward(transmittance: f32, out: f32, d: f32) -> (f32, f32) {
    let value = refined_shadow(transmittance, out);
    let d_logit = d * value * (1.0 - value);
    let inside = transmittance > SHADOW_RANGE.0 && transmittance < SHADOW_RANGE.1;
    let slope = transmittance * (1.0 - transmittance);
    (if inside { d_logit / slope } else { 0.0 }, d_logit)
}
