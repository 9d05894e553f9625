//! Binning of splats to tiles: per tile a list of its splats, front to back.
//!
//! Chunks of splats are binned to rows of tiles; each row of tiles sorts its splats by depth and bins them to its tiles
//! in that order. Every stage runs in parallel, on memory that fits a cache, and gives the same lists for any number of
//! threads.

use super::project::Splat;
use crate::binning::{CellSpan, RowBins, RowList, cell_starts, split_rows};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Columns of a tile, pixels. Wide tiles: fewer splats lie in two, and a row stays in few lines of the cache.
pub const TILE_WIDTH: usize = 32;
/// Rows of a tile, pixels.
pub const TILE_HEIGHT: usize = 16;

/// Lists of the splats of each tile, front to back; splats of equal depth are in the order of their indices.
#[derive(Debug, Clone, Default)]
pub struct Bins {
    /// Number of tiles in a row of tiles.
    pub columns: usize,
    /// Number of rows of tiles.
    pub rows: usize,
    /// `starts[t]..starts[t + 1]` is the part of `list` of tile `t`.
    pub starts: Vec<u32>,
    /// Splats, tile after tile, and front to back within a tile.
    pub list: Vec<Entry>,
    /// `slot_starts[s]..slot_starts[s + 1]` is the part of `slots` of splat `s`.
    pub slot_starts: Vec<u32>,
    /// Gradient records, splat after splat.
    pub slots: Vec<u32>,
}

/// Entry of a splat in the list of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Entry {
    /// Index of the splat.
    pub splat: u32,
    /// Index of the gradient record that the tile writes for this splat. Records lie tile after tile, and within a tile
    /// by index of the splat, so that neighbours in the table of splats are neighbours in memory.
    pub record: u32,
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

fn span(splat: &Splat, columns: usize, rows: usize) -> CellSpan {
    CellSpan {
        columns: tile_span(splat.col, splat.half[0], TILE_WIDTH, columns),
        rows: tile_span(splat.row, splat.half[1], TILE_HEIGHT, rows),
    }
}

fn width(span: &CellSpan) -> u32 {
    u32::from(span.columns.1) - u32::from(span.columns.0)
}

fn tiles(span: &CellSpan) -> u32 {
    width(span) * (u32::from(span.rows.1) - u32::from(span.rows.0))
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

/// Inputs of binning, and the record indices of each splat that it writes.
struct Binning<'a> {
    spans: &'a [CellSpan],
    /// Sort keys: depth in the upper half, splat in the lower.
    keys: RowBins<u64>,
    slot_starts: &'a [u32],
    /// Every slot is written once, so the order of threads does not matter.
    slots: &'a [AtomicU32],
}

impl Binning<'_> {
    fn span(&self, key: u64) -> &CellSpan {
        &self.spans[key as u32 as usize]
    }

    fn starts(&self, row: usize, columns: usize) -> Vec<u32> {
        cell_starts(self.keys.row(row), |key| *self.span(key), columns)
    }

    /// The slots of a splat in a row of tiles.
    fn slots(&self, key: u64, row: usize) -> &[AtomicU32] {
        let span = self.span(key);
        let above = row as u32 - u32::from(span.rows.0);
        let first = (self.slot_starts[key as u32 as usize] + above * width(span)) as usize;
        &self.slots[first..first + width(span) as usize]
    }

    /// Fills a row's list: records in the order of indices, then the list in the order of depths.
    fn fill(&self, tiles: RowList<Entry>) {
        let mut keys = self.keys.row(tiles.row).collect::<Vec<_>>().concat();
        let mut cursor = tiles.starts.clone();
        for &key in &keys {
            let places = cursor[self.span(key).columns()].iter_mut();
            for (place, slot) in places.zip(self.slots(key, tiles.row)) {
                slot.store(tiles.base + *place, Ordering::Relaxed);
                *place += 1;
            }
        }
        sort_by_upper_half(&mut keys);
        cursor = tiles.starts;
        for key in keys {
            let places = cursor[self.span(key).columns()].iter_mut();
            for (place, slot) in places.zip(self.slots(key, tiles.row)) {
                tiles.list[*place as usize] = Entry {
                    splat: key as u32,
                    record: slot.load(Ordering::Relaxed),
                };
                *place += 1;
            }
        }
    }
}

impl Bins {
    /// Lists `splats` for an image of `width × height` pixels.
    pub fn new(splats: &[Splat], width: usize, height: usize) -> Self {
        let (columns, rows) = (width.div_ceil(TILE_WIDTH), height.div_ceil(TILE_HEIGHT));
        let spans: Vec<CellSpan> = splats
            .par_iter()
            .with_min_len(4096)
            .map(|splat| span(splat, columns, rows))
            .collect();
        let mut slot_starts = Vec::with_capacity(splats.len() + 1);
        slot_starts.push(0);
        let mut total = 0;
        slot_starts.extend(spans.iter().map(|span| {
            total += tiles(span);
            total
        }));
        let empty = (0..total).into_par_iter().with_min_len(4096);
        let slots: Vec<AtomicU32> = empty.map(|_| AtomicU32::new(0)).collect();
        let key = |s: usize| u64::from(ordered_bits(splats[s].depth)) << 32 | s as u64;
        let binning = Binning {
            spans: &spans,
            keys: RowBins::new(&spans, rows, key),
            slot_starts: &slot_starts,
            slots: &slots,
        };
        let row_starts = (0..rows)
            .into_par_iter()
            .map(|row| binning.starts(row, columns))
            .collect();
        let mut list = Vec::new();
        let (starts, row_lists) = split_rows(row_starts, &mut list);
        row_lists
            .into_par_iter()
            .with_max_len(1)
            .for_each(|tiles| binning.fill(tiles));
        Self {
            columns,
            rows,
            starts,
            list,
            slots: slots.into_iter().map(AtomicU32::into_inner).collect(),
            slot_starts,
        }
    }

    /// Entries of the splats of a tile, front to back.
    pub fn tile(&self, tile: usize) -> &[Entry] {
        &self.list[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }

    /// Indices of the gradient records of a splat.
    pub fn slots_of(&self, splat: usize) -> &[u32] {
        &self.slots[self.slot_starts[splat] as usize..self.slot_starts[splat + 1] as usize]
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

    fn listed(bins: &Bins, tile: usize) -> Vec<u32> {
        bins.tile(tile).iter().map(|entry| entry.splat).collect()
    }

    #[test]
    fn tiles_list_their_splats_front_to_back() {
        let splats = [
            splat(8.0, 8.0, 3.0, 2.0),
            splat(9.0, 8.0, -5.0, 2.0),
            splat(31.5, 8.0, 1.0, 2.0),
        ];
        let bins = Bins::new(&splats, 60, 20);
        assert_eq!(listed(&bins, 0), &[1, 2, 0]);
        assert_eq!(listed(&bins, 1), &[2]);
        assert!(bins.tile(2).is_empty() && bins.tile(3).is_empty());
    }

    #[test]
    fn the_slots_of_a_splat_are_its_records() {
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
        let mut splat_of_record = vec![u32::MAX; bins.list.len()];
        for tile in 0..bins.tiles() {
            for entry in bins.tile(tile) {
                assert!((bins.starts[tile]..bins.starts[tile + 1]).contains(&entry.record));
                splat_of_record[entry.record as usize] = entry.splat;
            }
        }
        for s in 0..splats.len() {
            for &record in &bins.slots[bins.slot_starts[s] as usize..bins.slot_starts[s + 1] as usize] {
                assert_eq!(splat_of_record[record as usize], s as u32);
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
            assert_eq!(listed(&bins, tile), expected);
        }
    }
}
