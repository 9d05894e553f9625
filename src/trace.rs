//! Light that reaches Gaussians: proxies, a bounding volume hierarchy, transmittance and its gradients.

pub mod bvh;
mod hierarchy;
mod light_ray;
mod sun_plane;
pub mod transmittance;

pub use bvh::{Occluder, Occluders};
pub use transmittance::{Transmittance, transmittance, transmittance_by_hierarchy};
