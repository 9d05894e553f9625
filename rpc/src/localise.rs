//! Localisation: the ground->image model inverted at a given height.
//!
//! Vendors' own image->ground polynomials are never used: they are a second fit, off by up to 80 m on real products.
//! Newton runs in normalised coordinates, with bounded steps and backtracking; where that fails, it follows the line
//! from the model's centre to the target, and last it runs from a grid of starts.

use crate::polynomial::{gradient_horizontal, monomials, value};
use crate::rpc::wrapped_longitude_deg;
use crate::rpc::{GeoPoint, ImagePoint, Rpc, RpcError};
use nalgebra::{Matrix2, Vector2};

/// Residual at the precision of f64, at which iteration stops, pixels.
const TARGET_RESIDUAL_PX: f64 = 2e-10;
/// Largest residual of a solution, from rounding on a model with large coordinates, pixels.
const ACCEPTED_RESIDUAL_PX: f64 = 1e-6;
/// Largest reprojection error of a result, pixels: longitude and latitude rounded to f64 are off by 2 nm.
const ACCEPTED_REPROJECTION_PX: f64 = 1e-5;
const MAX_ITERATIONS: usize = 60;
const MAX_HALVINGS: usize = 14;
const CONTINUATION_STEPS: usize = 16;
/// Largest span, ground half ranges per image half range, of a model that is trusted without a further check. Fifty
/// sound models have up to 1.4, models with a wrong fit 6 and more. Models whose scales are not those of their image
/// have any span.
const LARGEST_SPAN: f64 = 3.0;
/// Largest relative change of the slope over the image of a model with too large a span: at most 0.09 over sound images,
/// 7 and more over an image of a wrong fit.
const LARGEST_BEND: f64 = 0.5;

/// Border of the area between -1 and 1 each way.
const BORDER: [(f64, f64); 8] = [
    (-1.0, -1.0),
    (0.0, -1.0),
    (1.0, -1.0),
    (-1.0, 0.0),
    (1.0, 0.0),
    (-1.0, 1.0),
    (0.0, 1.0),
    (1.0, 1.0),
];

/// One localisation: the model at one height, and the target image point.
struct Problem<'a> {
    rpc: &'a Rpc,
    height: f64,
    target: Vector2<f64>,
    /// Longest Newton step, in the model's half ranges: 1 for the model's area, which is 2 across, or half the length
    /// of the first linear step where that is more (scales that are not those of the image).
    longest: f64,
}

/// Normalised (row, column) and its derivatives by normalised longitude and latitude.
struct Evaluation {
    image: Vector2<f64>,
    slope: Matrix2<f64>,
    /// Signs of the denominators, true if positive: a step that changes one crosses a pole of the rational and is
    /// rejected.
    signs: [bool; 2],
}

impl Rpc {
    /// The ground point at ellipsoidal height `height_m` that projects to `point`; longitude in [-180, 180] degrees.
    ///
    /// # Errors
    /// [`RpcError::NoConvergence`] when no such point is found, [`RpcError::Inconsistent`] when the model's scales and
    /// polynomials contradict each other so that no solution could be trusted.
    pub fn localise(&self, point: ImagePoint, height_m: f64) -> Result<GeoPoint, RpcError> {
        let failure = || RpcError::NoConvergence {
            col: point.col,
            row: point.row,
            height_m,
        };
        let mut problem = Problem {
            rpc: self,
            longest: 1.0,
            height: (height_m - self.height_offset_m) / self.height_scale_m,
            target: Vector2::new(
                (point.row - self.line_offset) / self.line_scale,
                (point.col - self.sample_offset) / self.sample_scale,
            ),
        };
        if !(problem.height.is_finite() && problem.target.iter().all(|v| v.is_finite())) {
            return Err(failure());
        }
        let centre = problem.evaluate(Vector2::zeros());
        let Some(inverse) = centre.slope.try_inverse() else {
            return Err(failure());
        };
        let span = inverse.abs().column_sum().max();
        if !span.is_finite() {
            return Err(failure());
        }
        // The scales of the image or those of the ground may be those of other pixels, so one of the two gives its
        // extent.
        let is_straight = |over: Matrix2<f64>| {
            BORDER.iter().all(|&(x, y)| {
                let slope = problem.evaluate(over * Vector2::new(x, y)).slope;
                (inverse * slope - Matrix2::identity()).abs().max() < LARGEST_BEND
            })
        };
        if span > LARGEST_SPAN && !is_straight(inverse) && !is_straight(Matrix2::identity()) {
            return Err(RpcError::Inconsistent { span });
        }
        let linear_start = inverse * (problem.target - centre.image);
        problem.longest = problem.longest.max(linear_start.norm() / 2.0);
        let solution = problem
            .newton(linear_start)
            .or_else(|| problem.continuation(centre.image))
            .or_else(|| problem.grid_of_starts())
            .ok_or_else(failure)?;
        let ground = GeoPoint::new(
            wrapped_longitude_deg(solution.x * self.longitude_scale_deg + self.longitude_offset_deg),
            solution.y * self.latitude_scale_deg + self.latitude_offset_deg,
            height_m,
        );
        // Scales that are zero or not finite show only in the final point.
        let seen = self.project(ground);
        let off_px = (seen.col - point.col).hypot(seen.row - point.row);
        if off_px < ACCEPTED_REPROJECTION_PX {
            Ok(ground)
        } else {
            Err(failure())
        }
    }
}

/// `step` shortened to `longest`.
fn limited(step: Vector2<f64>, longest: f64) -> Vector2<f64> {
    let length = step.norm();
    if length > longest {
        step * (longest / length)
    } else {
        step
    }
}

impl Problem<'_> {
    fn evaluate(&self, ground: Vector2<f64>) -> Evaluation {
        let m = monomials([ground.x, ground.y, self.height]);
        let rational = |numerator: &[f64; 20], denominator: &[f64; 20]| {
            let bottom = value(denominator, &m);
            let ratio = value(numerator, &m) / bottom;
            let (top_slope, bottom_slope) = (gradient_horizontal(numerator, &m), gradient_horizontal(denominator, &m));
            let slope = [0, 1].map(|axis| (top_slope[axis] - ratio * bottom_slope[axis]) / bottom);
            (ratio, slope, bottom > 0.0)
        };
        let (row, row_slope, row_sign) = rational(&self.rpc.line_numerator, &self.rpc.line_denominator);
        let (col, col_slope, col_sign) = rational(&self.rpc.sample_numerator, &self.rpc.sample_denominator);
        Evaluation {
            image: Vector2::new(row, col),
            slope: Matrix2::new(row_slope[0], row_slope[1], col_slope[0], col_slope[1]),
            signs: [row_sign, col_sign],
        }
    }

    /// Pixels between two normalised image positions.
    fn pixels(&self, difference: Vector2<f64>) -> f64 {
        (difference.x * self.rpc.line_scale).hypot(difference.y * self.rpc.sample_scale)
    }

    /// Damped Newton from `start`; `None` when it ends with more than the accepted residual.
    fn newton(&self, start: Vector2<f64>) -> Option<Vector2<f64>> {
        let mut ground = start;
        let mut here = self.evaluate(ground);
        let mut residual_px = self.pixels(self.target - here.image);
        for _ in 0..MAX_ITERATIONS {
            if !residual_px.is_finite() || residual_px < TARGET_RESIDUAL_PX {
                break;
            }
            let Some(inverse) = here.slope.try_inverse() else {
                break;
            };
            let mut step = limited(inverse * (self.target - here.image), self.longest);
            let mut improved = false;
            for _ in 0..MAX_HALVINGS {
                let there = self.evaluate(ground + step);
                let residual_there_px = self.pixels(self.target - there.image);
                if residual_there_px < residual_px && there.signs == here.signs {
                    ground += step;
                    here = there;
                    residual_px = residual_there_px;
                    improved = true;
                    break;
                }
                if residual_px < ACCEPTED_RESIDUAL_PX {
                    // Rounding, not the step's length, prevents progress.
                    break;
                }
                step *= 0.5;
            }
            if !improved {
                break;
            }
        }
        (residual_px < ACCEPTED_RESIDUAL_PX).then_some(ground)
    }

    /// Follows the solution from the model's centre to the target.
    fn continuation(&self, centre_image: Vector2<f64>) -> Option<Vector2<f64>> {
        let mut ground = Vector2::zeros();
        for step in 1..=CONTINUATION_STEPS {
            let share = step as f64 / CONTINUATION_STEPS as f64;
            let waypoint = Problem {
                target: centre_image + (self.target - centre_image) * share,
                ..*self
            };
            ground = waypoint.newton(ground)?;
        }
        Some(ground)
    }

    /// The solution nearest to the model's centre over a grid of starts.
    fn grid_of_starts(&self) -> Option<Vector2<f64>> {
        let steps = [-1.0, -0.5, 0.0, 0.5, 1.0];
        steps
            .iter()
            .flat_map(|&l| steps.iter().map(move |&p| Vector2::new(l, p)))
            .filter_map(|start| self.newton(start))
            .min_by(|a, b| a.norm().total_cmp(&b.norm()))
    }
}
