//! The curve of a training: its losses and the accuracy of the model, step by step.

use std::collections::BTreeMap;

/// The losses of one step.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CurvePoint {
    /// Number of the step.
    pub step: usize,
    /// Mean absolute difference to the images, exponentially smoothed over the steps.
    pub l1: f64,
    /// Losses of the step by name, without their weights.
    pub losses: BTreeMap<String, f64>,
    /// Mean absolute difference to the images on held-out tiles; `None` without such tiles.
    pub held_out_l1: Option<f64>,
    /// Accuracy of the model at that step, where it was measured.
    pub accuracy: Option<Accuracy>,
}

/// Accuracy of a model during training.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Accuracy {
    /// Mean absolute height error against truth, protocol `raw`, metres; `None` without truth.
    pub height_mae_m: Option<f64>,
    /// Mean PSNR of some held-out images, decibels; `None` where it is not measured.
    pub psnr_db: Option<f64>,
}
