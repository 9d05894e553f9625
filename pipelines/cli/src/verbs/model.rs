//! `train`, `relight`, `render`, `export` and `evaluate`: dispatch to the pipeline of satellite scenes or of objects.

use super::evaluate_args::EvaluateArgs;
use super::export_args::ExportArgs;
use super::model_args::{RelightArgs, RenderArgs, TrainArgs};
use super::{config_file, export, object, satellite};
use crate::args::scene_of;
use crate::outcome::{CliError, Outcome};
use heliosplat_fitting::request::Earlier;
use heliosplat_fitting::{checkpoint, run_folder};
use heliosplat_objects::is_capture;
use heliosplat_objects::model::is_object_run;
use heliosplat_session::Session;
use std::path::Path;

/// Trains a model of a satellite scene or of a capture.
///
/// # Errors
/// When the folder of the run is occupied, and errors of the pipeline.
pub(crate) fn train(args: &TrainArgs, session: &Session) -> Result<Outcome, CliError> {
    // An occupied folder without a checkpoint is refused before the images are read. The inputs of a checkpoint are
    // compared after that.
    if args.earlier() == Earlier::Keep && !checkpoint::path_in(&args.out).exists() {
        run_folder::must_be_free(&args.out)?;
    }
    let mut args = TrainArgs {
        scene: scene_of(&args.scenes, &args.out.join("scene"))?,
        ..args.clone()
    };
    if let Some(file) = args.config.take() {
        config_file::complete(&mut args, &file)?;
    }
    let args = &args;
    match is_capture(&args.scene) {
        true => object::train(args, session),
        false => satellite::train(args, session),
    }
}

/// Renders a run under another light.
///
/// # Errors
/// Errors of the pipeline.
pub(crate) fn relight(args: &RelightArgs) -> Result<Outcome, CliError> {
    match is_object_run(&args.run) {
        true => object::relight(args),
        false => satellite::relight(args),
    }
}

/// Renders the views of a run.
///
/// # Errors
/// Errors of the pipeline.
pub(crate) fn render(args: &RenderArgs, session: &Session) -> Result<Outcome, CliError> {
    match is_object_run(&args.run) {
        true => object::render(args, session),
        false => satellite::render(args, session),
    }
}

/// Exports a run, or a mosaic, for other programs.
///
/// # Errors
/// Errors of the pipeline.
pub(crate) fn export(args: &ExportArgs, session: &Session) -> Result<Outcome, CliError> {
    match is_object_run(&args.run) {
        true => object::export(args, session),
        false => export::of_satellite(args),
    }
}

/// Measures a run against the truth of its scene, or against its held-out images.
///
/// # Errors
/// When `--relit` is given for the run of an object, and errors of the pipeline.
pub(crate) fn evaluate(run: &Path, args: &EvaluateArgs) -> Result<Outcome, CliError> {
    match is_object_run(run) {
        true if args.relit.is_some() => Err(CliError::Input(format!(
            "{}: a run of an object; --relit is for runs of satellite scenes",
            run.display()
        ))),
        true => object::evaluate(run),
        false => satellite::evaluate(run, args),
    }
}
