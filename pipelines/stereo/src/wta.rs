//! From summed costs to an altitude: the cheapest level, a fraction of a step beside it, and how sure that is.

use super::bands::Bands;
use super::grid::Ladder;
use rayon::prelude::*;

/// What the volume says of one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Choice {
    pub(super) altitude_m: f32,
    /// Lowest and highest altitude that are nearly as good.
    pub(super) possible: (f32, f32),
    /// Summed cost of the level: how badly the views agree, with what smoothness adds.
    pub(super) cost: u16,
    /// How much worse the best distant alternative is, 0 (equal) to 1.
    pub(super) margin: f32,
}

/// Levels beside the best that count as the same answer.
const SAME: usize = 2;

/// Chooses a level for every cell. Local minima whose cost lies less than `tolerance` (in units of summed cost) above
/// the best stay possible for the next round.
pub(super) fn choose(bands: &Bands, ladder: &Ladder, sums: &[u16], tolerance: u16) -> Vec<Choice> {
    (0..bands.low.len())
        .into_par_iter()
        .map(|cell| {
            one(
                &sums[bands.range(cell)],
                usize::from(bands.low[cell]),
                ladder,
                tolerance,
            )
        })
        .collect()
}

fn one(sums: &[u16], low: usize, ladder: &Ladder, tolerance: u16) -> Choice {
    let mut best = 0;
    for (level, sum) in sums.iter().enumerate() {
        if *sum < sums[best] {
            best = level;
        }
    }
    let limit = sums[best].saturating_add(tolerance);
    let (mut least, mut most, mut second) = (best, best, u16::MAX);
    for (level, &sum) in sums.iter().enumerate() {
        if level.abs_diff(best) > SAME {
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
    Choice {
        altitude_m: ladder.altitude((low + best) as f32 + fraction),
        possible: (
            ladder.altitude((low + least) as f32),
            ladder.altitude((low + most) as f32),
        ),
        cost: sums[best],
        margin,
    }
}

/// Where the parabola through three equidistant values has its least value, in steps from the middle one, held to ±½.
pub(super) fn vertex([before, here, after]: [f32; 3]) -> f32 {
    let bend = before - 2.0 * here + after;
    if bend > 0.0 {
        (0.5 * (before - after) / bend).clamp(-0.5, 0.5)
    } else {
        0.0
    }
}
