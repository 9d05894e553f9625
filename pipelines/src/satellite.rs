//! The satellite pipeline: a scene in, a trained model and its products out.

pub mod adjust;
pub mod budget;
mod clouds;
pub mod config;
pub mod estimate;
pub mod fit;
pub mod ground;
mod initial;
pub(crate) mod measure;
pub mod plan;
mod radiometry;
pub(crate) mod saturation;
mod shadow_prior;
mod swept;
pub mod training;
pub mod views;

pub use plan::{PlanItem, plan};

use crate::cli::evaluate::{EvaluateArgs, table, write_pictures};
use crate::cli::satellite::{DemoArgs, DsmArgs, DsmSource, RelightArgs, RenderArgs, RenderSplit};
use crate::cli::{CliError, Outcome, Session};
use crate::product::{dsm, relight, views as rendered};
use crate::raster::write::{ImageSpec, Sample, write_geotiff};
use crate::run::checkpoint::CheckpointError;
use crate::run::{self, RunError};
use crate::scene::{Scene, SceneError, Split};
use config::{ConfigError, SatelliteConfig};
use fit::FitError;
use heliosplat_rpc::sun::sun_position;
use relight::RelightError;
use serde_json::json;
use std::path::Path;
use std::time::Instant;
use training::{Told, create_folder};

impl From<RunError> for CliError {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Write(raster) => raster.into(),
            RunError::NotARun(_) | RunError::Damaged { .. } => Self::Input(error.to_string()),
            RunError::Io { .. } => Self::Failed(error.to_string()),
        }
    }
}

impl From<ConfigError> for CliError {
    fn from(error: ConfigError) -> Self {
        Self::Input(error.to_string())
    }
}

impl From<FitError> for CliError {
    fn from(error: FitError) -> Self {
        match error {
            FitError::TooFewViews { .. } | FitError::Memory { .. } | FitError::Mask(_) => {
                Self::Input(error.to_string())
            }
            FitError::Train(_) => Self::Failed(error.to_string()),
            FitError::Checkpoint(error) => error.into(),
        }
    }
}

impl From<CheckpointError> for CliError {
    fn from(error: CheckpointError) -> Self {
        match error.is_input_fault() {
            true => Self::Input(error.to_string()),
            false => Self::Failed(error.to_string()),
        }
    }
}

impl From<RelightError> for CliError {
    fn from(error: RelightError) -> Self {
        match error {
            RelightError::Run(error) => error.into(),
            RelightError::Raster(error) => error.into(),
            RelightError::Night { .. } | RelightError::NoView { .. } => Self::Input(error.to_string()),
        }
    }
}

/// Synthesises a site, trains on it and writes its products.
///
/// # Errors
/// When the folder cannot be written, or a stage fails.
pub fn demo(args: &DemoArgs, session: &Session) -> Result<Outcome, CliError> {
    let scene_folder = args.out.join("scene");
    create_folder(&args.out)?;
    let request = heliosplat_synth::SatelliteRequest {
        site: heliosplat_synth::Site::Block,
        seed: args.seed,
        ..Default::default()
    };
    let progress = session.progress("synthesise", 100);
    heliosplat_synth::write_satellite(&request, &scene_folder, &|done, total| {
        progress.set((100 * done / total.max(1)) as u64);
    })
    .map_err(|error| CliError::Failed(error.to_string()))?;
    drop(progress);
    let begun = Instant::now();
    let scene = Scene::open(&scene_folder, &Default::default())?;
    let config = SatelliteConfig::resolve("fast", &[], args.seed)?;
    let run_folder = args.out.join("run");
    let told = Told::new("fast", begun);
    let (model, metrics, ending) = training::train_into(&scene, &run_folder, &config, &told, session)?;
    training::finished(ending, &run_folder)?;
    let evening = heliosplat_rpc::sun::SunPosition::from_degrees(250.0, 20.0);
    relight::relight(&model, &evening, "nadir")?.write(&args.out.join("evening.png"))?;
    let mae = metrics
        .pointer("/dsm/mae_m")
        .and_then(serde_json::Value::as_f64)
        .unwrap_or(f64::NAN);
    let folder = args.out.display();
    Ok(Outcome {
        text: format!(
            "{}\nDSM            {folder}/run/dsm.tif   (open it in QGIS)\npicture        {folder}/run/dsm.png\nerrors         {folder}/run/error.png\nanother sun    {folder}/evening.png\nmean absolute error against truth: {mae:.3} m (protocol raw)",
            measure::summary(&metrics)
        ),
        json: metrics,
    })
}

/// Writes the surface model of a run, or that of a scene's sweep.
///
/// # Errors
/// When the run, the scene, the coordinate system or the file to write is at fault.
pub fn dsm(args: &DsmArgs, session: &Session) -> Result<Outcome, CliError> {
    let (surface, gsd_m) = match args.from {
        DsmSource::Model => {
            if args.ingest.altitude.is_some() {
                return Err(CliError::Input(
                    "dsm: --altitude is for --from sweep; a run knows its own".into(),
                ));
            }
            let model = run::load(&args.run)?;
            let gsd_m = args.gsd.unwrap_or(model.file.gsd_m);
            (dsm::dsm(&model, gsd_m, args.crs.as_deref())?, gsd_m)
        }
        DsmSource::Sweep => {
            let scene = Scene::open(&args.run, &args.ingest.options())?;
            let gsd_m = args.gsd.unwrap_or(scene.gsd_m);
            let swept = swept::sweep_only(
                &scene,
                &plan::with_plan(&scene, &SatelliteConfig::resolve("fast", &[], 1)?),
                session,
            )?;
            let surface = dsm::of_surface(&(&scene).into(), &swept, gsd_m, args.crs.as_deref())?;
            (surface, gsd_m)
        }
    };
    let known = surface.raster.plane(0).iter().filter(|v| v.is_finite()).count();
    if known == 0 {
        let crs = surface.grid.crs.name();
        return Err(CliError::Input(format!(
            "dsm: nothing of {} falls on a grid in {crs}; choose a projected coordinate system of the place with --crs",
            args.run.display()
        )));
    }
    surface.write(&args.out)?;
    let share = known as f64 / surface.raster.plane_len().max(1) as f64;
    let (width, height) = (surface.grid.width, surface.grid.height);
    let crs = surface.grid.crs.name().to_owned();
    Ok(Outcome {
        text: format!(
            "{}: {width} x {height} cells of {gsd_m} m, {crs}, {:.1} % known",
            args.out.display(),
            100.0 * share
        ),
        json: json!({"dsm": args.out, "width": width, "height": height, "gsd_m": gsd_m, "crs": crs, "completeness": share}),
    })
}

/// Writes the scene of a run under another sun.
///
/// # Errors
/// When the run, the sun, the view or the file to write is at fault.
pub fn relight(args: &RelightArgs, _session: &Session) -> Result<Outcome, CliError> {
    let model = run::load(&args.run)?;
    let sun = match (args.sun, args.time) {
        (Some([azimuth, elevation]), _) => heliosplat_rpc::sun::SunPosition::from_degrees(azimuth, elevation),
        (None, Some(time)) => sun_position(time, model.frame.origin),
        (None, None) => {
            return Err(CliError::Input(
                "relight: a satellite scene takes --sun AZ,EL or --time RFC3339".into(),
            ));
        }
    };
    let relit = relight::relight(&model, &sun, &args.view)?;
    let mask = relit.write(&args.out)?;
    let (azimuth, elevation) = (sun.azimuth_rad.to_degrees(), sun.elevation_rad.to_degrees());
    Ok(Outcome {
        text: format!(
            "{} and {}: sun at azimuth {azimuth:.2}, elevation {elevation:.2}",
            args.out.display(),
            mask.display()
        ),
        json: json!({"image": args.out, "shadow": mask, "sun_azimuth_deg": azimuth, "sun_elevation_deg": elevation}),
    })
}

/// Renders the views of a run.
///
/// # Errors
/// When the run is at fault, or a file cannot be written.
pub fn render(args: &RenderArgs, session: &Session) -> Result<Outcome, CliError> {
    let model = run::load(&args.run)?;
    let wanted = |split: Split| match args.split {
        RenderSplit::Train => split == Split::Train,
        RenderSplit::Test => split == Split::Test,
        RenderSplit::All => true,
    };
    let images: Vec<_> = model.file.images.iter().filter(|image| wanted(image.split)).collect();
    if images.is_empty() {
        return Err(CliError::Input(format!(
            "{}: the run has no image of that split",
            args.run.display()
        )));
    }
    create_folder(&args.out)?;
    let scene = reopen(&args.run).ok();
    let progress = session.progress("render", images.len() as u64);
    let mut written = Vec::new();
    for (done, image) in images.iter().enumerate() {
        let truth = scene
            .as_ref()
            .and_then(|s| s.images.iter().find(|i| i.name == image.name));
        let truth = truth.map(|i| image.crop.cut(&i.pixels));
        let view = rendered::render_view(&model, image, truth.as_ref());
        let path = args.out.join(format!("{}.tif", image.name));
        let mut counts = view.image;
        counts
            .values
            .iter_mut()
            .for_each(|v| *v *= model.file.counts_per_unit as f32);
        write_geotiff(&path, &ImageSpec::plain(&counts), Sample::F32)?;
        let mask_path = args.out.join(format!("{}_shadow.tif", image.name));
        let mut mask = view.visibility;
        mask.values.iter_mut().for_each(|v| *v = 1.0 - *v);
        write_geotiff(&mask_path, &ImageSpec::plain(&mask), Sample::F32)?;
        written.push(json!({"image": path, "shadow": mask_path, "name": image.name, "colour": view.colour.text()}));
        progress.set(done as u64 + 1);
    }
    Ok(Outcome {
        text: format!("{} views in {}", written.len(), args.out.display()),
        json: json!({"views": written}),
    })
}

/// The scene a run was trained on.
fn reopen(run: &Path) -> Result<Scene, CliError> {
    let file = run::load_run(run)?;
    let options = crate::scene::IngestOptions {
        altitude_range_m: file.altitude_range_m,
        area: file.area,
        ..Default::default()
    };
    Scene::open(&file.scene, &options)
        .map_err(|error: SceneError| CliError::Input(format!("{}: the scene of the run: {error}", run.display())))
}

/// Measures a run against the truth of its scene.
///
/// # Errors
/// When the run or its scene cannot be read.
pub fn evaluate(run: &Path, args: &EvaluateArgs, _session: &Session) -> Result<Outcome, CliError> {
    let model = run::load(run)?;
    let scene = reopen(run)?;
    let evaluation = measure::dsm(&scene, run, args.protocol)?;
    let metrics = measure::metrics(&scene, &model, run, args.protocol)?;
    let mut text = String::new();
    if let Some(evaluation) = &evaluation {
        text = table(&evaluation.metrics);
        write_pictures(args, evaluation)?;
    }
    Ok(Outcome {
        text: text + &measure::summary(&metrics),
        json: metrics,
    })
}
