//! Errors of captures of objects and their runs.

use heliosplat_fitting::run_folder::RunError;
use heliosplat_fitting::settings::ConfigError;
use heliosplat_fitting::training::TrainingError;
use heliosplat_raster::RasterError;
use std::path::{Path, PathBuf};

/// Reason why a capture cannot be used; one line with the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// There is no `transforms_*.json`.
    #[error("{0}: no transforms_train.json or transforms.json here; give a folder that holds one")]
    NoTransforms(PathBuf),
    /// A file that cannot be read.
    #[error("{path}: {reason}; check that it is there and may be read")]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        reason: std::io::Error,
    },
    /// A `transforms` file or an image that is not usable.
    #[error("{path}: {what}; {remedy}")]
    File {
        /// The file.
        path: PathBuf,
        /// The fault.
        what: String,
        /// The remedy.
        remedy: &'static str,
    },
    /// More pixels than fit.
    #[error(
        "{folder}: its images take {needed_gib:.1} GiB and at most {limit_gib:.1} GiB are used; give fewer or smaller ones, or more with --memory"
    )]
    TooLarge {
        /// The capture.
        folder: PathBuf,
        /// Memory needed, GiB.
        needed_gib: f64,
        /// Memory allowed, GiB.
        limit_gib: f64,
    },
}

impl CaptureError {
    /// A fault of a file, with its remedy.
    pub(crate) fn file(path: &Path, what: impl Into<String>, remedy: &'static str) -> Self {
        Self::File {
            path: path.to_owned(),
            what: what.into(),
            remedy,
        }
    }

    /// An error of the system on a file.
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |reason| Self::Io {
            path: path.to_owned(),
            reason,
        }
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
    #[error(
        "--memory: the images leave no room for {gaussians} Gaussians; give {needed_gib:.2}GiB or more, or fewer with --set start.gaussians={most}"
    )]
    Memory {
        /// Gaussians requested.
        gaussians: usize,
        /// Sufficient memory, GiB.
        needed_gib: f64,
        /// Gaussians that fit.
        most: usize,
    },
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
