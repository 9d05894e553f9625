//! Irradiance under a clear sky: the model of the European Solar Radiation Atlas.
//!
//! C. Rigollier, O. Bauer and L. Wald, "On the clear sky model of the ESRA with respect to the Heliosat method", Solar
//! Energy 68(1), 2000, for beam, Rayleigh optical depth and diffuse light; optical air mass of F. Kasten and A. T.
//! Young, "Revised optical air mass tables and approximation formula", Applied Optics 28(22), 1989.

/// Linke turbidity at air mass 2: that of clear air over land in temperate climates.
pub const LINKE_TURBIDITY: f64 = 3.0;
/// Solar constant of the model, W/m².
const SOLAR_CONSTANT_W_M2: f64 = 1367.0;
/// Height in which pressure falls to 1/e, metres.
const SCALE_HEIGHT_M: f64 = 8434.5;

/// Irradiance of the sun and of the sky, W/m².
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Irradiance {
    /// Irradiance of a surface that faces the sun.
    pub(super) beam_w_m2: f64,
    /// Diffuse irradiance of the whole sky on level ground.
    pub(super) diffuse_w_m2: f64,
}

/// Irradiance under a sun at an elevation and a distance (astronomical units), some metres above the sea, at a Linke
/// turbidity; zero for a sun below the horizon.
pub(super) fn irradiance(elevation_rad: f64, distance_au: f64, height_m: f64, turbidity: f64) -> Irradiance {
    if elevation_rad <= 0.0 {
        return Irradiance::default();
    }
    let above_air_w_m2 = SOLAR_CONSTANT_W_M2 / (distance_au * distance_au);
    let mass = air_mass(elevation_rad, height_m);
    let beam_w_m2 = above_air_w_m2 * (-0.8662 * turbidity * mass * rayleigh_depth(mass)).exp();
    Irradiance {
        beam_w_m2,
        diffuse_w_m2: above_air_w_m2 * diffuse_share(elevation_rad, turbidity),
    }
}

/// Relative optical air mass, reduced with the pressure, of the elevation with its refraction (0.1 degree at 10
/// degrees).
fn air_mass(elevation_rad: f64, height_m: f64) -> f64 {
    let refraction_rad = 0.061_359 * (0.1594 + 1.1230 * elevation_rad + 0.065_656 * elevation_rad.powi(2))
        / (1.0 + 28.9344 * elevation_rad + 277.3971 * elevation_rad.powi(2));
    let true_rad = elevation_rad + refraction_rad;
    let pressure = (-height_m / SCALE_HEIGHT_M).exp();
    pressure / (true_rad.sin() + 0.505_72 * (true_rad.to_degrees() + 6.079_95).powf(-1.6364))
}

/// Optical depth of clean dry air per air mass.
fn rayleigh_depth(mass: f64) -> f64 {
    if mass > 20.0 {
        return 1.0 / (10.4 + 0.718 * mass);
    }
    let m = mass;
    1.0 / (6.6296 + m * (1.7513 + m * (-0.1202 + m * (0.0065 - m * 0.00013))))
}

/// Diffuse irradiance of level ground, relative to the sun's irradiance above the air.
fn diffuse_share(elevation_rad: f64, turbidity: f64) -> f64 {
    let t = turbidity;
    let zenith = -1.5843e-2 + t * (3.0543e-2 + t * 3.797e-4);
    let mut a0 = 2.6463e-1 + t * (-6.1581e-2 + t * 3.1408e-3);
    if a0 * zenith < 2e-3 {
        a0 = 2e-3 / zenith;
    }
    let a1 = 2.0402 + t * (1.8945e-2 - t * 1.1161e-2);
    let a2 = -1.3025 + t * (3.9231e-2 + t * 8.5079e-3);
    let sine = elevation_rad.sin();
    zenith * (a0 + sine * (a1 + sine * a2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn irradiance_follows_the_published_formulas() {
        // Worked by hand from the equations: sea level, mean distance, turbidity 3.
        for (elevation_deg, beam, diffuse) in EXPECTED {
            let light = irradiance(f64::to_radians(elevation_deg), 1.0, 0.0, 3.0);
            assert!(
                (light.beam_w_m2 - beam).abs() < 0.05,
                "{elevation_deg}: {}",
                light.beam_w_m2
            );
            assert!(
                (light.diffuse_w_m2 - diffuse).abs() < 0.05,
                "{elevation_deg}: {}",
                light.diffuse_w_m2
            );
        }
    }

    #[test]
    fn the_sky_s_share_grows_as_the_sun_sinks_and_thin_air_lets_more_through() {
        let share = |elevation_deg: f64| {
            let elevation_rad = elevation_deg.to_radians();
            let light = irradiance(elevation_rad, 1.0, 0.0, LINKE_TURBIDITY);
            light.diffuse_w_m2 / (light.diffuse_w_m2 + light.beam_w_m2 * elevation_rad.sin())
        };
        assert!(share(10.0) > share(20.0) && share(20.0) > share(45.0) && share(45.0) > share(80.0));
        let beam = |height_m: f64| irradiance(0.5, 1.0, height_m, LINKE_TURBIDITY).beam_w_m2;
        assert!(beam(2000.0) > 1.05 * beam(0.0));
        assert_eq!(irradiance(-0.01, 1.0, 0.0, 3.0).beam_w_m2, 0.0);
    }
    /// Elevation in degrees, beam and diffuse irradiance, W/m².
    const EXPECTED: [(f64, f64, f64); 5] = [
        (5.0, 303.969, 29.639),
        (10.0, 475.153, 45.63),
        (30.0, 801.189, 89.799),
        (60.0, 960.67, 108.928),
        (90.0, 998.362, 107.892),
    ];
}
