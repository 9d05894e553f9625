//! Index → [`Cut`] → pixels: the images of a delivery become a [`Scene`].
//!
//! [`Index::open`] finds and parses a delivery once; [`Cut::of`] chooses frame, ground, altitudes and windows without
//! reading pixels; [`Scene::read`] reads the pixels of a cut. A run keeps its [`KeptCut`], from which the same pixels
//! are read again.

mod area;
pub mod cameras;
pub mod crop;
mod cut;
mod footprint;
pub mod indices;
mod kept;
mod known_tiles;
mod parallax;
mod pixels;
mod read;
pub mod saturation;
pub mod survey;
mod truth;
mod values;

pub use area::AreaRequest;
pub use cut::{Cut, CutImage};
pub use heliosplat_delivery::{
    AltitudeRange, AltitudeSource, BandKind, FileIdentity, Finding, Hashes, ImageSun, Index, RelitTruth, RpcPreference,
    SceneError, Seen, Severity, Split, SunSource, Truth, camera_of, image_described, images_listed, places_in_til,
    relit_truth, seen,
};
pub use kept::{KeptCut, KeptImage};
pub use known_tiles::KnownTiles;
pub use parallax::ImagePair;
pub use values::{BandReflectance, ValueKind, Values};

use heliosplat::Raster;
use heliosplat_raster::Window;
use heliosplat_rpc::{GeoPoint, LocalFrame, PinholeFit, Rpc, sun::SunPosition};
use indices::{NormalisedDifference, VegetationIndex};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// User settings of a scene that its files do not contain.
#[derive(Debug, Clone, Default)]
pub struct IngestOptions {
    /// Lowest and highest ellipsoidal altitude of the surface, metres.
    pub altitude_range_m: Option<(f64, f64)>,
    /// Altitudes estimated from tie points between the images; used where neither this nor a file of the scene states a
    /// range.
    pub altitude_from_ties_m: Option<(f64, f64)>,
    /// Preference between two different cameras.
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
    /// Kind of each band of `pixels`.
    pub bands: Vec<BandKind>,
    /// The window of the file that was read: all of it, or the part that shows the requested area.
    pub window: Window,
    /// Its rational camera, in the file's pixel coordinates.
    pub rpc: Rpc,
    /// Source of the camera: `image` (tag, or a sidecar that GDAL reads) or a file name.
    pub rpc_source: String,
    /// The pinhole camera fitted in the scene's frame over the window and the altitude range; it counts pixels of the
    /// window.
    pub pinhole: PinholeFit,
    /// Acquisition time, if known.
    pub time: Option<jiff::Timestamp>,
    /// Direction of the sun: from the time where known, else from metadata, else unknown.
    pub sun: ImageSun,
    /// The sun as metadata state it, where they do.
    pub metadata_sun: Option<SunPosition>,
    /// Ground sampling distance at the image's centre, metres.
    pub gsd_m: f64,
    /// Data type of the file, as GDAL names it.
    pub data_type: String,
    /// Meaning of its values, and the source of that.
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
    /// Source of the altitude range.
    pub altitude_known_from: AltitudeSource,
    /// Source of the altitude range, in words.
    pub altitude_source: String,
    /// Ground covered by at least two training images (bounding rectangle at mid altitude).
    pub area: Area,
    /// Nominal ground sampling distance, metres: the median of the training images, rounded so that cells of products
    /// are 0.5 m wide and not 0.51, and coincide with the grids of other data.
    pub gsd_m: f64,
    /// Counts per unit of `pixels`.
    pub counts_per_unit: f64,
    /// Truth, where the scene brings it.
    pub truth: Truth,
    /// The cut that was read, without the identities of its files.
    pub cut: KeptCut,
    /// Rows of the table of checks that hold; their messages are among the warnings.
    pub findings: Vec<Finding>,
    /// Warnings (sun mismatch, unknown bands, images skipped), one line each.
    pub warnings: Vec<String>,
}

impl Scene {
    /// Opens a folder of images, a `scene.toml`, or a folder of Sat-NeRF or EOGS, cuts it by `options` and reads its
    /// pixels.
    ///
    /// # Errors
    /// The first [`SceneError`] found; nothing is written anywhere.
    pub fn open(path: &Path, options: &IngestOptions) -> Result<Self, SceneError> {
        Self::of(&Index::open(path, options.rpc)?, options)
    }

    /// Cuts an index by `options` and reads its pixels.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn of(index: &Index, options: &IngestOptions) -> Result<Self, SceneError> {
        let mut warnings = Vec::new();
        let cut = Cut::of(index, options, &mut warnings)?;
        Self::read(index, &cut, warnings)
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

    /// Number of training images that show a point of the scene's frame (metres) inside their frame and on known
    /// pixels, without regard to occlusion.
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

    /// Its index of leaves; `None` without near infrared or all three colours, and of values for display.
    pub fn vegetation_index(&self) -> Option<VegetationIndex> {
        self.values.vegetation_index(&self.bands)
    }

    /// True if a point of the scene's frame projects onto a known pixel.
    pub fn sees(&self, enu_m: Vector3<f64>) -> bool {
        let [col, row] = self.pinhole.map.project(enu_m).map(f64::round);
        let inside = col >= 0.0 && row >= 0.0 && col < self.pixels.width as f64 && row < self.pixels.height as f64;
        inside && self.pixels.at(0, col as usize, row as usize).is_finite()
    }
}
