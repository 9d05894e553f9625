//! Resampling of a raster onto the grid of another.

use heliosplat::Raster;
use heliosplat_grid::bilinear_to_the_edge;
use heliosplat_raster::{CrsTransform, GeoRaster, RasterError};
use rayon::prelude::*;

/// Positions of a target grid's cell centres in a source raster.
pub struct Placement<'a> {
    source: &'a Raster,
    width: usize,
    height: usize,
    /// Column and row in the source per target cell; not finite where there is none.
    positions: Vec<[f64; 2]>,
    /// Change of position per column and per row of the target, at its centre.
    per_cell: [[f64; 2]; 2],
}

impl<'a> Placement<'a> {
    /// Computes the positions. Where one raster has no coordinate system, that of the other is assumed.
    ///
    /// # Errors
    /// When a coordinate system cannot be used.
    pub fn new(source: &'a GeoRaster, target: &GeoRaster) -> Result<Self, RasterError> {
        let transform = match (&target.crs, &source.crs) {
            (Some(from), Some(to)) if from.wkt() != to.wkt() => Some(CrsTransform::new(from, to)?),
            _ => None,
        };
        let place = |col: f64, row: f64| {
            let [x, y] = target.transform.map_from_pixel(col, row);
            let (x, y) = match &transform {
                // A cell outside the source's coordinate system has no place there.
                Some(transform) => transform.apply(x, y).unwrap_or((f64::NAN, f64::NAN)),
                None => (x, y),
            };
            source.transform.pixel_from_map(x, y)
        };
        let (width, height) = (target.raster.width, target.raster.height);
        let cells = (0..width * height).map(|index| place((index % width) as f64, (index / width) as f64));
        let (col, row) = (width as f64 / 2.0, height as f64 / 2.0);
        let centre = place(col, row);
        let step = |[c, r]: [f64; 2]| [c - centre[0], r - centre[1]];
        Ok(Self {
            source: &source.raster,
            width,
            height,
            positions: cells.collect(),
            per_cell: [step(place(col + 1.0, row)), step(place(col, row + 1.0))],
        })
    }

    /// First band of the source on the target's grid, bilinear, `NaN` where nothing is known, after moving the source
    /// by `columns` to the right and `rows` down (target cells). Between different coordinate systems the move is
    /// computed at the grid's centre; within a kilometre of it, a move of 50 cells is wrong by some thousandths of a
    /// cell.
    pub fn moved(&self, columns: f64, rows: f64) -> Raster {
        self.moved_band(0, columns, rows)
    }

    /// Band `band` of the source, bilinear, moved as the first band is by [`Self::moved`].
    pub fn moved_band(&self, band: usize, columns: f64, rows: f64) -> Raster {
        let [per_col, per_row] = self.per_cell;
        let offset = [0, 1].map(|axis| columns * per_col[axis] + rows * per_row[axis]);
        let mut out = Raster::filled(self.width, self.height, 1, f32::NAN);
        let cells = out.values.par_iter_mut().zip(&self.positions);
        let resampled = |[col, row]: &[f64; 2]| bilinear_band(self.source, band, col - offset[0], row - offset[1]);
        cells.for_each(|(value, place)| *value = resampled(place));
        out
    }
    /// A band of the source on the target's grid, the nearest cell's value, `NaN` where there is none.
    pub fn nearest_band(&self, band: usize) -> Raster {
        let mut out = Raster::filled(self.width, self.height, 1, f32::NAN);
        let inside = |at: f64, count: usize| (0.0..count as f64).contains(&at);
        for (value, [col, row]) in out.values.iter_mut().zip(&self.positions) {
            let (col, row) = (col.round(), row.round());
            if inside(col, self.source.width) && inside(row, self.source.height) {
                *value = self.source.at(band, col as usize, row as usize);
            }
        }
        out
    }
}

/// First band at a fractional pixel position. Missing neighbours make the value missing, except those with negligible
/// weight; positions up to half a pixel outside take the edge's value.
pub fn bilinear(raster: &Raster, col: f64, row: f64) -> f32 {
    bilinear_band(raster, 0, col, row)
}

fn bilinear_band(raster: &Raster, band: usize, col: f64, row: f64) -> f32 {
    bilinear_to_the_edge(raster.plane(band), (raster.width, raster.height), col, row)
}
