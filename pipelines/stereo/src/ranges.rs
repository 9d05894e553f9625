//! Which altitudes each cell considers: a contiguous run of ladder levels, stored end to end.

use super::grid::{Grid, Ladder};
use std::ops::Range;

/// Per cell, the first level and where its values lie in a flat volume.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Bands {
    pub(super) low: Vec<u16>,
    /// `start[cell]..start[cell + 1]` are the values of a cell.
    pub(super) start: Vec<usize>,
}

impl Bands {
    pub(super) fn full(cells: usize, ladder: &Ladder) -> Self {
        Self {
            low: vec![0; cells],
            start: (0..=cells).map(|i| i * ladder.levels).collect(),
        }
    }

    /// Bands of a finer grid around what a coarser one (`factor` times wider cells) holds possible.
    ///
    /// `possible` is a low and a high altitude for each coarse cell; a cell takes in those of its parent and the parent's
    /// `reach` neighbours on each side, and `margin_m` more, so that an edge may move and a wall keeps both its feet.
    pub(super) fn around(
        grid: &Grid,
        ladder: &Ladder,
        coarse: &Grid,
        factor: usize,
        possible: &[(f32, f32)],
        reach: usize,
        margin_m: f32,
    ) -> Self {
        let spread = spread(coarse, possible, reach);
        let (mut low, mut start) = (Vec::with_capacity(grid.len()), Vec::with_capacity(grid.len() + 1));
        let last = ladder.levels - 1;
        let mut end = 0;
        start.push(0);
        for row in 0..grid.height {
            for col in 0..grid.width {
                let (least, most) = spread[row / factor * coarse.width + col / factor];
                let first = (ladder.level(least - margin_m).floor().max(0.0) as usize).min(last);
                let final_level = (ladder.level(most + margin_m).ceil().max(0.0) as usize).clamp(first, last);
                low.push(first as u16);
                end += final_level - first + 1;
                start.push(end);
            }
        }
        Self { low, start }
    }

    pub(super) fn count(&self, cell: usize) -> usize {
        self.start[cell + 1] - self.start[cell]
    }

    pub(super) fn range(&self, cell: usize) -> Range<usize> {
        self.start[cell]..self.start[cell + 1]
    }

    /// Values of all cells together.
    pub(super) fn total(&self) -> usize {
        *self.start.last().unwrap_or(&0)
    }
}

/// The widest bounds among each cell and its neighbours up to `reach` away (a separable minimum and maximum).
fn spread(grid: &Grid, bounds: &[(f32, f32)], reach: usize) -> Vec<(f32, f32)> {
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
