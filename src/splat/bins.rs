//! Listing splats by tile, front to back.
//!
//! Chunks of splats are dealt to rows of tiles; each row of tiles sorts its splats by depth and deals them to its tiles in
//! that order. Every stage runs in parallel, on memory that fits a cache, and gives the same lists for any number of threads.

use super::project::Splat;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Columns of a tile, pixels. Wide tiles: fewer splats lie in two, and a row stays in few lines of the cache.
pub const TILE_WIDTH: usize = 32;
/// Rows of a tile, pixels.
pub const TILE_HEIGHT: usize = 16;
/// Splats per parallel job.
const CHUNK: usize = 4096;

/// Per-tile lists of splats, front to back; equal depths in the order of their splats.
#[derive(Debug, Clone, Default)]
pub struct Bins {
    /// Tiles per row of tiles.
    pub columns: usize,
    /// Rows of tiles.
    pub rows: usize,
    /// `starts[t]..starts[t + 1]` is the part of `list` of tile `t`.
    pub starts: Vec<u32>,
    /// Splat indices, tile after tile, front to back within a tile.
    pub list: Vec<u32>,
    /// `slot_starts[s]..slot_starts[s + 1]` is the part of `slots` of splat `s`.
    pub slot_starts: Vec<u32>,
    /// Where in `list` each splat stands: its own places, one after another.
    pub slots: Vec<u32>,
}

/// Bits of a finite `f32` whose unsigned order is the order of the numbers.
#[inline]
fn ordered_bits(x: f32) -> u32 {
    let bits = x.to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 0x8000_0000 }
}

/// Sorts keys by their upper halves, keeping the order of equals: by bytes, least significant first.
fn sort_by_upper_half(keys: &mut Vec<u64>) {
    const BYTES: usize = 4;
    let byte = |key: u64, pass: usize| (key >> (32 + 8 * pass)) as usize & 0xff;
    let mut places = [[0u32; 256]; BYTES];
    for &key in keys.iter() {
        for (pass, counts) in places.iter_mut().enumerate() {
            counts[byte(key, pass)] += 1;
        }
    }
    let mut sorted = vec![0u64; keys.len()];
    for (pass, places) in places.iter_mut().enumerate() {
        let mut sum = 0;
        for place in places.iter_mut() {
            sum += std::mem::replace(place, sum);
        }
        for &key in keys.iter() {
            let place = &mut places[byte(key, pass)];
            sorted[*place as usize] = key;
            *place += 1;
        }
        std::mem::swap(keys, &mut sorted);
    }
}

/// The tiles that a splat touches: first and one past last column and row.
#[derive(Debug, Clone, Copy)]
struct Span {
    columns: (u16, u16),
    rows: (u16, u16),
}

impl Span {
    fn new(splat: &Splat, columns: usize, rows: usize) -> Self {
        Self {
            columns: tile_span(splat.col, splat.half[0], TILE_WIDTH, columns),
            rows: tile_span(splat.row, splat.half[1], TILE_HEIGHT, rows),
        }
    }

    fn width(&self) -> u32 {
        u32::from(self.columns.1) - u32::from(self.columns.0)
    }

    fn tiles(&self) -> u32 {
        self.width() * (u32::from(self.rows.1) - u32::from(self.rows.0))
    }

    /// Which of the splat's own slots belongs to a tile.
    fn slot(&self, column: usize, row: usize) -> u32 {
        (row as u32 - u32::from(self.rows.0)) * self.width() + column as u32 - u32::from(self.columns.0)
    }
}

/// First and one-past-last tile of `size` pixels that `[centre - half, centre + half]` touches.
#[inline]
fn tile_span(centre: f32, half: f32, size: usize, tiles: usize) -> (u16, u16) {
    let first = ((centre - half).ceil().max(0.0) as usize / size).min(tiles);
    let last = (centre + half).floor();
    let end = if last < 0.0 {
        0
    } else {
        (last as usize / size + 1).min(tiles)
    };
    (first as u16, end.max(first) as u16)
}

/// The splats of a chunk by the rows of tiles that they touch.
struct Chunk {
    /// `starts[r]..starts[r + 1]` is the part of `splats` of row `r`.
    starts: Vec<u32>,
    /// Depth above, splat below: what is sorted.
    keys: Vec<u64>,
}

impl Chunk {
    /// Deals `splats`, of which `first` is the index of the first in the list of all.
    fn new(splats: &[Splat], spans: &[Span], first: usize, rows: usize) -> Self {
        let touched = |span: &Span| usize::from(span.rows.0)..usize::from(span.rows.1);
        let mut starts = vec![0u32; rows + 1];
        for span in spans {
            touched(span).for_each(|row| starts[row + 1] += 1);
        }
        for row in 0..rows {
            starts[row + 1] += starts[row];
        }
        let mut cursor = starts.clone();
        let mut keys = vec![0; starts[rows] as usize];
        for (offset, (span, splat)) in spans.iter().zip(splats).enumerate() {
            let key = u64::from(ordered_bits(splat.depth)) << 32 | (first + offset) as u64;
            for row in touched(span) {
                keys[cursor[row] as usize] = key;
                cursor[row] += 1;
            }
        }
        Self { starts, keys }
    }

    fn row(&self, row: usize) -> &[u64] {
        &self.keys[self.starts[row] as usize..self.starts[row + 1] as usize]
    }
}

/// What dealing a row of tiles reads and where it notes the places of splats.
struct Deal<'a> {
    spans: &'a [Span],
    chunks: &'a [Chunk],
    columns: usize,
    slot_starts: &'a [u32],
    /// Every slot is written once, so the order of threads does not matter.
    slots: &'a [AtomicU32],
}

impl Deal<'_> {
    /// Where each tile of a row begins in the row's list, and where the last ends.
    fn starts(&self, row: usize) -> Vec<u32> {
        let mut starts = vec![0u32; self.columns + 1];
        for &key in self.chunks.iter().flat_map(|chunk| chunk.row(row)) {
            let (from, to) = self.spans[key as u32 as usize].columns;
            starts[usize::from(from) + 1..=usize::from(to)]
                .iter_mut()
                .for_each(|count| *count += 1);
        }
        for column in 0..self.columns {
            starts[column + 1] += starts[column];
        }
        starts
    }

    /// Fills a row's list, which begins at `base` in the list of all.
    fn fill(&self, row: usize, starts: &[u32], base: u32, list: &mut [u32]) {
        let mut keys = self
            .chunks
            .iter()
            .map(|chunk| chunk.row(row))
            .collect::<Vec<_>>()
            .concat();
        sort_by_upper_half(&mut keys);
        let mut cursor = starts.to_vec();
        for key in keys {
            let s = key as u32;
            let span = &self.spans[s as usize];
            let (from, to) = (usize::from(span.columns.0), usize::from(span.columns.1));
            let slot = (self.slot_starts[s as usize] + span.slot(from, row)) as usize;
            for (place, slot) in cursor[from..to].iter_mut().zip(&self.slots[slot..]) {
                list[*place as usize] = s;
                slot.store(base + *place, Ordering::Relaxed);
                *place += 1;
            }
        }
    }
}

impl Bins {
    /// Lists `splats` for an image of `width × height` pixels.
    pub fn new(splats: &[Splat], width: usize, height: usize) -> Self {
        let (columns, rows) = (width.div_ceil(TILE_WIDTH), height.div_ceil(TILE_HEIGHT));
        let spans: Vec<Span> = splats
            .par_iter()
            .with_min_len(CHUNK)
            .map(|splat| Span::new(splat, columns, rows))
            .collect();
        let chunks: Vec<Chunk> = spans
            .par_chunks(CHUNK)
            .enumerate()
            .map(|(number, spans)| {
                let first = number * CHUNK;
                Chunk::new(&splats[first..first + spans.len()], spans, first, rows)
            })
            .collect();
        let mut slot_starts = Vec::with_capacity(splats.len() + 1);
        slot_starts.push(0);
        let mut total = 0;
        slot_starts.extend(spans.iter().map(|span| {
            total += span.tiles();
            total
        }));
        let slots: Vec<AtomicU32> = (0..total).map(|_| AtomicU32::new(0)).collect();
        let deal = Deal {
            spans: &spans,
            chunks: &chunks,
            columns,
            slot_starts: &slot_starts,
            slots: &slots,
        };
        let row_starts: Vec<Vec<u32>> = (0..rows).into_par_iter().map(|row| deal.starts(row)).collect();
        let mut list = vec![0; total as usize];
        let mut starts = vec![0];
        let mut jobs = Vec::with_capacity(rows);
        let (mut base, mut left) = (0, list.as_mut_slice());
        for (row, row_starts) in row_starts.iter().enumerate() {
            let (part, remaining) = left.split_at_mut(row_starts[columns] as usize);
            starts.extend(row_starts[1..].iter().map(|end| base + end));
            jobs.push((row, row_starts, base, part));
            base += row_starts[columns];
            left = remaining;
        }
        jobs.into_par_iter()
            .with_max_len(1)
            .for_each(|(row, starts, base, part)| deal.fill(row, starts, base, part));
        Self {
            columns,
            rows,
            starts,
            list,
            slots: slots.into_iter().map(AtomicU32::into_inner).collect(),
            slot_starts,
        }
    }

    /// The splats of a tile, front to back.
    pub fn tile(&self, tile: usize) -> &[u32] {
        &self.list[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }

    /// Number of tiles.
    pub fn tiles(&self) -> usize {
        self.columns * self.rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn splat(col: f32, row: f32, depth: f32, half: f32) -> Splat {
        Splat {
            col,
            row,
            depth,
            half: [half, half],
            ..Splat::default()
        }
    }

    #[test]
    fn tiles_list_their_splats_front_to_back() {
        let splats = [
            splat(8.0, 8.0, 3.0, 2.0),
            splat(9.0, 8.0, -5.0, 2.0),
            splat(31.5, 8.0, 1.0, 2.0),
        ];
        let bins = Bins::new(&splats, 60, 20);
        assert_eq!(bins.tile(0), &[1, 2, 0]);
        assert_eq!(bins.tile(1), &[2]);
        assert!(bins.tile(2).is_empty() && bins.tile(3).is_empty());
    }

    #[test]
    fn the_slots_of_a_splat_point_back_at_it() {
        let splats: Vec<Splat> = (0..50)
            .map(|i| {
                splat(
                    (i * 7 % 60) as f32,
                    (i * 13 % 40) as f32,
                    (i * 31 % 17) as f32 - 8.0,
                    9.0,
                )
            })
            .collect();
        let bins = Bins::new(&splats, 60, 40);
        for s in 0..splats.len() {
            for &place in &bins.slots[bins.slot_starts[s] as usize..bins.slot_starts[s + 1] as usize] {
                assert_eq!(bins.list[place as usize], s as u32);
            }
        }
    }

    #[test]
    fn the_order_of_bits_is_total_over_signs_and_magnitudes() {
        let depths = [-1e30f32, -5.0, -1e-30, -0.0, 0.0, 1e-30, 5.0, 1e30];
        for pair in depths.windows(2) {
            assert!(ordered_bits(pair[0]) < ordered_bits(pair[1]));
        }
    }

    #[test]
    fn every_tile_that_a_splat_touches_lists_it_once() {
        let splats: Vec<Splat> = (0..10_000u32)
            .map(|i| {
                let h = i.wrapping_mul(2_654_435_761);
                splat(
                    (h >> 8 & 0xff) as f32 - 20.0,
                    (h >> 16 & 0xff) as f32 - 20.0,
                    (h & 0xff) as f32,
                    (h >> 24) as f32 / 8.0,
                )
            })
            .collect();
        let (width, height) = (200, 180);
        let bins = Bins::new(&splats, width, height);
        assert_eq!(bins.starts.len(), bins.tiles() + 1);
        for tile in 0..bins.tiles() {
            let (column, row) = (tile % bins.columns, tile / bins.columns);
            let touches = |centre: f32, half: f32, at: usize, size: usize| {
                (centre - half).ceil() < ((at + 1) * size) as f32 && (centre + half).floor() >= (at * size) as f32
            };
            let mut expected: Vec<u32> = (0..splats.len() as u32)
                .filter(|&s| {
                    let s = &splats[s as usize];
                    touches(s.col, s.half[0], column, TILE_WIDTH) && touches(s.row, s.half[1], row, TILE_HEIGHT)
                })
                .collect();
            expected.sort_by(|&a, &b| splats[a as usize].depth.total_cmp(&splats[b as usize].depth));
            assert_eq!(bins.tile(tile), expected);
        }
    }
}
