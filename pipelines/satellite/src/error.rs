//! What can go wrong between a scene and its run.

use crate::fit::FitError;
use heliosplat_evaluate::EvaluateError;
use heliosplat_fitting::run_folder::{OpenError, RunError};
use heliosplat_fitting::settings::ConfigError;
use heliosplat_fitting::training::TrainingError;
use heliosplat_raster::RasterError;
use heliosplat_rpc::RpcError;
use heliosplat_scene::SceneError;
use std::path::PathBuf;
use std::time::Duration;

/// Why a satellite scene did not become a run, or a run could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum SatelliteError {
    /// The scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A setting.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Settings that cannot be written down.
    #[error("the configuration cannot be written: {0}")]
    Settings(String),
    /// A limit of time within which training would not even begin.
    #[error(
        "--time-budget {limit:?}: before the first step this scene takes about {start_s:.0} s on this machine; give {:.0}s or more, or a coarser model with --set start.cell_gsd=2",
        2.0 * start_s
    )]
    TimeBudget {
        /// The limit.
        limit: Duration,
        /// Seconds before the first step.
        start_s: f64,
    },
    /// The fit.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The course of a training.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// The run's folder, or its checkpoint.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A file of the run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A raster.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// The evaluation.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// The scene that a run was trained on.
    #[error("{}: the scene of the run: {error}", run.display())]
    SceneOfRun {
        /// The run.
        run: PathBuf,
        /// What is wrong with its scene.
        error: SceneError,
    },
    /// Cameras that cannot be adjusted.
    #[error(
        "{}: the cameras cannot be adjusted: {error}; check the overlap and --altitude with `heliosplat inspect`",
        scene.display()
    )]
    Adjust {
        /// The scene.
        scene: PathBuf,
        /// Why not.
        error: RpcError,
    },
    /// An adjusted camera that cannot be written as a rational one.
    #[error("{}: its corrected camera: {error}", image.display())]
    CorrectedCamera {
        /// The image.
        image: PathBuf,
        /// Why not.
        error: RpcError,
    },
}
