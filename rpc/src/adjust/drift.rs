//! Selection of the images whose correction drifts along the rows.
//!
//! A drift has two parameters, and any two parameters lower the residuals a little. Among `N` images, that of one is
//! accepted where it lowers the sum of squares of the good sightings, `S`, such that `ν ln(S₀ / S₁) > 2 ln(ν N)`: the
//! likelihood ratio of normal residuals of unknown size, with `ν` degrees of freedom. Without drift it follows a χ² of
//! two degrees of freedom, which exceeds that bound with probability `1 / (ν N)`; so `N` images together have a drift
//! by chance with probability `1 / ν`. For a single image the bound is that of the Bayesian information criterion (G.
//! Schwarz 1978).
//!
//! Images are accepted one by one, that of the largest ratio first: a linear deformation of the ground fits the ties
//! as well as drifts of all images, so that the fewest drifts are the explanation. A drift that all images share
//! remains unseen. Errors of neighbouring ties are alike, so that ties of a small part of an image look like a drift:
//! they have to span half of its rows.

use super::correction::Correction;
use super::linear::Linear;
use super::normal::NormalEquations;
use super::robust::LEAST_SIGMA_PX;
use super::tracks::{FEWEST_SIGHTINGS, Track};
use crate::rpc::ImagePoint;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Parameters of an image: shifts of columns and rows, and their drifts along the rows.
const PARAMETERS: usize = 4;
/// Share of the rows with ties at either end that must have [`FEWEST_SIGHTINGS`] of their own: fewer would decide a
/// drift by leverage.
const END: f64 = 0.25;

/// For each image a correction of zero whose unit are the rows that ties span; `None` where they span less than half of
/// the image, or too few are at an end of these rows.
pub(super) fn spans(none: &[Correction], tracks: &[&Track]) -> Vec<Option<Correction>> {
    let mut rows = vec![Vec::new(); none.len()];
    for sighting in tracks.iter().flat_map(|track| &track.sightings) {
        rows[sighting.image].push(sighting.at.row);
    }
    let span = |(none, mut rows): (&Correction, Vec<f64>)| {
        rows.sort_by(f64::total_cmp);
        let (first, last) = (*rows.first()?, *rows.last()?);
        let end = END * (last - first);
        let [lowest, highest] = [
            *rows.get(FEWEST_SIGHTINGS - 1)?,
            *rows.get(rows.len() - FEWEST_SIGHTINGS)?,
        ];
        let is_spanned = last - first >= none.centre.row;
        (is_spanned && lowest < first + end && highest > last - end).then(|| Correction {
            centre: ImagePoint::new(none.centre.col, 0.5 * (first + last)),
            half_side_px: 0.5 * (last - first),
            ..*none
        })
    };
    none.iter().zip(rows).map(span).collect()
}

/// Sum of squares as a function of the parameters of all images, with the ground points eliminated: `squares - 2
/// gradient · p + p · curvature p`, where `p` is zero without drifts.
pub(super) struct Quadratic {
    curvature: DMatrix<f64>,
    gradient: DVector<f64>,
    squares: f64,
    /// Degrees of freedom of the residuals without drifts.
    freedom: f64,
}

impl Quadratic {
    /// The sum of squares around a solution with drifts, `now`, of the sightings with a weight.
    pub(super) fn of(linear: &[Vec<Linear>], weights: &[Vec<f64>], now: &[Correction], free: &[usize]) -> Self {
        let system = NormalEquations::<PARAMETERS>::of(linear, weights, now, free);
        let squares = system.squares(linear, weights);
        let (curvature, gradient) = system.into_parts();
        let mut back = DVector::zeros(gradient.len());
        for (image, correction) in now.iter().enumerate() {
            for axis in 0..2 {
                back[PARAMETERS * image + 2 + axis] = -correction.slope_px[axis][1];
            }
        }
        let turned = &curvature * &back;
        let several = |weights: &&Vec<f64>| weights.iter().filter(|weight| **weight > 0.0).count() > 1;
        let equations: usize = weights
            .iter()
            .filter(several)
            .map(|weights| 2 * weights.iter().filter(|weight| **weight > 0.0).count() - 3)
            .sum();
        let shifts = 2 * free.iter().filter(|free| **free > 0).count();
        let freedom = equations.saturating_sub(shifts) as f64;
        // Residuals of exact ties are those of the finest matching: smaller ones are no evidence.
        let least = freedom * LEAST_SIGMA_PX.powi(2);
        Self {
            squares: least + squares - 2.0 * gradient.dot(&back) + back.dot(&turned),
            gradient: gradient - turned,
            curvature,
            freedom,
        }
    }

    /// One flag for each image, true if its drift is accepted; `may` marks the candidates.
    pub(super) fn drifting(&self, may: &[bool]) -> Vec<bool> {
        let candidates = may.iter().filter(|may| **may).count() as f64;
        let bound = 2.0 * (self.freedom.max(1.0) * candidates).ln();
        let mut accepted = vec![false; may.len()];
        while let Some((image, ratio)) = self.best(may, &accepted)
            && ratio > bound
        {
            accepted[image] = true;
        }
        accepted
    }

    /// The candidate whose drift has the largest likelihood ratio beside the accepted ones, with that ratio.
    fn best(&self, may: &[bool], accepted: &[bool]) -> Option<(usize, f64)> {
        let drift = |image: usize| [PARAMETERS * image + 2, PARAMETERS * image + 3];
        let of_image = |image: usize| {
            let count = if accepted[image] { PARAMETERS } else { 2 };
            PARAMETERS * image..PARAMETERS * image + count
        };
        let free: Vec<usize> = (0..may.len()).flat_map(of_image).collect();
        let factor = Cholesky::new(self.part(&free, &free))?;
        let gradient = self.gradient.select_rows(&free);
        let solution = factor.solve(&gradient);
        let squares = self.squares - gradient.dot(&solution);
        let drifts = accepted.iter().filter(|accepted| **accepted).count();
        let freedom = self.freedom - 2.0 * drifts as f64;
        let ratio = |image: usize| {
            let gain = self.gain(&drift(image), &free, &factor, &solution)?;
            Some((
                image,
                freedom * (squares / (squares - gain).max(f64::MIN_POSITIVE)).ln(),
            ))
        };
        let open = (0..may.len()).filter(|&image| may[image] && !accepted[image]);
        open.filter_map(ratio).max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Decrease of the sum of squares by two more parameters, `more`.
    fn gain(
        &self,
        more: &[usize],
        free: &[usize],
        factor: &Cholesky<f64, Dyn>,
        solution: &DVector<f64>,
    ) -> Option<f64> {
        let coupling = self.part(free, more);
        let gradient = self.gradient.select_rows(more) - coupling.tr_mul(solution);
        let curvature = self.part(more, more) - coupling.tr_mul(&factor.solve(&coupling));
        Some(gradient.dot(&Cholesky::new(curvature)?.solve(&gradient)))
    }

    fn part(&self, rows: &[usize], columns: &[usize]) -> DMatrix<f64> {
        self.curvature.select_rows(rows).select_columns(columns)
    }
}
