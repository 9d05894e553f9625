//! How much a sighting counts, and how far off a good one is.

/// Residuals, in standard deviations, at which a sighting counts a quarter.
const QUARTER_AT: f64 = 3.0;
/// Least standard deviation believed, pixels: what matching can do at best.
const LEAST_SIGMA_PX: f64 = 0.03;
/// Median over standard deviation of the length of a normal residual in two directions.
const MEDIAN_OF_LENGTH: f64 = 1.1774;

/// The standard deviation of one direction of the residuals whose lengths are given, by their median, so that up to half of them may
/// be wrong. `freedom` is the share of equations that the unknowns leave.
pub(super) fn sigma_px(mut lengths_px: Vec<f64>, freedom: f64) -> f64 {
    if lengths_px.is_empty() {
        return LEAST_SIGMA_PX;
    }
    let middle = lengths_px.len() / 2;
    let median = *lengths_px.select_nth_unstable_by(middle, f64::total_cmp).1;
    (median / MEDIAN_OF_LENGTH / freedom.max(0.05).sqrt()).max(LEAST_SIGMA_PX)
}

/// Weight of a residual (S. Geman, D. McClure, 1987): 1 for none, a quarter at [`QUARTER_AT`] standard deviations.
pub(super) fn weight(length_px: f64, sigma_px: f64) -> f64 {
    let scaled = length_px / (QUARTER_AT * sigma_px);
    (1.0 + scaled * scaled).powi(-2)
}

/// Whether a sighting of this weight is a good one.
pub(super) fn is_good(weight: f64) -> bool {
    weight >= 0.25
}
