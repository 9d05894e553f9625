//! Losses: each returns its value and adds its gradient.

pub mod geometry;
pub mod photometric;
pub mod shadow;
pub mod smoothness;
