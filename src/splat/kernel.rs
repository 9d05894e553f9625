//! The inner loops: one tile, front to back, forward and backward, any number of channels.
//!
//! Plain loops over eight pixels of a row, compiled for several instruction sets and chosen at run time. They use
//! `a*b + c` without contraction, so every instruction set gives the same bits. The backward pass walks front to back
//! too and repeats the forward arithmetic exactly, so it needs no saved transmittance: with `G = Σ_j w_j d_j`, `d_j` the
//! product of splat j's values with the pixel's gradients, `∂L/∂α_i = T_i d_i - (G - Σ_{j≤i} w_j d_j) / (1 - α_i)`.
//!
//! Splats are small, so what surrounds the arithmetic counts. Splats are fetched in batches, whose cache misses overlap;
//! the eight pixels begin where the ellipse begins in a row, not at a multiple of eight, and may reach past the tile into
//! columns that never take light; all places of a splat are listed first, eight rows at once, and then worked through.

mod backward;
mod forward;

pub use backward::backward;
pub use forward::forward;

use super::bins::{Entry, TILE_HEIGHT, TILE_WIDTH};
use super::project::Splat;
use crate::fast::MAGIC;
use crate::simd::prefetch;
use std::f32::consts::LOG2_E;

/// Pixels handled together.
const LANES: usize = 8;
/// Distance between the rows of a tile in memory: its pixels, and room for eight that begin in its last column.
pub const STRIDE: usize = TILE_WIDTH + LANES;
/// Numbers of one plane of a tile.
pub const PLANE: usize = TILE_HEIGHT * STRIDE;
/// Transmittance below which a tile is finished.
const T_MIN: f32 = 1e-4;
/// Transmittance at the median depth.
const MEDIAN: f32 = 0.5;
/// Splats fetched together, and between two looks at whether the tile is finished.
const BATCH: usize = 16;
/// Groups of eight pixels in a tile, at most, and eight to spare, because they are written eight at once.
const GROUPS: usize = TILE_WIDTH * TILE_HEIGHT / LANES + LANES;
/// Numbers besides the channels in a splat's gradient record: Σh, Σhx, Σhy, Σhx², Σhxy, Σhy², Σm, Σmx, Σmy.
pub const GEOMETRY: usize = 9;

type Lane = [f32; LANES];
type Plane = [f32; PLANE];

/// Accumulated values of one tile.
#[derive(Clone)]
pub struct TileMaps<const K: usize> {
    /// Transmittance behind what was seen so far; zero outside the image.
    pub transmittance: Plane,
    /// Composited channels.
    pub channels: [Plane; K],
    /// `Σ w z`, metres.
    pub depth: Plane,
    /// `Σ w z²`, metres².
    pub depth_square: Plane,
    /// Depth where the transmittance falls through a half, metres; the last seen where it never does, zero where nothing was seen.
    pub median_depth: Plane,
    /// (splat, pixel) pairs inside the footprints.
    pub pairs: u64,
}

impl<const K: usize> TileMaps<K> {
    /// Room for a tile, on the heap.
    pub fn boxed() -> Box<Self> {
        Box::new(Self {
            transmittance: [0.0; PLANE],
            channels: [[0.0; PLANE]; K],
            depth: [0.0; PLANE],
            depth_square: [0.0; PLANE],
            median_depth: [0.0; PLANE],
            pairs: 0,
        })
    }

    /// Empties the tile, keeping the count of pairs.
    fn clear(&mut self, frame: &TileFrame, depths: bool) {
        frame.clear_sky(&mut self.transmittance);
        self.channels.fill([0.0; PLANE]);
        self.depth.fill(0.0);
        if depths {
            self.depth_square.fill(0.0);
            self.median_depth.fill(0.0);
        }
    }
}

/// Gradients of a loss to the maps of one tile; zero outside the image.
#[derive(Clone)]
pub struct TileGradients<const K: usize> {
    /// To the composited channels.
    pub channels: [Plane; K],
    /// To the accumulated alpha `Σ w`.
    pub alpha: Plane,
    /// To `Σ w z`.
    pub depth: Plane,
    /// `Σ_j w_j d_j`: the maps' values times these gradients, summed.
    pub total: Plane,
}

impl<const K: usize> TileGradients<K> {
    /// All zero, on the heap.
    pub fn boxed() -> Box<Self> {
        Box::new(Self {
            channels: [[0.0; PLANE]; K],
            alpha: [0.0; PLANE],
            depth: [0.0; PLANE],
            total: [0.0; PLANE],
        })
    }
}

/// What a tile covers.
#[derive(Clone, Copy)]
pub struct TileFrame {
    /// First column, pixels.
    pub col0: f32,
    /// First row, pixels.
    pub row0: f32,
    /// Columns inside the image.
    pub width: usize,
    /// Rows inside the image.
    pub height: usize,
}

impl TileFrame {
    /// Transmittance before anything is seen: one in the image, zero outside, where nothing then adds anything.
    fn clear_sky(&self, plane: &mut Plane) {
        for (number, row) in plane.chunks_exact_mut(STRIDE).enumerate() {
            let width = if number < self.height { self.width } else { 0 };
            row[..width].fill(1.0);
            row[width..].fill(0.0);
        }
    }
}

/// A splat as a tile meets it: in the tile's own pixels, its exponent in binary orders.
#[derive(Clone, Copy)]
struct Met<const K: usize> {
    x: f32,
    y: f32,
    /// `log2 α = (form[0]·x + form[1]·y)·x + form[2]·y² + peak`.
    form: [f32; 3],
    peak: f32,
    /// The peak, or where alpha saturates if that is less.
    top: f32,
    /// Columns that the ellipse's middle moves per row.
    shift: f32,
    /// Squared half width of the ellipse in a row: `width_square - narrowing·y²`.
    width_square: f32,
    narrowing: f32,
    depth: f32,
    slope: [f32; 2],
    rows: (u8, u8),
    values: [f32; K],
}

/// Groups of eight pixels of a row that a splat reaches, and what is the same all along the row.
struct Groups {
    /// Place of the first pixel in a plane.
    at: [u32; GROUPS],
    /// Its offset from the splat's centre, columns.
    x: [f32; GROUPS],
    /// The same of the row.
    y: [f32; GROUPS],
    /// Change of the exponent per column in the row, and its value in the column of the centre.
    tilt: [f32; GROUPS],
    base: [f32; GROUPS],
    /// Depth in the column of the centre, metres.
    depth: [f32; GROUPS],
    /// Alpha of the eight pixels, zero outside the footprint.
    alpha: [Lane; GROUPS],
    /// `1 / (1 - alpha)`, where it was asked for.
    inverse: [Lane; GROUPS],
    count: usize,
}

/// The groups that begin in eight rows.
struct EightRows {
    at: [u32; LANES],
    x: Lane,
    y: Lane,
    tilt: Lane,
    base: Lane,
    depth: Lane,
    /// Pixels inside the ellipse.
    wide: Lane,
}

/// The non-negative whole number `x`, without the checks of a cast; below 2²³.
#[inline(always)]
fn whole(x: f32) -> u32 {
    (x + 8_388_608.0).to_bits() & 0x007f_ffff
}

/// The lesser, `b` where `a` is not a number; unlike `f32::min` one instruction.
#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The greater, `b` where `a` is not a number.
#[inline(always)]
fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

impl Groups {
    fn new() -> Self {
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

    /// The groups' numbers, known to be few enough.
    #[inline(always)]
    fn numbers(&self) -> std::ops::Range<usize> {
        0..self.count.min(GROUPS)
    }

    /// Place of the first pixel of group `g`, known to lie inside a plane.
    #[inline(always)]
    fn place(&self, g: usize) -> usize {
        (self.at[g] as usize).min(PLANE - LANES)
    }

    /// Offset of pixel `l` of group `g` from the splat's centre, columns.
    #[inline(always)]
    fn offset(&self, g: usize, l: usize) -> f32 {
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

impl<const K: usize> Met<K> {
    const NOTHING: Self = Self {
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

    #[inline(always)]
    fn new(splat: &Splat, values: &[f32; K], frame: &TileFrame) -> Self {
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
    fn groups(&self, frame: &TileFrame, groups: &mut Groups, pixels: &mut Lane) {
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

    /// Finds the groups' alphas, and with `INVERSE` what walking back divides by. A walk of its own, because one group waits for its exponential longer than it works.
    #[inline(always)]
    fn alphas<const INVERSE: bool>(&self, groups: &mut Groups) {
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
const LOG2_ALPHA_MIN: f32 = -7.994_353_3;
/// `log2` of [`ALPHA_MAX`](super::project::ALPHA_MAX).
const LOG2_ALPHA_MAX: f32 = -0.014_499_57;

/// `2^x` for `-126 < x < 127`, vectorisable: the nearest integer by a magic number and a polynomial for the rest
/// (3e-6 relative, minimax). Outside, the value means nothing.
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

#[inline(always)]
fn load(values: &Plane, at: usize) -> Lane {
    let mut lane = [0.0; LANES];
    lane.copy_from_slice(&values[at..at + LANES]);
    lane
}

#[inline(always)]
fn store(values: &mut Plane, at: usize, lane: Lane) {
    values[at..at + LANES].copy_from_slice(&lane);
}

#[inline(always)]
fn finished(transmittance: &Plane) -> bool {
    let mut highest = [0.0f32; LANES];
    for lane in transmittance.chunks_exact(LANES) {
        for l in 0..LANES {
            highest[l] = most(lane[l], highest[l]);
        }
    }
    highest.iter().all(|&t| t < T_MIN)
}

/// Asks for the splats of a batch and their channels ahead of time.
#[inline(always)]
fn announce<const K: usize>(batch: &[Entry], splats: &[Splat], features: &[f32]) {
    for entry in batch {
        prefetch(splats, entry.splat as usize);
        prefetch(features, entry.splat as usize * K);
    }
}

/// Fetches the splats of a batch and their channels (`features[s * K + k]`).
#[inline(always)]
fn fetch<const K: usize>(
    batch: &[Entry],
    splats: &[Splat],
    features: &[f32],
    frame: &TileFrame,
    met: &mut [Met<K>; BATCH],
) {
    // Copies first, nothing else between them: the cache misses of a batch then overlap.
    let mut copies = [Splat::default(); BATCH];
    let mut values = [[0.0; K]; BATCH];
    for ((copy, values), entry) in copies.iter_mut().zip(&mut values).zip(batch) {
        let s = entry.splat as usize;
        *copy = splats[s];
        values.copy_from_slice(&features[s * K..s * K + K]);
    }
    for ((slot, splat), values) in met.iter_mut().zip(&copies).zip(&values).take(batch.len()) {
        *slot = Met::new(splat, values, frame);
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
