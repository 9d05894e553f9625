//! The index of a delivery: its files, cameras, times, suns, bands, values and truth, as one value. No pixels are read.

use super::altitude::{self, AltitudeRange, Stated, StatedAltitudes};
use super::bands::BandPlan;
use super::calibration::FoundRadiometry;
use super::checks::{self, Finding, Severity};
use super::draft::Draft;
use super::files::{self, Folders};
use super::manifest::Counts;
use super::names;
use super::{
    Hashes, ImageSun, Result, RpcPreference, SceneError, Split, Truth, acquisition, drafts, layout, sidecars,
    weak_times,
};
use heliosplat_raster::{Crs, RasterError, RasterFile, is_virtual};
use heliosplat_rpc::read::acquisition::Acquisition;
use heliosplat_rpc::{GeoPoint, Rpc};
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Content of a delivery, found before any image is cut or read.
#[derive(Serialize)]
pub struct Index {
    /// The folder or `scene.toml` that was opened.
    pub source: PathBuf,
    /// Preferred kind of camera, for images with several.
    pub rpc: RpcPreference,
    /// The images, in the order of the folder or the manifest.
    pub images: Vec<IndexImage>,
    /// Lowest and highest altitude in `scene.toml`, metres above the ellipsoid.
    pub altitude_range_m: Option<(f64, f64)>,
    /// Truth, where the delivery contains it.
    pub truth: Truth,
    /// All files that describe the delivery: images, sidecars, lists and truth.
    pub files: Vec<PathBuf>,
    /// Failed checks of the delivery.
    pub findings: Vec<Finding>,
    /// Contradictions and assumptions, one line each; includes the messages of the findings.
    pub warnings: Vec<String>,
}

/// One image of a delivery.
#[derive(Serialize)]
pub struct IndexImage {
    /// File stem, distinct among the images.
    pub name: String,
    /// The image file, or the first of its tiles.
    pub path: PathBuf,
    /// Further files with pixels of the image: other tiles or bands, or the multispectral half.
    pub others: Vec<PathBuf>,
    /// Train or test.
    pub split: Split,
    /// Columns and rows.
    pub size: (usize, usize),
    /// Bands that are read, with their kinds.
    pub bands: BandPlan,
    /// Data type of the first band, as GDAL names it.
    pub data_type: String,
    /// Rational camera, in the file's pixel coordinates.
    pub rpc: Rpc,
    /// Source of the camera: `image` (tag, or a sidecar that GDAL knows) or a file name.
    pub rpc_source: String,
    /// Acquisition time, and sun angles from the metadata.
    pub acquisition: Acquisition,
    /// True if the time is from a TIFF date tag, whose time zone is unknown.
    pub time_of_tag: bool,
    /// Calibration of the bands, where the metadata contain it.
    pub radiometry: Option<FoundRadiometry>,
    /// Linear counts or display values.
    pub counts: Counts,
    /// Source of `counts`: `scene.toml` or `image`; `None` where linear counts are assumed.
    pub counts_source: Option<String>,
    /// Altitudes in the image's files, metres above the ellipsoid.
    pub altitude: Stated,
    /// Planet's mask of unusable pixels (`udm2` or `udm`), if there is one.
    pub usable_mask: Option<PathBuf>,
    #[serde(skip)]
    file: Mutex<RasterFile>,
}

impl Index {
    /// Opens a folder of images, a `scene.toml`, or a folder of Sat-NeRF or EOGS. Each folder is listed once; each
    /// image and each text beside it is opened once.
    ///
    /// # Errors
    /// The first [`SceneError`] found.
    pub fn open(path: &Path, rpc: RpcPreference) -> Result<Self> {
        let folders = Folders::default();
        let mut layout = layout::find(path, &folders)?;
        let mut warnings = std::mem::take(&mut layout.warnings);
        let mut drafts = drafts::read_all(&layout, rpc, &folders, &mut warnings)?;
        if let Some(at) = drafts.first().and_then(Draft::middle) {
            weak_times::fill(&mut drafts, at, &mut warnings);
            // Every product needs the projection; a missing PROJ database would otherwise fail only after training.
            if let Err(error @ RasterError::ProjDatabase(_)) = Crs::utm(at) {
                return Err(error.into());
            }
        }
        let findings = checks::all(&drafts, rpc);
        if let Some(error) = findings.iter().find(|found| found.severity == Severity::Error) {
            return Err(SceneError::Refused(error.message.clone()));
        }
        warnings.extend(findings.iter().map(|found| found.message.clone()));
        let files = files_of(path, &layout, &drafts, &folders);
        let image = |draft| IndexImage::new(draft, layout.counts, &folders);
        let images: Vec<IndexImage> = drafts.into_iter().map(image).collect();
        warnings.extend(eight_bits(&images));
        Ok(Self {
            source: path.to_owned(),
            rpc,
            images,
            altitude_range_m: layout.altitude_range_m,
            truth: layout.truth,
            files,
            findings,
            warnings,
        })
    }

    /// Range of altitudes to search, metres above the ellipsoid. The first of these sources that exists is used:
    /// `wanted`, `scene.toml`, the images' JSON files, `from_ties`, and, with a warning, the common validity range of
    /// the cameras.
    ///
    /// # Errors
    /// [`SceneError::AltitudeRange`] where the range is empty or outside of the Earth's altitudes.
    pub fn altitudes(
        &self,
        wanted: Option<(f64, f64)>,
        from_ties: Option<(f64, f64)>,
        warnings: &mut Vec<String>,
    ) -> Result<AltitudeRange> {
        let stated: Vec<Stated> = self.images.iter().map(|image| image.altitude).collect();
        let said = StatedAltitudes {
            option_m: wanted,
            manifest_m: self.altitude_range_m,
            ties_m: from_ties,
        };
        altitude::choose(said, &stated, warnings)
    }

    /// Identity of the delivery's content, one line per file ([`Hashes::of`]).
    ///
    /// # Errors
    /// `SceneError::Unreadable` when a file cannot be read.
    pub fn identity(&self, hashes: &mut Hashes) -> Result<String> {
        let images = self.images.iter();
        let images = images.flat_map(|image| std::iter::once(&image.path).chain(&image.others));
        let truth = [&self.truth.dsm, &self.truth.classes].into_iter().flatten();
        let truth = truth.chain(self.truth.shadows.iter().map(|(_, path)| path));
        hashes.of(&self.files, &images.chain(truth).map(PathBuf::as_path).collect())
    }

    /// The images of the training split.
    pub fn training(&self) -> impl Iterator<Item = &IndexImage> {
        self.images.iter().filter(|image| image.split == Split::Train)
    }
}

impl IndexImage {
    fn new(mut draft: Draft, declared: Option<Counts>, folders: &Folders) -> Self {
        draft.file.set_opacity(draft.plan.alpha);
        let stated = draft.file.domain("").remove("RADIOMETRY");
        let (counts, counts_source) = match (declared, &stated) {
            (Some(declared), _) => (declared, Some("scene.toml")),
            (None, Some(stated)) if stated.to_lowercase().contains("srgb") => (Counts::Display, Some("image")),
            (None, Some(_)) => (Counts::Linear, Some("image")),
            (None, None) => (Counts::Linear, None),
        };
        let first_band = draft.plan.file_bands.first();
        let first_band = first_band.and_then(|&band| draft.file.bands.get(band));
        let (middle_m, half_m) = (draft.rpc.height_offset_m, draft.rpc.height_scale_m.abs());
        let altitude = Stated {
            json_m: (draft.entry.json.as_deref()).and_then(|json| super::satnerf::altitude_range(json, folders)),
            rpc_m: (middle_m - half_m, middle_m + half_m),
        };
        Self {
            name: draft.entry.name,
            usable_mask: files::usable_mask(&draft.entry.path, folders),
            path: draft.entry.path,
            others: draft.file.others().to_vec(),
            split: draft.entry.split,
            size: draft.file.size(),
            data_type: first_band.map_or_else(String::new, |band| band.data_type.clone()),
            bands: draft.plan,
            rpc: draft.rpc,
            rpc_source: draft.cameras.used.source,
            acquisition: draft.acquisition,
            time_of_tag: draft.time_of_tag,
            radiometry: draft.radiometry,
            counts,
            counts_source: counts_source.map(str::to_owned),
            altitude,
            file: Mutex::new(draft.file),
        }
    }

    /// The open image file, locked for one reader at a time.
    pub fn file(&self) -> MutexGuard<'_, RasterFile> {
        self.file.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// True if the image has eight bits and no metadata on the meaning of its values.
    pub fn has_unstated_bytes(&self) -> bool {
        self.data_type == "Byte" && self.radiometry.is_none() && self.counts_source.is_none()
    }

    /// The sun at a place: computed from the acquisition time, else from the angles in the metadata, else unknown. A
    /// sun below the horizon counts as unknown; contradictions are added to `warnings`. The standard deviation is
    /// unknown where the time is from a TIFF date tag.
    pub fn sun(&self, at: GeoPoint, warnings: &mut Vec<String>) -> ImageSun {
        let sun = acquisition::sun(&self.path, &self.acquisition, at, warnings);
        let sigma_deg = sun.sigma_deg.filter(|_| !self.time_of_tag);
        ImageSun { sigma_deg, ..sun }
    }
}

/// Warning about the assumed meaning of eight-bit values without metadata.
fn eight_bits(images: &[IndexImage]) -> Option<String> {
    let unstated = |image: &&IndexImage| image.has_unstated_bytes();
    let count = images.iter().filter(unstated).count();
    let first = images.iter().find(unstated)?;
    Some(format!(
        "{}: 8-bit values ({count} images) are taken as linear, and their greatest as clipped where many pixels have it; say \
         counts = \"display\" in a scene.toml where a display curve was applied",
        first.path.display()
    ))
}

/// The images, the files that describe them, and the files beside them whose names contain an image's name.
fn files_of(path: &Path, layout: &layout::Layout, drafts: &[Draft], folders: &Folders) -> Vec<PathBuf> {
    let mut files: BTreeSet<PathBuf> = folders.texts_read().into_iter().collect();
    for name in ["scene.toml", "train.txt", "test.txt"] {
        files.insert(path.join(name));
    }
    files.insert(path.to_owned());
    for draft in drafts {
        let image = &draft.entry.path;
        files.insert(image.clone());
        if let Some(json) = &draft.entry.json {
            files.insert(json.clone());
            // The lists of a split lie beside the cameras where images have a separate folder.
            files.extend(["train.txt", "test.txt"].map(|name| json.with_file_name(name)));
        }
        if let Some(said) = &draft.entry.said {
            files.extend([&said.rpc, &said.metadata].into_iter().flatten().cloned());
        }
        files.extend(sidecars::belonging_texts(image, folders).unwrap_or_default());
        for image in std::iter::once(image).chain(draft.file.others()) {
            files.insert(image.clone());
            files.extend(sibling_files(image, folders));
            files.extend(super::files::usable_mask(image, folders));
        }
    }
    let truth = &layout.truth;
    files.extend([&truth.dsm, &truth.classes].into_iter().flatten().cloned());
    files.extend(truth.dsm.iter().map(|dsm| dsm.with_extension("txt")));
    files.extend(truth.shadows.iter().map(|(_, path)| path.clone()));
    files.into_iter().filter(|file| !file.is_dir()).collect()
}

/// Files in an image's folder whose names contain the image's name.
fn sibling_files(image: &Path, folders: &Folders) -> Vec<PathBuf> {
    if is_virtual(image) {
        return Vec::new();
    }
    let stem = names::stem(image);
    let mut beside = folders.files(names::folder_of(image)).unwrap_or_default();
    beside.retain(|path| names::file_name(path).contains(&stem));
    beside
}
