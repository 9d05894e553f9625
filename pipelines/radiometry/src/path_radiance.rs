//! The path radiance of the reference image: the light that the air adds to every pixel, lit or not.
//!
//! Each image has a gain and an offset with respect to one of them, the reference. No difference between images
//! determines the reference's own offset; at zero, its path radiance counts as albedo, and no shadow can be darker than
//! that. Shadows determine it: ground with the value `x` in the sun has the value `y = p + s (x - p)` in a shadow,
//! where `p` is the path radiance and `s` the sky's share of the light. With the least possible share, each pair of
//! values gives an upper bound of `p`, and the least of these is taken: the dark-object subtraction of P. S. Chavez
//! ("An improved dark-object subtraction technique for atmospheric scattering correction of multispectral data", Remote
//! Sensing of Environment 24, 1988), with shadows as the dark objects.

use heliosplat_grid::statistics::upper_median;

/// Least share of skylight in the light on level ground: a clear sky, in red and near infrared.
const LEAST_SKY: f32 = 0.1;
/// Share of the bound that is used. Subtracting too little costs less than subtracting too much, which leaves dark
/// ground without albedo (docs/lab/faults.md).
const BOUND_SHARE: f32 = 0.85;
/// Fewest pairs of a bin, whose medians are used.
const FEWEST_PAIRS: usize = 40;
/// Most bins of one view's pairs, by the brightness of the ground in the sun.
const MOST_BINS: usize = 12;

/// Values of one place in a band, in the counts of the reference image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pair {
    /// In the sun, by two disjoint halves of the views that show it there: places are sorted by one half and measured
    /// by the other, so that noise makes none of them look darker than it is.
    pub(crate) lit: [f32; 2],
    /// In the shadow.
    pub(crate) shaded: f32,
}

/// The path radiance of a band, in the counts of the reference image, from the pairs of each view; 0 where there are
/// too few.
pub(crate) fn of_band(pairs: Vec<Vec<Pair>>) -> f32 {
    let bounds = pairs.into_iter().flat_map(bounds);
    let least = bounds.fold(f32::INFINITY, f32::min);
    if least.is_finite() {
        BOUND_SHARE * least.max(0.0)
    } else {
        0.0
    }
}

/// Upper bounds of the path radiance by the pairs of one view.
fn bounds(mut pairs: Vec<Pair>) -> Vec<f32> {
    pairs.sort_by(|a, b| a.lit[0].total_cmp(&b.lit[0]));
    let size = (pairs.len() / MOST_BINS).max(FEWEST_PAIRS);
    let median = |values: &mut dyn Iterator<Item = f32>| upper_median(&mut values.collect::<Vec<f32>>());
    let bin = |pairs: &[Pair]| {
        let lit = median(&mut pairs.iter().map(|pair| pair.lit[1]))?;
        let shaded = median(&mut pairs.iter().map(|pair| pair.shaded))?;
        Some((shaded - LEAST_SKY * lit) / (1.0 - LEAST_SKY))
    };
    pairs.chunks_exact(size).filter_map(bin).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ground of many albedos under a sky that gives `sky` of the light, with noise in every value.
    fn pairs(path_radiance: f32, sky: f32, count: usize) -> Vec<Pair> {
        let noise = |i: usize, k: usize| (((i * 7919 + k * 104_729) % 1009) as f32 / 1009.0 - 0.5) * 0.04;
        let value = |albedo: f32, light: f32| path_radiance + albedo * light;
        (0..count)
            .map(|i| {
                let albedo = 0.05 + 0.5 * (i as f32 / count as f32);
                Pair {
                    lit: [0, 1].map(|k| value(albedo, 1.0) + noise(i, k)),
                    shaded: value(albedo, sky) + noise(i, 2),
                }
            })
            .collect()
    }

    #[test]
    fn shadows_tell_the_path_radiance() {
        for path_radiance in [0.0, 0.1, 0.3] {
            let found = of_band(vec![pairs(path_radiance, 0.15, 2000), pairs(path_radiance, 0.4, 2000)]);
            let believed = BOUND_SHARE * path_radiance;
            assert!(
                found >= believed - 0.005 && found < believed + 0.02,
                "{found} for {path_radiance}"
            );
        }
    }

    #[test]
    fn a_few_places_tell_nothing() {
        assert_eq!(of_band(Vec::new()), 0.0);
        assert_eq!(of_band(vec![pairs(0.3, 0.2, FEWEST_PAIRS - 1)]), 0.0);
        assert!(of_band(vec![pairs(0.3, 0.2, FEWEST_PAIRS)]) > 0.0);
    }

    #[test]
    fn shadows_darker_than_any_sky_are_no_negative_light() {
        assert_eq!(of_band(vec![pairs(0.0, 0.0, 2000)]), 0.0);
    }
}
