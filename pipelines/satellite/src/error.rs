//! Errors of scenes and their runs.

use heliosplat::train::TrainError;
use heliosplat_evaluate::EvaluateError;
use heliosplat_fitting::run_folder::RunError;
use heliosplat_fitting::settings::ConfigError;
use heliosplat_fitting::training::TrainingError;
use heliosplat_products::relight::RelightError;
use heliosplat_radiometry::shadow_prior::MaskError;
use heliosplat_raster::RasterError;
use heliosplat_rpc::RpcError;
use heliosplat_rpc::parallax::LEAST_BASE_TO_HEIGHT;
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
    /// Settings that cannot be written down.
    #[error("the configuration cannot be written: {0}")]
    Settings(String),
    /// The user stopped it.
    #[error("stopped: nothing was written")]
    Stopped,
    /// Fewer than two images show the common ground.
    #[error("{images} of the scene's images show the ground that at least two have in common; two are needed")]
    TooFewViews {
        /// Number of images that show it.
        images: usize,
    },
    /// No two images look from far enough apart.
    #[error(
        "no parallax: {} and {} look from one place (base-to-height ratio {base_to_height:.4}) and no two images of the ground from {LEAST_BASE_TO_HEIGHT} apart; give images from other directions",
        first.display(),
        second.display()
    )]
    NoParallax {
        /// One of the two images that are farthest apart.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// Their base-to-height ratio.
        base_to_height: f64,
    },
    /// An image whose common ground is of one value.
    #[error(
        "{}: the ground that the images have in common has no contrast in it: nearly all of its pixels have one value; take the image out of the scene",
        image.display()
    )]
    NoContrast {
        /// The image.
        image: PathBuf,
    },
    /// Training would take more memory than it may.
    #[error(
        "--memory: training needs about {needed_gib:.2} GiB and {limit_gib:.2} GiB are allowed; give more, fewer images, or a coarser model with --set start.cell_gsd={cell_gsd:.2}"
    )]
    Memory {
        /// Memory needed, GiB.
        needed_gib: f64,
        /// Memory allowed, GiB.
        limit_gib: f64,
        /// Width of a cell that would fit, ground sampling distances.
        cell_gsd: f64,
    },
    /// The smallest tiles of a plane sweep would take more memory than it may.
    #[error(
        "--memory: the smallest tiles of this sweep, of {levels} altitudes per cell, need about {needed_gib:.2} GiB and {limit_gib:.2} GiB are allowed; give more, or a narrower --altitude"
    )]
    SweepMemory {
        /// Memory needed by the smallest tiles, GiB.
        needed_gib: f64,
        /// Memory allowed for the sweep, GiB.
        limit_gib: f64,
        /// Height hypotheses of a cell.
        levels: usize,
    },
    /// The channels do not suffice for the bands and near-surface light of each.
    #[error(
        "model.near_light: {bands} bands of albedo and as many of near-surface light are more than the {most} channels of the rasteriser; leave it off, or give images of fewer bands"
    )]
    Channels {
        /// Bands of the images.
        bands: usize,
        /// Channels of the rasteriser.
        most: usize,
    },
    /// A mask of shadows that cannot be used.
    #[error(transparent)]
    Mask(#[from] MaskError),
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
    /// Truth for relighting with other bands than the run.
    #[error("{}: {found} bands, and the run has {expected}; truth for relighting has the bands of the images", path.display())]
    RelitBands {
        /// The image.
        path: PathBuf,
        /// Its bands.
        found: usize,
        /// Bands of the run.
        expected: usize,
    },
    /// Truth for relighting of another place.
    #[error("{}: under one of its suns no pixel is known to the run; truth for relighting is of the run's ground", .0.display())]
    RelitElsewhere(PathBuf),
    /// The scene that a run was trained on.
    #[error("{}: the scene of the run: {error}", run.display())]
    SceneOfRun {
        /// The run.
        run: PathBuf,
        /// The fault of its scene.
        error: SceneError,
    },
    /// A scene that is no longer the one that a run was trained on.
    #[error("{}: its scene is not the one that it was trained on: {difference}; restore the scene, or train again", run.display())]
    OtherScene {
        /// The run.
        run: PathBuf,
        /// The first difference.
        difference: String,
    },
    /// Cameras that cannot be adjusted.
    #[error(
        "{}: the cameras cannot be adjusted: {error}; check the overlap and --altitude with `heliosplat inspect`",
        scene.display()
    )]
    Adjust {
        /// The scene.
        scene: PathBuf,
        /// The reason.
        error: RpcError,
    },
    /// An adjusted camera that cannot be written as a rational one.
    #[error("{}: its corrected camera: {error}", image.display())]
    CorrectedCamera {
        /// The image.
        image: PathBuf,
        /// The reason.
        error: RpcError,
    },
}

impl From<TrainError> for SatelliteError {
    fn from(error: TrainError) -> Self {
        Self::Training(error.into())
    }
}
