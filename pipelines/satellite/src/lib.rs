//! Multi-date satellite images with RPC cameras become a shadow-aware Gaussian model of the ground.
//!
//! [`training::train`] is the whole way, stage by stage; [`preprocess::sweep_only`] stops at the surface that is found before training.
//! [`Decisions`] says which components a scene requires, [`estimate`] what a training will take, [`adjust`] corrects cameras, and
//! [`measure`] compares a run with the truth of its scene.

pub mod adjust;
pub mod altitude;
mod beginning;
mod clouds;
pub mod config;
pub mod error;
pub mod estimate;
pub mod fit;
pub mod ground;
mod initial;
pub mod limits;
pub mod measure;
mod plan;
pub mod preprocess;
mod probe;
pub mod relit;
pub mod run_file;
mod short_fit;
mod suns;
mod sweep_memory;
pub mod sweep_tiles;
pub mod tiled_sweep;
pub mod training;
mod views;

pub use error::SatelliteError;
pub use plan::{Decisions, Light, PlanItem};
