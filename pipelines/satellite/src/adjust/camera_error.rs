//! Corrections compared with the true camera biases of a synthetic scene.

use heliosplat_rpc::adjust::{pixels_per_metre, smallest_shifts};
use heliosplat_scene::{Scene, SceneImage};
use nalgebra::{Vector2, Vector3};

/// Error of the cameras except for a common translation of the scene, which images do not determine.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CameraError {
    /// Root mean square of the images' errors as delivered, pixels.
    pub before_rms_px: f64,
    /// Root mean square of the images' errors with the corrections, pixels.
    pub after_rms_px: f64,
    /// Largest error of an image with the corrections, pixels.
    pub after_max_px: f64,
    /// Error of each image with the corrections, columns and rows, pixels.
    pub images_px: Vec<[f64; 2]>,
}

/// Error of `shifts_px` (columns, rows; pixels) against the true camera biases of the scene; `None` where these are
/// unknown.
pub fn camera_error(scene: &Scene, images: &[&SceneImage], shifts_px: &[[f64; 2]]) -> Option<CameraError> {
    let known = scene.true_camera_biases_px()?;
    let biases: Option<Vec<Vector2<f64>>> = images
        .iter()
        .map(|image| known.get(&image.name).copied().map(Vector2::from))
        .collect();
    let biases = biases?;
    let slopes: Vec<_> = images
        .iter()
        .map(|image| pixels_per_metre(&image.rpc, &scene.frame, Vector3::zeros()))
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
