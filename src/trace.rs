//! Light that reaches Gaussians: transmittance from Gaussians to a light, and its gradients.
//!
//! `light_ray` starts a ray at every Gaussian; `sun_plane` (parallel light, unless [`SunVisibility`] is `Bvh`) or
//! `hierarchy` finds the Gaussians on the rays and multiplies their attenuations; [`transmittance`](mod@transmittance)
//! puts it together, forward and backward. [`bvh`] holds the occluders.

pub mod bvh;
mod hierarchy;
mod light_ray;
mod occlusion;
mod sun_plane;
pub mod transmittance;

pub use bvh::{Occluder, Occluders, SunVisibility};
pub use transmittance::{OccluderGradients, Transmittance, transmittance};
