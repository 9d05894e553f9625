//! Light that reaches Gaussians: proxies, a bounding volume hierarchy, transmittance and its gradients.

pub mod bvh;
pub mod transmittance;

pub use bvh::{Occluder, OccluderTree};
pub use transmittance::{TraceOptions, Transmittance, transmittance};
