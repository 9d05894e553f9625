//! The ray from a Gaussian to a light: its origin above the surface, forward and backward.
//!
//! Self-shadowing: a surface is a sheet of overlapping flat Gaussians, and a ray that starts inside the sheet hits its
//! own neighbours. Two rules keep a lit plane lit at every elevation without moving the base of shadows under an
//! ordinary sun. The ray starts above the sheet, lifted along the origin's own thinnest axis (turned to the light) by
//! `LIFT · σ_min · (1 - cos θ)`, `θ` the angle between that axis and the light, so that a grazing ray clears the
//! neighbours' whole reach and a steep one hardly moves. Only peaks further along the ray than the origin's own extent
//! `sqrt(rᵀΣr)` count.

use super::bvh::Occluder;
use crate::gaussians::{Core, rotation_backward};
use crate::light::Light;
use glam::{Mat3, Vec3};

/// Standard deviations that a grazing ray is lifted off its own surface: the reach of an opaque Gaussian,
/// `sqrt(2 ln 1000)`.
const LIFT: f32 = 3.717;

/// A ray from a Gaussian toward the light.
#[derive(Debug, Clone)]
pub(super) struct LightRay {
    /// Start of the ray, metres.
    pub(super) origin: Vec3,
    /// Unit vector toward the light.
    pub(super) direction: Vec3,
    /// Distance from the Gaussian's centre to the light, metres; infinite for parallel light.
    pub(super) length: f32,
    /// Distance along the ray up to which peaks do not count, metres: the Gaussian's own extent `sqrt(rᵀΣr)`.
    pub(super) bias: f32,
    lift: Lift,
}

/// Lift of a ray off its surface: distance and axis.
#[derive(Debug, Clone)]
struct Lift {
    thin: usize,
    /// The axis, turned to the light.
    axis: Vec3,
    /// -1 if the axis was turned round to face the light, else 1.
    sign: f32,
    height: f32,
    /// Lift of a ray at right angles to the axis.
    full: f32,
}

impl LightRay {
    /// The ray of a Gaussian toward `light`.
    pub(super) fn new(gaussian: &Occluder, light: &Light) -> Self {
        let (position, scale) = (gaussian.position, gaussian.scale);
        let (direction, distance) = light.seen_from(position);
        let thin = if scale.x <= scale.y && scale.x <= scale.z {
            0
        } else if scale.y <= scale.z {
            1
        } else {
            2
        };
        let own = gaussian.scaled_axes.col(thin) / scale[thin];
        let sign = if own.dot(direction) < 0.0 { -1.0 } else { 1.0 };
        let axis = own * sign;
        let full = LIFT * scale[thin];
        let height = full * (1.0 - axis.dot(direction));
        let extent = (gaussian.scaled_axes.transpose() * direction).length();
        let lift = Lift {
            thin,
            axis,
            sign,
            height,
            full,
        };
        Self {
            origin: position + axis * height,
            direction,
            length: distance,
            bias: extent,
            lift,
        }
    }

    /// Gradient to the parameters of the Gaussian that the ray starts from, from the gradient `d_start` to the ray's
    /// start: `start = position + axis · full · (1 - axis·r)`, `full` proportional to the thinnest scale. A ray to a
    /// point light turns as its start moves, `∂r/∂position = -(I - rrᵀ) / length`; `d_turn` is the part of `d_start`
    /// that this turn cancels. The lift follows `r`.
    pub(super) fn backward(&self, d_start: Vec3, d_turn: Vec3, raw_rotation: [f32; 4]) -> Core {
        let lift = &self.lift;
        let d_height = d_start.dot(lift.axis);
        let mut log_scale = Vec3::ZERO;
        log_scale[lift.thin] = d_height * lift.height;
        let mut d_rotation = Mat3::ZERO;
        *d_rotation.col_mut(lift.thin) = (d_start * lift.height - self.direction * (d_height * lift.full)) * lift.sign;
        let d_direction = lift.axis * (-lift.full * d_height);
        let across = d_direction - self.direction * self.direction.dot(d_direction);
        Core {
            position: d_start - d_turn - across / self.length.max(1e-12),
            log_scale,
            rotation: rotation_backward(raw_rotation, d_rotation),
            opacity: 0.0,
        }
    }
}
