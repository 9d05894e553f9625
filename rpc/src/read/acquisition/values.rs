//! Time and sun of one acquisition, the result of all readers of this module.

use crate::rpc::GeoPoint;
use crate::sun::{SunPosition, sun_position};
use jiff::Timestamp;

/// Time and sun of an acquisition, as far as they are known.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct Acquisition {
    /// Time of acquisition, UTC.
    pub time: Option<Timestamp>,
    /// Azimuth of the sun as stated by the vendor, degrees clockwise from north, in [0, 360).
    pub sun_azimuth_deg: Option<f64>,
    /// Elevation of the sun as stated by the vendor, degrees above the horizon, in [-90, 90].
    pub sun_elevation_deg: Option<f64>,
}

impl Acquisition {
    /// These values, completed by those of `other`. Both angles come from the first source that states both; where
    /// neither does, each comes from the first that states it.
    pub fn merge(self, other: Self) -> Self {
        let own_angles = self.sun_azimuth_deg.is_some() || self.sun_elevation_deg.is_some();
        let (sun_azimuth_deg, sun_elevation_deg) = if own_angles && self.stated_sun().is_some() {
            (self.sun_azimuth_deg, self.sun_elevation_deg)
        } else if other.stated_sun().is_some() {
            (other.sun_azimuth_deg, other.sun_elevation_deg)
        } else {
            (
                self.sun_azimuth_deg.or(other.sun_azimuth_deg),
                self.sun_elevation_deg.or(other.sun_elevation_deg),
            )
        };
        Self {
            time: self.time.or(other.time),
            sun_azimuth_deg,
            sun_elevation_deg,
        }
    }

    /// True if time and angles are all absent.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The sun as stated by the vendor; `None` unless both angles are stated.
    pub fn stated_sun(&self) -> Option<SunPosition> {
        Some(SunPosition::from_degrees(
            self.sun_azimuth_deg?,
            self.sun_elevation_deg?,
        ))
    }

    /// The sun at `at`: computed where the time is known, else as stated by the vendor, else `None`.
    pub fn sun_at(&self, at: GeoPoint) -> Option<SunPosition> {
        self.time
            .map(|time| sun_position(time, at))
            .or_else(|| self.stated_sun())
    }

    /// The angle between the computed and the stated sun, degrees; `None` unless time and both angles are known.
    pub fn sun_disagreement_deg(&self, at: GeoPoint) -> Option<f64> {
        let computed = sun_position(self.time?, at).direction_enu();
        let stated = self.stated_sun()?.direction_enu();
        Some(computed.cross(&stated).norm().atan2(computed.dot(&stated)).to_degrees())
    }

    /// Acquisition from angles in degrees: those outside of -360 to 360 (azimuth) and -90 to 90 (elevation) are left
    /// out, and the azimuth is reduced to [0, 360).
    pub(super) fn new(time: Option<Timestamp>, azimuth_deg: Option<f64>, elevation_deg: Option<f64>) -> Self {
        Self {
            time,
            sun_azimuth_deg: azimuth_deg
                .filter(|v| (-360.0..=360.0).contains(v))
                .map(|v| v.rem_euclid(360.0)),
            sun_elevation_deg: elevation_deg.filter(|v| (-90.0..=90.0).contains(v)),
        }
    }
}
