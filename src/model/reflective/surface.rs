//! One Gaussian's surface in its surroundings, forward and backward.

use crate::gaussians::{normalised, rotation_backward};
use crate::model::over::COLOURS;
use crate::model::shadow_gs::softplus;
use crate::shade::sh::{self, MAX_FUNCTIONS};
use crate::shade::{ggx, split_sum};
use glam::{Mat3, Vec3};
use std::f32::consts::{FRAC_1_PI, SQRT_2};

/// Reflectance of what is no metal, head on.
pub(super) const HEAD_ON: f32 = 0.04;
/// What a surface gathers of a degree of the harmonics, cosine and 1/π included (Ramamoorthi and Hanrahan 2001).
const GATHERED: [f32; 4] = [1.0, 2.0 / 3.0, 0.25, 0.0];
/// Axes along which reflected directions are told to the decoder: those of an icosahedron.
const AXES: [Vec3; 6] = [
    Vec3::new(0.0, 0.525_731_1, 0.850_650_8),
    Vec3::new(0.0, 0.525_731_1, -0.850_650_8),
    Vec3::new(0.525_731_1, 0.850_650_8, 0.0),
    Vec3::new(0.525_731_1, -0.850_650_8, 0.0),
    Vec3::new(0.850_650_8, 0.0, 0.525_731_1),
    Vec3::new(-0.850_650_8, 0.0, 0.525_731_1),
];
/// Waves per axis, radians: each twice as fine as the one before.
const WAVES: [f32; 4] = [1.5, 3.0, 6.0, 12.0];
/// Numbers that tell a direction.
const TOLD: usize = 2 * AXES.len() * WAVES.len();
/// Numbers of a Gaussian's own that the decoder reads.
pub(super) const CODE: usize = 6;
const AT_LIGHT: usize = TOLD;
const AT_COSINE: usize = AT_LIGHT + COLOURS;
const AT_WIDTH: usize = AT_COSINE + 1;
const AT_POSITION: usize = AT_WIDTH + 2;
const AT_CODE: usize = AT_POSITION + 3;
/// Numbers that the decoder reads.
pub(super) const INPUTS: usize = AT_CODE + CODE;

/// Coefficients of light, `[function][colour]`.
pub(super) type Coefficients = [[f32; COLOURS]; MAX_FUNCTIONS];

/// Degree of a function.
fn degree(function: usize) -> usize {
    [0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3][function]
}

/// What a Gaussian's surface is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface {
    pub(super) position: Vec3,
    pub(super) albedo: [f32; COLOURS],
    pub(super) metallic: f32,
    /// Widths of the lobe, along x and y of the frame.
    pub(super) alpha: [f32; 2],
    /// Share of the gloss that is there at all.
    pub(super) gloss: f32,
    pub(super) frame: [f32; 4],
    pub(super) light: Coefficients,
    pub(super) code: [f32; CODE],
}

/// Gradients of a surface.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SurfaceGradient {
    pub(super) position: Vec3,
    pub(super) albedo: [f32; COLOURS],
    pub(super) metallic: f32,
    pub(super) alpha: [f32; 2],
    pub(super) gloss: f32,
    pub(super) frame: [f32; 4],
    pub(super) light: Coefficients,
    pub(super) code: [f32; CODE],
}

/// How a surface is looked at.
pub(super) struct Sight {
    frame: Mat3,
    to_eye: Vec3,
    inverse_distance: f32,
    /// 1 where the frame's normal faces the eye, else -1.
    side: f32,
    cosine: f32,
    /// Where a mirror would send the eye's ray.
    mirrored: Vec3,
    /// One standard deviation of the reflected lobe, for each of the two widths.
    spread: [Vec3; 2],
}

impl Sight {
    /// `eye` is where rays meet; with parallel rays, `toward` is where they come from.
    pub(super) fn new(surface: &Surface, eye: Option<Vec3>, toward: Vec3) -> Self {
        let frame = Mat3::from_quat(normalised(surface.frame));
        let offset = eye.map_or(toward, |eye| eye - surface.position);
        let inverse = 1.0 / offset.length().max(1e-12);
        let (to_eye, n) = (offset * inverse, frame.z_axis);
        let facing = n.dot(to_eye);
        // A facet turned by δ around y turns the mirrored ray by 2 (ω·x) n + 2 (ω·n) x times δ, and GGX of width α has a variance
        // of α²/2 near its peak.
        let spread = |k: usize| {
            let axis = frame.col(k);
            (n * to_eye.dot(axis) + axis * facing) * (SQRT_2 * surface.alpha[k])
        };
        Self {
            to_eye,
            inverse_distance: if eye.is_some() { inverse } else { 0.0 },
            side: if facing < 0.0 { -1.0 } else { 1.0 },
            cosine: facing.abs(),
            mirrored: n * (2.0 * facing) - to_eye,
            spread: [spread(0), spread(1)],
            frame,
        }
    }

    /// The normal that faces the eye.
    pub(super) fn normal(&self) -> Vec3 {
        self.frame.z_axis * self.side
    }
}

/// How much the lobe blurs a degree: `e^(-ρ l (l+1) / 2)` with the lobe's variance ρ, and its slope to ρ over itself.
fn blurred(alpha: [f32; 2], degree: usize) -> (f32, f32) {
    let rate = -0.5 * (degree * (degree + 1)) as f32;
    ((rate * (alpha[0] * alpha[0] + alpha[1] * alpha[1])).exp(), rate)
}

impl Surface {
    /// Light that the surface gathers, and that a mirror as rough would show, as far as harmonics know.
    fn gathered(&self, sight: &Sight, functions: usize) -> ([f32; COLOURS], [f32; COLOURS]) {
        let (across, along) = (sh::basis(sight.normal()), sh::basis(sight.mirrored));
        let (mut even, mut mirrored) = ([0.0; COLOURS], [0.0; COLOURS]);
        let blurs: [f32; 4] = std::array::from_fn(|degree| blurred(self.alpha, degree).0);
        for f in 0..functions {
            let (gathers, blur) = (GATHERED[degree(f)], blurs[degree(f)]);
            for k in 0..COLOURS {
                even[k] += gathers * across[f] * self.light[f][k];
                mirrored[k] += blur * along[f] * self.light[f][k];
            }
        }
        (even, mirrored)
    }

    /// What the decoder reads. A wave over all directions, blurred by the lobe, is the wave times the lobe's own factor: told like
    /// this, what the decoder makes of waves is light that went through the anisotropic lobe.
    pub(super) fn tell(&self, sight: &Sight, functions: usize, scale: f32, out: &mut [f32]) {
        let (_, mirrored) = self.gathered(sight, functions);
        let mut at = 0;
        for axis in AXES {
            let along = axis.dot(sight.mirrored);
            let variance = axis.dot(sight.spread[0]).powi(2) + axis.dot(sight.spread[1]).powi(2);
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
        out[AT_LIGHT..AT_COSINE].copy_from_slice(&mirrored);
        out[AT_COSINE] = sight.cosine;
        out[AT_WIDTH..AT_POSITION].copy_from_slice(&self.alpha);
        out[AT_POSITION..AT_CODE].copy_from_slice(&(self.position * scale).to_array());
        out[AT_CODE..INPUTS].copy_from_slice(&self.code);
    }

    fn roughness(&self) -> f32 {
        (self.alpha[0] * self.alpha[1]).sqrt().sqrt()
    }

    /// Light toward the eye, reflected evenly and as by a mirror; `decoded` is what the decoder made of [`Self::tell`], `None` where
    /// nothing is glossy.
    pub(super) fn shade(
        &self,
        sight: &Sight,
        functions: usize,
        decoded: Option<[f32; COLOURS]>,
    ) -> ([f32; COLOURS], [f32; COLOURS]) {
        let (even, mirrored) = self.gathered(sight, functions);
        let diffuse = std::array::from_fn(|k| self.albedo[k] * (1.0 - self.metallic) * even[k].max(0.0));
        let Some(decoded) = decoded else {
            return (diffuse, [0.0; COLOURS]);
        };
        let sums = split_sum::look_up(self.roughness(), sight.cosine).values;
        let specular = std::array::from_fn(|k| {
            let head_on = HEAD_ON * (1.0 - self.metallic) + self.metallic * self.albedo[k];
            self.gloss * softplus(mirrored[k] + decoded[k]) * (head_on * sums[0] + sums[1])
        });
        (diffuse, specular)
    }

    /// First half of the way back: from the gradient of the light toward the eye to all but what goes through the decoder's inputs;
    /// returns the gradient of what the decoder gives, too.
    pub(super) fn shade_backward(
        &self,
        sight: &Sight,
        functions: usize,
        decoded: Option<[f32; COLOURS]>,
        d_light: [f32; COLOURS],
        back: &mut Backward,
    ) -> [f32; COLOURS] {
        let (even, mirrored) = self.gathered(sight, functions);
        let mut d_even = [0.0; COLOURS];
        let out = &mut back.surface;
        for k in 0..COLOURS {
            let lit = even[k].max(0.0);
            out.albedo[k] += d_light[k] * (1.0 - self.metallic) * lit;
            out.metallic -= d_light[k] * self.albedo[k] * lit;
            let d = d_light[k] * self.albedo[k] * (1.0 - self.metallic);
            // In the dark, light hears only what would make it brighter: it must find its way back.
            d_even[k] = if even[k] > 0.0 { d } else { d.min(0.0) };
        }
        let normal = sight.normal();
        let (basis, slopes) = (sh::basis(normal), sh::basis_gradients(normal));
        let mut d_normal = Vec3::ZERO;
        for f in 0..functions {
            let gathers = GATHERED[degree(f)];
            let mut weight = 0.0;
            for k in 0..COLOURS {
                out.light[f][k] += d_even[k] * gathers * basis[f];
                weight += d_even[k] * self.light[f][k];
            }
            d_normal += slopes[f] * (gathers * weight);
        }
        back.normal += d_normal * sight.side;
        let Some(decoded) = decoded else {
            return [0.0; COLOURS];
        };
        let found = split_sum::look_up(self.roughness(), sight.cosine);
        let (mut d_sums, mut d_decoded) = ([0.0; 2], [0.0; COLOURS]);
        for k in 0..COLOURS {
            let head_on = HEAD_ON * (1.0 - self.metallic) + self.metallic * self.albedo[k];
            let (arriving, share) = (
                softplus(mirrored[k] + decoded[k]),
                head_on * found.values[0] + found.values[1],
            );
            out.gloss += d_light[k] * arriving * share;
            let d_share = d_light[k] * self.gloss * arriving;
            d_sums[0] += d_share * head_on;
            d_sums[1] += d_share;
            out.metallic += d_share * found.values[0] * (self.albedo[k] - HEAD_ON);
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

    /// Second half: from gradients of what the decoder reads (`told`, `d_told`) and of what it gives, which is also that of the
    /// mirrored light.
    pub(super) fn tell_backward(
        &self,
        sight: &Sight,
        functions: usize,
        scale: f32,
        (told, d_told): (&[f32], &[f32]),
        d_decoded: [f32; COLOURS],
        back: &mut Backward,
    ) {
        let mut at = 0;
        for axis in AXES {
            let (mut d_along, mut d_variance) = (0.0, 0.0);
            for wave in WAVES {
                let (s, c, ds, dc) = (told[at], told[at + 1], d_told[at], d_told[at + 1]);
                d_along += wave * (ds * c - dc * s);
                d_variance -= 0.5 * wave * wave * (ds * s + dc * c);
                at += 2;
            }
            back.mirrored += axis * d_along;
            for k in 0..2 {
                back.spread[k] += axis * (2.0 * d_variance * axis.dot(sight.spread[k]));
            }
        }
        let out = &mut back.surface;
        let (basis, slopes) = (sh::basis(sight.mirrored), sh::basis_gradients(sight.mirrored));
        let blurs: [(f32, f32); 4] = std::array::from_fn(|degree| blurred(self.alpha, degree));
        for f in 0..functions {
            let (blur, rate) = blurs[degree(f)];
            let mut weight = 0.0;
            for k in 0..COLOURS {
                let d = d_told[AT_LIGHT + k] + d_decoded[k];
                out.light[f][k] += d * blur * basis[f];
                weight += d * self.light[f][k];
            }
            back.mirrored += slopes[f] * (blur * weight);
            for k in 0..2 {
                out.alpha[k] += rate * blur * weight * basis[f] * 2.0 * self.alpha[k];
            }
        }
        back.cosine += d_told[AT_COSINE];
        for k in 0..2 {
            out.alpha[k] += d_told[AT_WIDTH + k];
        }
        out.position += Vec3::from_slice(&d_told[AT_POSITION..AT_CODE]) * scale;
        out.code.copy_from_slice(&d_told[AT_CODE..INPUTS]);
    }

    /// Light toward the eye of a light of strength one that reaches the surface from `to_light`, by the material alone.
    pub(super) fn under(&self, sight: &Sight, to_light: Vec3) -> ([f32; COLOURS], [f32; COLOURS]) {
        let mut frame = sight.frame;
        frame.z_axis *= sight.side;
        let (light, eye) = (frame.transpose() * to_light, frame.transpose() * sight.to_eye);
        let cosine = light.z.max(0.0);
        let half = (light + eye).normalize_or(Vec3::Z);
        let lobe = self.gloss * ggx::reflected(light, eye, self.alpha);
        let diffuse = std::array::from_fn(|k| self.albedo[k] * (1.0 - self.metallic) * cosine * FRAC_1_PI);
        let specular = std::array::from_fn(|k| {
            let head_on = HEAD_ON * (1.0 - self.metallic) + self.metallic * self.albedo[k];
            lobe * ggx::schlick(head_on, light.dot(half))
        });
        (diffuse, specular)
    }
}

/// Gradients on their way back to a surface.
#[derive(Default)]
pub(super) struct Backward {
    pub(super) surface: SurfaceGradient,
    normal: Vec3,
    cosine: f32,
    mirrored: Vec3,
    spread: [Vec3; 2],
}

impl Backward {
    /// Adds the gradient of [`Sight::normal`].
    pub(super) fn facing_normal(&mut self, sight: &Sight, d: Vec3) {
        self.normal += d * sight.side;
    }

    /// Through the frame and the direction to the eye.
    pub(super) fn finish(mut self, surface: &Surface, sight: &Sight) -> SurfaceGradient {
        let (n, eye) = (sight.frame.z_axis, sight.to_eye);
        let facing = sight.side * sight.cosine;
        let mut d_frame = Mat3::ZERO;
        // The mirrored direction 2 (n·ω) n - ω.
        let along = self.mirrored.dot(n);
        let mut d_normal = self.normal + (self.mirrored * facing + eye * along) * 2.0;
        let mut d_eye = n * (2.0 * along) - self.mirrored;
        let d_facing = self.cosine * sight.side;
        d_normal += eye * d_facing;
        d_eye += n * d_facing;
        for k in 0..2 {
            let (axis, d) = (sight.frame.col(k), self.spread[k]);
            self.surface.alpha[k] += d.dot(sight.spread[k]) / surface.alpha[k];
            let d = d * (SQRT_2 * surface.alpha[k]);
            let (by_normal, by_axis) = (d.dot(n), d.dot(axis));
            *d_frame.col_mut(k) += d * facing + eye * by_normal;
            d_normal += d * eye.dot(axis) + eye * by_axis;
            d_eye += axis * by_normal + n * by_axis;
        }
        d_frame.z_axis += d_normal;
        let mut out = self.surface;
        out.frame = rotation_backward(surface.frame, d_frame);
        out.position -= (d_eye - eye * eye.dot(d_eye)) * sight.inverse_distance;
        out
    }
}
