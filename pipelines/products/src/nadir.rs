//! A map grid over a place, and the camera that looks straight down on it.

use crate::model::LoadedModel;
use glam::DVec3;
use heliosplat::ProjectiveCamera;
use heliosplat_raster::grid::{EnuGrid, GridSpec};
use heliosplat_raster::{Crs, CrsTransform, Result};
use heliosplat_rpc::{GeoPoint, LocalFrame};
use heliosplat_scene::{Area, Scene};

/// Map grid over an area, and the camera that looks straight down on it.
pub struct NadirGrid {
    /// Map grid.
    pub grid: GridSpec,
    /// Camera that looks straight down: one pixel per grid cell.
    pub camera: ProjectiveCamera,
    /// Local coordinates of the cells, metres east, north and up.
    pub(super) enu: EnuGrid,
}

/// Piece of ground with its range of altitudes.
#[derive(Debug, Clone, Copy)]
pub struct GroundExtent {
    /// Local frame of the ground.
    pub frame: LocalFrame,
    /// Bounds of the ground, metres of the frame.
    pub area: Area,
    /// Lowest and highest ellipsoidal altitude, metres.
    pub altitude_range_m: (f64, f64),
}

impl From<&LoadedModel> for GroundExtent {
    fn from(model: &LoadedModel) -> Self {
        Self {
            frame: model.frame,
            area: model.file.area,
            altitude_range_m: model.file.altitude_range_m,
        }
    }
}

impl From<&Scene> for GroundExtent {
    fn from(scene: &Scene) -> Self {
        Self {
            frame: scene.frame,
            area: scene.area,
            altitude_range_m: scene.altitude_range_m,
        }
    }
}

impl NadirGrid {
    /// Grid over a place with cells of `gsd_m` metres in the coordinate system `crs`, the local UTM zone by default.
    ///
    /// # Errors
    /// When the coordinate system does not cover the place.
    pub fn new(place: &GroundExtent, gsd_m: f64, crs: Option<&str>) -> Result<Self> {
        let GroundExtent { frame, area, .. } = place;
        let crs = match crs {
            Some(definition) => Crs::horizontal(definition)?,
            None => Crs::utm(frame.origin)?,
        };
        let rectangle = [area.west_m, area.south_m, area.east_m, area.north_m];
        let grid = GridSpec::covering(frame, rectangle, &crs, gsd_m)?;
        Self::on(place, grid)
    }

    /// Camera over a given grid, in the frame of `place`.
    ///
    /// # Errors
    /// When the grid lies outside its coordinate system.
    pub fn on(place: &GroundExtent, grid: GridSpec) -> Result<Self> {
        let enu = EnuGrid::new(&place.frame, &grid, place.altitude_range_m)?;
        let camera = nadir_camera(&enu, &grid, place.frame.origin.height_m);
        Ok(Self { grid, camera, enu })
    }

    /// Grid that belongs to no model's frame, such as a mosaic's, with a frame of its own, whose origin is the middle
    /// of the grid at the lowest altitude. `altitude_m` is a surface on the grid, metres above the ellipsoid, NaN where
    /// unknown.
    ///
    /// # Errors
    /// When the grid lies outside its coordinate system.
    pub fn of_surface(grid: GridSpec, altitude_m: &[f32]) -> Result<(Self, LocalFrame)> {
        let known = || altitude_m.iter().copied().filter(|v| v.is_finite()).map(f64::from);
        let ends = known().reduce(f64::min).zip(known().reduce(f64::max));
        let (low, high) = ends.unwrap_or_default();
        let sides = [0.5 * grid.width as f64, 0.5 * grid.height as f64];
        let [x, y] = grid.transform.map_from_pixel(sides[0], sides[1]);
        let (lon_deg, lat_deg) = CrsTransform::to_lon_lat(&grid.crs)?.apply(x, y)?;
        let frame = LocalFrame::new(GeoPoint::new(lon_deg, lat_deg, low));
        let cell_m = grid.transform.pixel_size().0 * grid.crs.metres_per_unit();
        let [wide_m, high_m] = sides.map(|cells| cells * cell_m);
        let place = GroundExtent {
            frame,
            area: Area::new([-wide_m, -high_m, wide_m, high_m]),
            altitude_range_m: (low, high),
        };
        Ok((Self::on(&place, grid)?, frame))
    }

    /// Vectors from a cell to the next column and row at the grid's middle and an ellipsoidal height, metres east and
    /// north of the local frame.
    pub fn cell_vectors_m(&self, height_m: f64) -> CellVectors {
        let (col, row) = (0.5 * self.grid.width as f64, 0.5 * self.grid.height as f64);
        let at = |col: f64, row: f64| self.enu.enu(col, row, height_m);
        let between = |[a, b, _]: [f64; 3], [c, d, _]: [f64; 3]| [c - a, d - b];
        CellVectors {
            per_col: between(at(col - 0.5, row), at(col + 0.5, row)),
            per_row: between(at(col, row - 0.5), at(col, row + 0.5)),
        }
    }

    /// Width of a cell, metres.
    pub(crate) fn cell_m(&self) -> f32 {
        (self.grid.transform.pixel_size().0 * self.grid.crs.metres_per_unit()) as f32
    }

    /// Ellipsoidal height of a grid cell where the surface is `up_m` above the frame's origin, both in metres.
    pub fn height(&self, col: usize, row: usize, up_m: f32) -> f64 {
        self.enu.height(col as f64, row as f64, f64::from(up_m))
    }
}

/// The affine map from the local frame to grid cells, least squares over nine nodes: over a few kilometres a map
/// projection is affine to far below a pixel.
fn nadir_camera(enu: &EnuGrid, grid: &GridSpec, height_m: f64) -> ProjectiveCamera {
    let (w, h) = ((grid.width - 1) as f64, (grid.height - 1) as f64);
    let mut normal = nalgebra::Matrix3::<f64>::zeros();
    let mut right = nalgebra::Matrix3x2::<f64>::zeros();
    for fx in [0.0, 0.5, 1.0] {
        for fy in [0.0, 0.5, 1.0] {
            let (col, row) = (fx * w, fy * h);
            let [e, n, _] = enu.enu(col, row, height_m);
            let x = nalgebra::Vector3::new(e, n, 1.0);
            normal += x * x.transpose();
            right += x * nalgebra::RowVector2::new(col, row);
        }
    }
    // A grid of one row or column does not fix the map: then the pixel size does.
    let solved = normal.try_inverse().map(|inverse| inverse * right);
    let solved = solved.filter(|m| m.iter().all(|v| v.is_finite()));
    let map = solved.filter(|_| grid.width > 1 && grid.height > 1).unwrap_or_else(|| {
        let [e, n, _] = enu.enu(0.0, 0.0, height_m);
        let inverse = 1.0 / (grid.transform.pixel_size().0 * grid.crs.metres_per_unit());
        nalgebra::Matrix3x2::new(inverse, 0.0, 0.0, -inverse, -e * inverse, n * inverse)
    });
    let row = |k: usize| [map[(0, k)], map[(1, k)], 0.0, map[(2, k)]];
    ProjectiveCamera::new(row(0), row(1), [0.0; 3], (grid.width, grid.height), -DVec3::Z)
}

/// Vectors from a cell to the next column and row, metres east and north.
#[derive(Debug, Clone, Copy)]
pub struct CellVectors {
    /// Vector to the next column.
    pub per_col: [f64; 2],
    /// Vector to the next row.
    pub per_row: [f64; 2],
}

impl CellVectors {
    /// Offset of some columns and rows, metres east and north.
    pub(crate) fn offset_m(&self, cols: f64, rows: f64) -> [f64; 2] {
        [0, 1].map(|axis| cols * self.per_col[axis] + rows * self.per_row[axis])
    }

    /// Numbers of columns and rows within a distance, at least 1.
    pub(crate) fn reach(&self, distance_m: f64) -> [usize; 2] {
        [self.per_col, self.per_row].map(|[east, north]| ((distance_m / east.hypot(north)) as usize).max(1))
    }

    /// Columns and rows per metre in a direction (east, north).
    pub(crate) fn toward(&self, [east, north]: [f64; 2]) -> [f64; 2] {
        let ([a, b], [c, d]) = (self.per_col, self.per_row);
        let determinant = a * d - b * c;
        [east * d - north * c, north * a - east * b].map(|value| value / determinant)
    }
}
