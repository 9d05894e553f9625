//! Tiles of a sweep that fit into memory.
//!
//! Cores of tiles are on the cells of one map grid and do not overlap. A tile is swept beyond its core: over the margin
//! in which it is blended with its neighbours, and over a rim around that, where heights have fewer neighbours. All
//! tiles are in the frame of the whole scene, and on one lattice of ground cells on each level of the search.

use super::config::SatelliteConfig;
use super::error::SatelliteError;
use super::ground::{MARGIN_M, volume};
use super::sweep_memory::{SweepExtent, SweepModel};
use heliosplat_raster::{Crs, CrsTransform, GridSpec};
use heliosplat_rpc::GeoPoint;
use heliosplat_scene::survey::Survey;
use heliosplat_scene::{Area, crop};

/// Width of the blended margin on each side of a core's border, cells of the ground.
const BLEND_CELLS: f64 = 32.0;
/// Width of the rim around the blended margin, cells: the paths of semi-global matching forget their start within some
/// tens of cells (docs/lab/streaming.md).
const RIM_CELLS: f64 = 32.0;
/// Width of a cell of the search's coarsest level, cells: tiles begin at multiples of it, so that all levels share one
/// lattice.
const LATTICE: f64 = 8.0;
/// Least side of a core, map cells: smaller cores have too much rim.
const LEAST_CORE: usize = 96;
/// Points per edge of a tile for the transformation from map to ground, since edges may become curved.
const POINTS_PER_EDGE: usize = 8;
/// Bytes per map cell of the rows that are blended at once: the values of tiles, and the rows twice.
const BYTES_PER_BLENDED_CELL: f64 = 64.0;
/// Rows of the map that are blended at once.
pub(super) const ROWS_AT_ONCE: usize = 256;

/// Plan of a sweep.
#[derive(Debug, Clone)]
pub struct SweepPlan {
    /// Width of a cell of the ground grid, metres.
    pub cell_m: f64,
    /// Largest memory of the process, bytes.
    pub peak_bytes: f64,
    /// Tiles of the sweep; `None` where the scene fits as a whole.
    pub tiling: Option<SweepTiling>,
}

/// The tiles of a sweep.
#[derive(Debug, Clone)]
pub struct SweepTiling {
    /// Map grid of the whole surface model.
    pub grid: GridSpec,
    /// Ground that is swept, metres of the scene's frame; its edges are on cells.
    pub whole: Area,
    /// Number of rows and columns of tiles.
    pub size: (usize, usize),
    /// Tiles that two images may show, row by row.
    pub tiles: Vec<SweepTile>,
}

/// One tile of a sweep.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepTile {
    /// Columns and rows of the map in the core, each as first and one past the last.
    pub core: [[usize; 2]; 2],
    /// Columns and rows of the map in the core and the margins that are blended with the neighbours, each as first and
    /// one past the last.
    pub bounds: [[usize; 2]; 2],
    /// Ground that is swept for the tile, metres of the scene's frame.
    pub area: Area,
}

/// Grid of a surface model's file.
#[derive(Debug, Clone, Copy)]
pub struct MapRequest<'a> {
    /// Width of a cell, metres; `None` for the ground sampling distance of the images.
    pub gsd_m: Option<f64>,
    /// Coordinate reference system; `None` for the local UTM zone.
    pub crs: Option<&'a str>,
}

impl SweepPlan {
    /// Plan of a scene's sweep within `limit` bytes; `None` for no limit.
    ///
    /// # Errors
    /// When no tiles fit into the limit, or a map coordinate cannot be transformed.
    pub fn of(
        survey: &Survey,
        config: &SatelliteConfig,
        map: &MapRequest,
        limit: Option<u64>,
    ) -> Result<Self, SatelliteError> {
        let cell_m = config.start.cell_gsd * survey.gsd_m;
        let cutter = Cutter::new(survey, cell_m, map)?;
        let limit = limit.map_or(f64::INFINITY, |limit| limit as f64);
        let as_a_whole = cutter.bytes_as_a_whole();
        if as_a_whole <= limit {
            return Ok(Self {
                cell_m,
                peak_bytes: as_a_whole,
                tiling: None,
            });
        }
        let (mut rows, mut cols) = (1, 1);
        loop {
            let (tiles, peak_bytes) = cutter.tiles((rows, cols))?;
            if peak_bytes <= limit {
                return Ok(Self {
                    cell_m,
                    peak_bytes,
                    tiling: Some(SweepTiling {
                        grid: cutter.grid,
                        whole: cutter.whole,
                        size: (rows, cols),
                        tiles,
                    }),
                });
            }
            let (high, wide) = (cutter.grid.height / rows, cutter.grid.width / cols);
            if high.max(wide) / 2 < LEAST_CORE {
                return Err(SatelliteError::Input(format!(
                    "--memory: the smallest tiles of this sweep, of {} altitudes per cell, need about {:.2} GiB and {:.2} GiB are allowed; give more, or a narrower --altitude",
                    cutter.model.levels,
                    peak_bytes / f64::from(1 << 30),
                    limit / f64::from(1 << 30)
                )));
            }
            if high >= wide {
                rows += 1;
            } else {
                cols += 1;
            }
        }
    }
}

struct Cutter<'a> {
    survey: &'a Survey<'a>,
    model: SweepModel,
    cell_m: f64,
    grid: GridSpec,
    whole: Area,
    to_lon_lat: CrsTransform,
}

impl<'a> Cutter<'a> {
    fn new(survey: &'a Survey<'a>, cell_m: f64, map: &MapRequest) -> Result<Self, SatelliteError> {
        let crs = match map.crs {
            Some(definition) => Crs::horizontal(definition)?,
            None => Crs::utm(survey.frame().origin)?,
        };
        let area = survey.area();
        let rectangle = [area.west_m, area.south_m, area.east_m, area.north_m];
        let gsd_m = map.gsd_m.unwrap_or(survey.gsd_m);
        let grid = GridSpec::covering(survey.frame(), rectangle, &crs, gsd_m)?;
        let searched = volume(&crop::grown(area, MARGIN_M), (0.0, 0.0), cell_m);
        let on_lattice = |at: f32| (f64::from(at) / cell_m).round() * cell_m;
        let edges = [searched.west_m, searched.south_m, searched.east_m, searched.north_m];
        Ok(Self {
            model: SweepModel::of(survey, cell_m),
            to_lon_lat: CrsTransform::to_lon_lat(&grid.crs)?,
            survey,
            cell_m,
            grid,
            whole: Area::new(edges.map(on_lattice)),
        })
    }

    fn cells(&self, area: &Area) -> f64 {
        (area.east_m - area.west_m) * (area.north_m - area.south_m) / (self.cell_m * self.cell_m)
    }

    fn bytes_as_a_whole(&self) -> f64 {
        self.model.bytes(&SweepExtent {
            cells: self.cells(&self.whole),
            map_cells: self.grid.width as f64 * self.grid.height as f64,
            pixels: self.survey.pixels(),
            largest: self.survey.largest_image(),
        })
    }

    /// Tiles of a number of `rows` and `cols`, and the largest memory of the process, bytes.
    fn tiles(&self, (rows, cols): (usize, usize)) -> Result<(Vec<SweepTile>, f64), SatelliteError> {
        let metres_per_map_cell = self.grid.transform.pixel_size().0 * self.grid.crs.metres_per_unit();
        let blended = (BLEND_CELLS * self.cell_m / metres_per_map_cell).ceil() as usize;
        let share = |count: usize, parts: usize, index: usize| [count * index / parts, count * (index + 1) / parts];
        let wider =
            |[first, end]: [usize; 2], count: usize| [first.saturating_sub(blended), (end + blended).min(count)];
        let mut peak = BYTES_PER_BLENDED_CELL * (ROWS_AT_ONCE * self.grid.width) as f64;
        let mut tiles = Vec::with_capacity(rows * cols);
        for row in 0..rows {
            for col in 0..cols {
                let core = [share(self.grid.width, cols, col), share(self.grid.height, rows, row)];
                let bounds = [wider(core[0], self.grid.width), wider(core[1], self.grid.height)];
                let Some(area) = self.ground(&bounds)? else {
                    continue;
                };
                let read = self.survey.part(&area);
                if read.images < 2 {
                    continue;
                }
                peak = peak.max(self.model.bytes(&SweepExtent {
                    cells: self.cells(&area),
                    map_cells: bounds.iter().map(|[first, end]| (end - first) as f64).product(),
                    pixels: read.pixels,
                    largest: read.largest,
                }));
                tiles.push(SweepTile { core, bounds, area });
            }
        }
        Ok((tiles, peak))
    }

    /// Ground that is swept for a rectangle of the map; `None` where it lies outside of the whole ground.
    fn ground(&self, [columns, rows]: &[[usize; 2]; 2]) -> Result<Option<Area>, SatelliteError> {
        let frame = self.survey.frame();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let along = |[first, end]: &[usize; 2], t: f64| *first as f64 - 0.5 + t * (end - first) as f64;
        for step in 0..=POINTS_PER_EDGE {
            let t = step as f64 / POINTS_PER_EDGE as f64;
            let (col, row) = (along(columns, t), along(rows, t));
            for (col, row) in [
                (col, along(rows, 0.0)),
                (col, along(rows, 1.0)),
                (along(columns, 0.0), row),
                (along(columns, 1.0), row),
            ] {
                let [x, y] = self.grid.transform.map_from_pixel(col, row);
                let (lon_deg, lat_deg) = self.to_lon_lat.apply(x, y)?;
                let at = frame.enu_from_geo(GeoPoint::new(lon_deg, lat_deg, frame.origin.height_m));
                for (axis, v) in [at.x, at.y].into_iter().enumerate() {
                    low[axis] = low[axis].min(v);
                    high[axis] = high[axis].max(v);
                }
            }
        }
        let whole = self.whole;
        let (rim_m, lattice_m) = (RIM_CELLS * self.cell_m, LATTICE * self.cell_m);
        let down = |from: f64, v: f64| from + ((v - from) / lattice_m).floor() * lattice_m;
        let up = |from: f64, v: f64| from + ((v - from) / lattice_m).ceil() * lattice_m;
        let area = Area {
            west_m: down(whole.west_m, low[0] - rim_m).max(whole.west_m),
            south_m: down(whole.north_m, low[1] - rim_m).max(whole.south_m),
            east_m: up(whole.west_m, high[0] + rim_m).min(whole.east_m),
            north_m: up(whole.north_m, high[1] + rim_m).min(whole.north_m),
        };
        let inside = area.east_m - area.west_m >= lattice_m && area.north_m - area.south_m >= lattice_m;
        Ok(inside.then_some(area))
    }
}
