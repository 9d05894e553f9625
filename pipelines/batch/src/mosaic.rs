//! Surface model of an area, merged from the surface models of its tiles.

use super::BatchError;
use super::plan::{MosaicTile, MosaicWork};
use heliosplat::Raster;
use heliosplat_products::blend::{BANDS, Piece, blend};
use heliosplat_products::dsm::Dsm;
use heliosplat_raster::geoid::GeoidGrid;
use heliosplat_raster::{Crs, GeoRaster, GeoTransform, GridSpec, RasterError};
use std::path::Path;

/// Mosaic with its grid and tiles.
pub struct Mosaic {
    /// Blended surface model.
    pub dsm: Dsm,
    /// Grid of the mosaic, without a vertical datum.
    pub grid: GridSpec,
    /// Surface models of the tiles on the grid.
    pub pieces: Vec<Piece>,
}

impl Mosaic {
    /// Altitudes above the ellipsoid, metres, for any vertical datum of the surface model.
    ///
    /// # Errors
    /// When the geoid's grid cannot be used.
    pub fn above_ellipsoid(&self) -> Result<Raster, RasterError> {
        let mut altitude = self.dsm.altitude();
        if let Some(geoid) = self.dsm.geoid {
            let table = GeoidGrid::new(geoid, &self.grid)?;
            for (i, value) in altitude.values.iter_mut().enumerate() {
                *value += table.at(i % self.grid.width, i / self.grid.width) as f32;
            }
        }
        Ok(altitude)
    }
}

/// Blends the surface models of tiles; heights of the mosaic are above the ellipsoid.
///
/// # Errors
/// When a tile cannot be read or the coordinate reference system is unknown.
pub fn mosaic(out: &Path, work: &MosaicWork) -> Result<Mosaic, BatchError> {
    let mut pieces = Vec::with_capacity(work.tiles.len());
    for tile in &work.tiles {
        pieces.push(read(out, tile, work)?);
    }
    let [west, south, east, north] = work.bounds;
    let cells = |length: f64| (length / work.gsd_m).round().max(1.0) as usize;
    let grid = GridSpec {
        width: cells(east - west),
        height: cells(north - south),
        transform: GeoTransform::north_up(west, north, work.gsd_m),
        crs: Crs::from_definition(&work.crs)?,
    };
    let raster = blend(&pieces, (grid.width, grid.height), work.gsd_m as f32);
    Ok(Mosaic {
        dsm: Dsm {
            raster,
            grid: grid.clone(),
            geoid: None,
        },
        grid,
        pieces,
    })
}

/// Reads the surface model of a tile.
fn read(out: &Path, tile: &MosaicTile, work: &MosaicWork) -> Result<Piece, BatchError> {
    let path = out.join(&tile.unit).join("dsm.tif");
    let file = GeoRaster::read_surface(&path)?;
    if file.raster.bands < BANDS {
        return Err(RasterError::Damaged {
            path,
            reason: format!("it has {} bands of {BANDS}", file.raster.bands),
        }
        .into());
    }
    let [west, _, _, north] = work.bounds;
    let six = file.transform.to_gdal();
    let cells = |distance: f64| (distance / work.gsd_m).round() as isize;
    let span = |b: &[f64; 4]| {
        [
            [cells(b[0] - west), cells(b[2] - west)],
            [cells(north - b[3]), cells(north - b[1])],
        ]
    };
    Ok(Piece {
        unit: tile.unit.clone(),
        raster: file.raster,
        at: [cells(six[0] - west), cells(north - six[3])],
        core: span(&tile.core),
        bounds: span(&tile.bounds),
    })
}
