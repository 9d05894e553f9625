//! The ground grid: cells in rows from north to south, columns from west to east.

use glam::Vec3;
use rayon::prelude::*;

/// Cells that one thread works on at a time, at least.
const CELLS_PER_JOB: usize = 1024;

/// The indices of `cells` cells, on all threads.
fn in_parallel(cells: usize) -> impl IndexedParallelIterator<Item = usize> {
    (0..cells).into_par_iter().with_min_len(CELLS_PER_JOB)
}

/// Cells of a ground grid; row 0 is the northern one, `west_m` and `north_m` are the grid's outer edges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Western edge, metres.
    pub west_m: f32,
    /// Northern edge, metres.
    pub north_m: f32,
    /// Side of a cell, metres.
    pub cell_m: f32,
}

impl Grid {
    /// Cells of a metre whose north-western corner is the origin.
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

    /// All cells, on all threads.
    pub fn cells(&self) -> impl IndexedParallelIterator<Item = usize> {
        in_parallel(self.len())
    }

    /// Cells of a square window, the centre among them.
    pub fn around(&self, cell: usize, radius: usize) -> impl Iterator<Item = usize> + use<> {
        let (col, row, width) = (cell % self.width, cell / self.width, self.width);
        let columns = col.saturating_sub(radius)..(col + radius + 1).min(width);
        let rows = row.saturating_sub(radius)..(row + radius + 1).min(self.height);
        rows.flat_map(move |r| columns.clone().map(move |c| r * width + c))
    }

    /// The centre of a cell at an altitude, metres; cells outside the grid are allowed.
    pub fn point(&self, col: isize, row: isize, altitude_m: f32) -> Vec3 {
        Vec3::new(
            self.west_m + (col as f32 + 0.5) * self.cell_m,
            self.north_m - (row as f32 + 0.5) * self.cell_m,
            altitude_m,
        )
    }

    /// The same ground in cells `factor` times as wide; the last column and row may reach beyond the edge.
    pub fn coarser(&self, factor: usize) -> Self {
        Self {
            width: self.width.div_ceil(factor),
            height: self.height.div_ceil(factor),
            cell_m: self.cell_m * factor as f32,
            ..*self
        }
    }

    /// The nearest cell of a ground position, held inside the grid.
    pub fn nearest(&self, x_m: f32, y_m: f32) -> usize {
        let col = ((x_m - self.west_m) / self.cell_m).max(0.0) as usize;
        let row = ((self.north_m - y_m) / self.cell_m).max(0.0) as usize;
        row.min(self.height - 1) * self.width + col.min(self.width - 1)
    }

    /// The connected groups of the cells of a mask, by their sides and corners.
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

    /// True if the box of two ground positions lies outside the grid, at least a cell away from it.
    pub fn is_outside(&self, a: Vec3, b: Vec3) -> bool {
        let (low, high) = (a.min(b), a.max(b));
        let east_m = self.west_m + (self.width + 1) as f32 * self.cell_m;
        let south_m = self.north_m - (self.height + 1) as f32 * self.cell_m;
        high.x < self.west_m - self.cell_m || low.x > east_m || low.y > self.north_m + self.cell_m || high.y < south_m
    }

    /// True if a ground position lies on the grid.
    pub fn contains(&self, x_m: f32, y_m: f32) -> bool {
        let (col, row) = ((x_m - self.west_m) / self.cell_m, (self.north_m - y_m) / self.cell_m);
        col >= 0.0 && row >= 0.0 && col < self.width as f32 && row < self.height as f32
    }
}

/// The minimum of `values` within `columns` and `rows` each way of each cell of a grid of `(width, height)`: first
/// along rows, then across them.
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

/// Altitudes without structures narrower than twice the reach (columns, rows): a morphological opening, the maximum of
/// the minima. Unknown cells (NaN) do not count as ground.
pub fn opening(size: (usize, usize), up_m: &[f32], reach: [usize; 2]) -> Vec<f32> {
    let known: Vec<f32> = up_m.iter().map(|z| if z.is_nan() { f32::MAX } else { *z }).collect();
    let depths: Vec<f32> = lowest_within(size, &known, reach).iter().map(|z| -z).collect();
    lowest_within(size, &depths, reach).iter().map(|z| -z).collect()
}
