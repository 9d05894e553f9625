//! An object training from a capture to a finished run, stage by stage: read ([`open`]) → plan, start and fit ([`fit`])
//! → save ([`run`]) → evaluate ([`measure`]).

use crate::capture::{Capture, Frame, IMAGE_BYTES};
use crate::config::ObjectConfigs;
use crate::error::ObjectError;
use crate::fit::{self, Fitted};
use crate::measure;
use crate::model::ObjectModel;
use crate::plan::Plan;
use crate::run::{self, ObjectRun};
use heliosplat::timeline::stage;
use heliosplat_fitting::budget::steps_of_products;
use heliosplat_fitting::checkpoint::digest;
use heliosplat_fitting::program::{build, identity_of_training};
use heliosplat_fitting::request::{TrainOutcome, TrainRequest, TrainedRun};
use heliosplat_fitting::run_folder::{
    FolderState, Input, RunError, create_folder, hash, peak_rss_bytes, resident_bytes,
};
use heliosplat_fitting::training::Ending;
use heliosplat_session::Session;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;

/// Bytes that a Gaussian takes in training: its parameters, their gradients, Adam's two memories, and its splat.
const BYTES_PER_GAUSSIAN: f64 = 4.0 * 4.0 * 72.0 + 500.0;

/// Fewest Gaussians for which memory must suffice.
const LEAST_GAUSSIANS: usize = 1000;

/// A trained model and its `run.toml`.
pub struct TrainedObject {
    /// The trained model.
    pub model: ObjectModel,
    /// Content of `run.toml`.
    pub run: ObjectRun,
}

/// Opens a capture and logs its warnings.
///
/// # Errors
/// When the capture is invalid, or its images take more than half of `memory` bytes.
pub fn open(path: &Path, memory: Option<u64>) -> Result<Capture, ObjectError> {
    let capture = Capture::open(path, memory.map_or(IMAGE_BYTES, |bytes| bytes / 2))?;
    for warning in &capture.warnings {
        tracing::warn!("{warning}");
    }
    Ok(capture)
}

/// Trains a model of the capture at `path` and writes its run into the folder of the request. A request that resumes or
/// updates gets the metrics of this very training, if the folder holds it finished.
///
/// # Errors
/// When the capture or the configuration is invalid, a limit is exceeded, the user stops the training, or a file cannot
/// be written.
pub fn train(
    path: &Path,
    mut configs: ObjectConfigs,
    request: &TrainRequest,
    session: &Session,
) -> Result<TrainOutcome<TrainedObject>, ObjectError> {
    let out = request.out.as_path();
    let part = stage("read");
    let capture = open(path, request.memory)?;
    drop(part);
    let part = stage("decide");
    let mut most = capture.surface_px();
    if let Some(limit) = request.memory {
        let resident = resident_bytes() as f64;
        let room = ((limit as f64 - resident) / BYTES_PER_GAUSSIAN).max(0.0) as usize;
        if room < LEAST_GAUSSIANS {
            let least = LEAST_GAUSSIANS as f64 * BYTES_PER_GAUSSIAN + resident;
            return Err(ObjectError::Memory(format!(
                "--memory: the images leave no room for {LEAST_GAUSSIANS} Gaussians; give {:.2}GiB or more",
                least / f64::from(1 << 30) + 0.01
            )));
        }
        most = most.min(room);
    }
    configs.limit(most);
    let inputs = hashes(&capture)?;
    let identity = identity(request, &configs, &capture, &inputs)?;
    let folder = match FolderState::<Plan>::look(request, &identity, steps_of_products(capture.frames.len()))? {
        FolderState::Finished(metrics) => return Ok(TrainOutcome::FinishedBefore { metrics }),
        FolderState::Ready(folder) => *folder,
    };
    drop(part);
    let steps = configs.lamps.train.iterations as f64;
    let parts = [("plan", 0.4 * steps), ("train", steps), ("products", 0.1 * steps)];
    let _whole = session.whole("train", &parts);
    let fitted = fit::fit(
        &capture,
        &configs,
        session,
        folder.budget,
        &request.device,
        folder.checkpoints,
        folder.checkpoint,
    );
    let (closing, fitted) = folder.closing.after(fitted)?;
    if fitted.ending == Ending::Interrupted {
        fitted.ending.check(out)?;
    }
    let _progress = session.progress("products", 1);
    let part = stage("save");
    let run = ObjectRun {
        version: env!("CARGO_PKG_VERSION").into(),
        build: build().into(),
        preset: request.preset.name().into(),
        seed: configs.lamps.train.seed,
        capture: std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()),
        inputs,
        config: configs.of(fitted.plan.kind).clone(),
        plan: Some(fitted.plan.clone()),
    };
    run::save(out, &run, &fitted.model)?;
    drop(part);
    let part = stage("evaluate");
    let pictures = out.join("views");
    create_folder(&pictures)?;
    let mut metrics = measure::metrics(&fitted.model, &capture, Some(&pictures))?;
    drop(part);
    add_fit(&mut metrics, &fitted, folder.begun.elapsed().as_secs_f64());
    let lock = closing.finish(&mut metrics, &fitted.ending)?;
    Ok(TrainOutcome::Trained(Box::new(TrainedRun {
        model: TrainedObject {
            model: fitted.model,
            run,
        },
        metrics,
        ending: fitted.ending,
        lock,
    })))
}

/// Identity of a training, line by line: code, inputs and settings.
fn identity(
    request: &TrainRequest,
    configs: &ObjectConfigs,
    capture: &Capture,
    inputs: &[Input],
) -> Result<String, ObjectError> {
    let text_of = |config| toml::to_string(config).map_err(|error| ObjectError::Settings(error.to_string()));
    let (constant, lamps) = (text_of(&configs.constant)?, text_of(&configs.lamps)?);
    let mut text = identity_of_training(request, configs.lamps.train.seed, &(constant + &lamps));
    for (frame, input) in capture.frames.iter().zip(inputs) {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "image {} {}", frame.name, input.sha256);
        let camera = format!("{:?} {:?} {:?}", frame.split, frame.camera, frame.light);
        let _ = writeln!(text, "camera and light of {} {}", frame.name, digest(&camera));
    }
    Ok(text)
}

fn hashes(capture: &Capture) -> Result<Vec<Input>, RunError> {
    let input = |frame: &Frame| {
        let (path, sha256) = (frame.path.clone(), hash(&frame.path)?);
        Ok(Input { path, sha256 })
    };
    capture.frames.par_iter().map(input).collect()
}

fn add_fit(metrics: &mut Value, fitted: &Fitted, seconds: f64) {
    metrics["seconds"] = json!(seconds);
    metrics["device"] = json!(fitted.device);
    metrics["camera_turns"] = json!(fitted.turns);
    metrics["plan"] = json!(fitted.plan);
    metrics["stage_seconds"] = json!({"start": fitted.seconds[0], "train": fitted.seconds[1]});
    metrics["iterations"] = json!(fitted.iterations);
    metrics["rejected_steps"] = json!(fitted.rejected);
    metrics["start"] = json!({"gaussians": fitted.started, "how": fitted.start});
    metrics["peak_rss_bytes"] = json!(peak_rss_bytes());
    metrics["curve"] = json!(fitted.curve);
}
