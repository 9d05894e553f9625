//! The local east-north-up frame at a scene centre on the WGS84 ellipsoid.

use crate::GeoPoint;
use nalgebra::Vector3;

/// An ENU frame: metres east, north and up of `origin`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalFrame {
    /// Where the frame stands.
    pub origin: GeoPoint,
}

impl LocalFrame {
    /// A frame at `origin`.
    pub fn new(origin: GeoPoint) -> Self {
        Self { origin }
    }

    /// ENU metres of a geodetic point.
    pub fn enu_from_geo(&self, _point: GeoPoint) -> Vector3<f64> {
        unimplemented!()
    }

    /// Geodetic point of ENU metres.
    pub fn geo_from_enu(&self, _enu_m: Vector3<f64>) -> GeoPoint {
        unimplemented!()
    }
}
