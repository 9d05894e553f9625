//! Direction of the sun from time and place.
//!
//! Earth's heliocentric longitude, latitude and distance come from the leading terms of the VSOP87 theory, corrected
//! for nutation and aberration, turned by apparent sidereal time, and seen from the place itself (parallax). Formulas:
//! J. Meeus, *Astronomical Algorithms*, 2nd ed., chapters 12, 22, 25 and 32. Against the NREL algorithm over 1972-2100
//! the direction is good to 0.001 degree; the largest remaining error is UT1 taken as UTC (within 0.9 s).

mod vsop;

use crate::frame::{LocalFrame, ecef_from_geo};
use crate::rpc::{GeoPoint, wrapped_longitude_deg};
use nalgebra::Vector3;
use std::f64::consts::TAU;
use vsop::HeliocentricEarth;

/// Astronomical unit, metres.
const ASTRONOMICAL_UNIT_M: f64 = 149_597_870_700.0;
/// Julian day of 1970-01-01T00:00:00Z.
const UNIX_EPOCH_JULIAN_DAY: f64 = 2_440_587.5;
/// Julian day of J2000.0.
const J2000_JULIAN_DAY: f64 = 2_451_545.0;
const SECONDS_PER_DAY: f64 = 86_400.0;
const DAYS_PER_CENTURY: f64 = 36_525.0;

/// Direction of the sun at a place: geometric (no refraction), above the geodetic horizon.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SunPosition {
    /// Azimuth, clockwise from true north, radians.
    pub azimuth_rad: f64,
    /// Elevation above the horizon, radians.
    pub elevation_rad: f64,
}

impl SunPosition {
    /// Position from azimuth and elevation in degrees, unchecked.
    pub fn from_degrees(azimuth_deg: f64, elevation_deg: f64) -> Self {
        Self {
            azimuth_rad: azimuth_deg.to_radians(),
            elevation_rad: elevation_deg.to_radians(),
        }
    }

    /// Position from azimuth (-180 to 360) and elevation (-90 to 90) in degrees, checked.
    ///
    /// # Errors
    /// A message with both angles, where one is outside of its range or not finite.
    pub fn stated(azimuth_deg: f64, elevation_deg: f64) -> Result<Self, String> {
        match (-180.0..=360.0).contains(&azimuth_deg) && (-90.0..=90.0).contains(&elevation_deg) {
            true => Ok(Self::from_degrees(azimuth_deg, elevation_deg)),
            false => Err(format!(
                "a sun at azimuth {azimuth_deg}, elevation {elevation_deg} is not possible; expected -180 to 360 and -90 to 90 degrees"
            )),
        }
    }

    /// Position from a direction toward the sun (east, north, up; any length but zero); azimuth in [0, 2 pi).
    pub fn from_direction_enu(direction: Vector3<f64>) -> Self {
        Self {
            azimuth_rad: direction.x.atan2(direction.y).rem_euclid(TAU),
            elevation_rad: direction.z.atan2(direction.x.hypot(direction.y)),
        }
    }

    /// Azimuth, 0 to 360, and elevation, degrees.
    pub fn degrees(&self) -> [f64; 2] {
        [
            self.azimuth_rad.to_degrees().rem_euclid(360.0),
            self.elevation_rad.to_degrees(),
        ]
    }

    /// Unit vector toward the sun, east-north-up.
    pub fn direction_enu(&self) -> Vector3<f64> {
        let (sin_a, cos_a) = self.azimuth_rad.sin_cos();
        let (sin_e, cos_e) = self.elevation_rad.sin_cos();
        Vector3::new(cos_e * sin_a, cos_e * cos_a, sin_e)
    }
}

/// Position of the sun at `time`, seen from `at`. Valid for 1900 to 2150, the years for which the difference between
/// terrestrial and universal time is known or predicted.
pub fn sun_position(time: jiff::Timestamp, at: GeoPoint) -> SunPosition {
    let (days_ut, days_tt) = days_since_j2000(time);
    let toward_sun_ecef_m = sun_ecef_m(days_ut, days_tt) - ecef_from_geo(at);
    let direction = LocalFrame::new(at).enu_from_ecef_rotation() * toward_sun_ecef_m;
    SunPosition::from_direction_enu(direction)
}

/// Days since J2000.0 in universal and in terrestrial time.
fn days_since_j2000(time: jiff::Timestamp) -> (f64, f64) {
    let seconds = time.as_second() as f64 + f64::from(time.subsec_nanosecond()) * 1e-9;
    let days_ut = seconds / SECONDS_PER_DAY + (UNIX_EPOCH_JULIAN_DAY - J2000_JULIAN_DAY);
    let days_tt = days_ut + delta_t_s(2000.0 + days_ut / 365.2425) / SECONDS_PER_DAY;
    (days_ut, days_tt)
}

/// Distance from the Earth to the sun at `time`, astronomical units: 0.983 in January to 1.017 in July.
pub fn earth_sun_distance_au(time: jiff::Timestamp) -> f64 {
    let (_, days_tt) = days_since_j2000(time);
    HeliocentricEarth::at(days_tt / DAYS_PER_CENTURY / 10.0).distance_au
}

/// Apparent position of the sun, Earth-centred and Earth-fixed, metres; days count from J2000.0.
fn sun_ecef_m(days_ut: f64, days_tt: f64) -> Vector3<f64> {
    let centuries = days_tt / DAYS_PER_CENTURY;
    let earth = HeliocentricEarth::at(centuries / 10.0);
    let nutation = Nutation::at(centuries);
    let true_obliquity_rad = mean_obliquity_rad(centuries) + nutation.obliquity_rad;
    // To the FK5 frame, and the light's aberration (Meeus 25.9, 25.11).
    let longitude_rad = earth.longitude_rad
        + std::f64::consts::PI
        + nutation.longitude_rad
        + arcseconds(-0.09033 - 20.4898 / earth.distance_au);
    let (sin_lon, cos_lon) = longitude_rad.sin_cos();
    let (sin_lat, cos_lat) = (-earth.latitude_rad).sin_cos();
    let (sin_obliquity, cos_obliquity) = true_obliquity_rad.sin_cos();
    let ecliptic = Vector3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat);
    let equatorial = Vector3::new(
        ecliptic.x,
        ecliptic.y * cos_obliquity - ecliptic.z * sin_obliquity,
        ecliptic.y * sin_obliquity + ecliptic.z * cos_obliquity,
    );
    let sidereal_rad = mean_sidereal_deg(days_ut).to_radians() + nutation.longitude_rad * cos_obliquity;
    let (sin_sidereal, cos_sidereal) = sidereal_rad.sin_cos();
    Vector3::new(
        equatorial.x * cos_sidereal + equatorial.y * sin_sidereal,
        equatorial.y * cos_sidereal - equatorial.x * sin_sidereal,
        equatorial.z,
    ) * (earth.distance_au * ASTRONOMICAL_UNIT_M)
}

fn arcseconds(value: f64) -> f64 {
    (value / 3600.0).to_radians()
}

/// Greenwich mean sidereal time, degrees (Meeus 12.4).
fn mean_sidereal_deg(days_ut: f64) -> f64 {
    let centuries = days_ut / DAYS_PER_CENTURY;
    let turn_deg = 280.460_618_37 + 0.985_647_366_29 * days_ut + 360.0 * (days_ut - days_ut.floor());
    wrapped_longitude_deg(turn_deg + centuries * centuries * (0.000_387_933 - centuries / 38_710_000.0))
}

/// Mean obliquity of the ecliptic (IAU, Meeus 22.2).
fn mean_obliquity_rad(centuries: f64) -> f64 {
    arcseconds(84_381.448 - centuries * (46.8150 + centuries * (0.000_59 - centuries * 0.001_813)))
}

/// Nutation of the Earth's axis.
struct Nutation {
    longitude_rad: f64,
    obliquity_rad: f64,
}

impl Nutation {
    /// The terms of Meeus' table 22.A above 0.01 arc seconds of longitude.
    fn at(centuries: f64) -> Self {
        let t = centuries;
        let elongation = (297.850_36 + 445_267.111_480 * t).to_radians();
        let sun_anomaly = (357.527_72 + 35_999.050_340 * t).to_radians();
        let moon_anomaly = (134.962_98 + 477_198.867_398 * t).to_radians();
        let moon_latitude = (93.271_91 + 483_202.017_538 * t).to_radians();
        let node = (125.044_52 - 1_934.136_261 * t).to_radians();
        // Multiples of (D, M, M', F, node), longitude and obliquity in 0.0001 arc seconds.
        const TERMS: [([f64; 5], f64, f64); 13] = [
            ([0.0, 0.0, 0.0, 0.0, 1.0], -171_996.0, 92_025.0),
            ([-2.0, 0.0, 0.0, 2.0, 2.0], -13_187.0, 5_736.0),
            ([0.0, 0.0, 0.0, 2.0, 2.0], -2_274.0, 977.0),
            ([0.0, 0.0, 0.0, 0.0, 2.0], 2_062.0, -895.0),
            ([0.0, 1.0, 0.0, 0.0, 0.0], 1_426.0, 54.0),
            ([0.0, 0.0, 1.0, 0.0, 0.0], 712.0, -7.0),
            ([-2.0, 1.0, 0.0, 2.0, 2.0], -517.0, 224.0),
            ([0.0, 0.0, 0.0, 2.0, 1.0], -386.0, 200.0),
            ([0.0, 0.0, 1.0, 2.0, 2.0], -301.0, 129.0),
            ([-2.0, -1.0, 0.0, 2.0, 2.0], 217.0, -95.0),
            ([-2.0, 0.0, 1.0, 0.0, 0.0], -158.0, 0.0),
            ([-2.0, 0.0, 0.0, 2.0, 1.0], 129.0, -70.0),
            ([0.0, 0.0, -1.0, 2.0, 2.0], 123.0, -53.0),
        ];
        let arguments = [elongation, sun_anomaly, moon_anomaly, moon_latitude, node];
        let (mut longitude, mut obliquity) = (0.0, 0.0);
        for (multiples, along_longitude, along_obliquity) in TERMS {
            let angle: f64 = multiples.iter().zip(arguments).map(|(m, a)| m * a).sum();
            longitude += along_longitude * angle.sin();
            obliquity += along_obliquity * angle.cos();
        }
        Self {
            longitude_rad: arcseconds(longitude * 1e-4),
            obliquity_rad: arcseconds(obliquity * 1e-4),
        }
    }
}

/// Terrestrial time less universal time, seconds, at a decimal year: the polynomials of F. Espenak and J. Meeus (NASA
/// eclipse pages); 15 s of error move the sun by 0.0002 degree.
fn delta_t_s(year: f64) -> f64 {
    let horner = |t: f64, c: &[f64]| c.iter().rev().fold(0.0, |sum, c| sum * t + c);
    let parabola = |y: f64| -20.0 + 32.0 * ((y - 1820.0) / 100.0).powi(2);
    match year {
        y if y < 1900.0 => parabola(y),
        y if y < 1920.0 => horner(y - 1900.0, &[-2.79, 1.494_119, -0.059_893_9, 0.006_196_6, -0.000_197]),
        y if y < 1941.0 => horner(y - 1920.0, &[21.20, 0.844_93, -0.076_100, 0.002_093_6]),
        y if y < 1961.0 => horner(y - 1950.0, &[29.07, 0.407, -1.0 / 233.0, 1.0 / 2547.0]),
        y if y < 1986.0 => horner(y - 1975.0, &[45.45, 1.067, -1.0 / 260.0, -1.0 / 718.0]),
        y if y < 2005.0 => horner(
            y - 2000.0,
            &[63.86, 0.334_5, -0.060_374, 0.001_727_5, 0.000_651_814, 0.000_023_735_99],
        ),
        y if y < 2050.0 => horner(y - 2000.0, &[62.92, 0.322_17, 0.005_589]),
        y if y < 2150.0 => parabola(y) - 0.562_8 * (2150.0 - y),
        y => parabola(y),
    }
}
