//! Types of both tracers: attenuation by one Gaussian, the result of a ray, and the input of the backward pass.

use crate::fast::exp;
use crate::splat::project::ALPHA_MAX;
use glam::Vec3;

/// Product of the attenuations along one ray, and its gradients to the ray.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RayTransmittance {
    /// Transmittance `Π (1 - α̃)`, 0 to 1.
    pub(super) value: f32,
    /// Gradient of `ln Π (1 - α̃)` to the origin of the ray, 1/m, direction fixed.
    pub(super) d_origin: Vec3,
    /// Gradient of the origin through the change in ray direction, to be subtracted: each Gaussian's gradient times its
    /// distance along the ray over the distance to the light. Zero for parallel light.
    pub(super) d_turn: Vec3,
    /// Number of Gaussians hit.
    pub(super) hits: u32,
}

/// Rays of a backward pass.
#[derive(Clone, Copy)]
pub(super) struct RayGradients<'a> {
    /// Gaussian that each ray starts from.
    pub(super) origins: &'a [u32],
    /// Gradient of the loss to the logarithm of each ray's transmittance.
    pub(super) d_log: &'a [f32],
}

/// `α̃` at a squared distance in standard deviations, and `α̃ / (1 - α̃)`, which is `-∂ ln(1 - α̃) / ∂ ln α̃`; the
/// latter is zero where `α̃` is saturated, both are zero where the Gaussian is not `hit`.
#[inline(always)]
pub(super) fn attenuation(opacity: f32, square: f32, hit: u32) -> (f32, f32) {
    let alpha = opacity * exp(-0.5 * square);
    let alpha = if alpha < ALPHA_MAX { alpha } else { ALPHA_MAX };
    let alpha = if hit != 0 { alpha } else { 0.0 };
    // Divided in any case, so that lanes need no branch.
    let ratio = alpha / (1.0 - alpha);
    let weight = if alpha < ALPHA_MAX { ratio } else { 0.0 };
    (alpha, weight)
}
