//! `dsm --from sweep`: surface model of a scene without training, as a whole or in tiles, within a memory limit.

use super::model_args::DsmArgs;
use crate::outcome::{CliError, Outcome};
use crate::outputs::Inputs;
use heliosplat::timeline::stage;
use heliosplat_fitting::run_folder::peak_rss_bytes;
use heliosplat_fitting::settings::Preset;
use heliosplat_products::dsm::{self, Dsm};
use heliosplat_raster::Geoid;
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::sweep_tiles::{MapRequest, SweepPlan, SweepTiling};
use heliosplat_satellite::tiled_sweep::{MOST_ROUNDS, TiledSweep, Written};
use heliosplat_satellite::{altitude, preprocess};
use heliosplat_scene::survey::Survey;
use heliosplat_scene::{Index, IngestOptions, SceneError};
use heliosplat_session::{Session, memory};
use serde_json::{Value, json};

/// Share of the machine's memory that a sweep may take without `--memory`.
const SHARE_OF_MEMORY: f64 = 0.5;

/// Surface model of a sweep, in memory or written.
pub(super) enum SweptSurface {
    /// In memory: the surface model, heights above the ellipsoid, the width of a cell, metres, and for `--json` the
    /// limit, plan and peak of the sweep's memory, bytes, and the warnings about the scene, one line each.
    Whole(Box<Dsm>, f64, (Value, Vec<String>)),
    /// Written in tiles; the outcome of the verb.
    InTiles(Outcome),
}

/// Sweeps a scene in memory; a scene that does not fit into memory is swept in tiles and written to `--out`.
///
/// # Errors
/// When the scene or the map cannot be used, an output would replace an input, or the file cannot be written.
pub(super) fn sweep(
    args: &DsmArgs,
    (crs, geoid): (Option<&str>, Option<Geoid>),
    session: &Session,
) -> Result<SweptSurface, CliError> {
    let config = SatelliteConfig::resolve(Preset::Fast, &[], 1)?;
    let part = stage("read");
    let options = args.ingest.options();
    let index = Index::open(&args.run, options.rpc)?;
    let options = altitude::resolve(&index, &options)?;
    let survey = Survey::of(&index, &options)?;
    drop(part);
    Inputs::of_index(&index).keep_surface(&args.out)?;
    let share = |bytes: u64| (bytes as f64 * SHARE_OF_MEMORY) as u64;
    let limit = args.memory.or_else(|| memory::machine_bytes().map(share));
    let map = MapRequest { gsd_m: args.gsd, crs };
    let plan = SweepPlan::of(&survey, &config, &map, limit)?;
    if plan.tiling.is_some() {
        return in_tiles(args, &index, options, &config, (&map, geoid, limit), session).map(SweptSurface::InTiles);
    }
    drop(survey);
    let (scene, found) = preprocess::open_and_sweep(&index, &options, &config, session)?;
    let _part = stage("products");
    let gsd_m = args.gsd.unwrap_or(scene.gsd_m);
    let surface = dsm::of_surface(&(&scene).into(), &found, gsd_m, crs)?;
    let said = (memory_of(limit, &plan), scene.warnings);
    Ok(SweptSurface::Whole(Box::new(surface), gsd_m, said))
}

fn memory_of(limit: Option<u64>, plan: &SweepPlan) -> Value {
    json!({"limit_bytes": limit, "planned_bytes": plan.peak_bytes.ceil(), "peak_bytes": peak_rss_bytes()})
}

/// Sweeps a scene in tiles. An altitude range from tie points is widened if the surface touches its limits.
fn in_tiles(
    args: &DsmArgs,
    index: &Index,
    mut options: IngestOptions,
    config: &SatelliteConfig,
    (map, geoid, limit): (&MapRequest, Option<Geoid>, Option<u64>),
    session: &Session,
) -> Result<Outcome, CliError> {
    for round in 0.. {
        let part = stage("read");
        let survey = Survey::of(index, &options)?;
        if round == 0 {
            survey.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
        }
        drop(part);
        let plan = SweepPlan::of(&survey, config, map, limit)?;
        // A wider altitude range needs more memory: the scene still does not fit as a whole.
        let Some(tiling) = &plan.tiling else { break };
        if args.fill {
            let text = "dsm: --fill looks at all of a surface model at once, and this one does not fit into the memory \
allowed; give more --memory, or leave --fill out";
            return Err(CliError::Input(text.into()));
        }
        let (rows, columns) = tiling.size;
        let (count, gib) = (tiling.tiles.len(), plan.peak_bytes / f64::from(1 << 30));
        tracing::info!("swept in {count} tiles ({rows} x {columns}) of at most {gib:.2} GiB");
        let tiled = TiledSweep {
            config,
            survey: &survey,
            plan: &plan,
            tiling,
            geoid,
        };
        let written = tiled.write(&args.out, session)?;
        let may_widen = options.altitude_from_ties_m.is_some() && round < MOST_ROUNDS;
        match written.wider_m.filter(|_| may_widen) {
            Some(range_m) => {
                tracing::info!("searched again from {:.0} to {:.0} m", range_m.0, range_m.1);
                options.altitude_from_ties_m = Some(range_m);
            }
            None => return outcome_of(args, &survey, tiling, &written, &memory_of(limit, &plan)),
        }
    }
    Err(SceneError::NoPixels(args.run.clone()).into())
}

fn outcome_of(
    args: &DsmArgs,
    survey: &Survey,
    tiling: &SweepTiling,
    written: &Written,
    memory: &Value,
) -> Result<Outcome, CliError> {
    let &Written {
        tiles, completeness, ..
    } = written;
    let grid = &tiling.grid;
    let crs = grid.crs.name();
    if completeness == 0.0 {
        return Err(nothing_known(args, crs));
    }
    let gsd_m = grid.transform.pixel_size().0 * grid.crs.metres_per_unit();
    let (width, height) = (grid.width, grid.height);
    let (out, share) = (args.out.display(), 100.0 * completeness);
    let cells = format!("{out}: {width} x {height} cells of {gsd_m} m, {crs}");
    let text = format!("{cells}, {share:.1} % known, in {tiles} tiles");
    let json = json!({
        "dsm": args.out, "width": width, "height": height, "gsd_m": gsd_m, "crs": crs, "completeness": completeness,
        "filled": 0.0, "tiles": tiles, "memory": memory, "warnings": survey.warnings
    });
    Ok(Outcome::new(text, json))
}

/// Error for a surface model without known heights.
pub(super) fn nothing_known(args: &DsmArgs, crs: &str) -> CliError {
    CliError::Input(format!(
        "dsm: nothing of {} falls on a grid in {crs}; choose a projected coordinate system of the place with --crs",
        args.run.display()
    ))
}
