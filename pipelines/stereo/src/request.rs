//! Request of a plane sweep: the part of space to search, and the parameters.

use super::parameters::MatchingParameters;
use super::volume::SearchVolume;
use glam::Vec3;
use heliosplat_grid::Grid;

/// Volume and parameters of a search for the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneSweepRequest {
    /// The searched volume.
    pub volume: SearchVolume,
    /// Point at which viewing directions are taken, metres: the middle of the volume, or of the whole ground of which
    /// it is a tile.
    pub centre: Vec3,
    /// Matching parameters.
    pub parameters: MatchingParameters,
}

impl PlaneSweepRequest {
    /// Cells of the volume; their numbers along both axes are rounded.
    pub(super) fn grid(&self) -> Grid {
        let volume = &self.volume;
        let cells = |from: f32, to: f32| (((to - from) / volume.cell_m).round().max(0.0)) as usize;
        Grid {
            width: cells(volume.west_m, volume.east_m),
            height: cells(volume.south_m, volume.north_m),
            west_m: volume.west_m,
            north_m: volume.north_m,
            cell_m: volume.cell_m,
        }
    }
}
