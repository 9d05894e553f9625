//! Ingest: a folder of satellite images becomes a [`Scene`].
//!
//! A scene is recognised, not declared: a `scene.toml`, a folder of images, or the folders of Sat-NeRF and EOGS. Every
//! image needs a rational camera and either an acquisition time or sun angles; what is missing or contradictory is an
//! error of one line that names the file, what is merely odd is a warning in [`Scene::warnings`].

mod acquisition;
mod altitude;
mod bands;
mod camera;
mod error;
mod footprint;
mod layout;
mod manifest;
mod pixels;
mod satnerf;
mod truth;

pub use error::SceneError;

use crate::raster::RasterFile;
use bands::BandPlan;
use footprint::Footprint;
use heliosplat::Raster;
use heliosplat_rpc::read::acquisition::Acquisition;
use heliosplat_rpc::{GeoPoint, ImagePoint, ImageWindow, LocalFrame, PinholeFit, Rpc, sun::SunPosition};
use layout::{ImageEntry, Layout};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
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
    /// Which camera is used where two differ.
    pub rpc: RpcPreference,
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
    /// Where the camera was found: `image` (tag, or a sidecar GDAL knows) or a file name.
    pub rpc_source: String,
    /// The pinhole camera fitted in the scene's frame over the whole image and the altitude range.
    pub pinhole: PinholeFit,
    /// Acquisition time, if known.
    pub time: Option<jiff::Timestamp>,
    /// Where the sun stood: from the time where known, else from metadata.
    pub sun: SunPosition,
    /// Whether `sun` was computed (`time`) or read (`metadata`).
    pub sun_source: &'static str,
    /// The sun as metadata state it, where they do.
    pub metadata_sun: Option<SunPosition>,
    /// Ground sampling distance at the image's centre, metres.
    pub gsd_m: f64,
    /// Data type of the file, as GDAL names it.
    pub data_type: String,
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
    /// Where the altitude range comes from, in words.
    pub altitude_source: String,
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
    /// Opens a folder of images, a `scene.toml`, or a folder of Sat-NeRF or EOGS.
    ///
    /// # Errors
    /// The first [`SceneError`] found; nothing is written anywhere.
    pub fn open(path: &Path, options: &IngestOptions) -> Result<Self, SceneError> {
        let mut layout = layout::find(path)?;
        let mut warnings = std::mem::take(&mut layout.warnings);
        let drafts = read_drafts(&layout, options, &mut warnings)?;
        check_bands(&drafts)?;
        let ranges: Vec<altitude::Stated> = drafts.iter().map(Draft::stated_altitude).collect();
        let (altitude_range_m, altitude_source) = altitude::choose(
            options.altitude_range_m,
            layout.altitude_range_m,
            &ranges,
            &mut warnings,
        )?;
        let ground = Ground::find(path, drafts, altitude_range_m, &mut warnings)?;
        ground.finish(path, layout, (altitude_range_m, altitude_source), warnings)
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
    /// Whether a point of the scene's frame projects onto a known pixel.
    pub fn sees(&self, enu_m: Vector3<f64>) -> bool {
        let [col, row] = self.pinhole.map.project(enu_m).map(f64::round);
        let inside = col >= 0.0 && row >= 0.0 && col < self.pixels.width as f64 && row < self.pixels.height as f64;
        inside && self.pixels.at(0, col as usize, row as usize).is_finite()
    }
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
    if layout::has_extension(path, &["rpb", "txt", "xml", "json", "rpc"]) {
        return camera::from_text_file(path).map(|found| found.rpc);
    }
    let file = RasterFile::open(path)?;
    let entry = ImageEntry {
        name: layout::stem(path),
        path: path.to_owned(),
        split: Split::Train,
        json: satnerf::beside(path),
        said: None,
    };
    let mut warnings = Vec::new();
    let found = camera::find(&file, &entry, preference, &mut warnings)?;
    for warning in warnings {
        tracing::warn!("{warning}");
    }
    Ok(found.rpc)
}

/// An image whose file is open and whose metadata are read.
struct Draft {
    entry: ImageEntry,
    file: RasterFile,
    plan: BandPlan,
    rpc: Rpc,
    rpc_source: String,
    acquisition: Acquisition,
}

impl Draft {
    fn window(&self) -> ImageWindow {
        let (width, height) = self.file.size();
        ImageWindow {
            col0: 0.0,
            row0: 0.0,
            width,
            height,
        }
    }

    fn stated_altitude(&self) -> altitude::Stated {
        altitude::Stated {
            json_m: self.entry.json.as_deref().and_then(satnerf::altitude_range),
            rpc_m: (
                self.rpc.height_offset_m - self.rpc.height_scale_m.abs(),
                self.rpc.height_offset_m + self.rpc.height_scale_m.abs(),
            ),
        }
    }

    fn localise(&self, col: f64, row: f64, height_m: f64) -> Result<GeoPoint, SceneError> {
        self.rpc
            .localise(ImagePoint { col, row }, height_m)
            .map_err(|source| self.camera_fault(height_m, source))
    }

    fn camera_fault(&self, height_m: f64, source: heliosplat_rpc::RpcError) -> SceneError {
        SceneError::Camera {
            path: self.file.path().to_owned(),
            height_m,
            source,
        }
    }

    /// Outer corners of the image on the ground, in a local frame.
    fn footprint(&self, frame: &LocalFrame, height_m: f64) -> Result<Footprint, SceneError> {
        let (width, height) = self.file.size();
        let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
        let corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)];
        let on_ground = |&(col, row): &(f64, f64)| {
            let enu = frame.enu_from_geo(self.localise(col, row, height_m)?);
            Ok([enu.x, enu.y])
        };
        Ok(Footprint::new(
            corners.iter().map(on_ground).collect::<Result<_, SceneError>>()?,
        ))
    }

    /// Square root of the ground area of the central pixel, metres.
    fn gsd_m(&self, frame: &LocalFrame, height_m: f64) -> Result<f64, SceneError> {
        let (width, height) = self.file.size();
        let (col, row) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
        let ground = |col, row| -> Result<Vector3<f64>, SceneError> {
            Ok(frame.enu_from_geo(self.localise(col, row, height_m)?))
        };
        let centre = ground(col, row)?;
        let (along, down) = (ground(col + 1.0, row)? - centre, ground(col, row + 1.0)? - centre);
        Ok((along.x * down.y - along.y * down.x).abs().sqrt())
    }
}

fn read_drafts(layout: &Layout, options: &IngestOptions, warnings: &mut Vec<String>) -> Result<Vec<Draft>, SceneError> {
    let mut drafts = Vec::with_capacity(layout.images.len());
    for entry in &layout.images {
        let file = RasterFile::open(&entry.path)?;
        let found = camera::find(&file, entry, options.rpc, warnings)?;
        let plan = bands::plan(&file, layout.bands.as_deref())?;
        let acquisition = acquisition::find(&file, entry)?;
        drafts.push(Draft {
            entry: entry.clone(),
            file,
            plan,
            rpc: found.rpc,
            rpc_source: found.source,
            acquisition,
        });
    }
    // The same assumption about every image is one warning.
    if let Some(assumption) = drafts.iter().find_map(|draft| draft.plan.assumption.as_ref()) {
        warnings.push(format!(
            "{}: {assumption}; say otherwise with bands = [...] in a scene.toml",
            layout.images[0].path.display()
        ));
    }
    Ok(drafts)
}

fn check_bands(drafts: &[Draft]) -> Result<(), SceneError> {
    let Some(first) = drafts.first() else {
        return Ok(());
    };
    match drafts.iter().find(|draft| draft.plan.kinds != first.plan.kinds) {
        None => Ok(()),
        Some(differing) => Err(SceneError::MixedBands {
            path: differing.file.path().to_owned(),
            found: bands::in_words(&differing.plan.kinds),
            other: first.file.path().to_owned(),
            expected: bands::in_words(&first.plan.kinds),
        }),
    }
}

/// Images that overlap, and the ground they share.
struct Ground {
    drafts: Vec<Draft>,
    frame: LocalFrame,
    area: Area,
}

/// An overlap smaller than this many pixels on a side is none.
const LEAST_OVERLAP_PX: f64 = 16.0;

impl Ground {
    fn find(
        source: &Path,
        drafts: Vec<Draft>,
        altitude_range_m: (f64, f64),
        warnings: &mut Vec<String>,
    ) -> Result<Self, SceneError> {
        let count = drafts.iter().filter(|draft| draft.entry.split == Split::Train).count();
        if count < 2 {
            return Err(SceneError::TooFewViews {
                path: source.to_owned(),
                count,
            });
        }
        let altitude_m = (altitude_range_m.0 + altitude_range_m.1) / 2.0;
        // Any frame near the scene will do to find out where its centre is.
        let (width, height) = drafts[0].file.size();
        let near = drafts[0].localise(width as f64 / 2.0, height as f64 / 2.0, altitude_m)?;
        let near = LocalFrame::new(near);
        let drafts = drop_strangers(drafts, &near, altitude_m, warnings)?;
        let footprints = training_footprints(&drafts, &near, altitude_m)?;
        let centre = footprint::common(&footprints).centre();
        let centre = match (centre, footprint::covered_twice(&footprints, 0.0)) {
            (Some(centre), _) => centre,
            (None, Some(area)) => [(area.west_m + area.east_m) / 2.0, (area.south_m + area.north_m) / 2.0],
            (None, None) => [0.0; 2],
        };
        let mut origin = near.geo_from_enu(Vector3::new(centre[0], centre[1], 0.0));
        origin.height_m = altitude_m;
        let frame = LocalFrame::new(origin);
        let footprints = training_footprints(&drafts, &frame, altitude_m)?;
        let least_m2 = LEAST_OVERLAP_PX.powi(2) * drafts[0].gsd_m(&frame, altitude_m)?.powi(2);
        let area = footprint::covered_twice(&footprints, least_m2).ok_or_else(|| SceneError::NoOverlap {
            first: drafts[0].file.path().to_owned(),
            second: drafts[drafts.len() - 1].file.path().to_owned(),
            altitude_m,
        })?;
        Ok(Self { drafts, frame, area })
    }

    fn finish(
        self,
        source: &Path,
        layout: Layout,
        (altitude_range_m, altitude_source): ((f64, f64), String),
        mut warnings: Vec<String>,
    ) -> Result<Scene, SceneError> {
        let Self { drafts, frame, area } = self;
        let mut suns = Vec::with_capacity(drafts.len());
        for draft in &drafts {
            suns.push(acquisition::sun(
                &draft.file,
                &draft.acquisition,
                frame.origin,
                &mut warnings,
            )?);
        }
        let mut rasters = Vec::with_capacity(drafts.len());
        for draft in &drafts {
            rasters.push(pixels::read(&draft.file, &draft.plan, layout.counts, &mut warnings)?);
        }
        let counts_per_unit = pixels::scale_together(&mut rasters);
        let fits = fit_pinholes(&drafts, &frame, altitude_range_m, &mut warnings)?;
        let mut images = Vec::with_capacity(drafts.len());
        for (((draft, sun), pixels), pinhole) in drafts.into_iter().zip(suns).zip(rasters).zip(fits) {
            let gsd_m = draft.gsd_m(&frame, frame.origin.height_m)?;
            images.push(SceneImage {
                name: draft.entry.name,
                path: draft.entry.path,
                split: draft.entry.split,
                pixels,
                data_type: draft.file.bands[draft.plan.file_bands[0]].data_type.clone(),
                bands: draft.plan.kinds,
                rpc: draft.rpc,
                rpc_source: draft.rpc_source,
                pinhole,
                time: draft.acquisition.time,
                sun: sun.sun,
                sun_source: sun.source,
                metadata_sun: sun.metadata,
                gsd_m,
            });
        }
        images.sort_by_key(|image| image.split == Split::Test);
        let mut gsds: Vec<f64> = images
            .iter()
            .filter(|image| image.split == Split::Train)
            .map(|image| image.gsd_m)
            .collect();
        gsds.sort_by(f64::total_cmp);
        Ok(Scene {
            source: source.to_owned(),
            gsd_m: gsds[gsds.len() / 2],
            images,
            frame,
            altitude_range_m,
            altitude_source,
            area,
            counts_per_unit,
            truth: layout.truth,
            warnings,
        })
    }
}

fn training_footprints(drafts: &[Draft], frame: &LocalFrame, altitude_m: f64) -> Result<Vec<Footprint>, SceneError> {
    let training = drafts.iter().filter(|draft| draft.entry.split == Split::Train);
    training.map(|draft| draft.footprint(frame, altitude_m)).collect()
}

/// Leaves out images that see no ground a training image sees; at least two training images must remain.
fn drop_strangers(
    drafts: Vec<Draft>,
    frame: &LocalFrame,
    altitude_m: f64,
    warnings: &mut Vec<String>,
) -> Result<Vec<Draft>, SceneError> {
    let mut footprints = Vec::with_capacity(drafts.len());
    for draft in &drafts {
        footprints.push(draft.footprint(frame, altitude_m)?);
    }
    let least_m2 = LEAST_OVERLAP_PX.powi(2) * drafts[0].gsd_m(frame, altitude_m)?.powi(2);
    let is_training = |index: usize| drafts[index].entry.split == Split::Train;
    let has_company: Vec<bool> = (0..drafts.len())
        .map(|index| {
            (0..drafts.len()).any(|other| {
                let shared = || footprints[index].intersection(&footprints[other]).area_m2();
                other != index && is_training(other) && shared() >= least_m2
            })
        })
        .collect();
    let remaining = (0..drafts.len())
        .filter(|&index| is_training(index) && has_company[index])
        .count();
    if remaining < 2 {
        let mut training = (0..drafts.len()).filter(|&index| is_training(index));
        let first = training.next().unwrap_or(0);
        let second = training.next().unwrap_or(first);
        return Err(SceneError::NoOverlap {
            first: drafts[first].file.path().to_owned(),
            second: drafts[second].file.path().to_owned(),
            altitude_m,
        });
    }
    let mut kept = Vec::with_capacity(drafts.len());
    for (draft, has_company) in drafts.into_iter().zip(has_company) {
        if has_company {
            kept.push(draft);
        } else {
            warnings.push(format!(
                "{}: overlaps no other training image, left out",
                draft.file.path().display()
            ));
        }
    }
    Ok(kept)
}

fn fit_pinholes(
    drafts: &[Draft],
    frame: &LocalFrame,
    altitude_range_m: (f64, f64),
    warnings: &mut Vec<String>,
) -> Result<Vec<PinholeFit>, SceneError> {
    /// A larger residual shows as blur in the model.
    const WORTH_A_WARNING_PX: f64 = 0.25;
    // Open GDAL files cannot be shared between threads: take out what the fit needs.
    let cameras: Vec<(&Rpc, ImageWindow)> = drafts.iter().map(|draft| (&draft.rpc, draft.window())).collect();
    let fits: Vec<_> = cameras
        .par_iter()
        .map(|(rpc, window)| PinholeFit::fit(rpc, frame, *window, altitude_range_m))
        .collect();
    let mut good = Vec::with_capacity(fits.len());
    for (draft, fit) in drafts.iter().zip(fits) {
        let fit = fit.map_err(|source| draft.camera_fault(frame.origin.height_m, source))?;
        if fit.max_px > WORTH_A_WARNING_PX {
            warnings.push(format!(
                "{}: a pinhole camera stands for its RPC only to {:.2} px (rms {:.2}); give smaller crops or a narrower altitude \
                 range",
                draft.file.path().display(),
                fit.max_px,
                fit.rms_px
            ));
        }
        good.push(fit);
    }
    Ok(good)
}
