//! The training loop: steps, a budget of time, points of a curve, checkpoints, and the end.

use crate::budget::{Budget, Pace};
use crate::checkpoint::{CheckpointError, CheckpointWriter};
use crate::curve::{Accuracy, CurvePoint};
use heliosplat::model::{Parameters, View};
use heliosplat::train::{CameraTurn, EarlyStop, StepReport, TrainError, Trainer};
use heliosplat_session::log::grouped;
use heliosplat_session::{Session, about_left};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Reason why a training failed.
#[derive(Debug, thiserror::Error)]
pub enum TrainingError {
    /// Training failed before there was a usable model.
    #[error("training stopped: {0}")]
    Train(#[from] TrainError),
    /// A checkpoint is at fault, or cannot be written.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The user stopped the training; a checkpoint keeps its state.
    #[error("stopped; the training is kept in {}/checkpoint, the same command continues", .0.display())]
    Interrupted(PathBuf),
    /// Training could not continue; the run has the last good state. Fields: the cause, the folder of the run.
    #[error("training stopped: {}, in {}", .0, .1.display())]
    GaveUp(TrainError, PathBuf),
}

/// Measures a model in training without changing it; `None` where nothing can be measured.
pub type Probe<'a> = dyn Fn(&Parameters) -> Option<Accuracy> + 'a;

/// The step after which the time left is first reported, and the steps between two reports.
const FIRST_REPORT: usize = 20;
const REPORT_EVERY: usize = 100;
/// Steps between two points of the curve.
const CURVE_EVERY: usize = 25;
/// Approximate number of points of the curve with an accuracy.
const PROBES: usize = 12;

/// Reason why a training ended, with a usable model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// Converged, or out of steps or time.
    Done,
    /// The user stopped the training; its state is kept in a checkpoint.
    Interrupted,
    /// Training could not continue; the model is the last good state.
    GaveUp(TrainError),
}

impl Ending {
    /// Reports a training into the folder `out` that was interrupted or gave up.
    ///
    /// # Errors
    /// [`TrainingError::Interrupted`] when the user stopped the training, [`TrainingError::GaveUp`] when it could not
    /// continue.
    pub fn check(&self, out: &Path) -> Result<(), TrainingError> {
        let out = out.to_owned();
        match self {
            Self::Done => Ok(()),
            Self::Interrupted => Err(TrainingError::Interrupted(out)),
            Self::GaveUp(error) => Err(TrainingError::GaveUp(error.clone(), out)),
        }
    }
}

/// The result of a training.
pub struct Trained {
    /// Parameters of the best step.
    pub parameters: Parameters,
    /// Number of steps taken, and the best one.
    pub early_stop: EarlyStop,
    /// Steps rejected because of a number that is not finite.
    pub rejected: usize,
    /// Points of the curve, in the order of the steps.
    pub curve: Vec<CurvePoint>,
    /// The training views; held-out pixels have weight zero.
    pub views: Vec<View>,
    /// Reason why the training ended.
    pub ending: Ending,
    /// Rotations of the training cameras, where they may turn.
    pub turns: Vec<CameraTurn>,
    /// Name of the device that computed the steps.
    pub device: String,
}

/// Trains for `steps` steps, or until the model has converged, the user stops the training, or the time is spent.
/// `probe` measures the model at about twelve points of the curve.
///
/// # Errors
/// [`TrainingError::Train`] when the trainer fails in its first steps, [`TrainingError::Checkpoint`] when the state of
/// an interrupted training cannot be written.
pub fn train<P: Clone + Serialize>(
    mut trainer: Trainer,
    steps: usize,
    session: &Session,
    budget: Option<Budget>,
    mut checkpoints: CheckpointWriter<P>,
    probe: Option<&Probe>,
) -> Result<Trained, TrainingError> {
    session.stop_gently();
    let probe_every = CURVE_EVERY * (steps / CURVE_EVERY / PROBES).max(1);
    let progress = session.progress("train", steps as u64);
    progress.set(trainer.steps() as u64);
    let mut pace = Pace::new(trainer.views());
    let (mut ending, mut steps) = (Ending::Done, steps);
    if budget.is_some_and(|budget| budget.spent() >= 1.0) {
        tracing::warn!("--time-budget was over before the first step: training takes one step; give more time");
    }
    while !trainer.finished() && !session.stopped() {
        let begun = Instant::now();
        let report = match trainer.step() {
            Ok(report) => report,
            Err(error @ TrainError::NotFinite { .. }) if trainer.steps() > trainer.rejected() => {
                ending = Ending::GaveUp(error);
                break;
            }
            Err(error) => return Err(error.into()),
        };
        pace.add(begun.elapsed());
        if let Some(budget) = budget {
            steps = budget.steps(report.step, pace.step_s());
            trainer.set_iterations(steps);
            progress.set_total(steps as u64);
        }
        let log = &mut checkpoints.log;
        let l1 = log.smoothed.map_or(report.l1, |old| 0.95 * old + 0.05 * report.l1);
        log.smoothed = Some(l1);
        progress.set(report.step as u64);
        if report.step % CURVE_EVERY == 0 {
            progress.message(&format!("L1 {l1:.4}, {} Gaussians", grouped(report.gaussians)));
            let probe = probe.filter(|_| report.step % probe_every == 0);
            if probe.is_some() {
                trainer.fetch()?;
            }
            log.curve.push(CurvePoint {
                held_out_l1: trainer.held_out_l1(),
                accuracy: probe.and_then(|probe| probe(trainer.parameters())),
                ..point(&report, l1)
            });
        }
        if report.step < steps && (report.step == FIRST_REPORT || report.step.is_multiple_of(REPORT_EVERY)) {
            let gaussians = grouped(report.gaussians);
            let left_s = pace.step_s() * steps.saturating_sub(report.step) as f64;
            tracing::info!("Step {} of {steps}, {}", report.step, about_left(left_s));
            tracing::debug!("L1 {l1:.4}, {gaussians} Gaussians");
        }
        checkpoints.step_done(&mut trainer);
    }
    if ending == Ending::Done && !trainer.finished() {
        ending = Ending::Interrupted;
        checkpoints.write(&mut trainer)?;
    }
    trainer.fetch()?;
    let (rejected, device, turns) = (trainer.rejected(), trainer.device().to_owned(), trainer.camera_turns());
    let (parameters, early_stop, views) = trainer.into_best_and_views();
    Ok(Trained {
        parameters,
        early_stop,
        rejected,
        views,
        curve: checkpoints.log.curve,
        ending,
        turns,
        device,
    })
}

fn point(report: &StepReport, l1: f64) -> CurvePoint {
    let losses = report.losses.iter().map(|(name, value)| ((*name).to_owned(), *value));
    CurvePoint {
        step: report.step,
        l1,
        losses: losses.collect(),
        held_out_l1: None,
        accuracy: None,
    }
}
