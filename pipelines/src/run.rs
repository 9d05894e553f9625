//! The folder of a run: what was trained, from what, with what, and the model itself.
//!
//! `run.toml` (resolved configuration, version, seed, inputs with hashes), `model.ply` (the Gaussians), `model.json` (what is
//! shared, the frame and the cameras), `metrics.json`, `dsm.tif`, pictures. Everything is written to a temporary name and
//! renamed.

pub mod checkpoint;
mod model_file;
pub mod ply;

use crate::product::surface::Standing;
use crate::raster::RasterError;
use crate::raster::write::write_atomically;
use crate::satellite::config::SatelliteConfig;
use crate::satellite::views::Crop;
use crate::satellite::{PlanItem, fit::Fitted, views};
use crate::scene::{Area, AreaRequest, BandKind, Scene, Split};
use crate::trust;
use heliosplat::Raster;
use heliosplat::gaussians::Table;
use heliosplat::model::Parameters;
use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
use heliosplat::render::PassOptions;
use heliosplat::splat::ProjectionOptions;
use heliosplat::trace::TraceOptions;
use heliosplat_rpc::{GeoPoint, LocalFrame, ProjectiveMap, sun::SunPosition};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Version of `model.json`.
pub const SCHEMA: u32 = 1;

/// Why a run cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// There is no such run.
    #[error("{0}: not a finished run (it has no model.json); train one with `heliosplat train SCENE --out {0}`")]
    NotARun(PathBuf),
    /// A file of the run that is not what it should be.
    #[error("{path}: {reason}; train the run again")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file that cannot be read.
    #[error("{path}: {reason}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        reason: std::io::Error,
    },
    /// A file that cannot be written.
    #[error(transparent)]
    Write(#[from] RasterError),
}

/// One image as the model knows it.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ModelImage {
    /// Its name.
    pub name: String,
    /// Train or test.
    pub split: Split,
    /// Its own colour in the model, if it was trained on.
    pub appearance: Option<usize>,
    /// For an image held out: the colour of one taken the same day that was trained on.
    #[serde(default)]
    pub same_day: Option<usize>,
    /// The pinhole camera of the whole image.
    pub map: ProjectiveMap,
    /// The rectangle of it that shows the area.
    pub crop: Crop,
    /// Correction of its pointing, pixels.
    pub shift_px: [f32; 2],
    /// Its sun.
    pub sun: SunPosition,
    /// When it was taken, if known.
    #[serde(default)]
    pub time: Option<jiff::Timestamp>,
}

/// `model.json`: all of a model besides its Gaussians.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ModelFile {
    /// Version of this layout.
    pub schema: u32,
    /// Kind of scene.
    pub model: String,
    /// What the model is made of.
    pub options: ShadowGsOptions,
    /// What all Gaussians share.
    pub globals: Table,
    /// Origin of the local east-north-up frame.
    pub origin: GeoPoint,
    /// Lowest and highest ellipsoidal altitude, metres.
    pub altitude_range_m: (f64, f64),
    /// Ground that is modelled, metres of the local frame.
    pub area: Area,
    /// Ground sampling distance of the images, metres.
    pub gsd_m: f64,
    /// Counts of the files per unit of the model's colours.
    pub counts_per_unit: f64,
    /// How Gaussians become splats.
    pub projection: ProjectionOptions,
    /// How light is traced.
    pub trace: TraceOptions,
    /// What the bands are.
    pub bands: Vec<BandKind>,
    /// The images.
    pub images: Vec<ModelImage>,
}

/// One input of a run.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Input {
    /// The file.
    pub path: PathBuf,
    /// Its SHA-256, hexadecimal; of a file on a virtual file system, that of the pixels that were read.
    pub sha256: String,
}

/// `run.toml`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RunFile {
    /// Version of the program.
    pub version: String,
    /// Preset the configuration started from.
    pub preset: String,
    /// Seed of everything random.
    pub seed: u64,
    /// The scene.
    pub scene: PathBuf,
    /// The altitude range asked for, if any, metres.
    pub altitude_range_m: Option<(f64, f64)>,
    /// The piece of ground asked for, if any.
    #[serde(default)]
    pub area: Option<AreaRequest>,
    /// Which components the scene required, and why.
    pub plan: Vec<PlanItem>,
    /// The images, hashed.
    pub inputs: Vec<Input>,
    /// The resolved configuration.
    pub config: SatelliteConfig,
}

impl RunFile {
    /// What the text of a `run.toml` says.
    ///
    /// # Errors
    /// A sentence that says what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        toml::from_str(text).map_err(|e| e.message().to_owned())
    }
}

/// A model read back from its run.
pub struct LoadedModel {
    /// The folder.
    pub folder: PathBuf,
    /// What `model.json` says.
    pub file: ModelFile,
    /// The model.
    pub model: ShadowGs,
    /// Its parameters.
    pub parameters: Parameters,
    /// The local frame.
    pub frame: LocalFrame,
}

impl LoadedModel {
    /// Its Gaussians as a surface.
    pub fn standing(&self) -> Standing<'_> {
        Standing {
            gaussians: &self.parameters.gaussians,
            bands: &self.file.bands,
            projection: self.file.projection,
        }
    }

    /// How products look at the model: as training did.
    pub fn pass_options(&self) -> PassOptions {
        PassOptions {
            projection: self.file.projection,
            trace: self.file.trace,
            normals: true,
            ..PassOptions::default()
        }
    }
}

fn read(path: &Path) -> Result<String, RunError> {
    trust::read_text(path).map_err(|reason| RunError::Io {
        path: path.to_owned(),
        reason,
    })
}

/// SHA-256 of a file, hexadecimal.
///
/// # Errors
/// When the file cannot be read.
pub fn hash(path: &Path) -> Result<String, RunError> {
    let io = |reason| RunError::Io {
        path: path.to_owned(),
        reason,
    };
    let mut file = std::fs::File::open(path).map_err(io)?;
    let mut hasher = Sha256::new();
    std::io::copy(&mut file, &mut hasher).map_err(io)?;
    Ok(hex::encode(hasher.finalize()))
}

/// SHA-256 of the values of a raster, hexadecimal.
pub fn hash_of_pixels(raster: &Raster) -> String {
    let mut hasher = Sha256::new();
    for value in &raster.values {
        hasher.update(value.to_le_bytes());
    }
    hex::encode(hasher.finalize())
}

/// What `model.json` says of a scene's images: all that show the area, those trained on with their colours.
pub fn model_images(scene: &Scene, fitted: &Fitted, margin_m: f64) -> Vec<ModelImage> {
    let area = views::grown(&scene.area, margin_m);
    let up_m = views::altitude_range(scene);
    let all: Vec<_> = scene.images.iter().collect();
    let dates = views::date_groups(&all);
    let date_of = |name: &str| all.iter().position(|image| image.name == name).map(|i| dates[i]);
    scene
        .images
        .iter()
        .filter_map(|image| {
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
                crop: Crop::of(image, &area, up_m)?,
                shift_px: appearance.map_or([0.0; 2], |a| fitted.shifts_px[a]),
                sun: image.sun,
                time: image.time,
            })
        })
        .collect()
}

/// Writes model and configuration into `folder`, which must exist; `model.json` last, which makes the run a run.
///
/// # Errors
/// When a file cannot be written.
pub fn save(folder: &Path, run: &RunFile, model: &ModelFile, gaussians: &Table) -> Result<(), RunError> {
    let damaged = |name: &str, reason: String| RunError::Damaged {
        path: folder.join(name),
        reason,
    };
    let text = toml::to_string_pretty(run).map_err(|e| damaged("run.toml", e.to_string()))?;
    // What was measured of an earlier run here is not true of this one; and metrics are what makes a run finished.
    let _ = std::fs::remove_file(folder.join("metrics.json"));
    // The large file first: where it finds no room, nothing is written.
    write_atomically(&folder.join("model.ply"), &ply::encode(gaussians, model.options.bands))?;
    write_atomically(&folder.join("run.toml"), text.as_bytes())?;
    let text = serde_json::to_string_pretty(model).map_err(|e| damaged("model.json", e.to_string()))?;
    write_atomically(&folder.join("model.json"), text.as_bytes())?;
    Ok(())
}

/// The `run.toml` of a run.
///
/// # Errors
/// When it is missing or damaged.
pub fn load_run(folder: &Path) -> Result<RunFile, RunError> {
    let path = folder.join("run.toml");
    if !path.is_file() {
        return Err(RunError::NotARun(folder.to_owned()));
    }
    RunFile::parse(&read(&path)?).map_err(|reason| RunError::Damaged { path, reason })
}

/// What the `model.json` of a run says.
///
/// # Errors
/// When it is missing or damaged.
pub fn load_file(folder: &Path) -> Result<ModelFile, RunError> {
    let path = folder.join("model.json");
    if !path.is_file() {
        return Err(RunError::NotARun(folder.to_owned()));
    }
    ModelFile::parse(&read(&path)?).map_err(|reason| RunError::Damaged { path, reason })
}

/// The model of a run.
///
/// # Errors
/// When a file is missing or damaged.
pub fn load(folder: &Path) -> Result<LoadedModel, RunError> {
    let damaged = |path: &Path, reason: String| RunError::Damaged {
        path: path.to_owned(),
        reason,
    };
    let file = load_file(folder)?;
    let model = ShadowGs::new(file.options.clone());
    let ply_path = folder.join("model.ply");
    let bytes = trust::read_bytes(&ply_path, trust::MODEL_MAX).map_err(|reason| RunError::Io {
        path: ply_path.clone(),
        reason,
    })?;
    let gaussians = ply::decode(&bytes, &model).map_err(|reason| damaged(&ply_path, reason))?;
    let frame = LocalFrame::new(file.origin);
    let parameters = Parameters {
        gaussians,
        globals: file.globals.clone(),
    };
    Ok(LoadedModel {
        folder: folder.to_owned(),
        file,
        model,
        parameters,
        frame,
    })
}

/// Writes `metrics.json`.
///
/// # Errors
/// When it cannot be written.
pub fn save_metrics(folder: &Path, metrics: &serde_json::Value) -> Result<(), RunError> {
    let text = format!("{metrics:#}\n");
    Ok(write_atomically(&folder.join("metrics.json"), text.as_bytes())?)
}

/// Memory that this process holds now, bytes; zero where the system does not tell.
pub fn resident_bytes() -> u64 {
    status_bytes("VmRSS:")
}

/// The most memory this process has used, bytes; zero where the system does not tell.
pub fn peak_rss_bytes() -> u64 {
    status_bytes("VmHWM:")
}

/// One size of `/proc/self/status`, bytes. The kernel says them in KiB there, whatever the size of its pages.
fn status_bytes(field: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let kib = status
        .lines()
        .find_map(|line| line.strip_prefix(field))
        .and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) * 1024
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn the_most_memory_used_is_no_less_than_what_was_held_before() {
        let before = resident_bytes();
        drop(std::hint::black_box(vec![1u8; 64 << 20]));
        let most = peak_rss_bytes();
        assert!(before > 0 && most >= before + (32 << 20), "{before} {most}");
    }
}
