//! One sighting, linearised: its residual, and its derivatives by ground point and correction.

use nalgebra::{Matrix2x3, SMatrix, Vector2};

/// Prior weight of points that the sightings do not determine, square pixels per square metre.
pub(super) const POINT_HOLD: f64 = 1e-8;

/// One sighting's residual at the current estimate, and its derivatives.
#[derive(Debug, Clone)]
pub(super) struct Linear {
    /// Index of the image.
    pub(super) image: usize,
    /// Weight of the sighting before robust reweighting.
    pub(super) weight: f64,
    /// Seen minus corrected projection, pixels.
    pub(super) residual: Vector2<f64>,
    /// Pixels per metre east, north, up.
    pub(super) slope: Matrix2x3<f64>,
    /// Column and row from the image's centre, in half sides.
    pub(super) from_centre: [f64; 2],
}

/// Places of a correction's parameters after the shifts: axis and direction of [`super::Correction::slope_px`]. Those
/// along the rows are first, so that a drift has the first four parameters.
pub(super) const SLOPES: [[usize; 2]; 4] = [[0, 1], [1, 1], [0, 0], [1, 0]];

/// Derivative of the image position by a correction's parameters at `u`, `v`, half sides from the centre.
pub(super) fn basis<const K: usize>([u, v]: [f64; 2]) -> SMatrix<f64, 2, K> {
    let all = SMatrix::<f64, 2, 6>::new(1.0, 0.0, v, 0.0, u, 0.0, 0.0, 1.0, 0.0, v, 0.0, u);
    all.fixed_columns::<K>(0).into_owned()
}
