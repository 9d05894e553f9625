//! The file of `train --config`: a `run.toml`, or a file with some of its keys.

use super::model_args::TrainArgs;
use crate::outcome::CliError;
use heliosplat_fitting::settings::run_of;
use heliosplat_scene::AreaRequest;
use serde::Deserialize;
use std::path::Path;

/// Keys of a `run.toml` that state how it was made, not how to make it.
const RECORDS: [&str; 7] = [
    "version",
    "build",
    "scene",
    "capture",
    "altitude_from_ties_m",
    "plan",
    "inputs",
];

/// Content of the file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ConfigFile {
    preset: Option<String>,
    seed: Option<u64>,
    altitude_range_m: Option<[f64; 2]>,
    area: Option<AreaRequest>,
    #[serde(default)]
    config: toml::Table,
}

/// Adds the values of the file at `path` to arguments that do not have them.
///
/// # Errors
/// When the file cannot be read, or has an unknown key or preset.
pub(super) fn complete(args: &mut TrainArgs, path: &Path) -> Result<(), CliError> {
    let fault = |reason: &dyn std::fmt::Display| CliError::Input(format!("--config {}: {reason}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| fault(&error))?;
    let mut table: toml::Table = run_of(&text).map_err(|error| fault(&error))?;
    table.retain(|key, _| !RECORDS.contains(&key));
    let file = ConfigFile::deserialize(table).map_err(|error| fault(&error.message()))?;
    let preset = file.preset.as_deref().map(str::parse).transpose();
    args.preset = args.preset.or(preset.map_err(|error| fault(&error))?);
    args.seed = args.seed.or(file.seed);
    args.ingest.altitude = args.ingest.altitude.or(file.altitude_range_m);
    args.ingest.area = args.ingest.area.take().or(file.area);
    let mut set = Vec::new();
    settings(&file.config, "", &mut set);
    set.append(&mut args.set);
    args.set = set;
    Ok(())
}

/// Settings of nested tables as pairs of a dotted key and a value. Corrections by name of image are one value, since
/// names may have dots.
fn settings(table: &toml::Table, group: &str, pairs: &mut Vec<(String, String)>) {
    for (key, value) in table {
        let key = format!("{group}{key}");
        match value {
            toml::Value::Table(inner) if key != "cameras.shifts_px" => settings(inner, &format!("{key}."), pairs),
            value => pairs.push((key, value.to_string())),
        }
    }
}
