//! Units of a batch, in an order in which they can run.

mod cameras;
mod joint;

use super::manifest::{AreaEntry, ImagesEntry, Manifest, PresetEntry, ProductOptions, TileOptions};
use super::tiles::{self, Tiling};
use super::{BatchError, Result};
use heliosplat_fitting::checkpoint::digest;
use heliosplat_fitting::program::{build, executable, identity_of_program, recall_build};
use heliosplat_raster::Geoid;
use heliosplat_raster::bounded::read_bytes;
use heliosplat_raster::write::write_atomically;
use heliosplat_satellite::altitude;
use heliosplat_satellite::config::Align;
use heliosplat_scene::survey::Survey;
use heliosplat_scene::{AreaRequest, Hashes, Index, IngestOptions, RpcPreference, Seen, seen};
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Memory of any unit, bytes.
const LEAST_BYTES: f64 = 200.0 * 1_048_576.0;
/// Seconds of any unit: starting, reading, writing.
const LEAST_S: f64 = 5.0;
/// Approximate seconds per Gaussian and step of a training on one core; the speed of the machine is not measured.
const STEP_S_PER_GAUSSIAN: f64 = 1.8e-6;
/// Folder of a tile's training, below the folder of the tile.
pub const RUN: &str = "run";
/// Seconds per pixel of the windows of a sweep on one core.
const SWEEP_S_PER_PIXEL: f64 = 1e-5;
/// Time of the other stages of a training (start, albedo, evaluation) for each image, in steps.
const STEPS_PER_VIEW: f64 = 10.0;
/// Name of the file that keeps a plan, and its largest size, bytes: space for a million units.
const FILE: &str = "plan.json";
const FILE_MAX: u64 = 2 << 30;
/// Folder with the inputs of a plan and one file per unit, so that the process of a unit need not read the whole plan.
/// Names of areas cannot begin with a dot, so it is never the folder of an area.
const PARTS: &str = ".plan";
/// Name of the file in [`PARTS`] with the inputs of the plan.
const MADE: &str = "made.json";
/// Most files and folders of a refused scene that are watched for changes.
const LISTED_MAX: usize = 10_000;

/// Plan of a batch: its units, in an order in which they can run.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Plan {
    /// Units of the batch, each after the units that it waits for.
    pub units: Vec<Unit>,
}

/// Unit of work of a batch.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Unit {
    /// Name, and folder below the folder of the batch: `AREA/IMAGES/PRESET/PART`; without preset for units that all
    /// presets share.
    pub id: String,
    /// Task of the unit.
    pub work: Work,
    /// Names of the units that must be finished before.
    pub after: Vec<String>,
    /// Estimated peak memory, MiB.
    pub mem_mb: u64,
    /// Estimated time on one core, seconds: a rough figure, for workflow engines that need one.
    pub runtime_s: u64,
    /// Digest of program, inputs and settings; a stamp with another key is not of this work.
    pub key: String,
    /// Folder on an object store to which the products and the stamp are copied.
    pub deliver: Option<String>,
}

/// Task of a unit.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Work {
    /// Searches tie points in patches of the area.
    Ties(TiesWork),
    /// Corrects the pointing of the images over the whole area.
    Adjust(AdjustWork),
    /// Trains a tile and writes its surface model.
    Tile(TileWork),
    /// Finds the gains of the colours of all tiles.
    Colours(ColoursWork),
    /// Merges the surface models and products of the tiles in one piece.
    Mosaic(MosaicWork),
    /// Merges those of the tiles of a block.
    Block(MosaicWork),
    /// Joins the blocks of a mosaic.
    Joined(JoinedWork),
    /// Unusable scene; the unit fails when it runs.
    Refused {
        /// Reason of the refusal, for the user.
        reason: String,
    },
}

/// Work of a search for tie points.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TiesWork {
    /// Path of the scene.
    pub scene: PathBuf,
    /// Settings of the scene, without an area.
    pub ingest: IngestOptions,
    /// Rectangles of ground in which tie points are sought.
    pub patches: Vec<AreaRequest>,
    /// Preset of the image matching.
    pub preset: PresetEntry,
}

/// Work of an adjustment.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AdjustWork {
    /// Path of the scene.
    pub scene: PathBuf,
    /// Preferred cameras of the scene.
    pub rpc: RpcPreference,
    /// Names of the units that found the ties, in the order of their patches.
    pub ties: Vec<String>,
    /// Preset with the settings of the cameras.
    pub preset: PresetEntry,
}

/// Work of a tile.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TileWork {
    /// Path of the scene.
    pub scene: PathBuf,
    /// Settings of the scene: ground of the tile with its overlap, and altitudes of the whole area.
    pub ingest: IngestOptions,
    /// Name of the unit that corrected the pointing of the images; `None` if the tile corrects it.
    pub cameras: Option<String>,
    /// Preset of the training.
    pub preset: PresetEntry,
    /// Coordinate reference system of the surface model.
    pub crs: String,
    /// Width of a cell of the surface model, metres.
    pub gsd_m: f64,
    /// Products to write for the tile.
    pub products: ProductOptions,
}

/// Work of the colours of an area.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ColoursWork {
    /// Tiles of the area.
    pub tiles: Vec<MosaicTile>,
    /// Width of a cell, metres.
    pub gsd_m: f64,
    /// Products of the tiles and blocks.
    pub products: ProductOptions,
}

/// Work that joins the blocks of a mosaic.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct JoinedWork {
    /// Units of the blocks, with their bounds: west, south, east, north, in units of `crs`.
    pub blocks: Vec<(String, [f64; 4])>,
    /// Tiles of the area.
    pub tiles: Vec<MosaicTile>,
    /// Coordinate reference system.
    pub crs: String,
    /// Width of a cell, metres.
    pub gsd_m: f64,
    /// West, south, east, north of the mosaic, in units of `crs`.
    pub bounds: [f64; 4],
    /// Geoid that the heights of the blocks refer to; `None`: the ellipsoid.
    pub geoid: Option<Geoid>,
}

/// Work of a mosaic or of a block of it.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MosaicWork {
    /// Tiles to merge.
    pub tiles: Vec<MosaicTile>,
    /// Unit that found the gains of the colours of all tiles; `None` if the mosaic finds them.
    pub colours: Option<String>,
    /// Coordinate reference system.
    pub crs: String,
    /// Width of a cell, metres.
    pub gsd_m: f64,
    /// West, south, east, north of the mosaic, in units of `crs`.
    pub bounds: [f64; 4],
    /// West, south, east, north of the mosaic with the ground around it, whose shadows fall into it.
    pub around: [f64; 4],
    /// True surface model of the scene, if it has one.
    pub truth: Option<PathBuf>,
    /// Raster of ground classes of the scene, if it has one.
    pub classes: Option<PathBuf>,
    /// Products to write for the mosaic.
    pub products: ProductOptions,
}

/// Unit and bounds of a tile of a mosaic.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MosaicTile {
    /// Name of the tile's unit.
    pub unit: String,
    /// West, south, east, north of the core, in units of the mosaic's `crs`. Cores do not overlap.
    pub core: [f64; 4],
    /// West, south, east, north of the core with its overlap, in the same units.
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

/// Plan or unit in a file, with the digest of the inputs of the plan.
#[derive(serde::Serialize, serde::Deserialize)]
struct Part<T> {
    made: String,
    content: T,
}

/// Units of a plan by their names. Each is read from its own file, at a cost that is independent of the size of the
/// plan.
pub struct Units<'a> {
    manifest: &'a Path,
    out: &'a Path,
    made: Option<String>,
}

impl<'a> Units<'a> {
    /// Opens the units of the plan kept in `out`, if it was made from this manifest.
    ///
    /// # Errors
    /// When the manifest cannot be read or is invalid.
    pub fn open(manifest: &'a Path, out: &'a Path) -> Result<Self> {
        let text = format!("{:?}", Manifest::read(manifest)?);
        let made = Made::kept(out, &text).map(|made| made.digest());
        Ok(Self { manifest, out, made })
    }

    /// Unit with this name. Without a kept plan, the whole batch is planned.
    ///
    /// # Errors
    /// When the plan has no such unit.
    pub fn unit(&self, id: &str) -> Result<Unit> {
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

/// File of a unit of a plan.
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
    /// Plan of a manifest. A plan kept in `out` is used while program, manifest and files are unchanged; with `retry`,
    /// a kept plan with refused scenes is made again.
    ///
    /// # Errors
    /// When the manifest cannot be read or is invalid.
    pub fn of(manifest_path: &Path, out: &Path, retry: bool) -> Result<Self> {
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
        // Kept files only save time; the units report a folder that cannot be written.
        let _ = hashes.save(out);
        let _ = plan.keep(out, &made);
        Ok(plan)
    }

    /// Writes the plan to `out`, as a whole and unit by unit, then its inputs, which make it valid.
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
    /// True if it merges products of other units, and is quickly made again.
    pub(super) fn is_joint(&self) -> bool {
        use Work::{Block, Colours, Joined, Mosaic};
        matches!(self.work, Colours(_) | Mosaic(_) | Block(_) | Joined(_))
    }

    /// Reason of the refusal if the scene cannot be used.
    pub fn refusal(&self) -> Option<&str> {
        match &self.work {
            Work::Refused { reason } => Some(reason),
            _ => None,
        }
    }
}

/// All units, and the files on which the plan depends. An unusable scene becomes a unit that fails; it stops no other.
fn make(manifest: &Manifest, hashes: &mut Hashes) -> (Plan, Vec<PathBuf>) {
    let (mut units, mut files) = (Vec::new(), Vec::new());
    for area in &manifest.areas {
        let named = area.images.as_ref();
        let wanted = |images: &&ImagesEntry| named.is_none_or(|names| names.contains(&images.name));
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

/// Files and folders of an unusable scene, [`LISTED_MAX`] at most. When one changes, the scene is tried again.
fn around(scene: &Path) -> Vec<PathBuf> {
    let mut found = vec![scene.to_owned()];
    let mut next = 0;
    while next < found.len() && found.len() < LISTED_MAX {
        let entries = std::fs::read_dir(&found[next]).into_iter().flatten().flatten();
        // A link may lead back to its own folder.
        let entries = entries.filter(|entry| entry.file_type().is_ok_and(|kind| !kind.is_symlink()));
        found.extend(entries.map(|entry| entry.path()));
        next += 1;
    }
    found
}

/// Units of an area and a set of images for all presets, and the files of the scene.
fn units_of(
    manifest: &Manifest,
    area: &AreaEntry,
    images: &ImagesEntry,
    hashes: &mut Hashes,
) -> Result<(Vec<Unit>, Vec<PathBuf>)> {
    let options = IngestOptions {
        altitude_range_m: area.altitude_m.map(|[low, high]| (low, high)),
        rpc: images.rpc,
        area: area.request(),
        ..IngestOptions::default()
    };
    // Once for all tiles, so that they have one altitude range.
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
            ingest: &options,
            preset,
            inputs: &inputs,
            config: toml::to_string(&config).unwrap_or_default(),
            products: products_of(preset, &manifest.products),
            tiles: &manifest.tiles,
            deliver: manifest.deliver.as_ref(),
        };
        // Cameras are corrected once for the tiles of all presets.
        let cameras = (config.cameras.align != Align::Off && tiling.tiles.len() > 1).then(|| {
            let id = combination.adjust_id();
            let known = units.iter().find(|unit: &&Unit| unit.id == id).cloned();
            known.unwrap_or_else(|| {
                let (ties, adjust) = combination.cameras(&tiling, &survey, &config);
                units.extend(ties);
                units.push(adjust.clone());
                adjust
            })
        });
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

/// Products of a preset; a sweep has only surface models.
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
    /// Settings of the scene, for the whole area.
    ingest: &'a IngestOptions,
    preset: &'a PresetEntry,
    /// Digest of the files of the scene.
    inputs: &'a str,
    config: String,
    products: ProductOptions,
    tiles: &'a TileOptions,
    deliver: Option<&'a String>,
}

impl Combination<'_> {
    fn units(&self, tiling: &Tiling, survey: &Survey, cameras: Option<&Unit>) -> Vec<Unit> {
        let home = format!("{}/{}/{}", self.area.name, self.images.name, self.preset.name);
        let tiles = tiling.tiles.iter();
        let mut units: Vec<Unit> = tiles.map(|tile| self.tile(&home, tiling, tile, cameras)).collect();
        units.extend(self.joint(&home, tiling, survey, &units));
        units
    }

    fn tile(&self, home: &str, tiling: &Tiling, tile: &tiles::Tile, cameras: Option<&Unit>) -> Unit {
        let work = TileWork {
            scene: self.images.scene.clone(),
            ingest: IngestOptions {
                area: Some(tile.area.clone()),
                ..self.ingest.clone()
            },
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
        let identity = format!("tile {:?} {} {} {:?}", work.ingest, work.crs, work.gsd_m, work.products);
        let cost = (tile.estimate.peak_bytes, tile_s(tile));
        let after: Vec<&Unit> = cameras.into_iter().collect();
        self.unit(
            format!("{home}/{}", tile.name()),
            &after,
            cost,
            &identity,
            Work::Tile(work),
        )
    }

    /// A unit that waits for others, takes these bytes and seconds beyond the start of a process, and has the key of
    /// the program, of the units before it, of `identity`, and of settings and files of the scene.
    fn unit(&self, id: String, after: &[&Unit], (bytes, seconds): (f64, f64), identity: &str, work: Work) -> Unit {
        let keys: Vec<&str> = after.iter().map(|unit| unit.key.as_str()).collect();
        let (program, keys) = (identity_of_program(), keys.join("\n"));
        let (deliver, config, inputs) = (self.deliver, &self.config, self.inputs);
        Unit {
            id,
            after: after.iter().map(|unit| unit.id.clone()).collect(),
            mem_mb: mebibytes(bytes.max(LEAST_BYTES)),
            runtime_s: (LEAST_S + seconds).ceil() as u64,
            key: digest(&format!("{program}{keys}\n{identity}\n{deliver:?}\n{config}\n{inputs}")),
            deliver: deliver.cloned(),
            work,
        }
    }
}

/// Approximate seconds of a tile's sweep or training on one core.
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
