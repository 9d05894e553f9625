//! Rasterising K channels, forward and backward: tiles in parallel, results in fixed places and fixed order.

use super::bins::{Bins, TILE_HEIGHT, TILE_WIDTH};
use super::kernel::{self, GEOMETRY, PLANE, STRIDE, TileFrame, TileGradients, TileMaps};
use super::project::{Projected, Splat, SplatGradient};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::{Mutex, PoisonError};

/// Channel counts that are compiled; a request is rounded up to the next one. The last is for renderings, where normals
/// follow the channels of a model.
pub const CHANNEL_COUNTS: [usize; 10] = [0, 1, 4, 5, 7, 8, 10, 12, 16, 20];

/// Most channels of a model and of a backward pass.
pub const MOST_CHANNELS: usize = CHANNEL_COUNTS[CHANNEL_COUNTS.len() - 2];

/// The compiled channel count that holds `channels`.
///
/// # Panics
/// When `channels` is beyond the largest compiled count; scene models are written against that list.
pub fn padded_channels(channels: usize) -> usize {
    CHANNEL_COUNTS
        .into_iter()
        .find(|&k| k >= channels)
        .expect("a scene model has at most 16 channels, and normals three")
}

/// Composited depths along rays besides their mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Depths {
    /// No other depths, as in training.
    #[default]
    Mean,
    /// Squared depths and quantiles, for the spread along a ray, and the median depth, where half of the ray's light is
    /// left; for products.
    Median,
}

/// Composited maps of a view, `[row][column]` planes.
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
    /// `Σ w z²`, metres²; empty unless all depths are composited.
    pub depth_square: Vec<f32>,
    /// Depth where 0.84 of the ray's light is left, metres: one standard deviation before the median if the depths
    /// along the ray are normally distributed. NaN and empty as `median_depth`.
    pub near_depth: Vec<f32>,
    /// Depth where half of the ray's light is left, or of its last splat, metres; NaN where there is no splat. Empty
    /// unless all depths are composited.
    pub median_depth: Vec<f32>,
    /// Depth where 0.16 of the ray's light is left, metres: one standard deviation behind the median if the depths
    /// along the ray are normally distributed. NaN and empty as `median_depth`.
    pub far_depth: Vec<f32>,
    /// Number of (splat, pixel) pairs: pixels inside the footprints of the splats, up to where a tile is opaque.
    pub pairs: u64,
}

/// Gradients of a loss to [`Maps`], in planes of the same size.
#[derive(Debug, Clone, Default)]
pub struct MapGradients {
    /// Gradients to the channels, one plane each.
    pub channels: Vec<Vec<f32>>,
    /// Gradient to the accumulated alpha.
    pub alpha: Vec<f32>,
    /// Gradient to `Σ w z`.
    pub depth: Vec<f32>,
}

impl MapGradients {
    /// Zero gradients, for `channels` planes of `pixels` pixels.
    pub fn zeros(channels: usize, pixels: usize) -> Self {
        Self {
            channels: (0..channels).into_par_iter().map(|_| vec![0.0; pixels]).collect(),
            alpha: vec![0.0; pixels],
            depth: vec![0.0; pixels],
        }
    }
}

/// Gradients to the splats and to their features.
#[derive(Debug, Clone, Default)]
pub struct SplatGradients {
    /// Gradient to each splat.
    pub splats: Vec<SplatGradient>,
    /// Gradients to the features, `[splat][channel]`, with the padded channel count.
    pub features: Vec<f32>,
}

/// A row of tiles in every plane of [`Maps`].
struct Band<'m> {
    channels: Vec<&'m mut [f32]>,
    alpha: &'m mut [f32],
    depth: &'m mut [f32],
    depth_square: Option<&'m mut [f32]>,
    depth_quantiles: [Option<&'m mut [f32]>; 3],
}

/// A view binned and ready to be composited.
#[derive(Debug, Clone)]
pub struct Rasteriser<'a> {
    projected: &'a Projected,
    bins: Cow<'a, Bins>,
    width: usize,
    height: usize,
    depths: Depths,
}

impl<'a> Rasteriser<'a> {
    /// Bins `projected` for an image of `width × height` pixels.
    pub fn new(projected: &'a Projected, width: usize, height: usize) -> Self {
        Self {
            bins: Cow::Owned(Bins::new(&projected.splats, width, height)),
            projected,
            width,
            height,
            depths: Depths::Mean,
        }
    }

    /// A rasteriser with the bins of an earlier one of the same splats and size.
    pub fn with_bins(projected: &'a Projected, bins: &'a Bins, width: usize, height: usize) -> Self {
        Self {
            bins: Cow::Borrowed(bins),
            projected,
            width,
            height,
            depths: Depths::Mean,
        }
    }

    /// This rasteriser, with `depths` as the composited depths.
    pub fn with_depths(self, depths: Depths) -> Self {
        Self { depths, ..self }
    }

    /// Takes the bins out, for a later [`Self::with_bins`].
    pub fn into_bins(self) -> Bins {
        self.bins.into_owned()
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
    /// When `channels` is not in [`CHANNEL_COUNTS`] or beyond [`MOST_CHANNELS`], or `features` has another size.
    pub fn backward(&self, features: &[f32], channels: usize, maps: &Maps, grads: &MapGradients) -> SplatGradients {
        assert_eq!(features.len(), self.projected.splats.len() * channels);
        dispatch!(channels, K => self.backward_k::<K>(features, maps, grads))
    }

    fn frame(&self, tile: usize) -> TileFrame {
        let (column, row) = (tile % self.bins.columns, tile / self.bins.columns);
        let (col0, row0) = (column * TILE_WIDTH, row * TILE_HEIGHT);
        TileFrame {
            col0: col0 as f32,
            row0: row0 as f32,
            width: TILE_WIDTH.min(self.width - col0),
            height: TILE_HEIGHT.min(self.height - row0),
        }
    }

    /// Bands of tiles in parallel: a band's part of every plane is contiguous, so tiles are written in place.
    fn forward_k<const K: usize>(&self, features: &[f32]) -> Maps {
        let pixels = self.width * self.height;
        let plane = || vec![0.0f32; pixels];
        let all_depths = self.depths == Depths::Median;
        let optional_plane = || if all_depths { plane() } else { Vec::new() };
        let mut out = Maps {
            width: self.width,
            height: self.height,
            channels: (0..K).into_par_iter().map(|_| plane()).collect(),
            alpha: plane(),
            depth: plane(),
            depth_square: optional_plane(),
            near_depth: optional_plane(),
            median_depth: optional_plane(),
            far_depth: optional_plane(),
            pairs: 0,
        };
        let Maps {
            channels,
            alpha,
            depth,
            depth_square,
            near_depth,
            median_depth,
            far_depth,
            ..
        } = &mut out;
        let band = (self.width * TILE_HEIGHT).max(1);
        let mut channel_bands: Vec<_> = channels.iter_mut().map(|plane| plane.chunks_mut(band)).collect();
        let mut square_bands = depth_square.chunks_mut(band);
        let mut quantile_bands = [near_depth, median_depth, far_depth].map(|plane| plane.chunks_mut(band));
        let bands: Vec<_> = alpha
            .chunks_mut(band)
            .zip(depth.chunks_mut(band))
            .map(|(alpha, depth)| Band {
                channels: channel_bands.iter_mut().filter_map(Iterator::next).collect(),
                alpha,
                depth,
                depth_square: square_bands.next(),
                depth_quantiles: quantile_bands.each_mut().map(Iterator::next),
            })
            .collect();
        out.pairs = bands
            .into_par_iter()
            .enumerate()
            .with_max_len(1)
            .map(|(row, band)| self.forward_band::<K>(row, band, features))
            .sum();
        out
    }

    /// Composites a row of tiles; returns its pairs.
    fn forward_band<const K: usize>(&self, row: usize, mut band: Band, features: &[f32]) -> u64 {
        let mut maps = TileMaps::<K>::boxed();
        for column in 0..self.bins.columns {
            let tile = row * self.bins.columns + column;
            let frame = self.frame(tile);
            let list = self.bins.tile(tile);
            let splats = &self.projected.splats;
            match self.depths {
                Depths::Mean => kernel::forward::<K, false>(list, splats, features, &frame, &mut maps),
                Depths::Median => kernel::forward::<K, true>(list, splats, features, &frame, &mut maps),
            }
            for r in 0..frame.height {
                let start = r * self.width + column * TILE_WIDTH;
                let to = start..start + frame.width;
                let from = r * STRIDE..r * STRIDE + frame.width;
                for (plane, tile_plane) in band.channels.iter_mut().zip(&maps.channels) {
                    copy_row(&mut plane[to.clone()], &tile_plane[from.clone()]);
                }
                copy_row(&mut band.depth[to.clone()], &maps.depth[from.clone()]);
                if let Some(square) = &mut band.depth_square {
                    copy_row(&mut square[to.clone()], &maps.depth_square[from.clone()]);
                }
                let transmittance = &maps.transmittance[from.clone()];
                for (quantile, tile_plane) in band.depth_quantiles.iter_mut().zip(&maps.depth_quantiles) {
                    let Some(quantile) = quantile else { continue };
                    let found = tile_plane[from.clone()].iter().zip(transmittance);
                    for (depth, (&z, &t)) in quantile[to.clone()].iter_mut().zip(found) {
                        *depth = if t < 1.0 { z } else { f32::NAN };
                    }
                }
                for (alpha, t) in band.alpha[to].iter_mut().zip(transmittance) {
                    *alpha = 1.0 - t;
                }
            }
        }
        maps.pairs
    }

    /// Cuts the gradients of a tile, and its maps' values times them, out of the image's planes.
    fn cut_gradients<const K: usize>(
        &self,
        tile: usize,
        maps: &Maps,
        grads: &MapGradients,
        out: &mut TileGradients<K>,
    ) {
        let frame = self.frame(tile);
        let start = frame.row0 as usize * self.width + frame.col0 as usize;
        out.total.fill(0.0);
        let total = &mut out.total;
        let mut add = |plane: &[f32], gradient: &[f32], into: &mut [f32; PLANE]| {
            into.fill(0.0);
            for r in 0..frame.height {
                let from = start + r * self.width..start + r * self.width + frame.width;
                let to = r * STRIDE..r * STRIDE + frame.width;
                copy_row(&mut into[to.clone()], &gradient[from.clone()]);
                add_products(&mut total[to], &plane[from.clone()], &gradient[from]);
            }
        };
        // A padded channel has no gradient plane: it stays zero.
        for (into, (plane, gradient)) in out.channels.iter_mut().zip(maps.channels.iter().zip(&grads.channels)) {
            add(plane, gradient, into);
        }
        add(&maps.alpha, &grads.alpha, &mut out.alpha);
        add(&maps.depth, &grads.depth, &mut out.depth);
    }

    fn backward_k<const K: usize>(&self, features: &[f32], maps: &Maps, grads: &MapGradients) -> SplatGradients {
        let width = K + GEOMETRY;
        let mut records = Records::take(self.bins.list.len() * width);
        let mut parts = Vec::with_capacity(self.bins.tiles());
        let mut left = records.values();
        for tile in 0..self.bins.tiles() {
            let (part, remaining) = left.split_at_mut(self.bins.tile(tile).len() * width);
            parts.push(part);
            left = remaining;
        }
        let splats = &self.projected.splats;
        parts
            .into_par_iter()
            .enumerate()
            .for_each_init(TileGradients::<K>::boxed, |gradients, (tile, part)| {
                let list = self.bins.tile(tile);
                if !list.is_empty() {
                    self.cut_gradients(tile, maps, grads, gradients);
                    let (frame, base) = (self.frame(tile), self.bins.starts[tile]);
                    kernel::backward::<K>(list, splats, features, &frame, gradients, base, part);
                }
            });
        let records = &*records.values();
        let mut features = vec![0.0; splats.len() * K];
        let reduce = |s: usize, feature: &mut [f32]| {
            let mut sums = [0.0f32; GEOMETRY];
            for &place in self.bins.slots_of(s) {
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
        let numbers = (0..splats.len()).into_par_iter().with_min_len(1024);
        let splats = if K == 0 {
            numbers.map(|s| reduce(s, &mut [])).collect()
        } else {
            let features = features.par_chunks_mut(K.max(1));
            numbers.zip(features).map(|(s, feature)| reduce(s, feature)).collect()
        };
        SplatGradients { splats, features }
    }
}

/// Copies a tile's row; nearly all are of one length, for which no function need be called.
#[inline]
fn copy_row(to: &mut [f32], from: &[f32]) {
    if let (Ok(to), Ok(from)) = (
        <&mut [f32; TILE_WIDTH]>::try_from(&mut *to),
        <&[f32; TILE_WIDTH]>::try_from(from),
    ) {
        *to = *from;
    } else {
        to.copy_from_slice(from);
    }
}

/// `to += a · b`, by elements.
#[inline]
fn add_products(to: &mut [f32], a: &[f32], b: &[f32]) {
    let add = |((to, a), b): ((&mut f32, &f32), &f32)| *to += a * b;
    if to.len() == TILE_WIDTH && a.len() == TILE_WIDTH && b.len() == TILE_WIDTH {
        let (to, a, b) = (&mut to[..TILE_WIDTH], &a[..TILE_WIDTH], &b[..TILE_WIDTH]);
        to.iter_mut().zip(a).zip(b).for_each(add);
    } else {
        to.iter_mut().zip(a).zip(b).for_each(add);
    }
}

/// Memory for the tiles' records, kept from one backward pass to the next: clearing and freeing some ten megabytes
/// costs as much as filling them. Memory far beyond the need of a pass, as after one of more channels, is freed. Its
/// old contents are never read; every record is written first.
struct Records {
    values: Vec<f32>,
    length: usize,
}

/// Most memory that is kept, as a multiple of a pass's need. Passes of one training differ by less.
const MOST_SPARE: f64 = 1.5;

static SPARE_RECORDS: Mutex<Vec<f32>> = Mutex::new(Vec::new());

impl Records {
    fn take(length: usize) -> Self {
        let mut values = std::mem::take(&mut *SPARE_RECORDS.lock().unwrap_or_else(PoisonError::into_inner));
        if values.len() as f64 > MOST_SPARE * length as f64 {
            values = Vec::new();
        }
        if values.len() < length {
            values.resize(length, 0.0);
        }
        Self { values, length }
    }

    fn values(&mut self) -> &mut [f32] {
        &mut self.values[..self.length]
    }
}

impl Drop for Records {
    fn drop(&mut self) {
        *SPARE_RECORDS.lock().unwrap_or_else(PoisonError::into_inner) = std::mem::take(&mut self.values);
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
        dispatch!(@arms $channels, $k, $body, 0 1 4 5 7 8 10 12 16 20)
    };
    (@arms $channels:expr, $k:ident, $body:expr, $($n:literal)*) => {
        match $channels {
            $($n => { const $k: usize = $n; $body })*
            other => panic!("{other} channels are not compiled; see CHANNEL_COUNTS"),
        }
    };
}
use dispatch;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::ProjectiveCamera;
    use crate::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups, logit};
    use crate::splat::project::{ProjectionOptions, project};

    /// Median depth in the middle of a wide roof of an opacity, 6 m above opaque ground, seen from above.
    fn seen_below(opacity: f32) -> f32 {
        let mut table = Table::zeros(core_groups(), 2);
        table.group_mut(POSITION)[2] = 6.0;
        table
            .group_mut(LOG_SCALE)
            .copy_from_slice(&[3.0, 3.0, -3.0, 3.0, 3.0, -3.0]);
        table
            .group_mut(ROTATION)
            .copy_from_slice(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        table
            .group_mut(OPACITY)
            .copy_from_slice(&[logit(opacity), logit(0.999)]);
        let camera = ProjectiveCamera::nadir(-4.0, 4.0, 1.0, (9, 9));
        let projected = project(&table, &camera, &ProjectionOptions::default());
        let features = vec![0.0; projected.splats.len() * padded_channels(1)];
        let seen = Rasteriser::new(&projected, 9, 9).with_depths(Depths::Median);
        seen.forward(&features, padded_channels(1)).median_depth[40]
    }

    #[test]
    fn what_is_half_transparent_is_no_surface() {
        assert!((seen_below(0.5) - 0.0).abs() < 1e-3);
        assert!((seen_below(0.8) + 6.0).abs() < 1e-3);
    }
}
