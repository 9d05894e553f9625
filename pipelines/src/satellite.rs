//! The satellite pipeline: a scene in, a trained model and its products out.

use crate::cli::evaluate::EvaluateArgs;
use crate::cli::satellite::{DemoArgs, DsmArgs, RelightArgs, RenderArgs, TrainArgs};
use crate::cli::{CliError, Outcome, Session};
use crate::scene::Scene;
use std::path::Path;

/// One component of the model, whether the scene requires it, and why.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PlanItem {
    /// Its name in the configuration.
    pub component: String,
    /// Whether it is on.
    pub on: bool,
    /// Why, in one line.
    pub reason: String,
}

/// Which components of the model this scene requires.
pub fn plan(_scene: &Scene) -> Vec<PlanItem> {
    Vec::new()
}

fn not_built(verb: &str) -> CliError {
    CliError::Failed(format!("{verb}: not built yet"))
}

/// Synthesises a site, trains on it and writes its products.
///
/// # Errors
/// Always, as long as this pipeline is not built.
pub fn demo(_args: &DemoArgs, _session: &Session) -> Result<Outcome, CliError> {
    Err(not_built("demo"))
}

/// Trains a model.
///
/// # Errors
/// Always, as long as this pipeline is not built.
pub fn train(_args: &TrainArgs, _session: &Session) -> Result<Outcome, CliError> {
    Err(not_built("train"))
}

/// Writes the surface model of a run.
///
/// # Errors
/// Always, as long as this pipeline is not built.
pub fn dsm(_args: &DsmArgs, _session: &Session) -> Result<Outcome, CliError> {
    Err(not_built("dsm"))
}

/// Writes the scene of a run under another sun.
///
/// # Errors
/// Always, as long as this pipeline is not built.
pub fn relight(_args: &RelightArgs, _session: &Session) -> Result<Outcome, CliError> {
    Err(not_built("relight"))
}

/// Renders the views of a run.
///
/// # Errors
/// Always, as long as this pipeline is not built.
pub fn render(_args: &RenderArgs, _session: &Session) -> Result<Outcome, CliError> {
    Err(not_built("render"))
}

/// Measures a run against the truth of its scene.
///
/// # Errors
/// Always, as long as this pipeline is not built.
pub fn evaluate(_run: &Path, _args: &EvaluateArgs, _session: &Session) -> Result<Outcome, CliError> {
    Err(not_built("evaluate"))
}
