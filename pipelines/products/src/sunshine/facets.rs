//! A surface as a small plane in each cell, for horizons and irradiance.
//!
//! A surface model of half a metre is rough by a decimetre: unsmoothed, level ground would face all ways and lie in its
//! own shadow under a low sun. Each cell gets the plane that fits the cells around it, without those beyond an edge.

use crate::nadir::CellVectors;
use heliosplat::Raster;
use heliosplat_grid::PlaneFit;
use rayon::prelude::*;

/// Radius of the neighbourhood that the plane of a cell is fitted to, metres.
const REACH_M: f64 = 1.5;
/// Largest difference in altitude of a cell that takes part, metres; [`STEEPEST`] times its distance is added.
const ROUGHNESS_M: f64 = 0.25;
/// Rise per metre of the steepest surface that is one surface.
const STEEPEST: f64 = 1.0;

/// Planes of cells, `NaN` where the altitude is unknown.
pub(super) struct Facets {
    /// Number of columns.
    pub(super) width: usize,
    /// Number of rows.
    pub(super) height: usize,
    /// Altitude of each plane at its cell's centre, metres.
    pub(super) up_m: Vec<f32>,
    /// Rise per metre toward east and north.
    pub(super) slope: Vec<[f32; 2]>,
}

impl Facets {
    /// The planes of an altitude raster.
    pub(super) fn of(altitude_m: &Raster, cells: &CellVectors) -> Self {
        let all = (0..altitude_m.plane_len()).into_par_iter();
        let planes = all.map(|cell| plane(altitude_m, cells, cell));
        let planes: Vec<[f32; 3]> = planes.collect();
        Self {
            width: altitude_m.width,
            height: altitude_m.height,
            up_m: planes.iter().map(|plane| plane[0]).collect(),
            slope: planes.iter().map(|plane| [plane[1], plane[2]]).collect(),
        }
    }

    /// True if the altitude of a cell is known.
    pub(super) fn is_known(&self, cell: usize) -> bool {
        self.up_m[cell].is_finite()
    }

    /// The unit normal of a cell's plane: east, north, up.
    pub(super) fn normal(&self, cell: usize) -> [f64; 3] {
        let [east, north] = self.slope[cell].map(f64::from);
        let length = (1.0 + east * east + north * north).sqrt();
        [-east / length, -north / length, 1.0 / length]
    }
}

/// Altitude at the centre and rise toward east and north of the plane around a cell, by least squares.
fn plane(altitude_m: &Raster, cells: &CellVectors, cell: usize) -> [f32; 3] {
    let (width, height) = (altitude_m.width, altitude_m.height);
    let plane = altitude_m.plane(0);
    let own = plane[cell];
    if !own.is_finite() {
        return [f32::NAN; 3];
    }
    let (col, row) = (cell % width, cell / width);
    let [cols, rows] = cells.reach(REACH_M);
    let mut fit = PlaneFit::default();
    for r in row.saturating_sub(rows)..(row + rows + 1).min(height) {
        for c in col.saturating_sub(cols)..(col + cols + 1).min(width) {
            let above_m = f64::from(plane[r * width + c] - own);
            let [east, north] = cells.offset_m(c as f64 - col as f64, r as f64 - row as f64);
            let one_surface = above_m.abs() <= ROUGHNESS_M + STEEPEST * east.hypot(north);
            if above_m.is_finite() && one_surface {
                fit.add([east, north], above_m, 1.0);
            }
        }
    }
    match fit.plane(0.0).map(|value| value as f32) {
        [above_m, east, north] if above_m.is_finite() && east.is_finite() && north.is_finite() => {
            [own + above_m, east, north]
        }
        // Fewer than three cells of one surface: level.
        _ => [own, 0.0, 0.0],
    }
}
