//! The normal equations of one iteration, with the ground points eliminated (Schur complement): a dense system of a few
//! unknowns per image.

use super::correction::Correction;
use super::linear::{Linear, POINT_HOLD, SLOPES, basis};
use crate::rpc::RpcError;
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector3};

/// Prior standard deviation of shifts, pixels: weak, so that it fixes only unknowns that the ties leave open.
pub const SHIFT_SIGMA_PX: f64 = 10.0;
/// Prior standard deviation of rotation and drift: pixels at the edge of the image, half its longer side from the
/// centre.
pub const SLOPE_SIGMA_PX: f64 = 0.5;
/// Standard deviation of a sighting, pixels, for the weight of the priors.
const SIGHTING_SIGMA_PX: f64 = 0.15;

/// One track's contribution: the coupling of its point to each of its images.
struct Eliminated<const K: usize> {
    /// Inverse curvature of the point.
    inverse: Matrix3<f64>,
    gradient: Vector3<f64>,
    /// Image and mixed curvature, image parameters by point.
    mixed: Vec<(usize, SMatrix<f64, K, 3>)>,
}

/// The reduced system: `K` unknowns per image.
pub(super) struct NormalEquations<const K: usize> {
    curvature: DMatrix<f64>,
    gradient: DVector<f64>,
    /// By track; `None` where the point is not determined; such a track has no effect.
    tracks: Vec<Option<Eliminated<K>>>,
}

impl<const K: usize> NormalEquations<K> {
    /// The system at the corrections `now`; `free` is the number of parameters that each image may have.
    pub(super) fn of(linear: &[Vec<Linear>], weights: &[Vec<f64>], now: &[Correction], free: &[usize]) -> Self {
        let unknowns = K * now.len();
        let mut system = Self {
            curvature: DMatrix::zeros(unknowns, unknowns),
            gradient: DVector::zeros(unknowns),
            tracks: Vec::with_capacity(linear.len()),
        };
        for (lines, weights) in linear.iter().zip(weights) {
            let eliminated = system.add_track(lines, weights);
            system.tracks.push(eliminated);
        }
        for (image, correction) in now.iter().enumerate() {
            system.add_prior(image, correction, free[image]);
        }
        system
    }

    fn add_track(&mut self, lines: &[Linear], weights: &[f64]) -> Option<Eliminated<K>> {
        let mut point = Matrix3::identity() * POINT_HOLD;
        let mut gradient = Vector3::zeros();
        for (line, &weight) in lines.iter().zip(weights) {
            point += line.slope.transpose() * line.slope * weight;
            gradient += line.slope.transpose() * line.residual * weight;
        }
        let inverse = point.try_inverse()?;
        let mut mixed = Vec::with_capacity(lines.len());
        for (line, &weight) in lines.iter().zip(weights) {
            let by_image = basis::<K>(line.from_centre);
            let first = line.image * K;
            let mut block = self.curvature.fixed_view_mut::<K, K>(first, first);
            block += by_image.transpose() * by_image * weight;
            let mut part = self.gradient.fixed_rows_mut::<K>(first);
            part += by_image.transpose() * line.residual * weight;
            mixed.push((line.image, by_image.transpose() * line.slope * weight));
        }
        for (a, mixed_a) in &mixed {
            let through = mixed_a * inverse;
            let mut part = self.gradient.fixed_rows_mut::<K>(a * K);
            part -= through * gradient;
            for (b, mixed_b) in &mixed {
                let mut block = self.curvature.fixed_view_mut::<K, K>(a * K, b * K);
                block -= through * mixed_b.transpose();
            }
        }
        Some(Eliminated {
            inverse,
            gradient,
            mixed,
        })
    }

    /// Keeps corrections small where ties are weak, and parameters that are not free at zero.
    fn add_prior(&mut self, image: usize, now: &Correction, free: usize) {
        let slopes = SLOPES.map(|[axis, along]| now.slope_px[axis][along]);
        let values = now.shift_px.iter().chain(&slopes).take(K);
        for (place, value) in values.enumerate() {
            let sigma_px = match (place < free, place < 2) {
                (false, _) => 1e-6,
                (true, true) => SHIFT_SIGMA_PX,
                (true, false) => SLOPE_SIGMA_PX,
            };
            let weight = (SIGHTING_SIGMA_PX / sigma_px).powi(2);
            let at = image * K + place;
            self.curvature[(at, at)] += weight;
            self.gradient[at] -= weight * value;
        }
    }

    /// Weighted sum of squared residuals with every point at its best place.
    pub(super) fn squares(&self, linear: &[Vec<Linear>], weights: &[Vec<f64>]) -> f64 {
        let of_track = |((lines, weights), track): ((&Vec<Linear>, &Vec<f64>), &Option<Eliminated<K>>)| {
            let track = track.as_ref()?;
            let lines = lines.iter().zip(weights);
            let squares: f64 = lines.map(|(line, weight)| line.residual.norm_squared() * weight).sum();
            Some(squares - track.gradient.dot(&(track.inverse * track.gradient)))
        };
        linear.iter().zip(weights).zip(&self.tracks).filter_map(of_track).sum()
    }

    /// Curvature and gradient of half the sum of squares by the parameters of the images.
    pub(super) fn into_parts(self) -> (DMatrix<f64>, DVector<f64>) {
        (self.curvature, self.gradient)
    }

    /// Steps of the images' parameters, and their joint length; `points` are moved by their own steps. The length is
    /// the step in standard deviations of the parameters times that of a sighting, pixels: steps in directions that the
    /// ties hardly determine are short.
    pub(super) fn solve(self, points: &mut [Vector3<f64>]) -> Result<(Vec<SVector<f64, K>>, f64), RpcError> {
        let images = self.gradient.len() / K;
        let solution = self
            .curvature
            .cholesky()
            .map(|factor| factor.solve(&self.gradient))
            .filter(|steps| steps.iter().all(|v| v.is_finite()))
            .ok_or_else(|| RpcError::Invalid("adjustment: the ties do not determine the cameras".into()))?;
        let steps: Vec<SVector<f64, K>> = (0..images)
            .map(|image| solution.fixed_rows::<K>(image * K).into_owned())
            .collect();
        for (track, point) in self.tracks.iter().zip(points) {
            let Some(track) = track else { continue };
            let mut right = track.gradient;
            for (image, mixed) in &track.mixed {
                right -= mixed.transpose() * steps[*image];
            }
            *point += track.inverse * right;
        }
        Ok((steps, solution.dot(&self.gradient).max(0.0).sqrt()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2x3, Vector2};

    #[test]
    fn a_track_whose_point_is_not_determined_moves_no_other_track() {
        let line = |slope: Matrix2x3<f64>| Linear {
            image: 0,
            weight: 1.0,
            residual: Vector2::new(1.0, 0.0),
            slope,
            from_centre: [0.0; 2],
        };
        // Curvatures of 1e12 in one direction swallow the hold of 1e-8: the matrix is exactly singular.
        let singular = vec![line(Matrix2x3::new(1e6, 1e6, 1e6, 0.0, 0.0, 0.0))];
        let sound = vec![
            line(Matrix2x3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0)),
            line(Matrix2x3::new(1.0, 0.0, 1.0, 0.0, 1.0, 0.0)),
        ];
        let weights = [vec![1.0], vec![1.0; 2]];
        let mut points = [Vector3::zeros(); 2];
        // The image is held, so that points alone move.
        let now = [Correction::none(100, 100)];
        let system = NormalEquations::<2>::of(&[singular, sound], &weights, &now, &[0]);
        let _ = system.solve(&mut points).expect("a solution");
        assert_eq!(points[0], Vector3::zeros());
        assert!((points[1] - Vector3::x()).norm() < 1e-3, "{}", points[1]);
    }
}
