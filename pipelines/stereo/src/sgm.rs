//! Semi-global matching on the ground grid (Hirschmüller 2008): eight paths of dynamic programming, summed.
//!
//! Each cell has its own search range, so a path first brings the costs of the cell before it into the range of the
//! cell it enters; levels that the cell before did not search can only be reached by the large penalty. Where a guide
//! image has an edge, the large penalty shrinks, so that altitude jumps where brightness does. Sums are 16-bit
//! integers: the result does not depend on threads.

use super::ranges::SearchRanges;
use heliosplat::vectorised;
use rayon::prelude::*;

/// Cost of a level that the cell before did not search: far above all path costs, which are at most 255 plus the large
/// penalty.
const UNREACHABLE: u16 = 20_000;

/// Columns that one task takes through a row: enough work for a task.
const CHUNK: usize = 64;

/// Penalties of a change of altitude between neighbours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Penalties {
    /// P1: one height step up or down, in units of cost (0..255).
    pub(super) one_step: u16,
    /// P2: any other change where the guide shows no edge, in units of cost (0..255).
    pub(super) jump: u16,
    /// Difference of the guide image at which P2 is half, in its typical differences between neighbours.
    pub(super) edge: f32,
}

/// A cost volume to aggregate.
pub(super) struct Volume<'a> {
    /// Number of columns.
    pub(super) width: usize,
    /// Number of rows.
    pub(super) height: usize,
    /// Search range of each cell.
    pub(super) ranges: &'a SearchRanges,
    /// Matching costs, 0 to 255, in the order of `ranges`.
    pub(super) costs: &'a [u8],
    /// Guide image, one value per cell, NaN where missing; `None` without one.
    pub(super) guide: Option<&'a [f32]>,
    /// Penalties of a change of altitude between neighbours.
    pub(super) penalties: Penalties,
}

/// A path's costs at the previous cell, and the least of them.
struct Cell<'a> {
    low: usize,
    costs: &'a [u16],
    least: u16,
}

impl Volume<'_> {
    /// Sums of the eight path costs, in the order of the search ranges.
    pub(super) fn aggregate(&self) -> Vec<u16> {
        let mut sums = vec![0; self.ranges.total()];
        self.along_rows(&mut sums);
        self.across_rows(&mut sums, false);
        self.across_rows(&mut sums, true);
        sums
    }

    /// P2 between two cells; always more than P1.
    fn jump(&self, from: usize, to: usize) -> u16 {
        let Penalties { one_step, jump, edge } = self.penalties;
        let difference = self.guide.map_or(0.0, |guide| (guide[from] - guide[to]).abs());
        // A missing guide value (NaN) is no edge.
        let difference = if difference.is_finite() { difference } else { 0.0 };
        ((f32::from(jump) / (1.0 + difference / edge)) as u16).max(one_step + one_step / 2 + 1)
    }

    /// East and west paths: rows do not touch each other.
    fn along_rows(&self, sums: &mut [u16]) {
        let rows = split_by(sums, (0..self.height).map(|row| self.row_values(row).len()));
        rows.into_par_iter().enumerate().for_each(|(row, sums)| {
            let start = self.row_values(row).start;
            let mut path = (vec![0; sums.len()], vec![0; self.width]);
            let mut aligned = Vec::new();
            for backward in [false, true] {
                for step in 0..self.width {
                    let col = if backward { self.width - 1 - step } else { step };
                    let cell = row * self.width + col;
                    let before = (step > 0).then(|| if backward { cell + 1 } else { cell - 1 });
                    let range = self.ranges.start[cell] - start..self.ranges.start[cell + 1] - start;
                    let (left, right) = path.0.split_at_mut(if backward { range.end } else { range.start });
                    let (done, done_from, here) = if backward {
                        (right, range.end, &mut left[range.start..])
                    } else {
                        (left, 0, &mut right[..range.end - range.start])
                    };
                    let previous = before.map(|b| Cell {
                        low: usize::from(self.ranges.low[b]),
                        costs: &done
                            [self.ranges.start[b] - start - done_from..self.ranges.start[b + 1] - start - done_from],
                        least: path.1[b % self.width],
                    });
                    let jump = before.map_or(0, |b| self.jump(b, cell));
                    path.1[col] = self.step(cell, previous, jump, &mut aligned, here);
                    add(&mut sums[range], here);
                }
            }
        });
    }

    /// The three paths that enter from the row above (or below): rows in turn, chunks of columns side by side.
    fn across_rows(&self, sums: &mut [u16], upward: bool) {
        let mut before: [PathRow; 3] = Default::default();
        let mut here: [PathRow; 3] = Default::default();
        for step in 0..self.height {
            let row = if upward { self.height - 1 - step } else { step };
            let previous_row = (step > 0).then(|| if upward { row + 1 } else { row - 1 });
            let range = self.row_values(row);
            for path in &mut here {
                path.costs.resize(range.len(), 0);
                path.least.resize(self.width, 0);
            }
            let chunks = self.width.div_ceil(CHUNK);
            let first = |k: usize| row * self.width + (k * CHUNK).min(self.width);
            let sizes = || (0..chunks).map(|k| self.ranges.start[first(k + 1)] - self.ranges.start[first(k)]);
            let [west, straight, east] = here.each_mut().map(|path| {
                let costs = split_by(&mut path.costs, sizes());
                costs.into_iter().zip(path.least.chunks_mut(CHUNK)).collect::<Vec<_>>()
            });
            let sums = split_by(&mut sums[range], sizes());
            let work = west.into_par_iter().zip(straight).zip(east).zip(sums).enumerate();
            work.for_each(|(k, (((west, straight), east), sums))| {
                let mut aligned = Vec::new();
                for (direction, (costs, least)) in [west, straight, east].into_iter().enumerate() {
                    let entry = Entry {
                        row,
                        previous_row,
                        col0: k * CHUNK,
                        direction,
                    };
                    self.chunk(&entry, &before[direction], costs, least, &mut aligned);
                    add(sums, costs);
                }
            });
            std::mem::swap(&mut before, &mut here);
        }
    }

    /// One path through a chunk of columns.
    fn chunk(&self, entry: &Entry, before: &PathRow, costs: &mut [u16], least: &mut [u16], aligned: &mut Vec<u16>) {
        let (row, col0) = (entry.row, entry.col0);
        let chunk_start = self.ranges.start[row * self.width + col0];
        for (k, least) in least.iter_mut().enumerate() {
            let col = col0 + k;
            let cell = row * self.width + col;
            let from = entry.previous_row.and_then(|r| {
                let c = (col + entry.direction).checked_sub(1).filter(|&c| c < self.width)?;
                Some(r * self.width + c)
            });
            let previous = from.map(|b| {
                let start = self.ranges.start[b / self.width * self.width];
                Cell {
                    low: usize::from(self.ranges.low[b]),
                    costs: &before.costs[self.ranges.start[b] - start..self.ranges.start[b + 1] - start],
                    least: before.least[b % self.width],
                }
            });
            let jump = from.map_or(0, |b| self.jump(b, cell));
            let range = self.ranges.start[cell] - chunk_start..self.ranges.start[cell + 1] - chunk_start;
            *least = self.step(cell, previous, jump, aligned, &mut costs[range]);
        }
    }

    /// Path costs of one cell from those of the cell before; returns the least of them.
    fn step(&self, cell: usize, previous: Option<Cell>, jump: u16, aligned: &mut Vec<u16>, out: &mut [u16]) -> u16 {
        let costs = &self.costs[self.ranges.range(cell)];
        let Some(previous) = previous else {
            for (out, cost) in out.iter_mut().zip(costs) {
                *out = u16::from(*cost);
            }
            return out.iter().copied().min().unwrap_or(0);
        };
        // aligned[k] belongs to level low - 1 + k.
        let low = usize::from(self.ranges.low[cell]);
        aligned.clear();
        aligned.resize(costs.len() + 2, UNREACHABLE);
        let (from, to) = (
            previous.low.max(low.saturating_sub(1)),
            (previous.low + previous.costs.len()).min(low + costs.len() + 1),
        );
        if from < to {
            aligned[from + 1 - low..to + 1 - low]
                .copy_from_slice(&previous.costs[from - previous.low..to - previous.low]);
        }
        recurse(costs, aligned, previous.least, self.penalties.one_step, jump, out)
    }

    fn row_values(&self, row: usize) -> std::ops::Range<usize> {
        self.ranges.start[row * self.width]..self.ranges.start[(row + 1) * self.width]
    }
}

/// Entry of a path into a row.
struct Entry {
    row: usize,
    previous_row: Option<usize>,
    col0: usize,
    /// 0, 1, 2: from the west, straight, from the east.
    direction: usize,
}

/// One row of one path.
#[derive(Default)]
struct PathRow {
    costs: Vec<u16>,
    least: Vec<u16>,
}

fn split_by(mut values: &mut [u16], sizes: impl Iterator<Item = usize>) -> Vec<&mut [u16]> {
    sizes
        .map(|size| {
            let (head, tail) = std::mem::take(&mut values).split_at_mut(size);
            values = tail;
            head
        })
        .collect()
}

vectorised! {
    fn add(sums: &mut [u16], costs: &[u16]) {
        for (sum, cost) in sums.iter_mut().zip(costs) {
            *sum += cost;
        }
    }
}

vectorised! {
    /// `out[d] = costs[d] + min(before[d], before[d ± 1] + one, least + jump) - least`, where `before` begins one level
    /// lower than `costs`; returns the least of `out`.
    fn recurse(costs: &[u8], before: &[u16], least: u16, one: u16, jump: u16, out: &mut [u16]) -> u16 {
        let n = costs.len().min(out.len());
        let (below, same, above) = (&before[..n], &before[1..n + 1], &before[2..n + 2]);
        let mut smallest = u16::MAX;
        for d in 0..n {
            let near = same[d].min(below[d].min(above[d]) + one).min(least + jump);
            let value = u16::from(costs[d]) + near - least;
            out[d] = value;
            smallest = smallest.min(value);
        }
        smallest
    }
}
