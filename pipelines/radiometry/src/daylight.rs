//! Brightness of sunlit and shaded level ground under any sun, in counts of the reference image, fitted to the images
//! of a run.

mod air;

pub(crate) use air::CLEAR;
pub use air::{Evidence, evidence, fit};
use heliosplat::shade::daylight::BandAir;

/// Light of a scene as a function of the sun's elevation.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Daylight {
    /// Air of each band.
    pub air: Vec<BandAir>,
    /// Elevation of the reference image's sun, radians; brightness is relative to it.
    pub reference_elevation_rad: f64,
    /// Share of the information on each band's optical depth that comes from the images, 0 to 1; the rest is prior.
    pub images_decide: Vec<f64>,
    /// Lowest and highest elevation of the images' suns, radians.
    pub suns_rad: [f64; 2],
    /// Robust standard deviation of the images' own gains relative to those expected from their suns, as a share:
    /// exposure and haze.
    pub exposure_sigma: f64,
}

impl Daylight {
    /// Brightness of sunlit level ground in band `k` under a sun at an elevation, radians, relative to that under the
    /// sun of the reference image.
    pub fn gain(&self, k: usize, elevation_rad: f64) -> f64 {
        self.air[k].level(elevation_rad) / self.air[k].level(self.reference_elevation_rad)
    }

    /// Brightness of a shadow in band `k` relative to sunlit ground, 0 to 1, under a sun at an elevation, radians.
    pub fn shade(&self, k: usize, elevation_rad: f64) -> f64 {
        self.air[k].shade(elevation_rad)
    }

    /// True if there is a possible air and a share of 0 to 1 for each of `bands` bands, all suns are above the horizon,
    /// and the deviation is finite.
    pub fn is_possible(&self, bands: usize) -> bool {
        let above = |elevation: &f64| elevation.is_finite() && *elevation > 0.0 && elevation.sin() > 0.0;
        self.air.len() == bands
            && self.images_decide.len() == bands
            && self.air.iter().all(BandAir::is_possible)
            && self.images_decide.iter().all(|share| (0.0..=1.0).contains(share))
            && above(&self.reference_elevation_rad)
            && self.suns_rad.iter().all(above)
            && self.exposure_sigma.is_finite()
    }

    /// One line of text: optical depth and shadow of each band, and the share that the images determine.
    pub fn in_words(&self) -> String {
        let list = |value: &dyn Fn(usize) -> f64| {
            let values: Vec<String> = (0..self.air.len()).map(|k| format!("{:.2}", value(k))).collect();
            values.join(", ")
        };
        let [low, high] = self.suns_rad.map(f64::to_degrees);
        let decided: f64 = self.images_decide.iter().sum::<f64>() / self.air.len().max(1) as f64;
        let mut text = format!(
            "light of day, per band: optical depth {}, shadows under the sun of the reference image {} of sunlit ground; {:.0} % of it from suns at {low:.0} to {high:.0} degrees",
            list(&|k| self.air[k].optical_depth),
            list(&|k| self.shade(k, self.reference_elevation_rad)),
            100.0 * decided
        );
        if decided < 0.5 {
            text += ", and a clear sky is assumed for the rest";
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn daylight() -> Daylight {
        Daylight {
            air: vec![
                BandAir {
                    optical_depth: 0.1,
                    sky_share: 0.6,
                },
                BandAir {
                    optical_depth: 0.3,
                    sky_share: 0.6,
                },
            ],
            reference_elevation_rad: 60f64.to_radians(),
            images_decide: vec![0.9, 0.2],
            suns_rad: [0.5, 1.1],
            exposure_sigma: 0.05,
        }
    }

    #[test]
    fn the_reference_image_is_the_gauge_and_low_suns_are_darker_and_redder() {
        let light = daylight();
        for k in 0..2 {
            assert!((light.gain(k, light.reference_elevation_rad) - 1.0).abs() < 1e-12);
        }
        let low = 12f64.to_radians();
        let sines = low.sin() / light.reference_elevation_rad.sin();
        assert!(light.gain(0, low) < sines && light.gain(0, low) > 0.6 * sines);
        assert!(light.gain(1, low) < light.gain(0, low));
        assert!(light.shade(1, low) > light.shade(0, low));
    }

    #[test]
    fn light_that_cannot_be_is_refused() {
        assert!(daylight().is_possible(2));
        assert!(!daylight().is_possible(3));
        let mut other = daylight();
        other.reference_elevation_rad = 0.0;
        assert!(!other.is_possible(2));
        other = daylight();
        other.air[1].optical_depth = f64::NAN;
        assert!(!other.is_possible(2));
    }

    #[test]
    fn words_say_when_the_sky_is_assumed() {
        let mut light = daylight();
        assert!(!light.in_words().contains("assumed"));
        light.images_decide = vec![0.1, 0.1];
        assert!(light.in_words().contains("10 %") && light.in_words().contains("assumed"));
    }
}
