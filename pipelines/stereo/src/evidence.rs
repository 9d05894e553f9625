//! Whether the views agree at a cell's altitude better than they would by chance.
//!
//! Semi-global matching gives every cell an altitude, and over open water a smooth one that looks sure of itself. How well views agree by
//! chance is measured on the same cells: one view's census neighbourhoods are turned by a right angle, so that brightness, contrast and
//! the number of views stay as they are and only the pattern is another. The share by which the distance of the true patterns is less
//! is the evidence, over a window of some cells each way. It is nothing over water, whatever the number of views, and a quarter on land.
//!
//! Of two or three views a few comparisons decide, and the search has found the altitude at which these happen to agree: more is asked of them.
//!
//! Limits: matches that are wrong in the same way in all views pass, and patches smaller than the window are judged with their
//! surroundings.

use super::agreement::{DistanceSums, OnSurface};
use super::cost::CONTRAST_LIMIT;
use super::grid::Grid;
use super::level::LevelView;
use super::ortho::box_mean;
use super::pyramid::{Compared, Search};
use super::visibility::FirstHits;
use rayon::prelude::*;

/// Half of the window, cells.
const WINDOW_CELLS: usize = 8;
/// Rows that are resampled together: what all views show on them is in memory at a time.
const STRIP_ROWS: usize = 64;
/// Least evidence of a match, however many pairs of views compare it (docs/lab/known.md).
const LEAST_EVIDENCE: f32 = 0.08;
/// The same that a single pair needs beside it; of more pairs, chance leaves the search less.
const LEAST_EVIDENCE_OF_PAIR: f32 = 0.08;

/// Whether each cell of a surface, which so many `views` see, is matched better than by chance. The surface lies on the cells of the level
/// of `factor`; a view does not see what lies `tolerance_m` below what it sees first. Where less than half of a window is compared nothing is
/// said against a cell: other tests are left.
pub(super) fn matched(
    search: &Search,
    factor: usize,
    grid: &Grid,
    altitude_m: &[f32],
    tolerance_m: f32,
    views: impl Fn(usize) -> f32,
) -> Vec<bool> {
    let evidence = evidence(search, factor, grid, altitude_m, tolerance_m);
    let cells = evidence.iter().enumerate();
    cells
        .map(|(cell, evidence)| evidence.is_nan() || *evidence >= least_evidence(views(cell)))
        .collect()
}

/// The least evidence of a match that so many views agree on.
fn least_evidence(views: f32) -> f32 {
    let pairs = (0.5 * views * (views - 1.0)).max(1.0);
    LEAST_EVIDENCE + LEAST_EVIDENCE_OF_PAIR / pairs
}

/// Share by which the census distance of the views is less than by chance; NaN where less than half of a window is compared.
fn evidence(search: &Search, factor: usize, grid: &Grid, altitude_m: &[f32], tolerance_m: f32) -> Vec<f32> {
    let Compared { views, pairs } = search.compared(factor);
    let hits = |view: &LevelView| FirstHits::new(&view.camera, grid, altitude_m, tolerance_m);
    let surface = OnSurface {
        views: &views,
        hits: &views.iter().map(hits).collect::<Vec<_>>(),
        grid,
        altitude_m,
        noise: search.request.parameters.noise_floor / CONTRAST_LIMIT,
    };
    let (mut found, mut by_chance) = (vec![f32::NAN; grid.len()], vec![f32::NAN; grid.len()]);
    let strip_cells = STRIP_ROWS * grid.width.max(1);
    let strips = found.par_chunks_mut(strip_cells).zip(by_chance.par_chunks_mut(strip_cells));
    strips.enumerate().for_each(|(strip, (found, by_chance))| {
        let row0 = strip * STRIP_ROWS;
        let resampled = surface.resample(row0..(row0 + STRIP_ROWS).min(grid.height));
        let turned = resampled.turned();
        let (mut sums, mut chance) = (DistanceSums::new(found.len()), DistanceSums::new(found.len()));
        for pair in &pairs {
            let weights = [pair.weight, search.index_weight.map_or(0, |share| pair.weight_of(share))];
            resampled.add_distances(&resampled, pair, weights, &mut sums);
            // Turned to either side, so that a slope of brightness agrees half of the time.
            resampled.add_distances(&turned, pair, weights, &mut chance);
            turned.add_distances(&resampled, pair, weights, &mut chance);
        }
        for cell in (0..found.len()).filter(|&cell| sums.weight[cell] > 0) {
            found[cell] = sums.distance[cell] as f32;
            by_chance[cell] = 0.5 * chance.distance[cell] as f32;
        }
    });
    let [found, by_chance] = [found, by_chance].map(|values| box_mean(grid, &values, WINDOW_CELLS));
    found.iter().zip(by_chance).map(|(found, chance)| 1.0 - found / chance).collect()
}
