//! Projection of Gaussians to splats, and its backward pass.
//!
//! With `L = R S` (rotation times scales) and the camera's Jacobian rows `j_u`, `j_v` and depth axis `d`, the three
//! whitened vectors `a = Lᵀj_u`, `b = Lᵀj_v`, `c = Lᵀd` carry everything: the image covariance is their Gram matrix, and
//! the covariance of depth with the image gives the plane on which the peaks of the 1-D Gaussians cut out by the
//! pixels' rays lie (RaDe-GS, Zhang et al. 2024; here for any projective camera): `depth(u, v) = z + g·(u - u_i, v - v_i)`,
//! `g = (Σ₂ + δI)⁻¹ [c·a, c·b]`. That plane's normal in the scene is along `j_u g_u + j_v g_v - d`.

use crate::camera::ProjectiveCamera;
use crate::gaussians::{CoreGradient, Table, rotation_backward};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Alpha below which a splat does not touch a pixel.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Alpha above which it saturates (its gradient is then zero).
pub const ALPHA_MAX: f32 = 0.99;
/// Keeps the depth plane of an edge-on disc bounded; pixels². At a standard deviation of one pixel it changes slopes by 5 %.
pub const DEPTH_FILTER_PX2: f32 = 0.05;
/// Gaussians per parallel job; fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 2048;

/// How Gaussians become splats.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProjectionOptions {
    /// Variance added to the image covariance: the pixel filter, pixels².
    pub filter_px2: f32,
    /// Multiply opacity by `sqrt(det before / det after)` the filter, so that small splats dim instead of growing.
    pub antialias: bool,
}

impl Default for ProjectionOptions {
    fn default() -> Self {
        Self {
            filter_px2: 0.1,
            antialias: true,
        }
    }
}

/// A projected Gaussian: all that the rasteriser reads, in one record, in one line of the cache.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(align(64))]
pub struct Splat {
    /// Column of the centre, pixels.
    pub col: f32,
    /// Row of the centre, pixels.
    pub row: f32,
    /// Inverse image covariance: `q = conic[0]·x² + 2·conic[1]·x·y + conic[2]·y²`.
    pub conic: [f32; 3],
    /// Opacity at the centre.
    pub opacity: f32,
    /// Depth of the centre, metres from the scene centre along the camera's depth axis.
    pub depth: f32,
    /// Change of depth per column and per row, metres per pixel.
    pub slope: [f32; 2],
    /// `q` beyond which alpha is below [`ALPHA_MIN`].
    pub reach: f32,
    /// Half sizes of the box of that reach, pixels.
    pub half: [f32; 2],
    /// Unit normal of the depth plane, facing the camera.
    pub normal: [f32; 3],
}

/// Gradient of a loss to a [`Splat`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SplatGradient {
    /// To the column.
    pub col: f32,
    /// To the row.
    pub row: f32,
    /// To the conic's three numbers.
    pub conic: [f32; 3],
    /// To the opacity.
    pub opacity: f32,
    /// To the depth.
    pub depth: f32,
    /// To the slopes.
    pub slope: [f32; 2],
    /// To the normal.
    pub normal: [f32; 3],
}

/// The splats that a camera sees.
#[derive(Debug, Clone, Default)]
pub struct Projected {
    /// The splats, in the order of their Gaussians.
    pub splats: Vec<Splat>,
    /// The Gaussian of each splat.
    pub gaussian: Vec<u32>,
    /// Gaussians dropped because a number was not finite.
    pub non_finite: usize,
}

/// The whitened vectors of one Gaussian in one view.
struct Whitened {
    rotation: Mat3,
    scale: Vec3,
    ju: Vec3,
    jv: Vec3,
    a: Vec3,
    b: Vec3,
    c: Vec3,
}

impl Whitened {
    #[inline(always)]
    fn new(gaussians: &Table, index: usize, camera: &ProjectiveCamera, at: (f32, f32, f32)) -> Self {
        let rotation = gaussians.rotation(index);
        let scale = gaussians.scale(index);
        let (ju, jv) = camera.jacobian(at.0, at.1, at.2);
        let whiten = |x: Vec3| (rotation.transpose() * x) * scale;
        Self {
            a: whiten(ju),
            b: whiten(jv),
            c: whiten(camera.depth_axis),
            rotation,
            scale,
            ju,
            jv,
        }
    }

    /// Image covariance `[xx, xy, yy]` without any filter, pixels².
    fn covariance(&self) -> [f32; 3] {
        [self.a.dot(self.a), self.a.dot(self.b), self.b.dot(self.b)]
    }

    /// Covariance of depth with column and row, metres·pixels.
    fn depth_covariance(&self) -> [f32; 2] {
        [self.c.dot(self.a), self.c.dot(self.b)]
    }
}

/// Inverse of a symmetric 2 × 2 matrix `[xx, xy, yy]` with `filter` added to its diagonal, and the determinant.
fn inverse_filtered(m: [f32; 3], filter: f32) -> ([f32; 3], f32) {
    let (xx, yy) = (m[0] + filter, m[2] + filter);
    let det = xx * yy - m[1] * m[1];
    ([yy / det, -m[1] / det, xx / det], det)
}

/// Gradient to a symmetric matrix (its three numbers as stored: the off-diagonal counts twice) from that to its inverse.
fn inverse_backward(inverse: [f32; 3], d_inverse: [f32; 3]) -> [f32; 3] {
    // dM = -M⁻¹ dI M⁻¹ with the off-diagonal gradient split over both entries.
    let [p, q, r] = inverse;
    let (gp, gq, gr) = (d_inverse[0], 0.5 * d_inverse[1], d_inverse[2]);
    let xx = p * (gp * p + gq * q) + q * (gq * p + gr * q);
    let xy = p * (gp * q + gq * r) + q * (gq * q + gr * r);
    let yy = q * (gp * q + gq * r) + r * (gq * q + gr * r);
    [-xx, -2.0 * xy, -yy]
}

fn dimming(covariance: [f32; 3], det_filtered: f32, options: &ProjectionOptions) -> f32 {
    if !options.antialias {
        return 1.0;
    }
    let det = covariance[0] * covariance[2] - covariance[1] * covariance[1];
    (det.max(0.0) / det_filtered).sqrt()
}

enum Fate {
    Seen(Splat),
    Unseen,
    NotFinite,
}

#[inline(always)]
fn project_one(gaussians: &Table, index: usize, camera: &ProjectiveCamera, options: &ProjectionOptions) -> Fate {
    let position = gaussians.position(index);
    if !position.is_finite() {
        return Fate::NotFinite;
    }
    let (col, row, denominator) = camera.project(position);
    if denominator <= 1e-6 {
        return Fate::Unseen;
    }
    let margin = 0.5 * (camera.width + camera.height) as f32 + 64.0;
    if !(col > -margin && row > -margin && col < camera.width as f32 + margin && row < camera.height as f32 + margin) {
        return if col.is_finite() && row.is_finite() {
            Fate::Unseen
        } else {
            Fate::NotFinite
        };
    }
    let white = Whitened::new(gaussians, index, camera, (col, row, denominator));
    let covariance = white.covariance();
    let (conic, det) = inverse_filtered(covariance, options.filter_px2);
    let opacity = gaussians.opacity(index) * dimming(covariance, det, options);
    let depth = camera.depth(position);
    let (depth_inverse, depth_det) = inverse_filtered(covariance, DEPTH_FILTER_PX2);
    let dc = white.depth_covariance();
    let slope = [
        depth_inverse[0] * dc[0] + depth_inverse[1] * dc[1],
        depth_inverse[1] * dc[0] + depth_inverse[2] * dc[1],
    ];
    let normal = (white.ju * slope[0] + white.jv * slope[1] - camera.depth_axis).normalize_or_zero();
    let finite = opacity.is_finite() && depth.is_finite() && conic.iter().chain(&slope).all(|v| v.is_finite());
    // Both determinants are finite here: the conic and the slopes were divided by them.
    if !finite || det <= 0.0 || depth_det <= 0.0 {
        return Fate::NotFinite;
    }
    if opacity <= ALPHA_MIN {
        return Fate::Unseen;
    }
    let reach = 2.0 * (opacity / ALPHA_MIN).ln();
    let half = [
        (reach * (covariance[0] + options.filter_px2)).sqrt(),
        (reach * (covariance[2] + options.filter_px2)).sqrt(),
    ];
    let inside = col + half[0] >= 0.0
        && row + half[1] >= 0.0
        && col - half[0] <= camera.width as f32 - 1.0
        && row - half[1] <= camera.height as f32 - 1.0;
    if !inside {
        return Fate::Unseen;
    }
    Fate::Seen(Splat {
        col,
        row,
        conic,
        opacity,
        depth,
        slope,
        reach,
        half,
        normal: normal.to_array(),
    })
}

/// Projects every Gaussian; those outside the image, too faint, or with a number that is not finite are left out.
pub fn project(gaussians: &Table, camera: &ProjectiveCamera, options: &ProjectionOptions) -> Projected {
    let chunks: Vec<Projected> = (0..gaussians.count.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut out = Projected::default();
            for index in chunk * CHUNK..((chunk + 1) * CHUNK).min(gaussians.count) {
                match project_one(gaussians, index, camera, options) {
                    Fate::Seen(splat) => {
                        out.splats.push(splat);
                        out.gaussian.push(index as u32);
                    }
                    Fate::Unseen => {}
                    Fate::NotFinite => out.non_finite += 1,
                }
            }
            out
        })
        .collect();
    let count = chunks.iter().map(|chunk| chunk.splats.len()).sum();
    let mut all = Projected {
        splats: Vec::with_capacity(count),
        gaussian: Vec::with_capacity(count),
        non_finite: 0,
    };
    for chunk in chunks {
        all.splats.extend(chunk.splats);
        all.gaussian.extend(chunk.gaussian);
        all.non_finite += chunk.non_finite;
    }
    all
}

#[inline(always)]
fn backward_one(
    gaussians: &Table,
    index: usize,
    camera: &ProjectiveCamera,
    options: &ProjectionOptions,
    splat: &Splat,
    grad: &SplatGradient,
) -> CoreGradient {
    let position = gaussians.position(index);
    let (col, row, denominator) = camera.project(position);
    let white = Whitened::new(gaussians, index, camera, (col, row, denominator));
    let Whitened {
        rotation,
        scale,
        ju,
        jv,
        a,
        b,
        c,
    } = white;
    let covariance = white.covariance();

    // Normal -> slopes and Jacobian rows.
    let raw_normal = ju * splat.slope[0] + jv * splat.slope[1] - camera.depth_axis;
    let (normal, length) = (Vec3::from(splat.normal), raw_normal.length().max(1e-12));
    let d_normal = Vec3::from(grad.normal);
    let d_raw = (d_normal - normal * normal.dot(d_normal)) / length;
    let d_slope = [grad.slope[0] + ju.dot(d_raw), grad.slope[1] + jv.dot(d_raw)];
    let mut d_ju = d_raw * splat.slope[0];
    let mut d_jv = d_raw * splat.slope[1];

    // Slopes -> covariance and depth covariance.
    let (depth_inverse, _) = inverse_filtered(covariance, DEPTH_FILTER_PX2);
    let dc = white.depth_covariance();
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
    let (_, det) = inverse_filtered(covariance, options.filter_px2);
    let from_conic = inverse_backward(splat.conic, grad.conic);
    let mut d_cov = [0, 1, 2].map(|i| from_slope[i] + from_conic[i]);
    let o = gaussians.opacity(index);
    let dim = dimming(covariance, det, options);
    if options.antialias && dim > 0.0 {
        let det_raw = dim * dim * det;
        let d_dim = grad.opacity * o;
        // dim = sqrt(det_raw / det): d ln dim = ½ (d det_raw / det_raw - d det / det).
        let (k_raw, k) = (0.5 * d_dim * dim / det_raw.max(1e-30), 0.5 * d_dim * dim / det);
        let (xx, yy) = (covariance[0] + options.filter_px2, covariance[2] + options.filter_px2);
        d_cov[0] += k_raw * covariance[2] - k * yy;
        d_cov[1] += -2.0 * (k_raw - k) * covariance[1];
        d_cov[2] += k_raw * covariance[0] - k * xx;
    }

    // Covariances -> whitened vectors.
    let d_a = a * (2.0 * d_cov[0]) + b * d_cov[1] + c * d_dc[0];
    let d_b = b * (2.0 * d_cov[2]) + a * d_cov[1] + c * d_dc[1];
    let d_c = a * d_dc[0] + b * d_dc[1];

    // a = S Rᵀ j_u and so on -> Jacobian rows, scales, rotation.
    d_ju += rotation * (scale * d_a);
    d_jv += rotation * (scale * d_b);
    let log_scale = a * d_a + b * d_b + c * d_c;
    let outer = |j: Vec3, d: Vec3| {
        let s = scale * d;
        Mat3::from_cols(j * s.x, j * s.y, j * s.z)
    };
    let d_rotation = outer(ju, d_a) + outer(jv, d_b) + outer(camera.depth_axis, d_c);

    // Jacobian rows j_u = (u - w·col)/(1 + w·p) depend on the position through col and the denominator.
    let inverse = 1.0 / denominator;
    let d_col = grad.col - camera.w.dot(d_ju) * inverse;
    let d_row = grad.row - camera.w.dot(d_jv) * inverse;
    let d_position =
        ju * d_col + jv * d_row + camera.depth_axis * grad.depth - camera.w * ((ju.dot(d_ju) + jv.dot(d_jv)) * inverse);
    CoreGradient {
        position: d_position,
        log_scale,
        rotation: rotation_backward(gaussians.raw_rotation(index), d_rotation),
        opacity: grad.opacity * dim * o * (1.0 - o),
    }
}

/// Adds the gradients of the splats to those of their Gaussians.
pub fn project_backward(
    gaussians: &Table,
    camera: &ProjectiveCamera,
    options: &ProjectionOptions,
    projected: &Projected,
    grads: &[SplatGradient],
    out: &mut Table,
) {
    out.add_core(&projected.gaussian, |place| {
        let (index, splat) = (projected.gaussian[place] as usize, &projected.splats[place]);
        backward_one(gaussians, index, camera, options, splat, &grads[place])
    });
}
