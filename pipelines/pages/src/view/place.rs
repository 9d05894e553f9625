//! Place of a page's cells on the map and on the Earth, and the direction of the sun across cells.
//!
//! The azimuth of the sun counts from true north. The columns of a projected grid point to grid north, which differs by
//! the meridian convergence, up to some degrees in UTM. The page therefore gets the change of column and row per metre
//! to the true east and north, which contains convergence, scale and cells in degrees.

use heliosplat_raster::{CrsTransform, GridSpec, RasterError};
use heliosplat_rpc::{GeoPoint, LocalFrame};
use nalgebra::Vector3;
use serde::Serialize;

/// Half of the base length over which the directions east and north are measured, metres.
const STEP_M: f64 = 10.0;

/// Place of a grid on the Earth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct GridLocation {
    /// Longitude of the middle, degrees.
    pub lon_deg: f64,
    /// Latitude of the middle, degrees.
    pub lat_deg: f64,
    /// Change of column and row per metre to the east.
    pub east: [f64; 2],
    /// Change of column and row per metre to the north.
    pub north: [f64; 2],
    /// Clockwise angle from grid north to true north, degrees.
    pub true_north_deg: f64,
    /// Longitude and latitude at 3 x 3 nodes (outer edges and middle of the grid), degrees, row by row from the
    /// north-west corner. The page interpolates between them by quadratics.
    pub nodes: Vec<[f64; 2]>,
}

impl GridLocation {
    /// Computes the place of a grid at an ellipsoidal height in metres.
    ///
    /// # Errors
    /// When the grid lies outside its coordinate system.
    pub(crate) fn of(grid: &GridSpec, height_m: f64) -> Result<Self, RasterError> {
        let to_lon_lat = CrsTransform::to_lon_lat(&grid.crs)?;
        let from_lon_lat = CrsTransform::from_lon_lat(&grid.crs)?;
        let lon_lat = |col: f64, row: f64| {
            let [x, y] = grid.transform.map_from_pixel(col, row);
            to_lon_lat.apply(x, y)
        };
        let (width, height) = (grid.width as f64, grid.height as f64);
        let (col, row) = (0.5 * (width - 1.0), 0.5 * (height - 1.0));
        let (lon_deg, lat_deg) = lon_lat(col, row)?;
        let frame = LocalFrame::new(GeoPoint::new(lon_deg, lat_deg, height_m));
        let per_metre = |direction: Vector3<f64>| -> Result<[[f64; 2]; 2], RasterError> {
            let at = |sign: f64| {
                let geo = frame.geo_from_enu(direction * (sign * STEP_M));
                let (x, y) = from_lon_lat.apply(geo.lon_deg, geo.lat_deg)?;
                Ok::<_, RasterError>(([x, y], grid.transform.pixel_from_map(x, y)))
            };
            let ((map_a, a), (map_b, b)) = (at(-1.0)?, at(1.0)?);
            let slope = |a: [f64; 2], b: [f64; 2]| [0, 1].map(|axis| (b[axis] - a[axis]) / (2.0 * STEP_M));
            Ok([slope(a, b), slope(map_a, map_b)])
        };
        let [east, _] = per_metre(Vector3::x())?;
        let [north, north_on_map] = per_metre(Vector3::y())?;
        let mut nodes = Vec::with_capacity(9);
        for fraction_down in [0.0, 0.5, 1.0] {
            for fraction_right in [0.0, 0.5, 1.0] {
                let (lon, lat) = lon_lat(fraction_right * width - 0.5, fraction_down * height - 0.5)?;
                // Longitudes of a grid across the antimeridian continue beyond 180 degrees.
                nodes.push([lon_deg + (lon - lon_deg + 180.0).rem_euclid(360.0) - 180.0, lat]);
            }
        }
        Ok(Self {
            lon_deg,
            lat_deg,
            east,
            north,
            true_north_deg: north_on_map[0].atan2(north_on_map[1]).to_degrees(),
            nodes,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat_raster::Crs;

    fn grid_at(lon_deg: f64, lat_deg: f64, crs: &Crs, gsd_m: f64) -> GridSpec {
        let frame = LocalFrame::new(GeoPoint::new(lon_deg, lat_deg, 0.0));
        GridSpec::covering(&frame, [-100.0, -100.0, 100.0, 100.0], crs, gsd_m).expect("a grid")
    }

    #[test]
    fn true_north_is_turned_against_the_grid_by_the_meridian_convergence() {
        // Gauss-Krueger: tan(convergence) = tan(lon - central meridian) sin(lat) on the sphere, to a thousandth of a
        // degree on the ellipsoid (Snyder, Map Projections, eq. 8-1 ff.). Grid north lies east of true north in the
        // eastern half of a zone, on the northern hemisphere.
        for (lon_deg, lat_deg, epsg, central_deg) in [
            (36.9, 37.6, 32637, 39.0f64),
            (29.95, 60.0, 32635, 27.0),
            (-81.7, 30.3, 32617, -81.0),
            (151.2, -33.9, 32756, 153.0),
        ] {
            let crs = Crs::from_epsg(epsg).expect("a zone");
            let place = GridLocation::of(&grid_at(lon_deg, lat_deg, &crs, 0.5), 0.0).expect("a place");
            let difference = (lon_deg - central_deg).to_radians();
            let convergence_deg = (difference.tan() * lat_deg.to_radians().sin()).atan().to_degrees();
            assert!(convergence_deg.abs() > 0.3);
            assert!(
                (place.true_north_deg + convergence_deg).abs() < 5e-3,
                "{} and {convergence_deg}",
                place.true_north_deg
            );
            // Directions in pixels and on the map have one angle.
            let [right, down] = place.north;
            let of_pixels_deg = right.atan2(-down).to_degrees();
            assert!((of_pixels_deg - place.true_north_deg).abs() < 1e-6);
            let per_metre = right.hypot(down);
            assert!((per_metre - 2.0).abs() < 2e-3, "{per_metre} cells of half a metre");
        }
    }

    #[test]
    fn cells_of_degrees_are_narrower_than_high() {
        let crs = Crs::from_epsg(4326).expect("WGS 84");
        let place = GridLocation::of(&grid_at(10.0, 60.0, &crs, 1.0), 0.0).expect("a place");
        let ratio = place.east[0] / -place.north[1];
        assert!(
            (ratio - 2.0).abs() < 0.02,
            "at 60 degrees a degree is half as wide: {ratio}"
        );
        assert!(place.true_north_deg.abs() < 1e-6);
    }
}
