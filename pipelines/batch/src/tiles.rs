//! Tiles of an area: as few as fit into memory, small enough that pinhole cameras fit the RPCs.
//!
//! Cores are disjoint blocks of cells of the mosaic's grid; a tile is its core with a margin that overlaps its
//! neighbours. The overlap holds objects that cast shadows into the core, and lets the mosaic blend neighbours.

use super::blocks::common;
use super::manifest::{LEAST_SIDE_M, TileOptions};
use super::{BatchError, Result};
use heliosplat_raster::{Crs, GridSpec};
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::estimate::{Estimate, Extent, PROGRAM_BYTES, estimate_of, sweep_estimate};
use heliosplat_scene::AreaRequest;
use heliosplat_scene::survey::{Survey, TileSurvey};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Bytes per pixel and band of the images that a tile reads: the values, and half as much for reading.
const BYTES_PER_PIXEL: f64 = 4.0 * 1.5;
/// Largest side of a patch in which tie points are sought, ground sampling distances.
const PATCH_CELLS: f64 = 800.0;
/// Most patches in each direction.
const MOST_PATCHES: f64 = 5.0;
/// Most tiles of an area.
const MOST_TILES: usize = 100_000;

/// Grid of an area's mosaic, and its tiles.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Tiling {
    /// Coordinate reference system.
    pub crs: String,
    /// Width of a cell, metres.
    pub gsd_m: f64,
    /// West, south, east, north of the mosaic, in units of `crs`.
    pub bounds: [f64; 4],
    /// Number of rows and of columns of tiles.
    pub size: (usize, usize),
    /// Tiles that at least two training images show.
    pub tiles: Vec<Tile>,
}

/// Tile of an area.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Tile {
    /// Row of the tile, counted from the north.
    pub row: usize,
    /// Column of the tile, counted from the west.
    pub col: usize,
    /// West, south, east, north of the core, in units of the tiling's `crs`.
    pub core: [f64; 4],
    /// Core with its overlap.
    pub area: AreaRequest,
    /// Ground, images and pixels of the tile.
    pub survey: TileSurvey,
    /// Estimated Gaussians, memory and steps of its training.
    pub estimate: Estimate,
}

impl Tile {
    /// Name of the tile within its area: `tile-rROWcCOLUMN`.
    pub fn name(&self) -> String {
        format!("tile-r{}c{}", self.row, self.col)
    }
}

/// Area and images to tile, and the limits of a tile.
pub struct Request<'a> {
    /// Name of the area, for errors.
    pub name: &'a str,
    /// Name of the images, for errors.
    pub images: &'a str,
    /// Survey of the scene.
    pub survey: &'a Survey<'a>,
    /// Limits of a tile.
    pub options: &'a TileOptions,
    /// Settings of the plane sweep and the training.
    pub config: &'a SatelliteConfig,
    /// True if the tiles are trained, false if they are only swept.
    pub trains: bool,
}

/// Cuts an area into tiles that respect the limits.
///
/// # Errors
/// When no tile is shown by two training images, or tiles of the least size exceed a limit.
pub fn cut(request: &Request) -> Result<Tiling> {
    let Request { survey, options, .. } = request;
    let crs = Crs::utm(survey.frame().origin)?;
    let rounded_m = ((survey.gsd_m * 100.0).round() / 100.0).max(0.01);
    let gsd_m = options.gsd_m.unwrap_or(rounded_m);
    let area = survey.area();
    let rectangle = [area.west_m, area.south_m, area.east_m, area.north_m];
    let grid = GridSpec::covering(survey.frame(), rectangle, &crs, gsd_m)?;
    let (mut rows, mut cols) = at_first(request, &grid, gsd_m);
    loop {
        let side_m = |cells: usize, parts: usize| cells as f64 * gsd_m / parts as f64;
        let (high_m, wide_m) = (side_m(grid.height, rows), side_m(grid.width, cols));
        match try_cut(request, &grid, gsd_m, (rows, cols))? {
            Ok(tiling) if tiling.tiles.is_empty() => {
                return Err(BatchError::Refused(format!(
                    "{}: no tile of it is shown by two training images of {}; give other bounds",
                    request.name, request.images
                )));
            }
            Ok(tiling) => return Ok(tiling),
            Err(TooMuch { what, remedy }) => {
                let smallest = high_m.max(wide_m) / 1.2 < LEAST_SIDE_M;
                if smallest || rows * cols >= MOST_TILES {
                    let (name, side_m) = (request.name, high_m.max(wide_m));
                    let reason = format!("{name}: tiles of {side_m:.0} m would still take {what}; {remedy}");
                    return Err(BatchError::Refused(reason));
                }
            }
        }
        if high_m >= wide_m {
            rows = grown(rows);
        } else {
            cols = grown(cols);
        }
    }
}

fn grown(parts: usize) -> usize {
    (parts + 1).max(parts + parts / 5)
}

/// Fewest rows and columns of tiles for the largest allowed side.
fn at_first(request: &Request, grid: &GridSpec, gsd_m: f64) -> (usize, usize) {
    let parts = |cells: usize| {
        let side_m = request.options.side_m.unwrap_or(f64::INFINITY);
        ((cells as f64 * gsd_m / side_m - 1e-6).ceil() as usize).clamp(1, cells.max(1))
    };
    (parts(grid.height), parts(grid.width))
}

/// Exceeded limit of a tile and its remedy, as text.
struct TooMuch {
    what: String,
    remedy: &'static str,
}

/// Tiling of so many rows and columns, or the limit that the first unfit tile exceeds.
fn try_cut(
    request: &Request,
    grid: &GridSpec,
    gsd_m: f64,
    (rows, cols): (usize, usize),
) -> Result<Result<Tiling, TooMuch>> {
    let [west, _, _, north, ..] = grid.transform.to_gdal();
    let (cell, overlap) = (grid.transform.pixel_size().0, request.options.overlap_m / gsd_m);
    let overlap = overlap.round() * grid.transform.pixel_size().0;
    let (south, east) = (north - cell * grid.height as f64, west + cell * grid.width as f64);
    let bounds = [west, south, east, north];
    let line = |col: usize| west + cell * (grid.width * col / cols) as f64;
    let level = |row: usize| north - cell * (grid.height * row / rows) as f64;
    let mut tiles = Vec::new();
    for row in 0..rows {
        let tile = |col: usize| -> Result<Option<Tile>> {
            let core = [line(col), level(row + 1), line(col + 1), level(row)];
            let [left, bottom, right, top] = core;
            let wider = [left - overlap, bottom - overlap, right + overlap, top + overlap];
            let (bounds, crs) = (common(wider, bounds), Some(grid.crs.definition().to_owned()));
            let area = AreaRequest { bounds, crs };
            let survey = request.survey.tile(&area)?;
            Ok(survey.map(|survey| Tile {
                row,
                col,
                core,
                area,
                estimate: estimate(request, &survey),
                survey,
            }))
        };
        for tile in (0..cols).into_par_iter().map(tile).collect::<Vec<_>>() {
            let Some(tile) = tile? else { continue };
            if let Some(too_much) = too_much(request.options, &tile.estimate) {
                return Ok(Err(too_much));
            }
            tiles.push(tile);
        }
    }
    if let Some(too_far) = too_far(request, &tiles, (rows, cols))? {
        return Ok(Err(too_far));
    }
    Ok(Ok(Tiling {
        crs: grid.crs.definition().to_owned(),
        gsd_m,
        bounds,
        size: (rows, cols),
        tiles,
    }))
}

/// Excessive residual of the pinhole cameras against the rational ones, pixels, if any, measured in the tiles in the
/// middle, at the corners and at the edges of the area. All tiles have one size, and the distortion of a rational
/// camera is similar from one tile to the next; a finished tile states its own residual.
fn too_far(request: &Request, tiles: &[Tile], (rows, cols): (usize, usize)) -> Result<Option<TooMuch>> {
    let along = |count: usize| [count / 2, 0, count - 1];
    let levels = along(rows).into_iter();
    let places = levels.flat_map(|row| along(cols).map(|col| (row, col)));
    let nearest = |(row, col)| {
        let apart = |place: &usize| tiles[*place].row.abs_diff(row) + tiles[*place].col.abs_diff(col);
        (0..tiles.len()).min_by_key(apart)
    };
    let places: BTreeSet<usize> = places.filter_map(nearest).collect();
    for tile in places.into_iter().filter_map(|place| tiles.get(place)) {
        let most_px = request.options.residual_px;
        let residual_px = request.survey.residual_px(&tile.area, most_px)?;
        if residual_px > most_px {
            return Ok(Some(TooMuch {
                what: format!("{residual_px:.3} px off their rational cameras"),
                remedy: "give a narrower altitude_m, or a larger tiles.residual_px",
            }));
        }
    }
    Ok(None)
}

/// Rectangles of at most [`PATCH_CELLS`] sampling distances a side, spread evenly over an area, for tie points.
pub(super) fn patches(tiling: &Tiling, gsd_m: f64) -> Vec<AreaRequest> {
    let [west, south, east, north] = tiling.bounds;
    let side = |from: f64, to: f64| (to - from).min(PATCH_CELLS * gsd_m);
    let (wide, high) = (side(west, east), side(south, north));
    let along = |from: f64, to: f64, side: f64| {
        let count = ((to - from) / side).floor().clamp(1.0, MOST_PATCHES);
        (0..count as usize).map(move |k| from + (k as f64 + 0.5) * (to - from) / count - 0.5 * side)
    };
    let rows = along(south, north, high);
    let patch = |x: f64, y: f64| {
        let (bounds, crs) = ([x, y, x + wide, y + high], Some(tiling.crs.clone()));
        AreaRequest { bounds, crs }
    };
    let corners = rows.flat_map(|y| along(west, east, wide).map(move |x| (x, y)));
    corners.map(|(x, y)| patch(x, y)).collect()
}

fn estimate(request: &Request, tile: &TileSurvey) -> Estimate {
    if !request.trains {
        return sweep_estimate(request.survey, tile, request.config);
    }
    let extent = Extent {
        area: tile.area,
        gsd_m: request.survey.gsd_m,
        bands: request.survey.bands,
        training: tile.training,
        altitudes_m: request.survey.altitude_range_m.1 - request.survey.altitude_range_m.0,
        widest_base_to_height: request.survey.widest_base_to_height,
    };
    let read = PROGRAM_BYTES + BYTES_PER_PIXEL * tile.pixels * request.survey.bands as f64;
    estimate_of(&extent, request.config, read)
}

fn too_much(options: &TileOptions, estimate: &Estimate) -> Option<TooMuch> {
    let gib = |bytes: f64| bytes / f64::from(1 << 30);
    let memory = options.memory_bytes().map_or(f64::INFINITY, |bytes| bytes as f64);
    (estimate.peak_bytes > memory).then(|| TooMuch {
        what: format!("{:.2} GiB of {:.2}", gib(estimate.peak_bytes), gib(memory)),
        remedy: "give more tiles.memory or less tiles.overlap_m",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_lie_all_over_a_city_and_one_holds_a_small_site() {
        let tiling = |side_m: f64| Tiling {
            crs: "EPSG:32637".into(),
            gsd_m: 0.5,
            bounds: [0.0, 0.0, side_m, side_m],
            size: (1, 1),
            tiles: Vec::new(),
        };
        let city = patches(&tiling(10_000.0), 0.5);
        assert_eq!(city.len(), 25);
        assert_eq!(city[0].bounds, [800.0, 800.0, 1200.0, 1200.0]);
        assert_eq!(city[24].bounds, [8800.0, 8800.0, 9200.0, 9200.0]);
        let site = patches(&tiling(300.0), 0.5);
        assert_eq!(
            site.iter().map(|patch| patch.bounds).collect::<Vec<_>>(),
            [[0.0, 0.0, 300.0, 300.0]]
        );
    }
}
