//! The sun of an image: direction, standard deviation and source. It may be unknown.

use heliosplat_rpc::sun::SunPosition;

/// Source of an image's sun.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SunSource {
    /// Computed from the acquisition time.
    Time,
    /// Angles that the metadata state.
    Metadata,
    /// Estimated from cast shadows.
    Shadows,
    /// Nobody says: the sun is unknown.
    #[default]
    None,
}

impl SunSource {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Time => "time",
            Self::Metadata => "metadata",
            Self::Shadows => "shadows",
            Self::None => "none",
        }
    }
}

/// Standard deviation of a sun computed from a time, degrees: vendors give the first line of a strip or the full minute, and in half
/// a minute the sun moves 0.125 degree.
const TIME_SIGMA_DEG: f64 = 0.1;
/// Standard deviation of a sun that metadata state, degrees: vendors use the geocentric vertical, up to 0.2 degree off the geodetic one.
const METADATA_SIGMA_DEG: f64 = 0.2;

/// The sun of one image.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct ImageSun {
    /// Its position; `None` if unknown.
    pub position: Option<SunPosition>,
    /// Standard deviation of its direction, degrees; `None` where it is unknown.
    pub sigma_deg: Option<f64>,
    /// Its source.
    pub source: SunSource,
}

impl ImageSun {
    /// Computed from the acquisition time.
    pub fn from_time(position: SunPosition) -> Self {
        Self::known(position, TIME_SIGMA_DEG, SunSource::Time)
    }

    /// A sun from metadata.
    pub fn from_metadata(position: SunPosition) -> Self {
        Self::known(position, METADATA_SIGMA_DEG, SunSource::Metadata)
    }

    /// Estimated from cast shadows, with its standard deviation, degrees.
    pub fn from_shadows(position: SunPosition, sigma_deg: f64) -> Self {
        Self::known(position, sigma_deg, SunSource::Shadows)
    }

    /// Nobody says.
    pub fn unknown() -> Self {
        Self::default()
    }

    fn known(position: SunPosition, sigma_deg: f64, source: SunSource) -> Self {
        Self {
            position: Some(position),
            sigma_deg: Some(sigma_deg),
            source,
        }
    }

    /// Azimuth (clockwise from north, 0 to 360) and elevation, degrees; `None` where the sun is unknown.
    pub fn angles_deg(&self) -> Option<[f64; 2]> {
        let sun = self.position?;
        Some([
            sun.azimuth_rad.to_degrees().rem_euclid(360.0),
            sun.elevation_rad.to_degrees(),
        ])
    }
}
