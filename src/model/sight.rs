//! What models whose colours change with the viewing direction have in common: that direction, and when which degree of the
//! spherical harmonics learns.

use crate::camera::ProjectiveCamera;
use glam::Vec3;

/// Degrees above the constant learn this much slower (Kerbl et al. 2023).
const HIGHER: f32 = 0.05;
/// Share of training after which the next degree joins.
const DEGREE_SHARE: f32 = 0.1;

/// Learning rate of a degree, as a share of that of the constant function, when `progress` (0 to 1) of training is done: zero until
/// its turn.
pub(super) fn rate_of_degree(degree: usize, progress: f32) -> f32 {
    match degree {
        0 => 1.0,
        n if progress >= n as f32 * DEGREE_SHARE => HIGHER,
        _ => 0.0,
    }
}

/// From where a Gaussian is seen.
pub(super) struct Sight {
    /// Unit direction from the camera to its centre.
    pub(super) direction: Vec3,
    /// One over the distance, 1/m; zero where rays are parallel.
    pub(super) inverse_distance: f32,
}

impl Sight {
    /// Of a centre seen by a camera whose rays meet in `eye`.
    pub(super) fn new(eye: Option<Vec3>, camera: &ProjectiveCamera, position: Vec3) -> Self {
        // Parallel rays have no eye; their direction is the same everywhere.
        let offset = eye.map_or(camera.depth_axis, |eye| position - eye);
        let inverse = 1.0 / offset.length().max(1e-12);
        Self {
            direction: offset * inverse,
            inverse_distance: if eye.is_some() { inverse } else { 0.0 },
        }
    }
}
