//! An object training from a capture to a finished run, stage by stage: read ([`open`]) → plan, start and fit ([`fit`]) →
//! save ([`run`]) → evaluate ([`measure`]).

use crate::capture::{Capture, IMAGE_BYTES};
use crate::config::ObjectConfig;
use crate::error::ObjectError;
use crate::fit::{self, Fitted};
use crate::measure;
use crate::model::ObjectModel;
use crate::run::{self, ObjectRun};
use heliosplat_fitting::checkpoint::{digest, identity_of_program};
use heliosplat_fitting::run_folder::{
    Input, Opened, RunError, RunFolder, RunRequest, create_folder, hash, peak_rss_bytes, resident_bytes,
};
use heliosplat_fitting::settings::Preset;
use heliosplat_fitting::training::Ending;
use heliosplat_session::Session;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Bytes that a Gaussian takes in training: its parameters, their gradients, Adam's two memories, and its splat.
const BYTES_PER_GAUSSIAN: f64 = 4.0 * 4.0 * 59.0 + 500.0;

/// What a training is asked for, besides its configuration.
#[derive(Debug, Clone)]
pub struct TrainRequest {
    /// The capture.
    pub capture: PathBuf,
    /// Folder of the run, made where it is absent.
    pub out: PathBuf,
    /// Preset that the configuration started from.
    pub preset: Preset,
    /// When the program began: the time budget counts from here.
    pub begun: Instant,
    /// The time that the run may take.
    pub time_budget: Option<Duration>,
    /// The memory that the process may take, bytes.
    pub memory: Option<u64>,
    /// Whether a checkpoint in the folder is taken up, and a finished run left as it is.
    pub resume: bool,
    /// Time between two checkpoints.
    pub checkpoint_every: Duration,
}

/// The outcome of a training.
pub enum TrainOutcome {
    /// The folder holds this very training, finished before.
    FinishedBefore {
        /// Its `metrics.json`.
        metrics: Value,
    },
    /// It was trained now; the model is written and measured.
    Trained(Box<TrainedRun>),
}

/// A run that was trained now.
pub struct TrainedRun {
    /// The model.
    pub model: ObjectModel,
    /// Its `run.toml`.
    pub run: ObjectRun,
    /// Its `metrics.json`.
    pub metrics: Value,
    /// How training ended: a run whose training gave up is written all the same.
    pub ending: Ending,
}

/// Opens a capture; says what looks wrong.
///
/// # Errors
/// When the capture is at fault, or its images take more than half of `memory` bytes.
pub fn open(path: &Path, memory: Option<u64>) -> Result<Capture, ObjectError> {
    let capture = Capture::open(path, memory.map_or(IMAGE_BYTES, |bytes| bytes / 2))?;
    for warning in &capture.warnings {
        tracing::warn!("{warning}");
    }
    Ok(capture)
}

/// Trains a model of a capture and writes its run.
///
/// # Errors
/// When the capture, the configuration or a limit is at fault, the user stops the training, or a file cannot be written.
pub fn train(mut config: ObjectConfig, request: &TrainRequest, session: &Session) -> Result<TrainOutcome, ObjectError> {
    let out = request.out.as_path();
    let capture = open(&request.capture, request.memory)?;
    if let Some(limit) = request.memory {
        let resident = resident_bytes() as f64;
        let left = limit as f64 - resident;
        let most = (left / BYTES_PER_GAUSSIAN).max(0.0) as usize;
        if most < config.start.gaussians {
            let least = config.start.gaussians as f64 * BYTES_PER_GAUSSIAN + resident;
            return Err(ObjectError::Memory {
                gaussians: config.start.gaussians,
                needed_gib: least / f64::from(1 << 30) + 0.01,
                most,
            });
        }
        config.train.density.cap = config.train.density.cap.min(most);
    }
    let inputs = hashes(&capture)?;
    let identity = identity(request, &config, &capture, &inputs)?;
    let folder = match Opened::<()>::look(RunRequest {
        out,
        identity: &identity,
        resume: request.resume,
        checkpoint_every: request.checkpoint_every,
        begun: request.begun,
        time_budget: request.time_budget,
        images: capture.frames.len(),
    })? {
        Opened::Finished(metrics) => return Ok(TrainOutcome::FinishedBefore { metrics }),
        Opened::Open(folder) => *folder,
    };
    let RunFolder {
        begun,
        budget,
        checkpoints,
        checkpoint,
        closing,
    } = folder;
    let fitted = fit::fit(&capture, &config, session, budget, checkpoints, checkpoint);
    let fitted = fitted.inspect_err(|_| closing.discard())?;
    if fitted.ending == Ending::Interrupted {
        fitted.ending.check(out)?;
    }
    let run = ObjectRun {
        version: env!("CARGO_PKG_VERSION").into(),
        preset: request.preset.name().into(),
        seed: config.train.seed,
        capture: std::fs::canonicalize(&request.capture).unwrap_or_else(|_| request.capture.clone()),
        inputs,
        config,
        plan: Some(fitted.plan.clone()),
    };
    // What was measured of an earlier run here is not true of this one.
    let _ = std::fs::remove_file(out.join("metrics.json"));
    run::save(out, &run, &fitted.model)?;
    let pictures = out.join("views");
    create_folder(&pictures)?;
    let mut metrics = measure::metrics(&fitted.model, &capture, Some(&pictures))?;
    add_fit(&mut metrics, &fitted, begun.elapsed().as_secs_f64());
    closing.finish(&mut metrics, &fitted.ending)?;
    Ok(TrainOutcome::Trained(Box::new(TrainedRun {
        model: fitted.model,
        run,
        metrics,
        ending: fitted.ending,
    })))
}

/// All that decides a training, line by line.
fn identity(
    request: &TrainRequest,
    config: &ObjectConfig,
    capture: &Capture,
    inputs: &[Input],
) -> Result<String, ObjectError> {
    let mut text = identity_of_program();
    let seed = config.train.seed;
    let config = toml::to_string(config).map_err(|error| ObjectError::Settings(error.to_string()))?;
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "--time-budget {:?}\n--memory {:?}\nseed = {seed}\n{config}",
        request.time_budget, request.memory
    );
    for (frame, input) in capture.frames.iter().zip(inputs) {
        let _ = writeln!(text, "image {} {}", frame.name, input.sha256);
        let camera = format!("{:?} {:?} {:?}", frame.split, frame.camera, frame.light);
        let _ = writeln!(text, "camera and light of {} {}", frame.name, digest(&camera));
    }
    Ok(text)
}

fn hashes(capture: &Capture) -> Result<Vec<Input>, RunError> {
    let inputs = capture.frames.par_iter().map(|frame| {
        Ok(Input {
            path: frame.path.clone(),
            sha256: hash(&frame.path)?,
        })
    });
    inputs.collect()
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
