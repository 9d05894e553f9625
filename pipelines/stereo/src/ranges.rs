//! The search range of each cell: a contiguous run of height levels, stored end to end in a flat volume.
//!
//! On the coarsest level of the pyramid every cell searches all heights; on finer ones only those around the candidates
//! of the coarser level, which makes the sweep fast.

use super::heights::HeightHypotheses;
use heliosplat_grid::Grid;
use rayon::prelude::*;
use std::ops::Range;

/// Search range of each cell: its first level, and the position of its values in a flat volume.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SearchRanges {
    /// First level of each cell.
    pub(super) low: Vec<u16>,
    /// `start[cell]..start[cell + 1]` are the values of a cell.
    pub(super) start: Vec<usize>,
}

impl SearchRanges {
    /// Ranges of all levels for each of `cells` cells.
    pub(super) fn full(cells: usize, heights: &HeightHypotheses) -> Self {
        Self {
            low: vec![0; cells],
            start: (0..=cells).map(|i| i * heights.levels).collect(),
        }
    }

    /// Ranges of a finer grid around the candidates of a coarser one, whose cells are `factor` times as wide.
    ///
    /// `candidates` are the lowest and the highest candidate of each coarse cell, metres. A cell searches those of its
    /// parent and of the parent's `reach` neighbours on each side, and `margin_m` more, so that an edge may move by
    /// some cells and both sides of a wall stay in range.
    pub(super) fn around(
        grid: &Grid,
        heights: &HeightHypotheses,
        coarse: &Grid,
        factor: usize,
        candidates: &[(f32, f32)],
        reach: usize,
        margin_m: f32,
    ) -> Self {
        let bounds = widened(coarse, candidates, reach);
        let last = heights.levels - 1;
        let levels = |&(least, most): &(f32, f32)| {
            let first = (heights.level(least - margin_m).floor().max(0.0) as usize).min(last);
            let final_level = (heights.level(most + margin_m).ceil().max(0.0) as usize).clamp(first, last);
            (first as u16, final_level - first + 1)
        };
        let levels: Vec<(u16, usize)> = bounds.par_iter().map(levels).collect();
        let of_cell = |cell: usize| levels[cell / grid.width / factor * coarse.width + cell % grid.width / factor];
        let low = grid.cells().map(|cell| of_cell(cell).0).collect();
        let mut start = Vec::with_capacity(grid.len() + 1);
        start.push(0);
        let mut end = 0;
        for cell in 0..grid.len() {
            end += of_cell(cell).1;
            start.push(end);
        }
        Self { low, start }
    }

    /// Number of levels of a cell.
    pub(super) fn count(&self, cell: usize) -> usize {
        self.start[cell + 1] - self.start[cell]
    }

    /// Range of a cell's values in the flat volume.
    pub(super) fn range(&self, cell: usize) -> Range<usize> {
        self.start[cell]..self.start[cell + 1]
    }

    /// Number of values of all cells together.
    pub(super) fn total(&self) -> usize {
        *self.start.last().unwrap_or(&0)
    }
}

/// The widest bounds among each cell and its neighbours up to `reach` away (a separable minimum and maximum).
fn widened(grid: &Grid, bounds: &[(f32, f32)], reach: usize) -> Vec<(f32, f32)> {
    let widen = |a: (f32, f32), b: (f32, f32)| (a.0.min(b.0), a.1.max(b.1));
    let near = |at: usize, count: usize| at.saturating_sub(reach)..(at + reach + 1).min(count);
    let along_row = |cell: usize| {
        let line = &bounds[cell / grid.width * grid.width..][..grid.width];
        let around = &line[near(cell % grid.width, grid.width)];
        around.iter().copied().fold(bounds[cell], widen)
    };
    let across: Vec<(f32, f32)> = grid.cells().map(along_row).collect();
    let along_column = |cell: usize| {
        let around = near(cell / grid.width, grid.height).map(|row| across[row * grid.width + cell % grid.width]);
        around.fold(across[cell], widen)
    };
    grid.cells().map(along_column).collect()
}
