//! Rasters other than the surface model, merged from tiles with the blending weights of their surface models. Tiles
//! that show another surface at a cell have no weight there.

use super::Result;
use super::mosaic::Parts;
use heliosplat::Raster;
use heliosplat_grid::statistics::upper_median;
use heliosplat_products::blend::{Piece, in_row, one_surface};
use rayon::prelude::*;
use std::path::Path;

/// Name of the albedo of a tile and of a mosaic.
pub(super) const ALBEDO: &str = "albedo.tif";
/// Approximate number of cells of an overlap that are compared in each direction.
const COMPARED: isize = 300;
/// Fewest compared cells of an overlap from which a ratio is estimated.
const LEAST_CELLS: usize = 50;
/// Colours at or below this value give no ratio.
const DARK: f32 = 1e-4;

/// One raster of each tile, in the order of the pieces; `None` for tiles without it.
pub struct Layer(Vec<Option<Raster>>);

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
    pub fn read(out: &Path, parts: &Parts, name: &str) -> Result<Self> {
        Self::named(out, parts, |_| Some(name.to_owned()))
    }

    /// Reads a raster of every tile below `out`, with the name for the place of the tile.
    ///
    /// # Errors
    /// When a file is damaged or not on the grid of its tile's surface model.
    pub fn named(out: &Path, parts: &Parts, name: impl Fn(usize) -> Option<String>) -> Result<Self> {
        Ok(Self(parts.rasters(out, name)?))
    }

    /// Multiplies every band of every tile by its gain; missing gains are 1.
    pub fn scale(&mut self, gains: &[Vec<f64>]) {
        for (raster, gains) in self.0.iter_mut().zip(gains) {
            let Some(raster) = raster else { continue };
            for (band, &gain) in gains.iter().enumerate().take(raster.bands) {
                raster.plane_mut(band).iter_mut().for_each(|v| *v *= gain as f32);
            }
        }
    }

    /// Replaces every value by `change` of its tile, band and value, and the value of `other` there.
    pub(super) fn change(&mut self, other: &Self, change: impl Fn(usize, usize, f32, f32) -> f32) {
        for (tile, (raster, other)) in self.0.iter_mut().zip(&other.0).enumerate() {
            let (Some(raster), Some(other)) = (raster, other) else {
                continue;
            };
            for band in 0..raster.bands.min(other.bands) {
                let values = raster.plane_mut(band).iter_mut().zip(other.plane(band));
                values.for_each(|(value, beside)| *value = change(tile, band, *value, *beside));
            }
        }
    }

    /// Number of bands that all rasters have; 0 without rasters.
    fn bands(&self) -> usize {
        let bands = self.0.iter().flatten().map(|raster| raster.bands);
        bands.min().unwrap_or(0)
    }

    fn value(&self, pieces: &[Piece], index: usize, band: usize, (col, row): (isize, isize)) -> f32 {
        let raster = self.0[index].as_ref();
        raster.map_or(f32::NAN, |raster| pieces[index].value_of(raster, band, col, row))
    }

    /// Median ratio of each band of the first two tiles in their overlap, over cells where both show one surface:
    /// natural logarithm of first over second, and number of cells; `None` where too few cells are known.
    pub(super) fn ratios(&self, pieces: &[Piece], gsd_m: f32) -> Vec<Option<(f64, usize)>> {
        let [columns, rows] = [0, 1].map(|axis| {
            let (p, q) = (pieces[0].bounds[axis], pieces[1].bounds[axis]);
            (p[0].max(q[0]), p[1].min(q[1]))
        });
        let step = |(from, to): (isize, isize)| ((to - from) / COMPARED).max(1) as usize;
        let mut said = Vec::new();
        let mut logs = vec![Vec::new(); self.bands()];
        for row in (rows.0..rows.1).step_by(step(rows)) {
            for col in (columns.0..columns.1).step_by(step(columns)) {
                one_surface(&mut said, (pieces, &[0, 1]), (col, row), gsd_m);
                for (band, logs) in logs.iter_mut().enumerate() {
                    let [p, q] = [0, 1].map(|index| self.value(pieces, index, band, (col, row)));
                    if said.len() == 2 && p > DARK && q > DARK {
                        logs.push(f64::from(p / q).ln());
                    }
                }
            }
        }
        let of = |mut logs: Vec<f64>| {
            let cells = logs.len();
            let median = upper_median(&mut logs).filter(|_| cells >= LEAST_CELLS)?;
            Some((median, cells))
        };
        logs.into_iter().map(of).collect()
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
        let layer = Layer(values.map(|v| Some(Raster::filled(30, 20, 1, v))).to_vec());
        (vec![piece(0, [0, 20], [0, 30]), piece(10, [20, 40], [10, 40])], layer)
    }

    #[test]
    fn colours_of_tiles_with_other_gains_meet_without_a_seam() {
        let (pieces, mut layer) = pair([0.2, 0.4]);
        let (log, cells) = layer.ratios(&pieces, 0.5)[0].expect("common cells");
        assert!((log - 0.5f64.ln()).abs() < 1e-6 && cells == 400);
        layer.scale(&[vec![2f64.sqrt()], vec![0.5f64.sqrt()]]);
        let merged = layer.merged(&pieces, (40, 20), 0.5, Merge::Mean);
        let expected = 0.2 * 2f32.sqrt();
        assert!(merged.values.iter().all(|v| (v - expected).abs() < 1e-5));
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
        layer.0[0] = None;
        let merged = layer.merged(&pieces, (40, 20), 0.5, Merge::Majority);
        assert_eq!(merged.at(0, 12, 5), 0.0, "what the other says");
        assert!(merged.at(0, 2, 5).is_nan(), "what none says");
        assert_eq!(layer.ratios(&pieces, 0.5), [None]);
    }
}
