//! Blocks of cells and the memory that their costs are computed in.

use super::super::census::{Descriptors, RADIUS};
use super::super::sampling::{POINTS, Places};
use heliosplat_grid::Grid;

/// Rows and columns of a block: small enough for the cache, large enough that the window's margin stays cheap.
pub(super) const BLOCK: (usize, usize) = (16, 64);

/// A rectangle of cells.
pub(super) struct Block {
    /// First row.
    pub(super) row0: usize,
    /// Row behind the last one.
    pub(super) row1: usize,
    /// First column.
    pub(super) col0: usize,
    /// Column behind the last one.
    pub(super) col1: usize,
}

impl Block {
    /// The block of one cell.
    pub(super) fn of_cell(row: usize, col: usize) -> Self {
        Self {
            row0: row,
            row1: row + 1,
            col0: col,
            col1: col + 1,
        }
    }

    /// Extends the block to the smallest one that also contains `other`.
    pub(super) fn grow(&mut self, other: &Self) {
        self.row0 = self.row0.min(other.row0);
        self.row1 = self.row1.max(other.row1);
        self.col0 = self.col0.min(other.col0);
        self.col1 = self.col1.max(other.col1);
    }

    /// Calls `each` with the index inside the block and the index on the grid of every cell, row by row.
    pub(super) fn cells(&self, grid: &Grid, mut each: impl FnMut(usize, usize)) {
        let mut k = 0;
        for row in self.row0..self.row1 {
            for col in self.col0..self.col1 {
                each(k, row * grid.width + col);
                k += 1;
            }
        }
    }

    /// The block with `margin` more cells on each side.
    pub(super) fn wider(&self, margin: usize) -> WideBlock {
        WideBlock {
            row0: self.row0 as isize - margin as isize,
            col0: self.col0 as isize - margin as isize,
            width: self.col1 - self.col0 + 2 * margin,
            height: self.row1 - self.row0 + 2 * margin,
        }
    }
}

/// A block with a margin, which may reach beyond the grid.
pub(super) struct WideBlock {
    /// First row on the grid; negative beyond its northern edge.
    pub(super) row0: isize,
    /// First column on the grid; negative beyond its western edge.
    pub(super) col0: isize,
    /// Number of columns.
    pub(super) width: usize,
    /// Number of rows.
    pub(super) height: usize,
}

impl WideBlock {
    /// Index of the grid's cell that is nearest to the block's cell in column `col` and row `row`.
    pub(super) fn nearest(&self, col: usize, row: usize, grid: &Grid) -> usize {
        let held = |at: isize, count: usize| (at.max(0) as usize).min(count - 1);
        held(self.row0 + row as isize, grid.height) * grid.width + held(self.col0 + col as isize, grid.width)
    }
}

/// Buffers for one block, reused from block to block.
pub(super) struct Scratch {
    /// Samples of one view, with room for a whole last group of `POINTS`.
    pub(super) values: Vec<f32>,
    /// Sampling positions.
    pub(super) places: Places,
    /// Descriptors of brightness, per view.
    pub(super) descriptors: Vec<Descriptors>,
    /// Descriptors of the index, per view.
    pub(super) index_descriptors: Vec<Descriptors>,
    /// Largest differences that the census compares, cell by cell.
    pub(super) limits: Vec<f32>,
    /// Weighted sums of the comparisons, cell by cell.
    pub(super) sum: Vec<u32>,
    /// Sums of the weights, cell by cell.
    pub(super) weights: Vec<u32>,
    /// The costs, 0 to 255.
    pub(super) cost: Vec<u8>,
    /// Sums over the rows of the aggregation window.
    across: Vec<u32>,
}

impl Scratch {
    /// Room for a block with a margin of `radius` cells and its census windows.
    pub(super) fn new(views: usize, radius: usize) -> Self {
        let cells = (BLOCK.0 + 2 * radius) * (BLOCK.1 + 2 * radius);
        let margin = 2 * (RADIUS + radius);
        Self {
            values: vec![0.0; (BLOCK.0 + margin) * (BLOCK.1 + margin) + POINTS],
            places: Places::new((BLOCK.0 + margin) * (BLOCK.1 + margin)),
            across: vec![0; cells],
            descriptors: vec![Descriptors::new(cells); views],
            index_descriptors: vec![Descriptors::new(cells); views],
            limits: vec![0.0; cells],
            sum: vec![0; cells],
            weights: vec![0; cells],
            cost: vec![0; cells],
        }
    }

    /// Averages the costs of a block and its margin over the aggregation window of `radius` cells. Afterwards `cost`
    /// begins with those of the block itself, row by row.
    pub(super) fn average(&mut self, block: &Block, radius: usize) {
        if radius == 0 {
            return;
        }
        let (width, height) = (block.col1 - block.col0, block.row1 - block.row0);
        let (stride, side) = (width + 2 * radius, 2 * radius + 1);
        for row in 0..height + 2 * radius {
            for col in 0..width {
                let window = &self.cost[row * stride + col..row * stride + col + side];
                self.across[row * width + col] = window.iter().map(|&c| u32::from(c)).sum();
            }
        }
        for row in 0..height {
            for col in 0..width {
                let sum: u32 = (row..row + side).map(|r| self.across[r * width + col]).sum();
                self.cost[row * width + col] = (sum / (side * side) as u32) as u8;
            }
        }
    }
}
