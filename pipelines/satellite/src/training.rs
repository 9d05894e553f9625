//! Training of a satellite scene to a finished run, stage by stage:
//!
//! read (the caller's [`Scene`]) → decide ([`Decisions`]) → start ([`preprocess`](crate::preprocess), `initial`) →
//! fit ([`FitRequest`]) → save ([`run_file`]) → products (`dsm.tif`) → evaluate ([`measure`]).
//! The caller writes the page of the run, since it has the pictures.

use crate::config::SatelliteConfig;
use crate::error::SatelliteError;
use crate::fit::{FitRequest, Fitted};
use crate::ground::MARGIN_M;
use crate::measure;
use crate::plan::Decisions;
use crate::run_file::{self, RunFile};
use heliosplat::splat::ProjectionOptions;
use heliosplat::timeline::{self, stage};
use heliosplat_evaluate::{Protocol, error_map};
use heliosplat_fitting::budget::steps_of_products;
use heliosplat_fitting::checkpoint::digest;
use heliosplat_fitting::program::{build, identity_of_training};
use heliosplat_fitting::request::{TrainOutcome, TrainRequest, TrainedRun};
use heliosplat_fitting::run_folder::{FolderState, Input};
use heliosplat_fitting::training::Ending;
use heliosplat_products::change::ChangeMap;
use heliosplat_products::dsm::{self, Dsm};
use heliosplat_products::model::{LoadedModel, ModelChanges, ModelFile, SCHEMA};
use heliosplat_products::nadir::NadirGrid;
use heliosplat_radiometry::linear;
use heliosplat_raster::{Crs, RasterError, preview};
use heliosplat_scene::{AltitudeSource, Hashes, IngestOptions, KeptCut, Scene, SceneError, Values};
use heliosplat_session::Session;
use rayon::prelude::*;
use std::fmt::Write;
use std::path::Path;

/// Name of the model, in `model.json`.
const MODEL: &str = "shadow_gs";

/// Trains a model of `scene` and writes its run: model, configuration, DSM, and errors where there is truth. `ingest`
/// is the request that the scene was read with; the run stores it.
///
/// # Errors
/// When a limit is exceeded, a file of the scene is invalid, the user stops the training, or a file cannot be written.
pub fn train(
    scene: &Scene,
    ingest: &IngestOptions,
    config: &SatelliteConfig,
    request: &TrainRequest,
    session: &Session,
) -> Result<TrainOutcome<LoadedModel>, SatelliteError> {
    // The surface model needs a map; a missing PROJ database would otherwise fail only after training.
    Crs::utm(scene.frame.origin)?;
    request.device.does_not_know(MODEL)?;
    let part = stage("decide");
    let decisions = Decisions::of(scene, config);
    let config = decisions.resolved(config);
    let cut = identified(scene, &request.out)?;
    let inputs = inputs_of(scene, &cut);
    let identity = identity(scene, &config, &decisions, request, &inputs)?;
    let steps_after = steps_of_products(scene.images.len()) + linear::finish_steps(scene.training().count());
    let folder = match FolderState::look(request, &identity, steps_after)? {
        FolderState::Finished(metrics) => return Ok(TrainOutcome::FinishedBefore { metrics }),
        FolderState::Ready(folder) => *folder,
    };
    drop(part);
    let _whole = session.whole("train", &parts(config.train.iterations));
    let fit = FitRequest {
        scene,
        config: &config,
        decisions: &decisions,
        budget: folder.budget,
        memory: request.memory,
        session,
    };
    let (closing, mut fitted) = folder.closing.after(fit.run(folder.checkpoints, folder.checkpoint))?;
    let ending = fitted.trained.ending.clone();
    if ending == Ending::Interrupted {
        ending.check(&request.out)?;
    }
    let _progress = session.progress("products", 1);
    let part = stage("save");
    let file = model_file(scene, &fitted);
    let run = RunFile {
        version: env!("CARGO_PKG_VERSION").into(),
        build: build().into(),
        preset: request.preset.name().into(),
        seed: config.train.seed,
        scene: std::fs::canonicalize(&scene.source).unwrap_or_else(|_| scene.source.clone()),
        altitude_range_m: ingest.altitude_range_m,
        altitude_from_ties_m: (scene.altitude_known_from == AltitudeSource::Ties).then_some(scene.altitude_range_m),
        area: ingest.area.clone(),
        plan: fitted.decisions.items.clone(),
        inputs,
        config: fitted.decisions.resolved(&config),
    };
    run_file::save(&request.out, &run, &cut, &file, &fitted.trained.parameters.gaussians)?;
    let whole = LoadedModel {
        folder: request.out.clone(),
        model: fitted.model.clone(),
        parameters: std::mem::take(&mut fitted.trained.parameters),
        file,
        frame: scene.frame,
    };
    drop(part);
    let part = stage("products");
    let nadir = NadirGrid::new(&(&whole).into(), whole.file.gsd_m, None)?;
    let model = whole.on_last();
    let start = measure::write_start(&request.out, &fitted, &model)?;
    let surface = dsm::of_model(&nadir, &model)?;
    let changes = ChangeMap::of(&whole, &nadir, &surface);
    write_surfaces(&request.out, &surface, changes.as_ref(), model.file.gsd_m)?;
    drop(part);
    let part = stage("evaluate");
    let (start, metrics) = timeline::concurrently(
        || measure::start_metrics(scene, &request.out, &start, model.file.gsd_m),
        || measure::metrics(scene, &whole, &request.out, Protocol::Raw),
    );
    let (start, mut metrics) = (start?, metrics?);
    if !start.is_null() {
        metrics["start"] = start;
    }
    drop(part);
    metrics["surface"] = serde_json::to_value(surface.facts(model.file.gsd_m)).unwrap_or_default();
    measure::add_fit(&mut metrics, &fitted, &model, folder.begun.elapsed().as_secs_f64());
    let lock = closing.finish(&mut metrics, &ending)?;
    Ok(TrainOutcome::Trained(Box::new(TrainedRun {
        model,
        metrics,
        ending,
        lock,
    })))
}

/// Parts of a training of `steps` steps, with their expected times in steps (docs/lab/presets.md: of 37 s of `fast`
/// with 40 steps, 21 are spent before the first step, 8 in training).
fn parts(steps: usize) -> [(&'static str, f64); 4] {
    [
        ("cameras", 30.0),
        ("sweep", 60.0),
        ("train", 15.0 + steps as f64),
        ("products", 40.0),
    ]
}

/// Writes the surface model and the changes, each with its picture; in parallel, since packing a file uses one core.
fn write_surfaces(out: &Path, surface: &Dsm, changes: Option<&ChangeMap>, gsd_m: f64) -> Result<(), RasterError> {
    let changed = |write: &dyn Fn(&ChangeMap) -> Result<(), RasterError>| changes.map_or(Ok(()), write);
    let files: [&(dyn Fn() -> Result<(), RasterError> + Sync); 4] = [
        &|| surface.write(&out.join("dsm.tif")),
        &|| preview::write_png(&out.join("dsm.png"), &preview::hillshade(&surface.altitude(), gsd_m)),
        &|| changed(&|changes| changes.write(&out.join("change.tif"), &surface.grid)),
        &|| changed(&|changes| preview::write_png(&out.join("change.png"), &error_map::draw(&changes.difference()))),
    ];
    files.par_iter().try_for_each(|write| write())
}

/// Images with hashes of their files or of the pixels read; `cut` contains the identities of the files.
fn inputs_of(scene: &Scene, cut: &KeptCut) -> Vec<Input> {
    let mut inputs = Vec::new();
    for image in &scene.images {
        for kept in cut.images.iter().filter(|kept| kept.name == image.name) {
            inputs.extend(kept.pixels_sha256.iter().map(|sha256| Input {
                path: image.path.clone(),
                sha256: sha256.clone(),
            }));
            inputs.extend(kept.files.iter().map(|file| Input {
                path: file.path.clone(),
                sha256: file.sha256.clone(),
            }));
        }
    }
    inputs
}

/// Cut of a scene with the identities of its files; identities of an earlier run in `out` are reused.
fn identified(scene: &Scene, out: &Path) -> Result<KeptCut, SceneError> {
    let mut hashes = Hashes::default();
    if let Ok(before) = run_file::cut_of(out) {
        hashes.learn(before.images.into_iter().flat_map(|image| image.files));
    }
    let mut cut = scene.cut.clone();
    cut.identify(&scene.images, &mut hashes)?;
    Ok(cut)
}

/// Identity of a training, in lines: equal lines are the same training, wherever the files are.
fn identity(
    scene: &Scene,
    config: &SatelliteConfig,
    decisions: &Decisions,
    request: &TrainRequest,
    inputs: &[Input],
) -> Result<String, SatelliteError> {
    let settings = toml::to_string(config)
        .map_err(|error| SatelliteError::Unwritable(format!("the configuration cannot be written: {error}")))?;
    let mut text = identity_of_training(request, config.train.seed, &settings);
    // Writing to a String cannot fail.
    let _ = writeln!(text, "matching {:?}", decisions.matching);
    let _ = writeln!(text, "area {:?}\naltitudes {:?}", scene.area, scene.altitude_range_m);
    for input in inputs {
        let name = input.path.file_name().unwrap_or_default().to_string_lossy();
        let _ = writeln!(text, "image {name} {}", input.sha256);
    }
    for image in &scene.images {
        let (name, sun, bands, values) = (&image.name, &image.sun, &image.bands, &image.values);
        let camera = format!("{:?} {:?} {sun:?} {bands:?}", image.split, image.pinhole.map);
        let _ = writeln!(text, "camera, sun and bands of {name} {}", digest(&camera));
        if !values.is_unknown() {
            let _ = writeln!(text, "values of {name} {values:?}");
        }
    }
    Ok(text)
}

/// Values of the reference image, whose colour is the model's.
fn reference_values(scene: &Scene, fitted: &Fitted) -> Values {
    let name = fitted.images.get(fitted.model.options.reference);
    let image = scene.images.iter().find(|image| Some(&image.name) == name);
    image.map_or_else(Values::default, |image| image.values.clone())
}

fn model_file(scene: &Scene, fitted: &Fitted) -> ModelFile {
    let changes = &fitted.found.changes;
    ModelFile {
        schema: SCHEMA,
        model: MODEL.into(),
        gaussians_sha256: None,
        options: fitted.model.options.clone(),
        globals: fitted.trained.parameters.globals.clone(),
        origin: scene.origin(),
        altitude_range_m: scene.altitude_range_m,
        area: scene.area,
        gsd_m: scene.gsd_m,
        counts_per_unit: scene.counts_per_unit,
        projection: ProjectionOptions::default(),
        bands: scene.bands().to_vec(),
        values: reference_values(scene, fitted),
        daylight: fitted.daylight.clone(),
        images: run_file::model_images(scene, fitted, MARGIN_M),
        changes: (!changes.days.is_empty()).then(|| ModelChanges {
            days: changes.days.clone(),
            segments: changes.segments.clone(),
        }),
    }
}
