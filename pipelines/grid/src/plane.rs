//! The least-squares plane through points of a grid.

/// Share of the product of the two variances below which a determinant is the rounding of points on one line.
const LEAST_DETERMINANT: f64 = 1e-12;

/// Weighted sums for the least-squares fit of a plane `z = p + q a + r b`.
#[derive(Debug, Clone, Default)]
pub struct PlaneFit {
    weight: f64,
    first: [f64; 3],
    second: [f64; 5],
}

impl PlaneFit {
    /// Adds a point `(a, b, z)` with a weight.
    pub fn add(&mut self, [a, b]: [f64; 2], z: f64, weight: f64) {
        self.weight += weight;
        for (sum, value) in self.first.iter_mut().zip([a, b, z]) {
            *sum += weight * value;
        }
        for (sum, value) in self.second.iter_mut().zip([a * a, a * b, b * b, a * z, b * z]) {
            *sum += weight * value;
        }
    }

    /// Coefficients `[p, q, r]` of the plane. `stiffness`, in squared units of `a` and `b`, is added to their
    /// variances, so that slopes stay finite where all points lie on one line; without it the plane of such points is
    /// not finite.
    pub fn plane(&self, stiffness: f64) -> [f64; 3] {
        let [a, b, z] = self.first.map(|sum| sum / self.weight);
        let [aa, ab, bb, az, bz] = self.second.map(|sum| sum / self.weight);
        let (aa, ab, bb) = (aa - a * a + stiffness, ab - a * b, bb - b * b + stiffness);
        let (az, bz) = (az - a * z, bz - b * z);
        let det = aa * bb - ab * ab;
        let det = if det > LEAST_DETERMINANT * aa * bb { det } else { 0.0 };
        let (q, r) = ((az * bb - bz * ab) / det, (bz * aa - az * ab) / det);
        [z - q * a - r * b, q, r]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(points: &[[f64; 2]]) -> PlaneFit {
        let mut fit = PlaneFit::default();
        for &[a, b] in points {
            fit.add([a, b], 2.0 + 0.3 * a - 0.1 * b, 1.0 + a.abs());
        }
        fit
    }

    #[test]
    fn points_of_a_plane_give_it_back() {
        let found = fit(&[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [3.0, -2.0]]).plane(0.0);
        for (found, wanted) in found.into_iter().zip([2.0, 0.3, -0.1]) {
            assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
        }
    }

    #[test]
    fn points_on_a_line_have_a_plane_only_with_stiffness() {
        for line in [vec![[0.0, 0.0]], vec![[-0.7, -0.3], [0.0, 0.0], [0.7, 0.3]]] {
            assert!(fit(&line).plane(0.0).iter().any(|value| !value.is_finite()));
            let [p, q, r] = fit(&line).plane(1e-3);
            assert!((p - 2.0).abs() < 0.01 && q.is_finite() && r.is_finite());
        }
    }
}
