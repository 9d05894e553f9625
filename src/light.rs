//! Light sources: a direction (the sun) or a position (a lamp). The share of their light that reaches a Gaussian is its
//! transmittance, see [`crate::trace`].

use glam::Vec3;

/// A light source.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Light {
    /// Parallel light, by the unit vector toward it.
    Directional(Vec3),
    /// A point light, by its position in metres (or scene units, for objects).
    Point(Vec3),
}

impl Light {
    /// Unit direction from `from` toward the light, and the distance to it in metres (infinite for parallel light).
    #[inline]
    pub fn seen_from(&self, from: Vec3) -> (Vec3, f32) {
        match *self {
            Light::Directional(direction) => (direction, f32::INFINITY),
            Light::Point(position) => {
                let offset = position - from;
                let distance = offset.length();
                if distance > 1e-12 {
                    (offset / distance, distance)
                } else {
                    (Vec3::Z, 0.0)
                }
            }
        }
    }
}
