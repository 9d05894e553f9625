//! Scenes in, products out.

pub mod raster;
pub mod scene;
