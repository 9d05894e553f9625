//! Arguments of `evaluate`, and the table and pictures of an evaluation.

use crate::outcome::CliError;
use clap::Args;
use heliosplat_evaluate::{DsmEvaluation, DsmMetrics, HeightErrors, Protocol, error_map};
use heliosplat_pages::page::calibration;
use heliosplat_raster::preview::write_png;
use heliosplat_raster::write_atomically;
use std::fmt::Write;
use std::path::PathBuf;

/// Inputs and options of `evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// A run, measured against the truth of its scene; or a DSM, with `--truth`
    #[arg(value_name = "RUN", conflicts_with = "dsm")]
    pub run: Option<PathBuf>,
    /// A DSM
    #[arg(long, value_name = "FILE", requires = "truth")]
    pub dsm: Option<PathBuf>,
    /// The true DSM
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// LAS classes on the truth's grid
    #[arg(long, value_name = "FILE", requires = "truth")]
    pub classes: Option<PathBuf>,
    /// Registration of the DSM to the truth before the comparison
    #[arg(long, value_name = "NAME", default_value = "raw")]
    pub protocol: Protocol,
    /// Folder with truth of relit images (`relit.json`, `relit_K.tif`, `relit_K_shadow.tif`) [default: that of the scene]
    #[arg(long, value_name = "FOLDER", requires = "run", conflicts_with = "truth")]
    pub relit: Option<PathBuf>,
    /// Picture of the errors to write (PNG; blue 5 m too low, red 5 m too high)
    #[arg(long, value_name = "FILE")]
    pub error_map: Option<PathBuf>,
    /// Chart of standard deviations against errors to write (SVG)
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
}

/// Writes the requested pictures of an evaluation.
///
/// # Errors
/// When a file cannot be written, or `--calibration` is given for a DSM without standard deviations.
pub fn write_pictures(args: &EvaluateArgs, evaluation: &DsmEvaluation) -> Result<(), CliError> {
    if let Some(path) = &args.error_map {
        write_png(path, &error_map::draw(&evaluation.errors))?;
    }
    if let Some(path) = &args.calibration {
        let Some(uncertainty) = &evaluation.metrics.uncertainty else {
            let text =
                "evaluate: --calibration needs a DSM with a band of standard deviations, as `heliosplat dsm` writes it";
            return Err(CliError::Input(text.into()));
        };
        write_atomically(path, calibration::draw(uncertainty, |chart| chart.file()).as_bytes())?;
    }
    Ok(())
}

/// Formats metrics as a table for a terminal: errors in total, by class and by distance from walls, and uncertainty.
pub fn table(metrics: &DsmMetrics) -> String {
    let (protocol, [east, north, up]) = (&metrics.protocol, metrics.shift_m);
    let mut text = format!("protocol {protocol}   shift east {east:.2} north {north:.2} up {up:.2} m\n");
    text.push_str("class          MAE m   RMSE m  median m   NMAD m  within 1 m  beyond 5 m  complete\n");
    let mut line = |name: &str, errors: &HeightErrors| {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{name:<12} {:>7.3}  {:>7.3}   {:>7.3}  {:>7.3}     {:>5.1} %     {:>5.2} %   {:>5.1} %",
            errors.mae_m,
            errors.rmse_m,
            errors.median_m,
            errors.nmad_m,
            100.0 * errors.within_1m,
            100.0 * errors.beyond_5m,
            100.0 * errors.completeness
        );
    };
    line("all", &metrics.all);
    if let Some(errors) = &metrics.ground_and_buildings {
        line("ground, built", errors);
    }
    for (name, errors) in &metrics.by_class {
        line(name, errors);
    }
    for edge in &metrics.edges {
        let distance = match edge.to_m {
            Some(to_m) => format!("{} to {to_m} m from walls", edge.from_m),
            None => format!("{} m and more", edge.from_m),
        };
        let (mae_m, mean_m, share) = (edge.errors.mae_m, edge.mean_m, 100.0 * edge.share_of_error);
        text +=
            &format!("ground {distance:<23} MAE {mae_m:>6.3} m, mean {mean_m:>+6.3} m, {share:>4.1} % of the error\n");
    }
    if let Some(distance_m) = metrics.outside_truth_m {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "outside the true altitudes of 3 x 3 cells: MAE {distance_m:.3} m");
    }
    if let Some(share) = metrics.seen_unknown {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "unknown of what two images see: {:.2} %", 100.0 * share);
    }
    if let Some(uncertainty) = &metrics.uncertainty {
        text += &uncertainty.table();
    }
    text
}
