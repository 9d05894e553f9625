//! The ground below a surface, and the probability that the surface is ground.

use heliosplat_grid::opening;

/// Half of the largest width of structures on the ground, metres: two rows of houses and the court between them.
const REACH_M: f32 = 12.0;
/// Least height above the ground of a cell that may be a structure, metres.
const LEAST_M: f32 = 3.0;
/// Least probability of a certain altitude.
const SURE: f32 = 0.97;

/// Altitude of the ground below a surface, metres, `[row][column]`: the morphological opening of `altitude_m` (metres,
/// NaN where unknown) on a grid of `(width, height)` cells of `cell_m` metres.
pub fn ground_below(size: (usize, usize), cell_m: f32, altitude_m: &[f32]) -> Vec<f32> {
    let reach = (REACH_M / cell_m).round() as usize;
    opening(size, altitude_m, [reach; 2])
}

/// Probability, 0 to 1, that a cell is ground although its altitude is `height_m` metres above the ground around it.
/// `of_altitude` returns the probability of that altitude, 0 to 1. `None` where the cell is too low to be a structure,
/// or its altitude is certain.
pub fn ground_probability(height_m: f32, of_altitude: impl FnOnce() -> f32) -> Option<f32> {
    let probability = (height_m > LEAST_M).then(of_altitude)?;
    (probability < SURE).then_some(1.0 - probability)
}

/// True if an altitude of this probability is certain; false for NaN.
pub(crate) fn is_sure(probability: f32) -> bool {
    probability >= SURE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_probability_is_neither_sure_nor_doubt() {
        assert!(!is_sure(f32::NAN) && ground_probability(5.0, || f32::NAN).is_none());
        assert!(is_sure(SURE) && ground_probability(5.0, || SURE).is_none());
        assert_eq!(ground_probability(5.0, || 0.75), Some(0.25));
        assert_eq!(ground_probability(LEAST_M, || 0.75), None);
    }
}
