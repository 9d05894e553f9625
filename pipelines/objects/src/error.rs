//! Errors of captures of objects and their runs.

use heliosplat_fitting::run_folder::RunError;
use heliosplat_fitting::settings::ConfigError;
use heliosplat_fitting::training::TrainingError;
use heliosplat_raster::RasterError;
use std::path::Path;

/// Reason why a capture cannot be read, with the file and the remedy.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct CaptureError(pub(crate) String);

impl CaptureError {
    /// Fault of a file.
    pub(crate) fn file(path: &Path, what: impl std::fmt::Display, remedy: &'static str) -> Self {
        Self(format!("{}: {what}; {remedy}", path.display()))
    }

    /// A file that cannot be read.
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |reason| Self::file(path, reason, "check that it is there and may be read")
    }
}

/// Reason why a capture did not become a run, or a run could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum ObjectError {
    /// The capture.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A setting.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Settings that cannot be written down.
    #[error("the configuration cannot be written: {0}")]
    Settings(String),
    /// No room for the Gaussians that training starts from.
    #[error("{0}")]
    Memory(String),
    /// The course of a training.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// A file of the run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A picture.
    #[error(transparent)]
    Raster(#[from] RasterError),
}
