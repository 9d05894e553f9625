//! The folder of a run on a capture: `run.toml`, `model.ply`, `model.json`, `metrics.json`, `views/`.

use crate::config::ObjectConfig;
use crate::model::{self, ObjectModel, damaged};
use crate::plan::Plan;
use heliosplat_fitting::run_folder::{Input, RUN, RunError, read};
use heliosplat_fitting::settings::run_of;
use std::path::{Path, PathBuf};

/// Content of `run.toml`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ObjectRun {
    /// Version of the program.
    pub version: String,
    /// Build of the program; absent in runs of versions that did not state it.
    #[serde(default)]
    pub build: String,
    /// Name of the preset that the configuration started from.
    pub preset: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Path of the capture.
    pub capture: PathBuf,
    /// The images with their hashes.
    pub inputs: Vec<Input>,
    /// The resolved configuration.
    pub config: ObjectConfig,
    /// The fitted model and the reasons for it.
    #[serde(default)]
    pub plan: Option<Plan>,
}

/// Writes a run into `folder`, which must exist; `model.json` last, which makes the folder a run.
///
/// # Errors
/// When a file cannot be written.
pub fn save(folder: &Path, run: &ObjectRun, model: &ObjectModel) -> Result<(), RunError> {
    let path = folder.join(RUN);
    let text = toml::to_string_pretty(run).map_err(|e| damaged(&path, e))?;
    model::save(folder, &[(RUN, &text)], model)
}

/// Reads the `run.toml` of the run in `folder`.
///
/// # Errors
/// When the file is missing or damaged.
pub fn load_run(folder: &Path) -> Result<ObjectRun, RunError> {
    let path = folder.join("run.toml");
    ObjectRun::parse(&read(&path)?).map_err(|e| damaged(&path, e))
}

impl ObjectRun {
    /// Parses the text of a `run.toml`.
    ///
    /// # Errors
    /// A sentence with the fault of the TOML.
    pub fn parse(text: &str) -> Result<Self, String> {
        run_of(text)
    }
}
