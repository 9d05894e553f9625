//! Whether the views agree at a cell's altitude better than they would by chance.
//!
//! Semi-global matching gives every cell an altitude, and over open water a smooth one that looks sure of itself. Where
//! nothing matches, the matching cost of the chosen altitude is hardly less than that of any other. So the share by which it is less is
//! the evidence: its mean over some twenty cells each way, on the coarse levels, where many height hypotheses are compared. Ground without
//! texture may show nothing on one level and enough on the next: the larger share counts.
//!
//! Limits: matches that are wrong in the same way in all views pass, and patches smaller than the window are judged with their
//! surroundings.

use super::grid::Grid;
use super::ortho::box_mean;
use super::ranges::SearchRanges;
use rayon::prelude::*;

/// Cells of the request per cell of the finest level that is judged: on finer ones few hypotheses are left.
const FINEST_FACTOR: usize = 4;
/// Half of the window of the mean, in cells of the request.
const WINDOW_CELLS: usize = 8;
/// Hypotheses that a cell needs to be judged: with fewer the chosen one and its neighbours are all there is.
const FEWEST_HYPOTHESES: usize = 4;
/// Least share by which the cost at the chosen altitude is below the mean of all: open sea has 0.04 to 0.05, and of the ground that is
/// matched right less than 1 % has under 0.08 (docs/lab/known.md).
const LEAST_SHARE: f32 = 0.08;

/// The evidence of the levels that were judged.
#[derive(Debug, Clone, Default)]
pub(super) struct Evidence {
    levels: Vec<Level>,
}

#[derive(Debug, Clone)]
struct Level {
    grid: Grid,
    factor: usize,
    /// Share by which the chosen cost is less than the mean; NaN where it cannot be judged.
    share: Vec<f32>,
}

impl Evidence {
    /// Adds a level whose cells are `factor` cells of the request wide, if it is one to judge by: its matching `costs` and its aggregated
    /// `sums`, both in the order of `ranges`.
    pub(super) fn add(&mut self, grid: &Grid, factor: usize, ranges: &SearchRanges, costs: &[u8], sums: &[u16]) {
        if factor < FINEST_FACTOR {
            return;
        }
        let share: Vec<f32> = (0..grid.len())
            .into_par_iter()
            .map(|cell| {
                let range = ranges.range(cell);
                share_saved(&costs[range.clone()], &sums[range])
            })
            .collect();
        self.levels.push(Level {
            grid: *grid,
            factor,
            share: box_mean(grid, &share, (WINDOW_CELLS / factor).max(1)),
        });
    }

    /// Whether each cell of the request is matched better than by chance. What no level judges counts as matched: other tests are left.
    pub(super) fn matched(&self, grid: &Grid) -> Vec<bool> {
        let of_cell = |cell: usize| {
            let shares = self.levels.iter().map(|level| {
                let (col, row) = (cell % grid.width / level.factor, cell / grid.width / level.factor);
                level.share[row * level.grid.width + col]
            });
            // `max` leaves NaN out where the other is a number.
            let share = shares.fold(f32::NAN, f32::max);
            share.is_nan() || share >= LEAST_SHARE
        };
        (0..grid.len()).into_par_iter().map(of_cell).collect()
    }
}

/// Share by which the cost of the level that is cheapest in the `sums` is less than the mean `costs`; NaN where no views were compared, or
/// too few hypotheses.
fn share_saved(costs: &[u8], sums: &[u16]) -> f32 {
    let compared = costs.iter().any(|&cost| cost != costs[0]);
    if !compared || costs.len() < FEWEST_HYPOTHESES {
        return f32::NAN;
    }
    let chosen = (0..sums.len()).min_by_key(|&level| sums[level]).unwrap_or(0);
    let mean = costs.iter().map(|&cost| f32::from(cost)).sum::<f32>() / costs.len() as f32;
    (mean - f32::from(costs[chosen])) / mean
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heights::HeightHypotheses;

    /// Evidence of a level of 8 × 8 cells with eleven hypotheses, of which the fifth is chosen.
    fn evidence(cost: impl Fn(usize, usize) -> u8) -> Evidence {
        let (grid, heights) = (Grid::plain(8, 8), HeightHypotheses::new(0.0, 10.0, 1.0));
        let ranges = SearchRanges::full(grid.len(), &heights);
        let costs: Vec<u8> = (0..grid.len() * 11).map(|i| cost(i / 11, i % 11)).collect();
        let sums: Vec<u16> = (0..grid.len() * 11)
            .map(|i| if i % 11 == 4 { 100 } else { 900 })
            .collect();
        let mut evidence = Evidence::default();
        evidence.add(&grid, 4, &ranges, &costs, &sums);
        evidence
    }

    fn grid() -> Grid {
        Grid::plain(32, 32)
    }

    #[test]
    fn costs_that_scatter_alike_at_all_altitudes_are_no_match() {
        let noise = |cell: usize, level: usize| 215 + (((cell * 11 + level) * 2_654_435_761) >> 7) as u8 % 20;
        let matched = evidence(noise).matched(&grid());
        // In the corners less than half of the window is there, and nothing is judged.
        let inside = (0..32 * 32).filter(|cell| (4..28).contains(&(cell / 32)) && (4..28).contains(&(cell % 32)));
        assert_eq!(inside.filter(|&cell| matched[cell]).count(), 0);
    }

    #[test]
    fn an_altitude_that_costs_a_quarter_less_is_a_match() {
        let clear = |_: usize, level: usize| if level == 4 { 160 } else { 215 };
        assert!(evidence(clear).matched(&grid()).iter().all(|&matched| matched));
    }

    #[test]
    fn where_nothing_was_compared_nothing_is_said_against_a_cell() {
        assert!(evidence(|_, _| 255).matched(&grid()).iter().all(|&matched| matched));
        assert!(Evidence::default().matched(&grid()).iter().all(|&matched| matched));
    }
}
