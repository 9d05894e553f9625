//! Winner takes all: from summed costs to one altitude per cell, refined below the height step.
//!
//! The cheapest level wins; the parabola through it and its neighbours refines it (as Hirschmüller 2008 does for
//! disparities), and the margin to the best distant alternative is its confidence.

use super::heights::HeightHypotheses;
use super::parameters::COST_PER_E_FOLD;
use super::ranges::SearchRanges;
use heliosplat_grid::parabola_top;
use rayon::prelude::*;

/// The winner of one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HeightChoice {
    /// Chosen altitude, metres.
    pub(super) altitude_m: f32,
    /// Lowest and highest altitude that stay candidates for the next search, metres.
    pub(super) candidates: (f32, f32),
    /// Margin to the best distant alternative, 0 (equal) to 1.
    pub(super) margin: f32,
    /// Standard deviation of the altitude, metres.
    pub(super) deviation_m: f32,
    /// Probability that the altitude is right to within two height steps, 0 to 1.
    pub(super) probability: f32,
}

/// Levels next to the best that belong to the same minimum of costs and are no alternative.
const SAME_VALLEY: usize = 2;

/// Chooses an altitude for every cell. Local minima whose summed cost lies at most `tolerance` above the least stay
/// candidates for the next search. A level of another minimum is e times less probable per `alternative_cost` of
/// additional summed cost.
pub(super) fn winner_takes_all(
    ranges: &SearchRanges,
    heights: &HeightHypotheses,
    sums: &[u16],
    tolerance: u16,
    alternative_cost: f32,
) -> Vec<HeightChoice> {
    (0..ranges.low.len())
        .into_par_iter()
        .map(|cell| {
            winner(
                &sums[ranges.range(cell)],
                usize::from(ranges.low[cell]),
                heights,
                tolerance,
                alternative_cost,
            )
        })
        .collect()
}

/// Winner of one cell from the summed costs of its levels, the first of which is `low`; `tolerance` and
/// `alternative_cost` are those of [`winner_takes_all`].
pub(super) fn winner(
    sums: &[u16],
    low: usize,
    heights: &HeightHypotheses,
    tolerance: u16,
    alternative_cost: f32,
) -> HeightChoice {
    let mut best = 0;
    for (level, sum) in sums.iter().enumerate() {
        if *sum < sums[best] {
            best = level;
        }
    }
    let limit = sums[best].saturating_add(tolerance);
    let (mut least, mut most, mut second) = (best, best, u16::MAX);
    for (level, &sum) in sums.iter().enumerate() {
        if level.abs_diff(best) > SAME_VALLEY {
            second = second.min(sum);
        }
        let valley = (level == 0 || sums[level - 1] >= sum) && sums.get(level + 1).is_none_or(|&next| next >= sum);
        if valley && sum <= limit {
            least = least.min(level);
            most = most.max(level);
        }
    }
    let fraction = if best > 0 && best + 1 < sums.len() {
        parabola_top([best - 1, best, best + 1].map(|level| -f32::from(sums[level]))).unwrap_or(0.0)
    } else {
        0.0
    };
    let margin = if second == u16::MAX {
        0.0
    } else {
        f32::from(second - sums[best]) / f32::from(second.max(1))
    };
    let posterior = Posterior::new(sums, best, fraction, alternative_cost);
    HeightChoice {
        altitude_m: heights.altitude((low + best) as f32 + fraction),
        deviation_m: heights.step_m * posterior.deviation_levels,
        probability: posterior.probability,
        candidates: (
            heights.altitude((low + least) as f32),
            heights.altitude((low + most) as f32),
        ),
        margin,
    }
}

/// Posterior of the chosen level, from the summed costs of a cell as negative logarithms of probabilities: in units of
/// [`COST_PER_E_FOLD`] within its own minimum, of `alternative_cost` elsewhere.
struct Posterior {
    /// Root mean square distance from the chosen altitude, height steps.
    deviation_levels: f32,
    /// Probability of the levels of its own minimum of costs.
    probability: f32,
}

impl Posterior {
    fn new(sums: &[u16], best: usize, fraction: f32, alternative_cost: f32) -> Self {
        let chosen = best as f32 + fraction;
        let (mut all, mut near, mut squares) = (0.0f32, 0.0f32, 0.0f32);
        for (level, &sum) in sums.iter().enumerate() {
            let own = level.abs_diff(best) <= SAME_VALLEY;
            let per_e_fold = if own { COST_PER_E_FOLD } else { alternative_cost };
            let weight = (-f32::from(sum - sums[best]) / per_e_fold).exp();
            let away = level as f32 - chosen;
            all += weight;
            squares += weight * away * away;
            if own {
                near += weight;
            }
        }
        Self {
            deviation_levels: (squares / all).sqrt(),
            probability: near / all,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_clear_valley_is_sure_and_two_equal_ones_are_in_doubt_by_their_distance() {
        let heights = HeightHypotheses::new(0.0, 10.0, 0.5);
        let mut sums = [2000u16; 21];
        sums[4] = 200;
        let sure = winner(&sums, 0, &heights, 80, COST_PER_E_FOLD);
        assert!(sure.probability > 0.999 && sure.deviation_m < 0.01, "{sure:?}");
        sums[16] = 200;
        let torn = winner(&sums, 0, &heights, 80, COST_PER_E_FOLD);
        assert!((torn.probability - 0.5).abs() < 1e-3, "{torn:?}");
        // Half of the probability lies twelve steps away.
        assert!((torn.deviation_m - 6.0 * 0.5f32.sqrt()).abs() < 1e-2, "{torn:?}");
    }

    #[test]
    fn costs_that_say_nothing_leave_the_whole_range_in_doubt() {
        let heights = HeightHypotheses::new(0.0, 10.0, 0.5);
        let flat = winner(&[1000; 21], 0, &heights, 80, COST_PER_E_FOLD);
        assert!(flat.probability < 0.2 && flat.deviation_m > 5.0, "{flat:?}");
    }

    #[test]
    fn an_alternative_counts_more_where_neighbours_share_their_comparisons() {
        let heights = HeightHypotheses::new(0.0, 20.0, 1.0);
        let mut sums = [1000u16; 21];
        (sums[5], sums[15]) = (400, 490);
        let alone = winner(&sums, 0, &heights, 80, COST_PER_E_FOLD);
        let shared = winner(&sums, 0, &heights, 80, 5.0 * COST_PER_E_FOLD);
        assert_eq!(alone.altitude_m, shared.altitude_m);
        // Odds of e^3 and of e^(3/5) to one.
        assert!((alone.probability - 0.953).abs() < 0.001, "{alone:?}");
        assert!(shared.probability > 0.5 && shared.probability < 0.65, "{shared:?}");
        assert!(shared.deviation_m > 2.0 * alone.deviation_m, "{shared:?}");
    }
}
