//! What a model is turned into.

pub mod dsm;
pub mod ortho;
pub mod points;
pub mod relight;
pub mod set;
pub mod shadow_mask;
pub mod stac;
pub mod surface;
pub mod views;
pub mod writer;
