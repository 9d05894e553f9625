//! The verb `train`: what it was told, what that takes, and the run that comes of it.

use super::budget::Budget;
use super::config::SatelliteConfig;
use super::estimate::{self, Estimate, estimate};
use super::fit::{self, Ending, Fitted, Limits};
use super::ground::MARGIN_M;
use super::measure;
use super::plan::{plan, with_plan};
use crate::cli::satellite::{Preset, TrainArgs};
use crate::cli::{CliError, Outcome, Session};
use crate::evaluate::Protocol;
use crate::product::dsm;
use crate::raster::{is_virtual, preview};
use crate::report;
use crate::run::checkpoint::{self, Keeper};
use crate::run::{self, Input, LoadedModel, ModelFile, RunFile};
use crate::scene::{IngestOptions, Scene, SceneImage};
use heliosplat::splat::ProjectionOptions;
use std::fmt::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// Time between two checkpoints, unless said otherwise.
pub const CHECKPOINT_EVERY: Duration = Duration::from_secs(60);

/// What a training was told besides its scene and its configuration.
pub struct Told {
    preset: &'static str,
    ingest: IngestOptions,
    begun: Instant,
    time_budget: Option<Duration>,
    memory: Option<u64>,
    resume: bool,
    checkpoint_every: Duration,
}

impl Told {
    /// Nothing but a preset; time counts from `begun`.
    pub fn new(preset: &'static str, begun: Instant) -> Self {
        Self {
            preset,
            ingest: IngestOptions::default(),
            begun,
            time_budget: None,
            memory: None,
            resume: false,
            checkpoint_every: CHECKPOINT_EVERY,
        }
    }
}

/// Fits a scene and writes the run, with its DSM and, where there is truth, its errors.
///
/// # Errors
/// When the scene is at fault, training finds no good state, or a file cannot be written.
pub fn train_into(
    scene: &Scene,
    out: &Path,
    config: &SatelliteConfig,
    told: &Told,
    session: &Session,
) -> Result<(LoadedModel, serde_json::Value, Ending), CliError> {
    let plan = plan(scene, config);
    let config = with_plan(scene, config);
    let inputs = inputs(scene)?;
    let identity = identity(scene, &config, told, &inputs)?;
    let kept = match told.resume {
        true => checkpoint::read(out, &identity)?,
        false => None,
    };
    // A training that was interrupted began earlier by the time that it had taken.
    let before = kept.as_ref().map_or(0.0, |kept| kept.course.elapsed_s);
    let before = Duration::try_from_secs_f64(before).unwrap_or_default();
    let begun = told.begun.checked_sub(before).unwrap_or(told.begun);
    let limits = Limits {
        budget: told
            .time_budget
            .map(|limit| Budget::new(begun, limit, scene.images.len())),
        memory: told.memory,
    };
    // Made first: better to hear now than after the training that nothing can be written there.
    let new = !out.exists();
    create_folder(out)?;
    let keeper = Keeper::new(out, &identity, told.checkpoint_every, begun);
    let mut fitted = fit::fit(scene, &config, session, &limits, keeper, kept).inspect_err(|_| {
        if new {
            // Only removes it while it is empty; that it stays is no further fault.
            let _ = std::fs::remove_dir(out);
        }
    })?;
    if fitted.ending == Ending::Interrupted {
        return Err(interrupted(out));
    }
    let file = model_file(scene, &fitted);
    let run_file = RunFile {
        version: env!("CARGO_PKG_VERSION").into(),
        preset: told.preset.into(),
        seed: config.train.seed,
        scene: std::fs::canonicalize(&scene.source).unwrap_or_else(|_| scene.source.clone()),
        altitude_range_m: told.ingest.altitude_range_m,
        area: told.ingest.area.clone(),
        plan,
        inputs,
        config,
    };
    run::save(out, &run_file, &file, &fitted.parameters.gaussians)?;
    let parameters = std::mem::take(&mut fitted.parameters);
    let frame = scene.frame;
    let model = LoadedModel {
        folder: out.to_owned(),
        model: fitted.model.clone(),
        parameters,
        file,
        frame,
    };
    let surface = dsm::dsm(&model, model.file.gsd_m, None)?;
    surface.write(&out.join("dsm.tif"))?;
    preview::write_png(
        &out.join("dsm.png"),
        &preview::hillshade(&surface.altitude(), model.file.gsd_m),
    )?;
    let start = measure::write_start(scene, out, &fitted, &model)?;
    let mut metrics = measure::metrics(scene, &model, out, Protocol::Raw)?;
    if !start.is_null() {
        metrics["start"] = start;
    }
    measure::add_fit(&mut metrics, &fitted, &model, begun.elapsed().as_secs_f64());
    if fitted.ending == Ending::Done {
        metrics["training"] = checkpoint::digest(&identity).into();
    }
    run::save_metrics(out, &metrics)?;
    report::write(out)?;
    checkpoint::remove(out);
    Ok((model, metrics, fitted.ending))
}

/// The images, hashed.
fn inputs(scene: &Scene) -> Result<Vec<Input>, CliError> {
    let input = |image: &SceneImage| {
        Ok(Input {
            path: image.path.clone(),
            sha256: match is_virtual(&image.path) {
                // Not to be fetched once more: what was read of it stands for it.
                true => run::hash_of_pixels(&image.pixels),
                false => run::hash(&image.path)?,
            },
        })
    };
    scene.images.iter().map(input).collect()
}

/// All that decides a training, line by line: two of the same lines are the same training, wherever their files lie.
fn identity(scene: &Scene, config: &SatelliteConfig, told: &Told, inputs: &[Input]) -> Result<String, CliError> {
    let mut text = checkpoint::identity_of_program();
    let seed = config.train.seed;
    let config = toml::to_string(config).map_err(|error| CliError::Failed(error.to_string()))?;
    let Told {
        time_budget, memory, ..
    } = told;
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "--time-budget {time_budget:?}\n--memory {memory:?}\nseed = {seed}\n{config}"
    );
    let _ = writeln!(text, "area {:?}\naltitudes {:?}", scene.area, scene.altitude_range_m);
    for (image, input) in scene.images.iter().zip(inputs) {
        let SceneImage {
            name,
            split,
            pinhole,
            sun,
            bands,
            ..
        } = image;
        let _ = writeln!(text, "image {name} {}", input.sha256);
        let camera = format!("{split:?} {:?} {sun:?} {bands:?}", pinhole.map);
        let _ = writeln!(text, "camera, sun and bands of {name} {}", checkpoint::digest(&camera));
    }
    Ok(text)
}

/// The run in `out`, if it was finished by this very training.
fn done_before(
    scene: &Scene,
    out: &Path,
    config: &SatelliteConfig,
    told: &Told,
) -> Result<Option<serde_json::Value>, CliError> {
    let Ok(text) = std::fs::read_to_string(out.join("metrics.json")) else {
        return Ok(None);
    };
    let metrics: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let identity = identity(scene, &with_plan(scene, config), told, &inputs(scene)?)?;
    Ok((metrics["training"] == checkpoint::digest(&identity)).then_some(metrics))
}

pub(crate) fn interrupted(out: &Path) -> CliError {
    let out = out.display();
    CliError::Interrupted(format!(
        "stopped; the training is kept in {out}/checkpoint, the same command with --resume goes on"
    ))
}

pub(crate) fn create_folder(out: &Path) -> Result<(), CliError> {
    std::fs::create_dir_all(out).map_err(|error| {
        CliError::Failed(format!(
            "{}: the folder cannot be made ({error}); choose another --out",
            out.display()
        ))
    })
}

fn model_file(scene: &Scene, fitted: &Fitted) -> ModelFile {
    ModelFile {
        schema: run::SCHEMA,
        model: "shadow_gs".into(),
        options: fitted.model.options.clone(),
        globals: fitted.parameters.globals.clone(),
        origin: scene.origin(),
        altitude_range_m: scene.altitude_range_m,
        area: scene.area,
        gsd_m: scene.gsd_m,
        counts_per_unit: scene.counts_per_unit,
        projection: ProjectionOptions::default(),
        bands: scene.bands().to_vec(),
        images: run::model_images(scene, fitted, MARGIN_M),
    }
}

/// What to tell of a training that ended before its time; its run is written.
pub(crate) fn finished(ending: Ending, out: &Path) -> Result<(), CliError> {
    match ending {
        Ending::Done => Ok(()),
        Ending::Interrupted => Err(interrupted(out)),
        Ending::GaveUp(error) => Err(CliError::Failed(format!(
            "training stopped: {error}, in {}",
            out.display()
        ))),
    }
}

/// Presets, the most accurate first.
const PRESETS: [Preset; 3] = [Preset::Accurate, Preset::Balanced, Preset::Fast];

/// The configuration that was asked for; where only a time was, that of the most accurate preset that fits into it.
fn configure(args: &TrainArgs, scene: &Scene) -> Result<(Preset, SatelliteConfig, Estimate), CliError> {
    let slowness = estimate::slowness();
    let resolve = |preset: Preset| -> Result<_, CliError> {
        let config = SatelliteConfig::resolve(preset.name(), &args.set, args.seed)?;
        let estimate = estimate(scene, &config, slowness);
        Ok((preset, config, estimate))
    };
    let Some(limit) = args.time_budget else {
        return resolve(args.preset.unwrap_or_default());
    };
    let limit_s = limit.as_secs_f64();
    let mut chosen = resolve(args.preset.unwrap_or(Preset::Fast))?;
    if args.preset.is_none() {
        for preset in PRESETS {
            let (_, config, estimate) = resolve(preset)?;
            if estimate.seconds <= limit_s {
                chosen = (preset, config, estimate);
                break;
            }
        }
    }
    if chosen.2.start_s > limit_s {
        return Err(CliError::Input(format!(
            "--time-budget {limit:?}: before the first step this scene takes about {:.0} s on this machine; give {:.0}s or more, or a coarser model with --set start.cell_gsd=2",
            chosen.2.start_s,
            2.0 * chosen.2.start_s
        )));
    }
    Ok(chosen)
}

/// Trains a model.
///
/// # Errors
/// When the scene, the configuration or a limit is at fault, training gives up, or a file cannot be written.
pub fn train(args: &TrainArgs, session: &Session) -> Result<Outcome, CliError> {
    let begun = Instant::now();
    let options = args.ingest.options();
    let scene = Scene::open(&args.scene, &options)?;
    for warning in &scene.warnings {
        tracing::warn!("{warning}");
    }
    let (preset, config, estimate) = configure(args, &scene)?;
    tracing::info!(
        preset = preset.name(),
        gib = estimate.peak_bytes / f64::from(1 << 30),
        seconds = estimate.seconds,
        "estimate"
    );
    // Before its surface is known, a scene is refused only where it would not even fit if it were flat.
    estimate::must_fit(estimate.least_bytes, args.memory, &config)?;
    let told = Told {
        preset: preset.name(),
        ingest: options,
        begun,
        time_budget: args.time_budget,
        memory: args.memory,
        resume: args.resume,
        checkpoint_every: args.checkpoint_every,
    };
    let done = match args.resume {
        true => done_before(&scene, &args.out, &config, &told)?,
        false => None,
    };
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
    let (_, metrics, ending) = train_into(&scene, &args.out, &config, &told, session)?;
    finished(ending, &args.out)?;
    let text = format!("{}\nrun            {}", measure::summary(&metrics), args.out.display());
    Ok(Outcome { json: metrics, text })
}
