//! Settings of an adjustment, and its result.

use super::correction::{BiasModel, Correction};
use super::residuals::{ImageResiduals, PairResiduals, ResidualVector};
use crate::rpc::GeoPoint;

/// Options of the adjustment; the default is suitable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdjustOptions {
    /// Error model of the cameras.
    pub model: BiasModel,
    /// Largest number of Gauss-Newton rounds.
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

/// Corrections of all images, ground points of all tracks, and residuals before and after.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjustment {
    /// Error model of the cameras.
    pub model: BiasModel,
    /// One correction per image; zero where an image has fewer than [`super::FEWEST_SIGHTINGS`] sightings.
    pub corrections: Vec<Correction>,
    /// One ground point per track.
    pub points: Vec<GeoPoint>,
    /// Standard deviation of a good sighting in one direction, pixels.
    pub sigma_px: f64,
    /// Number of Gauss-Newton rounds.
    pub rounds: usize,
    /// True if the corrections converged within the allowed rounds.
    pub converged: bool,
    /// Residuals of each image.
    pub images: Vec<ImageResiduals>,
    /// Residuals across the epipolar lines of pairs of images.
    pub pairs: Vec<PairResiduals>,
    /// Residual of each sighting, in the order of the tracks.
    pub residuals: Vec<ResidualVector>,
}
