//! `heliosplat report`: writes the report of a run or a mosaic.

use crate::outcome::{CliError, Outcome};
use clap::Args;
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
    let path = if args.run.join(heliosplat_pages::page::MOSAIC_FILE).is_file() {
        report::mosaic::write(&args.run)?
    } else if heliosplat_objects::model::is_object_run(&args.run) {
        report::object::write(&args.run)?
    } else {
        report::write(&args.run)?
    };
    Ok(Outcome {
        text: format!("{}: open it in a browser", path.display()),
        json: json!({ "report": path }),
    })
}
