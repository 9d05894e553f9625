//! `heliosplat adjust`: arguments, and their way to the satellite pipeline.

use super::{CliError, IngestArgs, Outcome, Session};
use crate::page::residuals;
use crate::raster::write_atomically;
use clap::{Args, ValueEnum};
use heliosplat_rpc::adjust::BiasModel;
use std::path::PathBuf;

/// `adjust`.
#[derive(Debug, Clone, Args)]
pub struct AdjustArgs {
    /// A folder of images, a scene.toml, or a folder of Sat-NeRF or EOGS
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    /// Folder for the corrected cameras, adjustment.json and adjustment.svg, made if absent
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// What may be wrong with a camera
    #[arg(long, value_enum, default_value = "translation")]
    pub model: ModelName,
    /// Also write copies of the images with the corrected camera in their GeoTIFF tag: the folder is then a scene
    #[arg(long)]
    pub images: bool,
    /// What is said about the scene
    #[command(flatten)]
    pub ingest: IngestArgs,
}

/// What may be wrong with a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ModelName {
    /// A shift of the whole image
    Translation,
    /// A shift that changes linearly over the image: rotation, scale, drift
    Affine,
}

impl From<ModelName> for BiasModel {
    fn from(name: ModelName) -> Self {
        match name {
            ModelName::Translation => Self::Translation,
            ModelName::Affine => Self::Affine,
        }
    }
}

pub(super) fn run(args: &AdjustArgs, session: &Session) -> Result<Outcome, CliError> {
    let adjusted = crate::satellite::adjust::run(args, session)?;
    let picture = residuals::picture(&adjusted.residuals);
    write_atomically(&args.out.join("adjustment.svg"), picture.as_bytes())?;
    Ok(adjusted.outcome)
}
