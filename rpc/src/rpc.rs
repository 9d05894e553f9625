//! The rational polynomial camera (RPC00B): projection, its analytic Jacobian, and localisation.

use crate::polynomial::{gradient, monomials, value};
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

impl GeoPoint {
    /// A point from longitude and latitude, degrees, and height, metres.
    pub const fn new(lon_deg: f64, lat_deg: f64, height_m: f64) -> Self {
        Self {
            lon_deg,
            lat_deg,
            height_m,
        }
    }
}

/// A point in an image, in pixels; the centre of the upper-left pixel is (0, 0).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ImagePoint {
    /// Column, to the right.
    pub col: f64,
    /// Row, downwards.
    pub row: f64,
}

impl ImagePoint {
    /// A point from its column and row.
    pub const fn new(col: f64, row: f64) -> Self {
        Self { col, row }
    }
}

/// Errors of a rational camera.
#[derive(Debug, thiserror::Error)]
pub enum RpcError {
    /// The inversion of the projection did not converge.
    #[error("localisation of column {col}, row {row} at height {height_m} m did not converge")]
    NoConvergence {
        /// Requested column, pixels.
        col: f64,
        /// Requested row, pixels.
        row: f64,
        /// Requested height above the ellipsoid, metres.
        height_m: f64,
    },
    /// A model whose own scales contradict its polynomials.
    #[error(
        "this RPC cannot be localised: one half range of its image spans {span:.1} half ranges of its ground \
         (a sound model has at most about 1), so its polynomials are used far outside what they were fitted on; \
         ask the vendor for a refitted RPC"
    )]
    Inconsistent {
        /// Ground half ranges that one image half range covers at the model's centre.
        span: f64,
    },
    /// Samples, views, tracks or a window that determine no result; the text names the fault.
    #[error("{0}")]
    Invalid(String),
}

/// A rational polynomial camera with coefficients in the order of RPC00B (STDI-0002),
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
    /// Coefficients of the row's numerator.
    pub line_numerator: [f64; 20],
    /// Coefficients of the row's denominator.
    pub line_denominator: [f64; 20],
    /// Coefficients of the column's numerator.
    pub sample_numerator: [f64; 20],
    /// Coefficients of the column's denominator.
    pub sample_denominator: [f64; 20],
    /// Stated bias error, metres; `None` where unknown.
    pub error_bias_m: Option<f64>,
    /// Stated random error, metres; `None` where unknown.
    pub error_random_m: Option<f64>,
}

impl Rpc {
    /// Image position of a ground point, pixels.
    ///
    /// Any finite point gives a result, which is valid only near the ground that the model was made for; where a
    /// denominator vanishes the result is not finite. Longitudes on the two sides of the date line are equivalent.
    pub fn project(&self, point: GeoPoint) -> ImagePoint {
        let m = monomials(self.normalised(point));
        let row = value(&self.line_numerator, &m) / value(&self.line_denominator, &m);
        let col = value(&self.sample_numerator, &m) / value(&self.sample_denominator, &m);
        ImagePoint::new(
            col * self.sample_scale + self.sample_offset,
            row * self.line_scale + self.line_offset,
        )
    }

    /// Image position and its Jacobian `d(col, row) / d(lon_deg, lat_deg, height_m)`, pixels per degree and per metre.
    pub fn project_with_jacobian(&self, point: GeoPoint) -> (ImagePoint, Matrix2x3<f64>) {
        let m = monomials(self.normalised(point));
        let ground_scale = [self.longitude_scale_deg, self.latitude_scale_deg, self.height_scale_m];
        let rational = |numerator: &[f64; 20], denominator: &[f64; 20], scale: f64| {
            let bottom = value(denominator, &m);
            let ratio = value(numerator, &m) / bottom;
            let (top_slope, bottom_slope) = (gradient(numerator, &m), gradient(denominator, &m));
            let slope: [f64; 3] = std::array::from_fn(|axis| {
                (top_slope[axis] - ratio * bottom_slope[axis]) / bottom * scale / ground_scale[axis]
            });
            (ratio, slope)
        };
        let (row, row_slope) = rational(&self.line_numerator, &self.line_denominator, self.line_scale);
        let (col, col_slope) = rational(&self.sample_numerator, &self.sample_denominator, self.sample_scale);
        let image = ImagePoint::new(
            col * self.sample_scale + self.sample_offset,
            row * self.line_scale + self.line_offset,
        );
        let jacobian = Matrix2x3::new(
            col_slope[0],
            col_slope[1],
            col_slope[2],
            row_slope[0],
            row_slope[1],
            row_slope[2],
        );
        (image, jacobian)
    }

    /// Longitude (the short way round the Earth), latitude and height from the model's centre, in half ranges.
    pub(crate) fn normalised(&self, point: GeoPoint) -> [f64; 3] {
        [
            wrapped_difference_deg(point.lon_deg, self.longitude_offset_deg) / self.longitude_scale_deg,
            (point.lat_deg - self.latitude_offset_deg) / self.latitude_scale_deg,
            (point.height_m - self.height_offset_m) / self.height_scale_m,
        ]
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

/// Longitude difference `a - b`, degrees, the short way round the Earth.
pub(crate) fn wrapped_difference_deg(a_deg: f64, b_deg: f64) -> f64 {
    let difference = a_deg - b_deg;
    if difference.abs() <= 180.0 {
        // Returned unchanged, because wrapping would round it.
        difference
    } else {
        difference - 360.0 * (difference / 360.0).round()
    }
}

/// A longitude reduced to [-180, 180] degrees.
pub(crate) fn wrapped_longitude_deg(longitude_deg: f64) -> f64 {
    wrapped_difference_deg(longitude_deg, 0.0)
}
