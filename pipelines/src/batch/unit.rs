//! Doing one unit.

use super::BatchError;
use super::mosaic::mosaic;
use super::plan::{MosaicWork, Plan, TileWork, Unit, Work};
use super::seams;
use super::stamp::{Output, STAMP, Stamp, claim, finished};
use crate::cli::satellite::{Preset, TrainArgs};
use crate::cli::{CliError, IngestArgs, Session};
use crate::evaluate::{Protocol, evaluate_dsm};
use crate::product::dsm;
use crate::raster::preview;
use crate::raster::write::{deliver, remove_leftovers, write_atomically};
use crate::run::{self, checkpoint};
use crate::satellite::training;
use clap::ValueEnum;
use serde_json::{Value, json};
use std::path::Path;
use std::time::{Duration, Instant};

/// Name of the file that says which work a folder was last used for.
const BEGUN: &str = "begun.txt";
/// Folder of a tile's training.
const RUN: &str = "run";

/// Does a unit, unless it is finished; returns its stamp and whether it was finished before.
///
/// # Errors
/// When what it waits for is not finished, its inputs are at fault, or the user stops it.
pub fn do_unit(
    plan: &Plan,
    unit: &Unit,
    out: &Path,
    checkpoint_every: Duration,
    session: &Session,
) -> Result<(Stamp, bool), CliError> {
    for after in &unit.after {
        if finished(out, plan.unit(after)?).is_none() {
            return Err(BatchError::NotYet {
                unit: unit.id.clone(),
                after: after.clone(),
            }
            .into());
        }
    }
    let folder = out.join(&unit.id);
    training::create_folder(&folder)?;
    let Some(_claim) = claim(&folder, &|| session.stopped())? else {
        return Err(CliError::Interrupted(format!("{}: stopped before it began", unit.id)));
    };
    if let Some(stamp) = finished(out, unit) {
        return Ok((stamp, true));
    }
    begin(&folder, unit)?;
    let begun = Instant::now();
    let (outputs, metrics) = match &unit.work {
        Work::Tile(work) => tile(work, &folder, checkpoint_every, session)?,
        Work::Mosaic(work) => mosaic_unit(work, out, &folder)?,
        Work::Refused { reason } => return Err(CliError::Input(reason.clone())),
    };
    if let Some(to) = &unit.deliver {
        deliver(&folder.join("dsm.tif"), Path::new(&format!("{to}/{}/dsm.tif", unit.id)))?;
    }
    let seconds = metrics["seconds"]
        .as_f64()
        .unwrap_or_else(|| begun.elapsed().as_secs_f64());
    let mut stamp = Stamp {
        unit: unit.id.clone(),
        key: unit.key.clone(),
        outputs: Vec::new(),
        seconds,
        peak_rss_bytes: run::peak_rss_bytes(),
        metrics,
    };
    for output in outputs {
        stamp.outputs.push(Output::of(&folder, output)?);
    }
    let text = serde_json::to_string_pretty(&stamp).unwrap_or_default();
    write_atomically(&folder.join(STAMP), text.as_bytes())?;
    Ok((stamp, false))
}

/// Puts away what an earlier use of the folder for other work left unfinished.
fn begin(folder: &Path, unit: &Unit) -> Result<(), CliError> {
    remove_leftovers(folder);
    let path = folder.join(BEGUN);
    let same = std::fs::read_to_string(&path).is_ok_and(|before| before.trim() == unit.key);
    // A stamp that is of other work, or whose products are gone, must not be found again.
    let _ = std::fs::remove_file(folder.join(STAMP));
    if !same {
        checkpoint::remove(&folder.join(RUN));
        write_atomically(&path, unit.key.as_bytes())?;
    }
    Ok(())
}

type Done = (Vec<&'static str>, Value);

fn tile(work: &TileWork, folder: &Path, checkpoint_every: Duration, session: &Session) -> Result<Done, CliError> {
    let run = folder.join(RUN);
    let args = TrainArgs {
        scene: work.scene.clone(),
        out: run.clone(),
        preset: Preset::from_str(work.preset.base(), true).ok(),
        time_budget: None,
        memory: None,
        seed: work.preset.seed,
        set: work.preset.changes(),
        resume: true,
        checkpoint_every,
        ingest: IngestArgs {
            altitude: work.altitude_m,
            rpc: work.rpc,
            area: Some(work.area.clone()),
        },
    };
    let trained = training::train(&args, session)?;
    let model = run::load(&run)?;
    dsm::dsm(&model, work.gsd_m, Some(&work.crs))?.write(&folder.join("dsm.tif"))?;
    let mut metrics = json!({"residual_px": work.residual_px});
    for key in [
        "seconds",
        "iterations",
        "gaussians",
        "peak_rss_bytes",
        "dsm",
        "train",
        "test",
        "shadow",
    ] {
        if let Some(value) = trained.json.get(key) {
            metrics[key] = value.clone();
        }
    }
    let outputs = vec![
        "dsm.tif",
        "run/model.ply",
        "run/model.json",
        "run/run.toml",
        "run/metrics.json",
    ];
    Ok((outputs, metrics))
}

fn mosaic_unit(work: &MosaicWork, out: &Path, folder: &Path) -> Result<Done, CliError> {
    let mosaic = mosaic(out, work)?;
    let path = folder.join("dsm.tif");
    mosaic.dsm.write(&path)?;
    let altitude = mosaic.dsm.altitude();
    preview::write_png(&folder.join("dsm.png"), &preview::hillshade(&altitude, work.gsd_m))?;
    let seams = seams::measure(&altitude, &mosaic.pieces);
    let known = altitude.values.iter().filter(|v| v.is_finite()).count();
    let mut metrics = json!({
        "tiles": mosaic.pieces.len(),
        "width": altitude.width,
        "height": altitude.height,
        "completeness": known as f64 / altitude.values.len().max(1) as f64,
        "seams": seams,
    });
    if let Some(truth) = &work.truth {
        let evaluation = evaluate_dsm(&path, truth, work.classes.as_deref(), Protocol::Raw)?;
        metrics["dsm"] = serde_json::to_value(&evaluation.metrics).unwrap_or_default();
    }
    let text = format!("{metrics:#}\n");
    write_atomically(&folder.join("mosaic.json"), text.as_bytes())?;
    Ok((vec!["dsm.tif", "dsm.png", "mosaic.json"], metrics))
}
