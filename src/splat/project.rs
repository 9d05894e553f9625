//! Projection of Gaussians to splats, and its backward pass.
//!
//! With `L = R S` (rotation times scales) and the camera's Jacobian rows `j_u`, `j_v` and depth axis `d`, the three
//! whitened vectors `a = Lᵀj_u`, `b = Lᵀj_v`, `c = Lᵀd` carry everything: the image covariance is their Gram matrix,
//! and the covariance of depth with the image gives the plane on which the peaks of the 1-D Gaussians cut out by the
//! pixels' rays lie (RaDe-GS, Zhang et al. 2024; here for any projective camera):
//! `depth(u, v) = z + g·(u - u_i, v - v_i)`, `g = (Σ₂ + δI)⁻¹ [c·a, c·b]`. That plane's normal in the scene is along
//! `j_u g_u + j_v g_v - d`.

mod backward;
mod forward;
mod splat;

pub use splat::{ALPHA_MAX, ALPHA_MIN, DEPTH_FILTER_PX2, ProjectionOptions, Splat, SplatGradient};

use crate::camera::ProjectiveCamera;
use crate::gaussians::Table;
use backward::{SplatsAndGradients, backward_eight};
use forward::{LANES, NOT_FINITE, Raw, Splats, VISIBLE, project_eight};
use rayon::prelude::*;

/// Gaussians per parallel job; fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 2048;

/// The splats that a camera sees.
#[derive(Debug, Clone, Default)]
pub struct Projected {
    /// The splats, in the order of their Gaussians.
    pub splats: Vec<Splat>,
    /// Index of the Gaussian of each splat, ascending.
    pub gaussian: Vec<u32>,
    /// Number of Gaussians dropped because a number was not finite.
    pub non_finite: usize,
}

impl Projected {
    /// Drops the splats of Gaussians that are not `present` (a flag per Gaussian).
    pub fn keep(&mut self, present: &[bool]) {
        let kept = |gaussian: &u32| present[*gaussian as usize];
        let mut of_splats = self.gaussian.iter();
        self.splats.retain(|_| of_splats.next().is_some_and(kept));
        self.gaussian.retain(kept);
    }
}

/// Projects every Gaussian; those outside the image, below the least alpha, or with a number that is not finite are
/// left out.
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
                    match splats.status[l] {
                        VISIBLE => {
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
    joined(&chunks)
}

/// The splats of all chunks, one after another.
fn joined(chunks: &[Projected]) -> Projected {
    let mut count = 0;
    let mut starts = Vec::with_capacity(chunks.len());
    for chunk in chunks {
        starts.push(count);
        count += chunk.splats.len();
    }
    // Of several chunks that start at one place all but the last are empty.
    let places = (0..count).into_par_iter().with_min_len(CHUNK).map(|place| {
        let chunk = starts.partition_point(|start| *start <= place) - 1;
        (&chunks[chunk], place - starts[chunk])
    });
    let (splats, gaussian) = places
        .map(|(chunk, place)| (chunk.splats[place], chunk.gaussian[place]))
        .unzip();
    Projected {
        splats,
        gaussian,
        non_finite: chunks.iter().map(|chunk| chunk.non_finite).sum(),
    }
}

/// Adds the gradients of the splats, `grads`, to those of their Gaussians, `out`.
pub fn project_backward(
    gaussians: &Table,
    camera: &ProjectiveCamera,
    options: &ProjectionOptions,
    projected: &Projected,
    grads: &[SplatGradient],
    out: &mut Table,
) {
    out.add_core_in_blocks::<LANES>(&projected.gaussian, |places, add| {
        let (mut raw, mut back, mut grads_of) = (Raw::default(), SplatsAndGradients::default(), Raw::default());
        let (first, count) = (places.start, places.len());
        raw.load(gaussians, count, |l| projected.gaussian[first + l] as usize);
        for l in 0..count {
            back.set(l, &projected.splats[first + l], &grads[first + l]);
        }
        backward_eight(&raw, &back, camera, options, &mut grads_of);
        for l in 0..count {
            add(l, &grads_of.one(l));
        }
    });
}
