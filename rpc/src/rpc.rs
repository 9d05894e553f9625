//! The rational polynomial camera (RPC00B): projection, its analytic Jacobian, and localisation.

use nalgebra::Matrix2x3;

/// A point on or above the Earth: WGS84 longitude and latitude in degrees, ellipsoidal height in metres.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct GeoPoint {
    /// Longitude, degrees east.
    pub lon_deg: f64,
    /// Geodetic latitude, degrees north.
    pub lat_deg: f64,
    /// Height above the WGS84 ellipsoid, metres.
    pub height_m: f64,
}

/// A point in an image, in pixels; the centre of the upper-left pixel is (0, 0).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ImagePoint {
    /// Column, to the right.
    pub col: f64,
    /// Row, downwards.
    pub row: f64,
}

/// What can go wrong with a rational camera.
#[derive(Debug, thiserror::Error)]
pub enum RpcError {
    /// The inversion of the projection did not converge.
    #[error("localisation of column {col}, row {row} at height {height_m} m did not converge")]
    NoConvergence {
        /// Column asked for, pixels.
        col: f64,
        /// Row asked for, pixels.
        row: f64,
        /// Height asked for, metres.
        height_m: f64,
    },
    /// A model that cannot be fitted or read.
    #[error("{0}")]
    Invalid(String),
}

/// A rational polynomial camera, RPC00B coefficient order
/// `1 L P H LP LH PH LL PP HH LPH LLL LPP LHH LLP PPP PHH LLH PPH HHH` (L longitude, P latitude, H height).
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Rpc {
    /// Row of the centre, pixels.
    pub line_offset: f64,
    /// Column of the centre, pixels.
    pub sample_offset: f64,
    /// Latitude of the centre, degrees.
    pub latitude_offset_deg: f64,
    /// Longitude of the centre, degrees.
    pub longitude_offset_deg: f64,
    /// Height of the centre, metres.
    pub height_offset_m: f64,
    /// Half range of rows, pixels.
    pub line_scale: f64,
    /// Half range of columns, pixels.
    pub sample_scale: f64,
    /// Half range of latitudes, degrees (some vendors write it negative).
    pub latitude_scale_deg: f64,
    /// Half range of longitudes, degrees.
    pub longitude_scale_deg: f64,
    /// Half range of heights, metres.
    pub height_scale_m: f64,
    /// Numerator of the row.
    pub line_numerator: [f64; 20],
    /// Denominator of the row.
    pub line_denominator: [f64; 20],
    /// Numerator of the column.
    pub sample_numerator: [f64; 20],
    /// Denominator of the column.
    pub sample_denominator: [f64; 20],
    /// Stated bias error, metres.
    pub error_bias_m: Option<f64>,
    /// Stated random error, metres.
    pub error_random_m: Option<f64>,
}

impl Rpc {
    /// Image position of a ground point.
    pub fn project(&self, _point: GeoPoint) -> ImagePoint {
        unimplemented!()
    }

    /// Image position and its Jacobian `d(col, row) / d(lon_deg, lat_deg, height_m)`.
    pub fn project_with_jacobian(&self, _point: GeoPoint) -> (ImagePoint, Matrix2x3<f64>) {
        unimplemented!()
    }

    /// The ground point at ellipsoidal height `height_m` that projects to `point`.
    ///
    /// # Errors
    /// [`RpcError::NoConvergence`] when no such point is found.
    pub fn localise(&self, _point: ImagePoint, _height_m: f64) -> Result<GeoPoint, RpcError> {
        unimplemented!()
    }

    /// The camera of a crop whose upper-left pixel is (`col0`, `row0`) of this camera's image.
    pub fn cropped(&self, col0: f64, row0: f64) -> Rpc {
        Rpc {
            line_offset: self.line_offset - row0,
            sample_offset: self.sample_offset - col0,
            ..self.clone()
        }
    }
}
