//! Errors of scenes and their runs.

use heliosplat::train::TrainError;
use heliosplat_evaluate::EvaluateError;
use heliosplat_fitting::run_folder::RunError;
use heliosplat_fitting::settings::ConfigError;
use heliosplat_fitting::training::TrainingError;
use heliosplat_products::relight::RelightError;
use heliosplat_raster::RasterError;
use heliosplat_scene::SceneError;
use std::path::PathBuf;

/// Reason why a satellite scene did not become a run, or a run could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum SatelliteError {
    /// The scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A setting.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A scene, a run or a request that cannot be used, with the remedy.
    #[error("{0}")]
    Input(String),
    /// A result that cannot be written down.
    #[error("{0}")]
    Unwritable(String),
    /// The user stopped it.
    #[error("stopped: nothing was written")]
    Stopped,
    /// The course of a training.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// The run's folder, its checkpoint, or a file in it.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A raster.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// The evaluation.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// A sun that the model cannot be put under.
    #[error(transparent)]
    Relight(#[from] RelightError),
    /// The scene that a run was trained on.
    #[error("{}: the scene of the run: {error}", run.display())]
    SceneOfRun {
        /// The run.
        run: PathBuf,
        /// The fault of its scene.
        error: SceneError,
    },
}

impl From<TrainError> for SatelliteError {
    fn from(error: TrainError) -> Self {
        Self::Training(error.into())
    }
}

impl SatelliteError {
    /// Fewer than two images show the common ground.
    pub(crate) fn too_few_views(images: usize) -> Self {
        Self::Input(format!(
            "{images} of the scene's images show the ground that at least two have in common; two are needed"
        ))
    }
}
