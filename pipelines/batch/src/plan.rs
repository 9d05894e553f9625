//! The units of a batch, in an order in which they can be done.

use super::BatchError;
use super::manifest::{AreaEntry, ImagesEntry, Manifest, PresetEntry, ProductOptions};
use super::tiles::{self, Tiling};
use heliosplat_fitting::checkpoint::digest;
use heliosplat_fitting::program::{build, executable, identity_of_program, recall_build};
use heliosplat_raster::bounded::read_bytes;
use heliosplat_raster::write::write_atomically;
use heliosplat_satellite::altitude;
use heliosplat_satellite::config::{Align, SatelliteConfig};
use heliosplat_satellite::estimate::sweep_estimate;
use heliosplat_scene::survey::Survey;
use heliosplat_scene::{AreaRequest, Hashes, Index, IngestOptions, RpcPreference, Seen, seen};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Bytes per cell of a mosaic while its surface model is made: three bands of tiles and of the mosaic, weights, the file in memory.
const MOSAIC_BYTES_PER_CELL: f64 = 120.0;
/// Memory of a mosaic for each cell and band of its albedo, bytes.
const MOSAIC_BYTES_PER_CELL_AND_BAND: f64 = 24.0;
/// Memory of any unit, bytes.
const LEAST_BYTES: f64 = 200.0 * 1_048_576.0;
/// Seconds of any unit: starting, reading, writing.
const LEAST_S: f64 = 5.0;
/// Seconds per Gaussian and step of a training on one core, roughly: how fast the machine is does not count.
const STEP_S_PER_GAUSSIAN: f64 = 1.8e-6;
/// Name of the unit that corrects the pointing of the images.
const ADJUST: &str = "adjust";
/// Seconds per pixel of the windows of an adjustment on one core.
const ADJUST_S_PER_PIXEL: f64 = 2e-5;
/// Seconds per pixel of the windows of a sweep on one core.
const SWEEP_S_PER_PIXEL: f64 = 1e-5;
/// Steps that take as long as the rest of a training does for each of its images: start, albedo, evaluation.
const STEPS_PER_VIEW: f64 = 10.0;
/// Seconds per cell of a mosaic, and of each raster besides its surface model.
const MOSAIC_S_PER_CELL: f64 = 2e-6;
/// Name of the file that keeps a plan, and its largest size, bytes: a million units.
const FILE: &str = "plan.json";
const FILE_MAX: u64 = 2 << 30;
/// Folder of what the process of one unit reads of a plan: what it was made of, and a file for each unit. No area has such a name.
const PARTS: &str = ".plan";
/// Name there of what it was made of.
const MADE: &str = "made.json";
/// Most files and folders of a refused scene that are watched for changes.
const LISTED_MAX: usize = 10_000;

/// The plan of a batch: its units, in an order in which they can be run.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Plan {
    /// The units, each after those that it waits for.
    pub units: Vec<Unit>,
}

/// One thing to be done.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Unit {
    /// Its name, and its folder below the batch's: area, images, preset, part.
    pub id: String,
    /// Task of the unit.
    pub work: Work,
    /// The units that must be finished before.
    pub after: Vec<String>,
    /// Memory it will take, MiB.
    pub mem_mb: u64,
    /// Time it will take, seconds: a rough figure for one core, for workflow engines that ask for one.
    pub runtime_s: u64,
    /// Names its inputs and its settings: another key is other work.
    pub key: String,
    /// Folder on an object store that its products are copied to.
    pub deliver: Option<String>,
}

/// Task of a unit.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Work {
    /// Corrects the pointing of the images over the whole area.
    Adjust(AdjustWork),
    /// Trains a tile and writes its surface model.
    Tile(TileWork),
    /// Makes one surface model of those of the tiles.
    Mosaic(MosaicWork),
    /// A scene that cannot be used.
    Refused {
        /// Why.
        reason: String,
    },
}

/// The work of an adjustment.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AdjustWork {
    /// The scene.
    pub scene: PathBuf,
    /// Ground on which ties are sought.
    pub patches: Vec<AreaRequest>,
    /// Lowest and highest ellipsoidal altitude, metres.
    pub altitude_m: Option<[f64; 2]>,
    /// Altitude range from tie points, if none is stated.
    pub altitude_from_ties_m: Option<(f64, f64)>,
    /// Preferred camera model of the images.
    pub rpc: RpcPreference,
    /// Preset of the image matching.
    pub preset: PresetEntry,
}

/// The work of a tile.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TileWork {
    /// The scene.
    pub scene: PathBuf,
    /// Its ground.
    pub area: AreaRequest,
    /// Lowest and highest ellipsoidal altitude, metres.
    pub altitude_m: Option<[f64; 2]>,
    /// Altitude range from tie points of the whole area, if none is stated.
    #[serde(default)]
    pub altitude_from_ties_m: Option<(f64, f64)>,
    /// Preferred camera model of the images.
    pub rpc: RpcPreference,
    /// The unit that corrected the pointing of its images; `None` where it corrects them itself.
    pub cameras: Option<String>,
    /// Preset of the training.
    pub preset: PresetEntry,
    /// Coordinate reference system of its surface model.
    pub crs: String,
    /// Width of a cell of it, metres.
    pub gsd_m: f64,
    /// Products of the model.
    pub products: ProductOptions,
}

/// The work of a mosaic.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MosaicWork {
    /// The tiles.
    pub tiles: Vec<MosaicTile>,
    /// Coordinate reference system.
    pub crs: String,
    /// Width of a cell, metres.
    pub gsd_m: f64,
    /// West, south, east, north.
    pub bounds: [f64; 4],
    /// True altitudes, where the scene has them.
    pub truth: Option<PathBuf>,
    /// Classes, where the scene has them.
    pub classes: Option<PathBuf>,
    /// Products of the mosaic.
    pub products: ProductOptions,
}

/// A tile as its mosaic knows it.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MosaicTile {
    /// Its unit.
    pub unit: String,
    /// West, south, east, north of what is its alone.
    pub core: [f64; 4],
    /// Bounds of the whole area.
    pub bounds: [f64; 4],
}

/// Inputs of a plan: program build, executable, manifest and files. A plan is kept while they are unchanged.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
struct Made {
    build: String,
    executable: Seen,
    manifest: String,
    files: BTreeMap<PathBuf, Seen>,
}

/// A plan or a unit in a file, with the digest of what the plan was made of.
#[derive(serde::Serialize, serde::Deserialize)]
struct Part<T> {
    made: String,
    content: T,
}

/// The units of a plan by their names, each read from a file of its own: a unit costs the same in a plan of any size.
pub struct Units<'a> {
    manifest: &'a Path,
    out: &'a Path,
    made: Option<String>,
}

impl<'a> Units<'a> {
    /// Units of the plan in `out`, if it is that of the manifest.
    ///
    /// # Errors
    /// When the manifest is at fault.
    pub fn open(manifest: &'a Path, out: &'a Path) -> Result<Self, BatchError> {
        let text = format!("{:?}", Manifest::read(manifest)?);
        let made = Made::kept(out, &text).map(|made| made.digest());
        Ok(Self { manifest, out, made })
    }

    /// A unit by its name; the whole is planned where no plan is kept.
    ///
    /// # Errors
    /// Where the plan has no such unit.
    pub fn unit(&self, id: &str) -> Result<Unit, BatchError> {
        let plain = !Path::new(id).is_absolute() && !id.contains("..");
        let kept = self.made.as_ref().filter(|_| plain);
        if let Some(unit) = kept.and_then(|made| read_part(&part_of(self.out, id), made)) {
            return Ok(unit);
        }
        let plan = Plan::of(self.manifest, self.out, false)?;
        let found = plan.units.into_iter().find(|unit| unit.id == id);
        found.ok_or_else(|| BatchError::no_unit(id))
    }
}

/// The file of a unit of a plan.
fn part_of(out: &Path, id: &str) -> PathBuf {
    out.join(PARTS).join(format!("{id}.json"))
}

fn read_part<T: DeserializeOwned>(path: &Path, made: &str) -> Option<T> {
    let part: Part<T> = serde_json::from_slice(&read_bytes(path, FILE_MAX).ok()?).ok()?;
    (part.made == made).then_some(part.content)
}

impl Made {
    /// Inputs of the plan kept in `out`; `None` if the program, the manifest or one of the files has changed.
    fn kept(out: &Path, manifest: &str) -> Option<Self> {
        let made: Self = serde_json::from_slice(&read_bytes(&out.join(PARTS).join(MADE), FILE_MAX).ok()?).ok()?;
        if made.executable == seen(&executable()) {
            recall_build(made.build.clone());
        }
        let same = made.build == build() && made.manifest == digest(manifest);
        let unchanged = || made.files.iter().all(|(path, before)| seen(path) == *before);
        (same && unchanged()).then_some(made)
    }

    fn digest(&self) -> String {
        digest(&serde_json::to_string(self).unwrap_or_default())
    }
}

impl Plan {
    /// The plan of a manifest; one that was made before for the same files is read from `out`. A kept plan with refused areas is made
    /// again where `retry` is set, or a file of such an area has changed.
    ///
    /// # Errors
    /// When the manifest is at fault.
    pub fn of(manifest_path: &Path, out: &Path, retry: bool) -> Result<Self, BatchError> {
        let manifest = Manifest::read(manifest_path)?;
        let text = format!("{manifest:?}");
        let kept = Made::kept(out, &text).and_then(|made| read_part::<Self>(&out.join(FILE), &made.digest()));
        if let Some(plan) = kept
            && !(retry && plan.units.iter().any(|unit| unit.refusal().is_some()))
        {
            return Ok(plan);
        }
        let mut hashes = Hashes::open(out);
        let (plan, files) = make(&manifest, &mut hashes);
        let made = Made {
            build: build().to_owned(),
            executable: seen(&executable()),
            manifest: digest(&text),
            files: files.into_iter().map(|path| (path.clone(), seen(&path))).collect(),
        };
        // They only save time: a folder that cannot be written is told of by the units.
        let _ = hashes.save(out);
        let _ = plan.keep(out, &made);
        Ok(plan)
    }

    /// Keeps the plan in `out`, as a whole and unit by unit; what it was made of last.
    fn keep(&self, out: &Path, made: &Made) -> std::io::Result<()> {
        let digest = made.digest();
        let folder = out.join(PARTS);
        let _ = std::fs::remove_file(folder.join(MADE));
        for unit in &self.units {
            let path = part_of(out, &unit.id);
            std::fs::create_dir_all(path.parent().unwrap_or(&folder))?;
            std::fs::write(path, part(&digest, unit)?)?;
        }
        let write = |path: &Path, text: &[u8]| write_atomically(path, text).map_err(std::io::Error::other);
        write(&out.join(FILE), &part(&digest, self)?)?;
        write(&folder.join(MADE), &serde_json::to_vec(made)?)
    }
}

fn part<T: serde::Serialize>(made: &str, content: &T) -> serde_json::Result<Vec<u8>> {
    let made = made.to_owned();
    serde_json::to_vec(&Part { made, content })
}

impl Unit {
    /// The reason why its scene cannot be used, if it cannot.
    pub fn refusal(&self) -> Option<&str> {
        match &self.work {
            Work::Refused { reason } => Some(reason),
            _ => None,
        }
    }
}

/// All units, and the files that decided them. A scene that is at fault becomes a unit that fails, and stops no other.
fn make(manifest: &Manifest, hashes: &mut Hashes) -> (Plan, Vec<PathBuf>) {
    let (mut units, mut files) = (Vec::new(), Vec::new());
    for area in &manifest.areas {
        let wanted = |images: &&ImagesEntry| {
            let named = area.images.as_ref();
            named.is_none_or(|names| names.contains(&images.name))
        };
        for images in manifest.images.iter().filter(wanted) {
            match units_of(manifest, area, images, hashes) {
                Ok((more, of)) => {
                    units.extend(more);
                    files.extend(of);
                }
                Err(error) => {
                    units.push(refused(area, images, &error));
                    files.extend(around(&images.scene));
                }
            }
        }
    }
    (Plan { units }, files)
}

/// The files and folders of a scene that cannot be used, [`LISTED_MAX`] at most: when one changes, the scene is tried again.
fn around(scene: &Path) -> Vec<PathBuf> {
    let mut found = vec![scene.to_owned()];
    let mut next = 0;
    while next < found.len() && found.len() < LISTED_MAX {
        let entries = std::fs::read_dir(&found[next]).into_iter().flatten().flatten();
        // A link may lead back to where it is.
        let entries = entries.filter(|entry| entry.file_type().is_ok_and(|kind| !kind.is_symlink()));
        found.extend(entries.map(|entry| entry.path()));
        next += 1;
    }
    found
}

/// The units of an area and a set of images, for all presets.
fn units_of(
    manifest: &Manifest,
    area: &AreaEntry,
    images: &ImagesEntry,
    hashes: &mut Hashes,
) -> Result<(Vec<Unit>, Vec<PathBuf>), BatchError> {
    let options = IngestOptions {
        altitude_range_m: area.altitude_m.map(|[low, high]| (low, high)),
        altitude_from_ties_m: None,
        rpc: images.preference(),
        area: area.request(),
    };
    // Once for all tiles, so that they are parts of one surface.
    let index = Index::open(&images.scene, options.rpc)?;
    let options = altitude::resolve(&index, &options)?;
    let survey = Survey::of(&index, &options)?;
    let inputs = digest(&index.identity(hashes)?);
    let mut units = Vec::new();
    for preset in &manifest.presets {
        let config =
            (preset.config()).map_err(|error| BatchError::Refused(format!("{}: {error}", images.scene.display())))?;
        let tiling = tiles::cut(&tiles::Request {
            name: &area.name,
            images: &images.name,
            survey: &survey,
            options: &manifest.tiles,
            config: &config,
            trains: !preset.is_sweep(),
        })?;
        let combination = Combination {
            area,
            images,
            altitude_from_ties_m: options.altitude_from_ties_m,
            preset,
            inputs: &inputs,
            config: toml::to_string(&config).unwrap_or_default(),
            products: products_of(preset, &manifest.products),
            deliver: manifest.deliver.as_ref(),
        };
        let cameras = match config.cameras.align != Align::Off && tiling.tiles.len() > 1 {
            true => {
                let id = format!("{}/{}/{ADJUST}", area.name, images.name);
                if !units.iter().any(|unit: &Unit| unit.id == id) {
                    units.push(combination.adjust(id.clone(), &tiling, &survey, &config));
                }
                units.iter().find(|unit| unit.id == id).cloned()
            }
            false => None,
        };
        units.extend(combination.units(&tiling, &survey, cameras.as_ref()));
    }
    Ok((units, index.files))
}

fn refused(area: &AreaEntry, images: &ImagesEntry, error: &BatchError) -> Unit {
    let reason = error.to_string();
    Unit {
        id: format!("{}/{}/refused", area.name, images.name),
        after: Vec::new(),
        mem_mb: mebibytes(LEAST_BYTES),
        runtime_s: LEAST_S as u64,
        key: digest(&reason),
        deliver: None,
        work: Work::Refused { reason },
    }
}

/// The products of a preset: a sweep has surface models alone.
fn products_of(preset: &PresetEntry, asked: &ProductOptions) -> ProductOptions {
    match preset.is_sweep() {
        true => ProductOptions {
            dsm_only: true,
            geoid: asked.geoid,
            ..ProductOptions::default()
        },
        false => asked.clone(),
    }
}

struct Combination<'a> {
    area: &'a AreaEntry,
    images: &'a ImagesEntry,
    /// The altitudes of the whole area, where tie points gave them, metres.
    altitude_from_ties_m: Option<(f64, f64)>,
    preset: &'a PresetEntry,
    /// The files that say something about the scene, and their hashes.
    inputs: &'a str,
    config: String,
    products: ProductOptions,
    deliver: Option<&'a String>,
}

impl Combination<'_> {
    /// One correction of the pointing for all tiles, whatever their preset.
    fn adjust(&self, id: String, tiling: &Tiling, survey: &Survey, config: &SatelliteConfig) -> Unit {
        let patches = tiles::patches(tiling, survey.gsd_m);
        let surveyed = patches.iter().filter_map(|patch| survey.tile(patch).ok()?);
        let estimates: Vec<(f64, f64)> = surveyed
            .map(|tile| (sweep_estimate(survey, &tile, config).peak_bytes, tile.pixels))
            .collect();
        let bytes = estimates.iter().map(|(bytes, _)| *bytes).fold(LEAST_BYTES, f64::max);
        let pixels: f64 = estimates.iter().map(|(_, pixels)| pixels).sum();
        let work = AdjustWork {
            scene: self.images.scene.clone(),
            patches,
            altitude_m: self.area.altitude_m,
            altitude_from_ties_m: self.altitude_from_ties_m,
            rpc: self.images.preference(),
            preset: self.preset.clone(),
        };
        let said = format!(
            "{}adjust\n{:?} {:?} {:?} {:?}\n{}\n{}",
            identity_of_program(),
            work.patches,
            work.altitude_m,
            work.altitude_from_ties_m,
            work.rpc,
            self.config,
            self.inputs
        );
        Unit {
            id,
            after: Vec::new(),
            mem_mb: mebibytes(bytes),
            runtime_s: (LEAST_S + ADJUST_S_PER_PIXEL * pixels).ceil() as u64,
            key: digest(&said),
            deliver: None,
            work: Work::Adjust(work),
        }
    }

    fn units(&self, tiling: &Tiling, survey: &Survey, cameras: Option<&Unit>) -> Vec<Unit> {
        let home = format!("{}/{}/{}", self.area.name, self.images.name, self.preset.name);
        let mut units: Vec<Unit> = tiling
            .tiles
            .iter()
            .map(|tile| self.tile(&home, tiling, tile, cameras))
            .collect();
        let tiles: Vec<MosaicTile> = tiling
            .tiles
            .iter()
            .map(|tile| MosaicTile {
                unit: format!("{home}/{}", tile.name()),
                core: tile.core,
                bounds: tile.area.bounds,
            })
            .collect();
        let work = MosaicWork {
            tiles,
            crs: tiling.crs.clone(),
            gsd_m: tiling.gsd_m,
            bounds: tiling.bounds,
            truth: survey.truth.dsm.clone(),
            classes: survey.truth.classes.clone(),
            products: self.products.clone(),
        };
        let [west, south, east, north] = tiling.bounds;
        let cells = (east - west) * (north - south) / (tiling.gsd_m * tiling.gsd_m);
        let images = tiling.tiles.iter().map(|tile| tile.survey.images).max().unwrap_or(0);
        let (bands, rasters) = match self.products.dsm_only {
            true => (0.0, 1.0),
            // Each image may be of a date of its own, which has shadows of its own.
            false => (survey.bands as f64, (4 + survey.bands + images) as f64),
        };
        let bytes_per_cell = MOSAIC_BYTES_PER_CELL + MOSAIC_BYTES_PER_CELL_AND_BAND * bands;
        let keys: Vec<&str> = units.iter().map(|unit| unit.key.as_str()).collect();
        let said = format!(
            "{}mosaic\n{}\n{:?} {:?}",
            identity_of_program(),
            keys.join("\n"),
            work,
            self.deliver
        );
        units.push(Unit {
            id: format!("{home}/mosaic"),
            after: units.iter().map(|unit| unit.id.clone()).collect(),
            mem_mb: mebibytes(LEAST_BYTES + bytes_per_cell * cells),
            runtime_s: (LEAST_S + MOSAIC_S_PER_CELL * rasters * cells).ceil() as u64,
            key: digest(&said),
            deliver: self.deliver.cloned(),
            work: Work::Mosaic(work),
        });
        units
    }

    fn tile(&self, home: &str, tiling: &Tiling, tile: &tiles::Tile, cameras: Option<&Unit>) -> Unit {
        let work = TileWork {
            scene: self.images.scene.clone(),
            area: tile.area.clone(),
            altitude_m: self.area.altitude_m,
            altitude_from_ties_m: self.altitude_from_ties_m,
            rpc: self.images.preference(),
            cameras: cameras.map(|unit| unit.id.clone()),
            preset: self.preset.clone(),
            crs: tiling.crs.clone(),
            gsd_m: tiling.gsd_m,
            // Products of the whole surface are left to the mosaic.
            products: ProductOptions {
                geoid: None,
                sun_hours: None,
                globe: false,
                ..self.products.clone()
            },
        };
        let said = format!(
            "{}tile\n{:?} {} {:?} {:?} {:?} {} {} {:?} {:?}\n{}\n{}",
            identity_of_program(),
            cameras.map(|unit| &unit.key),
            work.area,
            work.altitude_m,
            work.altitude_from_ties_m,
            work.rpc,
            work.crs,
            work.gsd_m,
            work.products,
            self.deliver,
            self.config,
            self.inputs
        );
        Unit {
            id: format!("{home}/{}", tile.name()),
            after: work.cameras.iter().cloned().collect(),
            mem_mb: mebibytes(tile.estimate.peak_bytes.max(LEAST_BYTES)),
            runtime_s: (LEAST_S + tile_s(tile)).ceil() as u64,
            key: digest(&said),
            deliver: self.deliver.cloned(),
            work: Work::Tile(work),
        }
    }
}

/// Seconds of a tile's sweep or training, roughly.
fn tile_s(tile: &tiles::Tile) -> f64 {
    if tile.estimate.steps == 0 {
        return SWEEP_S_PER_PIXEL * tile.survey.pixels;
    }
    let steps = tile.estimate.steps as f64 + STEPS_PER_VIEW * tile.survey.training as f64;
    STEP_S_PER_GAUSSIAN * tile.estimate.gaussians * steps
}

fn mebibytes(bytes: f64) -> u64 {
    (bytes / f64::from(1 << 20)).ceil() as u64
}
