//! Shadow masks of images: shadows are traced, and the image refines their borders.
//!
//! A traced border is off by the error in altitude times the length of the shadow, a pixel or two. For each pixel
//! beside it there are two predictions, shaded `d` and lit `l`; its visibility `s` follows from `c = d + s (l - d)`,
//! `c` the image, by least squares over the bands, each weighted by its noise. The traced visibility is the prior, with
//! a standard deviation of 0.2; it stays where a surface is too dark to decide.

use heliosplat::Raster;
use heliosplat_grid::in_parallel;
use heliosplat_grid::statistics::{SIGMA_PER_MAD, upper_median};
use rayon::prelude::*;

/// Standard deviation of the traced visibility near the border of a shadow.
const TRACED: f32 = 0.2;
/// Distance from a traced border within which the image counts, pixels: farther off, dark pixels may be dark for
/// another reason.
const REACH_PX: usize = 4;
/// Least noise of an image, in units of its values.
const LEAST_NOISE: f32 = 1e-3;

/// Rasters from which the shadow mask of an image is made, all of one size.
pub struct Evidence<'a> {
    /// Traced visibility of the sun from each pixel, 0 to 1; `NaN` where unknown.
    pub traced: &'a Raster,
    /// Rendering of the image by the model.
    pub rendered: &'a Raster,
    /// Rendering without sun.
    pub shaded: &'a Raster,
    /// Rendering without cast shadows.
    pub lit: &'a Raster,
    /// The image itself; `NaN` where it has no value.
    pub image: &'a Raster,
}

impl Evidence<'_> {
    /// Visibility of the sun from each pixel by trace and image together, 0 to 1; `NaN` where the trace has none.
    pub fn visibility(&self) -> Raster {
        let near = near_border(self.traced);
        let weights: Vec<f32> = (0..self.image.bands).map(|band| self.noise(band).powi(-2)).collect();
        let value = |(i, &traced): (usize, &f32)| match near[i] {
            true => self.weighed(i, traced, &weights),
            false => traced,
        };
        let values = self.traced.values.par_iter().enumerate().map(value).collect();
        Raster { values, ..*self.traced }
    }

    /// Least squares of one pixel, with the traced visibility as prior.
    fn weighed(&self, i: usize, traced: f32, weights: &[f32]) -> f32 {
        let (mut known, mut told) = (TRACED.powi(-2), traced * TRACED.powi(-2));
        for (band, weight) in weights.iter().enumerate() {
            let shaded = self.shaded.plane(band)[i];
            let range = self.lit.plane(band)[i] - shaded;
            let information = weight * range * range;
            let word = weight * range * (self.image.plane(band)[i] - shaded);
            if information.is_finite() && word.is_finite() {
                known += information;
                told += word;
            }
        }
        (told / known).clamp(0.0, 1.0)
    }

    /// Standard deviation of a band from its rendering, by the median so that cars and edges count little.
    fn noise(&self, band: usize) -> f32 {
        let pairs = self.image.plane(band).iter().zip(self.rendered.plane(band));
        let sizes = pairs.map(|(a, b)| (a - b).abs()).filter(|d| d.is_finite());
        let mut sizes: Vec<f32> = sizes.collect();
        upper_median(&mut sizes).map_or(1.0, |size| (SIGMA_PER_MAD as f32 * size).max(LEAST_NOISE))
    }
}

/// Pixels with both light and shadow within [`REACH_PX`].
fn near_border(traced: &Raster) -> Vec<bool> {
    let (width, height) = (traced.width, traced.height);
    // Light and shadow seen within reach, first along rows, then along columns.
    let own: Vec<[bool; 2]> = traced.values.iter().map(|&v| [v >= 0.5, v < 0.5]).collect();
    let spread = |from: &[[bool; 2]], along: usize, length: usize| -> Vec<[bool; 2]> {
        in_parallel(from.len())
            .map(|i| {
                let place = i / along % length;
                let (first, last) = (place.saturating_sub(REACH_PX), (place + REACH_PX).min(length - 1));
                (first..=last).fold([false; 2], |any, p| {
                    let [light, shadow] = from[i + p * along - place * along];
                    [any[0] | light, any[1] | shadow]
                })
            })
            .collect()
    };
    let both = spread(&spread(&own, 1, width), width, height);
    both.iter().map(|[light, shadow]| *light && *shadow).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(values: &[f32]) -> Raster {
        Raster::of_plane(values.len(), 1, values.to_vec())
    }

    /// A row whose left half lies in shadow by the trace; surfaces of brightness `albedo`, a third of it from the sky.
    fn seen(traced: &[f32], image: &[f32], albedo: f32) -> Vec<f32> {
        let (shaded, lit) = (vec![albedo / 3.0; traced.len()], vec![albedo; traced.len()]);
        let rendered: Vec<f32> = traced.iter().map(|s| albedo / 3.0 + s * albedo * 2.0 / 3.0).collect();
        let evidence = Evidence {
            traced: &row(traced),
            rendered: &row(&rendered),
            shaded: &row(&shaded),
            lit: &row(&lit),
            image: &row(image),
        };
        evidence.visibility().values
    }

    #[test]
    fn a_border_moves_to_where_the_image_shows_it() {
        let mut traced = vec![0.0; 12];
        traced[6..].fill(1.0);
        let mut image = vec![0.2; 12];
        image[8..].fill(0.6);
        let found = seen(&traced, &image, 0.6);
        assert!(found[..8].iter().all(|&s| s < 0.05), "{found:?}");
        assert!(found[8..].iter().all(|&s| s > 0.95), "{found:?}");
    }

    #[test]
    fn dark_ground_far_from_a_traced_shadow_is_not_one() {
        let mut traced = vec![0.0; 24];
        traced[4..].fill(1.0);
        let mut image: Vec<f32> = traced.iter().map(|s| 0.2 + 0.4 * s).collect();
        image[14] = 0.2;
        assert_eq!(seen(&traced, &image, 0.6)[14], 1.0);
    }

    #[test]
    fn the_trace_decides_where_the_image_cannot() {
        let mut traced = vec![0.1; 12];
        traced[6..].fill(0.9);
        // As dark as its noise: light and shadow differ by less than a thousandth.
        let found = seen(&traced, &[0.0; 12], 1e-4);
        assert!(
            found.iter().zip(&traced).all(|(a, b)| (a - b).abs() < 0.01),
            "{found:?}"
        );
        // And where it has no value.
        let found = seen(&traced, &[f32::NAN; 12], 0.6);
        assert!(
            found.iter().zip(&traced).all(|(a, b)| (a - b).abs() < 1e-6),
            "{found:?}"
        );
    }

    #[test]
    fn what_is_not_known_stays_so() {
        let found = seen(&[0.0, f32::NAN, 1.0, 1.0], &[0.2, 0.2, 0.2, 0.6], 0.6);
        assert!(found[1].is_nan() && found[2] < 0.05 && found[3] > 0.95, "{found:?}");
    }
}
