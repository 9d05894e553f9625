//! Ingest: a folder of satellite images becomes a [`Scene`].
//!
//! A scene is recognised, not declared: a `scene.toml`, a folder of images, or the folders of Sat-NeRF and EOGS. Every
//! image needs a rational camera; its sun may be unknown. What is missing or contradictory is an error of one line that
//! names the file, what is merely odd is a warning in [`Scene::warnings`].

mod acquisition;
mod altitude;
mod area;
mod bands;
mod calibration;
mod camera;
pub mod cameras;
pub mod crop;
mod dimap;
mod draft;
mod drafts;
mod entry;
mod error;
mod files;
mod footprint;
mod ground;
pub mod indices;
mod known_tiles;
mod layout;
mod manifest;
mod pair_names;
mod pairs;
mod parallax;
mod pixels;
mod relit_truth;
mod satnerf;
pub mod saturation;
mod sidecars;
mod sun;
pub mod survey;
mod tiles;
mod truth;
mod values;
mod weak_times;

pub use altitude::{AltitudeRange, AltitudeSource};
pub use area::AreaRequest;
pub use error::SceneError;
pub use known_tiles::KnownTiles;
pub use parallax::ImagePair;
pub use relit_truth::{RelitTruth, relit_truth};
pub use sun::{ImageSun, SunSource};
pub use values::{BandReflectance, ValueKind, Values};

use draft::Draft;
use entry::ImageEntry;
use ground::Ground;
use heliosplat::Raster;
use heliosplat_raster::{RasterFile, Window};
use heliosplat_rpc::read::calibration::CalibratedBand;
use heliosplat_rpc::{GeoPoint, LocalFrame, PinholeFit, Rpc, sun::SunPosition};
use indices::{NormalisedDifference, VegetationIndex};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tiles::ImageFiles;

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

impl BandKind {
    /// Its name in reports and band descriptions.
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

    /// What a band shows that metadata call so.
    fn of_metadata(band: CalibratedBand) -> Self {
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

/// Whether an image is trained on or held out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Used in training.
    Train,
    /// Held out.
    Test,
}

/// Which camera is used where an image's own RPC and a Sat-NeRF JSON differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RpcPreference {
    /// The JSON: somebody made it on purpose, by bundle adjustment or for a crop.
    #[default]
    Json,
    /// What GDAL finds in the image or beside it.
    Image,
}

/// What a user may say about a scene that its files do not.
#[derive(Debug, Clone, Default)]
pub struct IngestOptions {
    /// Lowest and highest ellipsoidal altitude of the surface, metres.
    pub altitude_range_m: Option<(f64, f64)>,
    /// The same as tie points between the images gave it; used where neither this nor a file of the scene states a range.
    pub altitude_from_ties_m: Option<(f64, f64)>,
    /// Which camera is used where two differ.
    pub rpc: RpcPreference,
    /// The piece of ground to model, if not all.
    pub area: Option<AreaRequest>,
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
    pub pixels: Arc<Raster>,
    /// What each band of `pixels` is.
    pub bands: Vec<BandKind>,
    /// What of the file was read: all of it, or what shows the area that was asked for.
    pub window: Window,
    /// Its rational camera, in the file's pixel coordinates.
    pub rpc: Rpc,
    /// Where the camera was found: `image` (tag, or a sidecar GDAL knows) or a file name.
    pub rpc_source: String,
    /// The pinhole camera fitted in the scene's frame over the window and the altitude range; it counts pixels of the window.
    pub pinhole: PinholeFit,
    /// Acquisition time, if known.
    pub time: Option<jiff::Timestamp>,
    /// Where the sun stood: from the time where known, else from metadata, else unknown.
    pub sun: ImageSun,
    /// The sun as metadata state it, where they do.
    pub metadata_sun: Option<SunPosition>,
    /// Ground sampling distance at the image's centre, metres.
    pub gsd_m: f64,
    /// Data type of the file, as GDAL names it.
    pub data_type: String,
    /// What its values are, and who says so.
    pub values: Values,
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
    /// Folder of images from above under other suns, for [`relit_truth()`].
    pub relit: Option<PathBuf>,
}

/// Images with cameras and what is known of their suns, in one local frame.
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
    /// Where the altitude range comes from.
    pub altitude_known_from: AltitudeSource,
    /// The same in words.
    pub altitude_source: String,
    /// Ground covered by at least two training images (bounding rectangle at mid altitude).
    pub area: Area,
    /// Nominal ground sampling distance, metres: the median of the training images, rounded so that cells of products are 0.5 m wide
    /// and not 0.51, and lie on the grids of other data.
    pub gsd_m: f64,
    /// Counts per unit of `pixels`.
    pub counts_per_unit: f64,
    /// Truth, where the scene brings it.
    pub truth: Truth,
    /// Things a user should know (sun mismatch, unknown bands, images skipped), one line each.
    pub warnings: Vec<String>,
}

impl Scene {
    /// Opens a folder of images, a `scene.toml`, or a folder of Sat-NeRF or EOGS.
    ///
    /// # Errors
    /// The first [`SceneError`] found; nothing is written anywhere.
    pub fn open(path: &Path, options: &IngestOptions) -> Result<Self, SceneError> {
        Self::read(path, options, None)
    }

    /// Opens what of a scene's training images shows a part of its ground, a rectangle in metres of the frame that the whole scene has
    /// ([`survey::Survey::frame`]): the tiles of a scene lie in one frame. Images that show nothing of the part are left out.
    ///
    /// # Errors
    /// As [`Self::open`]; [`SceneError::NotCovered`] where fewer than two images show the part.
    pub fn open_part(path: &Path, options: &IngestOptions, part: &Area) -> Result<Self, SceneError> {
        Self::read(path, options, Some(part))
    }

    fn read(path: &Path, options: &IngestOptions, part: Option<&Area>) -> Result<Self, SceneError> {
        let mut layout = layout::find(path)?;
        let mut warnings = std::mem::take(&mut layout.warnings);
        let drafts = drafts::read_all(&layout, options, &mut warnings)?;
        warnings.extend(pixels::eight_bits(&drafts, layout.counts));
        drafts::check_bands(&drafts)?;
        let ranges: Vec<altitude::Stated> = drafts.iter().map(Draft::stated_altitude).collect();
        let range = altitude::choose(
            altitude::Said::of(options, layout.altitude_range_m),
            &ranges,
            &mut warnings,
        )?;
        let mut ground = Ground::find(path, drafts, range.limits_m(), options.area.as_ref(), &mut warnings)?;
        if let Some(part) = part {
            ground.cut(part, path, range.limits_m())?;
        }
        truth::keep_if_here(&mut layout.truth, ground.frame(), ground.area(), &mut warnings);
        ground.finish(path, layout, range, warnings)
    }

    /// Geodetic position of the frame's origin.
    pub fn origin(&self) -> GeoPoint {
        self.frame.origin
    }

    /// The images to train on.
    pub fn training(&self) -> impl Iterator<Item = &SceneImage> {
        self.images.iter().filter(|image| image.split == Split::Train)
    }

    /// The bands of every image.
    pub fn bands(&self) -> &[BandKind] {
        self.images.first().map_or(&[], |image| &image.bands)
    }

    /// How many training images see a point of the scene's frame (metres) inside their frame and on known pixels,
    /// whatever stands in between.
    pub fn views_covering(&self, east_m: f64, north_m: f64, up_m: f64) -> usize {
        let point = Vector3::new(east_m, north_m, up_m);
        self.training().filter(|image| image.sees(point)).count()
    }
}

impl SceneImage {
    /// Its rational camera in the pixel coordinates of `pixels`.
    pub fn window_rpc(&self) -> Rpc {
        self.rpc.cropped(self.window.col0 as f64, self.window.row0 as f64)
    }

    /// Its normalised difference vegetation index; `None` without red and near infrared, and of values for display.
    pub fn ndvi(&self) -> Option<NormalisedDifference> {
        self.values.ndvi(&self.bands)
    }

    /// What tells leaves in it; `None` without near infrared or all three colours, and of values for display.
    pub fn vegetation_index(&self) -> Option<VegetationIndex> {
        self.values.vegetation_index(&self.bands)
    }

    /// Whether a point of the scene's frame projects onto a known pixel.
    pub fn sees(&self, enu_m: Vector3<f64>) -> bool {
        let [col, row] = self.pinhole.map.project(enu_m).map(f64::round);
        let inside = col >= 0.0 && row >= 0.0 && col < self.pixels.width as f64 && row < self.pixels.height as f64;
        inside && self.pixels.at(0, col as usize, row as usize).is_finite()
    }
}

/// The images that the text of a `scene.toml` lists, as it names them.
///
/// # Errors
/// A sentence that says what is wrong, and in which line.
pub fn images_listed(manifest: &str) -> Result<Vec<PathBuf>, String> {
    let manifest = manifest::Manifest::parse(manifest)?;
    Ok(manifest.images.into_iter().map(|image| image.path).collect())
}

/// The image that the text of a Sat-NeRF JSON describes, and the altitudes it states, metres; `None` where it is none.
pub fn image_described(json: &str) -> Option<(String, [Option<f64>; 2])> {
    satnerf::image_and_altitudes(json)
}

/// The rational camera of one file by itself: of an image, as a scene would find it, or of an RPC text file.
///
/// # Errors
/// [`SceneError::NoRpc`] and others that name the file.
pub fn camera_of(path: &Path, preference: RpcPreference) -> Result<Rpc, SceneError> {
    manifest::reject_address(path)?;
    if !path.is_file() {
        return Err(SceneError::Missing(path.to_owned()));
    }
    if files::has_extension(path, &["rpb", "txt", "xml", "json", "rpc"]) {
        return camera::from_text_file(path).map(|found| found.rpc);
    }
    let file = RasterFile::open(path)?;
    let entry = ImageEntry {
        name: files::stem(path),
        path: path.to_owned(),
        split: Split::Train,
        json: satnerf::beside(path),
        said: None,
        tiles: ImageFiles::one(path.to_owned()),
        multispectral: None,
    };
    let mut warnings = Vec::new();
    let found = camera::find(&file, &entry, preference, &mut warnings)?;
    for warning in warnings {
        tracing::warn!("{warning}");
    }
    Ok(found.rpc)
}
