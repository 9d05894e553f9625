//! The inner loops: one tile, front to back, forward and backward, any number of channels.
//!
//! Plain loops over eight pixels of a row, compiled for several instruction sets and chosen at run time. They use
//! `a*b + c` without contraction, so every instruction set gives the same bits. The backward pass walks front to back
//! too and repeats the forward arithmetic exactly, so it needs no saved transmittance: with `G = Σ_j w_j d_j`, `d_j` the
//! product of splat j's values with the pixel's gradients, `∂L/∂α_i = T_i d_i - (G - Σ_{j≤i} w_j d_j) / (1 - α_i)`.
//!
//! Splats are small, so what surrounds the arithmetic counts. Splats are fetched in batches, whose cache misses overlap;
//! the eight pixels begin where the ellipse begins in a row, not at a multiple of eight, and may reach past the tile into
//! columns that never take light; all places of a splat are listed first, without branches, and then worked through.

use super::bins::{Entry, TILE_HEIGHT, TILE_WIDTH};
use super::project::{ALPHA_MAX, Splat};
use multiversion::multiversion;
use std::f32::consts::LOG2_E;

/// Pixels handled together.
const LANES: usize = 8;
/// Distance between the rows of a tile in memory: its pixels, and room for eight that begin in its last column.
pub const STRIDE: usize = TILE_WIDTH + LANES;
/// Numbers of one plane of a tile.
pub const PLANE: usize = TILE_HEIGHT * STRIDE;
/// Transmittance below which a tile is finished.
const T_MIN: f32 = 1e-4;
/// Splats fetched together, and between two looks at whether the tile is finished.
const BATCH: usize = 16;
/// Groups of eight pixels in a tile, at most, and one to spare for a group that is written and not kept.
const GROUPS: usize = TILE_WIDTH * TILE_HEIGHT / LANES + 2;
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
    /// Depth where the transmittance falls through one half; the last seen where it never does, zero where nothing was seen.
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
    fn clear(&mut self, frame: &TileFrame) {
        self.transmittance = frame.clear_sky();
        self.channels.fill([0.0; PLANE]);
        self.depth.fill(0.0);
        self.depth_square.fill(0.0);
        self.median_depth.fill(0.0);
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
    /// To `Σ w z²`.
    pub depth_square: Plane,
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
            depth_square: [0.0; PLANE],
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
    fn clear_sky(&self) -> Plane {
        let mut plane = [0.0; PLANE];
        for row in plane.chunks_exact_mut(STRIDE).take(self.height) {
            row[..self.width].fill(1.0);
        }
        plane
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

/// Eight pixels of a row that a splat reaches.
#[derive(Clone, Copy, Default)]
struct Group {
    /// Place of the first pixel in a plane.
    at: u32,
    /// Its offset from the splat's centre.
    x: f32,
    y: f32,
}

/// The non-negative whole number `x`, without the checks of a cast; below 2²³.
#[inline(always)]
fn whole(x: f32) -> u32 {
    (x + 8_388_608.0).to_bits() & 0x007f_ffff
}

impl<const K: usize> Met<K> {
    const NOTHING: Self = Self {
        x: 0.0,
        y: 0.0,
        form: [0.0; 3],
        peak: 0.0,
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
        let first = (y - splat.half[1]).ceil().max(0.0).min(TILE_HEIGHT as f32);
        let last = (y + splat.half[1]).floor().max(-1.0).min(frame.height as f32 - 1.0);
        Self {
            x,
            y,
            form: [-0.5 * LOG2_E * a, -LOG2_E * b, -0.5 * LOG2_E * c],
            // ln(α / α_min) at the centre is half the reach.
            peak: 0.5 * LOG2_E * splat.reach + log2_alpha_min(),
            shift,
            width_square: splat.reach * inverse,
            narrowing: c * inverse - shift * shift,
            depth: splat.depth,
            slope: splat.slope,
            rows: (whole(first) as u8, whole(last + 1.0) as u8),
            values: *values,
        }
    }

    /// Lists the groups of eight that the ellipse touches; returns how many, and the pixels inside the ellipse.
    #[inline(always)]
    fn groups(&self, frame: &TileFrame, groups: &mut [Group; GROUPS]) -> (usize, u32) {
        let (mut count, mut pixels) = (0, 0);
        let last_column = frame.width as f32 - 1.0;
        for row in u32::from(self.rows.0)..u32::from(self.rows.1) {
            let y = row as f32 - self.y;
            let half = (self.width_square - self.narrowing * y * y).max(0.0).sqrt();
            let middle = self.x - self.shift * y;
            let first = (middle - half).ceil().max(0.0).min(TILE_WIDTH as f32 - 1.0);
            let beyond = (middle + half).floor().min(last_column) + 1.0;
            let wide = (beyond - first).max(0.0);
            let group = Group {
                at: row * STRIDE as u32 + whole(first),
                x: first - self.x,
                y,
            };
            pixels += whole(wide);
            groups[count] = group;
            count += usize::from(wide > 0.0);
            let mut done = LANES as f32;
            while wide > done {
                groups[count] = Group {
                    at: group.at + whole(done),
                    x: group.x + done,
                    y,
                };
                count += 1;
                done += LANES as f32;
            }
        }
        (count, pixels)
    }

    /// Alpha of eight pixels before the upper clamp (zero outside the footprint), and their offsets from the centre.
    #[inline(always)]
    fn alphas(&self, group: &Group) -> (Lane, Lane) {
        let by = self.form[1] * group.y;
        let base = self.form[2] * group.y * group.y + self.peak;
        let mut xs = [0.0; LANES];
        let mut raw = [0.0; LANES];
        for l in 0..LANES {
            let x = group.x + l as f32;
            let order = (self.form[0] * x + by) * x + base;
            let order = if order > self.peak { self.peak } else { order };
            let alpha = exp2(order);
            raw[l] = if order >= log2_alpha_min() { alpha } else { 0.0 };
            xs[l] = x;
        }
        (raw, xs)
    }
}

/// `log2` of [`ALPHA_MIN`].
#[inline(always)]
const fn log2_alpha_min() -> f32 {
    -7.994_353_3
}

/// `2^x` for `-126 < x < 127`, vectorisable: the nearest integer by a magic number and a polynomial for the rest
/// (3e-6 relative, minimax). Outside, the value means nothing.
#[inline(always)]
fn exp2(x: f32) -> f32 {
    const MAGIC: f32 = 12_582_912.0; // 1.5 · 2²³: adding it rounds to an integer.
    let n = x + MAGIC;
    let f = x - (n - MAGIC);
    let p = 0.999_999_3 + f * (0.693_121_8 + f * (0.240_247_44 + f * (0.055_917_86 + f * 0.009_570_101)));
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

/// The place of a group, known to lie inside a plane.
#[inline(always)]
fn place(group: &Group) -> usize {
    (group.at as usize).min(PLANE - LANES)
}

#[inline(always)]
fn finished(transmittance: &Plane) -> bool {
    let mut most = [0.0f32; LANES];
    for lane in transmittance.chunks_exact(LANES) {
        for l in 0..LANES {
            most[l] = if lane[l] > most[l] { lane[l] } else { most[l] };
        }
    }
    most.iter().all(|&t| t < T_MIN)
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

/// Composites `list` (front to back) into `maps`, which it empties first; `features[s * K + k]` are the splats' channels.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
pub fn forward<const K: usize>(
    list: &[Entry],
    splats: &[Splat],
    features: &[f32],
    frame: &TileFrame,
    maps: &mut TileMaps<K>,
) {
    maps.clear(frame);
    let mut met = [Met::<K>::NOTHING; BATCH];
    let mut groups = [Group::default(); GROUPS];
    for (number, batch) in list.chunks(BATCH).enumerate() {
        if number > 0 && finished(&maps.transmittance) {
            return;
        }
        fetch(batch, splats, features, frame, &mut met);
        for splat in &met[..batch.len()] {
            let (count, pixels) = splat.groups(frame, &mut groups);
            maps.pairs += u64::from(pixels);
            for group in &groups[..count] {
                forward_group(splat, group, maps);
            }
        }
    }
}

#[inline(always)]
fn forward_group<const K: usize>(splat: &Met<K>, group: &Group, maps: &mut TileMaps<K>) {
    let at = place(group);
    let (raw, xs) = splat.alphas(group);
    let depth_at_row = splat.depth + splat.slope[1] * group.y;
    let mut t = load(&maps.transmittance, at);
    let mut depth = load(&maps.depth, at);
    let mut square = load(&maps.depth_square, at);
    let mut median = load(&maps.median_depth, at);
    let mut w = [0.0; LANES];
    for l in 0..LANES {
        let alpha = if raw[l] > ALPHA_MAX { ALPHA_MAX } else { raw[l] };
        w[l] = t[l] * alpha;
        let z = depth_at_row + splat.slope[0] * xs[l];
        let wz = w[l] * z;
        depth[l] += wz;
        square[l] += wz * z;
        // Zeros and ones instead of a choice, which would be stored through a mask: slow on many processors.
        let here = if t[l] > 0.5 && w[l] > 0.0 { 1.0 } else { 0.0 };
        median[l] = here * z + (1.0 - here) * median[l];
        t[l] -= w[l];
    }
    store(&mut maps.transmittance, at, t);
    store(&mut maps.depth, at, depth);
    store(&mut maps.depth_square, at, square);
    store(&mut maps.median_depth, at, median);
    for k in 0..K {
        let mut lane = load(&maps.channels[k], at);
        for l in 0..LANES {
            lane[l] += w[l] * splat.values[k];
        }
        store(&mut maps.channels[k], at, lane);
    }
}

#[inline(always)]
fn sum(lane: &Lane) -> f32 {
    ((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]))
}

/// Where a tile stands on its way front to back, and the lane sums of the splat at hand.
struct Walk<const K: usize> {
    transmittance: Plane,
    /// `G - Σ_{j≤i} w_j d_j`.
    rest: Plane,
    channels: [Lane; K],
    geometry: [Lane; GEOMETRY],
}

/// Gradients of every splat of `list`: record `r` of the tile, whose first is `base`, fills `out[(r - base) * (K + 9)..]`,
/// channels first, then the nine geometric sums.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
pub fn backward<const K: usize>(
    list: &[Entry],
    splats: &[Splat],
    features: &[f32],
    frame: &TileFrame,
    grads: &TileGradients<K>,
    base: u32,
    out: &mut [f32],
) {
    let width = K + GEOMETRY;
    let place = |entry: &Entry| {
        let start = (entry.record - base) as usize * width;
        start..start + width
    };
    let mut walk = Walk {
        transmittance: frame.clear_sky(),
        rest: grads.total,
        channels: [[0.0; LANES]; K],
        geometry: [[0.0; LANES]; GEOMETRY],
    };
    let mut met = [Met::<K>::NOTHING; BATCH];
    let mut groups = [Group::default(); GROUPS];
    for (number, batch) in list.chunks(BATCH).enumerate() {
        if number > 0 && finished(&walk.transmittance) {
            for entry in &list[number * BATCH..] {
                out[place(entry)].fill(0.0);
            }
            return;
        }
        fetch(batch, splats, features, frame, &mut met);
        for (splat, entry) in met.iter().zip(batch) {
            let (count, _) = splat.groups(frame, &mut groups);
            walk.channels = [[0.0; LANES]; K];
            walk.geometry = [[0.0; LANES]; GEOMETRY];
            for group in &groups[..count] {
                backward_group(splat, group, grads, &mut walk);
            }
            for (slot, lane) in out[place(entry)]
                .iter_mut()
                .zip(walk.channels.iter().chain(&walk.geometry))
            {
                *slot = sum(lane);
            }
        }
    }
}

#[inline(always)]
fn backward_group<const K: usize>(splat: &Met<K>, group: &Group, grads: &TileGradients<K>, walk: &mut Walk<K>) {
    let at = place(group);
    let (raw, xs) = splat.alphas(group);
    let depth_at_row = splat.depth + splat.slope[1] * group.y;
    let mut t = load(&walk.transmittance, at);
    let mut left = load(&walk.rest, at);
    let mut dot = load(&grads.alpha, at);
    let (gd, gs) = (load(&grads.depth, at), load(&grads.depth_square, at));
    let mut w = [0.0; LANES];
    for l in 0..LANES {
        let alpha = if raw[l] > ALPHA_MAX { ALPHA_MAX } else { raw[l] };
        w[l] = t[l] * alpha;
    }
    for k in 0..K {
        let gk = load(&grads.channels[k], at);
        for l in 0..LANES {
            dot[l] += gk[l] * splat.values[k];
            walk.channels[k][l] += w[l] * gk[l];
        }
    }
    let y = group.y;
    let sums = &mut walk.geometry;
    for l in 0..LANES {
        let x = xs[l];
        let z = depth_at_row + splat.slope[0] * x;
        let gz = gs[l] * z;
        let slope = gd[l] + gz;
        let d = dot[l] + slope * z;
        let m = w[l] * (slope + gz);
        left[l] -= w[l] * d;
        let saturated = raw[l] > ALPHA_MAX;
        let alpha = if saturated { ALPHA_MAX } else { raw[l] };
        let d_alpha = t[l] * d - left[l] / (1.0 - alpha);
        let h = if saturated { 0.0 } else { raw[l] * d_alpha };
        t[l] -= w[l];
        let (hx, hy) = (h * x, h * y);
        sums[0][l] += h;
        sums[1][l] += hx;
        sums[2][l] += hy;
        sums[3][l] += hx * x;
        sums[4][l] += hx * y;
        sums[5][l] += hy * y;
        sums[6][l] += m;
        sums[7][l] += m * x;
        sums[8][l] += m * y;
    }
    store(&mut walk.transmittance, at, t);
    store(&mut walk.rest, at, left);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::project::ALPHA_MIN;

    #[test]
    fn the_fast_exponential_is_accurate_over_its_domain() {
        for i in 0..12_500 {
            let x = -0.01 * i as f32;
            let (fast, exact) = (f64::from(exp2(x)), f64::from(x).exp2());
            assert!((fast - exact).abs() <= 4e-6 * exact, "{x}: {fast} against {exact}");
        }
    }

    #[test]
    fn the_least_alpha_is_where_the_footprint_ends() {
        assert!((log2_alpha_min() - ALPHA_MIN.log2()).abs() < 1e-6);
    }

    #[test]
    fn whole_numbers_survive_the_turn_to_integers() {
        for i in 0..300u16 {
            assert_eq!(whole(f32::from(i)), u32::from(i));
        }
    }
}
