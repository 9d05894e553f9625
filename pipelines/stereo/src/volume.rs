//! The part of space that a plane sweep searches.

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
    /// Middle of the volume, metres.
    pub fn centre(&self) -> Vec3 {
        Vec3::new(
            0.5 * (self.west_m + self.east_m),
            0.5 * (self.south_m + self.north_m),
            0.5 * (self.altitude_min_m + self.altitude_max_m),
        )
    }
}
