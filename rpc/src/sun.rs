//! Where the sun stands, from time and place.

use crate::GeoPoint;
use nalgebra::Vector3;

/// Direction of the sun at a place: geometric (no refraction), above the geodetic horizon.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SunPosition {
    /// Clockwise from true north, radians.
    pub azimuth_rad: f64,
    /// Above the horizon, radians.
    pub elevation_rad: f64,
}

impl SunPosition {
    /// From degrees.
    pub fn from_degrees(azimuth_deg: f64, elevation_deg: f64) -> Self {
        Self {
            azimuth_rad: azimuth_deg.to_radians(),
            elevation_rad: elevation_deg.to_radians(),
        }
    }

    /// Unit vector toward the sun, east-north-up.
    pub fn direction_enu(&self) -> Vector3<f64> {
        let (sin_a, cos_a) = self.azimuth_rad.sin_cos();
        let (sin_e, cos_e) = self.elevation_rad.sin_cos();
        Vector3::new(cos_e * sin_a, cos_e * cos_a, sin_e)
    }
}

/// The sun at `time`, seen from `at`.
pub fn sun_position(_time: jiff::Timestamp, _at: GeoPoint) -> SunPosition {
    unimplemented!()
}
