//! Gaussians that are seen and lit: rasterise, trace, shade, optimise. No files, no coordinate systems, no command line.

pub mod camera;
pub mod raster;

pub use camera::ProjectiveCamera;
pub use raster::Raster;
