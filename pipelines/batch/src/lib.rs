//! Many trainings at once: areas × images × presets, cut into tiles, each tile a unit of work that can be done anywhere and again.
//!
//! A unit is one command (`heliosplat batch MANIFEST --out FOLDER --only UNIT`) with its inputs hashed: it writes into a folder of its
//! own, its stamp (`unit.json`) last. So a unit that is finished is known by its stamp, one that was interrupted goes on from its
//! checkpoint, and a batch that was killed is taken up by the same command.

pub mod driver;
pub mod layers;
pub mod manifest;
pub mod mosaic;
pub mod plan;
pub mod products;
pub mod row;
pub mod stamp;
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

/// Why a batch cannot be planned, or a unit of it not be done.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// A manifest, an area or a unit that cannot be used, with the remedy.
    #[error("{0}")]
    Refused(String),
    /// Stopped by the user.
    #[error("{0}")]
    Interrupted(String),
    /// A process that cannot be started, or failed.
    #[error("{0}")]
    Failed(String),
    /// A training at fault.
    #[error(transparent)]
    Satellite(#[from] SatelliteError),
    /// A training that was not finished.
    #[error(transparent)]
    Training(#[from] TrainingError),
    /// Settings at fault.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A run at fault.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A page that cannot be written.
    #[error(transparent)]
    View(#[from] ViewError),
    /// A model that cannot be lit.
    #[error(transparent)]
    Relight(#[from] RelightError),
    /// A model that cannot be exported.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// A surface that cannot be compared with truth.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// A scene at fault.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A raster at fault.
    #[error(transparent)]
    Raster(#[from] RasterError),
}

impl BatchError {
    /// A unit that the plan does not have.
    fn no_unit(id: &str) -> Self {
        Self::Refused(format!("--only {id}: the plan has no such unit; see them with --plan"))
    }
}
