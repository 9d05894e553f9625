//! The ground below a surface, and what of the surface may be ground instead.

use super::grid::opening;

/// What is narrower than twice this stands on the ground, metres: two rows of houses and the court between them.
const REACH_M: f32 = 12.0;
/// Least height above the ground that makes another choice, metres.
const LEAST_M: f32 = 3.0;
/// Probability of an altitude from which on the sweep is sure of it.
const SURE: f32 = 0.97;

/// The ground below the surface `altitude_m`, NaN where it is unknown, on a grid of `(width, height)` cells: its opening.
pub fn ground_below(size: (usize, usize), cell_m: f32, altitude_m: &[f32]) -> Vec<f32> {
    let reach = (REACH_M / cell_m).round() as usize;
    opening(size, altitude_m, [reach; 2])
}

/// Whether a cell that stands `height_m` above the ground, and whose altitude has this probability, may be ground.
pub fn may_be_ground(height_m: f32, probability: f32) -> bool {
    height_m > LEAST_M && probability < SURE
}
