//! An RPC fitted to ground-image pairs: iteratively reweighted, regularised linear least squares.
//!
//! Each rational `r = N/D` has 39 unknowns (`D` starts with 1). `N - r D = 0` is linear in them but weighs samples by
//! `D`; dividing by the last round's `D` brings the residual back to the image (C. V. Tao, Y. Hu, *A comprehensive study
//! of the rational function model*, PE&RS 67(12), 2001). The unknowns are strongly correlated, so a ridge holds what the
//! samples do not determine near zero; two rounds of refinement then take the ridge's bias out of what they do.

use crate::polynomial::monomials;
use crate::rpc::{wrapped_difference_deg, wrapped_longitude_deg};
use crate::{GeoPoint, ImagePoint, Rpc, RpcError};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Fewest samples: the 39 unknowns of one rational.
pub const FEWEST_SAMPLES: usize = 39;
const UNKNOWNS: usize = 39;
const REWEIGHTINGS: usize = 4;
const REFINEMENTS: usize = 3;
/// Of one sample's weight, in normalised units: coefficients that change the image by less than about 1e-6 of its half
/// range are not worth having.
const RIDGE: f64 = 1e-11;

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

/// Fits an RPC to pairs of a ground point and where it is seen.
///
/// The samples should fill the volume the model is to be used in (a grid of the image at several heights); between them
/// the model is smooth, outside it means nothing.
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
    let design: Vec<[f64; 20]> = samples.iter().map(|(ground, _)| monomials(rpc.normalised(*ground))).collect();
    let rows: Vec<f64> = samples.iter().map(|(_, image)| (image.row - rpc.line_offset) / rpc.line_scale).collect();
    let cols: Vec<f64> =
        samples.iter().map(|(_, image)| (image.col - rpc.sample_offset) / rpc.sample_scale).collect();
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
        return Err(RpcError::Invalid("the fitted RPC is not finite over its own samples".into()));
    }
    Ok(RpcFit { rpc, rms_px, max_px })
}

/// Offsets and scales that bring every coordinate of the samples to [-1, 1]; coefficients are still zero.
fn normalisation(samples: &[(GeoPoint, ImagePoint)]) -> Result<Rpc, RpcError> {
    let first_lon_deg = samples[0].0.lon_deg;
    let centre_and_half = |name: &str, least: f64, of: &dyn Fn(&(GeoPoint, ImagePoint)) -> f64| {
        let (low, high) = samples.iter().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            // NaN must survive: `min` and `max` would drop it.
            if v.is_finite() { (low.min(v), high.max(v)) } else { (f64::NAN, f64::NAN) }
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
    let (from_first_deg, longitude_scale_deg) =
        centre_and_half("longitudes", 1e-12, &|s| wrapped_difference_deg(s.0.lon_deg, first_lon_deg))?;
    // One height alone is a legal, if poor, set of samples: the ridge then leaves height out of the model.
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
fn fit_rational(design: &[[f64; 20]], ratios: &[f64]) -> Result<([f64; 20], [f64; 20]), RpcError> {
    let mut unknowns = DVector::zeros(UNKNOWNS);
    for _ in 0..REWEIGHTINGS {
        let rows: Vec<([f64; UNKNOWNS], f64)> = design
            .iter()
            .zip(ratios)
            .map(|(m, &ratio)| weighted_row(m, ratio, &unknowns))
            .collect();
        unknowns = solve_ridge(&rows)?;
    }
    let mut numerator = [0.0; 20];
    let mut denominator = [1.0; 20];
    numerator.copy_from_slice(&unknowns.as_slice()[..20]);
    denominator[1..].copy_from_slice(&unknowns.as_slice()[20..]);
    Ok((numerator, denominator))
}

/// One equation `(N - r D_without_one) / D_last = r / D_last`.
fn weighted_row(m: &[f64; 20], ratio: f64, last: &DVector<f64>) -> ([f64; UNKNOWNS], f64) {
    let denominator = 1.0 + (1..20).map(|i| last[19 + i] * m[i]).sum::<f64>();
    // A denominator near zero is a round gone astray: such a weight would let one sample rule.
    let weight = 1.0 / denominator.max(0.1);
    let row = std::array::from_fn(|i| if i < 20 { m[i] * weight } else { -ratio * m[i - 19] * weight });
    (row, ratio * weight)
}

/// Least squares with a ridge, the ridge's bias reduced by refinement on the residual.
fn solve_ridge(rows: &[([f64; UNKNOWNS], f64)]) -> Result<DVector<f64>, RpcError> {
    let mut normal = DMatrix::<f64>::zeros(UNKNOWNS, UNKNOWNS);
    for (row, _) in rows {
        for i in 0..UNKNOWNS {
            for j in 0..=i {
                normal[(i, j)] += row[i] * row[j];
            }
        }
    }
    for i in 0..UNKNOWNS {
        normal[(i, i)] += RIDGE * rows.len() as f64;
    }
    let factor: Cholesky<f64, Dyn> = Cholesky::new(normal)
        .ok_or_else(|| RpcError::Invalid("an RPC cannot be fitted: the samples do not determine it".into()))?;
    let mut unknowns = DVector::<f64>::zeros(UNKNOWNS);
    for _ in 0..REFINEMENTS {
        let mut gradient = DVector::<f64>::zeros(UNKNOWNS);
        for (row, right) in rows {
            let residual = right - row.iter().zip(unknowns.iter()).map(|(a, x)| a * x).sum::<f64>();
            for i in 0..UNKNOWNS {
                gradient[i] += row[i] * residual;
            }
        }
        unknowns += factor.solve(&gradient);
    }
    Ok(unknowns)
}
