//! Surface shading of one Gaussian under one light, forward and backward: softened Lambert plus shared lobes times
//! Fresnel.
//!
//! [`LightGeometry`] holds the directions and the falloff, [`OlatSurface`] the material, [`Lobes`] the shared specular
//! basis. The formulas are in the documentation of [`super`].

use crate::camera::ProjectiveCamera;
use crate::gaussians::{normalised, rotation_backward, sigmoid};
use crate::light::Light;
use crate::model::background::COLOURS;
use crate::model::shadow_gs::softplus;
use crate::shade::asg::Lobe;
use crate::shade::falloff::falloff;
use glam::{Mat3, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Lobes that all Gaussians share.
pub const LOBES: usize = 8;
/// Depth of the softened cosine below zero.
const SOFT: f32 = 0.01;
/// `SOFT · (1 - 1/e)`: makes the function zero at -1.
const SOFT_OFFSET: f32 = 0.006_321_206;
/// Least length of the sum of the directions to light and eye, below which they count as opposite.
const LEAST_SUM: f32 = 1e-3;
/// The relative widths of a lobe reach from zero to this.
const WIDEST: f32 = 10.0;

/// A cosine that is softened below zero: value and slope.
#[inline]
pub(super) fn soft_cosine(c: f32) -> (f32, f32) {
    let scale = 1.0 / (1.0 + SOFT_OFFSET);
    if c > 0.0 {
        ((c + SOFT_OFFSET) * scale, scale)
    } else {
        (
            (SOFT * c.exp_m1() + SOFT_OFFSET).max(0.0) * scale,
            SOFT * c.exp() * scale,
        )
    }
}

/// The lobes that all Gaussians share.
pub(super) struct Lobes {
    frames: [Mat3; LOBES],
    shapes: [Lobe; LOBES],
}

/// Width of lobe `j` where its parameter is one: from narrow to wide (GS³).
fn widest(j: usize) -> f32 {
    softplus(-2.0 + 2.0 * j as f32 / (LOBES - 1) as f32)
}

impl Lobes {
    /// Lobes from their stored groups: frames (quaternions), relative widths and widths, the last two before the
    /// sigmoid.
    pub(super) fn new(frames: &[f32], scales: &[f32], sigmas: &[f32]) -> Self {
        let frame = |j: usize| Mat3::from_quat(normalised([0, 1, 2, 3].map(|k| frames[j * 4 + k])));
        Self {
            frames: std::array::from_fn(frame),
            shapes: std::array::from_fn(|j| Lobe {
                lambda: WIDEST * sigmoid(scales[j * 2]).max(1e-5),
                mu: WIDEST * sigmoid(scales[j * 2 + 1]).max(1e-5),
                sigma: (sigmoid(sigmas[j]) * widest(j)).max(1e-4),
            }),
        }
    }

    /// Gradients of the lobes' groups (frames, relative widths, widths) from those of all Gaussians.
    pub(super) fn gradients([frames, scales, sigmas]: [&[f32]; 3], parts: &[SurfaceGradient]) -> [Vec<f32>; 3] {
        let mut out = [vec![0.0; LOBES * 4], vec![0.0; LOBES * 2], vec![0.0; LOBES]];
        for j in 0..LOBES {
            // One after another, in f64: the same sum for any number of threads.
            let (mut turned, mut shape) = ([0.0f64; 9], [0.0f64; 3]);
            for part in parts {
                let d = &part.lobes[j];
                for row in 0..3 {
                    for col in 0..3 {
                        turned[col * 3 + row] += f64::from(part.half[row] * d.direction[col]);
                    }
                }
                shape.iter_mut().zip(d.shape).for_each(|(sum, d)| *sum += f64::from(d));
            }
            let d_frame = Mat3::from_cols_array(&turned.map(|d| d as f32));
            let raw = [0, 1, 2, 3].map(|k| frames[j * 4 + k]);
            out[0][j * 4..j * 4 + 4].copy_from_slice(&rotation_backward(raw, d_frame));
            let slope = |raw: f32| sigmoid(raw) * (1.0 - sigmoid(raw));
            for k in 0..2 {
                out[1][j * 2 + k] = shape[k] as f32 * WIDEST * slope(scales[j * 2 + k]);
            }
            out[2][j] = shape[2] as f32 * widest(j) * slope(sigmas[j]);
        }
        out
    }
}

/// Unit directions from a Gaussian to light and eye, and the light's falloff there.
#[derive(Debug, Clone, Copy)]
pub(super) struct LightGeometry {
    /// Unit direction to the light.
    pub(super) to_light: Vec3,
    /// Unit direction to the eye.
    pub(super) to_eye: Vec3,
    /// One over the distances to light and eye; zero where they are infinitely far.
    inverse_light: f32,
    inverse_eye: f32,
    /// Falloff of a light of strength one, see [`falloff`].
    pub(super) falloff: f32,
    /// Gradient of the falloff to the position.
    d_falloff: Vec3,
}

impl LightGeometry {
    /// Geometry of a Gaussian at `position` under `light`; `distance` and `radius` are those of [`falloff`].
    pub(super) fn new(position: Vec3, light: &Light, camera: &ProjectiveCamera, distance: f32, radius: f32) -> Self {
        let (to_light, distance_to_light) = light.seen_from(position);
        let (to_eye, inverse_eye) = match camera.eye() {
            Some(eye) => {
                let length = (eye - position).length().max(1e-12);
                ((eye - position) / length, 1.0 / length)
            }
            None => (-camera.depth_axis, 0.0),
        };
        if !distance_to_light.is_finite() {
            return Self {
                to_light,
                to_eye,
                inverse_light: 0.0,
                inverse_eye,
                falloff: 1.0,
                d_falloff: Vec3::ZERO,
            };
        }
        let (value, slope) = falloff(distance_to_light, distance, radius);
        Self {
            to_light,
            to_eye,
            // At the position of the light itself the direction is a convention and does not turn.
            inverse_light: if distance_to_light > 0.0 {
                1.0 / distance_to_light
            } else {
                0.0
            },
            inverse_eye,
            falloff: value,
            d_falloff: to_light * -slope,
        }
    }
}

impl LightGeometry {
    /// Gradient of the position, from those of the directions to light and eye and of the falloff.
    pub(super) fn position_gradient(&self, d_light: Vec3, d_eye: Vec3, d_falloff: f32) -> Vec3 {
        let across = |unit: Vec3, d: Vec3| d - unit * unit.dot(d);
        self.d_falloff * d_falloff
            - across(self.to_light, d_light) * self.inverse_light
            - across(self.to_eye, d_eye) * self.inverse_eye
    }
}

/// Material and frame of a Gaussian.
#[derive(Debug, Clone, Copy)]
pub(super) struct OlatSurface {
    /// Diffuse colour.
    pub(super) diffuse: [f32; COLOURS],
    /// Quaternion `x, y, z, w` that turns the surface's own z axis to its normal; not necessarily unit.
    pub(super) frame: [f32; 4],
    /// Specular colour.
    pub(super) specular: [f32; COLOURS],
    /// Weight of each lobe.
    pub(super) weights: [f32; LOBES],
    /// F0, reflectance at normal incidence (Schlick 1994), 0 to 1: about 0.04 for dielectrics, large for metals.
    pub(super) f0: f32,
}

/// Reflected light per incoming light: the diffuse and the specular part.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shaded {
    /// Diffuse part, before shadow and falloff.
    pub(super) diffuse: [f32; COLOURS],
    /// Specular part, before shadow and falloff.
    pub(super) specular: [f32; COLOURS],
}

/// Inputs of the gradients of the shared lobes, for one Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LobeGradient {
    direction: Vec3,
    shape: [f32; 3],
}

/// Gradients of a loss to the surface of a Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SurfaceGradient {
    /// Gradient to the diffuse colour.
    pub(super) diffuse: [f32; COLOURS],
    /// Gradient to the specular colour.
    pub(super) specular: [f32; COLOURS],
    /// Gradients to the lobes' weights.
    pub(super) weights: [f32; LOBES],
    /// Gradient to F0.
    pub(super) f0: f32,
    /// Gradient to the frame's quaternion.
    pub(super) frame: [f32; 4],
    /// Gradient to the position.
    pub(super) position: Vec3,
    /// Gradient to the transmittance toward the light.
    pub(super) transmittance: f32,
    /// The half vector in the surface's frame, and each lobe's gradients there.
    half: Vec3,
    lobes: [LobeGradient; LOBES],
}

impl SurfaceGradient {
    /// Adds the gradient `d` of the surface's normal to that of the frame.
    pub(super) fn turn_normal(&mut self, surface: &OlatSurface, d: Vec3) {
        let mut turned = Mat3::ZERO;
        turned.z_axis = d;
        let added = rotation_backward(surface.frame, turned);
        self.frame.iter_mut().zip(added).for_each(|(slot, d)| *slot += d);
    }
}

/// The half vector of light and eye, and the Fresnel and masking terms that depend on it.
struct HalfVector {
    sum: f32,
    direction: Vec3,
    /// Cosine between the half vector and the light.
    cosine: f32,
}

/// Least cosine between half vector and light in the masking term: below it, surfaces of medium roughness mask more
/// than the inverse square predicts.
const LEAST_COSINE: f32 = 0.25;

impl HalfVector {
    fn new(geometry: &LightGeometry) -> Self {
        let sum = geometry.to_light + geometry.to_eye;
        let length = sum.length().max(LEAST_SUM);
        Self {
            sum: length,
            direction: sum / length,
            cosine: (0.5 * length).min(1.0),
        }
    }

    /// Schlick's Fresnel term over the squared cosine, which approximates masking and shadowing over `(n·l)(n·v)`
    /// (Kelemen and Szirmay-Kalos 2001): value, and slopes to F0 and to the cosine.
    fn fresnel(&self, f0: f32) -> (f32, f32, f32) {
        let rest = 1.0 - self.cosine;
        let grazing = rest.powi(5);
        let share = f0 + (1.0 - f0) * grazing;
        let slope = -5.0 * (1.0 - f0) * rest.powi(4);
        let cosine = self.cosine.max(LEAST_COSINE);
        let seen = 1.0 / (cosine * cosine);
        let bending = if self.cosine > LEAST_COSINE {
            -2.0 * share * seen / cosine
        } else {
            0.0
        };
        (share * seen, (1.0 - grazing) * seen, slope * seen + bending)
    }
}

impl OlatSurface {
    /// Light toward the eye from a light of strength one, before shadow and falloff.
    pub(super) fn shade(&self, lobes: Option<&Lobes>, geometry: &LightGeometry) -> Shaded {
        let frame = Mat3::from_quat(normalised(self.frame));
        let (cosine, _) = soft_cosine(frame.z_axis.dot(geometry.to_light));
        let gloss = lobes.map_or(0.0, |lobes| {
            let half = HalfVector::new(geometry);
            let own = frame.transpose() * half.direction;
            let lobe = |j: usize| self.weights[j] * lobes.shapes[j].value(lobes.frames[j].transpose() * own);
            (0..LOBES).map(lobe).sum::<f32>() * half.fresnel(self.f0).0
        });
        Shaded {
            diffuse: self.diffuse.map(|c| c * cosine * FRAC_1_PI),
            specular: self.specular.map(|c| c * gloss * cosine),
        }
    }

    /// Backward of the colour `(diffuse + specular) · transmittance · falloff`.
    pub(super) fn shade_backward(
        &self,
        lobes: Option<&Lobes>,
        geometry: &LightGeometry,
        transmittance: f32,
        d_colour: [f32; COLOURS],
    ) -> SurfaceGradient {
        let frame = Mat3::from_quat(normalised(self.frame));
        let (cosine, slope) = soft_cosine(frame.z_axis.dot(geometry.to_light));
        let mut out = SurfaceGradient::default();
        let half = HalfVector::new(geometry);
        out.half = frame.transpose() * half.direction;
        let mut values = [0.0; LOBES];
        let (mut lobe_sum, mut in_frames) = (0.0, [Vec3::ZERO; LOBES]);
        if let Some(lobes) = lobes {
            for j in 0..LOBES {
                in_frames[j] = lobes.frames[j].transpose() * out.half;
                values[j] = lobes.shapes[j].value(in_frames[j]);
                lobe_sum += self.weights[j] * values[j];
            }
        }
        let (fresnel, by_f0, by_cosine) = half.fresnel(self.f0);
        let gloss = lobe_sum * fresnel;
        let arriving = transmittance * geometry.falloff;
        let (mut d_cosine, mut d_gloss, mut d_falloff) = (0.0, 0.0, 0.0);
        for (k, d) in d_colour.into_iter().enumerate() {
            let per_cosine = self.diffuse[k] * FRAC_1_PI + self.specular[k] * gloss;
            out.diffuse[k] = d * arriving * cosine * FRAC_1_PI;
            out.specular[k] = d * arriving * cosine * gloss;
            out.transmittance += d * per_cosine * cosine * geometry.falloff;
            d_falloff += d * per_cosine * cosine * transmittance;
            d_cosine += d * arriving * per_cosine;
            d_gloss += d * arriving * cosine * self.specular[k];
        }
        let mut d_frame = Mat3::ZERO;
        d_frame.z_axis = geometry.to_light * (d_cosine * slope);
        let mut d_light = frame.z_axis * (d_cosine * slope);
        let mut d_eye = Vec3::ZERO;
        if let Some(lobes) = lobes {
            let mut d_own = Vec3::ZERO;
            for j in 0..LOBES {
                let d_value = d_gloss * fresnel;
                out.weights[j] = d_value * values[j];
                let weight = d_value * self.weights[j];
                let found = lobes.shapes[j].value_and_gradients(in_frames[j]);
                let direction = found.direction * weight;
                out.lobes[j] = LobeGradient {
                    direction,
                    shape: found.shape.map(|d| d * weight),
                };
                d_own += lobes.frames[j] * direction;
            }
            // own = frameᵀ · half
            for k in 0..3 {
                *d_frame.col_mut(k) += half.direction * d_own[k];
            }
            let d_half = frame * d_own;
            let along = half.direction.dot(d_half);
            let mut d_sum = (d_half - half.direction * along) / half.sum;
            out.f0 = d_gloss * lobe_sum * by_f0;
            // The cosine is half of the sum's length.
            d_sum += half.direction * (0.5 * d_gloss * lobe_sum * by_cosine);
            d_light += d_sum;
            d_eye += d_sum;
        }
        out.frame = rotation_backward(self.frame, d_frame);
        out.position = geometry.position_gradient(d_light, d_eye, d_falloff);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Olat, OlatOptions};
    use super::*;
    use std::f32::consts::PI;

    #[test]
    fn a_gradient_of_the_normal_turns_the_frame() {
        let surface = |frame| OlatSurface {
            diffuse: [0.0; COLOURS],
            frame,
            specular: [0.0; COLOURS],
            weights: [0.0; LOBES],
            f0: 0.04,
        };
        let (at, d) = ([0.3, -0.5, 0.2, 0.9], Vec3::new(0.7, -0.2, 0.4));
        let along = |frame: [f32; 4]| (Mat3::from_quat(normalised(frame)) * Vec3::Z).dot(d);
        let mut found = SurfaceGradient::default();
        found.turn_normal(&surface(at), d);
        for k in 0..4 {
            let moved = |by: f32| std::array::from_fn(|i| at[i] + if i == k { by } else { 0.0 });
            let numeric = (along(moved(1e-3)) - along(moved(-1e-3))) / 2e-3;
            assert!(
                (numeric - found.frame[k]).abs() < 1e-3,
                "{k}: {numeric} {}",
                found.frame[k]
            );
        }
    }

    #[test]
    fn reflectance_has_the_slopes_it_says() {
        for cosine in [0.1f32, 0.4, 0.9] {
            let half = |cosine: f32| HalfVector {
                sum: 2.0 * cosine,
                direction: Vec3::Z,
                cosine,
            };
            let (h, step) = (0.3, 1e-3);
            let (_, by_f0, by_cosine) = half(cosine).fresnel(h);
            let slope = |hi: f32, lo: f32| (hi - lo) / (2.0 * step);
            let f0 = slope(half(cosine).fresnel(h + step).0, half(cosine).fresnel(h - step).0);
            let turned = slope(half(cosine + step).fresnel(h).0, half(cosine - step).fresnel(h).0);
            assert!((f0 - by_f0).abs() < 2e-2 * by_f0.abs().max(1.0), "{cosine}");
            assert!((turned - by_cosine).abs() < 2e-2 * by_cosine.abs().max(1.0), "{cosine}");
        }
    }

    #[test]
    fn at_the_start_some_lobe_lies_along_any_grain() {
        let globals = Olat::new(OlatOptions::default()).initial_globals();
        let lobes = Lobes::new(globals.group(0), globals.group(1), globals.group(2));
        for step in 0..12 {
            let turn = Mat3::from_rotation_z(step as f32 * PI / 12.0);
            let tilted = |x: f32, y: f32| turn * Vec3::new(x, y, 1.0).normalize();
            let (along, across) = (tilted(0.4, 0.0), tilted(0.0, 0.4));
            let value = |j: usize, h: Vec3| lobes.shapes[j].value(lobes.frames[j].transpose() * h);
            let ratios: Vec<f32> = (0..LOBES).map(|j| value(j, along) / value(j, across)).collect();
            let (longer, shorter) = (ratios.iter().any(|&r| r > 1.1), ratios.iter().any(|&r| r < 0.9));
            assert!(longer && shorter, "{step}: {ratios:?}");
        }
    }

    #[test]
    fn the_softened_cosine_is_zero_behind_one_ahead_and_alive_between() {
        assert!(soft_cosine(-1.0).0.abs() < 1e-7 && (soft_cosine(1.0).0 - 1.0).abs() < 1e-6);
        assert!((soft_cosine(0.0).0 - 0.00628).abs() < 1e-5);
        for c in [-0.95f32, -0.5, -1e-3, 1e-3, 0.7] {
            let numeric = (soft_cosine(c + 1e-3).0 - soft_cosine(c - 1e-3).0) / 2e-3;
            if c.abs() > 2e-3 {
                assert!(
                    (numeric - soft_cosine(c).1).abs() < 1e-3 && soft_cosine(c).1 > 0.0,
                    "{c}"
                );
            }
        }
    }
}
