//! Settings of an adjustment, and its result.

use super::correction::{BiasModel, Correction};
use super::residuals::{ImageResiduals, PairResiduals, ResidualVector};
use crate::rpc::GeoPoint;

/// Options of the adjustment; the default is suitable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdjustOptions {
    /// Error model of the cameras.
    pub model: BiasModel,
    /// Most rounds of Gauss-Newton.
    pub most_rounds: usize,
}

impl Default for AdjustOptions {
    fn default() -> Self {
        Self {
            model: BiasModel::default(),
            most_rounds: 40,
        }
    }
}

/// The corrections and how well the images agree with them.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjustment {
    /// Error model of the cameras.
    pub model: BiasModel,
    /// One per image; none where an image has fewer than [`super::FEWEST_SIGHTINGS`] sightings.
    pub corrections: Vec<Correction>,
    /// One ground point per track.
    pub points: Vec<GeoPoint>,
    /// Standard deviation of a good sighting in one direction, pixels.
    pub sigma_px: f64,
    /// Rounds it took.
    pub rounds: usize,
    /// True if the corrections came to rest before the last round allowed.
    pub converged: bool,
    /// Residuals of each image.
    pub images: Vec<ImageResiduals>,
    /// Residuals across the epipolar lines of pairs of images.
    pub pairs: Vec<PairResiduals>,
    /// Residual of each sighting, in the order of the tracks.
    pub residuals: Vec<ResidualVector>,
}
