//! Gauge of the adjustment: the translation of the whole scene, which images do not determine, and the choice among
//! corrections that differ by one.

use crate::frame::LocalFrame;
use crate::rpc::Rpc;
use crate::triangulate::geo_slope;
use heliosplat_grid::statistics::upper_median;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// Derivative of the image position by the ground point at `enu_m`, pixels per metre east, north and up: the effect of
/// a translation of the scene.
pub fn pixels_per_metre(rpc: &Rpc, frame: &LocalFrame, enu_m: Vector3<f64>) -> Matrix2x3<f64> {
    let (_, by_geo) = rpc.project_with_jacobian(frame.geo_from_enu(enu_m));
    by_geo * geo_slope(frame, enu_m)
}

/// Length of a shift, in median lengths, above which it does not enter the translation of the scene: such a camera has
/// an error of its own.
const FAR_OFF_MEDIANS: f64 = 4.0;
/// Median below which no shift counts as an outlier, pixels: the usual spread of one vendor's cameras.
const LEAST_MEDIAN_PX: f64 = 0.5;

/// The smallest of all sets of shifts (columns, rows; pixels) that differ by a translation of the scene, and that
/// translation (east, north, up; metres).
///
/// `slopes` are the images' [`pixels_per_metre`]: shifts `s_i` and `s_i - slopes_i t` fit all ties alike for any `t`.
/// The smallest have the least sum of squares over all images without outliers (`FAR_OFF_MEDIANS`), so that one wrong
/// camera does not move the scene.
pub fn smallest_shifts(shifts: &[Vector2<f64>], slopes: &[Matrix2x3<f64>]) -> (Vec<Vector2<f64>>, Vector3<f64>) {
    let moved =
        |t: Vector3<f64>| -> Vec<Vector2<f64>> { shifts.iter().zip(slopes).map(|(s, slope)| s - slope * t).collect() };
    let mut kept = vec![true; shifts.len()];
    loop {
        let translation_m = translation(shifts, slopes, &kept);
        let smallest = moved(translation_m);
        let mut lengths: Vec<f64> = smallest.iter().map(Vector2::norm).collect();
        let limit_px = FAR_OFF_MEDIANS * upper_median(&mut lengths).unwrap_or(0.0).max(LEAST_MEDIAN_PX);
        let mut fewer = false;
        for (kept, shift) in kept.iter_mut().zip(&smallest) {
            let far_off = shift.norm() > limit_px;
            fewer |= far_off && *kept;
            *kept &= !far_off;
        }
        // Each round leaves out at least one more, and never as much as half: the median is among those that stay.
        if !fewer {
            return (smallest, translation_m);
        }
    }
}

/// The translation of the scene, metres, that reduces the `kept` shifts most.
fn translation(shifts: &[Vector2<f64>], slopes: &[Matrix2x3<f64>], kept: &[bool]) -> Vector3<f64> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let all = shifts.iter().zip(slopes).zip(kept);
    for ((shift, slope), _) in all.filter(|(_, kept)| **kept) {
        normal += slope.transpose() * slope;
        right += slope.transpose() * shift;
    }
    // Views from one direction leave one component open; a trace of damping sets it to zero.
    normal += Matrix3::identity() * (1e-12 * normal.trace()).max(f64::MIN_POSITIVE);
    normal
        .cholesky()
        .map_or_else(Vector3::zeros, |factor| factor.solve(&right))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixels of half a metre, seen from two metres up per `lean` metres aside.
    fn slope(east: f64, north: f64) -> Matrix2x3<f64> {
        Matrix2x3::new(2.0, 0.0, 2.0 * east, 0.0, -2.0, -2.0 * north)
    }

    fn slopes() -> Vec<Matrix2x3<f64>> {
        (0..9)
            .map(|i| slope(0.1 * f64::from(i) - 0.4, 0.3 - 0.05 * f64::from(i * i % 7)))
            .collect()
    }

    #[test]
    fn one_wrong_camera_does_not_move_the_scene() {
        let slopes = slopes();
        let small = |i: usize| Vector2::new(0.3 * (i as f64).sin(), 0.3 * (1.7 * i as f64).cos());
        let mut shifts: Vec<_> = (0..9).map(small).collect();
        let (_, without) = smallest_shifts(&shifts[1..], &slopes[1..]);
        shifts[0].y -= 36.0;
        let (smallest, with) = smallest_shifts(&shifts, &slopes);
        assert!((with - without).norm() < 1e-9, "{with} {without}");
        assert!((smallest[0].y + 36.0).abs() < 1.0);
    }

    #[test]
    fn a_translation_of_the_scene_is_taken_out_whole() {
        let slopes = slopes();
        let t = Vector3::new(3.0, -8.0, 2.0);
        let shifts: Vec<_> = slopes.iter().map(|slope| slope * t).collect();
        let (smallest, found) = smallest_shifts(&shifts, &slopes);
        assert!((found - t).norm() < 1e-6);
        assert!(smallest.iter().all(|shift| shift.norm() < 1e-6));
    }
}
