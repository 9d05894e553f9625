//! The ground grid: rows of cells from north to south, columns from west to east; and minimum filters over its cells.

use glam::Vec3;
use rayon::prelude::*;

/// Cells that one thread works on at a time, at least.
const CELLS_PER_JOB: usize = 1024;

/// Indices of `cells` cells, as a parallel iterator.
pub fn in_parallel(cells: usize) -> impl IndexedParallelIterator<Item = usize> {
    (0..cells).into_par_iter().with_min_len(CELLS_PER_JOB)
}

/// Grid of square ground cells. Row 0 is the northernmost; cell `(col, row)` has the index `row * width + col`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Outer western edge, metres.
    pub west_m: f32,
    /// Outer northern edge, metres.
    pub north_m: f32,
    /// Side of a cell, metres.
    pub cell_m: f32,
}

impl Grid {
    /// Grid of 1 m cells whose north-western corner is the origin.
    pub fn plain(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            west_m: 0.0,
            north_m: 0.0,
            cell_m: 1.0,
        }
    }

    /// The number of cells.
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// Indices of all cells, as a parallel iterator.
    pub fn cells(&self) -> impl IndexedParallelIterator<Item = usize> {
        in_parallel(self.len())
    }

    /// Cells around a cell, as [`around`].
    pub fn around(&self, cell: usize, radius: usize) -> impl Iterator<Item = usize> + use<> {
        around((self.width, self.height), cell, radius)
    }

    /// Centre of the cell at a column and a row, with an altitude as third coordinate, metres; cells outside the grid
    /// are allowed.
    pub fn point(&self, col: isize, row: isize, altitude_m: f32) -> Vec3 {
        Vec3::new(
            self.west_m + (col as f32 + 0.5) * self.cell_m,
            self.north_m - (row as f32 + 0.5) * self.cell_m,
            altitude_m,
        )
    }

    /// Grid over the same ground with cells `factor` times as wide; its last column and row may reach beyond the edge.
    pub fn coarser(&self, factor: usize) -> Self {
        Self {
            width: self.width.div_ceil(factor),
            height: self.height.div_ceil(factor),
            cell_m: self.cell_m * factor as f32,
            ..*self
        }
    }

    /// Index of the cell at a ground position, metres; positions outside are clamped to the grid.
    pub fn nearest(&self, x_m: f32, y_m: f32) -> usize {
        let col = ((x_m - self.west_m) / self.cell_m).max(0.0) as usize;
        let row = ((self.north_m - y_m) / self.cell_m).max(0.0) as usize;
        row.min(self.height - 1) * self.width + col.min(self.width - 1)
    }

    /// Connected groups of the cells of a mask, as cell indices; cells that share a side or a corner are connected.
    pub fn connected(&self, mask: &[bool]) -> Vec<Vec<usize>> {
        let mut seen = vec![false; self.len()];
        let mut groups = Vec::new();
        for start in (0..self.len()).filter(|&cell| mask[cell]) {
            if std::mem::replace(&mut seen[start], true) {
                continue;
            }
            let mut group = vec![start];
            let mut next = 0;
            while let Some(&cell) = group.get(next) {
                next += 1;
                for near in self.around(cell, 1) {
                    if mask[near] && !std::mem::replace(&mut seen[near], true) {
                        group.push(near);
                    }
                }
            }
            groups.push(group);
        }
        groups
    }

    /// True if the bounding box of two ground positions, metres, lies more than a cell outside the grid.
    pub fn is_outside(&self, a: Vec3, b: Vec3) -> bool {
        let (low, high) = (a.min(b), a.max(b));
        let east_m = self.west_m + (self.width + 1) as f32 * self.cell_m;
        let south_m = self.north_m - (self.height + 1) as f32 * self.cell_m;
        high.x < self.west_m - self.cell_m || low.x > east_m || low.y > self.north_m + self.cell_m || high.y < south_m
    }

    /// True if a ground position, metres, lies on the grid.
    pub fn contains(&self, x_m: f32, y_m: f32) -> bool {
        let (col, row) = ((x_m - self.west_m) / self.cell_m, (self.north_m - y_m) / self.cell_m);
        col >= 0.0 && row >= 0.0 && col < self.width as f32 && row < self.height as f32
    }
}

/// Indices of the cells within `radius` columns and rows of a cell, the cell itself included, row by row; the window
/// ends at the edge of the grid of `(width, height)` cells.
pub fn around((width, height): (usize, usize), cell: usize, radius: usize) -> impl Iterator<Item = usize> + use<> {
    let (col, row) = (cell % width, cell / width);
    let columns = col.saturating_sub(radius)..(col + radius + 1).min(width);
    let rows = row.saturating_sub(radius)..(row + radius + 1).min(height);
    rows.flat_map(move |r| columns.clone().map(move |c| r * width + c))
}

/// Minimum filter: for each cell of a grid of `(width, height)` cells the least of `values` within `columns` columns
/// and `rows` rows on either side, first along rows, then across them. NaN is ignored; a window of NaN alone gives
/// `f32::MAX`.
pub fn lowest_within((width, height): (usize, usize), values: &[f32], [columns, rows]: [usize; 2]) -> Vec<f32> {
    let near = |at: usize, reach: usize, count: usize| at.saturating_sub(reach)..(at + reach + 1).min(count);
    let least = |values: &mut dyn Iterator<Item = f32>| values.fold(f32::MAX, f32::min);
    let across: Vec<f32> = in_parallel(width * height)
        .map(|i| least(&mut near(i % width, columns, width).map(|c| values[i / width * width + c])))
        .collect();
    in_parallel(width * height)
        .map(|i| least(&mut near(i / width, rows, height).map(|r| across[r * width + i % width])))
        .collect()
}

/// Morphological opening of altitudes, metres, on a grid of `size` (width, height): the maximum of the minima within
/// the reach (columns, rows), which removes structures narrower than twice the reach. Unknown cells (NaN) do not count
/// as ground.
pub fn opening(size: (usize, usize), up_m: &[f32], reach: [usize; 2]) -> Vec<f32> {
    let known: Vec<f32> = up_m.iter().map(|z| if z.is_nan() { f32::MAX } else { *z }).collect();
    let depths: Vec<f32> = lowest_within(size, &known, reach).iter().map(|z| -z).collect();
    lowest_within(size, &depths, reach).iter().map(|z| -z).collect()
}
