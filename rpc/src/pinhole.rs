//! The local projective (pinhole) camera fitted to an RPC over one image window and altitude range.

use crate::{LocalFrame, Rpc, RpcError};
use nalgebra::Vector3;

/// A window of an image, pixels; `col0`, `row0` is its upper-left pixel in the RPC's image coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageWindow {
    /// First column.
    pub col0: f64,
    /// First row.
    pub row0: f64,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// `col = (u[0..3]·p + u[3]) / (1 + w·p)`, `row` likewise with `v`; `p` in ENU metres from the frame's origin.
/// Columns and rows count from the window's own upper-left pixel centre.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ProjectiveMap {
    /// Column numerator: three per-metre coefficients and a constant.
    pub u: [f64; 4],
    /// Row numerator.
    pub v: [f64; 4],
    /// Denominator, per metre.
    pub w: [f64; 3],
}

impl ProjectiveMap {
    /// (col, row) of an ENU point.
    pub fn project(&self, enu_m: Vector3<f64>) -> [f64; 2] {
        let dot = |c: &[f64]| c[0] * enu_m.x + c[1] * enu_m.y + c[2] * enu_m.z;
        let denominator = 1.0 + dot(&self.w);
        [
            (dot(&self.u) + self.u[3]) / denominator,
            (dot(&self.v) + self.v[3]) / denominator,
        ]
    }
}

/// A fitted map and how far it is from the RPC it stands for.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PinholeFit {
    /// The camera.
    pub map: ProjectiveMap,
    /// Root mean square residual over the check grid, pixels.
    pub rms_px: f64,
    /// Largest residual over the check grid, pixels.
    pub max_px: f64,
}

impl PinholeFit {
    /// Fits the map to `rpc` over `window` and `altitude_range_m` (ellipsoidal), in `frame`.
    ///
    /// # Errors
    /// When the RPC cannot be localised over the window.
    pub fn fit(
        _rpc: &Rpc,
        _frame: &LocalFrame,
        _window: ImageWindow,
        _altitude_range_m: (f64, f64),
    ) -> Result<Self, RpcError> {
        unimplemented!()
    }
}
