//! Batch reconstruction of areas × images × presets, cut into tiles. Each tile is a unit of work that can run on any
//! machine and can be repeated.
//!
//! A unit is one command (`heliosplat batch MANIFEST --out FOLDER --only UNIT`) with hashed inputs and a folder of its
//! own; it writes its stamp (`unit.json`) last. A finished unit is recognised by its stamp, an interrupted one resumes
//! from its checkpoint, and the same command resumes a batch that was killed.

mod blocks;
mod colours;
pub mod driver;
mod joined;
pub mod layers;
pub mod manifest;
pub mod mosaic;
pub mod plan;
pub mod products;
pub mod row;
pub mod stamp;
mod store;
pub mod summary;
pub mod tiles;
pub mod unit;

use heliosplat_evaluate::EvaluateError;
use heliosplat_fitting::run_folder::RunError;
use heliosplat_fitting::settings::ConfigError;
use heliosplat_fitting::training::TrainingError;
use heliosplat_pages::view::ViewError;
use heliosplat_products::export::ExportError;
use heliosplat_products::relight::RelightError;
use heliosplat_raster::RasterError;
use heliosplat_satellite::SatelliteError;
use heliosplat_scene::SceneError;

/// Result of a step of a batch.
pub(crate) type Result<T, E = BatchError> = std::result::Result<T, E>;

/// Failure to plan a batch or to run one of its units.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// Unusable manifest, area or unit; the message names the remedy.
    #[error("{0}")]
    Refused(String),
    /// Stopped by the user.
    #[error("{0}")]
    Interrupted(String),
    /// The process or a file of a unit failed.
    #[error("{0}")]
    Failed(String),
    /// Error of the satellite pipeline.
    #[error(transparent)]
    Satellite(#[from] SatelliteError),
    /// Training that did not finish.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// Invalid settings.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Run folder that cannot be used or written.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Page that cannot be written.
    #[error(transparent)]
    View(#[from] ViewError),
    /// Model that cannot be relit.
    #[error(transparent)]
    Relight(#[from] RelightError),
    /// Model that cannot be exported.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// Surface model that cannot be compared with truth.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// Unusable scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Raster that cannot be read or written.
    #[error(transparent)]
    Raster(#[from] RasterError),
}

impl BatchError {
    /// Error for a unit that is not in the plan.
    fn no_unit(id: &str) -> Self {
        Self::Refused(format!("--only {id}: the plan has no such unit; see them with --plan"))
    }
}
