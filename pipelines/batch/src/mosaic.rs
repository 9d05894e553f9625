//! Surface model of an area or of a block of it, merged from the surface models of its tiles.

use super::Result;
use super::blocks::overlap;
use super::plan::{MosaicTile, MosaicWork};
use super::stamp::Done;
use heliosplat::Raster;
use heliosplat_products::blend::{BANDS, Piece, blend};
use heliosplat_products::dsm::{Dsm, file_of};
use heliosplat_products::writer::Surroundings;
use heliosplat_raster::{Crs, GeoTransform, GridSpec, RasterError, RasterFile, Window};
use serde_json::json;
use std::path::Path;

/// Mosaic with its grid and tiles.
pub struct Mosaic {
    /// Blended surface model.
    pub dsm: Dsm,
    /// Grid of the mosaic, without a vertical datum.
    pub grid: GridSpec,
    /// Parts of the surface models of the tiles on the grid.
    pub parts: Parts,
    /// Blended altitudes of the grid and the ground around it, metres above the ellipsoid.
    pub around: Surroundings,
}

impl Mosaic {
    /// Altitudes above the ellipsoid, metres, for any vertical datum of the surface model.
    pub fn above_ellipsoid(&self) -> Raster {
        let size = (self.grid.width, self.grid.height);
        self.around.inner(&self.around.altitude, size)
    }
}

/// Result of a unit of which no tile has a known height.
pub(super) fn nothing(unit: &str) -> Done {
    tracing::warn!("{unit}: none of its tiles has a surface");
    (Vec::new(), json!({"empty": true}))
}

/// Map grid of bounds (west, south, east, north) with cells of `gsd_m`.
///
/// # Errors
/// When the coordinate reference system is unknown.
pub(super) fn grid_of([west, south, east, north]: [f64; 4], gsd_m: f64, crs: &str) -> Result<GridSpec, RasterError> {
    let cells = |length: f64| (length / gsd_m).round().max(1.0) as usize;
    Ok(GridSpec {
        width: cells(east - west),
        height: cells(north - south),
        transform: GeoTransform::north_up(west, north, gsd_m),
        crs: Crs::from_definition(crs)?,
    })
}

/// Blends the surface models of tiles; heights of the mosaic are above the ellipsoid. Only the altitudes of the ground
/// around the mosaic are kept, and each side of it is blended by itself, so that it adds little memory.
///
/// # Errors
/// When a tile cannot be read or the coordinate reference system is unknown.
pub fn mosaic(out: &Path, work: &MosaicWork) -> Result<Mosaic> {
    let grid = grid_of(work.bounds, work.gsd_m, &work.crs)?;
    let whole = grid_of(work.around, work.gsd_m, &work.crs)?;
    let places = Places::of(work.around, work.gsd_m);
    let mut altitude = Raster::filled(whole.width, whole.height, 1, f32::NAN);
    for side in sides(work.around, work.bounds) {
        let (_, blended) = blended(out, work, side)?;
        altitude.put(&blended, places.corner(side));
    }
    let (parts, raster) = blended(out, work, work.bounds)?;
    let at = places.corner(work.bounds);
    altitude.put(&raster, at);
    Ok(Mosaic {
        dsm: Dsm::above_ellipsoid(raster, grid.clone()),
        grid,
        parts,
        around: Surroundings { altitude, at },
    })
}

/// Parts of the tiles within bounds (west, south, east, north), and their blended surface model.
fn blended(out: &Path, work: &MosaicWork, bounds: [f64; 4]) -> Result<(Parts, Raster)> {
    let places = Places::of(bounds, work.gsd_m);
    let span = places.span(bounds);
    let mut parts = Parts::default();
    for tile in work.tiles.iter().filter(|tile| overlap(&tile.bounds, &bounds)) {
        parts.read(out, tile, &places, span)?;
    }
    let [width, height] = span.map(|[_, end]| end as usize);
    let raster = blend(&parts.pieces, (width, height), work.gsd_m as f32);
    Ok((parts, raster))
}

/// Bounds of the ground in `around` on the four sides of `inner`, those that have any (west, south, east, north).
fn sides(around: [f64; 4], inner: [f64; 4]) -> impl Iterator<Item = [f64; 4]> {
    let [west, south, east, north] = around;
    let sides = [
        [west, inner[3], east, north],
        [west, south, east, inner[1]],
        [west, inner[1], inner[0], inner[3]],
        [inner[2], inner[1], east, inner[3]],
    ];
    sides.into_iter().filter(|side| side[0] < side[2] && side[1] < side[3])
}

/// Columns and rows from a north-western corner.
pub(super) struct Places {
    west: f64,
    north: f64,
    gsd_m: f64,
}

/// First and one past the last column, and first and one past the last row.
pub(super) type Span = [[isize; 2]; 2];

impl Places {
    /// Columns and rows from the north-western corner of bounds (west, south, east, north).
    pub(super) fn of([west, _, _, north]: [f64; 4], gsd_m: f64) -> Self {
        Self { west, north, gsd_m }
    }

    /// Column and row of a corner of cells at map coordinates.
    pub(super) fn cells(&self, [x, y]: [f64; 2]) -> [isize; 2] {
        [x - self.west, self.north - y].map(|distance| (distance / self.gsd_m).round() as isize)
    }

    /// Column and row at which bounds (west, south, east, north) within the mosaic begin.
    pub(super) fn corner(&self, [west, _, _, north]: [f64; 4]) -> (usize, usize) {
        let [col, row] = self.cells([west, north]).map(|at| at.max(0) as usize);
        (col, row)
    }

    /// Columns and rows of bounds (west, south, east, north).
    pub(super) fn span(&self, [west, south, east, north]: [f64; 4]) -> Span {
        let ([left, top], [right, bottom]) = (self.cells([west, north]), self.cells([east, south]));
        [[left, right], [top, bottom]]
    }
}

/// Parts of the surface models of tiles, and the windows of the tiles' files that they were read from.
#[derive(Default)]
pub struct Parts {
    /// Parts of the surface models.
    pub pieces: Vec<Piece>,
    /// Tile of each piece.
    pub tiles: Vec<MosaicTile>,
    /// Window of the tile's files, and their columns and rows, for each piece.
    windows: Vec<(Window, (usize, usize))>,
}

impl Parts {
    /// Reads the part of a tile's surface model within `span`; nothing where it has none there.
    ///
    /// # Errors
    /// When a file cannot be read or is not on the grid of the tile's surface model.
    pub(super) fn read(&mut self, out: &Path, tile: &MosaicTile, places: &Places, span: Span) -> Result<()> {
        let path = out.join(&tile.unit).join("dsm.tif");
        let file = RasterFile::open(&path)?;
        let placed = file.geo_transform();
        let placed = placed.ok_or_else(|| RasterError::NotGeoreferenced(path.clone()))?;
        let [west, _, _, north, ..] = placed.to_gdal();
        let Some((window, at)) = window(places.cells([west, north]), file.size(), span) else {
            return Ok(());
        };
        let mut raster = file.read(window, &[0])?;
        for band in 1..BANDS {
            let more = read_window(&file_of(&path, band), window, file.size())?;
            raster.values.extend_from_slice(more.plane(0));
            raster.bands += 1;
        }
        self.windows.push((window, file.size()));
        self.tiles.push(tile.clone());
        self.pieces.push(Piece {
            unit: tile.unit.clone(),
            raster,
            at,
            core: places.span(tile.core),
            bounds: places.span(tile.bounds),
        });
        Ok(())
    }

    /// Reads the raster with the name for its place of each tile on the cells of its piece; `None` for tiles without
    /// it.
    ///
    /// # Errors
    /// When a file is damaged or not on the grid of its tile's surface model.
    pub(super) fn rasters(&self, out: &Path, name: impl Fn(usize) -> Option<String>) -> Result<Vec<Option<Raster>>> {
        let pieces = self.pieces.iter().zip(&self.windows).enumerate();
        let read = pieces.map(|(place, (piece, &(window, size)))| {
            let path = name(place).map(|name| out.join(&piece.unit).join(name));
            let path = path.filter(|path| path.is_file());
            path.map(|path| read_window(&path, window, size)).transpose()
        });
        Ok(read.collect::<Result<_, _>>()?)
    }
}

/// Window of all bands of a raster, which must have these columns and rows.
fn read_window(path: &Path, window: Window, size: (usize, usize)) -> Result<Raster, RasterError> {
    let file = RasterFile::open(path)?;
    if file.size() != size {
        let reason = "it is not on the grid of its surface model";
        return Err(RasterError::Damaged(path.to_owned(), reason.into()));
    }
    let bands: Vec<usize> = (0..file.bands.len()).collect();
    file.read(window, &bands)
}

/// Window of a raster of `size`, which begins at a column and a row, within `span`, and the column and row at which the
/// window begins; `None` without a common cell.
fn window(begin: [isize; 2], size: (usize, usize), span: Span) -> Option<(Window, [isize; 2])> {
    let along = |axis: usize, cells: usize| {
        let from = begin[axis].max(span[axis][0]);
        let to = (begin[axis] + cells as isize).min(span[axis][1]);
        (from < to).then(|| (from, (from - begin[axis]) as usize, (to - from) as usize))
    };
    let ((col, col0, width), (row, row0, height)) = (along(0, size.0)?, along(1, size.1)?);
    let window = Window::new((col0, row0), (width, height));
    Some((window, [col, row]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tile_is_read_where_it_lies_on_the_block() {
        let (read, at) = window([-10, 5], (40, 30), [[0, 100], [0, 20]]).expect("common cells");
        assert_eq!((read.col0, read.row0, read.width, read.height), (10, 0, 30, 15));
        assert_eq!(at, [0, 5]);
        assert!(window([100, 0], (40, 30), [[0, 100], [0, 20]]).is_none());
    }
}
