//! Uncertainty of the initial sweep, added to the standard deviation of the surface of a model.
//!
//! Training converges to one surface. Where nothing is matched, as in a shaded court, its rays meet only that surface,
//! and the spread along them is small, however wrong the surface is. The probability of the sweep is a better measure
//! there: if an altitude has the probability p, and the alternative is the ground, d lower, the mean squared error of
//! the altitude is (1 - p) d² larger. Ablation in docs/lab/surface.md.

use crate::model::START;
use crate::nadir::{GroundExtent, NadirGrid};
use glam::Vec3;
use heliosplat_radiometry::ground::{ground_below, ground_probability};
use heliosplat_raster::{GeoRaster, RasterError};
use rayon::prelude::*;
use std::path::Path;

/// Name of the band of the sweep's probabilities.
const PROBABILITY: &str = "coverage";
/// Probability of an altitude where the sweep found none.
const UNKNOWN: f32 = 0.5;
/// Cells per parallel job.
const CHUNK: usize = 1024;

/// Probability (0 to 1) of the altitudes from the sweep that a model started from, on their grid.
pub(crate) struct StartProbability {
    nadir: NadirGrid,
    values: Vec<f32>,
}

impl StartProbability {
    /// Probabilities of the sweep of the run in `folder`, over the ground `place`; `None`, with a warning, if the run
    /// has none.
    ///
    /// # Errors
    /// When the file of the sweep is damaged, or its grid lies outside its coordinate system.
    pub(crate) fn of_run(folder: &Path, place: &GroundExtent) -> Result<Option<Self>, RasterError> {
        let path = folder.join(START);
        let start = match path.is_file() {
            true => Some(GeoRaster::read_surface(&path)?),
            false => None,
        };
        let found = start.and_then(|start| Some((start.band(PROBABILITY)?, start.grid()?, start)));
        let Some((band, grid, start)) = found else {
            tracing::warn!(
                "{}: absent or without the band {PROBABILITY}, so standard deviations do not know how sure the sweep was",
                path.display()
            );
            return Ok(None);
        };
        let (nadir, values) = (NadirGrid::on(place, grid)?, start.raster.plane(band).to_vec());
        Ok(Some(Self { nadir, values }))
    }

    /// Widens the standard deviations of a surface, metres, on the grid of `nadir`; `altitude_m` is above the
    /// ellipsoid, NaN where unknown.
    pub(crate) fn widen(&self, nadir: &NadirGrid, altitude_m: &[f32], deviation_m: &mut [f32]) {
        let ground_m = ground_below((nadir.grid.width, nadir.grid.height), nadir.cell_m(), altitude_m);
        let cells = deviation_m.par_iter_mut().with_min_len(CHUNK).enumerate();
        cells.for_each(|(cell, deviation)| {
            let above_m = altitude_m[cell] - ground_m[cell];
            let of_altitude = || self.at(nadir, cell, altitude_m[cell]);
            if let Some(of_ground) = ground_probability(above_m, of_altitude) {
                *deviation = (*deviation * *deviation + of_ground * above_m * above_m).sqrt();
            }
        });
    }

    /// Probability of an altitude (metres above the ellipsoid) at a cell of another grid, 0 to 1.
    fn at(&self, nadir: &NadirGrid, cell: usize, altitude_m: f32) -> f32 {
        let (col, row) = (cell % nadir.grid.width, cell / nadir.grid.width);
        let place = nadir.enu.enu(col as f64, row as f64, f64::from(altitude_m));
        let pixel = self.nadir.camera.pixel(Vec3::from(place.map(|metres| metres as f32)));
        let probability = pixel.map(|(pixel, _)| self.values[pixel]);
        probability.filter(|p| p.is_finite()).unwrap_or(UNKNOWN)
    }
}

#[cfg(test)]
mod tests {
    use heliosplat_raster::grid::GridSpec;

    use super::*;
    use heliosplat_raster::Crs;
    use heliosplat_raster::grid::GeoTransform;

    /// A grid of cells of a metre or two over the same 60 m.
    fn grid(cell_m: f64) -> GridSpec {
        let cells = (60.0 / cell_m) as usize;
        GridSpec {
            width: cells,
            height: cells,
            transform: GeoTransform::north_up(500_000.0, 3_000_000.0, cell_m),
            crs: Crs::from_epsg(32617).expect("a UTM zone"),
        }
    }

    /// A house of 10 m on level ground; the sweep is certain in its eastern half and uncertain in its western half.
    #[test]
    fn what_the_sweep_was_not_sure_of_may_be_ground() {
        let inside = |cell: usize, cells: usize| [cell % cells, cell / cells].iter().all(|&at| 3 * at / cells == 1);
        let altitude: Vec<f32> = (0..3600)
            .map(|cell| if inside(cell, 60) { 20.0 } else { 10.0 })
            .collect();
        let (nadir, frame) = NadirGrid::of_surface(grid(1.0), &altitude).expect("a grid");
        let place = GroundExtent {
            frame,
            area: heliosplat_scene::Area {
                west_m: -30.0,
                south_m: -30.0,
                east_m: 30.0,
                north_m: 30.0,
            },
            altitude_range_m: (10.0, 20.0),
        };
        // The start has a grid of its own.
        let start = StartProbability {
            nadir: NadirGrid::on(&place, grid(2.0)).expect("a grid"),
            values: (0..900).map(|cell| if cell % 30 < 15 { 0.9 } else { 0.98 }).collect(),
        };
        let mut deviation = vec![0.1; 3600];
        start.widen(&nadir, &altitude, &mut deviation);
        let at = |col: usize, row: usize| deviation[row * 60 + col];
        assert!(
            (at(25, 30) - (0.01f32 + 0.1 * 100.0).sqrt()).abs() < 1e-3,
            "unsure: {}",
            at(25, 30)
        );
        assert_eq!(at(35, 30), 0.1, "sure");
        assert_eq!(at(5, 30), 0.1, "ground has nothing below it");
    }
}
