//! The local east-north-up frame at a scene centre on the WGS84 ellipsoid.

use crate::rpc::GeoPoint;
use nalgebra::{Matrix3, Vector3};

/// WGS84 semi-major axis, metres.
pub const WGS84_SEMI_MAJOR_M: f64 = 6_378_137.0;
/// WGS84 flattening.
pub const WGS84_FLATTENING: f64 = 1.0 / 298.257_223_563;
const ECCENTRICITY_SQUARED: f64 = WGS84_FLATTENING * (2.0 - WGS84_FLATTENING);

/// Earth-centred, Earth-fixed (ECEF) position of a geodetic point, metres.
pub fn ecef_from_geo(point: GeoPoint) -> Vector3<f64> {
    let (sin_lat, cos_lat) = point.lat_deg.to_radians().sin_cos();
    let (sin_lon, cos_lon) = point.lon_deg.to_radians().sin_cos();
    let normal_m = WGS84_SEMI_MAJOR_M / (1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat).sqrt();
    let horizontal_m = (normal_m + point.height_m) * cos_lat;
    Vector3::new(
        horizontal_m * cos_lon,
        horizontal_m * sin_lon,
        (normal_m * (1.0 - ECCENTRICITY_SQUARED) + point.height_m) * sin_lat,
    )
}

/// Geodetic point of an Earth-centred, Earth-fixed (ECEF) position in metres; longitude in [-180, 180] degrees.
///
/// Bowring's iteration on the reduced latitude (B. R. Bowring, *Transformation from spatial to geographical
/// coordinates*, Survey Review 23, 1976), in sine and cosine so that poles and equator are no special cases. It is
/// exact to rounding from the surface to satellite orbits. The longitude of a pole is 0.
pub fn geo_from_ecef(ecef_m: Vector3<f64>) -> GeoPoint {
    const MAX_ITERATIONS: usize = 8;
    let semi_minor_m = WGS84_SEMI_MAJOR_M * (1.0 - WGS84_FLATTENING);
    let second_eccentricity_squared = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED);
    let horizontal_m = ecef_m.x.hypot(ecef_m.y);
    let mut lat_rad = ecef_m.z.atan2(horizontal_m * (1.0 - ECCENTRICITY_SQUARED));
    for _ in 0..MAX_ITERATIONS {
        let (sin_lat, cos_lat) = lat_rad.sin_cos();
        let reduced = Vector3::new(cos_lat, (1.0 - WGS84_FLATTENING) * sin_lat, 0.0).normalize();
        let next_rad = (ecef_m.z + second_eccentricity_squared * semi_minor_m * reduced.y.powi(3))
            .atan2(horizontal_m - ECCENTRICITY_SQUARED * WGS84_SEMI_MAJOR_M * reduced.x.powi(3));
        let change_rad = (next_rad - lat_rad).abs();
        lat_rad = next_rad;
        if change_rad < 1e-16 {
            break;
        }
    }
    let (sin_lat, cos_lat) = lat_rad.sin_cos();
    // This form of the height has no division by a cosine that vanishes at the poles.
    let height_m = horizontal_m * cos_lat + ecef_m.z * sin_lat
        - WGS84_SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED * sin_lat * sin_lat).sqrt();
    GeoPoint::new(ecef_m.y.atan2(ecef_m.x).to_degrees(), lat_rad.to_degrees(), height_m)
}

/// An ENU frame: metres east, north and up of `origin`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalFrame {
    /// Origin of the frame.
    pub origin: GeoPoint,
}

impl LocalFrame {
    /// A frame at `origin`.
    pub fn new(origin: GeoPoint) -> Self {
        Self { origin }
    }

    /// East, north and up of a geodetic point, metres.
    pub fn enu_from_geo(&self, point: GeoPoint) -> Vector3<f64> {
        self.enu_from_ecef_rotation() * (ecef_from_geo(point) - ecef_from_geo(self.origin))
    }

    /// Geodetic point of east, north and up in metres; longitude in [-180, 180] degrees.
    pub fn geo_from_enu(&self, enu_m: Vector3<f64>) -> GeoPoint {
        geo_from_ecef(self.enu_from_ecef_rotation().transpose() * enu_m + ecef_from_geo(self.origin))
    }

    /// The rotation that turns ECEF directions into east, north and up at the origin.
    pub fn enu_from_ecef_rotation(&self) -> Matrix3<f64> {
        let (sin_lat, cos_lat) = self.origin.lat_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.origin.lon_deg.to_radians().sin_cos();
        Matrix3::new(
            -sin_lon,
            cos_lon,
            0.0,
            -sin_lat * cos_lon,
            -sin_lat * sin_lon,
            cos_lat,
            cos_lat * cos_lon,
            cos_lat * sin_lon,
            sin_lat,
        )
    }
}
