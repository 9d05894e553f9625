//! Rays. Coordinates are east, north and up in metres from the site's centre; in captures of objects they are those of
//! the capture.

use nalgebra::Vector3;

/// A half line; `direction` is a unit vector.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    /// Start of the ray.
    pub(crate) origin: Vector3<f64>,
    /// Unit vector along the ray.
    pub(crate) direction: Vector3<f64>,
}

impl Ray {
    /// A ray from `origin` along the unit vector `direction`.
    pub(crate) fn new(origin: Vector3<f64>, direction: Vector3<f64>) -> Self {
        Self { origin, direction }
    }

    /// Point at the distance `t` from the start.
    pub(crate) fn at(&self, t: f64) -> Vector3<f64> {
        self.origin + self.direction * t
    }
}
