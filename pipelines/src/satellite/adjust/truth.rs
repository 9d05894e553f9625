//! Corrections against the biases that a synthetic scene was made with.

use crate::scene::SceneImage;
use heliosplat_rpc::LocalFrame;
use heliosplat_rpc::adjust::{pixels_per_metre, smallest_shifts};
use nalgebra::{Vector2, Vector3};
use std::path::Path;

/// How far cameras are off, a common translation of the scene apart, which no image shows.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CameraError {
    /// Root mean square of the images' errors as delivered, pixels.
    pub before_rms_px: f64,
    /// With the corrections.
    pub after_rms_px: f64,
    /// The largest of the images' errors with the corrections.
    pub after_max_px: f64,
    /// Each image's error with the corrections, columns and rows, pixels.
    pub images_px: Vec<[f64; 2]>,
}

/// What is read of the summary beside a synthetic scene: the file format is all that ties this to the program that wrote it.
#[derive(serde::Deserialize)]
struct Summary {
    images: Vec<ImageBias>,
}

/// One image of the summary.
#[derive(serde::Deserialize)]
struct ImageBias {
    name: String,
    /// RPC bias: constant error (column, row) put into the RPC, pixels.
    pointing_bias_px: [f64; 2],
}

/// The error of `shifts_px` (columns, rows) against the truth in the scene's folder, if there is one.
pub fn camera_error(
    folder: &Path,
    images: &[&SceneImage],
    frame: &LocalFrame,
    shifts_px: &[[f64; 2]],
) -> Option<CameraError> {
    let text = crate::trust::read_text(&folder.join("truth/summary.json")).ok()?;
    let summary: Summary = serde_json::from_str(&text).ok()?;
    let biases: Option<Vec<Vector2<f64>>> = images
        .iter()
        .map(|image| {
            let made = summary.images.iter().find(|made| made.name == image.name)?;
            Some(Vector2::from(made.pointing_bias_px))
        })
        .collect();
    let biases = biases?;
    let slopes: Vec<_> = images
        .iter()
        .map(|image| pixels_per_metre(&image.rpc, frame, Vector3::zeros()))
        .collect();
    let corrected: Vec<Vector2<f64>> = biases
        .iter()
        .zip(shifts_px)
        .map(|(b, s)| b + Vector2::from(*s))
        .collect();
    let rms = |errors: &[Vector2<f64>]| {
        (errors.iter().map(Vector2::norm_squared).sum::<f64>() / errors.len().max(1) as f64).sqrt()
    };
    let (before, _) = smallest_shifts(&biases, &slopes);
    let (after, _) = smallest_shifts(&corrected, &slopes);
    Some(CameraError {
        before_rms_px: rms(&before),
        after_rms_px: rms(&after),
        after_max_px: after.iter().map(Vector2::norm).fold(0.0, f64::max),
        images_px: after.iter().map(|error| [error.x, error.y]).collect(),
    })
}
