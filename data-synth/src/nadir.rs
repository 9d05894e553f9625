//! Nadir camera of the truth: every pixel looks down the ellipsoid's normal at its cell of the truth's grid.

use crate::crop::Crop;
use crate::ray::Ray;
use crate::truth_grid::TruthGrid;
use heliosplat_rpc::{GeoPoint, LocalFrame};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Altitudes of the two points that define a ray, metres above the frame's origin. Any two altitudes far enough apart
/// give the same direction.
const SPAN_M: [f64; 2] = [-100.0, 1000.0];

/// The camera over a grid. Lines and samples are rows and columns of its cells, whole numbers at their centres.
#[derive(Debug, Clone)]
pub(crate) struct NadirSensor {
    /// Local frame of the site (east, north and up, metres).
    pub(crate) frame: LocalFrame,
    /// Grid of the truth rasters.
    pub(crate) grid: TruthGrid,
}

impl NadirSensor {
    /// Ray of a (fractional) sample of a (fractional) line, from high above the ground.
    pub(crate) fn ray(&self, sample: f64, line: f64) -> Ray {
        self.plumb_line([sample + 0.5, line + 0.5], SPAN_M)
    }

    /// The ray down the ellipsoid's normal through a place of the grid (columns and rows of cells), from the higher of
    /// two altitudes (metres above the frame's origin) toward the lower.
    pub(crate) fn plumb_line(&self, at: [f64; 2], [low_m, high_m]: [f64; 2]) -> Ray {
        let (top, bottom) = (self.point(at, high_m), self.point(at, low_m));
        Ray::new(top, (bottom - top).normalize())
    }

    /// The point, metres of the frame, at an altitude (metres above the frame's origin) over a place of the grid
    /// (columns and rows of cells).
    pub(crate) fn point(&self, [col, row]: [f64; 2], altitude_m: f64) -> Vector3<f64> {
        let [lon_deg, lat_deg] = self.grid.lon_lat(col, row);
        let height_m = self.frame.origin.height_m + altitude_m;
        self.frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, height_m))
    }

    /// Values at the centres of all cells, row by row, from `value(place)`, whose places are columns and rows of cells.
    pub(crate) fn of_cells<T: Send>(&self, value: impl Fn([f64; 2]) -> T + Sync) -> Vec<T> {
        let size = self.grid.size;
        (0..size * size)
            .into_par_iter()
            .map(|cell| value([cell % size, cell / size].map(|index| index as f64 + 0.5)))
            .collect()
    }

    /// Crop that covers the whole grid.
    pub(crate) fn crop(&self) -> Crop {
        Crop {
            col0: 0.0,
            row0: 0.0,
            width: self.grid.size,
            height: self.grid.size,
        }
    }
}
