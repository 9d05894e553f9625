//! The translation of the whole scene, which images cannot tell from errors of their cameras, and the choice among all corrections
//! that differ by one.

use crate::frame::LocalFrame;
use crate::rpc::Rpc;
use crate::triangulate::geo_slope;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// Pixels per metre east, north and up of each image at one ground point: what a translation of the scene does to it.
pub fn pixels_per_metre(rpc: &Rpc, frame: &LocalFrame, enu_m: Vector3<f64>) -> Matrix2x3<f64> {
    let (_, by_geo) = rpc.project_with_jacobian(frame.geo_from_enu(enu_m));
    by_geo * geo_slope(frame, enu_m)
}

/// Of all sets of shifts (columns, rows) that differ by a translation of the scene, the smallest; and that translation, metres.
///
/// `slopes` are the images' [`pixels_per_metre`]: shifts `s_i` and `s_i - slopes_i t` fit all ties alike for any `t`.
pub fn smallest_shifts(shifts: &[Vector2<f64>], slopes: &[Matrix2x3<f64>]) -> (Vec<Vector2<f64>>, Vector3<f64>) {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (shift, slope) in shifts.iter().zip(slopes) {
        normal += slope.transpose() * slope;
        right += slope.transpose() * shift;
    }
    // Views from one direction leave one component open; a trace of damping sets it to zero.
    normal += Matrix3::identity() * (1e-12 * normal.trace()).max(f64::MIN_POSITIVE);
    let translation_m = normal
        .cholesky()
        .map_or_else(Vector3::zeros, |factor| factor.solve(&right));
    let smallest = shifts
        .iter()
        .zip(slopes)
        .map(|(shift, slope)| shift - slope * translation_m);
    (smallest.collect(), translation_m)
}
