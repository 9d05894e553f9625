//! What a plane sweep is asked: which part of space to search, and with which parameters.

use super::grid::Grid;
use super::parameters::MatchingParameters;
use glam::Vec3;

/// The part of space that is searched. Distances are metres in the frame of the cameras, up is +z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchVolume {
    /// Western edge of the grid.
    pub west_m: f32,
    /// Southern edge.
    pub south_m: f32,
    /// Eastern edge.
    pub east_m: f32,
    /// Northern edge.
    pub north_m: f32,
    /// Width of a cell; about the ground distance between pixels is best.
    pub cell_m: f32,
    /// Lowest altitude of the height hypotheses.
    pub altitude_min_m: f32,
    /// Highest altitude of the height hypotheses.
    pub altitude_max_m: f32,
}

impl SearchVolume {
    /// Its middle, metres.
    pub fn centre(&self) -> Vec3 {
        Vec3::new(
            0.5 * (self.west_m + self.east_m),
            0.5 * (self.south_m + self.north_m),
            0.5 * (self.altitude_min_m + self.altitude_max_m),
        )
    }
}

/// Where and how to look for the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneSweepRequest {
    /// What is searched.
    pub volume: SearchVolume,
    /// Where viewing directions are taken, metres: the middle of the volume, or of the whole ground of which it is a tile.
    pub centre: Vec3,
    /// How views are matched.
    pub parameters: MatchingParameters,
}

impl PlaneSweepRequest {
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

    pub(super) fn centre(&self) -> Vec3 {
        self.centre
    }
}
