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
    /// Error of a file: its path, the fault and the remedy.
    pub(crate) fn file(path: &Path, what: impl std::fmt::Display, remedy: &'static str) -> Self {
        Self(format!("{}: {what}; {remedy}", path.display()))
    }

    /// Converter of I/O errors of the file `path`.
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |reason| Self::file(path, reason, "check that it is there and may be read")
    }
}

/// Reason why a capture did not become a run, or a run could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum ObjectError {
    /// The capture cannot be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A setting is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The configuration cannot be written as TOML.
    #[error("the configuration cannot be written: {0}")]
    Settings(String),
    /// The memory limit leaves too little for the initial Gaussians.
    #[error("{0}")]
    Memory(String),
    /// The training failed or was stopped.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// A file of the run cannot be read or written.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A picture cannot be written.
    #[error(transparent)]
    Raster(#[from] RasterError),
}
