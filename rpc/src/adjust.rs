//! RPC bias correction by block adjustment: one small correction per image, so that all images agree on the ground.
//!
//! RPCs as delivered are biased: they are off by up to some ten pixels, nearly constant over a crop. The correction of
//! an image is therefore a function of the image position alone, added to the projection of its RPC ([`BiasModel`]; J.
//! Grodecki, G. Dial, *Block adjustment of high-resolution satellite images described by rational polynomials*, PE&RS
//! 69(1), 2003). Corrections and the ground points of all tracks are estimated together by Gauss-Newton on pixel
//! residuals; points are eliminated (Schur complement), so that the system has a few unknowns per image. Weights of
//! sightings fall with the size of their residual (Geman-McClure, reweighted each round, its scale from the median
//! residual), so that moving shadows and mismatches have no weight in the end.
//!
//! **Gauge.** Images do not determine a common translation of the scene (three unknowns). Of all corrections that fit
//! equally well, [`smallest_shifts`] selects the smallest. With two views, only the shift across their epipolar lines
//! remains. Rotation and drift have a prior of [`SLOPE_SIGMA_PX`], so that weak ties cannot inflate them. Of drifts along
//! the rows, [`BiasModel::Drift`] selects the fewest.
//!
//! **Terms.** A track is one tie point: a ground point visible in several images. A sighting is its position in one of
//! them.
//!
//! **Limits.** No pixels and no files: the caller matches the images. No ground control: the result is relative, up to
//! the translation of the gauge.

mod correction;
mod drift;
mod exchange;
mod export;
mod gauge;
mod linear;
mod normal;
mod problem;
mod residuals;
mod robust;
mod solution;
mod tracks;

pub use correction::{BiasModel, Correction};
pub use exchange::{Exchange, exchange};
pub use export::{CorrectedRpc, corrected_rpc};
pub use gauge::{pixels_per_metre, smallest_shifts};
pub use normal::{SHIFT_SIGMA_PX, SLOPE_SIGMA_PX};
pub use residuals::{ImageResiduals, PairResiduals, ResidualSize, ResidualVector};
pub use solution::{AdjustOptions, Adjustment};
pub use tracks::{AdjustImage, FEWEST_SIGHTINGS, Sighting, Track};

use crate::frame::LocalFrame;
use crate::rpc::RpcError;
use problem::BlockAdjustment;

/// Finds the corrections that make the images agree on the tracks.
///
/// `frame` is any local frame within some tens of kilometres of the tracks.
///
/// # Errors
/// [`RpcError::Invalid`] when the image index of a sighting is out of range, when fewer than [`FEWEST_SIGHTINGS`]
/// tracks have two sightings, when a camera projects a track to no finite position, or when the ties do not determine
/// the cameras.
pub fn adjust(
    images: &[AdjustImage],
    tracks: &[Track],
    frame: &LocalFrame,
    options: AdjustOptions,
) -> Result<Adjustment, RpcError> {
    let problem = BlockAdjustment::new(images, tracks, frame)?;
    match options.model {
        BiasModel::Translation => problem.adjust::<2>(options),
        BiasModel::Affine => problem.adjust::<6>(options),
        BiasModel::Drift => problem.adjust_drifts(options),
    }
}
