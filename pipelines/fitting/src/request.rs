//! Request and outcome of a training of any model.

use crate::lock::Lock;
use crate::settings::Preset;
use crate::training::Ending;
use heliosplat::model::SceneModel;
use heliosplat::train::device::{CPU, Device, DeviceSource};
use heliosplat::train::{TrainError, TrainOptions};
use serde_json::Value;
use std::path::PathBuf;
use std::sync::Arc;
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

/// The device that a training is asked for.
#[derive(Debug, Clone, Default)]
pub enum TrainDevice {
    /// The processor.
    #[default]
    Cpu,
    /// Another device.
    Other {
        /// The device.
        source: Arc<dyn DeviceSource>,
        /// True if models that it does not know are trained on the processor.
        or_cpu: bool,
    },
}

impl TrainDevice {
    /// Name, for the identity of a training.
    pub fn name(&self) -> &str {
        match self {
            Self::Cpu => CPU,
            Self::Other { source, .. } => source.name(),
        }
    }

    /// The device, ready to train `model`; `None` is the processor.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device fails, or does not know the model and must.
    pub fn open(&self, model: &dyn SceneModel, options: &TrainOptions) -> Result<Option<Box<dyn Device>>, TrainError> {
        let Self::Other { source, .. } = self else {
            return Ok(None);
        };
        let device = source.open(model, options)?;
        match device {
            Some(_) => tracing::info!("Training on {}", source.name()),
            None => self.does_not_know(model.name())?,
        }
        Ok(device)
    }

    /// Says that the processor trains `model`, which the device does not know.
    ///
    /// # Errors
    /// [`TrainError::Device`] when it must be the device.
    pub fn does_not_know(&self, model: &str) -> Result<(), TrainError> {
        match self {
            Self::Cpu => {}
            Self::Other { source, or_cpu: true } => {
                tracing::info!("{} does not know the model {model}: training on the CPU", source.name());
            }
            Self::Other { source, .. } => {
                let reason = format!("{} does not know the model {model}", source.name());
                return Err(TrainError::Device(reason));
            }
        }
        Ok(())
    }
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
    /// The device to train on.
    pub device: TrainDevice,
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
            device: TrainDevice::Cpu,
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
