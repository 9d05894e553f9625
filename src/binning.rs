//! Binning: boxes sorted into the cells of a grid that they touch, in parallel and always in the same order.
//!
//! Two passes of a bucket sort. First, chunks of boxes are sorted by the rows of cells they touch, every chunk on its
//! own ([`RowBins`]). Then every row of cells reads its boxes from all chunks, in their order, and sorts them by column
//! ([`cell_starts`], [`split_rows`]). Tiles of the rasteriser and grids of the tracer are binned with it.

use crate::parallel::set_defaults;
use rayon::prelude::*;

/// Boxes per parallel job.
const CHUNK: usize = 4096;

/// The cells that a box touches: first and one past last column and row.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CellSpan {
    /// First and one past last column.
    pub(crate) columns: (u16, u16),
    /// First and one past last row.
    pub(crate) rows: (u16, u16),
}

impl CellSpan {
    /// The columns, as a range.
    pub(crate) fn columns(&self) -> std::ops::Range<usize> {
        usize::from(self.columns.0)..usize::from(self.columns.1)
    }

    fn rows(&self) -> std::ops::Range<usize> {
        usize::from(self.rows.0)..usize::from(self.rows.1)
    }
}

/// The boxes that touch each row of a grid, chunk by chunk.
pub(crate) struct RowBins<T> {
    chunks: Vec<Chunk<T>>,
}

struct Chunk<T> {
    /// `starts[r]..starts[r + 1]` is the part of `items` of row `r`.
    starts: Vec<u32>,
    items: Vec<T>,
}

impl<T: Copy + Default + Send + Sync> RowBins<T> {
    /// Bins boxes, one for each of `spans`, to `rows` rows of cells; `item` makes the entry of a box from its index.
    pub(crate) fn new(spans: &[CellSpan], rows: usize, item: impl Fn(usize) -> T + Sync) -> Self {
        let chunks = spans
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(number, spans)| Chunk::new(spans, rows, |offset| item(number * CHUNK + offset)))
            .collect();
        Self { chunks }
    }

    /// Entries of the boxes that touch a row, in the order of the boxes, one slice per chunk.
    pub(crate) fn row(&self, row: usize) -> impl Iterator<Item = &[T]> {
        self.chunks.iter().map(move |chunk| chunk.row(row))
    }
}

impl<T: Copy + Default> Chunk<T> {
    fn new(spans: &[CellSpan], rows: usize, item: impl Fn(usize) -> T) -> Self {
        let mut starts = vec![0u32; rows + 1];
        for span in spans {
            starts[1..][span.rows()].iter_mut().for_each(|count| *count += 1);
        }
        for row in 0..rows {
            starts[row + 1] += starts[row];
        }
        let mut cursor = starts.clone();
        let mut items = vec![T::default(); starts[rows] as usize];
        for (offset, span) in spans.iter().enumerate() {
            let item = item(offset);
            for place in &mut cursor[span.rows()] {
                items[*place as usize] = item;
                *place += 1;
            }
        }
        Self { starts, items }
    }

    fn row(&self, row: usize) -> &[T] {
        &self.items[self.starts[row] as usize..self.starts[row + 1] as usize]
    }
}

/// Start of each of the row's `columns` cells in the row's list, and the end of the last: prefix sums of the counts.
/// `row` has the entries of the row, and `span` finds the cells of an entry.
pub(crate) fn cell_starts<'t, T: Copy + 't>(
    row: impl Iterator<Item = &'t [T]>,
    span: impl Fn(T) -> CellSpan,
    columns: usize,
) -> Vec<u32> {
    let mut starts = vec![0u32; columns + 1];
    for items in row {
        for &item in items {
            for count in &mut starts[1..][span(item).columns()] {
                *count += 1;
            }
        }
    }
    for column in 0..columns {
        starts[column + 1] += starts[column];
    }
    starts
}

/// A row of cells, and its part of the list of all cells.
pub(crate) struct RowList<'l, T> {
    /// Number of the row.
    pub(crate) row: usize,
    /// Starts of the row's cells in `list`, and the end of the last.
    pub(crate) starts: Vec<u32>,
    /// Start of `list` in the list of all cells.
    pub(crate) base: u32,
    /// Entries of the row, cell after cell.
    pub(crate) list: &'l mut [T],
}

/// Splits `list`, resized to hold all cells, into rows; `row_starts` are those of [`cell_starts`], row by row. Returns
/// the start of every cell in the list, with the end of the list last, and the rows.
pub(crate) fn split_rows<T: Default + Send>(
    row_starts: Vec<Vec<u32>>,
    list: &mut Vec<T>,
) -> (Vec<u32>, Vec<RowList<'_, T>>) {
    let ends = |starts: &Vec<u32>| starts.last().copied().unwrap_or(0);
    let length: usize = row_starts.iter().map(|starts| ends(starts) as usize).sum();
    set_defaults(list, length);
    let (mut base, mut left) = (0, list.as_mut_slice());
    let mut starts = vec![0];
    let mut rows = Vec::with_capacity(row_starts.len());
    for (row, row_starts) in row_starts.into_iter().enumerate() {
        let length = ends(&row_starts);
        starts.extend(row_starts[1..].iter().map(|end| base + end));
        let (list, remaining) = left.split_at_mut(length as usize);
        rows.push(RowList {
            row,
            starts: row_starts,
            base,
            list,
        });
        base += length;
        left = remaining;
    }
    (starts, rows)
}
