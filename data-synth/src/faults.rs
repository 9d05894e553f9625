//! Faults of real images that the plain generator leaves out, each requested by name: gains of bands, haze, and the
//! stretch of display images. `radiometry`, `gloss` and `clouds` make interreflection, glossy surfaces and large
//! clouds, and `cover` sea and snow.
//!
//! Every fault has its own random streams, so that requesting it leaves all else as it is.

use crate::materials::Spectrum;
use crate::noise::{hash2, normal, stream};
use crate::request::BandSet;
use heliosplat_grid::statistics::quantile;
use rand::RngExt;
use serde::{Deserialize, Serialize};

/// Largest factor between the sensor's gain of a band and that of the mean band, as a logarithm.
const SENSOR_GAIN_LOG: f64 = 0.3;
/// Standard deviation of a band's gain from image to image, as a logarithm.
const IMAGE_GAIN_LOG: f64 = 0.06;

/// Gains of the four bands of an image relative to the mean gain of the collection.
pub(crate) fn band_gains(seed: u64, image: usize) -> [f64; 4] {
    let mut random = stream(seed, 0x6A1);
    let sensor: [f64; 4] = std::array::from_fn(|_| random.random_range(-SENSOR_GAIN_LOG..SENSOR_GAIN_LOG));
    // The gains common to all images have mean 1 over red, green and blue: exposure is separate.
    let mean = sensor[..3].iter().sum::<f64>() / 3.0;
    std::array::from_fn(|band| {
        let draw = normal(hash2(hash2(seed, 0x6A2), (4 * image + band) as u64)).clamp(-2.5, 2.5);
        (sensor[band] - mean + IMAGE_GAIN_LOG * draw).exp()
    })
}

/// A level layer of haze between the ground and the satellite.
///
/// The radiance above it is `J t + A (1 - t)`, with the radiance `J` without haze, the transmittance
/// `t = exp(-δ / (2 cos θ))` of each band (half of the scattered light goes forward) and the airlight `A` of an
/// infinite layer (H. Koschmieder, "Theorie der horizontalen Sichtweite", 1924; E. J. McCartney, "Optics of the
/// Atmosphere", 1976). The sun's beam loses all of `δ` on its way down; most of that arrives as skylight, so shadows
/// get paler.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Haze {
    /// Optical depth `δ` in red, straight down.
    pub depth: f64,
    /// Reflectance of an infinite layer, 0 to 1, which determines the airlight `A`.
    pub airlight: f64,
}

/// The scattering of fine droplets and dust falls with wavelength by this power (Ångström's exponent).
const ANGSTROM: f64 = 1.3;
/// Centres of red, green, blue and near infrared, nanometres.
const WAVELENGTH_NM: [f64; 4] = [655.0, 550.0, 480.0, 830.0];

impl Haze {
    /// Random haze of a date: optical depth 0.05 to 0.6, reflectance 0.32 to 0.48.
    pub(crate) fn of_date(seed: u64, date: usize) -> Self {
        let mut random = stream(hash2(seed, 0x4A2E), date as u64);
        Self {
            depth: random.random_range(0.05..0.6),
            airlight: random.random_range(0.32..0.48),
        }
    }

    /// Optical depth of each band, straight down.
    pub(crate) fn depths(&self) -> Spectrum {
        Spectrum::from_fn(|band, _| self.depth * (WAVELENGTH_NM[band] / WAVELENGTH_NM[0]).powf(-ANGSTROM))
    }
}

/// Stretch of an image for display: `255 ((count - low) / (high - low))^(1 / gamma)`, clipped to 1..255.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stretch {
    /// Count of each band that becomes black.
    pub low: Vec<f64>,
    /// Count of each band that becomes white.
    pub high: Vec<f64>,
    /// Gamma, the inverse of the exponent.
    pub gamma: f64,
}

/// Range of the share of an image's pixels that is clipped at either end.
const CLIPPED_SHARE: [f64; 2] = [0.005, 0.02];
/// Range of the gammas, one per image.
const GAMMA: [f64; 2] = [1.4, 2.2];

/// Stretches linear counts, bands interleaved, to 1..255 in place, and returns the stretch. 0, "no data", stays 0.
pub(crate) fn stretch(counts: &mut [u16], bands: BandSet, seed: u64) -> Stretch {
    let bands = bands.names().len();
    let mut random = stream(seed, 0x57E);
    let gamma: f64 = random.random_range(GAMMA[0]..GAMMA[1]);
    let clipped: f64 = random.random_range(CLIPPED_SHARE[0]..CLIPPED_SHARE[1]);
    let mut made = Stretch {
        low: Vec::with_capacity(bands),
        high: Vec::with_capacity(bands),
        gamma,
    };
    for band in 0..bands {
        let known = counts.iter().skip(band).step_by(bands).filter(|&&count| count > 0);
        let mut known: Vec<f64> = known.map(|&count| f64::from(count)).collect();
        let mut percentile = |share: f64| quantile(&mut known, share).unwrap_or(0.0);
        let low = percentile(clipped);
        let high = percentile(1.0 - clipped).max(low + 1.0);
        for count in counts.iter_mut().skip(band).step_by(bands).filter(|count| **count > 0) {
            let share = ((f64::from(*count) - low) / (high - low)).clamp(0.0, 1.0);
            *count = (255.0 * share.powf(1.0 / gamma)).round().clamp(1.0, 255.0) as u16;
        }
        made.low.push(low);
        made.high.push(high);
    }
    made
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_of_bands_differ_much_between_bands_and_little_between_images() {
        for seed in 0..20 {
            let gains: Vec<[f64; 4]> = (0..12).map(|image| band_gains(seed, image)).collect();
            for band in 0..4 {
                let values: Vec<f64> = gains.iter().map(|gain| gain[band]).collect();
                let low = values.iter().copied().fold(f64::INFINITY, f64::min);
                let high = values.iter().copied().fold(0.0, f64::max);
                assert!(
                    low > 0.4 && high < 2.2 && high / low < 1.5 && high > low,
                    "{seed}: {low} {high}"
                );
            }
        }
        let spread = |seed: u64| {
            let gains = band_gains(seed, 0);
            gains[3] / gains[0]
        };
        assert!((0..20).any(|seed| !(0.8..1.25).contains(&spread(seed))));
    }

    #[test]
    fn haze_is_deeper_in_blue_and_of_another_depth_on_each_date() {
        let (first, second) = (Haze::of_date(3, 0), Haze::of_date(3, 1));
        assert_ne!(first, second);
        let depths = first.depths();
        assert!(depths.z > 1.3 * depths.x && depths.w < 0.8 * depths.x);
        assert!((depths.x - first.depth).abs() < 1e-12);
    }

    #[test]
    fn a_stretched_image_has_both_ends_clipped_keeps_its_order_and_its_missing_pixels() {
        let linear: Vec<u16> = (0..3000u32)
            .map(|k| if k < 30 { 0 } else { (100 + k * 7 % 1500) as u16 })
            .collect();
        let mut display = linear.clone();
        let made = stretch(&mut display, BandSet::Rgb, 5);
        assert!(display[..30].iter().all(|&count| count == 0));
        assert!(display[30..].iter().all(|count| (1..=255).contains(count)));
        for band in 0..3 {
            let of_band = || (30..3000).filter(|k| k % 3 == band);
            let share = |value: u16| of_band().filter(|&k| display[k] == value).count() as f64 / 990.0;
            assert!((0.004..0.03).contains(&share(1)) && (0.004..0.03).contains(&share(255)));
            for k in of_band() {
                let count = f64::from(linear[k]);
                let expected = ((count - made.low[band]) / (made.high[band] - made.low[band])).clamp(0.0, 1.0);
                let expected = 255.0 * expected.powf(1.0 / made.gamma);
                assert!((f64::from(display[k]) - expected.max(1.0)).abs() <= 0.5);
            }
        }
    }
}
