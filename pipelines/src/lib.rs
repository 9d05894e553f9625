//! Scenes in, products out.

pub mod scene;
