//! `heliosplat report`: a run on one page.

use super::{CliError, Outcome};
use clap::Args;
use serde_json::json;
use std::path::PathBuf;

/// `report`.
#[derive(Debug, Clone, Args)]
pub struct ReportArgs {
    /// A finished run of a satellite scene
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
}

pub(super) fn run(args: &ReportArgs) -> Result<Outcome, CliError> {
    if crate::objects::run::is_object_run(&args.run) {
        return Err(CliError::Input(format!(
            "{}: report shows runs of satellite scenes; look at a run of an object with `heliosplat render`",
            args.run.display()
        )));
    }
    let path = crate::report::write(&args.run)?;
    Ok(Outcome {
        text: format!("{}: open it in a browser", path.display()),
        json: json!({ "report": path }),
    })
}
