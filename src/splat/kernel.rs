//! The inner loops: one tile, front to back, forward and backward, any number of channels.
//!
//! Plain loops over eight pixels of a row, compiled for several instruction sets and chosen at run time. They use
//! `a*b + c` without contraction, so every instruction set gives the same bits. The backward pass walks front to back
//! too and repeats the forward arithmetic exactly, so it needs no saved transmittance: with `G = Σ_j w_j d_j`, `d_j` the
//! product of splat j's values with the pixel's gradients, `∂L/∂α_i = T_i d_i - (G - Σ_{j≤i} w_j d_j) / (1 - α_i)`.

use super::bins::TILE;
use super::project::{ALPHA_MAX, ALPHA_MIN, Splat};
use multiversion::multiversion;

/// Pixels handled together.
const LANES: usize = 8;
/// Pixels of a tile.
pub const PIXELS: usize = TILE * TILE;
/// Transmittance below which a tile is finished.
const T_MIN: f32 = 1e-4;
/// Splats between two looks at whether the tile is finished.
const CHECK_EVERY: usize = 16;
/// Numbers besides the channels in a splat's gradient record: Σh, Σhx, Σhy, Σhx², Σhxy, Σhy², Σm, Σmx, Σmy.
pub const GEOMETRY: usize = 9;

type Lane = [f32; LANES];

/// Accumulated values of one tile.
#[derive(Clone)]
pub struct TileMaps<const K: usize> {
    /// Transmittance behind what was seen so far.
    pub transmittance: [f32; PIXELS],
    /// Composited channels.
    pub channels: [[f32; PIXELS]; K],
    /// `Σ w z`, metres.
    pub depth: [f32; PIXELS],
    /// `Σ w z²`, metres².
    pub depth_square: [f32; PIXELS],
    /// Depth where the transmittance falls through one half; the last seen where it never does, NaN where nothing was seen.
    pub median_depth: [f32; PIXELS],
    /// (splat, pixel) pairs evaluated inside a footprint's rows.
    pub pairs: u64,
}

impl<const K: usize> TileMaps<K> {
    /// An empty tile.
    pub fn new() -> Self {
        Self {
            transmittance: [1.0; PIXELS],
            channels: [[0.0; PIXELS]; K],
            depth: [0.0; PIXELS],
            depth_square: [0.0; PIXELS],
            median_depth: [f32::NAN; PIXELS],
            pairs: 0,
        }
    }
}

impl<const K: usize> Default for TileMaps<K> {
    fn default() -> Self {
        Self::new()
    }
}

/// Gradients of a loss to the maps of one tile.
#[derive(Clone)]
pub struct TileGradients<const K: usize> {
    /// To the composited channels.
    pub channels: [[f32; PIXELS]; K],
    /// To the accumulated alpha `Σ w`.
    pub alpha: [f32; PIXELS],
    /// To `Σ w z`.
    pub depth: [f32; PIXELS],
    /// To `Σ w z²`.
    pub depth_square: [f32; PIXELS],
    /// `Σ_j w_j d_j`: the maps' values times these gradients, summed.
    pub total: [f32; PIXELS],
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

/// `e^x` for `x ≤ 0`, vectorisable: range reduction with a magic number and a degree-5 polynomial (5e-6 relative).
#[inline(always)]
fn exp_negative(x: f32) -> f32 {
    const MAGIC: f32 = 12_582_912.0; // 1.5 · 2²³: adding it rounds to an integer.
    let x = if x < -87.0 { -87.0 } else { x };
    let n = x * std::f32::consts::LOG2_E + MAGIC;
    let k = n - MAGIC;
    let r = x - k * std::f32::consts::LN_2;
    let p = 1.0 + r * (1.0 + r * (0.5 + r * (0.166_666_67 + r * (0.041_666_67 + r * 0.008_333_334))));
    f32::from_bits(
        p.to_bits()
            .wrapping_add((n.to_bits().wrapping_sub(MAGIC.to_bits())) << 23),
    )
}

#[inline(always)]
fn load(values: &[f32; PIXELS], at: usize) -> Lane {
    let mut lane = [0.0; LANES];
    lane.copy_from_slice(&values[at..at + LANES]);
    lane
}

#[inline(always)]
fn store(values: &mut [f32; PIXELS], at: usize, lane: Lane) {
    values[at..at + LANES].copy_from_slice(&lane);
}

/// Rows of the tile that a splat reaches: first and one past last.
#[inline(always)]
fn rows(splat: &Splat, frame: &TileFrame) -> (usize, usize) {
    let first = (splat.row - splat.half[1] - frame.row0).ceil().max(0.0);
    let last = (splat.row + splat.half[1] - frame.row0)
        .floor()
        .min(frame.height as f32 - 1.0);
    if last < first {
        (0, 0)
    } else {
        (first as usize, last as usize + 1)
    }
}

/// Columns that the ellipse covers in a row at `y` below the centre, as first and one past last lane group.
#[inline(always)]
fn groups(splat: &Splat, frame: &TileFrame, y: f32) -> (usize, usize) {
    let [a, b, c] = splat.conic;
    let discriminant = b * b * y * y - a * (c * y * y - splat.reach);
    if discriminant.is_nan() || discriminant <= 0.0 {
        return (0, 0);
    }
    let root = discriminant.sqrt();
    let centre = splat.col - frame.col0 - b * y / a;
    let half = root / a;
    let first = (centre - half).ceil().max(0.0);
    let last = (centre + half).floor().min(frame.width as f32 - 1.0);
    if last < first {
        (0, 0)
    } else {
        (first as usize / LANES, last as usize / LANES + 1)
    }
}

/// Alpha of eight pixels before the upper clamp (zero outside the footprint), and their offsets from the centre.
#[inline(always)]
fn alphas(splat: &Splat, x0: f32, y: f32) -> (Lane, Lane) {
    let [a, b, c] = splat.conic;
    let (by, cyy) = (2.0 * b * y, c * y * y);
    let mut xs = [0.0; LANES];
    let mut raw = [0.0; LANES];
    for l in 0..LANES {
        let x = x0 + l as f32;
        let q = (a * x + by) * x + cyy;
        let q = if q < 0.0 { 0.0 } else { q };
        let alpha = splat.opacity * exp_negative(-0.5 * q);
        raw[l] = if alpha < ALPHA_MIN { 0.0 } else { alpha };
        xs[l] = x;
    }
    (raw, xs)
}

#[inline(always)]
fn finished(transmittance: &[f32; PIXELS], frame: &TileFrame) -> bool {
    let mut most = 0.0f32;
    for r in 0..frame.height {
        for c in 0..frame.width {
            let t = transmittance[r * TILE + c];
            most = if t > most { t } else { most };
        }
    }
    most < T_MIN
}

/// Composites `list` (front to back) into `maps`; `features[s * K + k]` are the splats' channels.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
pub fn forward<const K: usize>(
    list: &[u32],
    splats: &[Splat],
    features: &[f32],
    frame: &TileFrame,
    maps: &mut TileMaps<K>,
) {
    for (step, &s) in list.iter().enumerate() {
        if step % CHECK_EVERY == 0 && step > 0 && finished(&maps.transmittance, frame) {
            return;
        }
        let splat = &splats[s as usize];
        let mut values = [0.0; K];
        values.copy_from_slice(&features[s as usize * K..s as usize * K + K]);
        let (r0, r1) = rows(splat, frame);
        for r in r0..r1 {
            let y = frame.row0 + r as f32 - splat.row;
            let (g0, g1) = groups(splat, frame, y);
            maps.pairs += ((g1 - g0) * LANES) as u64;
            for g in g0..g1 {
                let at = r * TILE + g * LANES;
                let x0 = frame.col0 + (g * LANES) as f32 - splat.col;
                let (raw, xs) = alphas(splat, x0, y);
                let mut t = load(&maps.transmittance, at);
                let mut depth = load(&maps.depth, at);
                let mut square = load(&maps.depth_square, at);
                let mut median = load(&maps.median_depth, at);
                let mut w = [0.0; LANES];
                for l in 0..LANES {
                    let alpha = if raw[l] > ALPHA_MAX { ALPHA_MAX } else { raw[l] };
                    w[l] = t[l] * alpha;
                    let z = splat.depth + splat.slope[0] * xs[l] + splat.slope[1] * y;
                    depth[l] += w[l] * z;
                    square[l] += w[l] * z * z;
                    median[l] = if t[l] > 0.5 && w[l] > 0.0 { z } else { median[l] };
                    t[l] -= w[l];
                }
                store(&mut maps.transmittance, at, t);
                store(&mut maps.depth, at, depth);
                store(&mut maps.depth_square, at, square);
                store(&mut maps.median_depth, at, median);
                for k in 0..K {
                    let channel = &mut maps.channels[k];
                    let mut lane = load(channel, at);
                    for l in 0..LANES {
                        lane[l] += w[l] * values[k];
                    }
                    store(channel, at, lane);
                }
            }
        }
    }
}

#[inline(always)]
fn sum(lane: &Lane) -> f32 {
    ((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]))
}

/// Gradients of every splat of `list`: `out[i * (K + 9)..]` holds channels first, then the nine geometric sums.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
pub fn backward<const K: usize>(
    list: &[u32],
    splats: &[Splat],
    features: &[f32],
    frame: &TileFrame,
    grads: &TileGradients<K>,
    out: &mut [f32],
) {
    let width = K + GEOMETRY;
    let mut transmittance = [1.0f32; PIXELS];
    let mut rest = grads.total;
    for (step, &s) in list.iter().enumerate() {
        if step % CHECK_EVERY == 0 && step > 0 && finished(&transmittance, frame) {
            out[step * width..].fill(0.0);
            return;
        }
        let splat = &splats[s as usize];
        let mut values = [0.0; K];
        values.copy_from_slice(&features[s as usize * K..s as usize * K + K]);
        let mut channel_sums = [[0.0f32; LANES]; K];
        let mut sums = [[0.0f32; LANES]; GEOMETRY];
        let (r0, r1) = rows(splat, frame);
        for r in r0..r1 {
            let y = frame.row0 + r as f32 - splat.row;
            let (g0, g1) = groups(splat, frame, y);
            for g in g0..g1 {
                let at = r * TILE + g * LANES;
                let x0 = frame.col0 + (g * LANES) as f32 - splat.col;
                let (raw, xs) = alphas(splat, x0, y);
                let mut t = load(&transmittance, at);
                let mut left = load(&rest, at);
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
                        dot[l] += gk[l] * values[k];
                        channel_sums[k][l] += w[l] * gk[l];
                    }
                }
                for l in 0..LANES {
                    let z = splat.depth + splat.slope[0] * xs[l] + splat.slope[1] * y;
                    let d = dot[l] + (gd[l] + gs[l] * z) * z;
                    let m = w[l] * (gd[l] + 2.0 * gs[l] * z);
                    left[l] -= w[l] * d;
                    let saturated = raw[l] > ALPHA_MAX;
                    let alpha = if saturated { ALPHA_MAX } else { raw[l] };
                    let d_alpha = t[l] * d - left[l] / (1.0 - alpha);
                    let h = if saturated { 0.0 } else { raw[l] * d_alpha };
                    t[l] -= w[l];
                    let x = xs[l];
                    sums[0][l] += h;
                    sums[1][l] += h * x;
                    sums[2][l] += h * y;
                    sums[3][l] += h * x * x;
                    sums[4][l] += h * x * y;
                    sums[5][l] += h * y * y;
                    sums[6][l] += m;
                    sums[7][l] += m * x;
                    sums[8][l] += m * y;
                }
                store(&mut transmittance, at, t);
                store(&mut rest, at, left);
            }
        }
        let record = &mut out[step * width..(step + 1) * width];
        for k in 0..K {
            record[k] = sum(&channel_sums[k]);
        }
        for (slot, lane) in record[K..].iter_mut().zip(&sums) {
            *slot = sum(lane);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_exponential_is_accurate_over_its_domain() {
        for i in 0..8700 {
            let x = -0.01 * i as f32;
            let (fast, exact) = (f64::from(exp_negative(x)), f64::from(x).exp());
            assert!((fast - exact).abs() <= 1e-5 * exact, "{x}: {fast} against {exact}");
        }
        assert!(exp_negative(-1e30) >= 0.0 && exp_negative(-1e30) < 1e-37);
    }
}
