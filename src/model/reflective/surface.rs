//! Shading of one Gaussian's surface by environment light, forward and backward.
//!
//! Forward, per splat: [`ViewGeometry::new`] (frame, direction to the eye, reflected direction, size of the reflected
//! lobe), then [`ReflectiveSurface::encode`] (the decoder's inputs), then, after the decoder ran over all splats,
//! [`ReflectiveSurface::shade`].
//!
//! Backward has four phases, because shading needs the decoder's output, and the decoder runs once for all splats:
//!
//! 1. [`ReflectiveSurface::shade_backward`]: from the light toward the eye to material, normal and cosine, and to
//!    the decoder's *output*.
//! 2. the decoder's own backward pass (in [`super`]): from its output to its weights and *inputs*.
//! 3. [`ReflectiveSurface::encode_backward`]: from the decoder's inputs, and from the light of the harmonics that
//!    the decoder's output is added to, to material, reflected direction and lobe.
//! 4. [`PartialGradient::finish`]: from the view geometry to frame and position.
//!
//! [`PartialGradient`] carries the gradients of phases 1 and 3.

use crate::gaussians::{normalised, rotation_backward};
use crate::model::background::COLOURS;
use crate::model::shadow_gs::softplus;
use crate::shade::sh::{self, MAX_FUNCTIONS};
use crate::shade::{ggx, split_sum};
use glam::{Mat3, Vec3};
use std::f32::consts::{FRAC_1_PI, SQRT_2};

/// Reflectance of dielectrics at normal incidence.
pub(super) const DIELECTRIC_F0: f32 = 0.04;
/// The clamped cosine in spherical harmonics, by degree, over π (Ramamoorthi and Hanrahan 2001): radiance to irradiance
/// over π.
const COSINE_KERNEL: [f32; 4] = [1.0, 2.0 / 3.0, 0.25, 0.0];
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
/// Numbers of the material embedding of a Gaussian.
pub(super) const EMBEDDING_WIDTH: usize = 6;
const AT_LIGHT: usize = ENCODED;
const AT_COSINE: usize = AT_LIGHT + COLOURS;
const AT_WIDTH: usize = AT_COSINE + 1;
const AT_POSITION: usize = AT_WIDTH + 2;
const AT_EMBEDDING: usize = AT_POSITION + 3;
/// Inputs of the decoder: encoded direction, light of the harmonics, cosine, widths, position, embedding.
pub(super) const INPUTS: usize = AT_EMBEDDING + EMBEDDING_WIDTH;

/// Coefficients of light, `[function][colour]`.
pub(super) type Coefficients = [[f32; COLOURS]; MAX_FUNCTIONS];

/// Degree of a function.
fn degree(function: usize) -> usize {
    [0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3][function]
}

/// Position, material, frame and light of a Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ReflectiveSurface {
    /// Centre of the Gaussian, scene units.
    pub(super) position: Vec3,
    /// Albedo, 0 to 1.
    pub(super) albedo: [f32; COLOURS],
    /// Metallic share, 0 to 1.
    pub(super) metallic: f32,
    /// Widths of the lobe (GGX), along x and y of the frame.
    pub(super) alpha: [f32; 2],
    /// Weight of the specular term, 0 to 1.
    pub(super) gloss: f32,
    /// Quaternion `x, y, z, w` of the frame, z its normal; not necessarily unit.
    pub(super) frame: [f32; 4],
    /// Environment light at the Gaussian.
    pub(super) light: Coefficients,
    /// Material embedding, an input of the decoder.
    pub(super) embedding: [f32; EMBEDDING_WIDTH],
}

/// Gradients of a loss to a [`ReflectiveSurface`], field by field.
pub(super) type SurfaceGradient = ReflectiveSurface;

/// Viewing geometry of a surface, with the direction of the reflected eye ray.
pub(super) struct ViewGeometry {
    frame: Mat3,
    to_eye: Vec3,
    inverse_distance: f32,
    /// 1 where the frame's normal faces the eye, else -1.
    side: f32,
    cosine: f32,
    /// The eye direction reflected at the normal.
    reflected: Vec3,
    /// One standard deviation of the reflected lobe, for each of its two widths.
    lobe_deviation: [Vec3; 2],
}

impl ViewGeometry {
    /// Geometry of `surface` seen from `eye`, the common point of the camera's rays; for parallel rays (`None`),
    /// `toward` is the unit direction to the camera.
    pub(super) fn new(surface: &ReflectiveSurface, eye: Option<Vec3>, toward: Vec3) -> Self {
        let frame = Mat3::from_quat(normalised(surface.frame));
        let offset = eye.map_or(toward, |eye| eye - surface.position);
        let inverse = 1.0 / offset.length().max(1e-12);
        let (to_eye, n) = (offset * inverse, frame.z_axis);
        let n_dot_eye = n.dot(to_eye);
        // A facet turned by δ around y turns the reflected ray by 2 (ω·x) n + 2 (ω·n) x times δ, and GGX of width α has
        // a variance of α²/2 near its peak.
        let lobe_deviation = |k: usize| {
            let axis = frame.col(k);
            (n * to_eye.dot(axis) + axis * n_dot_eye) * (SQRT_2 * surface.alpha[k])
        };
        Self {
            to_eye,
            inverse_distance: if eye.is_some() { inverse } else { 0.0 },
            side: if n_dot_eye < 0.0 { -1.0 } else { 1.0 },
            cosine: n_dot_eye.abs(),
            reflected: n * (2.0 * n_dot_eye) - to_eye,
            lobe_deviation: [lobe_deviation(0), lobe_deviation(1)],
            frame,
        }
    }

    /// The unit normal, on the side that faces the eye.
    pub(super) fn normal(&self) -> Vec3 {
        self.frame.z_axis * self.side
    }
}

/// Factor by which the lobe blurs a degree, `e^(-ρ l (l+1) / 2)` with the lobe's variance ρ; and its logarithmic slope
/// to ρ.
fn blur_factor(alpha: [f32; 2], degree: usize) -> (f32, f32) {
    let rate = -0.5 * (degree * (degree + 1)) as f32;
    ((rate * (alpha[0] * alpha[0] + alpha[1] * alpha[1])).exp(), rate)
}

impl ReflectiveSurface {
    /// Irradiance over π, and the radiance of the blurred reflection, both of the harmonics alone.
    fn harmonic_light(&self, view: &ViewGeometry, functions: usize) -> ([f32; COLOURS], [f32; COLOURS]) {
        let (diffuse_basis, reflected_basis) = (sh::basis(view.normal()), sh::basis(view.reflected));
        let (mut irradiance, mut reflected) = ([0.0; COLOURS], [0.0; COLOURS]);
        let blurs: [f32; 4] = std::array::from_fn(|degree| blur_factor(self.alpha, degree).0);
        for f in 0..functions {
            let (kernel, blur) = (COSINE_KERNEL[degree(f)], blurs[degree(f)]);
            for k in 0..COLOURS {
                irradiance[k] += kernel * diffuse_basis[f] * self.light[f][k];
                reflected[k] += blur * reflected_basis[f] * self.light[f][k];
            }
        }
        (irradiance, reflected)
    }

    /// Writes the decoder's inputs. A plane wave over the directions, blurred by the anisotropic lobe, is the wave
    /// times a factor of the lobe. With these factors the decoder receives the direction only as blurred by the lobe
    /// (the integrated directional encoding of Verbin et al. 2022, here for an anisotropic lobe). `functions` harmonics
    /// are used; `scale` is one over half the side of the cube that contains the positions.
    pub(super) fn encode(&self, view: &ViewGeometry, functions: usize, scale: f32, out: &mut [f32]) {
        let (_, reflected) = self.harmonic_light(view, functions);
        let mut at = 0;
        for axis in AXES {
            let along = axis.dot(view.reflected);
            let variance = axis.dot(view.lobe_deviation[0]).powi(2) + axis.dot(view.lobe_deviation[1]).powi(2);
            let mut factor = (-0.5 * WAVES[0] * WAVES[0] * variance).exp();
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
        out[AT_LIGHT..AT_COSINE].copy_from_slice(&reflected);
        out[AT_COSINE] = view.cosine;
        out[AT_WIDTH..AT_POSITION].copy_from_slice(&self.alpha);
        out[AT_POSITION..AT_EMBEDDING].copy_from_slice(&(self.position * scale).to_array());
        out[AT_EMBEDDING..INPUTS].copy_from_slice(&self.embedding);
    }

    fn roughness(&self) -> f32 {
        (self.alpha[0] * self.alpha[1]).sqrt().sqrt()
    }

    /// Light toward the eye, diffuse and specular, per colour. `decoded` is the decoder's output for [`Self::encode`],
    /// `None` if the surface is not glossy and the decoder was not evaluated.
    pub(super) fn shade(
        &self,
        view: &ViewGeometry,
        functions: usize,
        decoded: Option<[f32; COLOURS]>,
    ) -> ([f32; COLOURS], [f32; COLOURS]) {
        let (irradiance, reflected) = self.harmonic_light(view, functions);
        let diffuse = std::array::from_fn(|k| self.albedo[k] * (1.0 - self.metallic) * irradiance[k].max(0.0));
        let Some(decoded) = decoded else {
            return (diffuse, [0.0; COLOURS]);
        };
        let sums = split_sum::look_up(self.roughness(), view.cosine).values;
        let specular = std::array::from_fn(|k| {
            let f0 = DIELECTRIC_F0 * (1.0 - self.metallic) + self.metallic * self.albedo[k];
            self.gloss * softplus(reflected[k] + decoded[k]) * (f0 * sums[0] + sums[1])
        });
        (diffuse, specular)
    }

    /// First phase of the backward pass: from the gradient of the light toward the eye to all parameters, except
    /// through the decoder's inputs. Returns the gradient of the decoder's output.
    pub(super) fn shade_backward(
        &self,
        view: &ViewGeometry,
        functions: usize,
        decoded: Option<[f32; COLOURS]>,
        d_light: [f32; COLOURS],
        back: &mut PartialGradient,
    ) -> [f32; COLOURS] {
        let (irradiance, reflected) = self.harmonic_light(view, functions);
        let mut d_irradiance = [0.0; COLOURS];
        let out = &mut back.surface;
        for k in 0..COLOURS {
            let lit = irradiance[k].max(0.0);
            out.albedo[k] += d_light[k] * (1.0 - self.metallic) * lit;
            out.metallic -= d_light[k] * self.albedo[k] * lit;
            let d = d_light[k] * self.albedo[k] * (1.0 - self.metallic);
            // Below zero only gradients that brighten pass: clamped light must be able to recover.
            d_irradiance[k] = if irradiance[k] > 0.0 { d } else { d.min(0.0) };
        }
        let normal = view.normal();
        let (basis, slopes) = (sh::basis(normal), sh::basis_gradients(normal));
        let mut d_normal = Vec3::ZERO;
        for f in 0..functions {
            let kernel = COSINE_KERNEL[degree(f)];
            let mut weight = 0.0;
            for k in 0..COLOURS {
                out.light[f][k] += d_irradiance[k] * kernel * basis[f];
                weight += d_irradiance[k] * self.light[f][k];
            }
            d_normal += slopes[f] * (kernel * weight);
        }
        back.normal += d_normal * view.side;
        let Some(decoded) = decoded else {
            return [0.0; COLOURS];
        };
        let found = split_sum::look_up(self.roughness(), view.cosine);
        let (mut d_sums, mut d_decoded) = ([0.0; 2], [0.0; COLOURS]);
        for k in 0..COLOURS {
            let f0 = DIELECTRIC_F0 * (1.0 - self.metallic) + self.metallic * self.albedo[k];
            let (arriving, share) = (
                softplus(reflected[k] + decoded[k]),
                f0 * found.values[0] + found.values[1],
            );
            out.gloss += d_light[k] * arriving * share;
            let d_share = d_light[k] * self.gloss * arriving;
            d_sums[0] += d_share * f0;
            d_sums[1] += d_share;
            out.metallic += d_share * found.values[0] * (self.albedo[k] - DIELECTRIC_F0);
            out.albedo[k] += d_share * found.values[0] * self.metallic;
            // Slope of the softplus.
            d_decoded[k] = d_light[k] * self.gloss * share * -(-arriving).exp_m1();
        }
        let d_roughness = d_sums[0] * found.roughness[0] + d_sums[1] * found.roughness[1];
        for k in 0..2 {
            out.alpha[k] += d_roughness * self.roughness() / (4.0 * self.alpha[k]);
        }
        back.cosine += d_sums[0] * found.cosine[0] + d_sums[1] * found.cosine[1];
        d_decoded
    }

    /// Third phase of the backward pass: from the decoder's inputs and their gradients (`inputs`, `d_inputs`), and from
    /// the gradient of its output, which is also that of the blurred reflection of the harmonics.
    pub(super) fn encode_backward(
        &self,
        view: &ViewGeometry,
        functions: usize,
        scale: f32,
        (inputs, d_inputs): (&[f32], &[f32]),
        d_decoded: [f32; COLOURS],
        back: &mut PartialGradient,
    ) {
        let mut at = 0;
        for axis in AXES {
            let (mut d_along, mut d_variance) = (0.0, 0.0);
            for wave in WAVES {
                let (s, c, ds, dc) = (inputs[at], inputs[at + 1], d_inputs[at], d_inputs[at + 1]);
                d_along += wave * (ds * c - dc * s);
                d_variance -= 0.5 * wave * wave * (ds * s + dc * c);
                at += 2;
            }
            back.reflected += axis * d_along;
            for k in 0..2 {
                back.lobe_deviation[k] += axis * (2.0 * d_variance * axis.dot(view.lobe_deviation[k]));
            }
        }
        let out = &mut back.surface;
        let (basis, slopes) = (sh::basis(view.reflected), sh::basis_gradients(view.reflected));
        let blurs: [(f32, f32); 4] = std::array::from_fn(|degree| blur_factor(self.alpha, degree));
        for f in 0..functions {
            let (blur, rate) = blurs[degree(f)];
            let mut weight = 0.0;
            for k in 0..COLOURS {
                let d = d_inputs[AT_LIGHT + k] + d_decoded[k];
                out.light[f][k] += d * blur * basis[f];
                weight += d * self.light[f][k];
            }
            back.reflected += slopes[f] * (blur * weight);
            for k in 0..2 {
                out.alpha[k] += rate * blur * weight * basis[f] * 2.0 * self.alpha[k];
            }
        }
        back.cosine += d_inputs[AT_COSINE];
        for k in 0..2 {
            out.alpha[k] += d_inputs[AT_WIDTH + k];
        }
        out.position += Vec3::from_slice(&d_inputs[AT_POSITION..AT_EMBEDDING]) * scale;
        out.embedding.copy_from_slice(&d_inputs[AT_EMBEDDING..INPUTS]);
    }

    /// Light toward the eye from a light of strength one in direction `to_light`, without the environment: diffuse and
    /// specular.
    pub(super) fn shade_under_light(&self, view: &ViewGeometry, to_light: Vec3) -> ([f32; COLOURS], [f32; COLOURS]) {
        let mut frame = view.frame;
        frame.z_axis *= view.side;
        let (light, eye) = (frame.transpose() * to_light, frame.transpose() * view.to_eye);
        let cosine = light.z.max(0.0);
        let half = (light + eye).normalize_or(Vec3::Z);
        let lobe = self.gloss * ggx::reflected(light, eye, self.alpha);
        let diffuse = std::array::from_fn(|k| self.albedo[k] * (1.0 - self.metallic) * cosine * FRAC_1_PI);
        let specular = std::array::from_fn(|k| {
            let f0 = DIELECTRIC_F0 * (1.0 - self.metallic) + self.metallic * self.albedo[k];
            lobe * ggx::schlick(f0, light.dot(half))
        });
        (diffuse, specular)
    }
}

/// Gradients of a surface and of its view geometry, collected over the phases of the backward pass.
#[derive(Default)]
pub(super) struct PartialGradient {
    /// Gradients of the surface so far.
    pub(super) surface: SurfaceGradient,
    normal: Vec3,
    cosine: f32,
    reflected: Vec3,
    lobe_deviation: [Vec3; 2],
}

impl PartialGradient {
    /// Adds the gradient `d` of [`ViewGeometry::normal`].
    pub(super) fn add_facing_normal(&mut self, view: &ViewGeometry, d: Vec3) {
        self.normal += d * view.side;
    }

    /// Fourth phase of the backward pass: from the view geometry to frame and position.
    pub(super) fn finish(mut self, surface: &ReflectiveSurface, view: &ViewGeometry) -> SurfaceGradient {
        let (n, eye) = (view.frame.z_axis, view.to_eye);
        let n_dot_eye = view.side * view.cosine;
        let mut d_frame = Mat3::ZERO;
        // The reflected direction 2 (n·ω) n - ω.
        let along = self.reflected.dot(n);
        let mut d_normal = self.normal + (self.reflected * n_dot_eye + eye * along) * 2.0;
        let mut d_eye = n * (2.0 * along) - self.reflected;
        let d_facing = self.cosine * view.side;
        d_normal += eye * d_facing;
        d_eye += n * d_facing;
        for k in 0..2 {
            let (axis, d) = (view.frame.col(k), self.lobe_deviation[k]);
            self.surface.alpha[k] += d.dot(view.lobe_deviation[k]) / surface.alpha[k];
            let d = d * (SQRT_2 * surface.alpha[k]);
            let (by_normal, by_axis) = (d.dot(n), d.dot(axis));
            *d_frame.col_mut(k) += d * n_dot_eye + eye * by_normal;
            d_normal += d * eye.dot(axis) + eye * by_axis;
            d_eye += axis * by_normal + n * by_axis;
        }
        d_frame.z_axis += d_normal;
        let mut out = self.surface;
        out.frame = rotation_backward(surface.frame, d_frame);
        out.position -= (d_eye - eye * eye.dot(d_eye)) * view.inverse_distance;
        out
    }
}
