//! Fit of an RPC to pairs of ground and image points: regularised least squares, reweighted in each round.
//!
//! Each rational `r = N/D` has 39 unknowns (`D` starts with 1). From `D = 1`, where the problem is linear, each round
//! solves the equations linearised at the last solution, which weighs every sample by `1/D` (C. V. Tao, Y. Hu, *A
//! comprehensive study of the rational function model*, PE&RS 67(12), 2001, with the predicted image in place of the
//! observed one, so that noise does not bias the denominator). The unknowns are strongly correlated: a prior weighted
//! by the variance of the residuals keeps the denominator near 1, so that it gains no poles.

use crate::polynomial::{Monomials, monomials, value};
use crate::rpc::{GeoPoint, ImagePoint, Rpc, RpcError};
use crate::rpc::{wrapped_difference_deg, wrapped_longitude_deg};
use nalgebra::{SMatrix, SVector};

/// Fewest samples: the 39 unknowns of one rational.
pub const FEWEST_SAMPLES: usize = 39;
const UNKNOWNS: usize = 39;
const MAX_ROUNDS: usize = 20;
/// Relative improvement of the sum of squares below which the rounds end.
const LAST_IMPROVEMENT: f64 = 1e-6;
/// Standard deviation of the denominator's coefficients; those of real cameras are usually 0.001 to 0.1.
const DENOMINATOR_SIGMA: f64 = 0.1;
/// Damping per sample, on the diagonal of the normal equations, for terms of the highest order: fixes terms that the
/// samples leave open (three heights cannot separate `H` from `HHH`). It slows the rounds and does not bias their
/// limit.
const LEAST_DAMPING: f64 = 1e-10;
/// Factors on the damping for terms of orders 0 to 3: of two terms that the samples cannot separate, the one of lower
/// order is preferred.
const DAMPING_BY_ORDER: [f64; 4] = [1e-8, 1e-8, 1e-4, 1.0];

type Unknowns = SVector<f64, UNKNOWNS>;

/// A fitted RPC and its residuals over the samples it was fitted to.
#[derive(Debug, Clone, PartialEq)]
pub struct RpcFit {
    /// The camera.
    pub rpc: Rpc,
    /// Root mean square of the residual's length, pixels.
    pub rms_px: f64,
    /// Longest residual, pixels.
    pub max_px: f64,
}

/// Fits an RPC to pairs of a ground point and its image position.
///
/// The samples should fill the volume the model is to be used in: a grid of the image at four heights or more. With
/// fewer the model is only quadratic (three) or linear (two) in height. Outside the samples it is not valid.
///
/// # Errors
/// [`RpcError::Invalid`] with fewer than [`FEWEST_SAMPLES`] samples, with values that are not finite, or with samples
/// that do not spread over the ground and the image.
pub fn fit_rpc(samples: &[(GeoPoint, ImagePoint)]) -> Result<RpcFit, RpcError> {
    if samples.len() < FEWEST_SAMPLES {
        return Err(RpcError::Invalid(format!(
            "an RPC needs at least {FEWEST_SAMPLES} ground-image pairs to be fitted, got {}",
            samples.len()
        )));
    }
    let mut rpc = normalisation(samples)?;
    let design: Vec<Monomials> = samples
        .iter()
        .map(|(ground, _)| monomials(rpc.normalised(*ground)))
        .collect();
    let rows: Vec<f64> = samples
        .iter()
        .map(|(_, image)| (image.row - rpc.line_offset) / rpc.line_scale)
        .collect();
    let cols: Vec<f64> = samples
        .iter()
        .map(|(_, image)| (image.col - rpc.sample_offset) / rpc.sample_scale)
        .collect();
    (rpc.line_numerator, rpc.line_denominator) = fit_rational(&design, &rows)?;
    (rpc.sample_numerator, rpc.sample_denominator) = fit_rational(&design, &cols)?;
    let (mut sum, mut max_px) = (0.0, 0.0_f64);
    for (ground, image) in samples {
        let seen = rpc.project(*ground);
        let residual_px = (seen.col - image.col).hypot(seen.row - image.row);
        sum += residual_px * residual_px;
        max_px = max_px.max(residual_px);
    }
    let rms_px = (sum / samples.len() as f64).sqrt();
    if !rms_px.is_finite() {
        return Err(RpcError::Invalid(
            "the fitted RPC is not finite over its own samples".into(),
        ));
    }
    Ok(RpcFit { rpc, rms_px, max_px })
}

/// Offsets and scales that bring every coordinate of the samples to [-1, 1]; coefficients are still zero.
fn normalisation(samples: &[(GeoPoint, ImagePoint)]) -> Result<Rpc, RpcError> {
    let first_lon_deg = samples[0].0.lon_deg;
    let centre_and_half = |name: &str, least: f64, of: &dyn Fn(&(GeoPoint, ImagePoint)) -> f64| {
        let (low, high) = samples
            .iter()
            .map(of)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                // `f64::min` and `f64::max` ignore NaN, and one NaN has to make the range NaN.
                if v.is_nan() || low.is_nan() {
                    (f64::NAN, f64::NAN)
                } else {
                    (low.min(v), high.max(v))
                }
            });
        let half = 0.5 * (high - low);
        if half.is_finite() && half >= least {
            Ok((low + half, half))
        } else {
            Err(RpcError::Invalid(format!(
                "an RPC cannot be fitted: the samples' {name} are not finite or do not spread ({low} to {high})"
            )))
        }
    };
    let (line_offset, line_scale) = centre_and_half("rows", 1e-6, &|s| s.1.row)?;
    let (sample_offset, sample_scale) = centre_and_half("columns", 1e-6, &|s| s.1.col)?;
    let (latitude_offset_deg, latitude_scale_deg) = centre_and_half("latitudes", 1e-12, &|s| s.0.lat_deg)?;
    let (from_first_deg, longitude_scale_deg) = centre_and_half("longitudes", 1e-12, &|s| {
        wrapped_difference_deg(s.0.lon_deg, first_lon_deg)
    })?;
    // A single height is allowed: the damping then leaves height out of the model.
    let (height_offset_m, height_half_m) = centre_and_half("heights", 0.0, &|s| s.0.height_m)?;
    Ok(Rpc {
        line_offset,
        sample_offset,
        latitude_offset_deg,
        longitude_offset_deg: wrapped_longitude_deg(first_lon_deg + from_first_deg),
        height_offset_m,
        line_scale,
        sample_scale,
        latitude_scale_deg,
        longitude_scale_deg,
        height_scale_m: height_half_m.max(1.0),
        line_numerator: [0.0; 20],
        line_denominator: [0.0; 20],
        sample_numerator: [0.0; 20],
        sample_denominator: [0.0; 20],
        error_bias_m: None,
        error_random_m: None,
    })
}

/// Numerator and denominator of one rational.
fn fit_rational(design: &[Monomials], ratios: &[f64]) -> Result<([f64; 20], [f64; 20]), RpcError> {
    let mut here = Linearised::at(design, ratios, Unknowns::zeros());
    let mut damping = LEAST_DAMPING;
    let mut has_moved = false;
    for _ in 0..MAX_ROUNDS {
        let noise_squared = here.squared / ratios.len() as f64;
        let prior = noise_squared / (DENOMINATOR_SIGMA * DENOMINATOR_SIGMA);
        let next = here
            .step(prior, damping * ratios.len() as f64)
            .map(|step| Linearised::at(design, ratios, here.unknowns + step))
            // The prior may raise the sum of squares a little when it weakens; a wild step raises it a lot.
            .filter(|next| next.squared <= here.squared * (1.0 + 1e-3));
        match next {
            Some(next) => {
                let improved = next.squared < here.squared * (1.0 - LAST_IMPROVEMENT);
                here = next;
                has_moved = true;
                damping = f64::max(damping * 0.1, LEAST_DAMPING);
                if !improved {
                    break;
                }
            }
            None if damping < 1.0 => damping *= 100.0,
            None => break,
        }
    }
    if !has_moved {
        return Err(RpcError::Invalid(
            "an RPC cannot be fitted: the samples do not determine it; spread them over the image at several heights"
                .into(),
        ));
    }
    Ok(here.coefficients())
}

/// Degree of a monomial, by its place.
fn order_of(monomial: usize) -> usize {
    match monomial {
        0 => 0,
        1..=3 => 1,
        4..=9 => 2,
        _ => 3,
    }
}

/// The squared residuals of one rational and their normal equations at some unknowns.
struct Linearised {
    unknowns: Unknowns,
    squared: f64,
    normal: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    gradient: Unknowns,
}

impl Linearised {
    fn at(design: &[Monomials], ratios: &[f64], unknowns: Unknowns) -> Self {
        let mut system = Self {
            unknowns,
            squared: 0.0,
            normal: SMatrix::zeros(),
            gradient: Unknowns::zeros(),
        };
        let (numerator, denominator) = system.coefficients();
        for (m, ratio) in design.iter().zip(ratios) {
            let bottom = value(&denominator, m);
            let predicted = value(&numerator, m) / bottom;
            if bottom < 0.1 {
                // Near a pole the model is no camera, at any residual.
                system.squared = f64::INFINITY;
                return system;
            }
            let residual = ratio - predicted;
            let row = Unknowns::from_fn(|i, _| {
                if i < 20 {
                    m[i] / bottom
                } else {
                    -predicted * m[i - 19] / bottom
                }
            });
            system.squared += residual * residual;
            system.gradient.axpy(residual, &row, 1.0);
            system.normal.syger(1.0, &row, &row, 1.0);
        }
        system
    }

    fn coefficients(&self) -> ([f64; 20], [f64; 20]) {
        let mut numerator = [0.0; 20];
        let mut denominator = [1.0; 20];
        numerator.copy_from_slice(&self.unknowns.as_slice()[..20]);
        denominator[1..].copy_from_slice(&self.unknowns.as_slice()[20..]);
        (numerator, denominator)
    }

    fn step(&self, prior: f64, damping: f64) -> Option<Unknowns> {
        let mut normal = self.normal;
        let mut gradient = self.gradient;
        for i in 0..UNKNOWNS {
            // A term of the denominator acts as one of the next order.
            let order = if i < 20 {
                order_of(i)
            } else {
                (order_of(i - 19) + 1).min(3)
            };
            normal[(i, i)] += damping * DAMPING_BY_ORDER[order];
            if i >= 20 {
                normal[(i, i)] += prior;
                gradient[i] -= prior * self.unknowns[i];
            }
        }
        let step = normal.cholesky()?.solve(&gradient);
        step.iter().all(|v| v.is_finite()).then_some(step)
    }
}
