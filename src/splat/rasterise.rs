//! Rasterising K channels, forward and backward: tiles in parallel, results in fixed places and fixed order.

use super::bins::{Bins, TILE};
use super::kernel::{self, GEOMETRY, PIXELS, TileFrame, TileGradients, TileMaps};
use super::project::{Projected, Splat, SplatGradient};
use rayon::prelude::*;

/// Channel counts that are compiled; a request is rounded up to the next one.
pub const CHANNEL_COUNTS: [usize; 9] = [0, 1, 4, 5, 7, 8, 10, 12, 16];

/// The compiled channel count that holds `channels`.
///
/// # Panics
/// When `channels` is beyond the largest compiled count; scene models are written against that list.
pub fn padded_channels(channels: usize) -> usize {
    CHANNEL_COUNTS
        .into_iter()
        .find(|&k| k >= channels)
        .expect("a scene model asks for at most 16 channels")
}

/// What a view looks like: composited maps, `[row][column]` planes.
#[derive(Debug, Clone, Default)]
pub struct Maps {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Composited channels `Σ w f`, one plane each.
    pub channels: Vec<Vec<f32>>,
    /// Accumulated alpha `Σ w`.
    pub alpha: Vec<f32>,
    /// `Σ w z`, metres; divide by alpha for the expected depth.
    pub depth: Vec<f32>,
    /// `Σ w z²`, metres².
    pub depth_square: Vec<f32>,
    /// Depth at which half of the light is absorbed, metres; NaN where nothing is.
    pub median_depth: Vec<f32>,
    /// (splat, pixel) pairs evaluated.
    pub pairs: u64,
}

/// Gradients of a loss to [`Maps`]; same planes.
#[derive(Debug, Clone, Default)]
pub struct MapGradients {
    /// To the channels.
    pub channels: Vec<Vec<f32>>,
    /// To the accumulated alpha.
    pub alpha: Vec<f32>,
    /// To `Σ w z`.
    pub depth: Vec<f32>,
    /// To `Σ w z²`.
    pub depth_square: Vec<f32>,
}

impl MapGradients {
    /// All zero, for `channels` planes of `pixels`.
    pub fn zeros(channels: usize, pixels: usize) -> Self {
        Self {
            channels: vec![vec![0.0; pixels]; channels],
            alpha: vec![0.0; pixels],
            depth: vec![0.0; pixels],
            depth_square: vec![0.0; pixels],
        }
    }
}

/// Gradients to the splats and to their features.
#[derive(Debug, Clone, Default)]
pub struct SplatGradients {
    /// One record per splat.
    pub splats: Vec<SplatGradient>,
    /// `[splat][channel]`, with the padded channel count.
    pub features: Vec<f32>,
}

/// A view binned and ready to be composited.
#[derive(Debug, Clone)]
pub struct Rasteriser<'a> {
    projected: &'a Projected,
    bins: Bins,
    width: usize,
    height: usize,
}

impl<'a> Rasteriser<'a> {
    /// Bins `projected` for an image of `width × height` pixels.
    pub fn new(projected: &'a Projected, width: usize, height: usize) -> Self {
        Self {
            bins: Bins::new(&projected.splats, width, height),
            projected,
            width,
            height,
        }
    }

    /// Composites `features` (`[splat][channel]`, `channels` a compiled count).
    ///
    /// # Panics
    /// When `channels` is not in [`CHANNEL_COUNTS`] or `features` has another size.
    pub fn forward(&self, features: &[f32], channels: usize) -> Maps {
        assert_eq!(features.len(), self.projected.splats.len() * channels);
        dispatch!(channels, K => self.forward_k::<K>(features))
    }

    /// Gradients of the splats and features from those of the maps that [`Self::forward`] made.
    ///
    /// # Panics
    /// As [`Self::forward`].
    pub fn backward(&self, features: &[f32], channels: usize, maps: &Maps, grads: &MapGradients) -> SplatGradients {
        assert_eq!(features.len(), self.projected.splats.len() * channels);
        dispatch!(channels, K => self.backward_k::<K>(features, maps, grads))
    }

    fn frame(&self, tile: usize) -> TileFrame {
        let (col0, row0) = (tile % self.bins.columns * TILE, tile / self.bins.columns * TILE);
        TileFrame {
            col0: col0 as f32,
            row0: row0 as f32,
            width: TILE.min(self.width - col0),
            height: TILE.min(self.height - row0),
        }
    }

    fn forward_k<const K: usize>(&self, features: &[f32]) -> Maps {
        let tiles: Vec<Box<TileMaps<K>>> = (0..self.bins.tiles())
            .into_par_iter()
            .map(|tile| {
                let mut maps = Box::new(TileMaps::<K>::new());
                kernel::forward(
                    self.bins.tile(tile),
                    &self.projected.splats,
                    features,
                    &self.frame(tile),
                    &mut maps,
                );
                maps
            })
            .collect();
        let gather = |pick: &(dyn Fn(&TileMaps<K>) -> &[f32; PIXELS] + Sync)| self.assemble(|tile| pick(&tiles[tile]));
        let mut alpha = gather(&|t| &t.transmittance);
        for a in &mut alpha {
            *a = 1.0 - *a;
        }
        Maps {
            width: self.width,
            height: self.height,
            channels: (0..K).map(|k| gather(&|t| &t.channels[k])).collect(),
            alpha,
            depth: gather(&|t| &t.depth),
            depth_square: gather(&|t| &t.depth_square),
            median_depth: gather(&|t| &t.median_depth),
            pairs: tiles.iter().map(|t| t.pairs).sum(),
        }
    }

    /// A plane of the image from the tiles' planes.
    fn assemble<'t>(&self, tile_plane: impl Fn(usize) -> &'t [f32; PIXELS] + Sync) -> Vec<f32> {
        let mut plane = vec![0.0; self.width * self.height];
        plane
            .par_chunks_mut(self.width * TILE)
            .enumerate()
            .for_each(|(tile_row, band)| {
                for tile_column in 0..self.bins.columns {
                    let tile = tile_row * self.bins.columns + tile_column;
                    let frame = self.frame(tile);
                    let values = tile_plane(tile);
                    for r in 0..frame.height {
                        let start = r * self.width + tile_column * TILE;
                        band[start..start + frame.width].copy_from_slice(&values[r * TILE..r * TILE + frame.width]);
                    }
                }
            });
        plane
    }

    /// The part of an image plane that a tile covers; zero outside the image.
    fn cut(&self, plane: &[f32], tile: usize, out: &mut [f32; PIXELS]) {
        let frame = self.frame(tile);
        for r in 0..frame.height {
            let start = (frame.row0 as usize + r) * self.width + frame.col0 as usize;
            out[r * TILE..r * TILE + frame.width].copy_from_slice(&plane[start..start + frame.width]);
        }
    }

    fn tile_gradients<const K: usize>(&self, tile: usize, maps: &Maps, grads: &MapGradients) -> Box<TileGradients<K>> {
        let mut out = Box::new(TileGradients {
            channels: [[0.0; PIXELS]; K],
            alpha: [0.0; PIXELS],
            depth: [0.0; PIXELS],
            depth_square: [0.0; PIXELS],
            total: [0.0; PIXELS],
        });
        let mut value = [0.0; PIXELS];
        let mut total = [0.0; PIXELS];
        let mut add = |plane: &[f32], gradient: &[f32], into: &mut [f32; PIXELS]| {
            self.cut(gradient, tile, into);
            self.cut(plane, tile, &mut value);
            for ((t, v), g) in total.iter_mut().zip(&value).zip(into.iter()) {
                *t += v * g;
            }
        };
        for k in 0..K {
            // A padded channel has no gradient plane.
            if let Some(gradient) = grads.channels.get(k) {
                add(&maps.channels[k], gradient, &mut out.channels[k]);
            }
        }
        add(&maps.alpha, &grads.alpha, &mut out.alpha);
        add(&maps.depth, &grads.depth, &mut out.depth);
        add(&maps.depth_square, &grads.depth_square, &mut out.depth_square);
        out.total = total;
        out
    }

    fn backward_k<const K: usize>(&self, features: &[f32], maps: &Maps, grads: &MapGradients) -> SplatGradients {
        let width = K + GEOMETRY;
        let mut records = vec![0.0f32; self.bins.list.len() * width];
        let mut parts = Vec::with_capacity(self.bins.tiles());
        let mut left = records.as_mut_slice();
        for tile in 0..self.bins.tiles() {
            let (part, remaining) = left.split_at_mut(self.bins.tile(tile).len() * width);
            parts.push(part);
            left = remaining;
        }
        let splats = &self.projected.splats;
        parts.into_par_iter().enumerate().for_each(|(tile, part)| {
            let list = self.bins.tile(tile);
            if !list.is_empty() {
                let gradients = self.tile_gradients::<K>(tile, maps, grads);
                kernel::backward(list, splats, features, &self.frame(tile), &gradients, part);
            }
        });
        let mut out = SplatGradients {
            splats: vec![SplatGradient::default(); splats.len()],
            features: vec![0.0; splats.len() * K],
        };
        // One chunk of a length that never is zero, also without channels.
        let feature_chunks = out.features.par_chunks_mut(K.max(1));
        let reduce = |s: usize, feature: &mut [f32]| {
            let mut sums = [0.0f32; GEOMETRY];
            for &place in &self.bins.slots[self.bins.slot_starts[s] as usize..self.bins.slot_starts[s + 1] as usize] {
                let record = &records[place as usize * width..(place as usize + 1) * width];
                for (slot, value) in feature.iter_mut().zip(&record[..K]) {
                    *slot += value;
                }
                for (slot, value) in sums.iter_mut().zip(&record[K..]) {
                    *slot += value;
                }
            }
            splat_gradient(&splats[s], &sums)
        };
        if K == 0 {
            out.splats
                .par_iter_mut()
                .enumerate()
                .for_each(|(s, slot)| *slot = reduce(s, &mut []));
        } else {
            out.splats
                .par_iter_mut()
                .zip(feature_chunks)
                .enumerate()
                .for_each(|(s, (slot, f))| *slot = reduce(s, f));
        }
        out
    }
}

/// A splat's gradient from the nine sums that the kernel gathers.
fn splat_gradient(splat: &Splat, sums: &[f32; GEOMETRY]) -> SplatGradient {
    let [h, hx, hy, hxx, hxy, hyy, m, mx, my] = *sums;
    let [a, b, c] = splat.conic;
    SplatGradient {
        col: a * hx + b * hy - splat.slope[0] * m,
        row: b * hx + c * hy - splat.slope[1] * m,
        conic: [-0.5 * hxx, -hxy, -0.5 * hyy],
        opacity: h / splat.opacity,
        depth: m,
        slope: [mx, my],
        normal: [0.0; 3],
    }
}

/// Runs a block with a constant `K` equal to one of [`CHANNEL_COUNTS`].
macro_rules! dispatch {
    ($channels:expr, $k:ident => $body:expr) => {
        dispatch!(@arms $channels, $k, $body, 0 1 4 5 7 8 10 12 16)
    };
    (@arms $channels:expr, $k:ident, $body:expr, $($n:literal)*) => {
        match $channels {
            $($n => { const $k: usize = $n; $body })*
            other => panic!("{other} channels are not compiled; see CHANNEL_COUNTS"),
        }
    };
}
use dispatch;
