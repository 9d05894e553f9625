//! Encoding of radiance in the counts of a file: bands, noise, 8-bit display.

use crate::materials::Spectrum;
use crate::request::BandSet;

/// Weights of red, green, blue and near infrared in a panchromatic band (450 to 800 nm).
const PAN: [f64; 4] = [0.30, 0.27, 0.22, 0.21];

/// Bands of an image, and their number, from the red, green, blue and near infrared of the renderer. Unused values are
/// 0.
pub(crate) fn bands_of(spectrum: &Spectrum, bands: BandSet) -> ([f32; 4], usize) {
    match bands {
        BandSet::Pan => ([spectrum.dot(&Spectrum::from(PAN)) as f32, 0.0, 0.0, 0.0], 1),
        BandSet::Rgb => ([spectrum.x as f32, spectrum.y as f32, spectrum.z as f32, 0.0], 3),
        BandSet::RgbNir => (spectrum.map(|value| value as f32).into(), 4),
    }
}

/// Conversion of radiance to the counts of a file. Radiance is relative to the irradiance of the sun above the air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Encoding {
    /// Counts per unit of radiance.
    pub(crate) gain: f64,
    /// Noise relative to a good sensor's: 1 is a read noise of 2 counts and its shot noise, 0 is none.
    pub(crate) noise: f64,
    /// Bits per sample: 16 for linear counts, 8 for display values.
    pub(crate) bits: u8,
}

/// Largest count of an 11-bit sensor.
pub(crate) const FULL_COUNT: f64 = 2047.0;
/// Counts per unit of radiance at the mean exposure: a sunlit white roof stays below the largest count.
pub(crate) const MEAN_GAIN: f64 = 9500.0;
/// The count that is white in an 8-bit display image.
const DISPLAY_WHITE: f64 = 1500.0;

impl Encoding {
    /// Count of a radiance: 1 to 2047 with 16 bits, 1 to 255 with 8. `draw` is a standard normal number. 0 is kept for
    /// "no data".
    pub(crate) fn count(&self, radiance: f64, draw: f64) -> u16 {
        let clean = self.gain * radiance;
        // Read noise of 2 counts, and shot noise that grows with the square root of the signal.
        let sigma = self.noise * (4.0 + 0.05 * clean.max(0.0)).sqrt();
        let count = clean + sigma * draw;
        if self.bits == 8 {
            let display = srgb((count / DISPLAY_WHITE).clamp(0.0, 1.0));
            return (255.0 * display).round().clamp(1.0, 255.0) as u16;
        }
        count.round().clamp(1.0, FULL_COUNT) as u16
    }
}

/// The transfer curve of sRGB (IEC 61966-2-1).
pub(crate) fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn display_images_are_srgb_of_the_linear_counts() {
        let linear = Encoding {
            gain: MEAN_GAIN,
            noise: 0.0,
            bits: 16,
        };
        let display = Encoding { bits: 8, ..linear };
        let radiance = 0.5 * DISPLAY_WHITE / MEAN_GAIN;
        assert_eq!(linear.count(radiance, 0.0), 750);
        // sRGB of one half is 0.7354.
        assert_eq!(display.count(radiance, 0.0), 188);
        assert_eq!(display.count(10.0, 0.0), 255);
    }
}
