//! Light on level ground under a sun of any height, band by band.
//!
//! ```text
//! E_sun(e) = exp(-τ m(e)) sin e        E_sky(e) = κ (1 - exp(-τ m(e))) sin e
//! ```
//!
//! in units of the sun's irradiance above the air. `τ` is the optical depth of the air, `m(e)` the optical air mass (F.
//! Kasten and A. T. Young, "Revised optical air mass tables and approximation formula", Applied Optics 28, 1989),
//! finite at the horizon. The air scatters the light that it removes from the beam, and the share `κ` of that reaches
//! the ground as skylight. So the sky's share of the light grows as the sun sinks, is below one everywhere, and both
//! terms vanish with the sun. Light that walls and ground throw into shadows counts as skylight here.
//!
//! Limits: no twilight and no clouds; the spectrum within a band is one depth.

/// Plausible optical depths.
pub const OPTICAL_DEPTHS: [f64; 2] = [0.02, 1.0];
/// Plausible shares of the scattered light that reach the ground.
pub const SKY_SHARES: [f64; 2] = [0.1, 1.0];

/// Optical air mass towards a sun of this elevation, relative to the zenith; below the horizon that of the horizon.
pub fn air_mass(elevation_rad: f64) -> f64 {
    let elevation_rad = elevation_rad.max(0.0);
    let degrees = elevation_rad.to_degrees();
    1.0 / (elevation_rad.sin() + 0.50572 * (degrees + 6.07995).powf(-1.6364))
}

/// Optical depth and scattering of the air in one band.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BandAir {
    /// Optical depth `τ` of the whole air, straight up.
    pub optical_depth: f64,
    /// Share `κ` of the light taken from the beam that reaches the ground.
    pub sky_share: f64,
}

impl BandAir {
    /// True if both numbers are in their plausible ranges.
    pub fn is_possible(&self) -> bool {
        let within = |value: f64, [least, most]: [f64; 2]| (least..=most).contains(&value);
        within(self.optical_depth, OPTICAL_DEPTHS) && within(self.sky_share, SKY_SHARES)
    }

    /// Irradiance of the sun on level ground, relative to the sun above the air.
    pub fn sun(&self, elevation_rad: f64) -> f64 {
        let passed = (-self.optical_depth * air_mass(elevation_rad)).exp();
        passed * elevation_rad.max(0.0).sin()
    }

    /// Irradiance of the sky on level ground, relative to the sun above the air.
    pub fn sky(&self, elevation_rad: f64) -> f64 {
        let passed = (-self.optical_depth * air_mass(elevation_rad)).exp();
        self.sky_share * (1.0 - passed) * elevation_rad.max(0.0).sin()
    }

    /// Irradiance of sun and sky on level ground, relative to the sun above the air.
    pub fn level(&self, elevation_rad: f64) -> f64 {
        self.sun(elevation_rad) + self.sky(elevation_rad)
    }

    /// Brightness of a shadow on level ground relative to sunlit ground, 0 to 1.
    pub fn shade(&self, elevation_rad: f64) -> f64 {
        // The sine cancels, so that the horizon has a limit.
        let passed = (-self.optical_depth * air_mass(elevation_rad)).exp();
        let sky = self.sky_share * (1.0 - passed);
        sky / (passed + sky)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AIR: BandAir = BandAir {
        optical_depth: 0.2,
        sky_share: 0.5,
    };

    fn deg(degrees: f64) -> f64 {
        degrees.to_radians()
    }

    #[test]
    fn air_mass_is_that_of_the_tables() {
        // Kasten and Young 1989, table 2.
        for (elevation_deg, expected) in [
            (90.0, 1.0),
            (60.0, 1.154),
            (30.0, 1.994),
            (10.0, 5.585),
            (5.0, 10.32),
            (0.0, 38.09),
        ] {
            let found = air_mass(deg(elevation_deg));
            assert!((found / expected - 1.0).abs() < 5e-3, "{elevation_deg}: {found}");
        }
        assert_eq!(air_mass(deg(-3.0)), air_mass(0.0));
    }

    #[test]
    fn a_sun_in_the_zenith_loses_one_depth() {
        let top = deg(90.0);
        assert!((AIR.sun(top) - (-0.2f64).exp()).abs() < 1e-3);
        assert!((AIR.sky(top) - 0.5 * (1.0 - (-0.2f64).exp())).abs() < 1e-3);
        assert!((AIR.shade(top) - AIR.sky(top) / AIR.level(top)).abs() < 1e-12);
    }

    #[test]
    fn light_goes_with_the_sun_and_the_sky_s_share_grows_to_a_limit() {
        assert!(AIR.level(0.0) == 0.0 && AIR.level(deg(0.1)) < 2e-3);
        assert!(AIR.level(-0.1) == 0.0);
        assert!(AIR.shade(0.0) > 0.99 * 1.0 - 1e-2 && AIR.shade(0.0) < 1.0);
        for band in [0.02, 0.1, 0.4, 1.0].map(|optical_depth| BandAir { optical_depth, ..AIR }) {
            for step in 1..90 {
                let (low, high) = (deg(f64::from(step)), deg(f64::from(step + 1)));
                assert!(band.level(low) < band.level(high), "{step}");
                assert!(band.shade(low) > band.shade(high) && band.shade(low) < 1.0, "{step}");
            }
        }
    }

    #[test]
    fn hazier_air_has_less_sun_and_more_sky() {
        let hazy = BandAir {
            optical_depth: 0.4,
            ..AIR
        };
        assert!(hazy.sun(deg(30.0)) < AIR.sun(deg(30.0)));
        assert!(hazy.sky(deg(30.0)) > AIR.sky(deg(30.0)));
    }

    #[test]
    fn impossible_air_is_known() {
        assert!(AIR.is_possible());
        for optical_depth in [0.0, -1.0, 2.0, f64::NAN] {
            assert!(!BandAir { optical_depth, ..AIR }.is_possible());
        }
        for sky_share in [0.0, 1.5, f64::INFINITY] {
            assert!(!BandAir { sky_share, ..AIR }.is_possible());
        }
    }
}
