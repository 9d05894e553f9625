//! Verbs for satellite scenes, and for runs on them.

use super::evaluate_args::{EvaluateArgs, table, write_pictures};
use super::model_args::{DsmArgs, DsmSource, RelightArgs, RenderArgs, TrainArgs};
use super::sweep_dsm::{self, SweptSurface};
use crate::args::{NamedScene, map_of, sun_of};
use crate::outcome::{CliError, Outcome};
use crate::outputs::{Inputs, must_end_in};
use heliosplat::timeline::{self, stage};
use heliosplat_fitting::request::TrainOutcome;
use heliosplat_fitting::run_folder::{RunError, create_folder, read, save_metrics};
use heliosplat_pages::report::{self, add_report};
use heliosplat_products::change::{as_day, day_of};
use heliosplat_products::dsm::{Dsm, SurfaceFacts};
use heliosplat_products::model::{load, load_whole};
use heliosplat_products::{dsm, relight, views as rendered};
use heliosplat_raster::Crs;
use heliosplat_raster::write::{ImageSpec, SampleType, write_geotiff};
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::error::SatelliteError;
use heliosplat_satellite::run_file::scene_of;
use heliosplat_satellite::{altitude, estimate, measure, relit, training};
use heliosplat_scene::Index;
use heliosplat_scene::survey::Survey;
use heliosplat_session::Session;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;
use std::time::Instant;

/// Trains a model of a scene, and writes its report.
///
/// # Errors
/// When the scene or the configuration is invalid, a limit is exceeded, training fails or is stopped, or a file cannot
/// be written.
pub(crate) fn train(args: &TrainArgs, session: &Session) -> Result<Outcome, CliError> {
    let begun = Instant::now();
    timeline::take();
    let part = stage("read");
    let preset = args.preset.unwrap_or_default();
    let config = SatelliteConfig::resolve(preset, &args.set, args.seed.unwrap_or(1))?;
    let mut ingest = args.ingest.options();
    let index = Index::open(&args.scene, ingest.rpc)?;
    Inputs::of_index(&index).keep_folder(&args.out)?;
    if args.memory.is_some() {
        ingest = altitude::resolve(&index, &ingest)?;
        estimate::must_fit_unread(&Survey::of(&index, &ingest)?, args.memory, &config)?;
    }
    let scene = altitude::open(&index, &ingest)?;
    drop(index);
    for warning in &scene.warnings {
        tracing::warn!("{warning}");
    }
    drop(part);
    let estimate = estimate::estimate(&scene, &config);
    let (name, steps, gib) = (preset.name(), estimate.steps, estimate.peak_bytes / f64::from(1 << 30));
    tracing::info!("Preset {name}: {steps} steps, about {gib:.2} GiB of memory");
    // The surface is still unknown: the scene is refused only if one Gaussian per cell would not fit.
    estimate::must_fit(estimate.least_bytes, args.memory, &config)?;
    let request = args.request(preset, begun)?;
    let (metrics, before) = match training::train(&scene, &ingest, &config, &request, session)? {
        TrainOutcome::FinishedBefore { metrics } => {
            report::complete(&args.out)?;
            (metrics, " (finished before)")
        }
        TrainOutcome::Trained(mut run) => {
            add_report(&args.out, &mut run.metrics, || report::write(&args.out))?;
            run.ending.check(&args.out)?;
            (run.metrics, "")
        }
    };
    tracing::debug!("{}", measure::engine(&metrics).join("; "));
    let out = args.out.display();
    let mut text = match SurfaceFacts::deserialize(&metrics["surface"]) {
        Ok(facts) => facts.in_words(&args.out.join("dsm.tif")),
        Err(_) => String::new(),
    };
    for line in measure::accuracy(&metrics) {
        text += &format!("\n{line}");
    }
    text += &format!("\nrun            {out}{before}");
    if args.out.join(report::FILE).is_file() {
        text += &format!("\nreport         {out}/{}   (open it in a browser)", report::FILE);
    }
    text += &format!("\nnext           heliosplat products {out}");
    Ok(Outcome::new(text, metrics))
}

/// Writes the surface model of a run, or of the plane sweep of a scene, with its page.
///
/// # Errors
/// When the run, the scene, the coordinate reference system or an option cannot be used, no height is known, or a file
/// cannot be written.
pub(crate) fn dsm(args: &DsmArgs, session: &Session) -> Result<Outcome, CliError> {
    must_end_in("--out", &args.out, &["tif", "tiff"])?;
    let named = NamedScene::new(&args.runs)?;
    let args = &DsmArgs {
        run: named.path.clone(),
        ..args.clone()
    };
    let (crs, geoid) = map_of("dsm", args.crs.as_deref(), args.geoid)?;
    let crs = crs.as_ref().map(Crs::definition);
    let usual = match args.runs[..] {
        [_] => DsmSource::Model,
        _ => DsmSource::Sweep,
    };
    let (mut surface, gsd_m, swept) = match args.from.unwrap_or(usual) {
        DsmSource::Model => {
            let (surface, gsd_m) = surface_of_run(args, crs)?;
            (surface, gsd_m, None)
        }
        DsmSource::Sweep if args.date.is_some() => {
            let text = "dsm: --date is of a trained run, not of --from sweep";
            return Err(CliError::Input(text.into()));
        }
        DsmSource::Sweep => {
            timeline::take();
            match sweep_dsm::sweep(args, (crs, geoid), session)? {
                SweptSurface::Whole(surface, gsd_m, said) => (*surface, gsd_m, Some(said)),
                SweptSurface::InTiles(mut outcome) => {
                    outcome.json["timeline"] = json!(timeline::take());
                    return Ok(outcome);
                }
            }
        }
    };
    let known = surface.raster.plane(0).iter().filter(|v| v.is_finite()).count();
    if known == 0 {
        return Err(sweep_dsm::nothing_known(args, surface.grid.crs.name()));
    }
    let part = stage("products");
    let filled = if args.fill { surface.fill() } else { 0 };
    if let Some(geoid) = geoid {
        surface = surface.above(geoid)?;
    }
    surface.write(&args.out)?;
    let page = report::write_of_file(&args.out)?;
    drop(part);
    let [share, filled] = [known, filled].map(|cells| cells as f64 / surface.raster.plane_len().max(1) as f64);
    let (width, height) = (surface.grid.width, surface.grid.height);
    let crs = surface.grid.crs.name().to_owned();
    let facts = surface.facts(gsd_m);
    let mut said = json!({
        "dsm": args.out, "width": width, "height": height, "gsd_m": gsd_m, "crs": crs, "completeness": share, "filled": filled, "surface": facts, "page": page
    });
    if let Some((memory, warnings)) = swept {
        said["tiles"] = json!(1);
        said["memory"] = memory;
        said["warnings"] = json!(warnings);
        said["timeline"] = json!(timeline::take());
    }
    let mut text = facts.in_words(&args.out);
    if args.fill {
        text += &format!("\n                {:.1} % of the grid filled", 100.0 * filled);
    }
    Ok(Outcome::new(text, said))
}

/// Surface model of a run, and its ground sampling distance in metres.
fn surface_of_run(args: &DsmArgs, crs: Option<&str>) -> Result<(Dsm, f64), CliError> {
    let swept = [
        (args.ingest.altitude.is_some(), "altitude"),
        (args.memory.is_some(), "memory"),
    ];
    CliError::refuse("dsm", &swept, "for --from sweep; a run knows its own")?;
    Inputs::of_run(&args.run).keep_surface(&args.out)?;
    let model = match args.date {
        Some(date) => {
            let model = load_whole(&args.run)?;
            let times = model.file.images.iter().filter_map(|image| image.time);
            let first = times.min().map(day_of);
            if first.is_some_and(|first| as_day(date) < first) {
                tracing::warn!("no image was taken by {date}: the surface is that of the first one");
            }
            model.on(as_day(date))
        }
        None => load(&args.run)?,
    };
    let gsd_m = args.gsd.unwrap_or(model.file.gsd_m);
    Ok((dsm::dsm(&model, gsd_m, crs)?, gsd_m))
}

/// Writes the scene of a run under another sun, and its shadow mask.
///
/// # Errors
/// When the run, the sun or the view cannot be used, or a file cannot be written or would replace an input.
pub(crate) fn relight(args: &RelightArgs) -> Result<Outcome, CliError> {
    must_end_in("--out", &args.out, &["tif", "tiff", "png"])?;
    let model = load(&args.run)?;
    Inputs::of_run(&args.run).keep(&args.out)?;
    let sun = sun_of(args.sun, args.time, model.frame.origin);
    let wanted = || CliError::Input("relight: a satellite scene takes --sun AZ,EL or --time RFC3339".into());
    let sun = sun.ok_or_else(wanted)?;
    let relit = relight::Viewpoint::new(&model, &args.view)?.relit(&sun)?;
    let mask = relit.write(&args.out)?;
    let [azimuth, elevation] = sun.degrees();
    let (out, shadow) = (args.out.display(), mask.display());
    let text = format!(
        "Wrote {out} and {shadow}; sun azimuth {azimuth:.2}°, elevation {elevation:.2}°\nExposure: {}",
        relit.exposure
    );
    let json = json!({"image": args.out, "shadow": mask, "sun_azimuth_deg": azimuth, "sun_elevation_deg": elevation, "exposure": relit.exposure});
    Ok(Outcome::new(text, json))
}

/// Renders the views of a run as GeoTIFFs in counts of the images, with their shadow masks.
///
/// # Errors
/// When the run cannot be used or has no view of the split, or a file cannot be written.
pub(crate) fn render(args: &RenderArgs, session: &Session) -> Result<Outcome, CliError> {
    let whole = load_whole(&args.run)?;
    let (model, changing) = (whole.on_last(), !whole.model.options.days.is_empty());
    let images = args.of_split(&model.file.images, |image| image.split)?;
    Inputs::of_run(&args.run).keep_folder(&args.out)?;
    create_folder(&args.out)?;
    let scene = match scene_of(&args.run) {
        Ok(scene) => Some(scene),
        Err(SatelliteError::SceneOfRun { error, .. }) => {
            tracing::warn!("shadows are not compared with the images: {error}");
            None
        }
        Err(error) => return Err(error.into()),
    };
    let progress = session.progress("render", images.len() as u64);
    let mut written = Vec::new();
    for (done, image) in images.iter().enumerate() {
        let read = scene.iter().flat_map(|s| &s.images).find(|i| i.name == image.name);
        let truth = read.map(|i| image.crop.cut(&i.pixels));
        let of_day = image.time.filter(|_| changing).map(|time| whole.on(day_of(time)));
        let view = rendered::render_view(of_day.as_ref().unwrap_or(&model), image, truth.as_ref());
        let path = args.out.join(format!("{}.tif", image.name));
        let mut counts = view.image;
        let per_unit = model.file.counts_per_unit as f32;
        counts.values.iter_mut().for_each(|v| *v *= per_unit);
        write_geotiff(&path, &ImageSpec::plain(&counts), SampleType::F32)?;
        let mask_path = if image.sun.is_some() && model.file.has_light() {
            let mask_path = args.out.join(format!("{}_shadow.tif", image.name));
            let mut mask = view.visibility;
            mask.values.iter_mut().for_each(|v| *v = 1.0 - *v);
            write_geotiff(&mask_path, &ImageSpec::plain(&mask), SampleType::F32)?;
            Some(mask_path)
        } else {
            tracing::warn!("{}: no shadow mask, because its sun is unknown", image.name);
            None
        };
        written.push(json!({"image": path, "shadow": mask_path, "name": image.name, "colour": view.colour.text()}));
        progress.set(done as u64 + 1);
    }
    let text = format!("{} views in {}", written.len(), args.out.display());
    Ok(Outcome::new(text, json!({"views": written})))
}

/// Measures a run against the truth of its scene. Figures under other suns are also written to the run's metrics and
/// report.
///
/// # Errors
/// When the run, its scene or the truth cannot be read, or a file cannot be written.
pub(crate) fn evaluate(run: &Path, args: &EvaluateArgs) -> Result<Outcome, CliError> {
    let whole = load_whole(run)?;
    let model = whole.on_last();
    let mut scene = scene_of(run)?;
    if args.relit.is_some() {
        scene.truth.relit = None;
    }
    let evaluation = measure::dsm(&scene, &model, run, args.protocol)?;
    let mut metrics = measure::metrics(&scene, &whole, run, args.protocol)?;
    if let Some(folder) = &args.relit {
        metrics["relit"] = relit::measure(&model, folder, run)?;
    }
    let mut text = String::new();
    if let Some(evaluation) = &evaluation {
        text = table(&evaluation.metrics);
        write_pictures(args, evaluation)?;
    }
    if let Some(measured) = metrics.get("relit") {
        text += &relit::table(measured);
        keep(run, measured)?;
    }
    Ok(Outcome::new(text + &measure::summary(&metrics), metrics))
}

/// Writes figures under other suns to the `metrics.json` of a finished run, and updates its report.
fn keep(run: &Path, relit: &Value) -> Result<(), CliError> {
    let path = run.join("metrics.json");
    if !path.is_file() {
        return Ok(());
    }
    let mut metrics: Value =
        serde_json::from_str(&read(&path)?).map_err(|error| RunError::Damaged(path, error.to_string()))?;
    metrics["relit"] = relit.clone();
    save_metrics(run, &metrics)?;
    report::write(run)?;
    Ok(())
}
