//! The backward arithmetic of projection, eight Gaussians at once: from gradients of splats to those of the core
//! parameters.
//!
//! Every step of the forward pass in reverse: normal, slopes, conic and antialiasing to the image covariance,
//! covariances to the whitened vectors, those to Jacobian rows, scales and rotation, and the Jacobian rows to the
//! position.

use super::forward::{LANES, Lane, Raw, Whitened, inverse_filtered, three};
use super::splat::{DEPTH_FILTER_PX2, ProjectionOptions, Splat, SplatGradient};
use crate::camera::ProjectiveCamera;
use crate::gaussians::Core;
use crate::vectorised;
use glam::{Mat3, Vec3};

/// Gradient to a symmetric matrix (its three numbers as stored: the off-diagonal counts twice) from that to its
/// inverse.
#[inline(always)]
fn inverse_backward(inverse: [f32; 3], d_inverse: [f32; 3]) -> [f32; 3] {
    // dM = -M⁻¹ dI M⁻¹ with the off-diagonal gradient split over both entries.
    let [p, q, r] = inverse;
    let (gp, gq, gr) = (d_inverse[0], 0.5 * d_inverse[1], d_inverse[2]);
    let xx = p * (gp * p + gq * q) + q * (gq * p + gr * q);
    let xy = p * (gp * q + gq * r) + q * (gq * q + gr * r);
    let yy = q * (gp * q + gq * r) + r * (gq * q + gr * r);
    [-xx, -2.0 * xy, -yy]
}

/// Inputs of the backward pass for eight splats, and their gradients.
#[derive(Clone, Copy, Default)]
pub(super) struct SplatsAndGradients {
    conic: [Lane; 3],
    slope: [Lane; 2],
    normal: [Lane; 3],
    grads: [Lane; 12],
}

impl SplatsAndGradients {
    /// Puts a splat and its gradient in lane `l`.
    #[inline(always)]
    pub(super) fn set(&mut self, l: usize, splat: &Splat, grad: &SplatGradient) {
        for k in 0..3 {
            self.conic[k][l] = splat.conic[k];
            self.normal[k][l] = splat.normal[k];
            self.grads[2 + k][l] = grad.conic[k];
            self.grads[9 + k][l] = grad.normal[k];
        }
        for k in 0..2 {
            self.slope[k][l] = splat.slope[k];
            self.grads[7 + k][l] = grad.slope[k];
        }
        self.grads[0][l] = grad.col;
        self.grads[1][l] = grad.row;
        self.grads[5][l] = grad.opacity;
        self.grads[6][l] = grad.depth;
    }

    #[inline(always)]
    fn one(&self, l: usize) -> (Splat, SplatGradient) {
        let g = &self.grads;
        let splat = Splat {
            conic: three(&self.conic, l).to_array(),
            slope: [self.slope[0][l], self.slope[1][l]],
            normal: three(&self.normal, l).to_array(),
            ..Splat::default()
        };
        let grad = SplatGradient {
            col: g[0][l],
            row: g[1][l],
            conic: [g[2][l], g[3][l], g[4][l]],
            opacity: g[5][l],
            depth: g[6][l],
            slope: [g[7][l], g[8][l]],
            normal: [g[9][l], g[10][l], g[11][l]],
        };
        (splat, grad)
    }
}

#[inline(always)]
fn backward_one(
    raw: &Core,
    camera: &ProjectiveCamera,
    options: &ProjectionOptions,
    splat: &Splat,
    grad: &SplatGradient,
) -> Core {
    let whitened = Whitened::new(raw, camera);
    let (rotation, scale, covariance) = (whitened.rotation, whitened.scale, whitened.covariance);
    let (ju, jv, a, b, c) = (whitened.ju, whitened.jv, whitened.a, whitened.b, whitened.c);

    // Normal -> slopes and Jacobian rows.
    let raw_normal = ju * splat.slope[0] + jv * splat.slope[1] - camera.depth_axis;
    let length = raw_normal.dot(raw_normal).sqrt();
    let (normal, length) = (Vec3::from(splat.normal), if length > 1e-12 { length } else { 1e-12 });
    let d_normal = Vec3::from(grad.normal);
    let d_raw = (d_normal - normal * normal.dot(d_normal)) * (1.0 / length);
    let d_slope = [grad.slope[0] + ju.dot(d_raw), grad.slope[1] + jv.dot(d_raw)];
    let mut d_ju = d_raw * splat.slope[0];
    let mut d_jv = d_raw * splat.slope[1];

    // Slopes -> covariance and depth covariance.
    let (depth_inverse, _) = inverse_filtered(covariance, whitened.area_square, DEPTH_FILTER_PX2);
    let dc = whitened.depth_covariance;
    let d_dc = [
        depth_inverse[0] * d_slope[0] + depth_inverse[1] * d_slope[1],
        depth_inverse[1] * d_slope[0] + depth_inverse[2] * d_slope[1],
    ];
    let d_depth_inverse = [
        dc[0] * d_slope[0],
        dc[1] * d_slope[0] + dc[0] * d_slope[1],
        dc[1] * d_slope[1],
    ];
    let from_slope = inverse_backward(depth_inverse, d_depth_inverse);

    // Conic, and the dimming of the anti-aliased option, -> covariance.
    let (_, det) = inverse_filtered(covariance, whitened.area_square, options.filter_px2);
    let from_conic = inverse_backward(splat.conic, grad.conic);
    let o = whitened.opacity;
    let dim = whitened.dimming(det, options);
    let det_raw = dim * dim * det;
    let dims = options.antialias & (dim > 0.0);
    let d_dim = if dims { grad.opacity * o } else { 0.0 };
    // dim = sqrt(det_raw / det): d ln dim = ½ (d det_raw / det_raw - d det / det).
    let safe = if det_raw > 1e-30 { det_raw } else { 1e-30 };
    let (k_raw, k) = (0.5 * d_dim * dim / safe, 0.5 * d_dim * dim / det);
    // det = det_raw + f (xx + yy) + f², and det_raw = ‖a × b‖². The area is accurate for needles: through the
    // covariance, their gradient is a difference of numbers larger by the square of the aspect ratio.
    let area = a.cross(b) * (2.0 * (k_raw - k));
    let d_cov = [
        from_slope[0] + from_conic[0] - k * options.filter_px2,
        from_slope[1] + from_conic[1],
        from_slope[2] + from_conic[2] - k * options.filter_px2,
    ];

    // Covariances and area -> whitened vectors.
    let d_a = a * (2.0 * d_cov[0]) + b * d_cov[1] + c * d_dc[0] + b.cross(area);
    let d_b = b * (2.0 * d_cov[2]) + a * d_cov[1] + c * d_dc[1] + area.cross(a);
    let d_c = a * d_dc[0] + b * d_dc[1];

    // a = S Rᵀ j_u and so on -> Jacobian rows, scales, rotation.
    let turn = |v: Vec3| rotation.x_axis * v.x + rotation.y_axis * v.y + rotation.z_axis * v.z;
    let (s_a, s_b, s_c) = (scale * d_a, scale * d_b, scale * d_c);
    d_ju += turn(s_a);
    d_jv += turn(s_b);
    let log_scale = a * d_a + b * d_b + c * d_c;
    let axis = camera.depth_axis;
    let d_rotation = Mat3::from_cols(
        ju * s_a.x + jv * s_b.x + axis * s_c.x,
        ju * s_a.y + jv * s_b.y + axis * s_c.y,
        ju * s_a.z + jv * s_b.z + axis * s_c.z,
    );
    let rotation = quaternion_backward(whitened.quaternion, whitened.norm, d_rotation);

    // Jacobian rows j_u = (u - w·col)/(1 + w·p) depend on the position through col and the denominator.
    let inverse = 1.0 / whitened.denominator;
    let d_col = grad.col - camera.w.dot(d_ju) * inverse;
    let d_row = grad.row - camera.w.dot(d_jv) * inverse;
    let position = ju * d_col + jv * d_row + axis * grad.depth - camera.w * ((ju.dot(d_ju) + jv.dot(d_jv)) * inverse);
    Core {
        position,
        log_scale,
        rotation,
        opacity: grad.opacity * dim * o * (1.0 - o),
    }
}

/// Gradient to a raw quaternion, as [`rotation_backward`](crate::gaussians::rotation_backward); zero where it is
/// degenerate.
#[inline(always)]
fn quaternion_backward(q: [f32; 4], norm: f32, d: Mat3) -> [f32; 4] {
    let [x, y, z, w] = q;
    let (c0, c1, c2) = (d.x_axis, d.y_axis, d.z_axis);
    let (xy, xz, yz) = (c1.x + c0.y, c2.x + c0.z, c2.y + c1.z);
    let (rx, ry, rz) = (c1.z - c2.y, c2.x - c0.z, c0.y - c1.x);
    let unit = [
        2.0 * (y * xy + z * xz - 2.0 * x * (c1.y + c2.z) + w * rx),
        2.0 * (x * xy + z * yz - 2.0 * y * (c0.x + c2.z) + w * ry),
        2.0 * (x * xz + y * yz - 2.0 * z * (c0.x + c1.y) + w * rz),
        2.0 * (x * rx + y * ry + z * rz),
    ];
    let along = unit[0] * x + unit[1] * y + unit[2] * z + unit[3] * w;
    let inverse = if norm > 0.0 { 1.0 / norm } else { 0.0 };
    let tangent = |k: usize| (unit[k] - along * q[k]) * inverse;
    [tangent(0), tangent(1), tangent(2), tangent(3)]
}

vectorised! {
    /// Gradients of eight Gaussians from those of their splats.
    pub(super) fn backward_eight(
        raw: &Raw,
        back: &SplatsAndGradients,
        camera: &ProjectiveCamera,
        options: &ProjectionOptions,
        out: &mut Raw,
    ) {
        let (raw, back, camera, options) = (*raw, *back, *camera, *options);
        let mut all = Raw::default();
        for l in 0..LANES {
            let (splat, grad) = back.one(l);
            all.set(l, &backward_one(&raw.one(l), &camera, &options, &splat, &grad));
        }
        *out = all;
    }
}
