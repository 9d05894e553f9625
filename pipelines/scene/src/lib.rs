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
use heliosplat_delivery::Result;
pub use heliosplat_delivery::{
    AltitudeRange, AltitudeSource, BandKind, FileIdentity, Finding, Hashes, ImageSun, Index, RelitTruth, RpcPreference,
    SceneError, Seen, Severity, Split, SunSource, Truth, camera_of, image_described, images_listed, places_in_til,
    relit_truth, seen, toml_fault,
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

/// User settings of a scene, besides its files.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct IngestOptions {
    /// Lowest and highest altitude of the surface, metres above the ellipsoid.
    pub altitude_range_m: Option<(f64, f64)>,
    /// Lowest and highest altitude from tie points between the images, metres above the ellipsoid; used where neither
    /// `altitude_range_m` nor a file of the scene states a range.
    pub altitude_from_ties_m: Option<(f64, f64)>,
    /// Preferred kind of camera, for images with several.
    pub rpc: RpcPreference,
    /// Area to model; `None` for all of the common ground.
    pub area: Option<AreaRequest>,
}

/// One image of a scene: pixels, cameras, sun and metadata.
#[derive(Debug, Clone)]
pub struct SceneImage {
    /// File stem, distinct among the images: the name in every report and product.
    pub name: String,
    /// The image file, or the first of its tiles.
    pub path: PathBuf,
    /// Train or test.
    pub split: Split,
    /// Linear pixel values, counts over `Scene::counts_per_unit`, so that most lie in 0..1; NaN where there are no
    /// data.
    pub pixels: Arc<Raster>,
    /// Kind of each band of `pixels`.
    pub bands: Vec<BandKind>,
    /// The window of the file that was read: all of it, or the part that shows the requested area.
    pub window: Window,
    /// Rational camera, in pixels of the file.
    pub rpc: Rpc,
    /// Source of the camera: `image` (tag, or a sidecar that GDAL reads) or a file name.
    pub rpc_source: String,
    /// Pinhole camera fitted in the scene's frame over the window and the altitude range, in pixels of the window.
    pub pinhole: PinholeFit,
    /// Acquisition time, if known.
    pub time: Option<jiff::Timestamp>,
    /// Sun: computed from the time, else from the metadata, else unknown.
    pub sun: ImageSun,
    /// Sun in the metadata; `None` where they contain none.
    pub metadata_sun: Option<SunPosition>,
    /// Ground sampling distance at the image's centre, metres.
    pub gsd_m: f64,
    /// Data type of the file, as GDAL names it.
    pub data_type: String,
    /// Meaning of the values, and its source.
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
    /// Folder or `scene.toml` of the scene.
    pub source: PathBuf,
    /// Images, those of the training split first.
    pub images: Vec<SceneImage>,
    /// ENU frame. Its origin is the centre of the requested area, else of the ground that all training images show, at
    /// the middle of the altitude range.
    pub frame: LocalFrame,
    /// Lowest and highest altitude of the surface, metres above the ellipsoid.
    pub altitude_range_m: (f64, f64),
    /// Source of the altitude range.
    pub altitude_known_from: AltitudeSource,
    /// Source of the altitude range, in words.
    pub altitude_source: String,
    /// Bounding rectangle of the ground that at least two training images show at mid altitude, within the requested
    /// area.
    pub area: Area,
    /// Nominal ground sampling distance, metres: the median of the training images, rounded so that cells of products
    /// coincide with the grids of other data (0.5 m wide, not 0.51 m).
    pub gsd_m: f64,
    /// Counts per unit of `pixels`.
    pub counts_per_unit: f64,
    /// Truth, where the scene contains it.
    pub truth: Truth,
    /// The cut whose pixels were read, without the identities of its files.
    pub cut: KeptCut,
    /// Failed checks of the delivery and the scene; their messages are among the warnings.
    pub findings: Vec<Finding>,
    /// Warnings (sun mismatch, unknown bands, images skipped), one line each.
    pub warnings: Vec<String>,
}

impl Scene {
    /// Opens a folder of images, a `scene.toml`, or a folder of Sat-NeRF or EOGS, cuts it by `options`, and reads its
    /// pixels.
    ///
    /// # Errors
    /// The first [`SceneError`] found; nothing is written anywhere.
    pub fn open(path: &Path, options: &IngestOptions) -> Result<Self> {
        Self::of(&Index::open(path, options.rpc)?, options)
    }

    /// Cuts an index by `options` and reads its pixels.
    ///
    /// # Errors
    /// Those of [`Self::open`].
    pub fn of(index: &Index, options: &IngestOptions) -> Result<Self> {
        let mut warnings = Vec::new();
        let cut = Cut::of(index, options, &mut warnings)?;
        Self::read(index, &cut, warnings)
    }

    /// Geodetic position of the frame's origin.
    pub fn origin(&self) -> GeoPoint {
        self.frame.origin
    }

    /// Images of the training split.
    pub fn training(&self) -> impl Iterator<Item = &SceneImage> {
        self.images.iter().filter(|image| image.split == Split::Train)
    }

    /// Kinds of the bands of every image.
    pub fn bands(&self) -> &[BandKind] {
        self.images.first().map_or(&[], |image| &image.bands)
    }

    /// Number of training images that show a point of the scene's frame (metres) on a known pixel; occlusion is
    /// ignored.
    pub fn views_covering(&self, east_m: f64, north_m: f64, up_m: f64) -> usize {
        let point = Vector3::new(east_m, north_m, up_m);
        self.training().filter(|image| image.sees(point)).count()
    }
}

impl SceneImage {
    /// Rational camera in pixels of the window.
    pub fn window_rpc(&self) -> Rpc {
        self.rpc.cropped(self.window.col0 as f64, self.window.row0 as f64)
    }

    /// Normalised difference vegetation index; `None` without red and near infrared, and for display values.
    pub fn ndvi(&self) -> Option<NormalisedDifference> {
        self.values.ndvi(&self.bands)
    }

    /// Index of leaves; `None` without near infrared or all three colours, and for display values.
    pub fn vegetation_index(&self) -> Option<VegetationIndex> {
        self.values.vegetation_index(&self.bands)
    }

    /// True if a point of the scene's frame (metres) projects onto a known pixel.
    pub fn sees(&self, enu_m: Vector3<f64>) -> bool {
        let [col, row] = self.pinhole.map.project(enu_m).map(f64::round);
        let inside = col >= 0.0 && row >= 0.0 && col < self.pixels.width as f64 && row < self.pixels.height as f64;
        inside && self.pixels.at(0, col as usize, row as usize).is_finite()
    }
}
