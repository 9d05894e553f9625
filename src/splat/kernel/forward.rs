//! Forward over one tile, front to back: the contribution of each splat to the maps.

use super::footprint::{BATCH, Groups, TileSplat, load_batch, prefetch_batch};
use super::tile::{LANES, QUANTILES, TileFrame, TileMaps, is_opaque, load, store};
use crate::splat::bins::Entry;
use crate::splat::project::Splat;
use crate::vectorised;

/// Channels beyond which AVX-512 is slower: the compiler then makes gathers of the loop over channels
/// (docs/lab/speed.md).
const MOST_AVX512: usize = 8;

vectorised! {
    up to Avx2 where K > MOST_AVX512;
    /// Composites `list` (front to back) into `maps`, which it empties first; `features[s * K + k]` are the splats'
    /// channels. The sum of squared depths and the depths' quantiles are computed only with `DEPTHS`.
    pub fn forward<const K: usize, const DEPTHS: bool>(
        list: &[Entry],
        splats: &[Splat],
        features: &[f32],
        frame: &TileFrame,
        maps: &mut TileMaps<K>,
    ) {
        maps.clear(frame, DEPTHS);
        let mut splats_in_tile = [TileSplat::<K>::NOTHING; BATCH];
        let mut groups = Groups::new();
        for (number, batch) in list.chunks(BATCH).enumerate() {
            if number > 0 && is_opaque(&maps.transmittance) {
                return;
            }
            let next = &list[((number + 1) * BATCH).min(list.len())..((number + 2) * BATCH).min(list.len())];
            prefetch_batch::<K>(next, splats, features);
            load_batch(batch, splats, features, frame, &mut splats_in_tile);
            let mut pixels = [0.0; LANES];
            for splat in &splats_in_tile[..batch.len()] {
                splat.groups(frame, &mut groups, &mut pixels);
                splat.alphas::<false>(&mut groups);
                for g in groups.numbers() {
                    composite::<K, DEPTHS>(splat, &groups, g, maps);
                }
            }
            maps.pairs += pixels.iter().sum::<f32>() as u64;
        }
    }
}

/// Adds a splat to the eight pixels of its group `g`.
#[inline(always)]
fn composite<const K: usize, const DEPTHS: bool>(
    splat: &TileSplat<K>,
    groups: &Groups,
    g: usize,
    maps: &mut TileMaps<K>,
) {
    let (at, depth_at_row) = (groups.place(g), groups.depth[g]);
    let mut t = load(&maps.transmittance, at);
    let mut depth = load(&maps.depth, at);
    let mut w = [0.0; LANES];
    let mut z = [0.0; LANES];
    for l in 0..LANES {
        w[l] = t[l] * groups.alpha[g][l];
        z[l] = depth_at_row + splat.slope[0] * groups.offset(g, l);
        depth[l] += w[l] * z[l];
    }
    if DEPTHS {
        let mut square = load(&maps.depth_square, at);
        for l in 0..LANES {
            square[l] += (w[l] * z[l]) * z[l];
        }
        store(&mut maps.depth_square, at, square);
        for (plane, left) in maps.depth_quantiles.iter_mut().zip(QUANTILES) {
            let mut quantile = load(plane, at);
            for l in 0..LANES {
                // Zeros and ones instead of a choice, which would be stored through a mask: slow on many processors.
                let here = if t[l] > left && w[l] > 0.0 { 1.0 } else { 0.0 };
                quantile[l] = here * z[l] + (1.0 - here) * quantile[l];
            }
            store(plane, at, quantile);
        }
    }
    for l in 0..LANES {
        t[l] -= w[l];
    }
    store(&mut maps.transmittance, at, t);
    store(&mut maps.depth, at, depth);
    for k in 0..K {
        let mut lane = load(&maps.channels[k], at);
        for l in 0..LANES {
            lane[l] += w[l] * splat.values[k];
        }
        store(&mut maps.channels[k], at, lane);
    }
}
