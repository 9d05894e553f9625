//! Viewing direction of a Gaussian, and the training schedule of its spherical harmonics, for all models with
//! view-dependent colour.

use crate::camera::ProjectiveCamera;
use crate::optim::LearningRate;
use glam::Vec3;

/// Share of training after which the next degree joins.
const DEGREE_SHARE: f32 = 0.1;

/// Learning rate of the coefficients of a degree: frozen until the degrees below have had their share of training.
pub(super) fn rate_of_degree(rate: f32, degree: usize) -> LearningRate {
    LearningRate::constant(rate).starting_at(degree as f32 * DEGREE_SHARE)
}

/// The direction in which a camera sees a Gaussian.
pub(super) struct ViewDirection {
    /// Unit vector from the camera to the Gaussian's centre.
    pub(super) direction: Vec3,
    /// One over the distance, 1/m; zero where rays are parallel.
    pub(super) inverse_distance: f32,
}

impl ViewDirection {
    /// Direction of a centre (metres) seen by a camera whose rays meet in `eye`; `None` for parallel rays.
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
