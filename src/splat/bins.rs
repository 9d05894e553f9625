//! Sorting splats front to back and listing them by tile.
//!
//! Splats are sorted once by depth (radix sort on ordered bits), then dealt to the tiles they touch in that order, so
//! that every tile's list is front to back without a sort of its own.

use super::project::Splat;

/// Side of a square tile, pixels.
pub const TILE: usize = 16;

/// Per-tile lists of splats, front to back.
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

/// Indices of `splats` by increasing depth; equal depths keep their order.
fn depth_order(splats: &[Splat]) -> Vec<u32> {
    const BITS: u32 = 11;
    const BUCKETS: usize = 1 << BITS;
    let mut from: Vec<(u32, u32)> = splats
        .iter()
        .enumerate()
        .map(|(i, s)| (ordered_bits(s.depth), i as u32))
        .collect();
    let mut to = vec![(0, 0); from.len()];
    for pass in 0..3 {
        let digit = |key: u32| (key >> (pass * BITS)) as usize & (BUCKETS - 1);
        let mut ends = vec![0usize; BUCKETS + 1];
        for &(key, _) in &from {
            ends[digit(key) + 1] += 1;
        }
        for b in 0..BUCKETS {
            ends[b + 1] += ends[b];
        }
        for &(key, index) in &from {
            let place = &mut ends[digit(key)];
            to[*place] = (key, index);
            *place += 1;
        }
        std::mem::swap(&mut from, &mut to);
    }
    from.into_iter().map(|(_, index)| index).collect()
}

/// First and one-past-last tile that `[centre - half, centre + half]` touches.
#[inline]
fn tile_span(centre: f32, half: f32, tiles: usize) -> (usize, usize) {
    let first = ((centre - half).ceil().max(0.0) as usize) / TILE;
    let last = (centre + half).floor();
    if last < 0.0 {
        return (0, 0);
    }
    (first.min(tiles), (last as usize / TILE + 1).min(tiles))
}

impl Bins {
    /// Lists `splats` for an image of `width × height` pixels.
    pub fn new(splats: &[Splat], width: usize, height: usize) -> Self {
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let spans: Vec<[u16; 4]> = splats
            .iter()
            .map(|s| {
                let (c0, c1) = tile_span(s.col, s.half[0], columns);
                let (r0, r1) = tile_span(s.row, s.half[1], rows);
                [c0 as u16, c1 as u16, r0 as u16, r1 as u16]
            })
            .collect();
        let mut starts = vec![0u32; columns * rows + 1];
        let mut slot_starts = Vec::with_capacity(splats.len() + 1);
        slot_starts.push(0);
        let mut total = 0;
        for &[c0, c1, r0, r1] in &spans {
            for r in r0 as usize..r1 as usize {
                for c in c0 as usize..c1 as usize {
                    starts[r * columns + c + 1] += 1;
                    total += 1;
                }
            }
            slot_starts.push(total);
        }
        for t in 0..columns * rows {
            starts[t + 1] += starts[t];
        }
        let mut cursor = starts.clone();
        let mut list = vec![0; total as usize];
        let mut slots = vec![0; total as usize];
        for index in depth_order(splats) {
            let [c0, c1, r0, r1] = spans[index as usize];
            let mut slot = slot_starts[index as usize] as usize;
            for r in r0 as usize..r1 as usize {
                for c in c0 as usize..c1 as usize {
                    let place = &mut cursor[r * columns + c];
                    list[*place as usize] = index;
                    slots[slot] = *place;
                    *place += 1;
                    slot += 1;
                }
            }
        }
        Self {
            columns,
            rows,
            starts,
            list,
            slot_starts,
            slots,
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
            splat(15.5, 8.0, 1.0, 2.0),
        ];
        let bins = Bins::new(&splats, 40, 20);
        assert_eq!(bins.tile(0), &[1, 2, 0]);
        assert_eq!(bins.tile(1), &[2]);
        assert!(bins.tile(2).is_empty());
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
    fn depth_order_is_total_over_signs_and_magnitudes() {
        let depths = [1e-30f32, -1e30, 0.0, -0.0, 5.0, -5.0, 1e30, -1e-30];
        let splats: Vec<Splat> = depths.iter().map(|&d| splat(0.0, 0.0, d, 1.0)).collect();
        let order = depth_order(&splats);
        for pair in order.windows(2) {
            assert!(depths[pair[0] as usize] <= depths[pair[1] as usize]);
        }
    }
}
