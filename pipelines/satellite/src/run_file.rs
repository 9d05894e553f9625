//! `run.toml` of a satellite run (configuration, version, seed, inputs), and writing of a run's folder.
//!
//! A run is `run.toml` (resolved configuration, version, seed, inputs with hashes), `cut.json` (the pixels used),
//! `model.ply` (the Gaussians), `model.json` (shared parameters, the frame and the cameras), `metrics.json`, `dsm.tif`
//! and pictures. Every file is written under a temporary name and renamed.

use crate::config::SatelliteConfig;
use crate::error::SatelliteError;
use crate::fit::Fitted;
use crate::plan::PlanItem;
use heliosplat::gaussians::Table;
use heliosplat_fitting::run_folder::{Input, RUN, RunError, parsed, read};
use heliosplat_fitting::settings::run_of;
use heliosplat_products::model::{self, ModelFile, ModelImage};
use heliosplat_scene::crop;
use heliosplat_scene::{AreaRequest, Index, KeptCut, Scene, Split};
use std::path::{Path, PathBuf};

/// Content of `run.toml`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RunFile {
    /// Version of the program.
    pub version: String,
    /// Build of the program; empty in runs of versions that did not state it.
    #[serde(default)]
    pub build: String,
    /// Preset at the start of the configuration.
    pub preset: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Folder or `scene.toml` of the scene.
    pub scene: PathBuf,
    /// Requested range of altitudes, metres above the ellipsoid; `None` if there was no request.
    pub altitude_range_m: Option<(f64, f64)>,
    /// Range of altitudes from tie points, metres above the ellipsoid; `None` if another source gave the range.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub altitude_from_ties_m: Option<(f64, f64)>,
    /// Requested area; `None` for all of the common ground.
    #[serde(default)]
    pub area: Option<AreaRequest>,
    /// Components that the scene required, with reasons.
    pub plan: Vec<PlanItem>,
    /// Images, with their hashes.
    pub inputs: Vec<Input>,
    /// The resolved configuration.
    pub config: SatelliteConfig,
}

impl RunFile {
    /// Parses the text of a `run.toml`.
    ///
    /// # Errors
    /// One sentence with the fault.
    pub fn parse(text: &str) -> Result<Self, String> {
        run_of(text)
    }
}

/// Entries of a scene's images in `model.json`: all images that show the area, grown by `margin_m` metres; training
/// images with their colours.
pub fn model_images(scene: &Scene, fitted: &Fitted, margin_m: f64) -> Vec<ModelImage> {
    let area = crop::grown(&scene.area, margin_m);
    let up_m = crop::altitude_range(scene);
    let all: Vec<_> = scene.images.iter().collect();
    let dates = crop::date_groups(&all);
    let date_of = |name: &str| all.iter().position(|image| image.name == name).map(|i| dates[i]);
    scene
        .images
        .iter()
        .zip(&fitted.suns)
        .filter_map(|(image, sun)| {
            let appearance = fitted
                .images
                .iter()
                .position(|name| *name == image.name && image.split == Split::Train);
            Some(ModelImage {
                name: image.name.clone(),
                split: image.split,
                appearance,
                same_day: fitted
                    .images
                    .iter()
                    .position(|name| appearance.is_none() && date_of(name) == date_of(&image.name)),
                map: image.pinhole.map,
                crop: crop::window_of(image, &area, up_m)?,
                shift_px: appearance.map_or([0.0; 2], |a| fitted.found.shifts_px[a]),
                known: appearance.and_then(|a| fitted.known[a].clone()),
                sun: sun.position,
                sun_sigma_deg: sun.sigma_deg,
                sun_source: sun.source,
                time: image.time,
            })
        })
        .collect()
}

/// Writes model and configuration into `folder`, which must exist. `model.json` comes last, since it marks the folder
/// as a run.
///
/// # Errors
/// When a file cannot be written.
pub fn save(folder: &Path, run: &RunFile, cut: &KeptCut, file: &ModelFile, gaussians: &Table) -> Result<(), RunError> {
    let text = toml::to_string_pretty(run).map_err(|error| RunError::Damaged(folder.join(RUN), error.to_string()))?;
    let cut = serde_json::to_string(cut).unwrap_or_default();
    model::save(folder, &[(RUN, &text), (CUT, &cut)], file, gaussians)
}

/// Reads the `run.toml` of a run.
///
/// # Errors
/// When the file is missing or damaged.
pub fn load_run(folder: &Path) -> Result<RunFile, RunError> {
    parsed(folder, RUN, RunFile::parse)
}

/// Name of the file with the cut of a run.
pub const CUT: &str = "cut.json";

/// Reads the cut that a run was trained on.
///
/// # Errors
/// When the file is missing or damaged.
pub fn cut_of(run: &Path) -> Result<KeptCut, RunError> {
    let path = run.join(CUT);
    let damaged = |reason: String| RunError::Damaged(path.clone(), reason);
    if !path.is_file() {
        return Err(damaged(
            "not there, so the pixels that the run was trained on are not known".into(),
        ));
    }
    serde_json::from_str(&read(&path)?).map_err(|error| damaged(error.to_string()))
}

/// Reads the scene that a run was trained on, with its windows, cameras and scale.
///
/// # Errors
/// When the run or its scene cannot be read, or the scene has changed since the training.
pub fn scene_of(run: &Path) -> Result<Scene, SatelliteError> {
    let file = load_run(run)?;
    let kept = cut_of(run)?;
    let unreadable = |error| SatelliteError::SceneOfRun {
        run: run.to_owned(),
        error,
    };
    let index = Index::open(&file.scene, kept.rpc).map_err(unreadable)?;
    let other = |difference| {
        let run = run.display();
        SatelliteError::Input(format!(
            "{run}: its scene is not the one that it was trained on: {difference}; restore the scene, or train again"
        ))
    };
    let cut = kept.again(&index).map_err(other)?;
    let scene = Scene::read(&index, &cut, Vec::new()).map_err(unreadable)?;
    kept.check_pixels(&scene.images).map_err(other)?;
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_with_settings_that_are_gone_is_read_and_one_with_unknown_settings_is_not() {
        let run = |settings: &str| {
            let start = "version = \"0\"\nbuild = \"b\"\npreset = \"fast\"\nseed = 1\nscene = \"s\"\naltitude_range_m = [0.0, 9.0]\nplan = []\ninputs = []";
            RunFile::parse(&format!("{start}\n{settings}"))
        };
        assert!(run("[config.start]\nstep_opacity = 0.35\n[config.model]\nopaqueness_weight = 0.0\n[config.train]\ndepth_normal_weight = 0.1").is_ok());
        let fault = run("[config.model]\nopaque = 0.0").expect_err("unknown");
        assert!(fault.contains("opaque"), "{fault}");
    }
}
