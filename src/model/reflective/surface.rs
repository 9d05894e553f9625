//! The surface of one Gaussian: the channels that pixels are shaded from, forward and backward.
//!
//! [`ReflectiveSurface::channels`] writes diffuse light, which is shaded per Gaussian, and what the reflection of a
//! pixel needs ([`super::reflection`]). Its backward pass has two phases: [`ReflectiveSurface::channels_backward`] to
//! material, light, normal and reflected direction, and [`PartialGradient::finish`] from these to frame and position.

use super::reflection::{CHANNELS, DIFFUSE, EMBEDDED, GLOSS, LIGHT, NORMAL, REFLECTANCE, VARIANCE};
use crate::gaussians::{normalised, rotation_backward};
use crate::model::background::COLOURS;
use crate::shade::ggx;
use crate::shade::sh::{self, MAX_FUNCTIONS};
use glam::{Mat3, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Reflectance of dielectrics at normal incidence.
pub(super) const DIELECTRIC_F0: f32 = 0.04;
/// The clamped cosine in spherical harmonics, by degree, over π (Ramamoorthi and Hanrahan 2001): radiance to irradiance
/// over π.
const COSINE_KERNEL: [f32; 4] = [1.0, 2.0 / 3.0, 0.25, 0.0];
/// Numbers of the material embedding of a Gaussian.
pub(super) const EMBEDDING_WIDTH: usize = EMBEDDED.end - EMBEDDED.start;

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
    /// The eye direction reflected at the normal.
    reflected: Vec3,
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
        Self {
            to_eye,
            inverse_distance: if eye.is_some() { inverse } else { 0.0 },
            side: if n_dot_eye < 0.0 { -1.0 } else { 1.0 },
            reflected: n * (2.0 * n_dot_eye) - to_eye,
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

    /// Reflectance at normal incidence.
    fn f0(&self, colour: usize) -> f32 {
        DIELECTRIC_F0 * (1.0 - self.metallic) + self.metallic * self.albedo[colour]
    }

    /// Writes the channels of the surface, those up to the normal alone if `out` is no longer. `functions` harmonics are
    /// used.
    pub(super) fn channels(&self, view: &ViewGeometry, functions: usize, out: &mut [f32]) {
        let (irradiance, reflected) = self.harmonic_light(view, functions);
        for k in 0..COLOURS {
            out[DIFFUSE.start + k] = self.albedo[k] * (1.0 - self.metallic) * irradiance[k].max(0.0);
        }
        out[NORMAL].copy_from_slice(&view.normal().to_array());
        if out.len() < CHANNELS {
            return;
        }
        out[LIGHT].copy_from_slice(&reflected);
        for k in 0..COLOURS {
            out[REFLECTANCE.start + k] = self.gloss * self.f0(k);
        }
        out[GLOSS] = self.gloss;
        out[VARIANCE] = 0.5 * (self.alpha[0] * self.alpha[0] + self.alpha[1] * self.alpha[1]);
        out[EMBEDDED].copy_from_slice(&self.embedding);
    }

    /// First phase of the backward pass of [`Self::channels`], whose gradients are `d`.
    pub(super) fn channels_backward(
        &self,
        view: &ViewGeometry,
        functions: usize,
        d: &[f32],
        back: &mut PartialGradient,
    ) {
        self.diffuse_backward(view, functions, &d[DIFFUSE], back);
        back.normal += Vec3::from_slice(&d[NORMAL]) * view.side;
        if d.len() < CHANNELS {
            return;
        }
        self.reflected_backward(view, functions, &d[LIGHT], back);
        let out = &mut back.surface;
        for k in 0..COLOURS {
            let d = d[REFLECTANCE.start + k];
            out.gloss += d * self.f0(k);
            out.metallic += d * self.gloss * (self.albedo[k] - DIELECTRIC_F0);
            out.albedo[k] += d * self.gloss * self.metallic;
        }
        out.gloss += d[GLOSS];
        for k in 0..2 {
            out.alpha[k] += d[VARIANCE] * self.alpha[k];
        }
        out.embedding.copy_from_slice(&d[EMBEDDED]);
    }

    /// From the gradients of the diffuse light.
    fn diffuse_backward(&self, view: &ViewGeometry, functions: usize, d_light: &[f32], back: &mut PartialGradient) {
        let (irradiance, _) = self.harmonic_light(view, functions);
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
    }

    /// From the gradients of the harmonics' light along the reflection.
    fn reflected_backward(&self, view: &ViewGeometry, functions: usize, d_light: &[f32], back: &mut PartialGradient) {
        let out = &mut back.surface;
        let (basis, slopes) = (sh::basis(view.reflected), sh::basis_gradients(view.reflected));
        let blurs: [(f32, f32); 4] = std::array::from_fn(|degree| blur_factor(self.alpha, degree));
        for f in 0..functions {
            let (blur, rate) = blurs[degree(f)];
            let mut weight = 0.0;
            for k in 0..COLOURS {
                out.light[f][k] += d_light[k] * blur * basis[f];
                weight += d_light[k] * self.light[f][k];
            }
            back.reflected += slopes[f] * (blur * weight);
            for k in 0..2 {
                out.alpha[k] += rate * blur * weight * basis[f] * 2.0 * self.alpha[k];
            }
        }
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
        let specular = std::array::from_fn(|k| lobe * ggx::schlick(self.f0(k), light.dot(half)));
        (diffuse, specular)
    }
}

/// Gradients of a surface and of its view geometry, collected over the phases of the backward pass.
#[derive(Default)]
pub(super) struct PartialGradient {
    /// Gradients of the surface so far.
    surface: SurfaceGradient,
    normal: Vec3,
    reflected: Vec3,
}

impl PartialGradient {
    /// Second phase of the backward pass: from the view geometry to frame and position.
    pub(super) fn finish(self, surface: &ReflectiveSurface, view: &ViewGeometry) -> SurfaceGradient {
        let (n, eye) = (view.frame.z_axis, view.to_eye);
        // The reflected direction 2 (n·ω) n - ω.
        let along = self.reflected.dot(n);
        let d_normal = self.normal + (self.reflected * n.dot(eye) + eye * along) * 2.0;
        let d_eye = n * (2.0 * along) - self.reflected;
        let mut out = self.surface;
        let d_frame = Mat3::from_cols(Vec3::ZERO, Vec3::ZERO, d_normal);
        out.frame = rotation_backward(surface.frame, d_frame);
        out.position -= (d_eye - eye * eye.dot(d_eye)) * view.inverse_distance;
        out
    }
}
