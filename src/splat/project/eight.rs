//! The arithmetic of projection, eight Gaussians at once: straight lines over lanes, no branch, no call.

use super::{ALPHA_MIN, DEPTH_FILTER_PX2, ProjectionOptions, Splat, SplatGradient};
use crate::camera::ProjectiveCamera;
use crate::fast;
use crate::gaussians::{CoreGradient, LOG_SCALE, OPACITY, POSITION, ROTATION, Table};
use crate::vectorised;
use glam::{Mat3, Vec3};

/// Gaussians at once.
pub(super) const LANES: usize = 8;
type Lane = [f32; LANES];

/// What becomes of a Gaussian.
pub(super) const UNSEEN: u32 = 0;
/// It is a splat.
pub(super) const SEEN: u32 = 1;
/// It is dropped because a number is not finite.
pub(super) const NOT_FINITE: u32 = 2;

/// The core parameters of eight Gaussians, as stored.
#[derive(Clone, Copy, Default)]
pub(super) struct Raw {
    position: [Lane; 3],
    log_scale: [Lane; 3],
    rotation: [Lane; 4],
    opacity: Lane,
}

impl Raw {
    /// The Gaussians `index(0)`, `index(1)` and so on; those from `count` on are what they were.
    #[inline(always)]
    pub(super) fn load(&mut self, gaussians: &Table, count: usize, index: impl Fn(usize) -> usize) {
        let (position, log_scale) = (gaussians.group(POSITION), gaussians.group(LOG_SCALE));
        let (rotation, opacity) = (gaussians.group(ROTATION), gaussians.group(OPACITY));
        for l in 0..count.min(LANES) {
            let i = index(l);
            let (p, s, q) = (
                &position[i * 3..i * 3 + 3],
                &log_scale[i * 3..i * 3 + 3],
                &rotation[i * 4..i * 4 + 4],
            );
            for k in 0..3 {
                self.position[k][l] = p[k];
                self.log_scale[k][l] = s[k];
            }
            for k in 0..4 {
                self.rotation[k][l] = q[k];
            }
            self.opacity[l] = opacity[i];
        }
    }

    #[inline(always)]
    fn one(&self, l: usize) -> RawOne {
        RawOne {
            position: three(&self.position, l),
            log_scale: three(&self.log_scale, l),
            rotation: [
                self.rotation[0][l],
                self.rotation[1][l],
                self.rotation[2][l],
                self.rotation[3][l],
            ],
            opacity: self.opacity[l],
        }
    }
}

/// Lane `l` of three, without touching the others: what is moved as a whole is not vectorised.
#[inline(always)]
fn three(lanes: &[Lane; 3], l: usize) -> Vec3 {
    Vec3::new(lanes[0][l], lanes[1][l], lanes[2][l])
}

/// One of them.
struct RawOne {
    position: Vec3,
    log_scale: Vec3,
    rotation: [f32; 4],
    opacity: f32,
}

/// A unit quaternion, and the norm it had; the identity and zero where it was degenerate.
#[inline(always)]
fn unit(q: [f32; 4]) -> ([f32; 4], f32) {
    let norm = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    let sound = (norm >= 1e-12) & finite(norm);
    let inverse = 1.0 / norm;
    let pick = |value: f32, other: f32| if sound { value * inverse } else { other };
    let unit = [pick(q[0], 0.0), pick(q[1], 0.0), pick(q[2], 0.0), pick(q[3], 1.0)];
    (unit, if sound { norm } else { 0.0 })
}

/// The rotation matrix of a unit quaternion.
#[inline(always)]
fn matrix(q: [f32; 4]) -> Mat3 {
    let [x, y, z, w] = q;
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, xy, xz) = (x * x2, x * y2, x * z2);
    let (yy, yz, zz) = (y * y2, y * z2, z * z2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    Mat3::from_cols(
        Vec3::new(1.0 - (yy + zz), xy + wz, xz - wy),
        Vec3::new(xy - wz, 1.0 - (xx + zz), yz + wx),
        Vec3::new(xz + wy, yz - wx, 1.0 - (xx + yy)),
    )
}

/// The whitened vectors of one Gaussian in one view, and the numbers that both passes need of them.
struct Whitened {
    col: f32,
    row: f32,
    denominator: f32,
    quaternion: [f32; 4],
    norm: f32,
    rotation: Mat3,
    scale: Vec3,
    opacity: f32,
    ju: Vec3,
    jv: Vec3,
    a: Vec3,
    b: Vec3,
    c: Vec3,
    /// Image covariance `[xx, xy, yy]` without any filter, pixels².
    covariance: [f32; 3],
    /// Its determinant, as the squared area of the two whitened rows: never negative, no cancellation for needles and discs.
    area_square: f32,
    /// Covariance of depth with column and row, metres·pixels.
    depth_covariance: [f32; 2],
}

impl Whitened {
    #[inline(always)]
    fn new(raw: &RawOne, camera: &ProjectiveCamera) -> Self {
        let (col, row, denominator) = camera.project(raw.position);
        let (quaternion, norm) = unit(raw.rotation);
        let rotation = matrix(quaternion);
        let scale = Vec3::new(
            fast::exp(raw.log_scale.x),
            fast::exp(raw.log_scale.y),
            fast::exp(raw.log_scale.z),
        );
        let (ju, jv) = camera.jacobian(col, row, denominator);
        let whiten =
            |x: Vec3| Vec3::new(rotation.x_axis.dot(x), rotation.y_axis.dot(x), rotation.z_axis.dot(x)) * scale;
        let (a, b, c) = (whiten(ju), whiten(jv), whiten(camera.depth_axis));
        let area = a.cross(b);
        Self {
            col,
            row,
            denominator,
            quaternion,
            norm,
            rotation,
            scale,
            opacity: fast::sigmoid(raw.opacity),
            ju,
            jv,
            a,
            b,
            c,
            covariance: [a.dot(a), a.dot(b), b.dot(b)],
            area_square: area.dot(area),
            depth_covariance: [c.dot(a), c.dot(b)],
        }
    }

    /// `sqrt(det before / det after)` the filter, where that is asked for.
    #[inline(always)]
    fn dimming(&self, det_filtered: f32, options: &ProjectionOptions) -> f32 {
        let ratio = self.area_square / det_filtered;
        if options.antialias { ratio.sqrt() } else { 1.0 }
    }
}

/// Inverse of a symmetric 2 × 2 matrix `[xx, xy, yy]` of determinant `det` with `filter` added to its diagonal, and the
/// determinant then: a sum of what is not negative, so that a needle of thousands of pixels keeps its width.
#[inline(always)]
fn inverse_filtered(m: [f32; 3], det: f32, filter: f32) -> ([f32; 3], f32) {
    let (xx, yy) = (m[0] + filter, m[2] + filter);
    let det = det + filter * (m[0] + yy);
    ([yy / det, -m[1] / det, xx / det], det)
}

/// Gradient to a symmetric matrix (its three numbers as stored: the off-diagonal counts twice) from that to its inverse.
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

#[inline(always)]
fn finite(x: f32) -> bool {
    x.abs() < f32::INFINITY
}

/// Eight splats and what became of their Gaussians.
#[derive(Clone, Copy, Default)]
pub(super) struct Splats {
    pub(super) fate: [u32; LANES],
    col: Lane,
    row: Lane,
    conic: [Lane; 3],
    opacity: Lane,
    depth: Lane,
    slope: [Lane; 2],
    reach: Lane,
    half: [Lane; 2],
    normal: [Lane; 3],
}

impl Splats {
    /// Splat `l`, which means something only where it is seen.
    #[inline(always)]
    pub(super) fn get(&self, l: usize) -> Splat {
        Splat {
            col: self.col[l],
            row: self.row[l],
            conic: three(&self.conic, l).to_array(),
            opacity: self.opacity[l],
            depth: self.depth[l],
            slope: [self.slope[0][l], self.slope[1][l]],
            reach: self.reach[l],
            half: [self.half[0][l], self.half[1][l]],
            normal: three(&self.normal, l).to_array(),
        }
    }

    #[inline(always)]
    fn set(&mut self, l: usize, fate: u32, splat: &Splat) {
        self.fate[l] = fate;
        self.col[l] = splat.col;
        self.row[l] = splat.row;
        self.conic[0][l] = splat.conic[0];
        self.conic[1][l] = splat.conic[1];
        self.conic[2][l] = splat.conic[2];
        self.opacity[l] = splat.opacity;
        self.depth[l] = splat.depth;
        self.slope[0][l] = splat.slope[0];
        self.slope[1][l] = splat.slope[1];
        self.reach[l] = splat.reach;
        self.half[0][l] = splat.half[0];
        self.half[1][l] = splat.half[1];
        self.normal[0][l] = splat.normal[0];
        self.normal[1][l] = splat.normal[1];
        self.normal[2][l] = splat.normal[2];
    }
}

#[inline(always)]
fn project_one(raw: &RawOne, camera: &ProjectiveCamera, options: &ProjectionOptions) -> (u32, Splat) {
    let white = Whitened::new(raw, camera);
    let (col, row) = (white.col, white.row);
    let (width, height) = (camera.width as f32, camera.height as f32);
    let covariance = white.covariance;
    let (conic, det) = inverse_filtered(covariance, white.area_square, options.filter_px2);
    let opacity = white.opacity * white.dimming(det, options);
    let depth = camera.depth(raw.position);
    let (depth_inverse, depth_det) = inverse_filtered(covariance, white.area_square, DEPTH_FILTER_PX2);
    let dc = white.depth_covariance;
    let slope = [
        depth_inverse[0] * dc[0] + depth_inverse[1] * dc[1],
        depth_inverse[1] * dc[0] + depth_inverse[2] * dc[1],
    ];
    let normal = white.ju * slope[0] + white.jv * slope[1] - camera.depth_axis;
    let shrink = 1.0 / normal.dot(normal).sqrt();
    let sound = (shrink > 0.0) & finite(shrink);
    let normal = normal * if sound { shrink } else { 0.0 };
    let reach = 2.0 * fast::ln(opacity / ALPHA_MIN);
    let half = [
        (reach * (covariance[0] + options.filter_px2)).sqrt(),
        (reach * (covariance[2] + options.filter_px2)).sqrt(),
    ];

    let position = raw.position;
    let placed = finite(position.x) & finite(position.y) & finite(position.z);
    let margin = 0.5 * (camera.width + camera.height) as f32 + 64.0;
    let near = (col > -margin) & (row > -margin) & (col < width + margin) & (row < height + margin);
    let on_image = finite(col) & finite(row);
    let numbers = finite(opacity) & finite(depth) & finite(slope[0]) & finite(slope[1]);
    // The conic and the slopes were divided by the determinants: those are finite where these are.
    let numbers = numbers & finite(conic[0]) & finite(conic[1]) & finite(conic[2]) & (det > 0.0) & (depth_det > 0.0);
    let inside = (col + half[0] >= 0.0)
        & (row + half[1] >= 0.0)
        & (col - half[0] <= width - 1.0)
        & (row - half[1] <= height - 1.0);
    let seen = if (opacity > ALPHA_MIN) & inside { SEEN } else { UNSEEN };
    let fate = if numbers { seen } else { NOT_FINITE };
    let away = if on_image { UNSEEN } else { NOT_FINITE };
    let fate = if near { fate } else { away };
    let fate = if white.denominator <= 1e-6 { UNSEEN } else { fate };
    let fate = if placed { fate } else { NOT_FINITE };
    let splat = Splat {
        col,
        row,
        conic,
        opacity,
        depth,
        slope,
        reach,
        half,
        normal: normal.to_array(),
    };
    (fate, splat)
}

vectorised! {
    /// Projects eight Gaussians.
    pub(super) fn project_eight(raw: &Raw, camera: &ProjectiveCamera, options: &ProjectionOptions, out: &mut Splats) {
        let (raw, camera, options) = (*raw, *camera, *options);
        let mut all = Splats::default();
        for l in 0..LANES {
            let (fate, splat) = project_one(&raw.one(l), &camera, &options);
            all.set(l, fate, &splat);
        }
        *out = all;
    }
}

/// Eight splats as walking back needs them, with their gradients.
#[derive(Clone, Copy)]
pub(super) struct Back {
    conic: [Lane; 3],
    slope: [Lane; 2],
    normal: [Lane; 3],
    grads: [Lane; 12],
}

impl Back {
    pub(super) const NOTHING: Self = Self {
        conic: [[0.0; LANES]; 3],
        slope: [[0.0; LANES]; 2],
        normal: [[0.0; LANES]; 3],
        grads: [[0.0; LANES]; 12],
    };

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

/// Gradients of eight Gaussians' core parameters.
#[derive(Clone, Copy, Default)]
pub(super) struct CoreGradients {
    position: [Lane; 3],
    log_scale: [Lane; 3],
    rotation: [Lane; 4],
    opacity: Lane,
}

impl CoreGradients {
    /// That of Gaussian `l`.
    #[inline(always)]
    pub(super) fn get(&self, l: usize) -> CoreGradient {
        let q = &self.rotation;
        CoreGradient {
            position: three(&self.position, l),
            log_scale: three(&self.log_scale, l),
            rotation: [q[0][l], q[1][l], q[2][l], q[3][l]],
            opacity: self.opacity[l],
        }
    }

    #[inline(always)]
    fn set(&mut self, l: usize, one: &CoreGradient) {
        self.position[0][l] = one.position.x;
        self.position[1][l] = one.position.y;
        self.position[2][l] = one.position.z;
        self.log_scale[0][l] = one.log_scale.x;
        self.log_scale[1][l] = one.log_scale.y;
        self.log_scale[2][l] = one.log_scale.z;
        self.rotation[0][l] = one.rotation[0];
        self.rotation[1][l] = one.rotation[1];
        self.rotation[2][l] = one.rotation[2];
        self.rotation[3][l] = one.rotation[3];
        self.opacity[l] = one.opacity;
    }
}

#[inline(always)]
fn backward_one(
    raw: &RawOne,
    camera: &ProjectiveCamera,
    options: &ProjectionOptions,
    splat: &Splat,
    grad: &SplatGradient,
) -> CoreGradient {
    let white = Whitened::new(raw, camera);
    let Whitened {
        rotation,
        scale,
        ju,
        jv,
        a,
        b,
        c,
        covariance,
        ..
    } = white;

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
    let (depth_inverse, _) = inverse_filtered(covariance, white.area_square, DEPTH_FILTER_PX2);
    let dc = white.depth_covariance;
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
    let (_, det) = inverse_filtered(covariance, white.area_square, options.filter_px2);
    let from_conic = inverse_backward(splat.conic, grad.conic);
    let o = white.opacity;
    let dim = white.dimming(det, options);
    let det_raw = dim * dim * det;
    let dims = options.antialias & (dim > 0.0);
    let d_dim = if dims { grad.opacity * o } else { 0.0 };
    // dim = sqrt(det_raw / det): d ln dim = ½ (d det_raw / det_raw - d det / det).
    let safe = if det_raw > 1e-30 { det_raw } else { 1e-30 };
    let (k_raw, k) = (0.5 * d_dim * dim / safe, 0.5 * d_dim * dim / det);
    // det = det_raw + f (xx + yy) + f², and det_raw = ‖a × b‖²: through the area, because through the covariance a needle's
    // gradient is what is left of numbers that are larger by the square of its aspect.
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
    let rotation = quaternion_backward(white.quaternion, white.norm, d_rotation);

    // Jacobian rows j_u = (u - w·col)/(1 + w·p) depend on the position through col and the denominator.
    let inverse = 1.0 / white.denominator;
    let d_col = grad.col - camera.w.dot(d_ju) * inverse;
    let d_row = grad.row - camera.w.dot(d_jv) * inverse;
    let position = ju * d_col + jv * d_row + axis * grad.depth - camera.w * ((ju.dot(d_ju) + jv.dot(d_jv)) * inverse);
    CoreGradient {
        position,
        log_scale,
        rotation,
        opacity: grad.opacity * dim * o * (1.0 - o),
    }
}

/// Gradient to a raw quaternion, as [`rotation_backward`](crate::gaussians::rotation_backward); zero where it is degenerate.
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
        back: &Back,
        camera: &ProjectiveCamera,
        options: &ProjectionOptions,
        out: &mut CoreGradients,
    ) {
        let (raw, back, camera, options) = (*raw, *back, *camera, *options);
        let mut all = CoreGradients::default();
        for l in 0..LANES {
            let (splat, grad) = back.one(l);
            all.set(l, &backward_one(&raw.one(l), &camera, &options, &splat, &grad));
        }
        *out = all;
    }
}
