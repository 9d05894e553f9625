//! Reflection of the environment by the surface that a pixel shows, shaded once per pixel from composited channels
//! (deferred shading, as Ye et al. 2024 do for mirrors).
//!
//! Forward, per pixel: [`PixelSurface::new`] from the channels over alpha, [`PixelSurface::encode`] (the decoder's
//! inputs), then, after the decoder ran over all pixels, [`PixelSurface::specular`]. Backward:
//! [`PixelSurface::specular_backward`] to the decoder's outputs, and [`PixelSurface::encode_backward`] from the gradients
//! of its inputs.
//!
//! Limits: a pixel has one normal and one lobe, the mean of its surfaces, and the lobe is as wide along both axes.

use crate::camera::ProjectiveCamera;
use crate::loss::geometry::Unprojection;
use crate::model::background::COLOURS;
use crate::model::shadow_gs::softplus;
use crate::shade::split_sum;
use crate::splat::{MapGradients, Maps};
use glam::Vec3;
use std::ops::Range;

/// Diffuse light toward the eye.
pub(super) const DIFFUSE: Range<usize> = 0..3;
/// The normal that faces the eye.
pub(super) const NORMAL: Range<usize> = 3..6;
/// Light of the harmonics from the reflected direction, blurred by the lobe.
pub(super) const LIGHT: Range<usize> = 6..9;
/// Reflectance at normal incidence times the weight of the specular term.
pub(super) const REFLECTANCE: Range<usize> = 9..12;
/// Weight of the specular term, 0 to 1.
pub(super) const GLOSS: usize = 12;
/// Mean square of the lobe's two widths.
pub(super) const VARIANCE: usize = 13;
/// Material embedding.
pub(super) const EMBEDDED: Range<usize> = 14..16;
/// Channels of a glossy surface.
pub(super) const CHANNELS: usize = EMBEDDED.end;

/// Axes along which the reflected direction is encoded: those of an icosahedron.
const AXES: [Vec3; 6] = [
    Vec3::new(0.0, 0.525_731_1, 0.850_650_8),
    Vec3::new(0.0, 0.525_731_1, -0.850_650_8),
    Vec3::new(0.525_731_1, 0.850_650_8, 0.0),
    Vec3::new(0.525_731_1, -0.850_650_8, 0.0),
    Vec3::new(0.850_650_8, 0.0, 0.525_731_1),
    Vec3::new(-0.850_650_8, 0.0, 0.525_731_1),
];

/// Frequencies of the encoding per axis, radians: each twice the one before.
const WAVES: [f32; 4] = [1.5, 3.0, 6.0, 12.0];
/// Number of values of the encoded direction.
const ENCODED: usize = 2 * AXES.len() * WAVES.len();
const AT_LIGHT: usize = ENCODED;
const AT_COSINE: usize = AT_LIGHT + COLOURS;
const AT_WIDTH: usize = AT_COSINE + 1;
const AT_POSITION: usize = AT_WIDTH + 1;
const AT_EMBEDDING: usize = AT_POSITION + 3;
/// Inputs of the decoder: encoded direction, light of the harmonics, cosine, width, position, embedding.
pub(super) const INPUTS: usize = AT_EMBEDDING + EMBEDDED.end - EMBEDDED.start;

/// Least variance of a lobe: that of the narrowest surface, less rounding.
const VARIANCE_MIN: f32 = 1e-6;

/// The surface that a pixel shows.
pub(super) struct PixelSurface {
    /// Index of the pixel.
    pub(super) pixel: usize,
    /// Composited channels over alpha.
    channels: [f32; CHANNELS],
    /// Mean square of the lobe's widths, more than zero.
    variance: f32,
    /// Length of the mean normal.
    length: f32,
    normal: Vec3,
    to_eye: Vec3,
    /// Cosine between normal and eye.
    facing: f32,
    position: Vec3,
    /// Derivative of the position to the depth.
    along: Vec3,
}

/// Gradients of a loss to a [`PixelSurface`].
#[derive(Default)]
pub(super) struct PixelGradient {
    channels: [f32; CHANNELS],
    cosine: f32,
    depth: f32,
}

/// The lobe's variance along an axis over its mean square width, from the axis' cosines with the normal and the eye, and
/// the cosine between those; with its slopes to the first and the last. A facet turned by δ around y turns the
/// reflected ray by `2 (ω·x) n + 2 (n·ω) x` times δ, and GGX of width α has a variance of α²/2 near its peak.
fn variance_along(by_normal: f32, by_eye: f32, facing: f32) -> (f32, f32, f32) {
    let (p, q, c) = (by_normal, by_eye, facing);
    let variance = 2.0 * (p * p + c * c + 2.0 * p * c * q - 4.0 * p * p * c * c);
    let to_normal = 4.0 * (p + c * q - 4.0 * p * c * c);
    let to_facing = 4.0 * (c + p * q - 4.0 * p * p * c);
    (variance, to_normal, to_facing)
}

impl PixelSurface {
    /// The surface of `pixel`, whose alpha is not zero.
    pub(super) fn new(camera: &ProjectiveCamera, maps: &Maps, pixel: usize) -> Self {
        let inverse = 1.0 / maps.alpha[pixel];
        let channels: [f32; CHANNELS] = std::array::from_fn(|c| maps.channels[c][pixel] * inverse);
        let (col, row) = (pixel % maps.width, pixel / maps.width);
        let (position, along) = Unprojection(camera).point(col, row, maps.depth[pixel] * inverse);
        let (normal, to_eye) = (
            Vec3::from_slice(&channels[NORMAL]),
            -camera.ray_direction(col as f32, row as f32),
        );
        let length = normal.length().max(1e-6);
        let normal = normal / length;
        Self {
            pixel,
            variance: channels[VARIANCE].max(VARIANCE_MIN),
            channels,
            length,
            normal,
            to_eye,
            facing: normal.dot(to_eye),
            position,
            along,
        }
    }

    /// Writes the decoder's inputs. A plane wave over the directions, blurred by the lobe, is the wave times a factor
    /// of the lobe. With these factors the decoder receives the direction only as blurred by the lobe (the integrated
    /// directional encoding of Verbin et al. 2022). `scale` is one over half the side of the cube that contains the
    /// positions.
    pub(super) fn encode(&self, scale: f32, out: &mut [f32]) {
        let reflected = self.normal * (2.0 * self.facing) - self.to_eye;
        let mut at = 0;
        for axis in AXES {
            let along = axis.dot(reflected);
            let (variance, ..) = variance_along(axis.dot(self.normal), axis.dot(self.to_eye), self.facing);
            let mut factor = (-0.5 * WAVES[0] * WAVES[0] * self.variance * variance.max(0.0)).exp();
            let (mut sine, mut cosine) = (WAVES[0] * along).sin_cos();
            for _ in WAVES {
                out[at] = factor * sine;
                out[at + 1] = factor * cosine;
                at += 2;
                // The next wave is twice as fine: the double angle, and a variance four times as large.
                (sine, cosine) = (2.0 * sine * cosine, 1.0 - 2.0 * sine * sine);
                factor = (factor * factor) * (factor * factor);
            }
        }
        out[AT_LIGHT..AT_COSINE].copy_from_slice(&self.channels[LIGHT]);
        out[AT_COSINE] = self.facing.abs();
        out[AT_WIDTH] = self.variance.sqrt();
        out[AT_POSITION..AT_EMBEDDING].copy_from_slice(&(self.position * scale).to_array());
        out[AT_EMBEDDING..INPUTS].copy_from_slice(&self.channels[EMBEDDED]);
    }

    /// Roughness, the fourth root of the variance: the root of the lobe's width.
    fn roughness(&self) -> f32 {
        self.variance.sqrt().sqrt()
    }

    /// Specular light toward the eye. `decoded` is the decoder's output for [`Self::encode`].
    pub(super) fn specular(&self, decoded: [f32; COLOURS]) -> [f32; COLOURS] {
        let sums = split_sum::look_up(self.roughness(), self.facing.abs()).values;
        std::array::from_fn(|k| {
            let share = self.channels[REFLECTANCE.start + k] * sums[0] + self.channels[GLOSS] * sums[1];
            softplus(self.channels[LIGHT.start + k] + decoded[k]) * share
        })
    }

    /// First phase of the backward pass: from the gradient of the specular light, `d`, to all channels, except through
    /// the decoder's inputs. Returns the gradient of the decoder's output.
    pub(super) fn specular_backward(
        &self,
        decoded: [f32; COLOURS],
        d: [f32; COLOURS],
        back: &mut PixelGradient,
    ) -> [f32; COLOURS] {
        let found = split_sum::look_up(self.roughness(), self.facing.abs());
        let (mut d_sums, mut d_decoded) = ([0.0; 2], [0.0; COLOURS]);
        for k in 0..COLOURS {
            let arriving = softplus(self.channels[LIGHT.start + k] + decoded[k]);
            let (reflectance, gloss) = (self.channels[REFLECTANCE.start + k], self.channels[GLOSS]);
            let d_share = d[k] * arriving;
            back.channels[REFLECTANCE.start + k] += d_share * found.values[0];
            back.channels[GLOSS] += d_share * found.values[1];
            d_sums[0] += d_share * reflectance;
            d_sums[1] += d_share * gloss;
            // Slope of the softplus.
            let share = reflectance * found.values[0] + gloss * found.values[1];
            d_decoded[k] = d[k] * share * -(-arriving).exp_m1();
            back.channels[LIGHT.start + k] += d_decoded[k];
        }
        let d_roughness = d_sums[0] * found.roughness[0] + d_sums[1] * found.roughness[1];
        back.channels[VARIANCE] += d_roughness * self.roughness() / (4.0 * self.variance);
        back.cosine += d_sums[0] * found.cosine[0] + d_sums[1] * found.cosine[1];
        d_decoded
    }

    /// Second phase of the backward pass: from the decoder's inputs and their gradients.
    pub(super) fn encode_backward(&self, scale: f32, (inputs, d_inputs): (&[f32], &[f32]), back: &mut PixelGradient) {
        let (mut d_normal, mut d_reflected, mut d_facing) = (Vec3::ZERO, Vec3::ZERO, 0.0);
        let mut at = 0;
        for axis in AXES {
            let (mut d_along, mut d_variance) = (0.0, 0.0);
            for wave in WAVES {
                let (s, c, ds, dc) = (inputs[at], inputs[at + 1], d_inputs[at], d_inputs[at + 1]);
                d_along += wave * (ds * c - dc * s);
                d_variance -= 0.5 * wave * wave * (ds * s + dc * c);
                at += 2;
            }
            d_reflected += axis * d_along;
            let (variance, to_normal, to_facing) =
                variance_along(axis.dot(self.normal), axis.dot(self.to_eye), self.facing);
            back.channels[VARIANCE] += d_variance * variance;
            d_normal += axis * (d_variance * self.variance * to_normal);
            d_facing += d_variance * self.variance * to_facing;
        }
        for k in 0..COLOURS {
            back.channels[LIGHT.start + k] += d_inputs[AT_LIGHT + k];
        }
        back.channels[VARIANCE] += d_inputs[AT_WIDTH] * 0.5 / self.variance.sqrt();
        back.channels[EMBEDDED].copy_from_slice(&d_inputs[AT_EMBEDDING..INPUTS]);
        back.depth += self.along.dot(Vec3::from_slice(&d_inputs[AT_POSITION..AT_EMBEDDING])) * scale;
        d_facing += (back.cosine + d_inputs[AT_COSINE]) * self.facing.signum();
        d_normal += (self.to_eye * d_reflected.dot(self.normal) + d_reflected * self.facing) * 2.0;
        d_normal += self.to_eye * d_facing;
        let d = (d_normal - self.normal * self.normal.dot(d_normal)) / self.length;
        back.channels[NORMAL].copy_from_slice(&d.to_array());
    }

    /// Last phase of the backward pass: adds the gradients of the composited maps.
    pub(super) fn add_to(&self, back: &PixelGradient, maps: &Maps, d_maps: &mut MapGradients) {
        let (pixel, inverse) = (self.pixel, 1.0 / maps.alpha[self.pixel]);
        for c in 0..CHANNELS {
            d_maps.channels[c][pixel] += back.channels[c] * inverse;
            d_maps.alpha[pixel] -= back.channels[c] * self.channels[c] * inverse;
        }
        d_maps.depth[pixel] += back.depth * inverse;
        d_maps.alpha[pixel] -= back.depth * maps.depth[pixel] * inverse * inverse;
    }
}
