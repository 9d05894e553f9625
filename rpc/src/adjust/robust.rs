//! Robust weights of sightings, and the scale of the residuals of good ones.

use super::linear::Linear;
use heliosplat_grid::statistics::upper_median;

/// Residual, in standard deviations, at which a sighting has a quarter of its weight. It is small because errors of
/// matching are not symmetric: slightly moved shadows pull in one direction, and only the peak of the residuals'
/// distribution is at the ground.
const QUARTER_AT: f64 = 1.0;
/// Largest residual of a good sighting, in standard deviations.
const GOOD_TO: f64 = 3.0;
/// Least standard deviation, pixels: the best precision of matching.
pub(super) const LEAST_SIGMA_PX: f64 = 0.03;
/// Median over standard deviation of the length of a normal residual in two directions.
const MEDIAN_OF_LENGTH: f64 = 1.1774;

/// Lengths of a track's residuals for the robust weights, pixels. With two sightings it is unknown which one is wrong.
/// Both get their common length; else the point would move onto one and the other would be rejected.
pub(super) fn lengths_px(track: &[Linear]) -> Vec<f64> {
    match track {
        [a, b] => {
            let both_px = (0.5 * (a.residual.norm_squared() + b.residual.norm_squared())).sqrt();
            vec![both_px; 2]
        }
        _ => track.iter().map(|line| line.residual.norm()).collect(),
    }
}

/// Standard deviation of one component of the residuals, from the median of their lengths, so that up to half of them
/// may be wrong. `freedom` is the redundancy as a share of the equations.
pub(super) fn sigma_px(mut lengths_px: Vec<f64>, freedom: f64) -> f64 {
    let Some(median_px) = upper_median(&mut lengths_px) else {
        return LEAST_SIGMA_PX;
    };
    (median_px / MEDIAN_OF_LENGTH / freedom.max(0.05).sqrt()).max(LEAST_SIGMA_PX)
}

/// Weight of a residual (S. Geman, D. McClure, 1987): 1 for none, a quarter at [`QUARTER_AT`] standard deviations.
pub(super) fn weight(length_px: f64, sigma_px: f64) -> f64 {
    let scaled = length_px / (QUARTER_AT * sigma_px);
    (1.0 + scaled * scaled).powi(-2)
}

/// True if a residual of this length belongs to a good sighting.
pub(super) fn is_good(length_px: f64, sigma_px: f64) -> bool {
    length_px <= GOOD_TO * sigma_px
}
