//! Reader of a batch's mosaic for `export`.

use crate::outcome::CliError;
use heliosplat_batch::plan::RUN;
use heliosplat_pages::page::MOSAIC_FILE;
use heliosplat_products::dsm::Dsm;
use heliosplat_products::export::{Mosaic, MosaicTile};
use heliosplat_raster::{GeoRaster, RasterFile, bounded};
use serde::Deserialize;
use serde_json::Value;
use std::path::Path;

/// Tile in `mosaic.json`.
#[derive(Deserialize)]
struct Piece {
    unit: String,
    core: [[isize; 2]; 2],
}

/// Reads the mosaic in a folder, and finds the runs of its tiles beside it.
///
/// # Errors
/// When the mosaic has no albedo or coordinate reference system, its heights are above a geoid, or a file is damaged.
pub(super) fn open(folder: &Path) -> Result<Mosaic, CliError> {
    let fault = |reason: &str| CliError::Input(format!("{}: {reason}", folder.display()));
    let path = folder.join(MOSAIC_FILE);
    let text = bounded::read_text(&path).map_err(|error| fault(&format!("{MOSAIC_FILE} cannot be read ({error})")))?;
    let damaged = |error: serde_json::Error| fault(&format!("{MOSAIC_FILE} is damaged ({error})"));
    let told: Value = serde_json::from_str(&text).map_err(damaged)?;
    let pieces = Vec::<Piece>::deserialize(&told["pieces"]).map_err(damaged)?;
    let gains = Option::<Vec<Vec<f64>>>::deserialize(&told["products"]["albedo_gains"]).map_err(damaged)?;
    if let Some(block) = told["blocks"][0].as_str() {
        let text = format!("the mosaic consists of blocks; name the folder of one, such as ../{block}");
        return Err(fault(&text));
    }
    let albedo = folder.join("albedo.tif");
    if !albedo.is_file() {
        let text = "the mosaic has no albedo.tif; leave products.dsm_only out and run the batch again";
        return Err(fault(text));
    }
    let surface = folder.join("dsm.tif");
    let datum = RasterFile::open(&surface)?.domain("").remove("VERTICAL_DATUM");
    if datum.is_some_and(|datum| !datum.contains("ellipsoid")) {
        let text =
            "its heights are above a geoid; products.globe = true in the manifest writes the tiles with the mosaic";
        return Err(fault(text));
    }
    let file = GeoRaster::read_surface(&surface)?;
    let grid = file.grid().ok_or_else(|| fault("dsm.tif says no coordinate system"))?;
    let dsm = Dsm::above_ellipsoid(file.raster, grid);
    let albedo = GeoRaster::read(&albedo)?.raster;
    if (albedo.width, albedo.height) != (dsm.grid.width, dsm.grid.height) {
        return Err(fault("albedo.tif is not on the grid of dsm.tif"));
    }
    let mut gains = gains.into_iter().flatten();
    let mut tiles = Vec::new();
    for piece in pieces {
        // A plain name only: a damaged file must not lead to other folders.
        let name = piece.unit.rsplit('/').next().filter(|name| !name.starts_with('.'));
        let name = name.ok_or_else(|| fault("a tile has no name"))?;
        let run = folder.join("..").join(name).join(RUN);
        let (core, gains) = (piece.core, gains.next().unwrap_or_default());
        tiles.push(MosaicTile { run, core, gains });
    }
    Ok(Mosaic::new(folder, dsm, albedo, tiles, None)?)
}
