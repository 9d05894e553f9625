//! RPC bias correction by block adjustment: one small correction per image, so that all images agree on where the ground is.
//!
//! RPCs as delivered are biased: they are off by up to some ten pixels, by nearly the same all over a crop. The correction of an image
//! is therefore a function of the image position alone, added to what its RPC projects ([`BiasModel`]; J. Grodecki, G. Dial, *Block
//! adjustment of high-resolution satellite images described by rational polynomials*, PE&RS 69(1), 2003). Corrections and the ground
//! points of all tracks are found together by Gauss-Newton on pixel residuals; points are eliminated (Schur complement), so that
//! the system has a few unknowns per image. Sightings count the less the farther off they are (Geman-McClure, reweighted each
//! round, its scale taken from the residuals' median): what moved with the sun or was matched wrong has no say in the end.
//!
//! **Gauge.** Images cannot tell a common translation of the scene (three unknowns) from its cameras' errors. Of all corrections
//! that fit alike, the smallest are given: [`smallest_shifts`]. With two views that leaves the shift across their epipolar
//! lines. Rotation and drift are held small by a prior of [`SLOPE_SIGMA_PX`]: they may say what the ties show and no more.
//!
//! **Words.** A track is one tie point: a ground point that several images show. A sighting is the place where one of them shows it.
//!
//! **Limits.** No pixels and no files: tracks come from whoever matches images. Ground control is not taken: the result is relative, up
//! to the translation of the gauge.

mod correction;
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
/// `frame` is any local frame within some tens of kilometres.
///
/// # Errors
/// [`RpcError::Invalid`] when a track names an image that is not there, when there are fewer than [`FEWEST_SIGHTINGS`] tracks of
/// two sightings, or when the cameras give no numbers there.
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
    }
}
