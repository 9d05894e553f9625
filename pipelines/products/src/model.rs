//! A trained satellite model as files: `model.ply` (the Gaussians) and `model.json` (shared parameters, frame,
//! cameras).

use crate::ply;
use heliosplat::gaussians::Table;
use heliosplat::model::Parameters;
use heliosplat::model::shadow_gs::{DAYS, ShadowGs, ShadowGsOptions, standing};
use heliosplat::render::PassOptions;
use heliosplat::splat::ProjectionOptions;
use heliosplat_fitting::run_folder::{MODEL, RunError, parsed, read_gaussians, save_model};
use heliosplat_radiometry::daylight::Daylight;
use heliosplat_raster::Window;
use heliosplat_rpc::{GeoPoint, LocalFrame, ProjectiveMap, sun::SunPosition};
use heliosplat_scene::indices::{NormalisedDifference, VegetationIndex};
use heliosplat_scene::{Area, BandKind, KnownTiles, Split, SunSource, Values};
use heliosplat_stereo::change::Segment;
use std::path::{Path, PathBuf};

/// Version of the layout of `model.json`.
pub const SCHEMA: u32 = 1;

/// Image of a model: camera, colours and sun.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ModelImage {
    /// Name of the image.
    pub name: String,
    /// Use of the image: train or test.
    pub split: Split,
    /// Index of the image's own colours in the model; `None` where it was not trained on.
    pub appearance: Option<usize>,
    /// Index of the colours of a training image of the same day, for an image held out.
    pub same_day: Option<usize>,
    /// Pinhole camera of the whole image.
    pub map: ProjectiveMap,
    /// Rectangle of the image that shows the area, pixels.
    pub crop: Window,
    /// Correction of the image's pointing, columns and rows, pixels.
    pub shift_px: [f32; 2],
    /// Tiles of the rectangle with data and without clouds; `None`: all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub known: Option<KnownTiles>,
    /// Position of the sun; `None` where it is unknown.
    pub sun: Option<SunPosition>,
    /// Standard deviation of the sun's direction, degrees; `None` where it is unknown.
    pub sun_sigma_deg: Option<f64>,
    /// Source of the sun's position.
    #[serde(default)]
    pub sun_source: SunSource,
    /// Acquisition time; `None` where it is unknown.
    pub time: Option<jiff::Timestamp>,
}

/// Changes between the images, as stored in `model.json`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ModelChanges {
    /// Days that divide the images, days since 1970.
    pub days: Vec<i32>,
    /// Changed segments of the ground, metres of the local frame.
    pub segments: Vec<Segment>,
}

/// Content of `model.json`: all of a model besides its Gaussians.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ModelFile {
    /// Version of the layout: [`SCHEMA`].
    pub schema: u32,
    /// Kind of model: `shadow_gs`.
    pub model: String,
    /// SHA-256 of `model.ply`, hexadecimal; absent in models of versions that did not state it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gaussians_sha256: Option<String>,
    /// Options of the model: bands, images, loss weights.
    pub options: ShadowGsOptions,
    /// Parameters shared by all Gaussians.
    pub globals: Table,
    /// Origin of the local east-north-up frame.
    pub origin: GeoPoint,
    /// Lowest and highest ellipsoidal altitude, metres.
    pub altitude_range_m: (f64, f64),
    /// Modelled ground, metres of the local frame.
    pub area: Area,
    /// Ground sampling distance of the images, metres.
    pub gsd_m: f64,
    /// Counts of the files per unit of the model's colours.
    pub counts_per_unit: f64,
    /// Options of the projection of Gaussians to splats.
    pub projection: ProjectionOptions,
    /// Kinds of the bands.
    pub bands: Vec<BandKind>,
    /// Radiometric quantity of the reference image, whose colour is the model's.
    #[serde(default, skip_serializing_if = "Values::is_unknown")]
    pub values: Values,
    /// Brightness of the ground as a function of the sun; `None` without light, and in models of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub daylight: Option<Daylight>,
    /// Images of the run, training and test.
    pub images: Vec<ModelImage>,
    /// Changes between the images; absent where they cannot be determined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub changes: Option<ModelChanges>,
}

impl ModelFile {
    /// Normalised difference vegetation index of the model's colours; `None` where they have none.
    pub fn ndvi(&self) -> Option<NormalisedDifference> {
        self.values.ndvi(&self.bands)
    }

    /// Index that separates leaves by the model's colours; `None` where there is none.
    pub fn vegetation_index(&self) -> Option<VegetationIndex> {
        self.values.vegetation_index(&self.bands)
    }

    /// True if the model was trained with light: the sun of at least one of its images was known.
    pub fn has_light(&self) -> bool {
        let mut trained = self.images.iter().filter(|image| image.appearance.is_some());
        trained.any(|image| image.sun.is_some())
    }
}

/// Name of the file of a run with the surface that training started from.
pub const START: &str = "start.tif";

/// A model read back from its run.
#[derive(Clone)]
pub struct LoadedModel {
    /// Folder of the run.
    pub folder: PathBuf,
    /// Content of `model.json`.
    pub file: ModelFile,
    /// Rendering model with its options.
    pub model: ShadowGs,
    /// Parameters of the model: Gaussians and shared ones.
    pub parameters: Parameters,
    /// Local frame of the model: metres east, north and up of its origin.
    pub frame: LocalFrame,
}

impl LoadedModel {
    /// Rendering options of products, equal to those of training.
    pub fn pass_options(&self) -> PassOptions {
        PassOptions {
            projection: self.file.projection,
            normals: true,
            ..PassOptions::default()
        }
    }
}

/// Content of the `model.json` of a run.
///
/// # Errors
/// When the folder is no run, or the file is damaged.
pub fn load_file(folder: &Path) -> Result<ModelFile, RunError> {
    parsed(folder, MODEL, ModelFile::parse)
}

impl LoadedModel {
    /// Copy of the model as it stands on a day, days since 1970.
    pub fn on(&self, day: i32) -> Self {
        self.clone().into_day(day as f32)
    }

    /// Copy of the model as it stands on the day of its last image.
    pub fn on_last(&self) -> Self {
        self.clone().last()
    }

    /// The model as it stands on the day of its last image.
    pub fn last(self) -> Self {
        let last = self.model.options.days.iter().copied().fold(f32::MIN, f32::max);
        self.into_day(last)
    }

    /// Removes the Gaussians that do not stand on a day, and all days.
    fn into_day(mut self, day: f32) -> Self {
        let gaussians = &self.parameters.gaussians;
        if let Some(standing) = standing(gaussians, day) {
            let kept: Vec<u32> = (0..gaussians.count as u32).filter(|&g| standing[g as usize]).collect();
            self.parameters.gaussians = gaussians.gather(&kept);
            self.parameters.gaussians.groups.retain(|group| group.spec.name != DAYS);
            self.model.options.days = Vec::new();
            self.file.options.days = Vec::new();
        }
        self
    }
}

/// The model of a run as it stands on the day of the last image.
///
/// # Errors
/// When a file is missing or damaged.
pub fn load(folder: &Path) -> Result<LoadedModel, RunError> {
    load_whole(folder).map(LoadedModel::last)
}

/// The model of a run with the Gaussians of all days.
///
/// # Errors
/// When a file is missing or damaged.
pub fn load_whole(folder: &Path) -> Result<LoadedModel, RunError> {
    let file = load_file(folder)?;
    let model = ShadowGs::new(file.options.clone());
    let (path, bytes) = read_gaussians(folder, file.gaussians_sha256.as_deref())?;
    let gaussians = ply::decode(&bytes, &model).map_err(|reason| RunError::Damaged(path, reason))?;
    let frame = LocalFrame::new(file.origin);
    let globals = file.globals.clone();
    let parameters = Parameters { gaussians, globals };
    Ok(LoadedModel {
        folder: folder.to_owned(),
        file,
        model,
        parameters,
        frame,
    })
}

/// Writes a model into `folder`, which must exist: `model.ply`, the `texts` of the run by their names, and last
/// `model.json`.
///
/// # Errors
/// When a file cannot be written.
pub fn save(folder: &Path, texts: &[(&str, &str)], file: &ModelFile, gaussians: &Table) -> Result<(), RunError> {
    save_model(folder, &ply::encode(gaussians, file.options.bands), texts, |sum| {
        serde_json::to_string_pretty(&ModelFile {
            gaussians_sha256: Some(sum),
            ..file.clone()
        })
    })
}
