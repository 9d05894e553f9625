//! Colours of the tiles of an area, found once for all of it. A model determines its albedo up to one gain per band, so
//! that each tile is multiplied by the gains with which overlapping tiles agree best. Relit images are brought to one
//! light.

use super::blocks::{common, overlap};
use super::layers::{ALBEDO, Layer};
use super::mosaic::{Parts, Places};
use super::plan::{MosaicTile, RUN};
use super::{BatchError, Result};
use heliosplat_products::export::Reference;
use heliosplat_products::model;
use heliosplat_products::relit_light::BandLight;
use heliosplat_raster::bounded::read_bytes;
use heliosplat_raster::{RasterError, write_atomically};
use heliosplat_rpc::sun::SunPosition;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

/// Name of the file of the colours of all tiles.
pub(super) const FILE: &str = "colours.json";
/// Fraction of the initial squared residual at which the solver stops: 1e-10 of the initial residual.
const SETTLED: f64 = 1e-20;
/// Most steps of the solver per tile; without rounding errors, one step per tile suffices.
const MOST_STEPS_PER_TILE: usize = 4;
/// Largest size of that file, bytes.
const FILE_MAX: u64 = 1 << 30;

/// Colours that all blocks of an area share.
#[derive(Debug, Default, serde::Serialize, serde::Deserialize)]
pub(super) struct Colours {
    /// Gains of the albedo by tile and band.
    gains: BTreeMap<String, Vec<f64>>,
    /// Light of the relit images of all tiles, band by band; `None` without such images.
    pub(super) relit: Option<Vec<BandLight>>,
    /// Look of the 3D Tiles of all blocks, if they are written.
    pub(super) reference: Option<Reference>,
}

/// Ratio of a band in the overlap of two tiles: their indices, logarithm of first over second, number of cells.
type Ratio = (usize, usize, f64, usize);

impl Colours {
    /// Finds the gains of the albedo of all tiles, whose geometric mean over the tiles is 1 for each band, and the mean
    /// light of their images relit under `sun`.
    ///
    /// # Errors
    /// When a raster or a model of a tile cannot be read.
    pub(super) fn find(out: &Path, tiles: &[MosaicTile], gsd_m: f64, sun: Option<&SunPosition>) -> Result<Self> {
        let has_surface = |tile: &&MosaicTile| out.join(&tile.unit).join("dsm.tif").is_file();
        let tiles: Vec<&MosaicTile> = tiles.iter().filter(has_surface).collect();
        let of_pair = |(a, b)| Ok(((a, b), ratios(out, [tiles[a], tiles[b]], gsd_m)?));
        let ratios = overlaps(&tiles).into_par_iter().map(of_pair);
        let ratios = ratios.collect::<Result<Vec<_>>>()?;
        let bands = ratios.iter().map(|(_, ratios)| ratios.len()).max().unwrap_or(0);
        let mut gains = vec![vec![1.0; bands]; tiles.len()];
        for band in 0..bands {
            let of_band = ratios.iter().filter_map(|&((a, b), ref ratios)| {
                let (log, cells) = ratios.get(band).copied().flatten()?;
                Some((a, b, log, cells))
            });
            let of_band: Vec<Ratio> = of_band.collect();
            for (gains, log) in gains.iter_mut().zip(balanced_gains(&of_band, tiles.len())) {
                gains[band] = log.exp();
            }
        }
        let mut lights = Vec::with_capacity(tiles.len());
        if let Some(sun) = sun {
            for tile in &tiles {
                lights.extend(BandLight::of(&model::load_file(&out.join(&tile.unit).join(RUN))?, sun));
            }
        }
        Ok(Self {
            gains: tiles.iter().map(|tile| tile.unit.clone()).zip(gains).collect(),
            relit: BandLight::mean(&lights),
            reference: None,
        })
    }

    /// Gains of the albedo of some tiles, band by band.
    pub(super) fn gains<'t>(&self, tiles: impl Iterator<Item = &'t str>) -> Vec<Vec<f64>> {
        let of_tile = |tile| self.gains.get(tile).cloned().unwrap_or_default();
        tiles.map(of_tile).collect()
    }

    /// Reads a file that [`Self::write`] wrote.
    ///
    /// # Errors
    /// When it cannot be read or is damaged.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let failed = |reason: String| BatchError::Failed(format!("{}: {reason}", path.display()));
        let bytes = read_bytes(path, FILE_MAX).map_err(|error| failed(error.to_string()))?;
        serde_json::from_slice(&bytes).map_err(|error| failed(error.to_string()))
    }

    /// Writes the colours as JSON.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(super) fn write(&self, path: &Path) -> Result<(), RasterError> {
        let text = serde_json::to_string(self).unwrap_or_default();
        write_atomically(path, text.as_bytes())
    }
}

/// Pairs of tiles with common ground, in the order of their indices.
fn overlaps(tiles: &[&MosaicTile]) -> Vec<(usize, usize)> {
    let mut from_west: Vec<usize> = (0..tiles.len()).collect();
    from_west.sort_by(|&a, &b| tiles[a].bounds[0].total_cmp(&tiles[b].bounds[0]));
    let mut pairs = Vec::new();
    for (place, &a) in from_west.iter().enumerate() {
        let others = from_west[place + 1..].iter();
        // Tiles that begin east of this one's end have nothing in common with it.
        let beside = others.take_while(|&&b| tiles[b].bounds[0] < tiles[a].bounds[2]);
        let common = beside.filter(|&&b| overlap(&tiles[a].bounds, &tiles[b].bounds));
        pairs.extend(common.map(|&b| (a.min(b), a.max(b))));
    }
    pairs.sort_unstable();
    pairs
}

/// Ratios of the albedo of two tiles in their overlap, band by band; only the overlap is read.
fn ratios(out: &Path, pair: [&MosaicTile; 2], gsd_m: f64) -> Result<Vec<Option<(f64, usize)>>> {
    let [a, b] = pair.map(|tile| tile.bounds);
    let common = common(a, b);
    let places = Places::of(common, gsd_m);
    let mut parts = Parts::default();
    for tile in pair {
        parts.read(out, tile, &places, places.span(common))?;
    }
    if parts.pieces.len() < 2 {
        return Ok(Vec::new());
    }
    Ok(Layer::read(out, &parts, ALBEDO)?.ratios(&parts.pieces, gsd_m as f32))
}

/// Natural logarithms of the gains of tiles: least-squares solution of `x_a - x_b = -log(a / b)` over the compared
/// cells, by conjugate gradients (Hestenes and Stiefel 1952). The solver starts at zero, so that the mean over each
/// connected group of overlapping tiles stays zero.
fn balanced_gains(ratios: &[Ratio], count: usize) -> Vec<f64> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut logs = vec![0.0; count];
    let mut residual = vec![0.0; count];
    for &(a, b, log, cells) in ratios {
        residual[a] -= cells as f64 * log;
        residual[b] += cells as f64 * log;
    }
    let mut direction = residual.clone();
    let mut size = dot(&residual, &residual);
    let small = SETTLED * size;
    for _ in 0..MOST_STEPS_PER_TILE * count {
        if size <= small {
            break;
        }
        let mut image = vec![0.0; count];
        for &(a, b, _, cells) in ratios {
            let flow = cells as f64 * (direction[a] - direction[b]);
            image[a] += flow;
            image[b] -= flow;
        }
        let step = size / dot(&direction, &image);
        for k in 0..count {
            logs[k] += step * direction[k];
            residual[k] -= step * image[k];
        }
        let next = dot(&residual, &residual);
        for (direction, residual) in direction.iter_mut().zip(&residual) {
            *direction = residual + next / size * *direction;
        }
        size = next;
    }
    logs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_of_ten_thousand_tiles_are_found() {
        const SIDE: usize = 100;
        // A slope across the area and a ripple: the lowest and the highest spatial frequency of the gains.
        let gain = |k: usize| 0.01 * (k % SIDE) as f64 - 0.02 * (k / SIDE) as f64 + 0.1 * ((7 * k) % 11) as f64;
        let mean = (0..SIDE * SIDE).map(gain).sum::<f64>() / (SIDE * SIDE) as f64;
        let mut ratios = Vec::new();
        for k in 0..SIDE * SIDE {
            let pairs = [(k % SIDE + 1 < SIDE, k + 1, 2000), (k / SIDE + 1 < SIDE, k + SIDE, 90)];
            let there = pairs.into_iter().filter(|(there, ..)| *there);
            ratios.extend(there.map(|(_, other, cells)| (k, other, gain(other) - gain(k), cells)));
        }
        let found = balanced_gains(&ratios, SIDE * SIDE);
        for (k, found) in found.iter().enumerate() {
            assert!((found - (gain(k) - mean)).abs() < 1e-6, "{k}: {found}");
        }
    }

    #[test]
    fn each_two_tiles_with_common_ground_are_a_pair_once() {
        let tile = |west: f64, south: f64| MosaicTile {
            unit: String::new(),
            core: [0.0; 4],
            bounds: [west, south, west + 12.0, south + 12.0],
        };
        let tiles = [
            tile(10.0, 10.0),
            tile(0.0, 0.0),
            tile(10.0, 0.0),
            tile(20.0, 10.0),
            tile(40.0, 0.0),
        ];
        let tiles: Vec<&MosaicTile> = tiles.iter().collect();
        assert_eq!(overlaps(&tiles), [(0, 1), (0, 2), (0, 3), (1, 2), (2, 3)]);
    }
}
