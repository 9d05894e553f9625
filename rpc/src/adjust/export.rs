//! A correction merged into the camera itself, for programs without support for corrections.

use super::correction::Correction;
use crate::fit::fit_rpc;
use crate::rpc::{ImagePoint, Rpc, RpcError};

/// Samples along each of columns and rows, and along heights, for a refitted camera.
const GRID: (usize, usize) = (13, 9);
/// Validity of a refitted camera beyond its image, as a share of the image's size.
const MARGIN: f64 = 0.1;

/// A camera that contains a correction.
#[derive(Debug, Clone, PartialEq)]
pub struct CorrectedRpc {
    /// The camera.
    pub rpc: Rpc,
    /// Largest distance to the projection of the original camera with its correction, pixels; 0 for a shift.
    pub max_px: f64,
}

/// The camera that projects as `rpc` with `correction` added; the image has `width` by `height` pixels.
///
/// A shift goes into `LINE_OFF` and `SAMP_OFF` and is exact everywhere. A rational camera of two denominators cannot
/// contain rotation and drift: a new one is fitted over the image with a margin of a tenth and over the ellipsoidal
/// heights `heights_m` (lowest, highest), and is valid there only.
///
/// # Errors
/// For a correction that is no shift: the errors of `Rpc::localise` over the image, and of `fit_rpc`.
pub fn corrected_rpc(
    rpc: &Rpc,
    correction: &Correction,
    (width, height): (usize, usize),
    heights_m: (f64, f64),
) -> Result<CorrectedRpc, RpcError> {
    if correction.is_translation() {
        let [col, row] = correction.shift_px;
        return Ok(CorrectedRpc {
            rpc: rpc.cropped(-col, -row),
            max_px: 0.0,
        });
    }
    let along = |size: usize, step: usize| {
        let share = step as f64 / (GRID.0 - 1) as f64 * (1.0 + 2.0 * MARGIN) - MARGIN;
        share * (size as f64 - 1.0)
    };
    let mut samples = Vec::with_capacity(GRID.0 * GRID.0 * GRID.1);
    for level in 0..GRID.1 {
        let share = level as f64 / (GRID.1 - 1) as f64;
        let height_m = heights_m.0 + share * (heights_m.1 - heights_m.0);
        for row in 0..GRID.0 {
            for col in 0..GRID.0 {
                let at = ImagePoint::new(along(width, col), along(height, row));
                samples.push((rpc.localise(at, height_m)?, correction.apply(at)));
            }
        }
    }
    let fit = fit_rpc(&samples)?;
    Ok(CorrectedRpc {
        rpc: Rpc {
            error_bias_m: rpc.error_bias_m,
            error_random_m: rpc.error_random_m,
            ..fit.rpc
        },
        max_px: fit.max_px,
    })
}
