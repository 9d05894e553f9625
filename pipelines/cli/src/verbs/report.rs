//! `heliosplat report`: writes the report of a run or a mosaic.

use crate::outcome::{CliError, Outcome};
use clap::Args;
use heliosplat_objects::model::is_object_run;
use heliosplat_pages::report;
use serde_json::json;
use std::path::PathBuf;

/// `report`.
#[derive(Debug, Clone, Args)]
pub struct ReportArgs {
    /// A finished run, of a satellite scene or of an object, or the mosaic of a batch
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
}

/// Writes the report of a run or a mosaic into its folder.
///
/// # Errors
/// When the folder cannot be read, or the page cannot be written.
pub(crate) fn run(args: &ReportArgs) -> Result<Outcome, CliError> {
    let is_mosaic = args.run.join(heliosplat_pages::page::MOSAIC_FILE).is_file();
    let path = match is_object_run(&args.run) {
        _ if is_mosaic => report::mosaic::write(&args.run)?,
        true => report::object::write(&args.run)?,
        false => report::write(&args.run)?,
    };
    let text = format!("{}: open it in a browser", path.display());
    Ok(Outcome::new(text, json!({ "report": path })))
}
