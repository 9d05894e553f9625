//! Anisotropic spherical Gaussian lobes over the half vector, as one-light-at-a-time models share them (Bi et al.,
//! "GS³", 2024).
//!
//! `G(v) = N exp(-½ θ² (c²/λ² + s²/μ²) / σ²)` with `v` in the lobe's frame, `θ` its angle to the lobe's axis and
//! `(c, s)` the direction it leans to. Written with `q = (θ / sin θ)²` there is neither an arc cosine nor a normalised
//! tangent, so that value and gradient are smooth on the axis: `N exp(-½ q ((v_x/λ)² + (v_y/μ)²) / σ²)`.

use glam::Vec3;

/// `1 / (√2 π^⅔)`: with `1 / σ` the factor in front of a lobe.
const FACTOR: f32 = 0.329_648_9;
/// `sin θ` below which `q` is its series.
const NEAR_AXIS: f32 = 0.05;
/// Least `sin θ`, which only matters opposite to the axis.
const LEAST_SINE: f32 = 1e-4;

/// Shape of an anisotropic lobe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lobe {
    /// Width along the first axis, relative.
    pub lambda: f32,
    /// Width along the second axis, relative.
    pub mu: f32,
    /// Width of both, radians.
    pub sigma: f32,
}

/// Value of a lobe and its gradients.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LobeValue {
    /// Value of the lobe.
    pub value: f32,
    /// Gradient to the direction, valid for changes along the sphere.
    pub direction: Vec3,
    /// Gradients to λ, μ and σ.
    pub shape: [f32; 3],
}

/// `q = (θ / sin θ)²` of a unit vector, and its derivatives to `sin² θ` and to the component along the axis.
#[inline]
fn stretch(v: Vec3) -> (f32, f32, f32) {
    let square = v.x * v.x + v.y * v.y;
    if v.z > 0.0 && square < NEAR_AXIS * NEAR_AXIS {
        let q = 1.0 + square * (1.0 / 3.0 + square * (8.0 / 45.0));
        return (q, 1.0 / 3.0 + square * (16.0 / 45.0), 0.0);
    }
    let sine = square.sqrt().max(LEAST_SINE);
    let angle = sine.atan2(v.z);
    let q = (angle / sine) * (angle / sine);
    let by_sine = 2.0 * angle * v.z / (sine * sine) - 2.0 * q / sine;
    (q, 0.5 * by_sine / sine, -2.0 * angle / sine)
}

impl Lobe {
    /// The lobe in the unit direction `v` of its frame.
    #[inline]
    pub fn value(&self, v: Vec3) -> f32 {
        let (x, y) = (v.x / self.lambda, v.y / self.mu);
        FACTOR / self.sigma * (-0.5 * stretch(v).0 * (x * x + y * y) / (self.sigma * self.sigma)).exp()
    }

    /// Value and gradients in the unit direction `v` of its frame.
    #[inline]
    pub fn value_and_gradients(&self, v: Vec3) -> LobeValue {
        let (x, y) = (v.x / self.lambda, v.y / self.mu);
        let u = x * x + y * y;
        let (q, q_square, q_axis) = stretch(v);
        let inverse = 1.0 / (self.sigma * self.sigma);
        let exponent = -0.5 * q * u * inverse;
        let value = FACTOR / self.sigma * exponent.exp();
        // Gradient of the exponent, times the value.
        let to_q = -0.5 * u * inverse * value;
        let to_u = -0.5 * q * inverse * value;
        LobeValue {
            value,
            direction: Vec3::new(
                to_q * q_square * 2.0 * v.x + to_u * 2.0 * x / self.lambda,
                to_q * q_square * 2.0 * v.y + to_u * 2.0 * y / self.mu,
                to_q * q_axis,
            ),
            shape: [
                to_u * -2.0 * x * x / self.lambda,
                to_u * -2.0 * y * y / self.mu,
                value * (-1.0 - 2.0 * exponent) / self.sigma,
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::f64::consts::PI;

    /// As printed: an arc cosine and a normalised tangent, in f64.
    fn literal(lobe: &[f64; 3], v: DVec3) -> f64 {
        let tangent = DVec3::new(v.x, v.y, 0.0).normalize_or_zero();
        let ratio = ((tangent.x / lobe[0]).powi(2) + (tangent.y / lobe[1]).powi(2)).sqrt();
        let angle = v.z.clamp(-1.0, 1.0).acos();
        (-0.5 * (angle * ratio / lobe[2]).powi(2)).exp() / (2f64.sqrt() * PI.powf(2.0 / 3.0) * lobe[2])
    }

    const SHAPES: [[f64; 3]; 3] = [[2.5, 1.0, 0.35], [0.7, 4.0, 0.1], [1.0, 1.0, 0.9]];

    fn lobe(shape: &[f64; 3]) -> Lobe {
        let [lambda, mu, sigma] = shape.map(|x| x as f32);
        Lobe { lambda, mu, sigma }
    }

    fn directions() -> Vec<DVec3> {
        let turned = |angle: f64, azimuth: f64| {
            DVec3::new(angle.sin() * azimuth.cos(), angle.sin() * azimuth.sin(), angle.cos())
        };
        let angles = [1e-6, 1e-3, 0.01, 0.049, 0.051, 0.2, 0.7, 1.5, 2.0, 3.0];
        angles
            .iter()
            .flat_map(|&a| (0..5).map(move |k| turned(a, 0.3 + 1.3 * f64::from(k))))
            .collect()
    }

    #[test]
    fn the_smooth_form_is_the_printed_one() {
        for shape in &SHAPES {
            for v in directions() {
                let (found, exact) = (f64::from(lobe(shape).value(v.as_vec3())), literal(shape, v));
                assert!(
                    (found - exact).abs() < 2e-5 * (exact + 0.01),
                    "{shape:?} {v}: {found} {exact}"
                );
            }
        }
    }

    #[test]
    fn gradients_match_central_differences_of_the_printed_form() {
        let step = 1e-6;
        for shape in &SHAPES {
            for v in directions() {
                let found = lobe(shape).value_and_gradients(v.as_vec3());
                let scale = 1.0 / shape[2].powi(2);
                for across in [v.any_orthonormal_vector(), v.cross(v.any_orthonormal_vector())] {
                    let (hi, lo) = ((v + across * step).normalize(), (v - across * step).normalize());
                    let numeric = (literal(shape, hi) - literal(shape, lo)) / (2.0 * step);
                    let analytic = f64::from(found.direction.dot(across.as_vec3()));
                    assert!(
                        (numeric - analytic).abs() < 1e-3 * scale,
                        "{shape:?} {v}: {numeric} {analytic}"
                    );
                }
                for k in 0..3 {
                    let (mut hi, mut lo) = (*shape, *shape);
                    hi[k] += step;
                    lo[k] -= step;
                    let numeric = (literal(&hi, v) - literal(&lo, v)) / (2.0 * step);
                    let analytic = f64::from(found.shape[k]);
                    assert!(
                        (numeric - analytic).abs() < 1e-3 * scale,
                        "{shape:?} {v} {k}: {numeric} {analytic}"
                    );
                }
            }
        }
    }

    #[test]
    fn on_the_axis_and_opposite_to_it_everything_is_finite() {
        for shape in &SHAPES {
            for v in [Vec3::Z, -Vec3::Z] {
                let found = lobe(shape).value_and_gradients(v);
                assert!(found.value.is_finite() && found.direction.is_finite());
                assert!(found.shape.iter().all(|d| d.is_finite()));
            }
            assert_eq!(
                lobe(shape).value_and_gradients(Vec3::Z).direction.truncate(),
                glam::Vec2::ZERO
            );
        }
    }
}
