//! The height hypotheses: the altitudes that every cell is tried at, in equal steps.

use super::parameters::STEP_CELLS;
use heliosplat_rpc::parallax::LEAST_BASE_TO_HEIGHT;

/// Regular altitudes `base_m + level · step_m`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HeightHypotheses {
    /// Altitude of level 0, metres.
    pub(super) base_m: f32,
    /// Distance between neighbouring levels, metres.
    pub(super) step_m: f32,
    /// Number of levels.
    pub(super) levels: usize,
}

/// Most levels; a search range counts its first level in 16 bits. Where the altitude range needs more, the step grows.
const MOST_LEVELS: usize = 8192;
/// Least step, metres, so that the number of levels stays finite for any request.
const LEAST_STEP_M: f32 = 1e-4;

/// Largest number of height hypotheses of a cell of `cell_m` metres, over a range of altitudes of `range_m` metres,
/// when the pair of views with the widest base has this base-to-height ratio.
pub fn height_levels(range_m: f32, cell_m: f32, widest_base_to_height: f32) -> usize {
    let step_m = STEP_CELLS * cell_m / widest_base_to_height.max(LEAST_BASE_TO_HEIGHT as f32);
    HeightHypotheses::new(0.0, range_m, step_m).levels
}

impl HeightHypotheses {
    /// Levels from `low_m` to at least `high_m`, metres, in steps of `step_m`; longer ones where the range would need
    /// more than `MOST_LEVELS`.
    pub(super) fn new(low_m: f32, high_m: f32, step_m: f32) -> Self {
        let range = (high_m - low_m).max(0.0);
        let step = step_m.max(range / (MOST_LEVELS - 2) as f32).max(LEAST_STEP_M);
        Self {
            base_m: low_m,
            step_m: step,
            levels: (range / step).ceil() as usize + 1,
        }
    }

    /// The altitude of a level, metres; fractions of a level are allowed.
    pub(super) fn altitude(&self, level: f32) -> f32 {
        self.base_m + level * self.step_m
    }

    /// The level of an altitude, neither rounded nor clamped to the range.
    pub(super) fn level(&self, altitude_m: f32) -> f32 {
        (altitude_m - self.base_m) / self.step_m
    }
}
