//! A grid over points of a plane: the points sorted by cell, row of cells after row of cells (a bucket sort).

use crate::binning::{CellSpan, RowBins, cell_starts, split_rows};
use glam::Vec2;
use rayon::prelude::*;
use std::ops::Range;

/// Cells per point, at most: an outlier must not make the grid as large as its distance.
const CELLS_PER_POINT: f32 = 8.0;
/// Points per parallel job.
const CHUNK: usize = 4096;
/// Cells along either side, at most; they are numbered with 16 bits.
const SIDE_MAX: f32 = 30_000.0;

/// A grid, and the places of each cell's points in the sorted order.
pub(super) struct Cells {
    corner: Vec2,
    inverse_cell: Vec2,
    columns: usize,
    rows: usize,
    /// `starts[cell]..starts[cell + 1]` is the part of the sorted points in a cell.
    starts: Vec<u32>,
}

impl Cells {
    /// Sorts `points` into cells of about `cell_size` metres; returns the grid, and the indices of the points in the
    /// order of their cells.
    pub(super) fn sort(points: &[Vec2], cell_size: Vec2) -> (Self, Vec<u32>) {
        let nothing = || (Vec2::INFINITY, Vec2::NEG_INFINITY);
        let parts = points.par_chunks(CHUNK).map(|part| {
            let finite = part.iter().filter(|point| point.is_finite());
            finite.fold(nothing(), |(low, high), &point| (low.min(point), high.max(point)))
        });
        let (mut low, mut high) = parts.reduce(nothing, |a, b| (a.0.min(b.0), a.1.max(b.1)));
        if low.x > high.x {
            (low, high) = (Vec2::ZERO, Vec2::ZERO);
        }
        let extent = high - low;
        let mut cell_size = cell_size.max(extent / SIDE_MAX).max(Vec2::splat(1e-6));
        let most = CELLS_PER_POINT * points.len() as f32 + 1024.0;
        let cells = (extent.x / cell_size.x + 1.0) * (extent.y / cell_size.y + 1.0);
        if cells > most {
            cell_size *= (cells / most).sqrt().max(cells / most * 1e-3);
        }
        let mut grid = Self {
            corner: low,
            inverse_cell: cell_size.recip(),
            columns: (extent.x / cell_size.x) as usize + 1,
            rows: (extent.y / cell_size.y) as usize + 1,
            starts: Vec::new(),
        };
        let order = grid.bin(points);
        (grid, order)
    }

    fn bin(&mut self, points: &[Vec2]) -> Vec<u32> {
        let spans: Vec<CellSpan> = points
            .par_iter()
            .with_min_len(CHUNK)
            .map(|point| {
                let (column, row) = (self.column(point.x) as u16, self.row(point.y) as u16);
                CellSpan {
                    columns: (column, column + 1),
                    rows: (row, row + 1),
                }
            })
            .collect();
        let places = RowBins::new(&spans, self.rows, |place| place as u32);
        let span = |place: u32| spans[place as usize];
        let row_starts = (0..self.rows)
            .into_par_iter()
            .map(|row| cell_starts(places.row(row), span, self.columns))
            .collect();
        let mut order = Vec::new();
        let (starts, row_lists) = split_rows(row_starts, &mut order);
        row_lists.into_par_iter().for_each(|mut cells| {
            for &place in places.row(cells.row).flatten() {
                let next = &mut cells.starts[usize::from(span(place).columns.0)];
                cells.list[*next as usize] = place;
                *next += 1;
            }
        });
        self.starts = starts;
        order
    }

    #[inline(always)]
    fn column(&self, x: f32) -> usize {
        let at = (x - self.corner.x) * self.inverse_cell.x;
        (at.max(0.0) as usize).min(self.columns - 1)
    }

    #[inline(always)]
    fn row(&self, y: f32) -> usize {
        let at = (y - self.corner.y) * self.inverse_cell.y;
        (at.max(0.0) as usize).min(self.rows - 1)
    }

    /// The cells that the box from `low` to `high` touches, for [`Self::run`] row by row.
    #[inline(always)]
    pub(super) fn window(&self, low: Vec2, high: Vec2) -> CellRange {
        CellRange {
            columns: self.column(low.x)..self.column(high.x) + 1,
            rows: self.row(low.y)..self.row(high.y) + 1,
        }
    }

    /// Range of the sorted points in the columns of `window` and its row `row`.
    #[inline(always)]
    pub(super) fn run(&self, window: &CellRange, row: usize) -> Range<usize> {
        let first = row * self.columns;
        self.starts[first + window.columns.start] as usize..self.starts[first + window.columns.end] as usize
    }
}

/// A block of neighbouring columns and rows of cells.
pub(super) struct CellRange {
    columns: Range<usize>,
    /// Rows of the block.
    pub(super) rows: Range<usize>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> Vec<Vec2> {
        let h = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1000) as f32 / 10.0;
        (0..3000).map(|i| Vec2::new(h(i, 1), h(i * 3, 2) - 40.0)).collect()
    }

    #[test]
    fn a_window_holds_every_point_of_its_box_once() {
        let points = points();
        let (cells, order) = Cells::sort(&points, Vec2::new(0.7, 2.9));
        for (low, high) in [
            (Vec2::new(10.0, -20.0), Vec2::new(14.0, 3.0)),
            (Vec2::new(-99.0, -99.0), Vec2::new(999.0, 999.0)),
            (Vec2::new(50.0, 50.0), Vec2::new(50.0, 50.0)),
        ] {
            let window = cells.window(low, high);
            let mut found: Vec<u32> = window
                .rows
                .clone()
                .flat_map(|row| order[cells.run(&window, row)].to_vec())
                .filter(|&p| points[p as usize].cmpge(low).all() && points[p as usize].cmple(high).all())
                .collect();
            found.sort_unstable();
            let expected: Vec<u32> = (0..points.len() as u32)
                .filter(|&p| points[p as usize].cmpge(low).all() && points[p as usize].cmple(high).all())
                .collect();
            assert_eq!(found, expected);
        }
    }

    #[test]
    fn a_point_far_away_does_not_make_the_grid_large() {
        let mut points = points();
        points.push(Vec2::splat(1e7));
        points.push(Vec2::NAN);
        let (cells, order) = Cells::sort(&points, Vec2::splat(0.01));
        assert!(cells.columns * cells.rows < 20 * points.len());
        assert_eq!(order.len(), points.len());
    }

    #[test]
    fn no_points_make_an_empty_grid() {
        let (cells, order) = Cells::sort(&[], Vec2::ONE);
        let window = cells.window(Vec2::ZERO, Vec2::ONE);
        assert!(order.is_empty() && window.rows.clone().all(|row| cells.run(&window, row).is_empty()));
    }
}
