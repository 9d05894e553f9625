//! Description of a folder of satellite images: files, cameras, times, suns, bands, values and truth.
//!
//! A delivery is recognised by its files: a `scene.toml`, a folder of images, or the folders of Sat-NeRF and EOGS.
//! Every image needs a rational camera; its sun may be unknown. No pixels are read. Missing or contradictory metadata
//! are an error of one line with the file; unusual metadata are warnings.

mod acquisition;
mod altitude;
mod bands;
mod calibration;
mod camera;
mod checks;
mod dimap;
mod draft;
mod drafts;
mod entry;
mod error;
mod files;
mod identity;
mod index;
mod layout;
mod manifest;
mod names;
mod pair_names;
mod pairs;
mod relit_truth;
mod satnerf;
mod sidecars;
mod stacks;
mod sun;
mod tiles;
mod truth;
mod weak_times;

pub use altitude::{AltitudeRange, AltitudeSource, Stated};
pub use bands::{BandPlan, in_words as bands_in_words};
pub use calibration::FoundRadiometry;
pub use checks::{Finding, Severity};
pub use error::{Result, SceneError};
pub use identity::{FileIdentity, Hashes, Seen, seen};
pub use index::{Index, IndexImage};
pub use manifest::{Counts, toml_fault};
pub use relit_truth::{RelitTruth, relit_truth};
pub use sun::{ImageSun, SunSource};
pub use tiles::places_in_til;

use entry::ImageEntry;
use files::Folders;
use heliosplat_raster::RasterFile;
use heliosplat_rpc::Rpc;
use heliosplat_rpc::read::calibration::CalibratedBand;
use std::path::{Path, PathBuf};
use tiles::ImageFiles;

/// Kind of a band, from the file or its metadata.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BandKind {
    /// Panchromatic.
    Pan,
    /// Red.
    Red,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// Near infrared.
    NearInfrared,
    /// Any other or an unknown band.
    Other,
}

impl BandKind {
    /// Name of the kind in reports and band descriptions.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pan => "pan",
            Self::Red => "red",
            Self::Green => "green",
            Self::Blue => "blue",
            Self::NearInfrared => "near_infrared",
            Self::Other => "other",
        }
    }

    /// Kind of a band that metadata name.
    pub fn of_metadata(band: CalibratedBand) -> Self {
        match band {
            CalibratedBand::Pan => Self::Pan,
            CalibratedBand::Blue => Self::Blue,
            CalibratedBand::Green => Self::Green,
            CalibratedBand::Red => Self::Red,
            CalibratedBand::NearInfrared => Self::NearInfrared,
            CalibratedBand::Place(_) => Self::Other,
        }
    }
}

/// Use of an image: trained on or held out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Used in training.
    Train,
    /// Held out.
    Test,
}

/// Preferred source of an image's camera; if the image has none of this kind, the next one counts.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RpcPreference {
    /// A Sat-NeRF JSON, then the file beside the image, then its tag.
    #[default]
    Json,
    /// The file beside the image, then its tag; the tag of a crop comes before the file of the whole image.
    Image,
    /// The file beside the image: RPB, _RPC.TXT, XML, .aux.xml.
    Sidecar,
    /// The tag in the image.
    Tag,
}

/// Truth of a scene.
#[derive(Debug, Clone, Default, serde::Serialize)]
pub struct Truth {
    /// Raster of altitudes, metres.
    pub dsm: Option<PathBuf>,
    /// Raster of classes, LAS codes.
    pub classes: Option<PathBuf>,
    /// Shadow mask of each image (1 = in cast shadow), by image name.
    pub shadows: Vec<(String, PathBuf)>,
    /// Folder of images from above under other suns, for [`relit_truth()`].
    pub relit: Option<PathBuf>,
}

/// Paths of the images in the text of a `scene.toml`, as written there.
///
/// # Errors
/// One sentence with the fault and its line.
pub fn images_listed(manifest: &str) -> Result<Vec<PathBuf>, String> {
    let manifest = manifest::Manifest::parse(manifest)?;
    Ok(manifest.images.into_iter().map(|image| image.path).collect())
}

/// Name of the image in the text of a Sat-NeRF JSON, and the lowest and highest altitude there, metres; `None` where
/// the text is no such JSON.
pub fn image_described(json: &str) -> Option<(String, [Option<f64>; 2])> {
    satnerf::image_and_altitudes(json)
}

/// The rational camera of a single file: of an image, selected as in a scene, or of an RPC text file. Warnings are
/// logged.
///
/// # Errors
/// [`SceneError::NoRpc`] for an image without a camera, and other errors that name the file.
pub fn camera_of(path: &Path, preference: RpcPreference) -> Result<Rpc> {
    manifest::reject_address(path)?;
    if !path.is_file() {
        return Err(SceneError::Missing(path.to_owned()));
    }
    let folders = Folders::default();
    if names::has_extension(path, &["rpb", "txt", "xml", "json", "rpc"]) {
        return camera::from_text_file(path, &folders).map(|found| found.rpc);
    }
    let file = RasterFile::open(path)?;
    let entry = ImageEntry {
        json: satnerf::json_of(path, &folders),
        ..ImageEntry::of(ImageFiles::one(path.to_owned()))
    };
    let mut warnings = Vec::new();
    let found = camera::find(&file, &entry, preference, &folders, &mut warnings)?;
    warnings.extend(checks::of_cameras(&found, &entry.path, file.size()));
    for warning in warnings {
        tracing::warn!("{warning}");
    }
    Ok(found.used.rpc)
}
