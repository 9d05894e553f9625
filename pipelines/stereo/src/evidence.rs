//! Evidence that the views agree at a cell's altitude better than by chance.
//!
//! Semi-global matching gives every cell an altitude, and over open water a smooth one with a small deviation. The
//! agreement by chance is measured on the same cells: one view's census neighbourhoods are rotated by 90 degrees, so
//! that brightness, contrast and the number of views stay and only the pattern differs. The share by which the distance
//! of the true patterns is less is the evidence, over a window of some cells each way. It is zero over water, for any
//! number of views, and a quarter on land. Lawns without texture at one cell size may have some at twice that size: the
//! larger evidence of the two counts.
//!
//! With two or three views few comparisons decide, and the search has selected the altitude at which they happen to
//! agree, so the threshold is higher.
//!
//! Limits: matches that are wrong in the same way in all views pass, and patches smaller than the window share the
//! evidence of their surroundings.

use super::agreement::{DistanceSums, OnSurface};
use super::cost::CONTRAST_LIMIT;
use super::level::LevelView;
use super::ortho::{self, box_mean};
use super::pyramid::{Compared, Search};
use super::visibility::{FirstHits, Standing};
use heliosplat::timeline::stage;
use heliosplat_grid::Grid;
use rayon::prelude::*;

/// Half of the window, cells of the surface.
pub(super) const WINDOW_CELLS: usize = 8;
/// Half of the window that is a cell's own, cells of the surface: the reach of the census and of the windows of costs.
pub(super) const NEAR_CELLS: usize = 3;
/// Cells of the surface, each way, in one of the coarser level that is tested too.
const COARSER: usize = 2;
/// Factor on evidence of the coarser level, where the same window has a quarter of the comparisons.
const COARSER_WORTH: f32 = 0.8;
/// Rows that are resampled together: the samples of all views on them are in memory at a time.
const STRIP_ROWS: usize = 64;
/// Least evidence of a match, for any number of pairs of views (docs/lab/known.md).
pub(super) const LEAST_EVIDENCE: f32 = 0.08;
/// Additional evidence required of a single pair; with more pairs the search exploits chance less.
const LEAST_EVIDENCE_OF_PAIR: f32 = 0.12;

/// Evidence of the cells of a surface.
pub(super) struct Evidence {
    /// Over a window of [`WINDOW_CELLS`], or a coarser one: it decides whether a cell is matched.
    pub(super) around: Vec<f32>,
    /// Over [`NEAR_CELLS`] alone.
    pub(super) near: Vec<f32>,
}

/// A surface on the cells of one level of the search.
pub(super) struct LevelSurface<'a> {
    /// Views, pairs and parameters of the search.
    pub(super) search: &'a Search<'a>,
    /// Cells of the request, each way, in one of the surface.
    pub(super) factor: usize,
    /// Cells of the surface.
    pub(super) grid: Grid,
    /// Altitude of each cell, metres.
    pub(super) altitude_m: &'a [f32],
    /// A point this far below the first surface point of a view is hidden from it, metres.
    pub(super) tolerance_m: f32,
}

impl LevelSurface<'_> {
    /// Excess of the agreement of the views over chance, one value per cell: 0 for none, 1 for a perfect match; NaN
    /// where less than half of a window is compared.
    pub(super) fn evidence(&self) -> Evidence {
        let _part = stage("evidence");
        let distances = self.distances();
        let fine = shares(&self.grid, &distances, WINDOW_CELLS);
        let (coarse_grid, altitude_m) = self.coarser();
        let coarse = LevelSurface {
            factor: self.factor * COARSER,
            grid: coarse_grid,
            altitude_m: &altitude_m,
            ..*self
        };
        let coarse = shares(&coarse_grid, &coarse.distances(), WINDOW_CELLS / COARSER);
        let coarse = ortho::repeated(&self.grid, &coarse_grid, COARSER, &coarse);
        // `max` leaves NaN out where the other is a number.
        let cells = fine.iter().zip(coarse);
        Evidence {
            around: cells.map(|(fine, coarse)| fine.max(COARSER_WORTH * coarse)).collect(),
            near: shares(&self.grid, &distances, NEAR_CELLS),
        }
    }

    /// The first surface point on the rays of each view.
    pub(super) fn hits(&self, views: &[LevelView]) -> Vec<FirstHits> {
        let standing = Standing::new(&self.grid, self.altitude_m, self.tolerance_m);
        views
            .iter()
            .map(|view| FirstHits::new(&view.camera, &standing))
            .collect()
    }

    /// Views that are compared on the surface.
    pub(super) fn on<'a>(&'a self, views: &'a [LevelView], hits: &'a [FirstHits]) -> OnSurface<'a> {
        OnSurface {
            views,
            hits,
            grid: &self.grid,
            altitude_m: self.altitude_m,
            shift_m: 0.0,
            noise: self.search.request.parameters.noise_floor / CONTRAST_LIMIT,
        }
    }

    /// The surface on the coarser level.
    fn coarser(&self) -> (Grid, Vec<f32>) {
        let grid = self.grid.coarser(COARSER);
        let middle = |at: usize, count: usize| (at * COARSER + COARSER / 2).min(count - 1);
        let of_cell = |cell: usize| {
            let (col, row) = (cell % grid.width, cell / grid.width);
            self.altitude_m[middle(row, self.grid.height) * self.grid.width + middle(col, self.grid.width)]
        };
        (grid, (0..grid.len()).map(of_cell).collect())
    }

    /// Census distance of the views at each cell, and that expected by chance; NaN where no two views see it.
    fn distances(&self) -> [Vec<f32>; 2] {
        let Compared { views, pairs } = self.search.compared(self.factor);
        let grid = &self.grid;
        let hits = self.hits(&views);
        let surface = self.on(&views, &hits);
        let (mut found, mut by_chance) = (vec![f32::NAN; grid.len()], vec![f32::NAN; grid.len()]);
        let strip_cells = STRIP_ROWS * grid.width.max(1);
        let strips = found
            .par_chunks_mut(strip_cells)
            .zip(by_chance.par_chunks_mut(strip_cells));
        strips.enumerate().for_each(|(strip, (found, by_chance))| {
            let row0 = strip * STRIP_ROWS;
            let resampled = surface.resample(row0..(row0 + STRIP_ROWS).min(grid.height));
            let rotated = resampled.rotated();
            let (mut sums, mut chance) = (DistanceSums::new(found.len()), DistanceSums::new(found.len()));
            for pair in &pairs {
                let of_index = self.search.index_weight.map_or(0, |share| pair.weight_of(share));
                let weights = [pair.weight, of_index];
                resampled.add_distances(&resampled, pair, weights, &mut sums);
                // Rotated to either side, so that a slope of brightness agrees half of the time.
                resampled.add_distances(&rotated, pair, weights, &mut chance);
                rotated.add_distances(&resampled, pair, weights, &mut chance);
            }
            for cell in (0..found.len()).filter(|&cell| sums.weight[cell] > 0) {
                found[cell] = sums.distance[cell] as f32;
                by_chance[cell] = 0.5 * chance.distance[cell] as f32;
            }
        });
        [found, by_chance]
    }
}

/// Share by which the mean of the first distances is less than that of the second ones, over windows of `window` cells
/// each way; NaN where less than half of a window is compared.
fn shares(grid: &Grid, distances: &[Vec<f32>; 2], window: usize) -> Vec<f32> {
    let [found, by_chance] = distances.each_ref().map(|values| box_mean(grid, values, window));
    let shares = found.iter().zip(by_chance);
    shares.map(|(found, by_chance)| share_less(*found, by_chance)).collect()
}

/// Share by which a distance is less than by chance. Ground without any contrast agrees at every altitude, so its
/// evidence is zero.
fn share_less(found: f32, by_chance: f32) -> f32 {
    match by_chance == 0.0 {
        true => 0.0,
        false => 1.0 - found / by_chance,
    }
}

/// True if `evidence` suffices for a match of `views` views. Cells without comparisons (NaN) pass and are left to other
/// tests.
pub(super) fn is_match(evidence: f32, views: f32) -> bool {
    evidence.is_nan() || evidence >= least_evidence(views)
}

/// The least evidence of a match of `views` views.
pub(super) fn least_evidence(views: f32) -> f32 {
    let pairs = (0.5 * views * (views - 1.0)).max(1.0);
    LEAST_EVIDENCE + LEAST_EVIDENCE_OF_PAIR / pairs
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{leaning, noise, request};
    use super::super::views::SweepView;
    use super::*;
    use heliosplat::Raster;

    const SIDE: usize = 96;

    /// Matched cells of level ground whose eastern half is the same in all of `views` images.
    fn matched(views: usize) -> Vec<bool> {
        let seed = |number: usize| move |pixel: usize| if pixel % SIDE < SIDE / 2 { number as u64 + 1 } else { 0 };
        let images: Vec<Raster> = (0..views).map(|number| noise(SIDE, seed(number))).collect();
        let views: Vec<SweepView> = images
            .iter()
            .enumerate()
            .map(|(number, image)| leaning(image, 0.1 * number as f64, 0.0, number as u32))
            .collect();
        let request = request(SIDE, views.len());
        let search = Search::new(&views, &request);
        let grid = request.grid();
        let surface = LevelSurface {
            search: &search,
            factor: 1,
            grid,
            altitude_m: &vec![0.0; grid.len()],
            tolerance_m: 1.0,
        };
        let evidence = surface.evidence().around;
        evidence
            .into_iter()
            .map(|evidence| is_match(evidence, views.len() as f32))
            .collect()
    }

    #[test]
    fn what_every_image_shows_alike_is_a_match_and_what_differs_is_none_however_few_the_views() {
        for views in [2, 3, 8] {
            let matched = matched(views);
            let share = |cols: std::ops::Range<usize>| {
                let inside = (0..matched.len())
                    .filter(|cell| cols.contains(&(cell % SIDE)) && (16..SIDE - 16).contains(&(cell / SIDE)));
                let (known, all) = inside.fold((0, 0), |(known, all), cell| {
                    (known + usize::from(matched[cell]), all + 1)
                });
                known as f64 / all as f64
            };
            assert_eq!(
                share(SIDE / 2 + 12..SIDE - 16),
                1.0,
                "the eastern half in {views} views"
            );
            assert!(share(16..SIDE / 2 - 12) < 0.05, "the western half in {views} views");
        }
    }

    #[test]
    fn ground_without_contrast_is_no_evidence_and_what_is_not_compared_says_nothing() {
        assert_eq!(share_less(0.0, 0.0), 0.0);
        assert_eq!(share_less(3.0, 4.0), 0.25);
        assert!(share_less(f32::NAN, f32::NAN).is_nan());
    }

    #[test]
    fn a_single_pair_needs_more_evidence_than_many_views() {
        assert!((least_evidence(2.0) - 0.20).abs() < 1e-6 && least_evidence(12.0) < 0.082);
    }
}
