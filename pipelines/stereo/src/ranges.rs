//! The search range of each cell: a contiguous run of height levels, stored end to end in a flat volume.
//!
//! On the coarsest level of the pyramid every cell searches all heights; on finer ones only those around what the coarser level left
//! as candidates, which is what makes the sweep fast.

use super::grid::Grid;
use super::heights::HeightHypotheses;
use std::ops::Range;

/// Per cell, the first level and where its values lie in a flat volume.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SearchRanges {
    pub(super) low: Vec<u16>,
    /// `start[cell]..start[cell + 1]` are the values of a cell.
    pub(super) start: Vec<usize>,
}

impl SearchRanges {
    /// All levels in each of `cells` cells.
    pub(super) fn full(cells: usize, heights: &HeightHypotheses) -> Self {
        Self {
            low: vec![0; cells],
            start: (0..=cells).map(|i| i * heights.levels).collect(),
        }
    }

    /// Ranges of a finer grid around the candidates of a coarser one, whose cells are `factor` times as wide.
    ///
    /// `candidates` are the lowest and the highest candidate of each coarse cell, metres. A cell searches those of its parent and of the
    /// parent's `reach` neighbours on each side, and `margin_m` more, so that an edge may move by some cells and both sides of a wall
    /// stay in range.
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
        let (mut low, mut start) = (Vec::with_capacity(grid.len()), Vec::with_capacity(grid.len() + 1));
        let last = heights.levels - 1;
        let mut end = 0;
        start.push(0);
        for row in 0..grid.height {
            for col in 0..grid.width {
                let (least, most) = bounds[row / factor * coarse.width + col / factor];
                let first = (heights.level(least - margin_m).floor().max(0.0) as usize).min(last);
                let final_level = (heights.level(most + margin_m).ceil().max(0.0) as usize).clamp(first, last);
                low.push(first as u16);
                end += final_level - first + 1;
                start.push(end);
            }
        }
        Self { low, start }
    }

    /// Levels of a cell.
    pub(super) fn count(&self, cell: usize) -> usize {
        self.start[cell + 1] - self.start[cell]
    }

    /// Where the values of a cell lie in the flat volume.
    pub(super) fn range(&self, cell: usize) -> Range<usize> {
        self.start[cell]..self.start[cell + 1]
    }

    /// Values of all cells together.
    pub(super) fn total(&self) -> usize {
        *self.start.last().unwrap_or(&0)
    }
}

/// The widest bounds among each cell and its neighbours up to `reach` away (a separable minimum and maximum).
fn widened(grid: &Grid, bounds: &[(f32, f32)], reach: usize) -> Vec<(f32, f32)> {
    let widen = |a: (f32, f32), b: (f32, f32)| (a.0.min(b.0), a.1.max(b.1));
    let mut across = bounds.to_vec();
    for row in 0..grid.height {
        let line = &bounds[row * grid.width..(row + 1) * grid.width];
        for col in 0..grid.width {
            let near = &line[col.saturating_sub(reach)..(col + reach + 1).min(grid.width)];
            across[row * grid.width + col] = near.iter().copied().fold(line[col], widen);
        }
    }
    let mut both = across.clone();
    for row in 0..grid.height {
        for near in row.saturating_sub(reach)..(row + reach + 1).min(grid.height) {
            for col in 0..grid.width {
                let i = row * grid.width + col;
                both[i] = widen(both[i], across[near * grid.width + col]);
            }
        }
    }
    both
}
