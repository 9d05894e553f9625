//! `(1-λ) L1 + λ (1 - SSIM)`, masked; SSIM after Wang et al. 2004 with a Gaussian window of 11 pixels, σ 1.5.

use crate::raster::Raster;
use crate::vectorised;
use rayon::prelude::*;

/// Half size of the window, pixels.
const RADIUS: usize = 5;
/// Standard deviation of the window, pixels.
const SIGMA: f32 = 1.5;
const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;

/// Weights of the one-dimensional window; they sum to one.
fn window() -> [f32; TAPS] {
    let mut weights = [0.0; TAPS];
    for (i, w) in weights.iter_mut().enumerate() {
        let x = i as f32 - RADIUS as f32;
        *w = (-0.5 * x * x / (SIGMA * SIGMA)).exp();
    }
    let sum: f32 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// Length of the window, pixels.
const TAPS: usize = 2 * RADIUS + 1;
/// Rows of a strip, a parallel job: with its margins it fits a cache.
const ROWS: usize = 32;

vectorised! {
    /// Weighted sum of rows that are at least as long as `out`. The outer loop is over pixels, which lets it be
    /// vectorised at every level of optimisation.
    fn weighted_sum(rows: &[&[f32]; TAPS], weights: &[f32; TAPS], out: &mut [f32]) {
        let n = out.len();
        let rows = rows.map(|row| &row[..n]);
        for i in 0..n {
            let mut sum = 0.0;
            for tap in 0..TAPS {
                sum += weights[tap] * rows[tap][i];
            }
            out[i] = sum;
        }
    }
}

/// Room to convolve a strip of `P` planes at once.
struct Strip<const P: usize> {
    weights: [f32; TAPS],
    width: usize,
    height: usize,
    padded: Vec<f32>,
    /// The rows of the strip and of its margins, convolved along their length.
    rows: [Vec<f32>; P],
    out: [Vec<f32>; P],
}

impl<const P: usize> Strip<P> {
    fn new(width: usize, height: usize) -> Self {
        Self {
            weights: window(),
            width,
            height,
            padded: vec![0.0; width + 2 * RADIUS],
            rows: [(); P].map(|()| vec![0.0; width * (ROWS + 2 * RADIUS)]),
            out: [(); P].map(|()| vec![0.0; width]),
        }
    }

    /// Convolves strip `number` of the planes and hands its rows to `done`. `fill` writes a row of a plane. Outside the
    /// planes is zero, which makes the operation its own adjoint.
    fn convolve(
        &mut self,
        number: usize,
        fill: impl Fn(usize, usize, &mut [f32]),
        mut done: impl FnMut(usize, [&[f32]; P]),
    ) {
        let (width, first) = (self.width, number * ROWS);
        let rows = ROWS.min(self.height - first);
        for (plane, smooth) in self.rows.iter_mut().enumerate() {
            for (offset, smooth) in smooth.chunks_exact_mut(width).take(rows + 2 * RADIUS).enumerate() {
                match (first + offset).checked_sub(RADIUS).filter(|&row| row < self.height) {
                    Some(row) => {
                        fill(plane, row, &mut self.padded[RADIUS..RADIUS + width]);
                        let taps = std::array::from_fn(|tap| &self.padded[tap..]);
                        weighted_sum(&taps, &self.weights, smooth);
                    }
                    None => smooth.fill(0.0),
                }
            }
        }
        for row in 0..rows {
            for (smooth, out) in self.rows.iter().zip(&mut self.out) {
                let taps = std::array::from_fn(|tap| &smooth[(row + tap) * width..]);
                weighted_sum(&taps, &self.weights, out);
            }
            done(row, self.out.each_ref().map(Vec::as_slice));
        }
    }
}

/// The greater, `b` where `a` is not a number: one instruction.
#[inline(always)]
fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Result of [`ssim_pixels`]: SSIM times its weight, and its gradients to the means of x, xx and xy.
struct Slopes<'a> {
    value: &'a mut [f32],
    x: &'a mut [f32],
    xx: &'a mut [f32],
    xy: &'a mut [f32],
}

vectorised! {
    /// SSIM of every pixel from the windowed means of x, y, xx, yy and xy.
    fn ssim_pixels(means: [&[f32]; 5], weight: &[f32], out: &mut Slopes) {
        let n = weight.len();
        let [mx, my, xx, yy, xy] = means;
        let (mx, my, xx, yy, xy) = (&mx[..n], &my[..n], &xx[..n], &yy[..n], &xy[..n]);
        let Slopes { value, x, xx: d_xx, xy: d_xy } = out;
        let (value, d_mx, d_xx, d_xy) = (&mut value[..n], &mut x[..n], &mut d_xx[..n], &mut d_xy[..n]);
        for i in 0..n {
            let (a, b) = (mx[i], my[i]);
            // In a bright uniform area only rounding errors remain: a variance below zero, where SSIM has a pole, and a
            // covariance beyond the Cauchy–Schwarz bound of the variances.
            let (vx, vy) = (most(xx[i] - a * a, 0.0), most(yy[i] - b * b, 0.0));
            let bound = (vx * vy).sqrt();
            let cov = -most(-most(xy[i] - a * b, -bound), -bound);
            let (l_num, l_den) = (2.0 * a * b + C1, a * a + b * b + C1);
            let (c_num, c_den) = (2.0 * cov + C2, vx + vy + C2);
            let ssim = (l_num * c_num) / (l_den * c_den);
            value[i] = weight[i] * ssim;
            // Partial derivatives with vx = xx - a², cov = xy - a b.
            let d_cov = weight[i] * 2.0 * l_num / (l_den * c_den);
            let d_vx = -weight[i] * ssim / c_den;
            d_xx[i] = d_vx;
            d_xy[i] = d_cov;
            d_mx[i] =
                weight[i] * (2.0 * b * c_num / (l_den * c_den) - 2.0 * a * ssim / l_den) - 2.0 * a * d_vx - b * d_cov;
        }
    }
}

/// SSIM per pixel of two planes, and the gradient of `Σ weight · SSIM` to the first.
fn ssim_plane(x: &[f32], y: &[f32], width: usize, weight: &[f32]) -> (f64, Vec<f32>) {
    let height = x.len() / width;
    let product = |a: &[f32], b: &[f32], out: &mut [f32]| {
        out.iter_mut().zip(a).zip(b).for_each(|((out, a), b)| *out = a * b);
    };
    let mut slopes = [(); 3].map(|()| vec![0.0f32; x.len()]);
    let [d_mx, d_xx, d_xy] = &mut slopes;
    let strips = d_mx
        .par_chunks_mut(ROWS * width)
        .zip(d_xx.par_chunks_mut(ROWS * width))
        .zip(d_xy.par_chunks_mut(ROWS * width))
        .enumerate();
    let totals: Vec<f64> = strips
        .map_init(
            || (Strip::new(width, height), vec![0.0; width]),
            |(strip, value), (number, ((d_mx, d_xx), d_xy))| {
                let mut total = 0.0f64;
                let fill = |plane: usize, row: usize, out: &mut [f32]| {
                    let (x, y) = (&x[row * width..(row + 1) * width], &y[row * width..(row + 1) * width]);
                    match plane {
                        0 => out.copy_from_slice(x),
                        1 => out.copy_from_slice(y),
                        2 => product(x, x, out),
                        3 => product(y, y, out),
                        _ => product(x, y, out),
                    }
                };
                strip.convolve(number, fill, |row, means| {
                    let own = row * width..(row + 1) * width;
                    let start = (number * ROWS + row) * width;
                    let mut out = Slopes {
                        value: value.as_mut_slice(),
                        x: &mut d_mx[own.clone()],
                        xx: &mut d_xx[own.clone()],
                        xy: &mut d_xy[own],
                    };
                    ssim_pixels(means, &weight[start..start + width], &mut out);
                    total += value.iter().map(|&v| f64::from(v)).sum::<f64>();
                });
                total
            },
        )
        .collect();
    let mut gradient = vec![0.0f32; x.len()];
    gradient.par_chunks_mut(ROWS * width).enumerate().for_each_init(
        || Strip::new(width, height),
        |strip, (number, out)| {
            let fill = |plane: usize, row: usize, out: &mut [f32]| {
                out.copy_from_slice(&slopes[plane][row * width..(row + 1) * width]);
            };
            strip.convolve(number, fill, |row, [d_mx, d_xx, d_xy]: [&[f32]; 3]| {
                let start = (number * ROWS + row) * width;
                let out = &mut out[row * width..(row + 1) * width];
                let (x, y) = (&x[start..start + width], &y[start..start + width]);
                for i in 0..width {
                    out[i] = d_mx[i] + 2.0 * x[i] * d_xx[i] + y[i] * d_xy[i];
                }
            });
        },
    );
    (totals.iter().sum(), gradient)
}

/// The loss between a rendered and a true image, and its gradient to the rendered one.
///
/// `weight` is per pixel, 0 to 1; a pixel of weight zero is ignored, and one whose truth is missing in a band is
/// ignored in that band. The value is a mean over the weighted pixels and bands.
pub fn photometric(image: &Raster, truth: &Raster, weight: &[f32], lambda_ssim: f32) -> (f64, Raster) {
    let mut gradient = Raster::filled(image.width, image.height, image.bands, 0.0);
    let plane = image.plane_len().max(1);
    let values: Vec<f64> = gradient
        .values
        .par_chunks_mut(plane)
        .enumerate()
        .map(|(band, out)| band_loss(image, truth, band, weight, lambda_ssim, out))
        .collect();
    (values.iter().sum(), gradient)
}

/// One band's part of the loss, and of its gradient.
fn band_loss(image: &Raster, truth: &Raster, band: usize, weight: &[f32], lambda_ssim: f32, out: &mut [f32]) -> f64 {
    let (x, t) = (image.plane(band), truth.plane(band));
    let weight: Vec<f32> = weight
        .iter()
        .zip(t)
        .map(|(&w, t)| if t.is_finite() { w } else { 0.0 })
        .collect();
    let norm: f64 = weight.iter().map(|&w| f64::from(w)).sum::<f64>() * image.bands as f64;
    if norm <= 0.0 {
        return 0.0;
    }
    let plane = x.len();
    // Ignored pixels take the rendered value as truth, so that the SSIM window sees no artificial edge.
    let y: Vec<f32> = (0..plane).map(|i| if weight[i] > 0.0 { t[i] } else { x[i] }).collect();
    let inverse = (1.0 / norm) as f32;
    let (ssim, d_ssim) = if lambda_ssim > 0.0 {
        ssim_plane(x, &y, image.width, &weight)
    } else {
        (norm / image.bands as f64, vec![0.0; plane])
    };
    let mut l1 = 0.0f64;
    for i in 0..plane {
        let difference = x[i] - y[i];
        l1 += f64::from(weight[i] * difference.abs());
        // At equality the derivative is zero (`signum` of zero is one).
        let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
        let l1_part = (1.0 - lambda_ssim) * weight[i] * sign;
        let own = if weight[i] > 0.0 { d_ssim[i] } else { 0.0 };
        out[i] = (l1_part - lambda_ssim * own) * inverse;
    }
    let lambda = f64::from(lambda_ssim);
    (1.0 - lambda) * l1 / norm + lambda * (1.0 / image.bands as f64 - ssim / norm)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(seed: u32) -> Raster {
        let mut raster = Raster::filled(23, 17, 2, 0.0);
        for (i, v) in raster.values.iter_mut().enumerate() {
            let h = (i as u32)
                .wrapping_mul(2_654_435_761)
                .wrapping_add(seed.wrapping_mul(40_503));
            *v = 0.1 + 0.8 * ((h >> 8) & 0xffff) as f32 / 65_535.0;
        }
        raster
    }

    #[test]
    fn equal_images_have_no_loss_and_no_gradient() {
        let a = pattern(1);
        let (value, gradient) = photometric(&a, &a, &vec![1.0; a.plane_len()], 0.2);
        assert!(value.abs() < 1e-6);
        assert!(gradient.values.iter().all(|g| g.abs() < 1e-6));
    }

    #[test]
    fn the_gradient_matches_central_differences() {
        let (image, truth) = (pattern(1), pattern(2));
        let mut weight = vec![1.0; image.plane_len()];
        weight[40] = 0.5;
        let (_, gradient) = photometric(&image, &truth, &weight, 0.6);
        let step = 1e-3;
        let (mut error, mut norm) = (0.0, 0.0);
        for i in 0..image.values.len() {
            let (mut hi, mut lo) = (image.clone(), image.clone());
            hi.values[i] += step;
            lo.values[i] -= step;
            let numeric = (photometric(&hi, &truth, &weight, 0.6).0 - photometric(&lo, &truth, &weight, 0.6).0)
                / (2.0 * f64::from(step));
            error += (numeric - f64::from(gradient.values[i])).powi(2);
            norm += numeric.powi(2);
        }
        assert!(
            error < 2e-2f64.powi(2) * norm,
            "relative error {}",
            (error / norm).sqrt()
        );
    }

    #[test]
    fn masked_and_missing_pixels_count_for_nothing() {
        let (image, mut truth) = (pattern(1), pattern(1));
        truth.values[30] = 99.0;
        truth.values[31] = f32::NAN;
        let mut weight = vec![1.0; image.plane_len()];
        weight[30] = 0.0;
        let (value, gradient) = photometric(&image, &truth, &weight, 0.2);
        assert!(value.abs() < 1e-6 && gradient.values.iter().all(|g| g.abs() < 1e-6));
    }
}
