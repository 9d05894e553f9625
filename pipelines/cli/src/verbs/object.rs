//! Verbs for captures of objects, and for runs on them.

use super::export_args::ExportArgs;
use super::model_args::{RelightArgs, RenderArgs, TrainArgs};
use crate::outcome::{CliError, Outcome};
use crate::outputs::{Inputs, must_end_in};
use glam::DVec3;
use heliosplat::light::Light;
use heliosplat::timeline;
use heliosplat_fitting::request::TrainOutcome;
use heliosplat_fitting::run_folder::create_folder;
use heliosplat_objects::config::{Background, ObjectConfigs};
use heliosplat_objects::model::{self, components};
use heliosplat_objects::pixels::Encoding;
use heliosplat_objects::run;
use heliosplat_objects::surroundings::{self, Lamp};
use heliosplat_objects::training::{self, TrainedObject, open};
use heliosplat_objects::{export, measure, mesh, plan, views};
use heliosplat_pages::report::{self, add_report};
use heliosplat_raster::preview::write_png;
use heliosplat_raster::write::write_atomically;
use heliosplat_scene::Split;
use heliosplat_session::Session;
use serde_json::json;
use std::path::Path;
use std::time::Instant;

/// Trains a model of a capture, and writes its report.
///
/// # Errors
/// When the capture, an option or the configuration is invalid, a limit is exceeded, training fails or is stopped, or a
/// file cannot be written.
pub(crate) fn train(args: &TrainArgs, session: &Session) -> Result<Outcome, CliError> {
    let begun = Instant::now();
    timeline::take();
    let ingest = &args.ingest;
    let of_scenes = [(ingest.altitude.is_some(), "altitude"), (ingest.area.is_some(), "area")];
    CliError::refuse(
        "train",
        &of_scenes,
        "not for captures of objects; train again without it",
    )?;
    let lists = ["transforms.json", "transforms_train.json", "cameras.csv"].map(|name| args.scene.join(name));
    Inputs::of_files(lists.iter().chain([&args.scene])).keep_folder(&args.out)?;
    let preset = args.preset.unwrap_or_default();
    let configs = ObjectConfigs::resolve(preset, &args.set, args.seed.unwrap_or(1))?;
    let request = args.request(preset, begun)?;
    let (metrics, before) = match training::train(&args.scene, configs, &request, session)? {
        TrainOutcome::FinishedBefore { metrics } => {
            report::complete(&args.out)?;
            (metrics, " (finished before)")
        }
        TrainOutcome::Trained(mut run) => {
            let TrainedObject { model, run: of_model } = &run.model;
            let write = || report::object::of(&args.out, model, of_model);
            add_report(&args.out, &mut run.metrics, write)?;
            run.ending.check(&args.out)?;
            (run.metrics, "")
        }
    };
    Ok(args.trained(&measure::summary(&metrics), metrics, before))
}

/// Renders the views of a run as PNG files, with light components and normals if requested.
///
/// # Errors
/// When the run cannot be used or has no such views or components, or a file cannot be written.
pub(crate) fn render(args: &RenderArgs, session: &Session) -> Result<Outcome, CliError> {
    let model = model::load(&args.run)?;
    let images = args.of_split(&model.file.images, |image| image.split)?;
    let parts = args.components.then(|| components(&model));
    if parts.as_ref().is_some_and(Vec::is_empty) {
        let fault = format!(
            "--components: a model of kind {} knows no parts of the light",
            model.model.name()
        );
        return Err(CliError::Input(fault));
    }
    Inputs::of_run(&args.run).keep_folder(&args.out)?;
    create_folder(&args.out)?;
    let progress = session.progress("render", images.len() as u64);
    let mut written = Vec::new();
    for (done, image) in images.iter().enumerate() {
        let Some(seen) = model.render(image) else { continue };
        let path = |part: &str| args.out.join(format!("{}{part}.png", measure::file_name(&image.name)));
        write_png(&path(""), &measure::picture(&seen, &model))?;
        written.push(json!({"image": path(""), "name": image.name}));
        if let Some(normals) = parts.as_ref().and_then(|_| model.normals(image)) {
            write_png(&path("_normal"), &measure::normal_picture(&normals))?;
        }
        for (name, shown) in parts.iter().flatten() {
            if let Some(seen) = model.render_as(&**shown, image) {
                write_png(&path(&format!("_{name}")), &measure::picture(&seen, &model))?;
            }
        }
        progress.set(done as u64 + 1);
    }
    let text = format!("{} views in {}", written.len(), args.out.display());
    Ok(Outcome::new(text, json!({"views": written})))
}

/// Renders an object under other lights as a PNG file.
///
/// # Errors
/// When the run cannot be used or relit, a light or the view is invalid, or the file cannot be written.
pub(crate) fn relight(args: &RelightArgs) -> Result<Outcome, CliError> {
    must_end_in("--out", &args.out, &["png"])?;
    Inputs::of_run(&args.run).keep(&args.out)?;
    Inputs::of_files(&args.surroundings).keep(&args.out)?;
    let model = model::load(&args.run)?;
    let folder = args.run.display();
    if model.file.kind.lit().is_none() {
        return Err(CliError::Input(format!(
            "{folder}: this model knows only the light it was photographed in; a capture with a light for every image makes one that does not"
        )));
    }
    let points = args.light.iter().map(|&position| Ok(point(&model, position)));
    let lights: Result<Vec<Light>, CliError> = points.chain(args.toward.iter().map(|&t| parallel(t))).collect();
    let colour = [1.0; 3];
    let mut lights: Vec<Lamp> = lights?.into_iter().map(|light| Lamp { light, colour }).collect();
    if let Some(path) = &args.surroundings {
        let image = surroundings::read(path)?;
        lights.extend(surroundings::lamps(&image, args.samples as usize));
    }
    if lights.is_empty() {
        let text = "relight: an object takes --light X,Y,Z, --toward X,Y,Z or --surroundings FILE that is not black";
        return Err(CliError::Input(text.into()));
    }
    let fault = |reason: &str| CliError::Input(format!("--view {}: {reason}", args.view));
    let images = &model.file.images;
    let image = match args.view.as_str() {
        "nadir" => images.first(),
        name => images.iter().find(|image| image.name.trim_start_matches("./") == name),
    };
    let some = images.first().map_or("none", |image| image.name.as_str());
    let image = image.ok_or_else(|| fault(&format!("{folder} has no image of that name; one is {some}")))?;
    let seen = model.relit(image, &lights);
    let seen = seen.ok_or_else(|| fault("the object lies behind that camera"))?;
    // Lights add up in linear values, even if the images of the capture are display values.
    write_png(&args.out, &measure::picture_of(&seen, true))?;
    let (out, count) = (args.out.display(), lights.len());
    let text = format!("{out}: {count} light(s), as {} saw it", image.name);
    let json = json!({"image": args.out, "lights": lights.len(), "view": image.name});
    Ok(Outcome::new(text, json))
}

/// Writes the splats, the mesh or the model of a run for other programs.
///
/// # Errors
/// When the run or an option cannot be used, or a file cannot be written.
pub(crate) fn export(args: &ExportArgs, session: &Session) -> Result<Outcome, CliError> {
    CliError::refuse(
        "export",
        &[
            (args.splats.is_some(), "splats"),
            (args.tiles.is_some(), "tiles"),
            (args.sun.is_some(), "sun"),
            (args.time.is_some(), "time"),
        ],
        "for runs on satellite scenes; leave it out for one on an object",
    )?;
    let format = match &args.mesh {
        Some(Some(path)) => Some((path, mesh_format(path)?)),
        Some(None) => {
            return Err(CliError::Input(
                "export --mesh: an object's needs the name of a file".into(),
            ));
        }
        None => None,
    };
    if let Some(path) = &args.ply {
        must_end_in("--ply", path, &["ply"])?;
    }
    let inputs = Inputs::of_run(&args.run);
    for path in args.ply.iter().chain(format.map(|(path, _)| path)) {
        inputs.keep(path)?;
    }
    if let Some(folder) = &args.asset {
        inputs.keep_folder(folder)?;
    }
    let model = model::load(&args.run)?;
    let fault = |reason| CliError::Input(format!("{}: {reason}", args.run.display()));
    let mut written = Vec::new();
    if let Some(path) = &args.ply {
        let light = match (args.light, args.toward) {
            (Some(position), _) => Some(point(&model, position)),
            (None, Some(toward)) => Some(parallel(toward)?),
            (None, None) => None,
        };
        let splats = export::baked(&model, light).map_err(fault)?;
        export::write_splats(&splats, path)?;
        written.push(path.clone());
    }
    if let Some(folder) = &args.asset {
        create_folder(folder)?;
        model::save_model(folder, &model)?;
        written.push(folder.clone());
    }
    if let Some((path, format)) = format {
        let progress = session.progress("mesh", 2 * model.file.images.len() as u64);
        let cells = args.cells.unwrap_or(MESH_CELLS) as usize;
        let mesh = mesh::mesh(&model, cells, &|done| progress.set(done)).map_err(fault)?;
        let bytes = mesh::encode(&mesh, format).map_err(|error| CliError::Input(error.to_string()))?;
        write_atomically(path, &bytes)?;
        written.push(path.clone());
    }
    let names: Vec<String> = written.iter().map(|path| path.display().to_string()).collect();
    let text = format!("{} Gaussians in {}", model.parameters.gaussians.count, names.join(", "));
    let json = json!({"written": written, "gaussians": model.parameters.gaussians.count});
    Ok(Outcome::new(text, json))
}

/// Default number of cells along the longest side of a mesh's grid.
const MESH_CELLS: u32 = 192;

fn mesh_format(path: &Path) -> Result<mesh::Format, CliError> {
    let fault = || format!("--mesh {}: a name that ends in .ply or .glb says how", path.display());
    mesh::Format::of(path).ok_or_else(|| CliError::Input(fault()))
}

fn point(model: &model::ObjectModel, position: [f64; 3]) -> Light {
    Light::Point((DVec3::from(position) - model.file.centre).as_vec3())
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
pub(crate) fn evaluate(folder: &Path) -> Result<Outcome, CliError> {
    let (model, run) = (model::load(folder)?, run::load_run(folder)?);
    let capture = open(&run.capture, None)?;
    let metrics = measure::metrics(&model, &capture, None)?;
    Ok(Outcome::new(measure::summary(&metrics), metrics))
}

/// Describes a capture: images, values, background, lights, extent, and the expected kind of model.
///
/// # Errors
/// When the capture cannot be read.
pub(crate) fn inspect(path: &Path) -> Result<Outcome, CliError> {
    let capture = open(path, None)?;
    let (background, why) = views::background(&capture, Background::Auto);
    let (kind, kind_why) = plan::outlook(&capture);
    let lights = capture.frames.iter().filter(|f| f.light.is_some()).count();
    let size = capture.frames.first().map_or([0; 2], |f| f.camera.size_px);
    let (train, test) = (capture.of(Split::Train).count(), capture.of(Split::Test).count());
    let encoding = capture.frames.first().map(|f| f.picture.encoding);
    let coverage = capture.has_coverage();
    let values = match encoding {
        Some(Encoding::Linear) => "linear (EXR)",
        _ => "display (PNG, JPEG)",
    };
    let text = format!(
        "a capture of an object\nmodel          {kind:?}: {kind_why}\nimages         {train} to train with, {test} held out, {} x {} pixels\nvalues         {}, {}\nbackground     {background:?}: {why}\nlights         {lights} images have a point light\ncentre         {:.4}, half size {:.4}, a pixel there is {:.5} wide",
        size[0],
        size[1],
        values,
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
    Ok(Outcome::new(text, json))
}
