//! The seam between the trainer and the place where its numbers live.
//!
//! The trainer owns the schedule, the order of views, the control of density, held-out pixels and checkpoints. A
//! [`Device`] computes a step: render, compare, go back, update. The CPU works on the trainer's own [`Tables`]; another
//! device may keep its own copy and bring it back when it is asked to.

use super::cached_visibility::CachedVisibility;
use super::fault::{Fault, TrainError};
use super::options::TrainOptions;
use crate::camera::ProjectiveCamera;
use crate::loss::smoothness::Neighbours;
use crate::model::{NamedLoss, Parameters, SceneModel, View};
use crate::optim::{Adam, DensityStatistics};
use glam::DVec3;

/// Name of the device that every build has.
pub const CPU: &str = "cpu";

/// All numbers of a training that a step changes.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Tables {
    /// The trained parameters.
    pub parameters: Parameters,
    /// Moments of the Gaussians' parameters.
    pub gaussians_adam: Adam,
    /// Moments of the shared parameters.
    pub globals_adam: Adam,
    /// Gradients in the images, for the control of density.
    pub statistics: DensityStatistics,
    /// By view.
    pub(super) cached_visibility: Vec<Option<CachedVisibility>>,
    /// Neighbours of the Gaussians when their number last changed; the current positions do not determine them.
    pub(super) neighbours: Option<Neighbours>,
}

impl Tables {
    /// The tables before the first step on `views` views.
    pub fn new(parameters: Parameters, views: usize) -> Self {
        Self {
            gaussians_adam: Adam::new(&parameters.gaussians),
            globals_adam: Adam::new(&parameters.globals),
            statistics: DensityStatistics::new(parameters.gaussians.count),
            cached_visibility: vec![None; views],
            neighbours: None,
            parameters,
        }
    }
}

/// Learning rates and bounds of one update.
#[derive(Debug, Clone, PartialEq)]
pub struct Rates {
    /// By group of the Gaussians' table; a group of rate zero does not change.
    pub gaussians: Vec<f32>,
    /// By group of the shared parameters.
    pub globals: Vec<f32>,
    /// Decay of Adam's first moment per step.
    pub beta1: f32,
    /// Weights of the prior of each Gaussian: of the sum of its standard deviations, per metre, and of its opacity.
    pub prior: (f32, f32),
    /// Least and largest log scale after the update.
    pub log_scale: (f32, f32),
    /// Least and largest opacity logit after the update.
    pub opacity: (f32, f32),
}

/// One step to compute.
#[derive(Clone, Copy)]
pub struct Step<'s> {
    /// The model in training.
    pub model: &'s dyn SceneModel,
    /// Options of the training.
    pub options: &'s TrainOptions,
    /// Number of steps done before.
    pub done: usize,
    /// Index of the view.
    pub index: usize,
    /// The view, or its image of half size.
    pub view: &'s View,
    /// True if the view has its full size.
    pub full_size: bool,
    /// Camera of the view at full size.
    pub camera: &'s ProjectiveCamera,
    /// Camera at the zenith, for shadow consistency.
    pub nadir: Option<&'s ProjectiveCamera>,
    /// True if the step finds a rotation of the camera, see [`Descent::turn`].
    pub turns: bool,
    /// Held-out pixels of the view at full size.
    pub held: &'s [u32],
    /// Rates of the update.
    pub rates: &'s Rates,
}

/// Result of a step.
#[derive(Debug, Clone, Default)]
pub struct Descent {
    /// Named loss values, unweighted.
    pub losses: Vec<NamedLoss>,
    /// Mean absolute difference to the image over the pixels trained on.
    pub l1: f64,
    /// Mean absolute difference on the held-out pixels; `None` without any.
    pub held_out: Option<f64>,
    /// Number of (splat, pixel) pairs of the forward pass.
    pub pairs: u64,
    /// Rotation of the view's camera that its image asks for, axis times angle, radians; `None` where it asks for none.
    pub turn: Option<DVec3>,
    /// Fault that rejected the step, which then changed no parameter.
    pub rejected: Option<Fault>,
}

/// A place where steps are computed.
pub trait Device: Send {
    /// Name, as in `metrics.json` and in the identity of a run.
    fn name(&self) -> &str;

    /// Takes over `tables`, which something else than a step has changed.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device has no room for them, or fails.
    fn put(&mut self, _tables: &Tables) -> Result<(), TrainError> {
        Ok(())
    }

    /// Computes one step. A device that keeps its own copy leaves `tables` as they are.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device has too little room, or fails.
    fn step(&mut self, step: &Step, tables: &mut Tables) -> Result<Descent, TrainError>;

    /// Brings `tables` to the state after the latest step.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device fails.
    fn fetch(&mut self, _tables: &mut Tables) -> Result<(), TrainError> {
        Ok(())
    }
}

/// A device of the machine that can train models.
pub trait DeviceSource: std::fmt::Debug + Send + Sync {
    /// Name of the device, see [`Device::name`].
    fn name(&self) -> &str;

    /// The device, ready to train `model`; `None` if it does not know this kind of model or these options.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device fails.
    fn open(&self, model: &dyn SceneModel, options: &TrainOptions) -> Result<Option<Box<dyn Device>>, TrainError>;
}
