//! Rays of the scene: east, north and up in metres from the site's centre.

use nalgebra::Vector3;

/// A half line; `direction` is a unit vector.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    pub(crate) origin: Vector3<f64>,
    pub(crate) direction: Vector3<f64>,
}

impl Ray {
    pub(crate) fn at(&self, t: f64) -> Vector3<f64> {
        self.origin + self.direction * t
    }
}
