//! Rendered images against real ones: PSNR and SSIM over the pixels known in both.
//!
//! The SSIM differs from that of the training loss (`heliosplat::loss::photometric`). A metric counts only windows
//! inside the image and without missing pixels. The loss must have a gradient at every pixel: its windows reach beyond
//! the border, where it takes zeros, and it replaces missing truth by the rendering. The loss is also in `f32`, whose
//! rounding of `E[x²] - E[x]²` in bright uniform areas is 1e-7 relative to K2² = 9e-4, an error of the index up to
//! 1e-4.

use heliosplat::Raster;
use rayon::prelude::*;

/// Scores of rendered images: `test` of `metrics.json`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ImageScore {
    /// Peak signal-to-noise ratio, dB, of all bands together, for values with a peak of 1.
    pub psnr: f64,
    /// PSNR of red, green and blue alone, as in papers; absent if the image has no other bands.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub psnr_rgb: Option<f64>,
    /// Structural similarity, mean over pixels and bands, -1..1.
    pub ssim: f64,
}

/// Scores a rendered image against a real one of the same size, both in 0..1. `None` when no pixel is known in both.
/// `rgb` are the planes of red, green and blue, where there are others too.
pub fn score_image(rendered: &Raster, real: &Raster, rgb: Option<[usize; 3]>) -> Option<ImageScore> {
    let colours = |image: &Raster, rgb: [usize; 3]| Raster {
        bands: 3,
        values: rgb.iter().flat_map(|&band| image.plane(band)).copied().collect(),
        ..*image
    };
    Some(ImageScore {
        psnr: psnr(rendered, real)?,
        psnr_rgb: rgb.and_then(|rgb| psnr(&colours(rendered, rgb), &colours(real, rgb))),
        ssim: ssim(rendered, real)?,
    })
}

/// Peak signal-to-noise ratio, dB: `-10 log10(MSE / peak²)`, infinite where the error is zero. `peak` is in the unit of
/// the values.
pub fn psnr_db(mean_square_error: f64, peak: f64) -> f64 {
    -10.0 * (mean_square_error / (peak * peak)).log10()
}

/// Peak signal-to-noise ratio of two images with a peak of 1, dB; `None` when no pixel is known in both.
pub fn psnr(rendered: &Raster, real: &Raster) -> Option<f64> {
    let differences = rendered.values.iter().zip(&real.values).map(|(a, b)| f64::from(a - b));
    let known = differences.filter(|difference| difference.is_finite());
    let (sum, count) = known.fold((0.0, 0usize), |(sum, count), d| (sum + d * d, count + 1));
    (count > 0).then(|| psnr_db(sum / count as f64, 1.0))
}

/// Structural similarity (Wang et al. 2004): Gaussian window of 11 pixels, σ 1.5, K1 0.01, K2 0.03, peak 1. Only
/// windows that lie inside the image and hold no missing pixel count; the mean is over those and all bands, -1..1.
/// `None` for an image of ten pixels or fewer on a side, and without such a window.
pub fn ssim(rendered: &Raster, real: &Raster) -> Option<f64> {
    const RADIUS: usize = 5;
    let (width, height) = (real.width, real.height);
    if width <= 2 * RADIUS || height <= 2 * RADIUS {
        return None;
    }
    let kernel = gaussian_kernel(RADIUS, 1.5);
    let of_band = |band| ssim_of_band(rendered.plane(band), real.plane(band), width, &kernel);
    let bands: Vec<(f64, usize)> = (0..real.bands).into_par_iter().map(of_band).collect();
    let sums = bands.iter();
    let (sum, count) = sums.fold((0.0, 0), |(sum, count), band| (sum + band.0, count + band.1));
    (count > 0).then(|| sum / count as f64)
}

fn gaussian_kernel(radius: usize, sigma: f64) -> Vec<f64> {
    let weight = |offset: f64| (-0.5 * (offset / sigma).powi(2)).exp();
    let weights = (0..=2 * radius).map(|index| weight(index as f64 - radius as f64));
    let weights: Vec<f64> = weights.collect();
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|weight| weight / sum).collect()
}

/// Sum of the index over valid windows, and their number. Missing pixels are NaN and make every window they are in NaN.
fn ssim_of_band(a: &[f32], b: &[f32], width: usize, kernel: &[f64]) -> (f64, usize) {
    let (c1, c2) = (0.01_f64.powi(2), 0.03_f64.powi(2));
    let smooth = |value: &dyn Fn(usize) -> f64| smoothed(value, width, a.len() / width, kernel);
    let at = |plane: &[f32], index: usize| f64::from(plane[index]);
    let mean_a = smooth(&|index| at(a, index));
    let mean_b = smooth(&|index| at(b, index));
    let square_a = smooth(&|index| at(a, index).powi(2));
    let square_b = smooth(&|index| at(b, index).powi(2));
    let product = smooth(&|index| at(a, index) * at(b, index));
    let (mut sum, mut count) = (0.0, 0);
    for index in 0..mean_a.len() {
        let (ma, mb) = (mean_a[index], mean_b[index]);
        let variance_a = (square_a[index] - ma * ma).max(0.0);
        let variance_b = (square_b[index] - mb * mb).max(0.0);
        let covariance = product[index] - ma * mb;
        let similarity = (2.0 * ma * mb + c1) * (2.0 * covariance + c2)
            / ((ma * ma + mb * mb + c1) * (variance_a + variance_b + c2));
        if similarity.is_finite() && !square_a[index].is_nan() && !square_b[index].is_nan() {
            sum += similarity;
            count += 1;
        }
    }
    (sum, count)
}

/// Separable convolution over windows that lie inside the image: `(width - 2 r) × (height - 2 r)` values.
fn smoothed(value: &dyn Fn(usize) -> f64, width: usize, height: usize, kernel: &[f64]) -> Vec<f64> {
    let inner = width + 1 - kernel.len();
    let mut across = vec![0.0; inner * height];
    for row in 0..height {
        let line: Vec<f64> = (0..width).map(|col| value(row * width + col)).collect();
        for col in 0..inner {
            let products = kernel.iter().zip(&line[col..]).map(|(weight, value)| weight * value);
            across[row * inner + col] = products.sum();
        }
    }
    let rows = height + 1 - kernel.len();
    let mut out = vec![0.0; inner * rows];
    for row in 0..rows {
        for (offset, weight) in kernel.iter().enumerate() {
            let from = &across[(row + offset) * inner..(row + offset + 1) * inner];
            for (sum, value) in out[row * inner..(row + 1) * inner].iter_mut().zip(from) {
                *sum += weight * value;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waves(phase: f32) -> Raster {
        let mut image = Raster::filled(40, 30, 2, 0.0);
        for (index, value) in image.values.iter_mut().enumerate() {
            *value = 0.5 + 0.3 * ((index % 40) as f32 * 0.4 + phase).sin();
        }
        image
    }

    #[test]
    fn equal_images_are_perfect_and_a_constant_error_has_its_psnr() {
        let image = waves(0.0);
        assert!((ssim(&image, &image).expect("windows") - 1.0).abs() < 1e-12);
        let mut brighter = image.clone();
        brighter.values.iter_mut().for_each(|value| *value += 0.1);
        assert!((psnr(&brighter, &image).expect("pixels") - 20.0).abs() < 1e-4);
    }

    #[test]
    fn structure_out_of_phase_is_dissimilar() {
        assert!(ssim(&waves(std::f32::consts::PI), &waves(0.0)).expect("windows") < 0.0);
    }

    #[test]
    fn missing_pixels_do_not_count() {
        let real = waves(0.0);
        let mut rendered = real.clone();
        rendered.values[5 * 40 + 5] = f32::NAN;
        assert_eq!(psnr(&rendered, &real), Some(f64::INFINITY));
        assert!((ssim(&rendered, &real).expect("windows") - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_index_follows_its_formula_on_flat_images() {
        // Flat images have no variance: only the luminance term is left.
        let (dark, bright) = (Raster::filled(16, 16, 1, 0.2), Raster::filled(16, 16, 1, 0.6));
        let want = (2.0 * 0.2 * 0.6 + 1e-4) / (0.04 + 0.36 + 1e-4);
        assert!((ssim(&dark, &bright).expect("windows") - want).abs() < 1e-6);
    }
}
