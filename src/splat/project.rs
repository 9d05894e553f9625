//! Projection of Gaussians to splats, and its backward pass.
//!
//! With `L = R S` (rotation times scales) and the camera's Jacobian rows `j_u`, `j_v` and depth axis `d`, the three
//! whitened vectors `a = Lᵀj_u`, `b = Lᵀj_v`, `c = Lᵀd` carry everything: the image covariance is their Gram matrix, and
//! the covariance of depth with the image gives the plane on which the peaks of the 1-D Gaussians cut out by the
//! pixels' rays lie (RaDe-GS, Zhang et al. 2024; here for any projective camera): `depth(u, v) = z + g·(u - u_i, v - v_i)`,
//! `g = (Σ₂ + δI)⁻¹ [c·a, c·b]`. That plane's normal in the scene is along `j_u g_u + j_v g_v - d`.

mod eight;

use crate::camera::ProjectiveCamera;
use crate::gaussians::Table;
use eight::{Back, CoreGradients, LANES, NOT_FINITE, Raw, SEEN, Splats, backward_eight, project_eight};
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

/// Projects every Gaussian; those outside the image, too faint, or with a number that is not finite are left out.
pub fn project(gaussians: &Table, camera: &ProjectiveCamera, options: &ProjectionOptions) -> Projected {
    let chunks: Vec<Projected> = (0..gaussians.count.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut out = Projected::default();
            let (mut raw, mut splats) = (Raw::default(), Splats::default());
            let end = ((chunk + 1) * CHUNK).min(gaussians.count);
            for first in (chunk * CHUNK..end).step_by(LANES) {
                let count = (end - first).min(LANES);
                raw.load(gaussians, count, |l| first + l);
                project_eight(&raw, camera, options, &mut splats);
                for l in 0..count {
                    match splats.fate[l] {
                        SEEN => {
                            out.splats.push(splats.get(l));
                            out.gaussian.push((first + l) as u32);
                        }
                        NOT_FINITE => out.non_finite += 1,
                        _ => {}
                    }
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

/// Adds the gradients of the splats to those of their Gaussians.
pub fn project_backward(
    gaussians: &Table,
    camera: &ProjectiveCamera,
    options: &ProjectionOptions,
    projected: &Projected,
    grads: &[SplatGradient],
    out: &mut Table,
) {
    out.add_core_in_blocks::<LANES>(&projected.gaussian, |places, add| {
        let (mut raw, mut back, mut grads_of) = (Raw::default(), Back::NOTHING, CoreGradients::default());
        let (first, count) = (places.start, places.len());
        raw.load(gaussians, count, |l| projected.gaussian[first + l] as usize);
        for l in 0..count {
            back.set(l, &projected.splats[first + l], &grads[first + l]);
        }
        backward_eight(&raw, &back, camera, options, &mut grads_of);
        for l in 0..count {
            add(l, &grads_of.get(l));
        }
    });
}
