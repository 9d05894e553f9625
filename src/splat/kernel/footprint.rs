//! Pixels of a tile that a splat covers, and its alpha there: groups of eight pixels of a row, listed before they are
//! processed.

use super::tile::{LANES, Lane, PLANE, STRIDE, TileFrame, least, most};
use crate::fast::MAGIC;
use crate::simd::prefetch;
use crate::splat::bins::{Entry, TILE_HEIGHT, TILE_WIDTH};
use crate::splat::project::Splat;
use std::f32::consts::LOG2_E;

/// Splats loaded together; after each batch the tile is checked for being opaque.
pub(super) const BATCH: usize = 16;
/// Groups of eight pixels in a tile, at most, and eight to spare, because they are written eight at once.
pub(super) const GROUPS: usize = TILE_WIDTH * TILE_HEIGHT / LANES + LANES;

/// A splat in the pixel coordinates of a tile, with its exponent to base two.
#[derive(Clone, Copy)]
pub(super) struct TileSplat<const K: usize> {
    /// Column of the centre in the tile, pixels.
    pub(super) x: f32,
    /// Row of the centre in the tile, pixels.
    pub(super) y: f32,
    /// Quadratic form of the exponent: `log2 α = (form[0]·x + form[1]·y)·x + form[2]·y² + peak`.
    pub(super) form: [f32; 3],
    /// `log2 α` at the centre, before saturation.
    pub(super) peak: f32,
    /// The lesser of `peak` and `log2` of the alpha at saturation.
    pub(super) top: f32,
    /// Shift of the ellipse's middle per row, columns.
    pub(super) shift: f32,
    /// Squared half width of the ellipse in a row, pixels²: `width_square - narrowing·y²`.
    pub(super) width_square: f32,
    /// Decrease of the squared half width per squared row.
    pub(super) narrowing: f32,
    /// Depth of the centre, metres.
    pub(super) depth: f32,
    /// Change of depth per column and per row, metres per pixel.
    pub(super) slope: [f32; 2],
    /// First and one past last row in the tile.
    pub(super) rows: (u8, u8),
    /// Channels of the splat.
    pub(super) values: [f32; K],
}

/// Groups of eight pixels of a row that a splat reaches, and the terms that are constant along the row.
pub(super) struct Groups {
    /// Place of the group's first pixel in a plane.
    pub(super) at: [u32; GROUPS],
    /// Offset of the first pixel from the splat's centre, columns.
    pub(super) x: [f32; GROUPS],
    /// Offset of the row from the centre, rows.
    pub(super) y: [f32; GROUPS],
    /// Change of the exponent per column in the row.
    pub(super) tilt: [f32; GROUPS],
    /// Exponent in the column of the centre.
    pub(super) base: [f32; GROUPS],
    /// Depth of the splat in this row, at the column of the centre, metres.
    pub(super) depth: [f32; GROUPS],
    /// Alpha of the eight pixels, zero outside the footprint.
    pub(super) alpha: [Lane; GROUPS],
    /// `1 / (1 - alpha)`, filled for the backward pass only.
    pub(super) inverse: [Lane; GROUPS],
    /// Number of groups.
    pub(super) count: usize,
}

/// The groups that begin in eight rows.
pub(super) struct EightRows {
    at: [u32; LANES],
    x: Lane,
    y: Lane,
    tilt: Lane,
    base: Lane,
    depth: Lane,
    /// Number of pixels inside the ellipse, by row.
    wide: Lane,
}

/// Converts the non-negative whole number `x` below 2²³, without the checks of a cast.
#[inline(always)]
pub(super) fn whole(x: f32) -> u32 {
    (x + 8_388_608.0).to_bits() & 0x007f_ffff
}

impl Groups {
    /// An empty list of groups.
    pub(super) fn new() -> Self {
        Self {
            at: [0; GROUPS],
            x: [0.0; GROUPS],
            y: [0.0; GROUPS],
            tilt: [0.0; GROUPS],
            base: [0.0; GROUPS],
            depth: [0.0; GROUPS],
            alpha: [[0.0; LANES]; GROUPS],
            inverse: [[0.0; LANES]; GROUPS],
            count: 0,
        }
    }

    /// Indices of the groups, known to be in bounds.
    #[inline(always)]
    pub(super) fn numbers(&self) -> std::ops::Range<usize> {
        0..self.count.min(GROUPS)
    }

    /// Place of the first pixel of group `g`, known to lie inside a plane.
    #[inline(always)]
    pub(super) fn place(&self, g: usize) -> usize {
        (self.at[g] as usize).min(PLANE - LANES)
    }

    /// Offset of pixel `l` of group `g` from the splat's centre, columns.
    #[inline(always)]
    pub(super) fn offset(&self, g: usize, l: usize) -> f32 {
        self.x[g] + l as f32
    }

    /// Adds the groups of the first `count` of eight rows where every row is one group.
    #[inline(always)]
    fn add_all(&mut self, rows: &EightRows, count: usize) {
        let to = self.count.min(GROUPS - LANES);
        self.at[to..to + LANES].copy_from_slice(&rows.at);
        self.x[to..to + LANES].copy_from_slice(&rows.x);
        self.y[to..to + LANES].copy_from_slice(&rows.y);
        self.tilt[to..to + LANES].copy_from_slice(&rows.tilt);
        self.base[to..to + LANES].copy_from_slice(&rows.base);
        self.depth[to..to + LANES].copy_from_slice(&rows.depth);
        self.count = to + count;
    }

    /// Adds the groups of one of eight rows, however many.
    #[inline(always)]
    fn add_row(&mut self, rows: &EightRows, l: usize) {
        let mut done = 0.0;
        while rows.wide[l] > done {
            let to = self.count.min(GROUPS - 1);
            self.at[to] = rows.at[l] + whole(done);
            self.x[to] = rows.x[l] + done;
            self.y[to] = rows.y[l];
            self.tilt[to] = rows.tilt[l];
            self.base[to] = rows.base[l];
            self.depth[to] = rows.depth[l];
            self.count = to + 1;
            done += LANES as f32;
        }
    }
}

impl<const K: usize> TileSplat<K> {
    /// A splat without rows, which covers nothing.
    pub(super) const NOTHING: Self = Self {
        x: 0.0,
        y: 0.0,
        form: [0.0; 3],
        peak: 0.0,
        top: 0.0,
        shift: 0.0,
        width_square: 0.0,
        narrowing: 0.0,
        depth: 0.0,
        slope: [0.0; 2],
        rows: (0, 0),
        values: [0.0; K],
    };

    /// The splat with its channels `values`, in the pixel coordinates of the tile of `frame`.
    #[inline(always)]
    pub(super) fn new(splat: &Splat, values: &[f32; K], frame: &TileFrame) -> Self {
        let [a, b, c] = splat.conic;
        let (x, y) = (splat.col - frame.col0, splat.row - frame.row0);
        let inverse = 1.0 / a;
        let shift = b * inverse;
        let first = least(most((y - splat.half[1]).ceil(), 0.0), TILE_HEIGHT as f32);
        let last = least(most((y + splat.half[1]).floor(), -1.0), frame.height as f32 - 1.0);
        // ln(α / α_min) at the centre is half the reach.
        let peak = 0.5 * LOG2_E * splat.reach + LOG2_ALPHA_MIN;
        Self {
            x,
            y,
            form: [-0.5 * LOG2_E * a, -LOG2_E * b, -0.5 * LOG2_E * c],
            peak,
            top: least(peak, LOG2_ALPHA_MAX),
            shift,
            width_square: splat.reach * inverse,
            narrowing: c * inverse - shift * shift,
            depth: splat.depth,
            slope: splat.slope,
            rows: (whole(first) as u8, whole(last + 1.0) as u8),
            values: *values,
        }
    }

    /// The ellipse in eight rows from `first` on; rows beyond its last are empty.
    #[inline(always)]
    fn eight_rows(&self, first: usize, frame: &TileFrame) -> EightRows {
        let (last_column, end) = (frame.width as f32 - 1.0, f32::from(self.rows.1));
        let mut out = EightRows {
            at: [0; LANES],
            x: [0.0; LANES],
            y: [0.0; LANES],
            tilt: [0.0; LANES],
            base: [0.0; LANES],
            depth: [0.0; LANES],
            wide: [0.0; LANES],
        };
        for l in 0..LANES {
            let row = first as f32 + l as f32;
            let y = row - self.y;
            let half = most(self.width_square - self.narrowing * y * y, 0.0).sqrt();
            let middle = self.x - self.shift * y;
            let column = least(most((middle - half).ceil(), 0.0), TILE_WIDTH as f32 - 1.0);
            let beyond = least((middle + half).floor(), last_column) + 1.0;
            let wide = most(beyond - column, 0.0);
            out.wide[l] = if row < end { wide } else { 0.0 };
            out.at[l] = whole(row * STRIDE as f32 + column);
            out.x[l] = column - self.x;
            out.y[l] = y;
            out.tilt[l] = self.form[1] * y;
            out.base[l] = self.form[2] * y * y + self.peak;
            out.depth[l] = self.depth + self.slope[1] * y;
        }
        out
    }

    /// Lists the groups of eight that the ellipse touches; adds the pixels inside the ellipse to `pixels`.
    #[inline(always)]
    pub(super) fn groups(&self, frame: &TileFrame, groups: &mut Groups, pixels: &mut Lane) {
        groups.count = 0;
        let (mut row, end) = (usize::from(self.rows.0), usize::from(self.rows.1));
        while row < end {
            let rows = self.eight_rows(row, frame);
            let count = (end - row).min(LANES);
            let mut uneven = false;
            for l in 0..LANES {
                pixels[l] += rows.wide[l];
                let empty = (rows.wide[l] <= 0.0) & ((l as f32) < count as f32);
                uneven |= empty | (rows.wide[l] > LANES as f32);
            }
            if uneven {
                for l in 0..count {
                    groups.add_row(&rows, l);
                }
            } else {
                groups.add_all(&rows, count);
            }
            row += LANES;
        }
    }

    /// Computes the alphas of the groups, and with `INVERSE` the `1 / (1 - alpha)` of the backward pass. A loop of its
    /// own over all groups, because a single group would wait for the latency of its exponential.
    #[inline(always)]
    pub(super) fn alphas<const INVERSE: bool>(&self, groups: &mut Groups) {
        for g in groups.numbers() {
            let (tilt, base) = (groups.tilt[g], groups.base[g]);
            let mut alpha = [0.0; LANES];
            for l in 0..LANES {
                let x = groups.offset(g, l);
                let order = (self.form[0] * x + tilt) * x + base;
                let inside = exp2(least(order, self.top));
                alpha[l] = if order >= LOG2_ALPHA_MIN { inside } else { 0.0 };
            }
            groups.alpha[g] = alpha;
            if INVERSE {
                for l in 0..LANES {
                    groups.inverse[g][l] = 1.0 / (1.0 - alpha[l]);
                }
            }
        }
    }
}

/// `log2` of [`ALPHA_MIN`](super::project::ALPHA_MIN).
pub(super) const LOG2_ALPHA_MIN: f32 = -7.994_353_3;
/// `log2` of [`ALPHA_MAX`](super::project::ALPHA_MAX).
pub(super) const LOG2_ALPHA_MAX: f32 = -0.014_499_57;

/// `2^x` for `-126 < x < 127`, vectorisable: the nearest integer by a magic number and a polynomial for the rest (3e-6
/// relative, minimax). Outside, the value is undefined.
#[inline(always)]
pub fn exp2(x: f32) -> f32 {
    let n = x + MAGIC;
    let f = x - (n - MAGIC);
    let square = f * f;
    // Pairs instead of one chain: the next step waits for half as long.
    let p = (0.999_999_3 + f * 0.693_121_8) + square * ((0.240_247_44 + f * 0.055_917_86) + square * 0.009_570_101);
    // The low nine bits of the magic number are zero: shifting leaves the integer alone.
    f32::from_bits(p.to_bits().wrapping_add(n.to_bits() << 23))
}

/// Prefetches the splats of a batch and their channels into the cache.
#[inline(always)]
pub(super) fn prefetch_batch<const K: usize>(batch: &[Entry], splats: &[Splat], features: &[f32]) {
    for entry in batch {
        prefetch(splats, entry.splat as usize);
        prefetch(features, entry.splat as usize * K);
    }
}

/// Loads the splats of a batch and their channels (`features[s * K + k]`) in the coordinates of the tile.
#[inline(always)]
pub(super) fn load_batch<const K: usize>(
    batch: &[Entry],
    splats: &[Splat],
    features: &[f32],
    frame: &TileFrame,
    splats_in_tile: &mut [TileSplat<K>; BATCH],
) {
    // Copies first, nothing else between them: the cache misses of a batch then overlap.
    let mut copies = [Splat::default(); BATCH];
    let mut values = [[0.0; K]; BATCH];
    for ((copy, values), entry) in copies.iter_mut().zip(&mut values).zip(batch) {
        let s = entry.splat as usize;
        *copy = splats[s];
        values.copy_from_slice(&features[s * K..s * K + K]);
    }
    for ((slot, splat), values) in splats_in_tile.iter_mut().zip(&copies).zip(&values).take(batch.len()) {
        *slot = TileSplat::new(splat, values, frame);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::project::{ALPHA_MAX, ALPHA_MIN};

    #[test]
    fn the_fast_exponential_is_accurate_over_its_domain() {
        for i in 0..12_500 {
            let x = -0.01 * i as f32;
            let (fast, exact) = (f64::from(exp2(x)), f64::from(x).exp2());
            assert!((fast - exact).abs() <= 4e-6 * exact, "{x}: {fast} against {exact}");
        }
    }

    #[test]
    fn the_bounds_of_alpha_are_those_of_the_projection() {
        assert!((LOG2_ALPHA_MIN - ALPHA_MIN.log2()).abs() < 1e-6);
        assert!((LOG2_ALPHA_MAX - ALPHA_MAX.log2()).abs() < 1e-7);
    }

    #[test]
    fn whole_numbers_survive_the_turn_to_integers() {
        for i in 0..300u16 {
            assert_eq!(whole(f32::from(i)), u32::from(i));
        }
    }
}
