//! What small networks add to surfaces under a lamp: light that scatters under them, and a shadow refined.

use super::surface::Place;
use crate::gaussians::sigmoid;
use crate::model::network::Network;
use crate::model::over::COLOURS;
use crate::shade::dipole::Medium;
use glam::Vec3;

/// Numbers of a Gaussian's own that the networks read.
pub(super) const CODE: usize = 6;
/// Numbers that tell a vector: itself, and sine and cosine of it and of twice it.
const TOLD: usize = 15;
/// Inputs of the network that scatters: place, directions to light and eye, normal, code.
pub(super) const SCATTER_INPUTS: usize = 3 * TOLD + 3 + CODE;
/// Inputs of the network that refines shadows: place, direction to the light, code, transmittance.
pub(super) const SHADOW_INPUTS: usize = 2 * TOLD + CODE + 1;
/// Transmittances are refined between these, where their logits are moderate.
const SHADOW_RANGE: (f32, f32) = (0.02, 0.98);

/// Widths of both networks.
pub(super) fn network(inputs: usize, outputs: usize, width: usize, hidden: usize) -> Network {
    Network {
        inputs,
        width,
        hidden,
        outputs,
    }
}

fn tell(v: Vec3, out: &mut [f32]) {
    for (k, x) in v.to_array().into_iter().enumerate() {
        let ((s, c), (s2, c2)) = (x.sin_cos(), (2.0 * x).sin_cos());
        out[k * 5..k * 5 + 5].copy_from_slice(&[x, s, c, s2, c2]);
    }
}

fn tell_backward(told: &[f32], d: &[f32]) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|k| {
        let (t, d) = (&told[k * 5..k * 5 + 5], &d[k * 5..k * 5 + 5]);
        d[0] + d[1] * t[2] - d[2] * t[1] + 2.0 * (d[3] * t[4] - d[4] * t[3])
    }))
}

/// A Gaussian between light and eye, as networks are told of it.
pub(super) struct Told<'a> {
    /// Its place, in halves of the scene.
    pub(super) place: Vec3,
    pub(super) normal: Vec3,
    pub(super) code: &'a [f32],
}

/// Gradients of what networks are told.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ToldGradient {
    pub(super) place: Vec3,
    pub(super) to_light: Vec3,
    pub(super) to_eye: Vec3,
    pub(super) normal: Vec3,
    pub(super) code: [f32; CODE],
}

impl ToldGradient {
    fn add_code(&mut self, d: &[f32]) {
        self.code.iter_mut().zip(d).for_each(|(s, d)| *s += d);
    }
}

impl Told<'_> {
    pub(super) fn of_scattering(&self, at: &Place, out: &mut [f32]) {
        tell(self.place, &mut out[..TOLD]);
        tell(at.to_light, &mut out[TOLD..2 * TOLD]);
        tell(at.to_eye, &mut out[2 * TOLD..3 * TOLD]);
        out[3 * TOLD..3 * TOLD + 3].copy_from_slice(&self.normal.to_array());
        out[3 * TOLD + 3..].copy_from_slice(self.code);
    }

    pub(super) fn of_shadow(&self, at: &Place, transmittance: f32, out: &mut [f32]) {
        tell(self.place, &mut out[..TOLD]);
        tell(at.to_light, &mut out[TOLD..2 * TOLD]);
        out[2 * TOLD..2 * TOLD + CODE].copy_from_slice(self.code);
        out[2 * TOLD + CODE] = transmittance;
    }
}

pub(super) fn scattering_told_backward(told: &[f32], d: &[f32], out: &mut ToldGradient) {
    out.place += tell_backward(&told[..TOLD], &d[..TOLD]);
    out.to_light += tell_backward(&told[TOLD..2 * TOLD], &d[TOLD..2 * TOLD]);
    out.to_eye += tell_backward(&told[2 * TOLD..3 * TOLD], &d[2 * TOLD..3 * TOLD]);
    out.normal += Vec3::from_slice(&d[3 * TOLD..3 * TOLD + 3]);
    out.add_code(&d[3 * TOLD + 3..]);
}

/// Returns the gradient of the transmittance, too.
pub(super) fn shadow_told_backward(told: &[f32], d: &[f32], out: &mut ToldGradient) -> f32 {
    out.place += tell_backward(&told[..TOLD], &d[..TOLD]);
    out.to_light += tell_backward(&told[TOLD..2 * TOLD], &d[TOLD..2 * TOLD]);
    out.add_code(&d[2 * TOLD..2 * TOLD + CODE]);
    d[2 * TOLD + CODE]
}

/// Distance and medium that a network's outputs stand for, in the ranges of SSD-GS, and their slopes.
fn medium(out: [f32; COLOURS]) -> (f32, Medium, [f32; COLOURS]) {
    let s = out.map(sigmoid);
    let slope = |k: usize, reach: f32| reach * s[k] * (1.0 - s[k]);
    let medium = Medium {
        scattering: 2.0 * s[1] + 0.05,
        absorption: 2.0 * s[2] + 0.05,
    };
    (3.0 * s[0] + 0.1, medium, [slope(0, 3.0), slope(1, 2.0), slope(2, 2.0)])
}

/// Light that scatters out, per light that falls in, of colour one.
pub(super) fn scattered(out: [f32; COLOURS]) -> f32 {
    let (distance, medium, _) = medium(out);
    medium.profile(distance).value
}

/// Gradients of the network's outputs.
pub(super) fn scattered_backward(out: [f32; COLOURS], d: f32) -> [f32; COLOURS] {
    let (distance, medium, slopes) = medium(out);
    let found = medium.profile(distance);
    [
        d * found.distance * slopes[0],
        d * found.scattering * slopes[1],
        d * found.absorption * slopes[2],
    ]
}

/// A transmittance, its logit moved by what the network says.
pub(super) fn refined(transmittance: f32, out: f32) -> f32 {
    let t = transmittance.clamp(SHADOW_RANGE.0, SHADOW_RANGE.1);
    // σ(ln(t / (1-t)) + x) without the logarithm.
    t / (t + (1.0 - t) * (-out).exp())
}

/// Gradients of the transmittance and of what the network says.
pub(super) fn refined_backward(transmittance: f32, out: f32, d: f32) -> (f32, f32) {
    let value = refined(transmittance, out);
    let d_logit = d * value * (1.0 - value);
    let inside = transmittance > SHADOW_RANGE.0 && transmittance < SHADOW_RANGE.1;
    let slope = transmittance * (1.0 - transmittance);
    (if inside { d_logit / slope } else { 0.0 }, d_logit)
}
