//! The air of a scene from its images: optical depth and share of skylight of each band, for brightness under other
//! suns.
//!
//! Two kinds of evidence, both as logarithms:
//! * brightness of shadows relative to sunlit ground, image by image. It does not depend on exposure;
//! * brightness of sunlit ground relative to the reference image. It includes exposure and haze, so its deviation is
//!   that of the images, and never below [`EXPOSURE_SIGMA`].
//!
//! Each band's `τ` and `κ` are the most probable ones under this evidence (Huber's loss) and a weak prior of clear air,
//! found on a grid. The images' share of the information on `τ` follows from the curvatures with and without them.

use super::Daylight;
use heliosplat::model::Parameters;
use heliosplat::model::shadow_gs::ShadowGs;
use heliosplat::shade::daylight::{BandAir, OPTICAL_DEPTHS, SKY_SHARES};
use heliosplat_grid::statistics::{SIGMA_PER_MAD, median_absolute_deviation};
use rayon::prelude::*;

/// Optical depth of clear air, and the deviation of its logarithm: 0.1 to 0.4 is one deviation each way.
const DEPTH_PRIOR: (f64, f64) = (0.2, std::f64::consts::LN_2);
/// Share of scattered light that reaches the ground, and the deviation of its logarithm.
const SKY_PRIOR: (f64, f64) = (0.5, 0.4);
/// Air of a clear sky, the centre of the prior.
pub(crate) const CLEAR: BandAir = BandAir {
    optical_depth: DEPTH_PRIOR.0,
    sky_share: SKY_PRIOR.0,
};

/// Deviation of the logarithm of an image's shade: shadows are measured near walls and errors of the surface.
const SHADE_SIGMA: f64 = 0.25;
/// Least deviation of the logarithm of an image's gain.
const EXPOSURE_SIGMA: f64 = 0.1;
/// Deviations beyond which evidence counts less than its square.
const HUBER: f64 = 1.5;
/// Intervals of the search grid along each of the two parameters, and the number of refinements around its best node.
const STEPS: usize = 40;
const REFINEMENTS: usize = 2;

/// Evidence of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Elevation of the sun, radians.
    pub elevation_rad: f64,
    /// Brightness of shaded relative to sunlit ground, 0 to 1, per band; `None` where the image has too few pairs.
    pub shade: Vec<Option<f64>>,
    /// Brightness of sunlit ground relative to that of the reference image, per band; `None` for the reference image,
    /// and where images have no colour of their own.
    pub gain: Vec<Option<f64>>,
}

/// Evidence of a trained model: gains from its colours, and `shades` measured before training, because the initial
/// skies are too bright and a short training hardly changes them. `elevations_rad` are the elevations of the images'
/// suns, radians; images without a sun are left out.
pub fn evidence(
    model: &ShadowGs,
    parameters: &Parameters,
    elevations_rad: &[Option<f64>],
    shades: &[Vec<Option<f64>>],
) -> Vec<Evidence> {
    let bands = model.options.bands;
    let of_image = |(image, elevation): (usize, &Option<f64>)| {
        let (matrix, _) = model.colour(parameters, image);
        let own_colour = model.options.image_colour && image != model.options.reference;
        let white = |k: usize| matrix[k * bands..(k + 1) * bands].iter().map(|&v| f64::from(v)).sum();
        Some(Evidence {
            elevation_rad: (*elevation)?,
            shade: shades.get(image)?.clone(),
            gain: (0..bands).map(|k| own_colour.then(|| white(k))).collect(),
        })
    };
    elevations_rad.iter().enumerate().filter_map(of_image).collect()
}

/// Most probable light of day under the evidence of all images, relative to a reference image with a sun at an
/// elevation, radians. `None` without a reference sun above the horizon.
pub fn fit(evidence: &[Evidence], reference_elevation_rad: Option<f64>, bands: usize) -> Option<Daylight> {
    let reference = reference_elevation_rad.filter(|e| *e > 0.0)?;
    let up: Vec<&Evidence> = evidence.iter().filter(|e| e.elevation_rad > 0.0).collect();
    let elevations = up.iter().map(|e| e.elevation_rad);
    let suns_rad = elevations.fold([reference; 2], |[low, high], e| [low.min(e), high.max(e)]);
    let residuals = |k: usize, air: &BandAir| -> Vec<f64> {
        let residual = |e: &&Evidence| gain_residual(e, k, air, reference);
        up.iter().filter_map(residual).collect()
    };
    let spread = |k: usize, air: &BandAir| {
        let spread = median_absolute_deviation(&residuals(k, air));
        spread.unwrap_or(0.0) * SIGMA_PER_MAD
    };
    let fitted: Vec<(BandAir, f64)> = (0..bands)
        .into_par_iter()
        .map(|k| {
            let sigma = spread(k, &CLEAR).max(EXPOSURE_SIGMA);
            let band = Band {
                evidence: &up,
                k,
                reference,
                sigma,
            };
            let air = band.best();
            (air, band.images_decide(&air))
        })
        .collect();
    let sigmas = fitted.iter().enumerate().map(|(k, (air, _))| spread(k, air));
    Some(Daylight {
        exposure_sigma: sigmas.sum::<f64>() / bands.max(1) as f64,
        air: fitted.iter().map(|(air, _)| *air).collect(),
        reference_elevation_rad: reference,
        images_decide: fitted.iter().map(|(_, share)| *share).collect(),
        suns_rad,
    })
}

fn logarithm(value: Option<f64>) -> Option<f64> {
    value.filter(|v| *v > 0.0 && v.is_finite()).map(f64::ln)
}

fn gain_residual(e: &Evidence, k: usize, air: &BandAir, reference: f64) -> Option<f64> {
    let expected = air.level(e.elevation_rad) / air.level(reference);
    Some(logarithm(e.gain[k])? - expected.ln())
}

/// One band of the evidence.
struct Band<'a> {
    evidence: &'a [&'a Evidence],
    k: usize,
    reference: f64,
    /// Deviation of the gains.
    sigma: f64,
}

impl Band<'_> {
    fn images_cost(&self, air: &BandAir) -> f64 {
        let one = |e: &&Evidence| {
            let shade = logarithm(e.shade[self.k]).map(|s| (s - air.shade(e.elevation_rad).ln()) / SHADE_SIGMA);
            let gain = gain_residual(e, self.k, air, self.reference).map(|r| r / self.sigma);
            shade.map_or(0.0, huber) + gain.map_or(0.0, huber)
        };
        self.evidence.iter().map(one).sum()
    }

    fn cost(&self, air: &BandAir) -> f64 {
        self.images_cost(air) + prior_cost(air)
    }

    /// The least cost on a grid of logarithms, refined around its best node.
    fn best(&self) -> BandAir {
        let mut ranges = [OPTICAL_DEPTHS, SKY_SHARES].map(|range| range.map(f64::ln));
        let mut best = CLEAR;
        for _ in 0..=REFINEMENTS {
            let node = |[low, high]: [f64; 2], i: usize| low + (high - low) * i as f64 / STEPS as f64;
            let mut least = f64::INFINITY;
            for i in 0..=STEPS * STEPS + 2 * STEPS {
                let air = BandAir {
                    optical_depth: node(ranges[0], i / (STEPS + 1))
                        .exp()
                        .clamp(OPTICAL_DEPTHS[0], OPTICAL_DEPTHS[1]),
                    sky_share: node(ranges[1], i % (STEPS + 1))
                        .exp()
                        .clamp(SKY_SHARES[0], SKY_SHARES[1]),
                };
                let cost = self.cost(&air);
                if cost < least {
                    (least, best) = (cost, air);
                }
            }
            let around = |[low, high]: [f64; 2], at: f64| {
                let step = 2.0 * (high - low) / STEPS as f64;
                [(at.ln() - step).max(low), (at.ln() + step).min(high)]
            };
            ranges = [around(ranges[0], best.optical_depth), around(ranges[1], best.sky_share)];
        }
        best
    }

    /// 1 less the variance of `ln τ` with the images in units of its variance without them, 0 to 1.
    fn images_decide(&self, at: &BandAir) -> f64 {
        const STEP: f64 = 0.1;
        let moved = |i: f64, j: f64| {
            let air = BandAir {
                optical_depth: at.optical_depth * (i * STEP).exp(),
                sky_share: at.sky_share * (j * STEP).exp(),
            };
            self.cost(&air)
        };
        let here = moved(0.0, 0.0);
        let second = |i: f64, j: f64| (moved(i, j) + moved(-i, -j) - 2.0 * here) / (STEP * STEP);
        let (depth, sky) = (second(1.0, 0.0), second(0.0, 1.0).max(1e-9));
        let mixed = 0.5 * (second(1.0, 1.0) - depth - sky);
        let information = (depth - mixed * mixed / sky) / 2.0;
        let prior = 1.0 / (DEPTH_PRIOR.1 * DEPTH_PRIOR.1);
        (1.0 - prior / information.max(prior)).clamp(0.0, 1.0)
    }
}

/// Twice the negative logarithm of the probability of a value at a distance of `deviations`.
fn huber(deviations: f64) -> f64 {
    let size = deviations.abs();
    match size <= HUBER {
        true => size * size,
        false => HUBER * (2.0 * size - HUBER),
    }
}

fn prior_cost(air: &BandAir) -> f64 {
    let depth = (air.optical_depth / DEPTH_PRIOR.0).ln() / DEPTH_PRIOR.1;
    let sky = (air.sky_share / SKY_PRIOR.0).ln() / SKY_PRIOR.1;
    depth * depth + sky * sky
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evidence of images under these suns in an air, with exposures that differ by up to `exposure`.
    fn images(air: &BandAir, elevations_deg: &[f64], exposure: f64) -> Vec<Evidence> {
        let reference = elevations_deg.iter().copied().fold(0.0, f64::max).to_radians();
        let one = |(i, elevation_deg): (usize, &f64)| {
            let e = elevation_deg.to_radians();
            let own = 1.0 + exposure * (((i * 7) % 5) as f64 / 2.0 - 1.0);
            let gain = own * air.level(e) / air.level(reference);
            Evidence {
                elevation_rad: e,
                shade: vec![Some(air.shade(e))],
                gain: vec![(e < reference).then_some(gain)],
            }
        };
        elevations_deg.iter().enumerate().map(one).collect()
    }

    fn fitted(evidence: &[Evidence]) -> Daylight {
        let reference = evidence.iter().map(|e| e.elevation_rad).fold(0.0, f64::max);
        fit(evidence, Some(reference), 1).expect("a light")
    }

    #[test]
    fn clear_and_hazy_air_are_told_apart_under_many_suns() {
        for (optical_depth, sky_share) in [(0.08, 0.75), (0.3, 0.75), (0.15, 0.4), (0.35, 0.4)] {
            let air = BandAir {
                optical_depth,
                sky_share,
            };
            let light = fitted(&images(&air, &[25.0, 32.0, 41.0, 48.0, 55.0, 60.0, 66.0, 68.0], 0.1));
            // Very clear air is pulled most by the prior: at 12 degrees, half of the lowest sun in the evidence.
            for elevation_deg in [12.0, 30.0, 66.0f64] {
                let e = elevation_deg.to_radians();
                let expected = air.level(e) / air.level(light.reference_elevation_rad);
                assert!(
                    (light.gain(0, e) / expected - 1.0).abs() < 0.16,
                    "{air:?} {elevation_deg}: {}",
                    light.gain(0, e) / expected
                );
                assert!(
                    (light.shade(0, e) / air.shade(e)).ln().abs() < 0.2,
                    "{air:?} {elevation_deg}"
                );
            }
            assert!(light.images_decide[0] > 0.5, "{}", light.images_decide[0]);
        }
    }

    #[test]
    fn one_wild_exposure_does_not_matter() {
        let air = BandAir {
            optical_depth: 0.2,
            sky_share: 0.5,
        };
        let mut evidence = images(&air, &[30.0, 35.0, 40.0, 50.0, 55.0, 65.0], 0.0);
        evidence[0].gain = vec![Some(4.0)];
        let e = 15f64.to_radians();
        let light = fitted(&evidence);
        let expected = air.level(e) / air.level(light.reference_elevation_rad);
        assert!((light.gain(0, e) / expected - 1.0).abs() < 0.08);
    }

    #[test]
    fn without_evidence_the_air_is_clear_and_the_prior_decides() {
        let silent = Evidence {
            elevation_rad: 1.0,
            shade: vec![None],
            gain: vec![None],
        };
        let light = fitted(&[silent]);
        assert!((light.air[0].optical_depth / DEPTH_PRIOR.0).ln().abs() < 0.01);
        assert!(light.images_decide[0] < 0.01, "{}", light.images_decide[0]);
        assert!(fit(&[], None, 1).is_none());
        assert!(fit(&[], Some(-0.1), 1).is_none());
    }

    #[test]
    fn nonsense_stays_within_bounds() {
        for shade in [1e-6, 50.0] {
            for gain in [1e-6, 1e6] {
                let evidence: Vec<Evidence> = (1..9)
                    .map(|i| Evidence {
                        elevation_rad: 0.15 * f64::from(i),
                        shade: vec![Some(shade)],
                        gain: vec![Some(gain)],
                    })
                    .collect();
                assert!(fitted(&evidence).is_possible(1));
            }
        }
    }
}
