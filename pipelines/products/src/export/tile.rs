//! A tile of a mosaic: its run, and its core.

use glam::Vec3;
use heliosplat::{ProjectiveCamera, Raster};
use std::path::PathBuf;

/// Distance beyond the core of a tile within which its splats are kept, cells: the splats of two tiles stand on grids
/// of their own, and between two cores a line up to two cells wide would stay open.
const OVERLAP_CELLS: f32 = 0.5;

/// A tile of a mosaic.
#[derive(Debug, Clone, PartialEq)]
pub struct MosaicTile {
    /// Folder of the tile's run.
    pub run: PathBuf,
    /// Core of the tile, columns and rows of the mosaic: first and one past the last of each.
    pub core: [[isize; 2]; 2],
    /// Gains of the tile's colours, band by band; missing gains are 1.
    pub gains: Vec<f64>,
}

impl MosaicTile {
    /// Multiplies the bands of `colours` by the gains.
    pub(super) fn balance(&self, colours: &mut Raster) {
        for band in 0..colours.bands {
            let gain = self.gains.get(band).map_or(1.0, |gain| *gain as f32);
            colours.plane_mut(band).iter_mut().for_each(|value| *value *= gain);
        }
    }

    /// True if a position in the mosaic's frame lies on the core, or beside it by less than [`OVERLAP_CELLS`]. `nadir`
    /// is the camera whose pixels are the mosaic's cells.
    pub(super) fn contains(&self, nadir: &ProjectiveCamera, position: Vec3) -> bool {
        let (col, row, _) = nadir.project(position);
        // Cells have their centres at integers.
        let inside = |at: f32, [from, to]: [isize; 2]| {
            (from as f32 - OVERLAP_CELLS..to as f32 + OVERLAP_CELLS).contains(&(at + 0.5))
        };
        inside(col, self.core[0]) && inside(row, self.core[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_two_cores_nothing_is_left_out_and_half_a_cell_is_shared() {
        let tile = |from: isize| MosaicTile {
            run: PathBuf::new(),
            core: [[from, from + 10], [0, 10]],
            gains: Vec::new(),
        };
        let (west, east) = (tile(0), tile(10));
        let camera = ProjectiveCamera::nadir(-9.5, 4.5, 1.0, (20, 10));
        // Metres east of the border, in cells of a metre.
        for (east_m, held) in [
            (-9.9, (true, false)),
            (-0.6, (true, false)),
            (-0.4, (true, true)),
            (0.0, (true, true)),
            (0.4, (true, true)),
            (0.6, (false, true)),
            (9.9, (false, true)),
        ] {
            let place = Vec3::new(east_m, 0.0, 3.0);
            assert_eq!(
                (west.contains(&camera, place), east.contains(&camera, place)),
                held,
                "{east_m} m"
            );
        }
    }
}
