//! Nadir camera of the truth: every pixel looks down the ellipsoid's normal at its cell of the truth's grid.

use crate::crop::Crop;
use crate::ray::Ray;
use crate::truth_grid::{TruthGrid, plumb_line};
use heliosplat_rpc::LocalFrame;

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
        plumb_line(&self.frame, &self.grid, [sample + 0.5, line + 0.5], SPAN_M)
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
