//! Clipped values of an image: the greatest value of a band is a lower bound of the brightness, the lowest an upper
//! bound.

use super::{Finding, Scene, Severity};
use heliosplat::Raster;
use rayon::prelude::*;

/// Least number of pixels with the greatest value in a clipped band: an unclipped band has its greatest value in fewer
/// pixels, such as the brightest glint.
const FEWEST: usize = 16;
/// Least ratio of that number to the number of pixels with the next lower value: without clipping, greater values are
/// rarer.
const TIMES: usize = 2;

/// Share of clipped values above which an image is warned of: the images of JAX_068, of which the brightest roofs are
/// clipped, have up to 0.06.
const MUCH: f64 = 0.2;

impl Scene {
    /// Warns about images of which much is clipped.
    pub(super) fn warn_of_clipped(&mut self) {
        let shares: Vec<f64> = self.images.par_iter().map(|image| share(&image.pixels)).collect();
        for (image, share) in self.images.iter().zip(shares).filter(|(_, share)| *share > MUCH) {
            let message = format!(
                "{}: {:.0} % of the values are the greatest of their band: clipped ground has no texture, and its heights are those \
                 of its surroundings; give the image as it was before a stretch, if there is one",
                image.name,
                100.0 * share
            );
            self.findings.push(Finding {
                code: "clipped",
                severity: Severity::Warning,
                files: vec![image.path.clone()],
                images: vec![image.name.clone()],
                value: Some(share),
                bound: Some(MUCH),
                message: message.clone(),
            });
            self.warnings.push(message);
        }
    }
}

/// Value at which each band of an image is clipped above; infinite where it is not clipped.
pub fn ceilings(image: &Raster) -> Vec<f32> {
    let bands = (0..image.bands).into_par_iter();
    bands.map(|band| ceiling(image.plane(band))).collect()
}

/// Value at which each band of an image is clipped below; minus infinity where it is not clipped.
pub fn floors(image: &Raster) -> Vec<f32> {
    let floor = |band: usize| {
        let mirrored: Vec<f32> = image.plane(band).iter().map(|value| -value).collect();
        -ceiling(&mirrored)
    };
    (0..image.bands).map(floor).collect()
}

/// Share of an image's known values that are clipped at the greatest value of their band, 0..1.
pub fn share(image: &Raster) -> f64 {
    share_where(image, &ceilings(image), |value, ceiling| value >= ceiling)
}

/// Share of an image's known values that are clipped at the lowest value of their band, 0..1.
pub fn share_below(image: &Raster) -> f64 {
    share_where(image, &floors(image), |value, floor| value <= floor)
}

fn share_where(image: &Raster, limits: &[f32], is_clipped: impl Fn(f32, f32) -> bool) -> f64 {
    let (mut clipped, mut known) = (0usize, 0usize);
    for (band, limit) in limits.iter().enumerate() {
        for value in image.plane(band).iter().filter(|v| v.is_finite()) {
            known += 1;
            clipped += usize::from(is_clipped(*value, *limit));
        }
    }
    clipped as f64 / known.max(1) as f64
}

/// True if most bands of an eight-bit image are clipped at 0 or 255. Sensors have ten bits and more, so their own
/// saturation would be at other values.
pub fn at_limits_of_eight_bits(image: &Raster) -> bool {
    let ends = ceilings(image).into_iter().zip(floors(image));
    let clipped = ends.filter(|(high, low)| *high == 255.0 || *low == 0.0);
    2 * clipped.count() > image.bands
}

fn ceiling(values: &[f32]) -> f32 {
    // Comparisons with NaN are false.
    let greatest = |below: f32| {
        let values = values.iter().copied().filter(|v| *v < below);
        values.fold(f32::NEG_INFINITY, f32::max)
    };
    let most = greatest(f32::INFINITY);
    let next = greatest(most);
    let count = |value: f32| values.iter().filter(|v| **v == value).count();
    // An even image has no value below its greatest.
    let clipped = next.is_finite() && count(most) >= FEWEST && count(most) > TIMES * count(next);
    if clipped { most } else { f32::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Image with bell-shaped values from 0 to 1, clipped at `at`; one pixel is NaN.
    fn image(at: f32) -> Raster {
        let mut image = Raster::filled(100, 100, 1, 0.0);
        for (i, value) in image.values.iter_mut().enumerate() {
            let sum: f32 = [7919, 104_729, 15_485_863]
                .map(|prime| (i * prime % 1009) as f32 / 1009.0)
                .iter()
                .sum();
            *value = (sum / 3.0).min(at);
        }
        image.values[5] = f32::NAN;
        image
    }

    #[test]
    fn many_equal_greatest_values_are_clipped() {
        assert_eq!(ceilings(&image(0.7)), [0.7]);
        let share = share(&image(0.7));
        assert!(share > 0.02 && share < 0.3, "{share}");
    }

    #[test]
    fn a_greatest_value_that_few_have_and_an_even_image_are_not() {
        assert_eq!(ceilings(&image(9.0)), [f32::INFINITY]);
        assert_eq!(share(&image(9.0)), 0.0);
        assert_eq!(ceilings(&Raster::filled(9, 9, 1, 3.0)), [f32::INFINITY]);
    }

    #[test]
    fn both_ends_are_found() {
        let mut stretched = image(0.7);
        stretched.values.iter_mut().for_each(|value| *value = value.max(0.3));
        assert_eq!((ceilings(&stretched), floors(&stretched)), (vec![0.7], vec![0.3]));
        let below = share_below(&stretched);
        assert!(below > 0.02 && below < 0.3, "{below}");
        assert_eq!(
            (floors(&image(0.7)), share_below(&image(0.7))),
            (vec![f32::NEG_INFINITY], 0.0)
        );
    }

    #[test]
    fn a_stretch_to_eight_bits_clips_at_their_limits_and_a_sensor_elsewhere() {
        let counts = |gain: f32, offset: f32| {
            let mut image = image(9.0);
            let stretch = |value: &mut f32| *value = (*value * gain + offset).round().clamp(0.0, 255.0);
            image.values.iter_mut().for_each(stretch);
            at_limits_of_eight_bits(&image)
        };
        assert!(counts(360.0, 0.0), "clipped above");
        assert!(counts(300.0, -80.0), "clipped below");
        assert!(!counts(200.0, 10.0));
        let mut saturated = image(0.7);
        saturated
            .values
            .iter_mut()
            .for_each(|value| *value = (*value * 300.0).round());
        assert!(!at_limits_of_eight_bits(&saturated));
    }

    #[test]
    fn a_dark_image_of_few_counts_is_not_clipped_at_its_brightest() {
        let mut image = image(9.0);
        let counts = |value: &mut f32| *value = (*value * 20.0).floor();
        image.values.iter_mut().for_each(counts);
        assert!(image.values.iter().filter(|v| **v == 18.0).count() >= FEWEST);
        assert!(image.values.iter().all(|v| v.is_nan() || *v <= 18.0));
        assert_eq!(ceilings(&image), [f32::INFINITY]);
    }
}
