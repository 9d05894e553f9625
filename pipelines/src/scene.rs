//! Ingest: a folder of satellite images becomes a [`Scene`].

use heliosplat::Raster;
use heliosplat_rpc::{GeoPoint, LocalFrame, PinholeFit, Rpc, sun::SunPosition};
use std::path::PathBuf;

/// What a band shows, as far as the file tells.
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
    /// Unknown.
    Other,
}

/// Whether an image is trained on or held out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Used in training.
    Train,
    /// Held out.
    Test,
}

/// One image of a scene, with everything that was found out about it.
#[derive(Debug, Clone)]
pub struct SceneImage {
    /// File stem: the name in every report and product.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    /// Train or test.
    pub split: Split,
    /// Pixels: counts divided by a robust per-scene maximum so that most lie in 0..1, linear; NaN where nodata.
    pub pixels: Raster,
    /// What each band of `pixels` is.
    pub bands: Vec<BandKind>,
    /// Its rational camera, in this file's pixel coordinates.
    pub rpc: Rpc,
    /// The pinhole camera fitted in the scene's frame over the whole image and the altitude range.
    pub pinhole: PinholeFit,
    /// Acquisition time, if known.
    pub time: Option<jiff::Timestamp>,
    /// Where the sun stood: from the time where known, else from metadata.
    pub sun: SunPosition,
    /// Whether `sun` was computed (`time`) or read (`metadata`).
    pub sun_source: &'static str,
}

/// Ground rectangle in the scene's ENU frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Area {
    /// Western edge.
    pub west_m: f64,
    /// Southern edge.
    pub south_m: f64,
    /// Eastern edge.
    pub east_m: f64,
    /// Northern edge.
    pub north_m: f64,
}

/// Truth that came with a scene.
#[derive(Debug, Clone, Default)]
pub struct Truth {
    /// Altitude raster.
    pub dsm: Option<PathBuf>,
    /// Classes, LAS codes.
    pub classes: Option<PathBuf>,
    /// Shadow mask of each image (1 = in cast shadow), by image name.
    pub shadows: Vec<(String, PathBuf)>,
}

/// Images with cameras and suns, in one local frame.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Folder or `scene.toml` it came from.
    pub source: PathBuf,
    /// Its images: those of the training split first.
    pub images: Vec<SceneImage>,
    /// ENU frame: the centre of the common footprint at the middle of the altitude range.
    pub frame: LocalFrame,
    /// Lowest and highest ellipsoidal altitude the surface may have, metres.
    pub altitude_range_m: (f64, f64),
    /// Ground covered by at least two training images (bounding rectangle at mid altitude).
    pub area: Area,
    /// Median ground sampling distance of the training images, metres.
    pub gsd_m: f64,
    /// Counts per unit of `pixels`.
    pub counts_per_unit: f64,
    /// Truth, where the scene brings it.
    pub truth: Truth,
    /// Things a user should know (sun mismatch, unknown bands, images skipped), one line each.
    pub warnings: Vec<String>,
}

impl Scene {
    /// Geodetic position of the frame's origin.
    pub fn origin(&self) -> GeoPoint {
        self.frame.origin
    }
}
