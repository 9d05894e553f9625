//! Gaussians that are seen and lit: rasterise, trace, shade, optimise. No files, no coordinate systems, no command line.

mod binning;
pub mod camera;
pub mod fast;
pub mod gaussians;
pub mod light;
pub mod loss;
pub mod model;
pub mod optim;
pub mod raster;
pub mod rates;
pub mod render;
pub mod shade;
pub mod simd;
pub mod splat;
pub mod trace;
pub mod train;

pub use camera::ProjectiveCamera;
pub use raster::Raster;
