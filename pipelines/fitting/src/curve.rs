//! The curve of a training: its losses and the accuracy of the model, step by step.

use std::collections::BTreeMap;

/// The losses of one step.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CurvePoint {
    /// The step.
    pub step: usize,
    /// Mean absolute difference to the images, smoothed.
    pub l1: f64,
    /// Named losses, unweighted.
    pub losses: BTreeMap<String, f64>,
    /// Mean absolute difference on tiles that are not learnt from.
    pub held_out_l1: Option<f64>,
    /// Accuracy of the model at that step, where it was measured.
    pub accuracy: Option<Accuracy>,
}

/// Accuracy of a model during training.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Accuracy {
    /// Mean height error against truth, protocol `raw`, metres.
    pub height_mae_m: Option<f64>,
    /// PSNR of some images held out, decibels.
    pub psnr_db: Option<f64>,
}
