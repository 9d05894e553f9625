//! Request and outcome of a training of any model.

use crate::lock::Lock;
use crate::settings::Preset;
use crate::training::Ending;
use serde_json::Value;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Default time between two checkpoints.
pub const CHECKPOINT_EVERY: Duration = Duration::from_secs(60);

/// Treatment of an earlier training in the folder of a run. `Keep`, `Resume` and `Update` continue the same training
/// where it was interrupted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Earlier {
    /// A finished run, and a checkpoint of another training, are refused.
    Keep,
    /// A finished run of the same training is kept; another training is refused.
    Resume,
    /// A finished run of the same training is kept; a finished run of another training is replaced.
    Update,
    /// Any earlier training is replaced.
    Overwrite,
}

/// Request of a training, besides its images and its configuration.
#[derive(Debug, Clone)]
pub struct TrainRequest {
    /// Folder of the run, made where it is absent.
    pub out: PathBuf,
    /// Preset from which the configuration started.
    pub preset: Preset,
    /// Start of the program, from which the time budget counts.
    pub begun: Instant,
    /// The time limit of the run, products included.
    pub time_budget: Option<Duration>,
    /// The memory that the process may take, bytes.
    pub memory: Option<u64>,
    /// Treatment of a training that the folder already contains.
    pub earlier: Earlier,
    /// Time between two checkpoints.
    pub checkpoint_every: Duration,
}

impl TrainRequest {
    /// A training into `out` without limits; its time counts from now.
    pub fn new(out: PathBuf, preset: Preset) -> Self {
        Self {
            out,
            preset,
            begun: Instant::now(),
            time_budget: None,
            memory: None,
            earlier: Earlier::Keep,
            checkpoint_every: CHECKPOINT_EVERY,
        }
    }
}

/// The outcome of a training; `M` is the model.
pub enum TrainOutcome<M> {
    /// The folder contains this very training, finished earlier.
    FinishedBefore {
        /// Content of its `metrics.json`.
        metrics: Value,
    },
    /// The model was trained now, written and measured.
    Trained(Box<TrainedRun<M>>),
}

/// A run that was trained now.
pub struct TrainedRun<M> {
    /// The trained model.
    pub model: M,
    /// Content of its `metrics.json`.
    pub metrics: Value,
    /// End of the training: a run whose training failed is written too.
    pub ending: Ending,
    /// Lock of the folder, held until the report's pages are written.
    pub lock: Lock,
}
