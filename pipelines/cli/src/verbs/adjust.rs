//! `heliosplat adjust`: corrects cameras by tie points, and draws their residuals.

use crate::args::IngestArgs;
use crate::outcome::{CliError, Outcome};
use crate::outputs::Inputs;
use clap::Args;
use heliosplat_pages::page::residuals;
use heliosplat_raster::write_atomically;
use heliosplat_rpc::adjust::BiasModel;
use heliosplat_satellite::adjust::{AdjustRequest, adjust_scene};
use heliosplat_satellite::altitude;
use heliosplat_scene::Index;
use heliosplat_session::Session;
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
    /// Error model of the cameras
    #[arg(long, value_enum, default_value = "translation")]
    pub model: BiasModel,
    /// Also copy the images, with corrected cameras in their GeoTIFF tags: the folder is then a scene
    #[arg(long)]
    pub images: bool,
    /// Scene options
    #[command(flatten)]
    pub ingest: IngestArgs,
}

/// Adjusts the cameras of a scene, and writes them with a picture of their residuals.
///
/// # Errors
/// When the scene cannot be used, its cameras cannot be adjusted, or a file cannot be written.
pub(crate) fn run(args: &AdjustArgs, session: &Session) -> Result<Outcome, CliError> {
    let options = args.ingest.options();
    let index = Index::open(&args.scene, options.rpc)?;
    Inputs::of_index(&index).keep_folder(&args.out)?;
    let scene = altitude::open(&index, &options)?;
    let request = AdjustRequest {
        out: &args.out,
        model: args.model,
        images: args.images,
    };
    let adjusted = adjust_scene(&scene, &request, session)?;
    let picture = residuals::picture(&adjusted.vectors());
    write_atomically(&args.out.join("adjustment.svg"), picture.as_bytes())?;
    let text = adjusted.text() + &format!("written to {}\n", args.out.display());
    Ok(Outcome::new(text, adjusted.json()))
}
