//! A requested area of a scene's ground, and the window of each image that shows it.

use super::{Area, Result};
use heliosplat_delivery::IndexImage;
use heliosplat_raster::{Crs, CrsTransform, RasterError, Window};
use heliosplat_rpc::{GeoPoint, LocalFrame};
use nalgebra::Vector3;

/// Margin around an area that is read with it, metres: the margin of a model and the pointing error of the cameras.
const MARGIN_M: f64 = 12.0;
/// Further margin around a window that is read, and its least number of columns or rows, pixels.
pub(super) const READ_PX: (f64, usize) = (16.0, 32);
/// Points per edge of a rectangle for a transformation between coordinate systems, since edges may become curved.
const POINTS_PER_EDGE: usize = 8;

/// Requested rectangle of ground.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AreaRequest {
    /// West, south, east, north in units of `crs`. In degrees, west is above east for a rectangle across the
    /// antimeridian, as in GeoJSON (RFC 7946, 5.2).
    pub bounds: [f64; 4],
    /// Coordinate reference system of the bounds; `None` for longitude and latitude, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crs: Option<String>,
}

impl std::fmt::Display for AreaRequest {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let [west, south, east, north] = self.bounds;
        write!(f, "{west},{south},{east},{north}")?;
        self.crs.iter().try_for_each(|crs| write!(f, ",{crs}"))
    }
}

impl AreaRequest {
    /// Checks that the bounds are a rectangle on Earth.
    ///
    /// # Errors
    /// One sentence with the reason.
    pub fn check(&self) -> Result<(), String> {
        let [west, south, east, north] = self.bounds;
        // Across the antimeridian west is above east; this is distinguishable from swapped bounds only for less than
        // half of the Earth's circumference.
        let crosses = self.crs.is_none() && west > east && self.unwrapped()[2] - west <= 180.0;
        let apart = west < east || crosses;
        if !(apart && south < north && self.bounds.iter().all(|v| v.is_finite())) {
            return Err(format!("{self}: expected west below east and south below north"));
        }
        let on_earth = [west, east].iter().all(|lon| lon.abs() <= 180.0) && south >= -90.0 && north <= 90.0;
        if self.crs.is_none() && !on_earth {
            let text = format!("{self}: these are no degrees; give the system with EPSG:N at the end");
            return Err(text);
        }
        if self.crs.is_none() && east - west > 180.0 {
            return Err(format!(
                "{self}: it spans more than half of the Earth; give west, south, east, north"
            ));
        }
        Ok(())
    }

    /// Bounds with east above west: above 180 degrees for a rectangle across the antimeridian.
    fn unwrapped(&self) -> [f64; 4] {
        let [west, south, east, north] = self.bounds;
        match self.crs.is_none() && west > east {
            true => [west, south, east + 360.0, north],
            false => self.bounds,
        }
    }

    /// Transformation of its coordinates to longitude and latitude; `None` if they are that.
    fn transform(&self) -> Result<Option<CrsTransform>, RasterError> {
        let to_lon_lat = |crs: &String| CrsTransform::to_lon_lat(&Crs::from_definition(crs)?);
        self.crs.as_ref().map(to_lon_lat).transpose()
    }

    /// Longitudes and latitudes of points along the edges, degrees.
    fn outline(&self) -> Result<Vec<[f64; 2]>> {
        let [west, south, east, north] = self.unwrapped();
        let transform = self.transform()?;
        let mut points = Vec::with_capacity(4 * POINTS_PER_EDGE);
        for step in 0..POINTS_PER_EDGE {
            let t = step as f64 / POINTS_PER_EDGE as f64;
            let (x, y) = (west + t * (east - west), south + t * (north - south));
            let (back_x, back_y) = (east - t * (east - west), north - t * (north - south));
            for (x, y) in [(x, south), (east, y), (back_x, north), (west, back_y)] {
                let (lon, lat) = match &transform {
                    Some(transform) => transform.apply(x, y)?,
                    None => (x, y),
                };
                points.push([lon, lat]);
            }
        }
        Ok(points)
    }

    /// Centre of the rectangle at a height, metres above the ellipsoid.
    pub(super) fn place(&self, height_m: f64) -> Result<GeoPoint> {
        let [west, south, east, north] = self.unwrapped();
        let (x, y) = (0.5 * (west + east), 0.5 * (south + north));
        let (lon_deg, lat_deg) = match self.transform()? {
            Some(transform) => transform.apply(x, y)?,
            None => (if x > 180.0 { x - 360.0 } else { x }, y),
        };
        Ok(GeoPoint::new(lon_deg, lat_deg, height_m))
    }

    /// Bounding rectangle in a local frame, metres.
    pub(super) fn area(&self, frame: &LocalFrame) -> Result<Area> {
        let point = |[lon_deg, lat_deg]: [f64; 2]| {
            let enu = frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, frame.origin.height_m));
            [enu.x, enu.y]
        };
        Ok(Area::covering(self.outline()?.into_iter().map(point)))
    }
}

impl std::fmt::Display for Area {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let [west, south, east, north] = [self.west_m, self.south_m, self.east_m, self.north_m];
        write!(
            f,
            "{west:.0} to {east:.0} m east and {south:.0} to {north:.0} m north of its middle"
        )
    }
}

/// Lowest and highest of each coordinate of points.
pub(super) fn bounds(points: impl IntoIterator<Item = [f64; 2]>) -> [[f64; 2]; 2] {
    let start = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    points.into_iter().fold(start, |[low, high], [x, y]| {
        [[low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]]
    })
}

impl Area {
    /// Rectangle of its western, southern, eastern and northern edges, metres.
    pub fn new([west_m, south_m, east_m, north_m]: [f64; 4]) -> Self {
        Self {
            west_m,
            south_m,
            east_m,
            north_m,
        }
    }

    /// Bounding rectangle of points (metres east and north).
    pub(super) fn covering(points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let [[west_m, south_m], [east_m, north_m]] = bounds(points);
        Self::new([west_m, south_m, east_m, north_m])
    }

    /// Intersection of two areas; `None` where it is less than a metre wide.
    pub fn intersection(&self, other: &Self) -> Option<Self> {
        let shared = Self {
            west_m: self.west_m.max(other.west_m),
            south_m: self.south_m.max(other.south_m),
            east_m: self.east_m.min(other.east_m),
            north_m: self.north_m.min(other.north_m),
        };
        (shared.east_m - shared.west_m >= 1.0 && shared.north_m - shared.south_m >= 1.0).then_some(shared)
    }
}

/// Window of an image that shows an area between two altitudes (metres above the ellipsoid), with a margin; `None`
/// where the image does not show the area.
pub(super) fn window_over(
    image: &IndexImage,
    frame: &LocalFrame,
    area: &Area,
    altitude_range_m: (f64, f64),
) -> Option<Window> {
    let origin_m = frame.origin.height_m;
    let mut places = Vec::with_capacity(8);
    for x in [area.west_m - MARGIN_M, area.east_m + MARGIN_M] {
        for y in [area.south_m - MARGIN_M, area.north_m + MARGIN_M] {
            for height_m in [altitude_range_m.0, altitude_range_m.1] {
                let ground = frame.geo_from_enu(Vector3::new(x, y, height_m - origin_m));
                let at = image.rpc.project(ground);
                places.push([at.col, at.row]);
            }
        }
    }
    window_around(places, image.size, READ_PX)
}

/// Window of an image of `size` around places (columns, rows), with a margin, pixels; `None` where fewer columns or rows
/// than the second of the limits are left.
pub(super) fn window_around(places: Vec<[f64; 2]>, size: (usize, usize), limits: (f64, usize)) -> Option<Window> {
    let (margin_px, least_px) = limits;
    let [low, high] = bounds(places);
    let along = |axis: usize, size: usize| {
        // `as` saturates: a window that begins before the image is clipped at the first pixel.
        let first = (low[axis] - margin_px).floor().max(0.0) as usize;
        let end = ((high[axis] + margin_px).ceil().max(0.0) as usize + 1).min(size);
        (first, end.saturating_sub(first))
    };
    let ((col0, width), (row0, height)) = (along(0, size.0), along(1, size.1));
    let window = Window::new((col0, row0), (width, height));
    (width >= least_px && height >= least_px).then_some(window)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(bounds: [f64; 4], crs: Option<&str>) -> AreaRequest {
        AreaRequest {
            bounds,
            crs: crs.map(str::to_owned),
        }
    }

    #[test]
    fn an_area_may_cross_the_antimeridian_in_degrees_and_is_as_small_as_it_is() {
        let crossing = request([179.99, -17.01, -179.99, -16.99], None);
        crossing.check().expect("as GeoJSON writes it");
        let place = crossing.place(0.0).expect("a place");
        assert!((place.lon_deg.abs() - 180.0).abs() < 1e-9 && (place.lat_deg + 17.0).abs() < 1e-9);
        let area = crossing.area(&LocalFrame::new(place)).expect("an area");
        assert!((area.east_m - area.west_m - 2130.0).abs() < 10.0, "{area}");
        // The centre is on the side with the larger part.
        let eastern = request([179.99, -17.0, -179.9, -16.9], None)
            .place(0.0)
            .expect("a place");
        assert!((eastern.lon_deg + 179.955).abs() < 1e-9, "{}", eastern.lon_deg);
    }

    #[test]
    fn bounds_upside_down_or_around_the_earth_are_no_area() {
        assert!(
            request([10.0, 1.0, 9.0, 2.0], None).check().is_err(),
            "almost all longitudes"
        );
        assert!(
            request([-100.0, 1.0, 100.0, 2.0], None).check().is_err(),
            "more than half of them"
        );
        assert!(request([10.0, 1.0, 9.0, 2.0], Some("EPSG:32601")).check().is_err());
        assert!(request([179.0, 1.0, 181.0, 2.0], None).check().is_err());
    }
}
