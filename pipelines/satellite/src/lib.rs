//! Shadow-aware Gaussian model of the ground from multi-date satellite images with RPC cameras.
//!
//! [`training::train`] runs all stages; [`preprocess::sweep_only`] stops at the surface before training. [`Decisions`]
//! contains the components that a scene requires, [`estimate`] the memory of a training; [`adjust`] corrects cameras,
//! and [`measure`] compares a run with the truth of its scene.

pub mod adjust;
pub mod altitude;
mod clouds;
pub mod config;
pub mod error;
pub mod estimate;
pub mod fit;
pub mod ground;
mod initial;
mod initial_state;
pub mod limits;
pub mod measure;
pub mod patch_ties;
mod plan;
pub mod preprocess;
mod probe;
pub mod relit;
pub mod run_file;
pub mod shared_cameras;
mod short_fit;
mod suns;
mod sweep_memory;
pub mod sweep_tiles;
pub mod tiled_sweep;
pub mod training;
mod views;

pub use error::SatelliteError;
pub use plan::{Decisions, Lighting, PlanItem};
