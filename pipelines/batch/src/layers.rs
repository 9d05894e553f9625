//! Rasters other than the surface model, merged from tiles with the blending weights of their surface models. Tiles
//! that show another surface at a cell have no weight there.
//!
//! A model determines its colours up to one gain per band. Before albedos are merged, each tile is multiplied by the
//! gains that minimise the differences in the overlaps.

use super::BatchError;
use heliosplat::Raster;
use heliosplat_grid::statistics::upper_median;
use heliosplat_products::blend::{Piece, in_row, one_surface};
use heliosplat_raster::{RasterError, RasterFile};
use rayon::prelude::*;
use std::path::Path;

/// Approximate number of cells of an overlap that are compared in each direction.
const COMPARED: isize = 300;
/// Fewest compared cells of an overlap from which a ratio is estimated.
const LEAST_CELLS: usize = 50;
/// Colours at or below this value give no ratio.
const DARK: f32 = 1e-4;
/// Fraction of the initial squared residual at which the solver stops: 1e-10 of the initial residual.
const SETTLED: f64 = 1e-20;
/// Most steps of the solver per tile; without rounding errors, one step per tile suffices.
const MOST_STEPS_PER_TILE: usize = 4;

/// One raster of each tile, in the order of the pieces; `None` for tiles without it.
pub struct Layer {
    rasters: Vec<Option<Raster>>,
}

/// Rule that merges the rasters of overlapping tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Merge {
    /// Weighted mean.
    Mean,
    /// Weighted majority of a mask: 1 or 0.
    Majority,
    /// Value of the tile with the largest weight, for rasters without a mean, such as days.
    Heaviest,
}

impl Layer {
    /// Reads the raster `name` of every tile below `out`.
    ///
    /// # Errors
    /// When a file is damaged or not on the grid of its tile's surface model.
    pub fn read(out: &Path, pieces: &[Piece], name: &str) -> Result<Self, BatchError> {
        let read = |piece: &Piece| -> Result<Option<Raster>, BatchError> {
            let path = out.join(&piece.unit).join(name);
            if !path.is_file() {
                return Ok(None);
            }
            let raster = RasterFile::open(&path)?.read_all()?;
            if (raster.width, raster.height) != (piece.raster.width, piece.raster.height) {
                return Err(RasterError::Damaged {
                    path,
                    reason: "it is not on the grid of its surface model".into(),
                }
                .into());
            }
            Ok(Some(raster))
        };
        let rasters = pieces.iter().map(read).collect::<Result<_, _>>()?;
        Ok(Self { rasters })
    }

    /// Number of bands that all rasters have; 0 without rasters.
    fn bands(&self) -> usize {
        self.rasters
            .iter()
            .flatten()
            .map(|raster| raster.bands)
            .min()
            .unwrap_or(0)
    }

    fn value(&self, pieces: &[Piece], index: usize, band: usize, (col, row): (isize, isize)) -> f32 {
        let raster = self.rasters[index].as_ref();
        raster.map_or(f32::NAN, |raster| pieces[index].value_of(raster, band, col, row))
    }

    /// Multiplies every band of every tile by the gain with which overlapping tiles agree best, and returns the gains
    /// by tile and band. Their geometric mean over the tiles is 1 for each band.
    pub fn balance(&mut self, pieces: &[Piece], gsd_m: f32) -> Vec<Vec<f64>> {
        let bands = self.bands();
        let mut gains = vec![vec![1.0; bands]; self.rasters.len()];
        for band in 0..bands {
            let ratios = self.ratios(pieces, band, gsd_m);
            let logs = balanced_gains(&ratios, self.rasters.len());
            for (raster, (log, gain)) in self.rasters.iter_mut().zip(logs.iter().zip(&mut gains)) {
                gain[band] = log.exp();
                let Some(raster) = raster else { continue };
                raster.plane_mut(band).iter_mut().for_each(|v| *v *= gain[band] as f32);
            }
        }
        gains
    }

    /// Ratios of a band in the overlaps of tiles, over cells where both tiles show one surface: indices of the two
    /// tiles, median of the natural logarithm of first over second, number of cells.
    fn ratios(&self, pieces: &[Piece], band: usize, gsd_m: f32) -> Vec<(usize, usize, f64, usize)> {
        let span = |a: usize, b: usize, axis: usize| {
            let (p, q) = (pieces[a].bounds[axis], pieces[b].bounds[axis]);
            (p[0].max(q[0]), p[1].min(q[1]))
        };
        let overlap = |a: usize, b: usize| [0, 1].into_iter().all(|axis| span(a, b, axis).0 < span(a, b, axis).1);
        let after = |a: usize| (a + 1..pieces.len()).map(move |b| (a, b));
        let pairs: Vec<(usize, usize)> = (0..pieces.len())
            .flat_map(after)
            .filter(|&(a, b)| overlap(a, b))
            .collect();
        let told = pairs.into_par_iter().filter_map(|(a, b)| {
            let ((left, right), (top, bottom)) = (span(a, b, 0), span(a, b, 1));
            let step = |from: isize, to: isize| ((to - from) / COMPARED).max(1) as usize;
            let mut logs = Vec::new();
            let mut said = Vec::new();
            for row in (top..bottom).step_by(step(top, bottom)) {
                for col in (left..right).step_by(step(left, right)) {
                    one_surface(&mut said, (pieces, &[a, b]), (col, row), gsd_m);
                    let [p, q] = [a, b].map(|index| self.value(pieces, index, band, (col, row)));
                    if said.len() == 2 && p > DARK && q > DARK {
                        logs.push(f64::from(p / q).ln());
                    }
                }
            }
            if logs.len() < LEAST_CELLS {
                return None;
            }
            let cells = logs.len();
            Some((a, b, upper_median(&mut logs)?, cells))
        });
        told.collect()
    }

    /// Raster of `width` by `height` cells, merged from all tiles; NaN at cells without a value.
    pub fn merged(&self, pieces: &[Piece], (width, height): (usize, usize), gsd_m: f32, merge: Merge) -> Raster {
        let bands = self.bands();
        let mut out = Raster::filled(width, height, bands, f32::NAN);
        for band in 0..bands {
            let rows = out.plane_mut(band).par_chunks_mut(width).enumerate();
            rows.for_each(|(row, values)| {
                let row = row as isize;
                let here = in_row(pieces, row);
                let mut said = Vec::with_capacity(4);
                for (col, value) in values.iter_mut().enumerate() {
                    let at = (col as isize, row);
                    one_surface(&mut said, (pieces, &here), at, gsd_m);
                    let (mut sum, mut weight) = (0.0, 0.0);
                    let (mut heaviest, mut most) = (f32::NAN, 0.0);
                    for one in &said {
                        let own = self.value(pieces, one.piece, band, at);
                        if own.is_finite() {
                            sum += one.weight * own;
                            weight += one.weight;
                            if one.weight > most {
                                (heaviest, most) = (own, one.weight);
                            }
                        }
                    }
                    if weight > 0.0 {
                        *value = match merge {
                            Merge::Mean => sum / weight,
                            Merge::Heaviest => heaviest,
                            Merge::Majority => f32::from(u8::from(sum > 0.5 * weight)),
                        };
                    }
                }
            });
        }
        out
    }
}

/// Natural logarithms of the gains of tiles: least-squares solution of `x_a - x_b = -log(a / b)` over the compared
/// cells, by conjugate gradients (Hestenes and Stiefel 1952). The solver starts at zero, so that the mean over each
/// connected group of overlapping tiles stays zero.
fn balanced_gains(ratios: &[(usize, usize, f64, usize)], count: usize) -> Vec<f64> {
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

    /// Two tiles of 30 x 20 cells of level ground whose cores meet at column 20, and a layer of one value per tile.
    fn pair(values: [f32; 2]) -> (Vec<Piece>, Layer) {
        let piece = |at: isize, core: [isize; 2], bounds: [isize; 2]| {
            let mut raster = Raster::filled(30, 20, 4, 100.0);
            raster.plane_mut(1).fill(0.2);
            Piece {
                unit: format!("t{at}"),
                raster,
                at: [at, 0],
                core: [core, [0, 20]],
                bounds: [bounds, [0, 20]],
            }
        };
        let layer = Layer {
            rasters: values.map(|v| Some(Raster::filled(30, 20, 1, v))).to_vec(),
        };
        (vec![piece(0, [0, 20], [0, 30]), piece(10, [20, 40], [10, 40])], layer)
    }

    #[test]
    fn colours_of_tiles_with_other_gains_meet_without_a_seam() {
        let (pieces, mut layer) = pair([0.2, 0.4]);
        let gains = layer.balance(&pieces, 0.5);
        assert!((gains[0][0] - 2f64.sqrt()).abs() < 1e-6 && (gains[0][0] * gains[1][0] - 1.0).abs() < 1e-9);
        let merged = layer.merged(&pieces, (40, 20), 0.5, Merge::Mean);
        let expected = 0.2 * 2f32.sqrt();
        assert!(merged.values.iter().all(|v| (v - expected).abs() < 1e-5));
    }

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
    fn shadows_stay_yes_or_no_and_the_tile_that_is_nearer_says() {
        let (pieces, layer) = pair([1.0, 0.0]);
        let merged = layer.merged(&pieces, (40, 20), 0.5, Merge::Majority);
        let line = &merged.values[5 * 40..6 * 40];
        assert!(
            line[..19].iter().all(|v| *v == 1.0) && line[21..].iter().all(|v| *v == 0.0),
            "{line:?}"
        );
    }

    #[test]
    fn a_tile_on_another_surface_or_without_the_raster_does_not_count() {
        let (mut pieces, mut layer) = pair([1.0, 0.0]);
        pieces[0].raster.plane_mut(0)[5 * 30 + 25] = 120.0;
        layer.rasters[0] = None;
        let merged = layer.merged(&pieces, (40, 20), 0.5, Merge::Majority);
        assert_eq!(merged.at(0, 12, 5), 0.0, "what the other says");
        assert!(merged.at(0, 2, 5).is_nan(), "what none says");
        assert!(layer.balance(&pieces, 0.5).iter().flatten().all(|gain| *gain == 1.0));
    }
}
