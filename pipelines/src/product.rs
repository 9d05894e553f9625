//! What a model is turned into.

pub mod dsm;
pub mod relight;
pub mod views;
