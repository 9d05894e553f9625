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

/// Reason why a satellite scene did not become a run, or why a run could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum SatelliteError {
    /// Error of the scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Error of a setting.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A scene, a run or a request that cannot be used, with the remedy.
    #[error("{0}")]
    Input(String),
    /// Result that cannot be written.
    #[error("{0}")]
    Unwritable(String),
    /// Stopped by the user.
    #[error("stopped: nothing was written")]
    Stopped,
    /// Error of the training.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// Error of the run's folder, its checkpoint, or a file in it.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Error of a raster.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// Error of the evaluation.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// Error of relighting: the model cannot be rendered under the sun.
    #[error(transparent)]
    Relight(#[from] RelightError),
    /// Error of the scene that a run was trained on.
    #[error("{}: the scene of the run: {error}", run.display())]
    SceneOfRun {
        /// Folder of the run.
        run: PathBuf,
        /// Error of its scene.
        error: SceneError,
    },
}

impl From<TrainError> for SatelliteError {
    fn from(error: TrainError) -> Self {
        Self::Training(error.into())
    }
}

impl SatelliteError {
    /// Error for a ground that fewer than two images show; `images` is their number.
    pub(crate) fn too_few_views(images: usize) -> Self {
        Self::Input(format!(
            "{images} of the scene's images show the ground that at least two have in common; two are needed"
        ))
    }
}
