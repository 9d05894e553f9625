//! Sun of an image: direction, standard deviation and source. It may be unknown.

use heliosplat_rpc::sun::SunPosition;

/// Source of an image's sun.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SunSource {
    /// Computed from the acquisition time.
    Time,
    /// Angles from the metadata.
    Metadata,
    /// Estimated from cast shadows.
    Shadows,
    /// No source: the sun is unknown.
    #[default]
    None,
}

impl SunSource {
    /// Name of the source in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Time => "time",
            Self::Metadata => "metadata",
            Self::Shadows => "shadows",
            Self::None => "none",
        }
    }
}

/// Standard deviation of a sun computed from a time, degrees: vendors state the time of a strip's first line or the
/// full minute, and the sun moves 0.125 degree in half a minute.
const TIME_SIGMA_DEG: f64 = 0.1;
/// Standard deviation of a sun from metadata, degrees: vendors use the geocentric vertical, up to 0.2 degree off the
/// geodetic one.
const METADATA_SIGMA_DEG: f64 = 0.2;

/// The sun of one image.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct ImageSun {
    /// Position of the sun; `None` if unknown.
    pub position: Option<SunPosition>,
    /// Standard deviation of the direction, degrees; `None` if unknown.
    pub sigma_deg: Option<f64>,
    /// Source of the position.
    pub source: SunSource,
}

impl ImageSun {
    /// Sun computed from the acquisition time, with its standard deviation.
    pub fn from_time(position: SunPosition) -> Self {
        Self::known(position, TIME_SIGMA_DEG, SunSource::Time)
    }

    /// Sun from the angles in the metadata, with its standard deviation.
    pub fn from_metadata(position: SunPosition) -> Self {
        Self::known(position, METADATA_SIGMA_DEG, SunSource::Metadata)
    }

    /// Sun estimated from cast shadows; `sigma_deg` is its standard deviation, degrees.
    pub fn from_shadows(position: SunPosition, sigma_deg: f64) -> Self {
        Self::known(position, sigma_deg, SunSource::Shadows)
    }

    /// Unknown sun.
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
        self.position.map(|sun| sun.degrees())
    }
}
