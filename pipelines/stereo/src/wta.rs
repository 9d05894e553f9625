//! Winner takes all: from summed costs to one altitude per cell, refined below the height step.
//!
//! The cheapest level wins; the parabola through it and its neighbours refines it (as Hirschmüller 2008 does for disparities), and how
//! much worse the best distant alternative is says how much to trust it.

use super::heights::HeightHypotheses;
use super::ranges::SearchRanges;
use rayon::prelude::*;

/// The winner of one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HeightChoice {
    pub(super) altitude_m: f32,
    /// Lowest and highest altitude that stay candidates for the next search, metres.
    pub(super) candidates: (f32, f32),
    /// How much worse the best distant alternative is, 0 (equal) to 1.
    pub(super) margin: f32,
}

/// Levels beside the best that count as the same answer: its own valley of costs, not an alternative.
const SAME_VALLEY: usize = 2;

/// Chooses an altitude for every cell. Local minima whose summed cost lies at most `tolerance` above the least stay candidates for the
/// next search.
pub(super) fn winner_takes_all(
    ranges: &SearchRanges,
    heights: &HeightHypotheses,
    sums: &[u16],
    tolerance: u16,
) -> Vec<HeightChoice> {
    (0..ranges.low.len())
        .into_par_iter()
        .map(|cell| {
            winner(
                &sums[ranges.range(cell)],
                usize::from(ranges.low[cell]),
                heights,
                tolerance,
            )
        })
        .collect()
}

fn winner(sums: &[u16], low: usize, heights: &HeightHypotheses, tolerance: u16) -> HeightChoice {
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
        vertex([sums[best - 1], sums[best], sums[best + 1]].map(f32::from))
    } else {
        0.0
    };
    let margin = if second == u16::MAX {
        0.0
    } else {
        f32::from(second - sums[best]) / f32::from(second.max(1))
    };
    HeightChoice {
        altitude_m: heights.altitude((low + best) as f32 + fraction),
        candidates: (
            heights.altitude((low + least) as f32),
            heights.altitude((low + most) as f32),
        ),
        margin,
    }
}

/// Minimum of the parabola through three equidistant values, in steps from the middle one, clamped to ±½.
fn vertex([before, here, after]: [f32; 3]) -> f32 {
    let bend = before - 2.0 * here + after;
    if bend > 0.0 {
        (0.5 * (before - after) / bend).clamp(-0.5, 0.5)
    } else {
        0.0
    }
}
