//! One unit of a batch: adjustment, training or mosaic, with products, page and stamp.

use super::colours::{self, Colours};
use super::joined;
use super::mosaic::{mosaic, nothing};
use super::plan::{AdjustWork, ColoursWork, MosaicWork, RUN, TiesWork, TileWork, Unit, Units, Work};
use super::products::{self, sun_of};
use super::stamp::{self, Done, Output, STAMP, Stamp, claim};
use super::store;
use super::{BatchError, Result};
use heliosplat_evaluate::{EvaluateError, Protocol, error_map, evaluate_dsm, evaluate_raster};
use heliosplat_fitting::checkpoint;
use heliosplat_fitting::program::build;
use heliosplat_fitting::request::{Earlier, TrainOutcome, TrainRequest};
use heliosplat_fitting::run_folder::{create_folder, peak_rss_bytes};
use heliosplat_pages::page::MOSAIC_FILE;
use heliosplat_pages::{report, view};
use heliosplat_products::{dsm, model, seams};
use heliosplat_raster::bounded::read_text;
use heliosplat_raster::temporary::TemporaryFolder;
use heliosplat_raster::write_atomically;
use heliosplat_raster::{Window, preview};
use heliosplat_satellite::config::{Align, SatelliteConfig};
use heliosplat_satellite::patch_ties::PatchTies;
use heliosplat_satellite::run_file::CUT;
use heliosplat_satellite::shared_cameras::SharedCameras;
use heliosplat_satellite::training::train;
use heliosplat_satellite::{measure, preprocess};
use heliosplat_scene::{Cut, Index, Scene, SceneError};
use heliosplat_session::Session;
use serde_json::json;
use std::path::Path;
use std::time::{Duration, Instant};

/// Name of the file with the key of the unit that last used a folder.
const BEGUN: &str = "begun.txt";
/// Name of the file with the ties of a unit's patches.
const TIES: &str = "ties.bin";
/// Name of the file with the camera corrections that all tiles share.
const CAMERAS: &str = "cameras.json";
/// Metrics of a training that are metrics of its tile.
const OF_TRAINING: [&str; 8] = [
    "seconds",
    "iterations",
    "gaussians",
    "peak_rss_bytes",
    "dsm",
    "train",
    "test",
    "shadow",
];
/// Name of the report page.
const REPORT: &str = report::FILE;
/// Name of the page with the movable sun.
const SUN: &str = view::FILE;

/// Runs a unit unless it is finished. Returns its stamp, and true if it was finished before.
///
/// # Errors
/// When a unit that it waits for is not finished, its inputs are invalid, a file cannot be written, or the user stops
/// it.
pub fn do_unit(
    units: &Units,
    unit: &Unit,
    out: &Path,
    checkpoint_every: Duration,
    session: &Session,
) -> Result<(Stamp, bool)> {
    for after in &unit.after {
        if store::taken(out, &units.unit(after)?)?.is_none() {
            return Err(BatchError::Refused(format!(
                "{}: {after} must be finished before; run it, or the whole batch",
                unit.id
            )));
        }
    }
    let folder = out.join(&unit.id);
    create_folder(&folder)?;
    let Some(_claim) = claim(&folder, &|| session.stopped())? else {
        return Err(BatchError::Interrupted(format!("{}: stopped before it began", unit.id)));
    };
    if let Some(stamp) = store::taken(out, unit)? {
        return Ok((stamp, true));
    }
    begin(&folder, unit)?;
    let begun = Instant::now();
    let (outputs, metrics) = match &unit.work {
        Work::Ties(work) => ties(work, &folder, session)?,
        Work::Adjust(work) => adjust(work, out, &folder)?,
        Work::Tile(work) => tile(work, unit, (out, &folder), checkpoint_every, session)?,
        Work::Colours(work) => colours(work, out, &folder)?,
        Work::Mosaic(work) | Work::Block(work) => mosaic_unit(work, unit, out, &folder)?,
        Work::Joined(work) => joined::join(work, &unit.id, out, &folder)?,
        Work::Refused { reason } => return Err(BatchError::Refused(reason.clone())),
    };
    let seconds = metrics["seconds"].as_f64();
    let outputs = outputs.iter().map(|output| Output::of(&folder, output));
    let stamp = Stamp {
        unit: unit.id.clone(),
        key: unit.key.clone(),
        build: build().into(),
        outputs: outputs.collect::<Result<_, _>>()?,
        seconds: seconds.unwrap_or_else(|| begun.elapsed().as_secs_f64()),
        peak_rss_bytes: peak_rss_bytes(),
        metrics,
    };
    let text = serde_json::to_string_pretty(&stamp).unwrap_or_default();
    if unit.deliver.is_some() {
        // A unit counts as finished when its products are on the store.
        let temporary = TemporaryFolder::inside(&folder)?;
        let file = temporary.path().join(STAMP);
        write_atomically(&file, text.as_bytes())?;
        store::keep(unit, &folder, &stamp, &file)?;
    }
    write_atomically(&folder.join(STAMP), text.as_bytes())?;
    Ok((stamp, false))
}

/// Removes the stamp of earlier work in the folder, and its checkpoint if its key differs.
fn begin(folder: &Path, unit: &Unit) -> Result<()> {
    let path = folder.join(BEGUN);
    let same = read_text(&path).is_ok_and(|before| before.trim() == unit.key);
    if unit.is_joint() {
        stamp::remove_outputs(folder)?;
    }
    // An outdated stamp, or one with missing products, must not be read again.
    let _ = std::fs::remove_file(folder.join(STAMP));
    if !same {
        checkpoint::remove(&folder.join(RUN));
        write_atomically(&path, unit.key.as_bytes())?;
    }
    Ok(())
}

fn tile(
    work: &TileWork,
    unit: &Unit,
    (out, folder): (&Path, &Path),
    checkpoint_every: Duration,
    session: &Session,
) -> Result<Done> {
    let run = folder.join(RUN);
    let begun = Instant::now();
    let scene = match scene_of(work) {
        Err(SceneError::NotCovered(..)) => {
            let id = &unit.id;
            tracing::warn!("{id}: fewer than two images have pixels here, so that it has no surface");
            return Ok((Vec::new(), json!({"empty": true})));
        }
        scene => scene?,
    };
    for warning in &scene.warnings {
        tracing::warn!("{warning}");
    }
    let (preset, mut config) = (work.preset.parsed()?, work.preset.config()?);
    if let Some(unit) = &work.cameras {
        share_cameras(&mut config, &scene, &out.join(unit).join(CAMERAS))?;
    }
    if work.preset.is_sweep() {
        return swept(&scene, work, &config, folder, session);
    }
    let request = TrainRequest {
        begun,
        earlier: Earlier::Update,
        checkpoint_every,
        ..TrainRequest::new(run.clone(), preset)
    };
    let trained = match train(&scene, &work.ingest, &config, &request, session)? {
        TrainOutcome::FinishedBefore { metrics } => {
            report::complete(&run)?;
            metrics
        }
        TrainOutcome::Trained(trained) => {
            report::write(&run)?;
            trained.ending.check(&run)?;
            trained.metrics
        }
    };
    let mut metrics = json!({"residual_px": residual_px(&scene)});
    drop(scene);
    let model = model::load_whole(&run)?;
    let mut outputs = if work.products.dsm_only {
        dsm::dsm(&model.on_last(), work.gsd_m, Some(&work.crs))?.write(&folder.join("dsm.tif"))?;
        dsm::files("dsm.tif")
    } else {
        products::of_tile(&model, unit, folder, (work.gsd_m, &work.crs), work.products.sun)?
    };
    for key in OF_TRAINING {
        if let Some(value) = trained.get(key) {
            metrics[key] = value.clone();
        }
    }
    let of_run = ["model.ply", "model.json", "run.toml", CUT, "metrics.json", SUN, REPORT];
    // A surface without known heights has no page.
    let there = of_run.iter().filter(|name| run.join(name).is_file());
    outputs.extend(there.map(|name| format!("{RUN}/{name}")));
    Ok((outputs, metrics))
}

/// Sets the corrections of the cameras that all tiles share, read from `path`: those in the middle of the windows of a
/// tile's `scene`.
fn share_cameras(config: &mut SatelliteConfig, scene: &Scene, path: &Path) -> Result<()> {
    let failed = |reason: &dyn std::fmt::Display| BatchError::Failed(format!("{}: {reason}", path.display()));
    let text = read_text(path).map_err(|error| failed(&error))?;
    let cameras: SharedCameras = serde_json::from_str(&text).map_err(|error| failed(&error))?;
    // With alignment on and no shifts, the tile would correct its pointing itself.
    config.cameras.align = Align::Off;
    let middle = |window: &Window| window.row0 as f64 + (window.height as f64 - 1.0) / 2.0;
    let images = scene.images.iter();
    let rows = images.map(|image| (image.name.as_str(), middle(&image.window)));
    config.cameras.shifts_px = cameras.shifts_at(&rows.collect());
    config.cameras.left_out = cameras.left_out;
    Ok(())
}

/// Searches the ties of some patches of an area.
fn ties(work: &TiesWork, folder: &Path, session: &Session) -> Result<Done> {
    let index = Index::open(&work.scene, work.ingest.rpc)?;
    let config = work.preset.config()?;
    let ties = PatchTies::find(&index, &work.ingest, &work.patches, &config, session)?;
    ties.write(&folder.join(TIES))?;
    let metrics = json!({"patches": work.patches.len(), "ties": ties.count()});
    Ok((vec![TIES.into()], metrics))
}

/// Corrects the pointing of each image, once for all tiles.
fn adjust(work: &AdjustWork, out: &Path, folder: &Path) -> Result<Done> {
    let index = Index::open(&work.scene, work.rpc)?;
    let of_unit = |unit: &String| PatchTies::read(&out.join(unit).join(TIES));
    let ties = work.ties.iter().map(of_unit).collect::<Result<Vec<_>, _>>()?;
    let cameras = SharedCameras::of(&index, &ties, work.preset.config()?.cameras.align);
    let metrics = serde_json::to_value(&cameras).unwrap_or_default();
    write_atomically(&folder.join(CAMERAS), format!("{metrics:#}\n").as_bytes())?;
    Ok((vec![CAMERAS.into()], metrics))
}

/// Finds the gains of the colours of all tiles of an area, and the look of its 3D Tiles.
fn colours(work: &ColoursWork, out: &Path, folder: &Path) -> Result<Done> {
    let sun = work.products.sun;
    let mut found = Colours::find(out, &work.tiles, work.gsd_m, sun.map(sun_of).as_ref())?;
    if work.products.globe {
        found.reference = products::reference(out, &work.tiles, &found, sun)?;
    }
    found.write(&folder.join(colours::FILE))?;
    Ok((vec![colours::FILE.into()], json!({"tiles": work.tiles.len()})))
}

/// Scene of a tile; images without pixels in it are left out.
fn scene_of(work: &TileWork) -> Result<Scene, SceneError> {
    let index = Index::open(&work.scene, work.ingest.rpc)?;
    let mut warnings = Vec::new();
    let mut cut = Cut::of(&index, &work.ingest, &mut warnings)?;
    cut.is_part = true;
    Scene::read(&index, &cut, warnings)
}

/// Surface model of a tile from a plane sweep, without training.
fn swept(scene: &Scene, work: &TileWork, config: &SatelliteConfig, folder: &Path, session: &Session) -> Result<Done> {
    let surface = preprocess::sweep_only(scene, config, session)?;
    let dsm = dsm::of_surface(&scene.into(), &surface, work.gsd_m, Some(&work.crs))?;
    let path = folder.join("dsm.tif");
    dsm.write(&path)?;
    let shade = preview::hillshade(&dsm.altitude(), work.gsd_m);
    preview::write_png(&folder.join("dsm.png"), &shade)?;
    let mut metrics = json!({"residual_px": residual_px(scene)});
    if let Some(truth) = &scene.truth.dsm {
        let evaluation = evaluate_dsm(&path, truth, scene.truth.classes.as_deref(), Protocol::Raw)?;
        metrics["dsm"] = measure::surface_metrics(&evaluation);
    }
    let mut outputs = dsm::files("dsm.tif");
    outputs.push("dsm.png".into());
    Ok((outputs, metrics))
}

/// Largest distance between the pinhole cameras of a scene and its rational ones, pixels.
fn residual_px(scene: &Scene) -> f64 {
    let residuals = scene.images.iter().map(|image| image.pinhole.max_px);
    residuals.fold(0.0, f64::max)
}

fn mosaic_unit(work: &MosaicWork, unit: &Unit, out: &Path, folder: &Path) -> Result<Done> {
    let mut work = work.clone();
    work.tiles.retain(|tile| out.join(&tile.unit).join("dsm.tif").is_file());
    let work = &work;
    if work.tiles.is_empty() {
        return Ok(nothing(&unit.id));
    }
    let mut mosaic = mosaic(out, work)?;
    let is_block = matches!(unit.work, Work::Block(_));
    if is_block && mosaic.dsm.completeness() == 0.0 {
        return Ok(nothing(&unit.id));
    }
    let pieces = &mosaic.parts.pieces;
    let path = folder.join("dsm.tif");
    let altitude = mosaic.dsm.altitude();
    preview::write_png(&folder.join("dsm.png"), &preview::hillshade(&altitude, work.gsd_m))?;
    let mut metrics = json!({
        "tiles": pieces.len(),
        "width": altitude.width,
        "height": altitude.height,
        "gsd_m": work.gsd_m,
        "completeness": mosaic.dsm.completeness(),
        "seams": seams::measure(&altitude, pieces),
        "pieces": pieces.iter().map(|p| json!({"unit": p.unit, "core": p.core, "bounds": p.bounds})).collect::<Vec<_>>(),
    });
    let mut outputs: Vec<String> = vec!["dsm.png".into()];
    if let Some(truth) = &work.truth {
        // Truth is above the ellipsoid even if the products refer to a geoid.
        let made = mosaic.dsm.geo_raster();
        match evaluate_raster((&path, &made), truth, work.classes.as_deref(), Protocol::Raw) {
            // The truth may show another part of the area.
            Err(EvaluateError::Apart(..)) if is_block => (),
            evaluation => {
                let evaluation = evaluation?;
                metrics["dsm"] = measure::surface_metrics(&evaluation);
                if !is_block {
                    // The map of errors is on the grid of the truth, which a block has a part of.
                    preview::write_png(&folder.join("error.png"), &error_map::draw(&evaluation.errors))?;
                    error_map::write(&folder.join("error.tif"), &evaluation)?;
                    outputs.extend(["error.png".into(), "error.tif".into()]);
                }
            }
        }
    }
    if let Some(geoid) = work.products.geoid {
        mosaic.dsm = mosaic.dsm.above(geoid)?;
    }
    if work.products.dsm_only {
        mosaic.dsm.write(&path)?;
        outputs.extend(dsm::files("dsm.tif"));
        if view::into_folder(folder, view::of_mosaic(folder, None))?.is_some() {
            outputs.push(SUN.into());
        }
    } else {
        let (names, said) = products::of_mosaic(out, work, &mosaic, unit, folder)?;
        outputs.extend(names);
        metrics["products"] = said;
    }
    let text = format!("{metrics:#}\n");
    write_atomically(&folder.join(MOSAIC_FILE), text.as_bytes())?;
    report::mosaic::write(folder)?;
    outputs.extend([MOSAIC_FILE.into(), REPORT.into()]);
    Ok((outputs, metrics))
}
