//! `heliosplat man`: writes manual pages of the program and of each verb, from the definition of the command line.

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
///
/// # Errors
/// When a page cannot be written.
pub(crate) fn run(args: &ManArgs, command: Command) -> Result<Outcome, CliError> {
    // `--version` names the libraries of this machine, but manual pages are read on others.
    let mut command = command.version(env!("CARGO_PKG_VERSION")).disable_help_subcommand(true);
    command.build();
    let mut pages = Vec::new();
    write_pages(&command, &args.out, &mut pages)?;
    let (count, folder, first) = (pages.len(), args.out.display(), args.out.join("heliosplat.1"));
    let text = format!("{count} pages in {folder}: read one with `man -l {}`", first.display());
    Ok(Outcome::new(text, serde_json::json!({ "pages": pages })))
}

/// Writes the page of a command, then the pages of its verbs; appends their paths to `pages`.
fn write_pages(command: &Command, folder: &Path, pages: &mut Vec<PathBuf>) -> Result<(), CliError> {
    let page = Man::new(command.clone()).source(concat!("heliosplat ", env!("CARGO_PKG_VERSION")));
    let page = page.manual("User Commands");
    let path = folder.join(page.get_filename());
    let mut bytes = Vec::new();
    page.render(&mut bytes)
        .map_err(|error| CliError::Failed(format!("{}: {error}", path.display())))?;
    write_atomically(&path, &bytes)?;
    pages.push(path);
    let mut shown = command.get_subcommands().filter(|verb| !verb.is_hide_set());
    shown.try_for_each(|verb| write_pages(verb, folder, pages))
}
