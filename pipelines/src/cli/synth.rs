//! `heliosplat synth`: scenes with known truth.

use super::{CliError, Outcome, Session};
use clap::Args;

/// Placeholder.
#[derive(Debug, Args)]
pub struct SynthArgs {}

pub(super) fn run(_args: &SynthArgs, _session: &Session) -> Result<Outcome, CliError> {
    Err(CliError::Failed("synth".to_owned()))
}
