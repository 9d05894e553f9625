//! A tile of a mosaic: where its run is, and what of it counts.

use crate::nadir::NadirGrid;
use glam::Vec3;
use heliosplat::Raster;
use std::path::PathBuf;

/// Cells that the splats of a tile may lie beyond its core: those of two tiles stand on grids of their own, and between two cores a line would
/// stay open that is up to two cells wide.
const OVERLAP_CELLS: f32 = 0.5;

/// A tile of a mosaic.
#[derive(Debug, Clone, PartialEq)]
pub struct MosaicTile {
    /// The folder of its run.
    pub run: PathBuf,
    /// First and one past last column and row of the mosaic of its core.
    pub core: [[isize; 2]; 2],
    /// What its colours are multiplied by, band by band; one where there is none.
    pub gains: Vec<f64>,
}

impl MosaicTile {
    /// Multiplies colours by the gains.
    pub(super) fn balance(&self, colours: &mut Raster) {
        for band in 0..colours.bands {
            let gain = self.gains.get(band).map_or(1.0, |gain| *gain as f32);
            colours.plane_mut(band).iter_mut().for_each(|value| *value *= gain);
        }
    }

    /// Whether a place of the mosaic's frame lies on the core, or beside it by less than [`OVERLAP_CELLS`].
    pub(super) fn holds(&self, nadir: &NadirGrid, position: Vec3) -> bool {
        let (col, row, _) = nadir.camera.project(position);
        // Cells have their middles at integers.
        let inside = |at: f32, [from, to]: [isize; 2]| {
            (from as f32 - OVERLAP_CELLS..to as f32 + OVERLAP_CELLS).contains(&(at + 0.5))
        };
        inside(col, self.core[0]) && inside(row, self.core[1])
    }
}
