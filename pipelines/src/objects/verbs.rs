//! The verbs of the program, for captures and runs on them.

use super::capture::{Capture, IMAGE_BYTES};
use super::config::{Background, ObjectConfig};
use super::error::CaptureError;
use super::fit::{self, Fitted};
use super::run::{self, ObjectModel, ObjectRun};
use super::surroundings::{self, Lamp};
use super::{export, measure, mesh, plan, views};
use crate::cli::export::ExportArgs;
use crate::cli::satellite::{RelightArgs, RenderArgs, RenderSplit, TrainArgs};
use crate::cli::{CliError, Outcome, Session};
use crate::raster::preview::write_png;
use crate::raster::write::write_atomically;
use crate::report;
use crate::run::checkpoint::{self, Keeper};
use crate::run::{Input, hash, peak_rss_bytes, resident_bytes, save_metrics};
use crate::satellite::budget::Budget;
use crate::satellite::fit::Ending;
use crate::satellite::training::{create_folder, finished, interrupted};
use crate::scene::Split;
use glam::DVec3;
use heliosplat::light::Light;
use heliosplat::model::SceneModel;
use heliosplat::model::olat::Component;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

/// Bytes that a Gaussian takes in training: its parameters, their gradients, Adam's two memories, and its splat.
const BYTES_PER_GAUSSIAN: f64 = 4.0 * 4.0 * 59.0 + 500.0;

impl From<CaptureError> for CliError {
    fn from(error: CaptureError) -> Self {
        Self::Input(error.to_string())
    }
}

/// Opens a capture; says what looks wrong.
fn open(path: &Path, memory: Option<u64>) -> Result<Capture, CliError> {
    let capture = Capture::open(path, memory.map_or(IMAGE_BYTES, |bytes| bytes / 2))?;
    for warning in &capture.warnings {
        tracing::warn!("{warning}");
    }
    Ok(capture)
}

/// Trains a model.
///
/// # Errors
/// When the capture, the configuration or a limit is at fault, training gives up, or a file cannot be written.
pub fn train(args: &TrainArgs, session: &Session) -> Result<Outcome, CliError> {
    let begun = Instant::now();
    for (told, name) in [
        (args.ingest.altitude.is_some(), "altitude"),
        (args.ingest.area.is_some(), "area"),
    ] {
        if told {
            let text = format!("train --{name}: not for captures of objects; train again without it");
            return Err(CliError::Input(text));
        }
    }
    let preset = args.preset.unwrap_or_default();
    let mut config = ObjectConfig::resolve(preset.name(), &args.set, args.seed)?;
    let capture = open(&args.scene, args.memory)?;
    if let Some(limit) = args.memory {
        let resident = resident_bytes() as f64;
        let left = limit as f64 - resident;
        let most = (left / BYTES_PER_GAUSSIAN).max(0.0) as usize;
        if most < config.start.gaussians {
            let least = config.start.gaussians as f64 * BYTES_PER_GAUSSIAN + resident;
            return Err(CliError::Input(format!(
                "--memory: the images leave no room for {} Gaussians; give {:.2}GiB or more, or fewer with --set start.gaussians={most}",
                config.start.gaussians,
                least / f64::from(1 << 30) + 0.01
            )));
        }
        config.train.density.cap = config.train.density.cap.min(most);
    }
    let inputs = hashes(&capture)?;
    let identity = identity(args, &config, &capture, &inputs)?;
    let done = metrics_of(&args.out).filter(|done| args.resume && done["training"] == checkpoint::digest(&identity));
    if let Some(metrics) = done {
        report::complete(&args.out)?;
        checkpoint::remove(&args.out);
        let text = format!(
            "{}\nrun            {} (finished before)",
            measure::summary(&metrics),
            args.out.display()
        );
        return Ok(Outcome { json: metrics, text });
    }
    let kept = match args.resume {
        true => checkpoint::read(&args.out, &identity)?,
        false => None,
    };
    let before = kept.as_ref().map_or(0.0, |kept| kept.course.elapsed_s);
    let before = std::time::Duration::try_from_secs_f64(before).unwrap_or_default();
    let begun = begun.checked_sub(before).unwrap_or(begun);
    let budget = args
        .time_budget
        .map(|limit| Budget::new(begun, limit, capture.frames.len()));
    let new = !args.out.exists();
    create_folder(&args.out)?;
    let keeper = Keeper::new(&args.out, &identity, args.checkpoint_every, begun);
    let fitted = fit::fit(&capture, &config, session, budget, keeper, kept).inspect_err(|_| {
        if new {
            // Only removes it while it is empty; that it stays is no further fault.
            let _ = std::fs::remove_dir(&args.out);
        }
    })?;
    if fitted.ending == Ending::Interrupted {
        return Err(interrupted(&args.out));
    }
    let run = ObjectRun {
        version: env!("CARGO_PKG_VERSION").into(),
        preset: preset.name().into(),
        seed: args.seed,
        capture: std::fs::canonicalize(&args.scene).unwrap_or_else(|_| args.scene.clone()),
        inputs,
        config,
        plan: Some(fitted.plan.clone()),
    };
    let _ = std::fs::remove_file(args.out.join("metrics.json"));
    run::save(&args.out, &run, &fitted.model)?;
    let pictures = args.out.join("views");
    create_folder(&pictures)?;
    let mut metrics = measure::metrics(&fitted.model, &capture, Some(&pictures))?;
    add_fit(&mut metrics, &fitted, begun.elapsed().as_secs_f64());
    if fitted.ending == Ending::Done {
        metrics["training"] = checkpoint::digest(&identity).into();
    }
    save_metrics(&args.out, &metrics)?;
    report::object::of(&args.out, &fitted.model, &run)?;
    checkpoint::remove(&args.out);
    finished(fitted.ending, &args.out)?;
    let text = format!("{}\nrun            {}", measure::summary(&metrics), args.out.display());
    Ok(Outcome { json: metrics, text })
}

/// All that decides a training, line by line.
fn identity(args: &TrainArgs, config: &ObjectConfig, capture: &Capture, inputs: &[Input]) -> Result<String, CliError> {
    let mut text = checkpoint::identity_of_program();
    let config = toml::to_string(config).map_err(|error| CliError::Failed(error.to_string()))?;
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "--time-budget {:?}\n--memory {:?}\n{config}",
        args.time_budget, args.memory
    );
    for (frame, input) in capture.frames.iter().zip(inputs) {
        let _ = writeln!(text, "image {} {}", frame.name, input.sha256);
        let camera = format!("{:?} {:?} {:?}", frame.split, frame.camera, frame.light);
        let _ = writeln!(
            text,
            "camera and light of {} {}",
            frame.name,
            checkpoint::digest(&camera)
        );
    }
    Ok(text)
}

fn metrics_of(run: &Path) -> Option<Value> {
    serde_json::from_slice(&std::fs::read(run.join("metrics.json")).ok()?).ok()
}

fn hashes(capture: &Capture) -> Result<Vec<Input>, CliError> {
    let inputs = capture.frames.par_iter().map(|frame| {
        Ok(Input {
            path: frame.path.clone(),
            sha256: hash(&frame.path)?,
        })
    });
    Ok(inputs.collect::<Result<_, crate::run::RunError>>()?)
}

fn add_fit(metrics: &mut Value, fitted: &Fitted, seconds: f64) {
    metrics["seconds"] = json!(seconds);
    metrics["plan"] = json!(fitted.plan);
    metrics["stage_seconds"] = json!({"start": fitted.seconds[0], "train": fitted.seconds[1]});
    metrics["iterations"] = json!(fitted.iterations);
    metrics["rejected_steps"] = json!(fitted.rejected);
    metrics["start"] = json!({"gaussians": fitted.started, "how": fitted.start});
    metrics["peak_rss_bytes"] = json!(peak_rss_bytes());
    metrics["curve"] = json!(fitted.curve);
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
        let run = args.run.display();
        return Err(CliError::Input(format!(
            "{run}: the run has no image of that split; try --split all"
        )));
    }
    let parts = args.components.then(|| components(&model));
    if parts.as_ref().is_some_and(Vec::is_empty) {
        let name = model.model.name();
        return Err(CliError::Input(format!(
            "--components: a model of kind {name} knows no parts of the light"
        )));
    }
    create_folder(&args.out)?;
    let progress = session.progress("render", images.len() as u64);
    let mut written = Vec::new();
    for (done, image) in images.iter().enumerate() {
        let Some(seen) = model.render(image) else { continue };
        let path = args.out.join(format!("{}.png", measure::file_name(&image.name)));
        write_png(&path, &measure::picture(&seen, &model))?;
        written.push(json!({"image": path, "name": image.name}));
        if let Some(normals) = parts.as_ref().and_then(|_| model.normals(image)) {
            let path = args.out.join(format!("{}_normal.png", measure::file_name(&image.name)));
            write_png(&path, &measure::normal_picture(&normals))?;
        }
        for (name, shown) in parts.iter().flatten() {
            let Some(seen) = model.render_as(&**shown, image) else {
                continue;
            };
            let path = args.out.join(format!("{}_{name}.png", measure::file_name(&image.name)));
            write_png(&path, &measure::picture(&seen, &model))?;
        }
        progress.set(done as u64 + 1);
    }
    Ok(Outcome {
        text: format!("{} views in {}", written.len(), args.out.display()),
        json: json!({"views": written}),
    })
}

/// Models that show the parts of the light that a model knows, with their names.
pub(crate) fn components(model: &ObjectModel) -> Vec<(&'static str, Box<dyn SceneModel>)> {
    let parts = [
        ("diffuse", Component::Diffuse),
        ("specular", Component::Specular),
        ("shadow", Component::Shadow),
        ("scattering", Component::Scattering),
    ];
    let shown = parts
        .into_iter()
        .filter_map(|(name, part)| Some((name, model.file.kind.showing(part)?.model())));
    shown.collect()
}

/// Shows an object under other lights.
///
/// # Errors
/// When the run, the lights, the view or the file to write is at fault.
pub fn relight(args: &RelightArgs) -> Result<Outcome, CliError> {
    let model = run::load(&args.run)?;
    let folder = args.run.display();
    if model.file.kind.lit().is_none() {
        return Err(CliError::Input(format!(
            "{folder}: this model knows only the light it was photographed in; a capture with a light for every image makes one that does not"
        )));
    }
    let mut lights: Vec<Lamp> = Vec::new();
    let one = |light| Lamp {
        light,
        colour: [1.0; 3],
    };
    for &position in &args.light {
        lights.push(one(Light::Point((DVec3::from(position) - model.file.centre).as_vec3())));
    }
    for &toward in &args.toward {
        lights.push(one(parallel(toward)?));
    }
    if let Some(path) = &args.surroundings {
        let image = surroundings::read(path)?;
        lights.extend(surroundings::lamps(&image, args.samples));
    }
    if lights.is_empty() {
        return Err(CliError::Input(
            "relight: an object takes --light X,Y,Z, --toward X,Y,Z or --surroundings FILE that is not black".into(),
        ));
    }
    let images = &model.file.images;
    let image = match args.view.as_str() {
        "nadir" => images.first(),
        name => images.iter().find(|image| image.name.trim_start_matches("./") == name),
    };
    let image = image.ok_or_else(|| {
        let some = images.first().map_or("none", |image| image.name.as_str());
        CliError::Input(format!(
            "--view {}: {folder} has no image of that name; one is {some}",
            args.view
        ))
    })?;
    let seen = model.relit(image, &lights);
    let seen =
        seen.ok_or_else(|| CliError::Input(format!("--view {}: the object lies behind that camera", args.view)))?;
    // Lamps add up in linear values, whatever the images of the capture are.
    write_png(&args.out, &measure::picture_of(&seen, true))?;
    Ok(Outcome {
        text: format!(
            "{}: {} light(s), as {} saw it",
            args.out.display(),
            lights.len(),
            image.name
        ),
        json: json!({"image": args.out, "lights": lights.len(), "view": image.name}),
    })
}

/// Writes what other programs can use of a run.
///
/// # Errors
/// When the run or the light is at fault, or a file cannot be written.
pub fn export(args: &ExportArgs, session: &Session) -> Result<Outcome, CliError> {
    let format = match &args.mesh {
        Some(path) => Some((path, mesh_format(path)?)),
        None => None,
    };
    let model = run::load(&args.run)?;
    let mut written = Vec::new();
    if let Some(path) = &args.ply {
        let light = match (args.light, args.toward) {
            (Some(position), _) => Some(Light::Point((DVec3::from(position) - model.file.centre).as_vec3())),
            (None, Some(toward)) => Some(parallel(toward)?),
            (None, None) => None,
        };
        let splats = export::baked(&model, light)
            .map_err(|reason| CliError::Input(format!("{}: {reason}", args.run.display())))?;
        export::write_splats(&splats, path)?;
        written.push(path.clone());
    }
    if let Some(folder) = &args.asset {
        create_folder(folder)?;
        run::save_model(folder, &model)?;
        written.push(folder.clone());
    }
    if let Some((path, format)) = format {
        let progress = session.progress("mesh", 2 * model.file.images.len() as u64);
        let mesh = mesh::mesh(&model, args.cells as usize, &|done| progress.set(done))
            .map_err(|reason| CliError::Input(format!("{}: {reason}", args.run.display())))?;
        write_atomically(path, &mesh::encode(&mesh, format))?;
        written.push(path.clone());
    }
    let names: Vec<String> = written.iter().map(|path| path.display().to_string()).collect();
    Ok(Outcome {
        text: format!("{} Gaussians in {}", model.parameters.gaussians.count, names.join(", ")),
        json: json!({"written": written, "gaussians": model.parameters.gaussians.count}),
    })
}

fn mesh_format(path: &Path) -> Result<mesh::Format, CliError> {
    let format = mesh::Format::of(path);
    format.ok_or_else(|| {
        CliError::Input(format!(
            "--mesh {}: a name that ends in .ply or .glb says how",
            path.display()
        ))
    })
}

fn parallel(toward: [f64; 3]) -> Result<Light, CliError> {
    let direction = DVec3::from(toward).try_normalize();
    let direction = direction.ok_or_else(|| CliError::Input("--toward 0,0,0 is no direction".into()))?;
    Ok(Light::Directional(direction.as_vec3()))
}

/// Measures a run against the held-out images of its capture.
///
/// # Errors
/// When the run or its capture cannot be read.
pub fn evaluate(folder: &Path) -> Result<Outcome, CliError> {
    let (model, run) = (run::load(folder)?, run::load_run(folder)?);
    let capture = open(&run.capture, None)?;
    let metrics = measure::metrics(&model, &capture, None)?;
    Ok(Outcome {
        text: measure::summary(&metrics),
        json: metrics,
    })
}

/// Describes a capture.
///
/// # Errors
/// When the capture is at fault.
pub fn inspect(path: &Path) -> Result<Outcome, CliError> {
    let capture = open(path, None)?;
    let (background, why) = views::background(&capture, Background::Auto);
    let (kind, kind_why) = plan::outlook(&capture);
    let lights = capture.frames.iter().filter(|f| f.light.is_some()).count();
    let size = capture.frames.first().map_or([0; 2], |f| f.camera.size_px);
    let (train, test) = (capture.of(Split::Train).count(), capture.of(Split::Test).count());
    let encoding = capture.frames.first().map(|f| f.picture.encoding);
    let coverage = capture.has_coverage();
    let text = format!(
        "a capture of an object (transforms file)\nmodel          {kind:?}: {kind_why}\nimages         {train} to train with, {test} held out, {} x {} pixels\nvalues         {}, {}\nbackground     {background:?}: {why}\nlights         {lights} images have a point light\ncentre         {:.4}, half size {:.4}, a pixel there is {:.5} wide",
        size[0],
        size[1],
        if encoding == Some(super::pixels::Encoding::Linear) {
            "linear (EXR)"
        } else {
            "display (PNG, JPEG)"
        },
        if coverage { "with coverage" } else { "without coverage" },
        capture.centre,
        capture.half_size,
        capture.pixel_size,
    );
    let json = json!({
        "kind": "object", "model": kind, "train": train, "test": test, "size_px": size, "values": encoding, "coverage": coverage,
        "background": background, "lights": lights, "centre": capture.centre.to_array(),
        "half_size": capture.half_size, "pixel_size": capture.pixel_size, "warnings": capture.warnings,
    });
    Ok(Outcome { json, text })
}
