//! Rasterisation of Gaussians: project, bin to tiles, composite front to back; each with its backward pass.

pub mod bins;
pub mod kernel;
pub mod project;
pub mod rasterise;

pub use bins::Bins;
pub use project::{Projected, ProjectionOptions, Splat, SplatGradient};
pub use rasterise::{Depths, MapGradients, Maps, Rasteriser, SplatGradients};
