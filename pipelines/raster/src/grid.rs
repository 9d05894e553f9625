//! Positions of pixels: geotransforms with pixel centres at integers, map grids, and their conversion to the local
//! frame.

use super::{Crs, CrsTransform, RasterError, Result};
use heliosplat_rpc::{GeoPoint, LocalFrame};

/// An affine map from pixel coordinates (centres at integers) to map coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GeoTransform {
    /// Map x and y of the centre of the upper-left pixel.
    pub origin: [f64; 2],
    /// Change of x and y per column.
    pub per_col: [f64; 2],
    /// Change of x and y per row.
    pub per_row: [f64; 2],
}

impl GeoTransform {
    /// North-up transform: the outer corner of the upper-left pixel is at (`west`, `north`), and pixels are `size` map
    /// units wide and high.
    pub fn north_up(west: f64, north: f64, size: f64) -> Self {
        Self::from_gdal([west, size, 0.0, north, 0.0, -size])
    }

    /// Transform from the text beside a truth raster of DFC2019 (`X_DSM.txt`): easting and northing of the raster's
    /// lower-left corner, its size in pixels, metres per pixel; `rows` is the raster's own height. `None` where the
    /// text has another form.
    pub fn from_region_text(text: &str, rows: usize) -> Option<Self> {
        let numbers = text.split_whitespace().filter_map(|word| word.parse().ok());
        let numbers: Vec<f64> = numbers.filter(|number: &f64| number.is_finite()).collect();
        match numbers[..] {
            [west, south, _, metres] if metres > 0.0 => {
                Some(Self::north_up(west, south + rows as f64 * metres, metres))
            }
            _ => None,
        }
    }

    /// Transform from GDAL's six numbers, which count from the outer corner of the upper-left pixel.
    pub fn from_gdal(six: [f64; 6]) -> Self {
        Self {
            origin: [six[0] + 0.5 * (six[1] + six[2]), six[3] + 0.5 * (six[4] + six[5])],
            per_col: [six[1], six[4]],
            per_row: [six[2], six[5]],
        }
    }

    /// GDAL's six numbers, which count from the outer corner of the upper-left pixel.
    pub fn to_gdal(&self) -> [f64; 6] {
        let corner = self.map_from_pixel(-0.5, -0.5);
        let [x, y] = [0, 1].map(|axis| [corner[axis], self.per_col[axis], self.per_row[axis]]);
        [x[0], x[1], x[2], y[0], y[1], y[2]]
    }

    /// Map coordinates of a pixel position.
    pub fn map_from_pixel(&self, col: f64, row: f64) -> [f64; 2] {
        [0, 1].map(|axis| self.origin[axis] + self.per_col[axis] * col + self.per_row[axis] * row)
    }

    /// Pixel position of map coordinates; not finite when the transform is singular.
    pub fn pixel_from_map(&self, x: f64, y: f64) -> [f64; 2] {
        let (dx, dy) = (x - self.origin[0], y - self.origin[1]);
        let det = self.per_col[0] * self.per_row[1] - self.per_row[0] * self.per_col[1];
        [
            (dx * self.per_row[1] - dy * self.per_row[0]) / det,
            (dy * self.per_col[0] - dx * self.per_col[1]) / det,
        ]
    }

    /// Length of a step of one column and of one row, in map units.
    pub fn pixel_size(&self) -> (f64, f64) {
        [self.per_col, self.per_row].map(|[dx, dy]| dx.hypot(dy)).into()
    }

    /// Metres per map unit, eastward and northward, at the centre of a raster of `size` columns and rows: a degree of
    /// longitude shrinks with the cosine of the latitude. Without a coordinate system, map units are metres.
    pub fn metres_per_unit(&self, size: (usize, usize), crs: Option<&Crs>) -> [f64; 2] {
        let Some(crs) = crs else { return [1.0; 2] };
        let [_, y] = self.map_from_pixel(0.5 * size.0 as f64, 0.5 * size.1 as f64);
        let shrink = if crs.is_geographic() { y.to_radians().cos() } else { 1.0 };
        [crs.metres_per_unit() * shrink, crs.metres_per_unit()]
    }

    /// Width and height, metres, of the cell at the centre of a raster of `size` columns and rows.
    pub fn cell_m(&self, size: (usize, usize), crs: Option<&Crs>) -> [f64; 2] {
        let [east, north] = self.metres_per_unit(size, crs);
        [self.per_col, self.per_row].map(|[dx, dy]| (dx * east).hypot(dy * north))
    }
}

/// A map grid: size in pixels, and their map coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct GridSpec {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Map coordinates of the pixels.
    pub transform: GeoTransform,
    /// Coordinate system of the map.
    pub crs: Crs,
}

impl GridSpec {
    /// The part of the grid that begins at a column and a row and has `size` columns and rows.
    #[must_use]
    pub fn part(&self, (col0, row0): (usize, usize), (width, height): (usize, usize)) -> Self {
        let mut part = Self {
            width,
            height,
            ..self.clone()
        };
        part.transform.origin = self.transform.map_from_pixel(col0 as f64, row0 as f64);
        part
    }

    /// Grid of cells that are `factor` times as wide, the last ones of a row or column in part outside.
    #[must_use]
    pub fn reduced(&self, factor: usize) -> Self {
        let mut small = self.part((0, 0), (self.width.div_ceil(factor), self.height.div_ceil(factor)));
        // The centre of a coarse cell is the mean of the centres of the cells that it replaces.
        let middle = (factor - 1) as f64 / 2.0;
        small.transform.origin = self.transform.map_from_pixel(middle, middle);
        small.transform.per_col = self.transform.per_col.map(|step| step * factor as f64);
        small.transform.per_row = self.transform.per_row.map(|step| step * factor as f64);
        small
    }

    /// The north-up grid of `crs`, with pixels of `gsd_m` metres snapped to whole multiples of it, that covers a
    /// rectangle of the local frame (west, south, east, north, metres) at the altitude of the frame's origin.
    ///
    /// # Errors
    /// `RasterError::Transform` when `crs` does not cover the place, or the grid would have more than 2e9 pixels;
    /// `RasterError::UnknownCrs` when PROJ cannot transform to it.
    pub fn covering(frame: &LocalFrame, rectangle_m: [f64; 4], crs: &Crs, gsd_m: f64) -> Result<Self> {
        const POINTS_PER_EDGE: usize = 16;
        let size = gsd_m / crs.metres_per_unit();
        let transform = CrsTransform::from_lon_lat(crs)?;
        let [west, south, east, north] = rectangle_m;
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for step in 0..=POINTS_PER_EDGE {
            let t = step as f64 / POINTS_PER_EDGE as f64;
            let (x, y) = (west + t * (east - west), south + t * (north - south));
            for corner in [[x, south], [x, north], [west, y], [east, y]] {
                let geo = frame.geo_from_enu(nalgebra::Vector3::new(corner[0], corner[1], 0.0));
                let (x, y) = transform.apply(geo.lon_deg, geo.lat_deg)?;
                // Across the antimeridian, degrees continue beyond 180, so that the grid is no wider.
                let x = match crs.is_geographic() {
                    true => around(x, frame.origin.lon_deg),
                    false => x,
                };
                low = [low[0].min(x), low[1].min(y)];
                high = [high[0].max(x), high[1].max(y)];
            }
        }
        let snap_down = |value: f64| (value / size).floor() * size;
        let (left, top) = (snap_down(low[0]), (high[1] / size).ceil() * size);
        let [width, height] = [high[0] - left, top - low[1]].map(|length| (length / size).ceil().max(1.0));
        const MOST_PIXELS: f64 = 2e9;
        if !(width * height).is_finite() || width * height > MOST_PIXELS {
            let reason = format!("a grid of {width} x {height} pixels of {gsd_m} m is too large");
            return Err(RasterError::Transform(crs.name().to_owned(), reason));
        }
        Ok(Self {
            width: width as usize,
            height: height as usize,
            transform: GeoTransform::north_up(left, top, size),
            crs: crs.clone(),
        })
    }
}

/// The longitude equivalent to `lon_deg` that is nearest to `other_deg`, degrees.
fn around(lon_deg: f64, other_deg: f64) -> f64 {
    other_deg + (lon_deg - other_deg + 180.0).rem_euclid(360.0) - 180.0
}

/// Conversion from a map grid to the local frame without a PROJ call per pixel: exact at nodes a few pixels apart and
/// at two heights, interpolated between them.
///
/// The interpolation error is `spacing² / (8 R)` with the Earth's radius `R`: below 0.1 mm for nodes (16 pixels apart)
/// under 70 m apart.
#[derive(Debug, Clone)]
pub struct EnuGrid {
    spacing: usize,
    columns: usize,
    rows: usize,
    heights_m: (f64, f64),
    /// East, north, up at the lower height, then at the upper, per node, row after row.
    nodes: Vec<[[f64; 3]; 2]>,
}

impl EnuGrid {
    /// Tabulates `grid` between two ellipsoidal heights, metres.
    ///
    /// # Errors
    /// `RasterError::Transform` when a node lies outside of the coordinate system; `RasterError::UnknownCrs` when PROJ
    /// cannot transform from it.
    pub fn new(frame: &LocalFrame, grid: &GridSpec, heights_m: (f64, f64)) -> Result<Self> {
        const SPACING_PX: usize = 16;
        let transform = CrsTransform::to_lon_lat(&grid.crs)?;
        // At least one metre apart, so that the interpolation is defined.
        let heights_m = (heights_m.0, heights_m.1.max(heights_m.0 + 1.0));
        let nodes_for = |pixels: usize| pixels.div_ceil(SPACING_PX) + 1;
        let (columns, rows) = (nodes_for(grid.width), nodes_for(grid.height));
        let mut nodes = Vec::with_capacity(columns * rows);
        for node in 0..rows * columns {
            let [col, row] = [node % columns, node / columns].map(|node| (node * SPACING_PX) as f64);
            let [x, y] = grid.transform.map_from_pixel(col, row);
            let (lon_deg, lat_deg) = transform.apply(x, y)?;
            let enu = |height_m| frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, height_m)).into();
            nodes.push([enu(heights_m.0), enu(heights_m.1)]);
        }
        Ok(Self {
            spacing: SPACING_PX,
            columns,
            rows,
            heights_m,
            nodes,
        })
    }

    /// East, north, up (metres) of a pixel position at an ellipsoidal height, metres.
    pub fn enu(&self, col: f64, row: f64, height_m: f64) -> [f64; 3] {
        let [low, high] = self.column_of_air(col, row);
        let t = (height_m - self.heights_m.0) / (self.heights_m.1 - self.heights_m.0);
        std::array::from_fn(|axis| low[axis] + t * (high[axis] - low[axis]))
    }

    /// Ellipsoidal height (metres) at which the pixel position is `up_m` above the frame's tangent plane.
    pub fn height(&self, col: f64, row: f64, up_m: f64) -> f64 {
        let [low, high] = self.column_of_air(col, row);
        let t = (up_m - low[2]) / (high[2] - low[2]);
        self.heights_m.0 + t * (self.heights_m.1 - self.heights_m.0)
    }

    fn column_of_air(&self, col: f64, row: f64) -> [[f64; 3]; 2] {
        let locate = |position: f64, count: usize| {
            let at = position / self.spacing as f64;
            let node = at.floor().clamp(0.0, (count - 2) as f64);
            (node as usize, at - node)
        };
        let ((c, fc), (r, fr)) = (locate(col, self.columns), locate(row, self.rows));
        let node = |dc: usize, dr: usize| &self.nodes[(r + dr) * self.columns + c + dc];
        let (a, b, d, e) = (node(0, 0), node(1, 0), node(0, 1), node(1, 1));
        std::array::from_fn(|level| {
            std::array::from_fn(|axis| {
                let top = a[level][axis] * (1.0 - fc) + b[level][axis] * fc;
                let bottom = d[level][axis] * (1.0 - fc) + e[level][axis] * fc;
                top * (1.0 - fr) + bottom * fr
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gdal_corners_become_pixel_centres_and_go_back() {
        let six = [500_000.0, 0.5, 0.0, 4_160_000.0, 0.0, -0.5];
        let transform = GeoTransform::from_gdal(six);
        assert_eq!(transform.map_from_pixel(0.0, 0.0), [500_000.25, 4_159_999.75]);
        assert_eq!(transform.to_gdal(), six);
        let [col, row] = transform.pixel_from_map(500_010.25, 4_159_989.75);
        assert!((col - 20.0).abs() < 1e-9 && (row - 20.0).abs() < 1e-9);
    }

    #[test]
    fn a_cell_in_degrees_is_narrower_away_from_the_equator() {
        let degrees = Crs::from_epsg(4326).expect("WGS 84");
        let cells = GeoTransform::north_up(25.0, 60.0, 1e-5);
        let [width_m, height_m] = cells.cell_m((20, 20), Some(&degrees));
        assert!((height_m - 1.113).abs() < 1e-3, "{height_m}");
        assert!((width_m / height_m - 0.5).abs() < 1e-4, "{width_m} {height_m}");
        assert_eq!(cells.metres_per_unit((20, 20), None), [1.0; 2]);
    }

    #[test]
    fn a_rotated_transform_inverts() {
        let transform = GeoTransform::from_gdal([10.0, 0.4, 0.3, 20.0, 0.3, -0.4]);
        let [x, y] = transform.map_from_pixel(7.5, -3.25);
        let [col, row] = transform.pixel_from_map(x, y);
        assert!((col - 7.5).abs() < 1e-12 && (row + 3.25).abs() < 1e-12);
    }

    #[test]
    fn the_tabulated_grid_agrees_with_proj_below_a_millimetre() {
        let origin = GeoPoint::new(36.91, 37.585, 700.0);
        let frame = LocalFrame::new(origin);
        let crs = Crs::utm(origin).expect("UTM");
        let grid = GridSpec::covering(&frame, [-300.0, -260.0, 280.0, 240.0], &crs, 0.5).expect("a grid");
        let table = EnuGrid::new(&frame, &grid, (640.0, 780.0)).expect("inside UTM");
        let exact = CrsTransform::to_lon_lat(&crs).expect("PROJ");
        for (col, row, height) in [(3.3, 9.7, 650.0), (700.2, 411.9, 700.0), (1100.0, 900.5, 779.0)] {
            let [x, y] = grid.transform.map_from_pixel(col, row);
            let (lon_deg, lat_deg) = exact.apply(x, y).expect("inside UTM");
            let want = frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, height));
            let got = table.enu(col, row, height);
            for axis in 0..3 {
                assert!((got[axis] - want[axis]).abs() < 1e-3, "{got:?} {want:?}");
            }
            assert!((table.height(col, row, want.z) - height).abs() < 1e-3);
        }
    }

    #[test]
    fn places_at_the_antimeridian_and_at_the_borders_of_zones_have_grids_as_small_as_they_are() {
        for (lon_deg, lat_deg, zone) in [
            (179.9999, -17.0, 32760),
            (-179.9999, -17.0, 32701),
            (180.0, 65.0, 32601),
            (35.9999, 37.0, 32636),
            (36.0, 37.0, 32637),
            (2.9999, 60.0, 32631),
            (20.9999, 78.0, 32633),
        ] {
            let origin = GeoPoint::new(lon_deg, lat_deg, 0.0);
            let frame = LocalFrame::new(origin);
            let crs = Crs::utm(origin).expect("UTM");
            assert_eq!(crs.definition(), format!("EPSG:{zone}"));
            let rectangle = [-500.0, -400.0, 500.0, 400.0];
            let grid = GridSpec::covering(&frame, rectangle, &crs, 1.0).expect("a grid");
            // Meridians lean by up to three degrees at the border of a zone, and by six at that of the wide zones of
            // Svalbard.
            assert!(
                (1000..1090).contains(&grid.width) && (800..910).contains(&grid.height),
                "{grid:?}"
            );
            let degrees = Crs::from_epsg(4326).expect("WGS 84");
            let grid = GridSpec::covering(&frame, rectangle, &degrees, 10.0).expect("a grid");
            assert!(grid.width < 550 && grid.height < 90, "{} x {}", grid.width, grid.height);
            // Cells on either side are where they belong.
            let enu = EnuGrid::new(&frame, &grid, (0.0, 10.0)).expect("on Earth");
            let [west, ..] = enu.enu(0.0, 40.0, 0.0);
            let [east, ..] = enu.enu(grid.width as f64 - 1.0, 40.0, 0.0);
            assert!(west > -530.0 && east < 530.0 && east - west > 950.0, "{west} {east}");
        }
    }

    #[test]
    fn the_covering_grid_holds_the_rectangle_and_is_snapped() {
        let origin = GeoPoint::new(-81.66, 30.35, 0.0);
        let crs = Crs::utm(origin).expect("UTM");
        let grid = GridSpec::covering(&LocalFrame::new(origin), [-64.0, -64.0, 64.0, 64.0], &crs, 0.5).expect("a grid");
        assert!(grid.width >= 256 && grid.height >= 256 && grid.width < 264, "{grid:?}");
        let corner = grid.transform.to_gdal();
        assert!((corner[0] / 0.5).fract().abs() < 1e-6 && (corner[3] / 0.5).fract().abs() < 1e-6);
    }
}
