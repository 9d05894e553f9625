//! Values at which an image was clipped: they say "at least this bright".

use heliosplat::Raster;

/// So many pixels share the greatest value of a band where it is clipped: the brightest glint alone is not.
const FEWEST: usize = 16;
/// So many times more pixels have it than the next value below, though greater values are rarer otherwise.
const TIMES: usize = 2;

/// The value at which each band of an image was clipped, infinite where it was not.
pub fn ceilings(image: &Raster) -> Vec<f32> {
    (0..image.bands).map(|band| ceiling(image.plane(band))).collect()
}

/// Share of the known values of an image that were clipped.
pub fn share(image: &Raster) -> f64 {
    let (mut clipped, mut known) = (0usize, 0usize);
    for (band, ceiling) in ceilings(image).into_iter().enumerate() {
        for value in image.plane(band).iter().filter(|v| v.is_finite()) {
            known += 1;
            clipped += usize::from(*value >= ceiling);
        }
    }
    clipped as f64 / known.max(1) as f64
}

fn ceiling(values: &[f32]) -> f32 {
    // NaN is neither below nor above anything.
    let greatest = |below: f32| {
        values
            .iter()
            .copied()
            .filter(|v| *v < below)
            .fold(f32::NEG_INFINITY, f32::max)
    };
    let most = greatest(f32::INFINITY);
    let next = greatest(most);
    let count = |value: f32| values.iter().filter(|v| **v == value).count();
    // An even image has nothing below its greatest value.
    let clipped = next.is_finite() && count(most) >= FEWEST && count(most) > TIMES * count(next);
    if clipped { most } else { f32::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of 0 to 1 as a bell of roofs, clipped at `at`.
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
    fn a_dark_image_of_few_counts_is_not_clipped_at_its_brightest() {
        let mut image = image(9.0);
        let counts = |value: &mut f32| *value = (*value * 20.0).floor();
        image.values.iter_mut().for_each(counts);
        assert!(image.values.iter().filter(|v| **v == 18.0).count() >= FEWEST);
        assert!(image.values.iter().all(|v| v.is_nan() || *v <= 18.0));
        assert_eq!(ceilings(&image), [f32::INFINITY]);
    }
}
