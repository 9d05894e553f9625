//! Camera adjustment: one small correction per image, so that all images agree on where the ground is.
//!
//! Vendors' cameras point wrong by up to some ten pixels, nearly the same all over a crop. The correction of an image is
//! therefore a function of the image position alone, added to what its RPC projects ([`BiasModel`]; J. Grodecki, G. Dial, *Block
//! adjustment of high-resolution satellite images described by rational polynomials*, PE&RS 69(1), 2003). Corrections and the ground
//! points of all tracks are found together by Gauss-Newton on pixel residuals; points are eliminated (Schur complement), so that
//! the system has a few unknowns per image. Sightings count the less the farther off they are (Geman-McClure, reweighted each
//! round, its scale taken from the residuals' median): what moved with the sun or was matched wrong has no say in the end.
//!
//! **Gauge.** Images cannot tell a common translation of the scene (three unknowns) from its cameras' errors. Of all corrections
//! that fit alike, the smallest are given: [`smallest_shifts`]. With two views that leaves the shift across their epipolar
//! lines. Rotation and drift are held small by a prior of [`SLOPE_SIGMA_PX`]: they may say what the ties show and no more.
//!
//! No pixels and no files: tracks come from whoever matches images.

mod export;
mod normal;
mod problem;
mod residuals;
mod robust;

pub use export::{CorrectedRpc, corrected_rpc};
pub use residuals::{ImageResiduals, PairResiduals, ResidualVector, Spread};

use crate::{GeoPoint, ImagePoint, LocalFrame, Rpc, RpcError};
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};
use problem::Problem;

/// Standard deviation given to shifts beforehand, pixels: weak, it only decides what ties leave open.
pub const SHIFT_SIGMA_PX: f64 = 10.0;
/// Standard deviation given to rotation and drift beforehand, pixels half an image from its centre.
pub const SLOPE_SIGMA_PX: f64 = 0.5;
/// Fewest sightings of an image for it to be corrected.
pub const FEWEST_SIGHTINGS: usize = 6;

/// What the error of an image's camera may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BiasModel {
    /// The same shift all over the image.
    #[default]
    Translation,
    /// A shift, and a change of it that is linear along columns and rows: rotation, scale and drift.
    Affine,
}

/// An image: its camera as delivered, and its size, pixels.
#[derive(Debug, Clone, Copy)]
pub struct AdjustImage<'a> {
    /// The camera.
    pub rpc: &'a Rpc,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// Where an image shows the point of a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Which image.
    pub image: usize,
    /// Where in it, pixels.
    pub at: ImagePoint,
    /// How much it counts beside the others, 0 to 1: matches that look less alike are worse than their number says.
    pub weight: f64,
}

/// One ground point seen in several images.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// About where it is: a few hundred metres off is near enough.
    pub near: GeoPoint,
    /// Where it is seen; each image at most once.
    pub sightings: Vec<Sighting>,
}

/// What is added to a camera's projections.
///
/// With `u` and `v` the column and row from the image's centre in units of half its longer side:
/// `col += shift_px[0] + slope_px[0][0] u + slope_px[0][1] v`, `row` likewise with the second entries.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Correction {
    /// Columns and rows at the image's centre, pixels.
    pub shift_px: [f64; 2],
    /// How the correction of columns (first) and rows (second) changes from the centre to the edge along columns and rows, pixels.
    pub slope_px: [[f64; 2]; 2],
    /// The image's centre, pixels.
    pub centre: ImagePoint,
    /// Half the image's longer side, pixels.
    pub half_side_px: f64,
}

impl Correction {
    /// No correction of an image of this size.
    pub fn none(width: usize, height: usize) -> Self {
        Self {
            shift_px: [0.0; 2],
            slope_px: [[0.0; 2]; 2],
            centre: ImagePoint {
                col: (width as f64 - 1.0) / 2.0,
                row: (height as f64 - 1.0) / 2.0,
            },
            half_side_px: (width.max(height) as f64 / 2.0).max(1.0),
        }
    }

    /// What is added at a projected position: columns and rows, pixels.
    pub fn at(&self, projected: ImagePoint) -> [f64; 2] {
        let [u, v] = self.half_sides_from_centre(projected);
        [0, 1].map(|axis| self.shift_px[axis] + self.slope_px[axis][0] * u + self.slope_px[axis][1] * v)
    }

    /// A projected position, corrected.
    pub fn apply(&self, projected: ImagePoint) -> ImagePoint {
        let [col, row] = self.at(projected);
        ImagePoint {
            col: projected.col + col,
            row: projected.row + row,
        }
    }

    /// Whether it is the same all over the image.
    pub fn is_translation(&self) -> bool {
        self.slope_px == [[0.0; 2]; 2]
    }

    fn half_sides_from_centre(&self, at: ImagePoint) -> [f64; 2] {
        [
            (at.col - self.centre.col) / self.half_side_px,
            (at.row - self.centre.row) / self.half_side_px,
        ]
    }
}

/// How to adjust; the default serves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdjustOptions {
    /// What may be wrong with a camera.
    pub model: BiasModel,
    /// Most rounds of Gauss-Newton.
    pub most_rounds: usize,
}

impl Default for AdjustOptions {
    fn default() -> Self {
        Self {
            model: BiasModel::default(),
            most_rounds: 40,
        }
    }
}

/// The corrections and how well the images agree with them.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjustment {
    /// What was allowed to be wrong.
    pub model: BiasModel,
    /// One per image; none where an image has fewer than [`FEWEST_SIGHTINGS`] sightings.
    pub corrections: Vec<Correction>,
    /// One ground point per track.
    pub points: Vec<GeoPoint>,
    /// Standard deviation of a good sighting in one direction, pixels.
    pub sigma_px: f64,
    /// Rounds it took.
    pub rounds: usize,
    /// What each image's sightings leave.
    pub images: Vec<ImageResiduals>,
    /// What is left across the epipolar lines of pairs of images.
    pub pairs: Vec<PairResiduals>,
    /// What each sighting leaves, in the order of the tracks.
    pub residuals: Vec<ResidualVector>,
}

/// Finds the corrections that make the images agree on the tracks.
///
/// `frame` is any local frame within some tens of kilometres.
///
/// # Errors
/// [`RpcError::Invalid`] when a track names an image that is not there, when there are fewer than [`FEWEST_SIGHTINGS`] tracks of
/// two sightings, or when the cameras give no numbers there.
pub fn adjust(
    images: &[AdjustImage],
    tracks: &[Track],
    frame: &LocalFrame,
    options: AdjustOptions,
) -> Result<Adjustment, RpcError> {
    let problem = Problem::new(images, tracks, frame)?;
    match options.model {
        BiasModel::Translation => problem.adjust::<2>(options),
        BiasModel::Affine => problem.adjust::<6>(options),
    }
}

/// Pixels per metre east, north and up of each image at one ground point: what a translation of the scene does to it.
pub fn pixels_per_metre(rpc: &Rpc, frame: &LocalFrame, enu_m: Vector3<f64>) -> Matrix2x3<f64> {
    let (_, by_geo) = rpc.project_with_jacobian(frame.geo_from_enu(enu_m));
    by_geo * crate::triangulate::geo_slope(frame, enu_m)
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
