//! `heliosplat evaluate`: measures a run or a DSM against truth.

use super::evaluate_args::{EvaluateArgs, table, write_pictures};
use super::model;
use crate::outcome::{CliError, Outcome};
use crate::outputs::{Inputs, must_end_in};
use heliosplat_evaluate::evaluate_dsm;

/// Measures a DSM against a truth file, or a run against the truth of its scene.
///
/// # Errors
/// When an option or a file cannot be used, or a picture cannot be written.
pub(crate) fn run(args: &EvaluateArgs) -> Result<Outcome, CliError> {
    for (path, option, format) in [
        (&args.error_map, "--error-map", "png"),
        (&args.calibration, "--calibration", "svg"),
    ] {
        if let Some(path) = path {
            must_end_in(option, path, &[format])?;
            args.run.iter().try_for_each(|run| Inputs::of_run(run).keep(path))?;
            Inputs::of_files([&args.dsm, &args.truth, &args.classes].into_iter().flatten()).keep(path)?;
        }
    }
    let dsm = match (&args.dsm, &args.run) {
        (Some(dsm), _) => dsm.clone(),
        (None, Some(file)) if file.is_file() => file.clone(),
        (None, Some(run)) if args.truth.is_some() => run.join("dsm.tif"),
        (None, Some(run)) => return model::evaluate(run, args),
        (None, None) => return Err(CliError::Input("evaluate: give a RUN, or --dsm and --truth".to_owned())),
    };
    let Some(truth) = &args.truth else {
        return Err(CliError::Input("evaluate: a DSM needs --truth FILE".to_owned()));
    };
    let evaluation = evaluate_dsm(&dsm, truth, args.classes.as_deref(), args.protocol)?;
    for warning in &evaluation.warnings {
        tracing::warn!("{warning}");
    }
    write_pictures(args, &evaluation)?;
    let text = table(&evaluation.metrics);
    Ok(Outcome::new(text, serde_json::json!({ "dsm": evaluation.metrics })))
}
