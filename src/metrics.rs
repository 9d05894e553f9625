//! Image metrics.

/// Peak signal-to-noise ratio in decibels for a peak of one, over the pixels of positive weight where truth is finite.
pub fn psnr(image: &crate::Raster, truth: &crate::Raster, weight: &[f32]) -> f64 {
    let plane = image.plane_len();
    let (mut sum, mut count) = (0.0f64, 0usize);
    for (i, (a, t)) in image.values.iter().zip(&truth.values).enumerate() {
        if weight[i % plane] > 0.0 && t.is_finite() {
            sum += f64::from(a - t).powi(2);
            count += 1;
        }
    }
    -10.0 * (sum / count.max(1) as f64).max(1e-12).log10()
}
