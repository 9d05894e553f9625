//! `heliosplat man`: manual pages, one for the program and one for each verb, from the definition of the command line itself.

use crate::outcome::{CliError, Outcome};
use clap::{Args, Command};
use clap_mangen::Man;
use heliosplat_raster::write::write_atomically;
use std::path::{Path, PathBuf};

/// `man`.
#[derive(Debug, Clone, Args)]
pub struct ManArgs {
    /// Folder of the pages, made if absent
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Writes the pages of `command`: `heliosplat.1`, `heliosplat-train.1` and so on.
pub(crate) fn run(args: &ManArgs, command: Command) -> Result<Outcome, CliError> {
    // The libraries that `--version` names are those of this machine; a manual page is read on others.
    let mut command = command.version(env!("CARGO_PKG_VERSION")).disable_help_subcommand(true);
    command.build();
    let mut pages = Vec::new();
    write_pages(&command, &args.out, &mut pages)?;
    Ok(Outcome {
        text: format!(
            "{} pages in {}: read one with `man -l {}`",
            pages.len(),
            args.out.display(),
            args.out.join("heliosplat.1").display()
        ),
        json: serde_json::json!({ "pages": pages }),
    })
}

/// The page of a command, then those of its verbs.
fn write_pages(command: &Command, folder: &Path, pages: &mut Vec<PathBuf>) -> Result<(), CliError> {
    let page = Man::new(command.clone())
        .source(concat!("heliosplat ", env!("CARGO_PKG_VERSION")))
        .manual("User Commands");
    let path = folder.join(page.get_filename());
    let mut bytes = Vec::new();
    page.render(&mut bytes)
        .map_err(|error| CliError::Failed(format!("{}: {error}", path.display())))?;
    write_atomically(&path, &bytes)?;
    pages.push(path);
    command
        .get_subcommands()
        .filter(|verb| !verb.is_hide_set())
        .try_for_each(|verb| write_pages(verb, folder, pages))
}
