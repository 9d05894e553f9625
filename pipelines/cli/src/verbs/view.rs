//! `heliosplat view`: writes a page with a movable sun over a surface.

use crate::outcome::{CliError, Outcome};
use crate::outputs::{Inputs, must_end_in};
use clap::Args;
use heliosplat_pages::view;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// `view`.
#[derive(Debug, Clone, Args)]
pub struct ViewArgs {
    /// A finished run of a satellite scene, or the mosaic of a batch
    #[arg(value_name = "RUN", conflicts_with = "dsm")]
    pub run: Option<PathBuf>,
    /// Surface model to show instead of a run's
    #[arg(long, value_name = "FILE")]
    pub dsm: Option<PathBuf>,
    /// Albedo, or another ortho image, over that surface model
    #[arg(long, value_name = "FILE", requires = "dsm")]
    pub albedo: Option<PathBuf>,
    /// Page to write [default: sun.html in RUN, which is then opened in the browser]
    #[arg(long, value_name = "FILE.html")]
    pub out: Option<PathBuf>,
}

/// Writes the page, and opens it in the browser if neither `--out` nor `--json` is given.
///
/// # Errors
/// When the surface cannot be read, or the page cannot be written or would replace an input.
pub(crate) fn run(args: &ViewArgs, json: bool) -> Result<Outcome, CliError> {
    if let Some(out) = &args.out {
        must_end_in("--out", out, &["html", "htm"])?;
        args.run.iter().try_for_each(|run| Inputs::of_run(run).keep(out))?;
        Inputs::of_files(args.dsm.iter().chain(&args.albedo)).keep(out)?;
    }
    let (exhibit, beside) = match (&args.run, &args.dsm) {
        (Some(run), _) => (view::of_folder(run)?, run.join(view::FILE)),
        (None, Some(dsm)) => (
            view::of_files(dsm, args.albedo.as_deref())?,
            dsm.with_file_name(view::FILE),
        ),
        (None, None) => return Err(CliError::Input("view: give a RUN, or --dsm FILE".into())),
    };
    let cells = exhibit.altitude.plane_len();
    let written = view::write(&exhibit, args.out.as_ref().unwrap_or(&beside))?;
    let opened = args.out.is_none() && !json && open(&written.path);
    let (width, height) = written.size;
    let averaged = if width * height < cells { " (averaged)" } else { "" };
    let next = if opened { "opened in the" } else { "open it in a" };
    let (page, megabytes) = (written.path.display(), written.bytes as f64 / 1e6);
    let text = format!("{page}: {width} x {height} cells{averaged}, {megabytes:.2} MB; {next} browser");
    let json = json!({"page": written.path, "bytes": written.bytes, "width": width, "height": height});
    Ok(Outcome::new(text, json))
}

/// Opens a file in the user's browser; returns true on success.
fn open(path: &Path) -> bool {
    let silent = Stdio::null;
    let mut command = Command::new("xdg-open");
    command.arg(path).stdin(silent()).stdout(silent()).stderr(silent());
    command.status().is_ok_and(|status| status.success())
}
