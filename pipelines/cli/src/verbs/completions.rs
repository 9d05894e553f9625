//! `heliosplat completions`: prints completions of a shell, from the definition of the command line.

use crate::outcome::{CliError, Outcome};
use clap::{Args, Command};
use clap_complete::Shell;

/// `completions`.
#[derive(Debug, Clone, Args)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_name = "SHELL", value_enum)]
    pub shell: Shell,
}

/// Completion script of `command` for a shell.
///
/// # Errors
/// When the script is not UTF-8.
pub(crate) fn run(args: &CompletionsArgs, mut command: Command) -> Result<Outcome, CliError> {
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, name, &mut script);
    let text = String::from_utf8(script)
        .map_err(|error| CliError::Failed(format!("the script for {} is not UTF-8: {error}", args.shell)))?;
    let json = serde_json::json!({ "shell": args.shell.to_string(), "script": text });
    Ok(Outcome::new(text, json))
}
