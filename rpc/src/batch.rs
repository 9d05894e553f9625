//! Many points through one camera: the same arithmetic as point by point, eight points side by side.
//!
//! Projection gives the same bits as [`Rpc::project`]. Localisation runs Newton's method from the model's centre, which
//! suffices for nearly every point of a valid model; other points go through the careful method of [`Rpc::localise`].

use crate::polynomial::{gradient_horizontal, monomials, value};
use crate::rpc::wrapped_longitude_deg;
use crate::rpc::{GeoPoint, ImagePoint, Rpc};

/// Points side by side.
const LANES: usize = 8;
/// Steps with the slope of the second; each leaves at most a hundredth of the error of a sound model.
const FROZEN_STEPS: usize = 6;
/// A residual below this needs no further step, pixels.
const TARGET_RESIDUAL_PX: f64 = 5e-10;
/// Largest residual of the fast method; beyond it, the careful method is used.
const ACCEPTED_RESIDUAL_PX: f64 = 2e-9;
/// Range of the fast method around the model's centre, half ranges.
const TRUSTED_RANGE: f64 = 1.5;
/// Half ranges of the ground that one of the image may span; valid models have 1.1.
const TRUSTED_SPAN: f64 = 2.0;

type Lane = [f64; LANES];

/// Eight points in the model's half ranges.
#[derive(Clone, Copy, Default)]
struct PointLanes {
    l: Lane,
    p: Lane,
    h: Lane,
}

/// Normalised rows and columns.
#[derive(Clone, Copy, Default)]
struct Image {
    row: Lane,
    col: Lane,
}

/// Inverse of the derivatives of row and column by longitude and latitude, all normalised.
#[derive(Clone, Copy, Default)]
struct Inverse {
    l_by_row: Lane,
    l_by_col: Lane,
    p_by_row: Lane,
    p_by_col: Lane,
}

/// Half ranges of height over which the start takes its slope.
const START_STEP: f64 = 1e-3;

/// A model linearised at its centre, normalised: start of Newton's method for every point.
struct LinearModel {
    image: Image,
    inverse: Inverse,
    row_by_h: f64,
    col_by_h: f64,
    /// True if the model's scales and its polynomials agree.
    trusted: bool,
}

impl Rpc {
    /// Image positions of `points`, bit by bit the results of [`Self::project`].
    // Into the caller, who may have been compiled for more instructions.
    #[inline]
    pub fn project_all(&self, points: &[GeoPoint]) -> Vec<ImagePoint> {
        let mut out = Vec::with_capacity(points.len());
        for block in points.chunks(LANES) {
            let mut ground = PointLanes::default();
            for (lane, &point) in block.iter().enumerate() {
                let [l, p, h] = self.normalised(point);
                (ground.l[lane], ground.p[lane], ground.h[lane]) = (l, p, h);
            }
            let image = self.look(&ground);
            out.extend((0..block.len()).map(|lane| self.image_point(&image, lane)));
        }
        out
    }

    /// The ground points at `heights_m` (ellipsoidal, one per point) that project to `points`; `None` where
    /// [`Self::localise`] gives an error.
    ///
    /// # Panics
    /// When there is not one height per point.
    pub fn localise_all(&self, points: &[ImagePoint], heights_m: &[f64]) -> Vec<Option<GeoPoint>> {
        assert_eq!(points.len(), heights_m.len(), "one height per point");
        let start = self.start();
        let mut out = Vec::with_capacity(points.len());
        for (points, heights_m) in points.chunks(LANES).zip(heights_m.chunks(LANES)) {
            let (ground, arrived) = self.approach(&start, points, heights_m);
            for (lane, (&point, &height_m)) in points.iter().zip(heights_m).enumerate() {
                let found = GeoPoint {
                    lon_deg: wrapped_longitude_deg(
                        ground.l[lane] * self.longitude_scale_deg + self.longitude_offset_deg,
                    ),
                    lat_deg: ground.p[lane] * self.latitude_scale_deg + self.latitude_offset_deg,
                    height_m,
                };
                let sound = arrived[lane] && found.lon_deg.is_finite() && found.lat_deg.is_finite();
                out.push(if sound {
                    Some(found)
                } else {
                    self.localise(point, height_m).ok()
                });
            }
        }
        out
    }

    /// The model as a plane at its centre.
    fn start(&self) -> LinearModel {
        let (image, inverse) = self.look_closely(&PointLanes::default());
        let level = PointLanes {
            h: [START_STEP; LANES],
            ..PointLanes::default()
        };
        let raised = self.look(&level);
        let of_row = inverse.l_by_row[0].abs() + inverse.p_by_row[0].abs();
        let of_col = inverse.l_by_col[0].abs() + inverse.p_by_col[0].abs();
        LinearModel {
            row_by_h: (raised.row[0] - image.row[0]) / START_STEP,
            col_by_h: (raised.col[0] - image.col[0]) / START_STEP,
            trusted: of_row < TRUSTED_SPAN && of_col < TRUSTED_SPAN,
            image,
            inverse,
        }
    }

    /// Newton's method for up to eight points, and which of them converged.
    fn approach(&self, start: &LinearModel, points: &[ImagePoint], heights_m: &[f64]) -> (PointLanes, [bool; LANES]) {
        let (mut ground, mut target, mut image) = (PointLanes::default(), Image::default(), start.image);
        for (lane, (point, height_m)) in points.iter().zip(heights_m).enumerate() {
            let height = (height_m - self.height_offset_m) / self.height_scale_m;
            ground.h[lane] = height;
            image.row[lane] += start.row_by_h * height;
            image.col[lane] += start.col_by_h * height;
            target.row[lane] = (point.row - self.line_offset) / self.line_scale;
            target.col[lane] = (point.col - self.sample_offset) / self.sample_scale;
        }
        step(&mut ground, &target, &image, &start.inverse);
        let (mut image, inverse) = self.look_closely(&ground);
        let mut arrived = [start.trusted; LANES];
        let mut residual_px = self.residual_px(&target, &image);
        for _ in 0..FROZEN_STEPS {
            if residual_px.iter().all(|&r| r < TARGET_RESIDUAL_PX) {
                break;
            }
            let before = (ground, residual_px);
            step(&mut ground, &target, &image, &inverse);
            image = self.look(&ground);
            residual_px = self.residual_px(&target, &image);
            keep_better(&mut ground, &mut residual_px, &before);
        }
        for lane in 0..LANES {
            let near = (ground.l[lane].abs() < TRUSTED_RANGE) & (ground.p[lane].abs() < TRUSTED_RANGE);
            arrived[lane] &= near & (residual_px[lane] < ACCEPTED_RESIDUAL_PX);
        }
        (ground, arrived)
    }

    /// Image positions of eight points of the ground.
    #[inline(always)]
    fn look(&self, ground: &PointLanes) -> Image {
        let m = eight_monomials(ground);
        let row = eight_values(&self.line_numerator, &m);
        let row_under = eight_values(&self.line_denominator, &m);
        let col = eight_values(&self.sample_numerator, &m);
        let col_under = eight_values(&self.sample_denominator, &m);
        let mut image = Image::default();
        for lane in 0..LANES {
            image.row[lane] = row[lane] / row_under[lane];
            image.col[lane] = col[lane] / col_under[lane];
        }
        image
    }

    /// The image of eight points, with the inverse of its derivatives.
    #[inline]
    fn look_closely(&self, ground: &PointLanes) -> (Image, Inverse) {
        let (mut image, mut inverse) = (Image::default(), Inverse::default());
        for lane in 0..LANES {
            let m = monomials([ground.l[lane], ground.p[lane], ground.h[lane]]);
            let rational = |numerator: &[f64; 20], denominator: &[f64; 20]| {
                let bottom = 1.0 / value(denominator, &m);
                let ratio = value(numerator, &m) * bottom;
                let (top, under) = (gradient_horizontal(numerator, &m), gradient_horizontal(denominator, &m));
                [
                    ratio,
                    (top[0] - ratio * under[0]) * bottom,
                    (top[1] - ratio * under[1]) * bottom,
                ]
            };
            let [row, row_l, row_p] = rational(&self.line_numerator, &self.line_denominator);
            let [col, col_l, col_p] = rational(&self.sample_numerator, &self.sample_denominator);
            (image.row[lane], image.col[lane]) = (row, col);
            let unit = 1.0 / (row_l * col_p - row_p * col_l);
            inverse.l_by_row[lane] = col_p * unit;
            inverse.l_by_col[lane] = -row_p * unit;
            inverse.p_by_row[lane] = -col_l * unit;
            inverse.p_by_col[lane] = row_l * unit;
        }
        (image, inverse)
    }

    /// An upper bound of the distances to the target, pixels.
    #[inline]
    fn residual_px(&self, target: &Image, image: &Image) -> Lane {
        let mut residual = [0.0; LANES];
        for lane in 0..LANES {
            residual[lane] = ((target.row[lane] - image.row[lane]) * self.line_scale).abs()
                + ((target.col[lane] - image.col[lane]) * self.sample_scale).abs();
        }
        residual
    }

    fn image_point(&self, image: &Image, lane: usize) -> ImagePoint {
        ImagePoint::new(
            image.col[lane] * self.sample_scale + self.sample_offset,
            image.row[lane] * self.line_scale + self.line_offset,
        )
    }
}

/// The monomials of eight points.
#[inline(always)]
fn eight_monomials(ground: &PointLanes) -> [Lane; 20] {
    let mut out = [[0.0; LANES]; 20];
    for lane in 0..LANES {
        let m = monomials([ground.l[lane], ground.p[lane], ground.h[lane]]);
        for (slots, m) in out.iter_mut().zip(m) {
            slots[lane] = m;
        }
    }
    out
}

/// A polynomial's values: the same sums in the same order as [`value`], eight side by side.
#[inline(always)]
fn eight_values(coefficients: &[f64; 20], m: &[Lane; 20]) -> Lane {
    let mut sums = [[0.0; LANES]; 4];
    for (part, sums) in sums.iter_mut().enumerate() {
        for term in (part..20).step_by(4) {
            for lane in 0..LANES {
                sums[lane] += coefficients[term] * m[term][lane];
            }
        }
    }
    let mut values = [0.0; LANES];
    for lane in 0..LANES {
        values[lane] = (sums[0][lane] + sums[2][lane]) + (sums[1][lane] + sums[3][lane]);
    }
    values
}

/// One step to the target.
#[inline]
fn step(ground: &mut PointLanes, target: &Image, image: &Image, inverse: &Inverse) {
    for lane in 0..LANES {
        let (row, col) = (target.row[lane] - image.row[lane], target.col[lane] - image.col[lane]);
        ground.l[lane] += inverse.l_by_row[lane] * row + inverse.l_by_col[lane] * col;
        ground.p[lane] += inverse.p_by_row[lane] * row + inverse.p_by_col[lane] * col;
    }
}

/// Takes back the steps that did not help: rounding had the last word before.
#[inline]
fn keep_better(ground: &mut PointLanes, residual_px: &mut Lane, before: &(PointLanes, Lane)) {
    for lane in 0..LANES {
        if before.1[lane] < TARGET_RESIDUAL_PX {
            ground.l[lane] = before.0.l[lane];
            ground.p[lane] = before.0.p[lane];
            residual_px[lane] = before.1[lane];
        }
    }
}
