//! Multi-view triangulation: the ground point with the smallest distances of its projections from the measured
//! positions.

use crate::frame::LocalFrame;
use crate::rpc::{GeoPoint, ImagePoint, Rpc, RpcError};
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

/// A triangulated point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangulation {
    /// Ground point.
    pub point: GeoPoint,
    /// Root mean square over the views of the residual's length, pixels.
    pub rms_px: f64,
}

/// Heights tried for a start, in the first camera's half ranges from its centre.
const START_HEIGHTS: [f64; 5] = [0.0, -0.5, 0.5, -1.0, 1.0];
const MAX_ITERATIONS: usize = 50;
/// Length of a step that ends the iteration, metres.
const LAST_STEP_M: f64 = 1e-7;
/// Least ratio of the smallest to the largest curvature of the residuals: below it, the weakest direction is less than
/// 1e-5 times as precise as the strongest.
const LEAST_CURVATURE_RATIO: f64 = 1e-10;

/// The ground point with the least squared pixel residuals, by Gauss-Newton with damping in a local frame. Each view is
/// a camera and the measured position, pixels.
///
/// # Errors
/// [`RpcError::Invalid`] with fewer than two views, or with views so nearly parallel that height is undetermined; the
/// error of [`Rpc::localise`] when the first view cannot be localised; [`RpcError::NoConvergence`] (of the first view)
/// when the iteration fails.
pub fn triangulate(views: &[(&Rpc, ImagePoint)]) -> Result<Triangulation, RpcError> {
    let &[(first, seen), _, ..] = views else {
        return Err(RpcError::Invalid(format!(
            "triangulation needs at least two views, got {}",
            views.len()
        )));
    };
    let start = best_start(views)?;
    let frame = LocalFrame::new(start);
    let failure = || RpcError::NoConvergence {
        col: seen.col,
        row: seen.row,
        height_m: first.height_offset_m,
    };
    let mut enu_m = Vector3::zeros();
    let mut system = NormalSystem::at(views, &frame, enu_m);
    let mut damping = 0.0;
    for _ in 0..MAX_ITERATIONS {
        let Some(step_m) = system.step(damping) else {
            damping = f64::max(damping * 10.0, 1e-6);
            continue;
        };
        let next = NormalSystem::at(views, &frame, enu_m + step_m);
        // Near the minimum the sums differ by rounding only.
        if next.squared_px <= system.squared_px * (1.0 + 1e-12) {
            enu_m += step_m;
            system = next;
            damping *= 0.1;
            if step_m.norm() < LAST_STEP_M {
                return system.finished(views.len(), &frame, enu_m);
            }
        } else if step_m.norm() < LAST_STEP_M {
            return system.finished(views.len(), &frame, enu_m);
        } else {
            damping = f64::max(damping * 10.0, 1e-6);
        }
    }
    Err(failure())
}

/// Point on the first camera's ray, at one of the start heights, with the least squared residuals in all views.
fn best_start(views: &[(&Rpc, ImagePoint)]) -> Result<GeoPoint, RpcError> {
    let (first, seen) = views[0];
    let mut failure = None;
    let mut best: Option<(f64, GeoPoint)> = None;
    for level in START_HEIGHTS {
        match first.localise(seen, first.height_offset_m + level * first.height_scale_m.abs()) {
            Ok(point) => {
                let squared_px: f64 = views
                    .iter()
                    .map(|(rpc, seen)| residual(rpc, *seen, point).norm_squared())
                    .sum();
                if squared_px.is_finite() && best.is_none_or(|(least, _)| squared_px < least) {
                    best = Some((squared_px, point));
                }
            }
            Err(error) => failure = failure.or(Some(error)),
        }
    }
    match (best, failure) {
        (Some((_, point)), _) => Ok(point),
        (None, Some(error)) => Err(error),
        (None, None) => Err(RpcError::Invalid(
            "triangulation: no other view sees the first view's ray; do the images overlap?".into(),
        )),
    }
}

fn residual(rpc: &Rpc, seen: ImagePoint, point: GeoPoint) -> Vector2<f64> {
    let projected = rpc.project(point);
    Vector2::new(seen.col - projected.col, seen.row - projected.row)
}

/// The normal equations of all views' residuals at a point.
struct NormalSystem {
    curvature: Matrix3<f64>,
    gradient: Vector3<f64>,
    squared_px: f64,
}

impl NormalSystem {
    fn at(views: &[(&Rpc, ImagePoint)], frame: &LocalFrame, enu_m: Vector3<f64>) -> Self {
        let point = frame.geo_from_enu(enu_m);
        let geo_from_enu = geo_slope(frame, enu_m);
        let mut system = Self {
            curvature: Matrix3::zeros(),
            gradient: Vector3::zeros(),
            squared_px: 0.0,
        };
        for (rpc, seen) in views {
            let (projected, by_geo) = rpc.project_with_jacobian(point);
            let residual = Vector2::new(seen.col - projected.col, seen.row - projected.row);
            let slope: Matrix2x3<f64> = by_geo * geo_from_enu;
            system.curvature += slope.transpose() * slope;
            system.gradient += slope.transpose() * residual;
            system.squared_px += residual.norm_squared();
        }
        system
    }

    fn step(&self, damping: f64) -> Option<Vector3<f64>> {
        let mut damped = self.curvature;
        for i in 0..3 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step = damped.cholesky()?.solve(&self.gradient);
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    fn finished(&self, views: usize, frame: &LocalFrame, enu_m: Vector3<f64>) -> Result<Triangulation, RpcError> {
        let curvatures = self.curvature.symmetric_eigenvalues();
        let ratio = curvatures.min() / curvatures.max();
        if ratio.is_nan() || ratio <= LEAST_CURVATURE_RATIO {
            return Err(RpcError::Invalid(
                "triangulation: the views are parallel, so that height is undetermined; add a view from elsewhere"
                    .into(),
            ));
        }
        Ok(Triangulation {
            point: frame.geo_from_enu(enu_m),
            rms_px: (self.squared_px / views as f64).sqrt(),
        })
    }
}

/// `d(lon_deg, lat_deg, height_m) / d(east, north, up)` by central differences of a metre, exact to 1e-9 relative:
/// Gauss-Newton's direction needs no more.
pub(crate) fn geo_slope(frame: &LocalFrame, enu_m: Vector3<f64>) -> Matrix3<f64> {
    let columns: [Vector3<f64>; 3] = std::array::from_fn(|axis| {
        let mut offset_m = Vector3::zeros();
        offset_m[axis] = 1.0;
        let (high, low) = (
            frame.geo_from_enu(enu_m + offset_m),
            frame.geo_from_enu(enu_m - offset_m),
        );
        Vector3::new(
            crate::rpc::wrapped_difference_deg(high.lon_deg, low.lon_deg),
            high.lat_deg - low.lat_deg,
            high.height_m - low.height_m,
        ) * 0.5
    });
    Matrix3::from_columns(&columns)
}
