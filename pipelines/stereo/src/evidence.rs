//! Whether the views agree at a cell's altitude better than they would by chance.
//!
//! Semi-global matching gives every cell an altitude, and over open water a smooth one that looks sure of itself. Where
//! nothing matches, the matching cost of the chosen altitude is hardly less than that of any other. So the share by which it is less is
//! the evidence: its mean over some twenty cells each way, on the coarse levels, where many height hypotheses are compared. Ground without
//! texture may show nothing on one level and enough on the next: the larger share counts.
//!
//! Such a window reaches over a shore: the texture of the land lends evidence to the water beside it. So stretches without a match that
//! are much larger than the window are grown over their border, as far as a finer level with a window of a few cells shows hardly anything either.
//! Smaller ones, a courtyard in deep shade, are left as they are: what is lost around them would be right more often than not.
//!
//! Limits: matches that are wrong in the same way in all views pass, and patches smaller than the window are judged with their
//! surroundings.

use super::grid::Grid;
use super::ortho::box_mean;
use super::parameters::many_views_share;
use super::postprocess::for_each_patch;
use super::ranges::SearchRanges;
use rayon::prelude::*;

/// Cells of the request per cell of the finest level that is judged: on finer ones few hypotheses are left.
const FINEST_FACTOR: usize = 4;
/// The same of the level that tells how far a stretch without a match reaches.
const BORDER_FACTOR: usize = 2;
/// Half of the window of the mean, in cells of the request.
const WINDOW_CELLS: usize = 8;
/// Hypotheses that a cell needs to be judged: with fewer the chosen one and its neighbours are all there is.
const FEWEST_HYPOTHESES: usize = 4;
/// Least share by which the cost at the chosen altitude is below the mean of all, where many views see a cell: open sea has 0.04 to 0.05, and of
/// the ground that is matched right less than 1 % has under 0.08 (docs/lab/known.md).
const LEAST_SHARE_MANY: f32 = 0.08;
/// The same where few do: of few comparisons some agree by chance at one altitude of many.
const LEAST_SHARE_FEW: f32 = 0.12;
/// The same over that in a window of 3 × 3 cells of the border level, where shares are larger: with many views three quarters of the land have 0.13 or
/// more, nine tenths of open water less than 0.1.
const BORDER_SHARE: f32 = 1.375;
/// Cells by which a stretch without a match grows at most: half of the window on the coarsest level is 12, and the census sees some more.
const MOST_GROWN_CELLS: usize = 16;
/// Cells of a stretch without a match that is grown, some six windows by six. A court in the shade of towers is smaller, and its rim is mostly
/// right once trained (docs/lab/known.md).
const LEAST_STRETCH_CELLS: usize = 10_000;

/// The evidence of the levels that were judged.
#[derive(Debug, Clone, Default)]
pub(super) struct Evidence {
    levels: Vec<Level>,
    /// The level that tells how far a stretch without a match reaches.
    border: Option<Level>,
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
        if factor < BORDER_FACTOR {
            return;
        }
        let share: Vec<f32> = (0..grid.len())
            .into_par_iter()
            .map(|cell| {
                let range = ranges.range(cell);
                share_saved(&costs[range.clone()], &sums[range])
            })
            .collect();
        let radius = match factor < FINEST_FACTOR {
            true => 1,
            false => (WINDOW_CELLS / factor).max(1),
        };
        let level = Level {
            grid: *grid,
            factor,
            share: box_mean(grid, &share, radius),
        };
        match factor < FINEST_FACTOR {
            true => self.border = Some(level),
            false => self.levels.push(level),
        }
    }

    /// Whether each cell of the request, which so many `views` see, is matched better than by chance. What no level judges counts as matched: other
    /// tests are left.
    pub(super) fn matched(&self, grid: &Grid, views: impl Fn(usize) -> f32 + Sync) -> Vec<bool> {
        let least =
            |cell: usize| LEAST_SHARE_FEW + (LEAST_SHARE_MANY - LEAST_SHARE_FEW) * many_views_share(views(cell));
        let of_cell = |cell: usize| {
            // `max` leaves NaN out where the other is a number.
            let shares = self.levels.iter().map(|level| level.at(grid, cell));
            let share = shares.fold(f32::NAN, f32::max);
            share.is_nan() || share >= least(cell)
        };
        let mut matched: Vec<bool> = (0..grid.len()).into_par_iter().map(of_cell).collect();
        if let Some(border) = &self.border {
            grow(grid, &mut matched, |cell| {
                border.at(grid, cell) < BORDER_SHARE * least(cell)
            });
        }
        matched
    }
}

impl Level {
    /// The share at a cell of the request.
    fn at(&self, grid: &Grid, cell: usize) -> f32 {
        let (col, row) = (cell % grid.width / self.factor, cell / grid.width / self.factor);
        self.share[row * self.grid.width + col]
    }
}

/// Grows large stretches of cells that are not `matched` by up to [`MOST_GROWN_CELLS`] through `bare` cells, those that show hardly anything.
fn grow(grid: &Grid, matched: &mut [bool], bare: impl Fn(usize) -> bool) {
    let mut rim = large_stretches(grid, matched);
    for _ in 0..MOST_GROWN_CELLS {
        let mut next = Vec::new();
        for cell in rim {
            for near in grid.around(cell, 1) {
                if matched[near] && bare(near) {
                    matched[near] = false;
                    next.push(near);
                }
            }
        }
        rim = next;
    }
}

/// The cells of the connected stretches of [`LEAST_STRETCH_CELLS`] cells or more that are not `matched`.
fn large_stretches(grid: &Grid, matched: &[bool]) -> Vec<usize> {
    let mut large = Vec::new();
    for_each_patch(
        grid,
        matched.to_vec(),
        |_, _| true,
        |stretch| {
            if stretch.len() >= LEAST_STRETCH_CELLS {
                large.extend_from_slice(stretch);
            }
        },
    );
    large
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
        let matched = evidence(noise).matched(&grid(), |_| 10.0);
        // In the corners less than half of the window is there, and nothing is judged.
        let inside = (0..32 * 32).filter(|cell| (4..28).contains(&(cell / 32)) && (4..28).contains(&(cell % 32)));
        assert_eq!(inside.filter(|&cell| matched[cell]).count(), 0);
    }

    #[test]
    fn an_altitude_that_costs_a_tenth_less_is_a_match_of_many_views_and_chance_of_few() {
        let faint = |_: usize, level: usize| if level == 4 { 194 } else { 215 };
        let all = |views: f32| evidence(faint).matched(&grid(), |_| views);
        assert!(all(8.0).iter().all(|&matched| matched));
        let inside = (0..32 * 32).filter(|cell| (4..28).contains(&(cell / 32)) && (4..28).contains(&(cell % 32)));
        assert_eq!(inside.filter(|&cell| all(4.0)[cell]).count(), 0);
    }

    #[test]
    fn an_altitude_that_costs_a_quarter_less_is_a_match() {
        let clear = |_: usize, level: usize| if level == 4 { 160 } else { 215 };
        assert!(
            evidence(clear)
                .matched(&grid(), |_| 10.0)
                .iter()
                .all(|&matched| matched)
        );
    }

    #[test]
    fn a_large_stretch_without_a_match_takes_the_bare_cells_beside_it_and_a_small_one_does_not() {
        let grid = Grid::plain(90, 250);
        // Water in the west, a shore that the coarse windows take for land as far as column 60, and bare cells as far as column 64.
        let left = |columns: usize| {
            let mut matched: Vec<bool> = (0..grid.len()).map(|cell| cell % 90 >= columns).collect();
            grow(&grid, &mut matched, |cell| cell % 90 < 64);
            matched
        };
        let grown = left(50);
        assert!((0..grid.len()).all(|cell| grown[cell] == (cell % 90 >= 64)));
        let far = left(42);
        assert!((0..grid.len()).all(|cell| far[cell] == (cell % 90 >= 42 + MOST_GROWN_CELLS)));
        let small = left(20);
        assert!((0..grid.len()).all(|cell| small[cell] == (cell % 90 >= 20)));
    }

    #[test]
    fn where_nothing_was_compared_nothing_is_said_against_a_cell() {
        assert!(
            evidence(|_, _| 255)
                .matched(&grid(), |_| 10.0)
                .iter()
                .all(|&matched| matched)
        );
        assert!(
            Evidence::default()
                .matched(&grid(), |_| 10.0)
                .iter()
                .all(|&matched| matched)
        );
    }
}
