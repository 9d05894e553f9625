//! The forward arithmetic of projection, eight Gaussians at once: loops over lanes without branch or call, so that they
//! vectorise. [`Whitened`] holds the values that `backward` computes again.

use super::splat::{ALPHA_MIN, DEPTH_FILTER_PX2, ProjectionOptions, Splat};
use crate::camera::ProjectiveCamera;
use crate::fast;
use crate::gaussians::{Core, LOG_SCALE, OPACITY, POSITION, ROTATION, Table};
use crate::vectorised;
use glam::{Mat3, Vec3};

/// Number of Gaussians processed together.
pub(super) const LANES: usize = 8;
/// One number for each of eight Gaussians.
pub(super) type Lane = [f32; LANES];

/// Cull status of a Gaussian, an integer per lane: outside the image, behind the camera or below the least alpha.
pub(super) const CULLED: u32 = 0;
/// Cull status of a Gaussian that is a splat.
pub(super) const VISIBLE: u32 = 1;
/// Cull status of a Gaussian that is dropped because a number is not finite.
pub(super) const NOT_FINITE: u32 = 2;

/// The core parameters of eight Gaussians, as stored, or gradients to them.
#[derive(Clone, Copy, Default)]
pub(super) struct Raw {
    position: [Lane; 3],
    log_scale: [Lane; 3],
    rotation: [Lane; 4],
    opacity: Lane,
}

impl Raw {
    /// Loads the Gaussians `index(0)`, `index(1)` and so on; lanes from `count` on keep their contents.
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

    /// Numbers of the Gaussian in lane `l`.
    #[inline(always)]
    pub(super) fn one(&self, l: usize) -> Core {
        let q = &self.rotation;
        Core {
            position: three(&self.position, l),
            log_scale: three(&self.log_scale, l),
            rotation: [q[0][l], q[1][l], q[2][l], q[3][l]],
            opacity: self.opacity[l],
        }
    }

    /// Puts the numbers of one Gaussian in lane `l`.
    #[inline(always)]
    pub(super) fn set(&mut self, l: usize, one: &Core) {
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

/// Lane `l` of three, read alone: moving whole arrays prevents vectorisation.
#[inline(always)]
pub(super) fn three(lanes: &[Lane; 3], l: usize) -> Vec3 {
    Vec3::new(lanes[0][l], lanes[1][l], lanes[2][l])
}

/// A unit quaternion, and the norm it had; the identity and zero where it was degenerate.
#[inline(always)]
fn unit(q: [f32; 4]) -> ([f32; 4], f32) {
    let norm = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    let normalisable = (norm >= 1e-12) & finite(norm);
    let inverse = 1.0 / norm;
    let pick = |value: f32, other: f32| if normalisable { value * inverse } else { other };
    let unit = [pick(q[0], 0.0), pick(q[1], 0.0), pick(q[2], 0.0), pick(q[3], 1.0)];
    (unit, if normalisable { norm } else { 0.0 })
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

/// The whitened vectors of one Gaussian in one view, and the numbers that both passes use.
pub(super) struct Whitened {
    /// Column of the centre, pixels.
    pub(super) col: f32,
    /// Row of the centre, pixels.
    pub(super) row: f32,
    /// Denominator `1 + w·p` of the camera, positive in front of it.
    pub(super) denominator: f32,
    /// Unit quaternion `x, y, z, w` of the rotation.
    pub(super) quaternion: [f32; 4],
    /// Norm of the raw quaternion; zero where it was degenerate.
    pub(super) norm: f32,
    /// Rotation matrix `R`.
    pub(super) rotation: Mat3,
    /// Standard deviations along the own axes, metres.
    pub(super) scale: Vec3,
    /// Opacity, 0 to 1.
    pub(super) opacity: f32,
    /// Derivative of the column to the position, pixels per metre.
    pub(super) ju: Vec3,
    /// Derivative of the row to the position, pixels per metre.
    pub(super) jv: Vec3,
    /// Whitened derivative of the column, `Lᵀj_u`, pixels.
    pub(super) a: Vec3,
    /// Whitened derivative of the row, `Lᵀj_v`, pixels.
    pub(super) b: Vec3,
    /// Whitened depth axis, `Lᵀd`, metres.
    pub(super) c: Vec3,
    /// Image covariance `[xx, xy, yy]` without any filter, pixels².
    pub(super) covariance: [f32; 3],
    /// Determinant of the image covariance, pixels⁴, as the squared area of the two whitened rows: never negative, and
    /// without cancellation for needles and discs.
    pub(super) area_square: f32,
    /// Covariance of depth with column and row, metres·pixels.
    pub(super) depth_covariance: [f32; 2],
}

impl Whitened {
    /// The whitened vectors of the Gaussian `raw` in the view of `camera`.
    #[inline(always)]
    pub(super) fn new(raw: &Core, camera: &ProjectiveCamera) -> Self {
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

    /// Factor on the opacity: `sqrt(det / det_filtered)` of the image covariance, without and with the pixel filter;
    /// one without antialiasing.
    #[inline(always)]
    pub(super) fn dimming(&self, det_filtered: f32, options: &ProjectionOptions) -> f32 {
        let ratio = self.area_square / det_filtered;
        if options.antialias { ratio.sqrt() } else { 1.0 }
    }
}

/// Inverse of a symmetric 2 × 2 matrix `[xx, xy, yy]` of determinant `det` with `filter` added to its diagonal, and the
/// new determinant. That is a sum of non-negative terms, so that a needle of thousands of pixels keeps its width.
#[inline(always)]
pub(super) fn inverse_filtered(m: [f32; 3], det: f32, filter: f32) -> ([f32; 3], f32) {
    let (xx, yy) = (m[0] + filter, m[2] + filter);
    let det = det + filter * (m[0] + yy);
    ([yy / det, -m[1] / det, xx / det], det)
}

/// True if `x` is finite.
#[inline(always)]
pub(super) fn finite(x: f32) -> bool {
    x.abs() < f32::INFINITY
}

/// Eight splats and the cull status of their Gaussians.
#[derive(Clone, Copy, Default)]
pub(super) struct Splats {
    /// Cull status of each Gaussian.
    pub(super) status: [u32; LANES],
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
    /// Splat `l`, valid only where its status is [`VISIBLE`].
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
    fn set(&mut self, l: usize, status: u32, splat: &Splat) {
        self.status[l] = status;
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
fn project_one(raw: &Core, camera: &ProjectiveCamera, options: &ProjectionOptions) -> (u32, Splat) {
    let whitened = Whitened::new(raw, camera);
    let (col, row) = (whitened.col, whitened.row);
    let (width, height) = (camera.width as f32, camera.height as f32);
    let covariance = whitened.covariance;
    let (conic, det) = inverse_filtered(covariance, whitened.area_square, options.filter_px2);
    let opacity = whitened.opacity * whitened.dimming(det, options);
    let depth = camera.depth(raw.position);
    let (depth_inverse, depth_det) = inverse_filtered(covariance, whitened.area_square, DEPTH_FILTER_PX2);
    let dc = whitened.depth_covariance;
    let slope = [
        depth_inverse[0] * dc[0] + depth_inverse[1] * dc[1],
        depth_inverse[1] * dc[0] + depth_inverse[2] * dc[1],
    ];
    let normal = whitened.ju * slope[0] + whitened.jv * slope[1] - camera.depth_axis;
    let shrink = 1.0 / normal.dot(normal).sqrt();
    let normalisable = (shrink > 0.0) & finite(shrink);
    let normal = normal * if normalisable { shrink } else { 0.0 };
    let reach = 2.0 * fast::ln(opacity / ALPHA_MIN);
    let half = [
        (reach * (covariance[0] + options.filter_px2)).sqrt(),
        (reach * (covariance[2] + options.filter_px2)).sqrt(),
    ];

    let position = raw.position;
    let position_finite = finite(position.x) & finite(position.y) & finite(position.z);
    let margin = 0.5 * (camera.width + camera.height) as f32 + 64.0;
    let near = (col > -margin) & (row > -margin) & (col < width + margin) & (row < height + margin);
    let on_image = finite(col) & finite(row);
    let values_finite = finite(opacity) & finite(depth) & finite(slope[0]) & finite(slope[1]);
    // The conic and the slopes were divided by the determinants: those are finite where these are.
    let values_finite =
        values_finite & finite(conic[0]) & finite(conic[1]) & finite(conic[2]) & (det > 0.0) & (depth_det > 0.0);
    let inside = (col + half[0] >= 0.0)
        & (row + half[1] >= 0.0)
        & (col - half[0] <= width - 1.0)
        & (row - half[1] <= height - 1.0);
    let visible = if (opacity > ALPHA_MIN) & inside {
        VISIBLE
    } else {
        CULLED
    };
    let status = if values_finite { visible } else { NOT_FINITE };
    let outside = if on_image { CULLED } else { NOT_FINITE };
    let status = if near { status } else { outside };
    let status = if whitened.denominator <= 1e-6 { CULLED } else { status };
    let status = if position_finite { status } else { NOT_FINITE };
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
    (status, splat)
}

vectorised! {
    /// Projects eight Gaussians.
    pub(super) fn project_eight(raw: &Raw, camera: &ProjectiveCamera, options: &ProjectionOptions, out: &mut Splats) {
        let (raw, camera, options) = (*raw, *camera, *options);
        let mut all = Splats::default();
        for l in 0..LANES {
            let (status, splat) = project_one(&raw.one(l), &camera, &options);
            all.set(l, status, &splat);
        }
        *out = all;
    }
}
