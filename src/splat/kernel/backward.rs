//! Backward over one tile, front to back again: the gradients of each splat.
//!
//! The groups of a splat are looped over twice, so that the sums of each loop stay in registers: first the sums over
//! pixel values, then the moments of two numbers per pixel, `h = ∂L/∂ ln α` and `m = ∂L/∂z`, over the splat.

use super::footprint::{BATCH, GROUPS, Groups, LOG2_ALPHA_MAX, TileSplat, exp2, load_batch, prefetch_batch};
use super::tile::{GEOMETRY, LANES, Lane, PLANE, Plane, TileFrame, TileGradients, is_opaque, load, store};
use crate::splat::bins::Entry;
use crate::splat::project::Splat;
use crate::splat::rasterise::MOST_CHANNELS;
use crate::vectorised;

/// State of a tile while its splats are visited front to back.
struct TileState {
    transmittance: Plane,
    /// `G - Σ_{j≤i} w_j d_j`.
    rest: Plane,
    /// `∂L/∂ ln α` and `∂L/∂z` of the current splat, by group.
    h: [Lane; GROUPS],
    m: [Lane; GROUPS],
    /// Lane sums of the current splat: the gradients of its channels, then its moments.
    sums: [Lane; MOST_CHANNELS + GEOMETRY],
}

vectorised! {
    // With AVX-512 the compiler gathers the sums over lanes, which takes a quarter more time (docs/lab/speed.md).
    up to Avx2;
    /// Gradients of every splat of `list`: record `r` of the tile, whose first is `base`, fills
    /// `out[(r - base) * (K + 9)..]`, channels first, then the nine geometric sums.
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
        // Hidden from the compiler, which would unroll the sums over lanes and shuffle more than add.
        let quantities = std::hint::black_box(width).min(MOST_CHANNELS + GEOMETRY);
        let place = |entry: &Entry| {
            let start = (entry.record - base) as usize * width;
            start..start + width
        };
        let mut state = TileState {
            transmittance: [0.0; PLANE],
            rest: grads.total,
            h: [[0.0; LANES]; GROUPS],
            m: [[0.0; LANES]; GROUPS],
            sums: [[0.0; LANES]; MOST_CHANNELS + GEOMETRY],
        };
        frame.reset_transmittance(&mut state.transmittance);
        let mut splats_in_tile = [TileSplat::<K>::NOTHING; BATCH];
        let mut groups = Groups::new();
        let mut pixels = [0.0; LANES];
        for (number, batch) in list.chunks(BATCH).enumerate() {
            if number > 0 && is_opaque(&state.transmittance) {
                for entry in &list[number * BATCH..] {
                    out[place(entry)].fill(0.0);
                }
                return;
            }
            let next = &list[((number + 1) * BATCH).min(list.len())..((number + 2) * BATCH).min(list.len())];
            prefetch_batch::<K>(next, splats, features);
            load_batch(batch, splats, features, frame, &mut splats_in_tile);
            for (splat, entry) in splats_in_tile.iter().zip(batch) {
                splat.groups(frame, &mut groups, &mut pixels);
                state.sums[..K].fill([0.0; LANES]);
                splat.alphas::<true>(&mut groups);
                for g in groups.numbers() {
                    group_backward::<K>(splat, &groups, g, grads, &mut state);
                }
                let moments = moments(&groups, &state);
                state.sums[K..K + GEOMETRY].copy_from_slice(&moments);
                add_lanes(&state.sums[..quantities], &mut out[place(entry)]);
            }
        }
    }
}

/// Gradients from eight pixels to a splat: adds to the sums of its channels and stores `h` and `m`.
#[inline(always)]
fn group_backward<const K: usize>(
    splat: &TileSplat<K>,
    groups: &Groups,
    g: usize,
    grads: &TileGradients<K>,
    state: &mut TileState,
) {
    let (at, depth_at_row, alpha) = (groups.place(g), groups.depth[g], &groups.alpha[g]);
    let saturated = exp2(LOG2_ALPHA_MAX);
    let mut t = load(&state.transmittance, at);
    let mut left = load(&state.rest, at);
    let mut dot = load(&grads.alpha, at);
    let gd = load(&grads.depth, at);
    let mut w = [0.0; LANES];
    for l in 0..LANES {
        w[l] = t[l] * alpha[l];
    }
    for k in 0..K {
        let gk = load(&grads.channels[k], at);
        for l in 0..LANES {
            dot[l] += gk[l] * splat.values[k];
            state.sums[k][l] += w[l] * gk[l];
        }
    }
    let (h, m) = (&mut state.h[g], &mut state.m[g]);
    for l in 0..LANES {
        let z = depth_at_row + splat.slope[0] * groups.offset(g, l);
        let d = dot[l] + gd[l] * z;
        m[l] = w[l] * gd[l];
        left[l] -= w[l] * d;
        let d_alpha = t[l] * d - left[l] * groups.inverse[g][l];
        let to_log = alpha[l] * d_alpha;
        h[l] = if alpha[l] >= saturated { 0.0 } else { to_log };
        t[l] -= w[l];
    }
    store(&mut state.transmittance, at, t);
    store(&mut state.rest, at, left);
}

/// Lane sums of the nine moments of a splat's pixels.
#[inline(always)]
fn moments(groups: &Groups, state: &TileState) -> [Lane; GEOMETRY] {
    let mut sums = [[0.0; LANES]; GEOMETRY];
    for g in groups.numbers() {
        let (h, m, y) = (&state.h[g], &state.m[g], groups.y[g]);
        for l in 0..LANES {
            let x = groups.offset(g, l);
            let (hx, hy) = (h[l] * x, h[l] * y);
            sums[0][l] += h[l];
            sums[1][l] += hx;
            sums[2][l] += hy;
            sums[3][l] += hx * x;
            sums[4][l] += hx * y;
            sums[5][l] += hy * y;
            sums[6][l] += m[l];
            sums[7][l] += m[l] * x;
            sums[8][l] += m[l] * y;
        }
    }
    sums
}

/// Sums of eight lanes each.
#[inline(always)]
fn add_lanes(lanes: &[Lane], out: &mut [f32]) {
    for (slot, lane) in out.iter_mut().zip(lanes) {
        *slot = ((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]));
    }
}
