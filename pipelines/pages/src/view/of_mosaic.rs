//! Content of the page of a batch's mosaic, from the products in its folder.

use super::exhibit::{Exhibit, LightTable, TracedDate};
use super::of_files::{albedo_on, on_grid, surface};
use super::of_run::maps;
use super::{OVERVIEW, ViewError};
use crate::page::MOSAIC_FILE;
use heliosplat::Raster;
use heliosplat::model::shadow_gs::{SKY, softplus};
use heliosplat_products::model::load_file;
use heliosplat_raster::{GeoRaster, RasterFile, bounded};
use heliosplat_rpc::sun::SunPosition;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Prefix of the shadow masks of dates: `shadow_DATE.tif`.
const SHADOWS: &str = "shadow_";

/// Gathers the content of the page of a mosaic; of one that consists of blocks, from its overview. The light is that of
/// `run`, the run of a tile; without it, that of the first tile's run, found beside the folder.
///
/// # Errors
/// When a file of the folder cannot be read.
pub fn of_mosaic(folder: &Path, run: Option<&Path>) -> Result<Exhibit, ViewError> {
    let overview = folder.join(OVERVIEW);
    let rasters = if overview.is_dir() { overview.as_path() } else { folder };
    let mut exhibit = surface(&rasters.join("dsm.tif"))?;
    exhibit.title = title(folder);
    let albedo = rasters.join("albedo.tif");
    if albedo.is_file() {
        exhibit.albedo = Some(albedo_on(&albedo, &exhibit.grid)?);
    }
    let first = run.map(Path::to_owned).or_else(|| first_run(folder));
    exhibit.light = first.and_then(|run| light(&run)).unwrap_or_else(LightTable::usual);
    exhibit.dates = dates(rasters, &exhibit)?;
    exhibit.layers = maps(rasters, &exhibit)?;
    Ok(exhibit)
}

/// Name of the area: the third folder above the mosaic's.
fn title(folder: &Path) -> String {
    let whole = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let area = whole.ancestors().nth(3).and_then(Path::file_name);
    area.unwrap_or_default().to_string_lossy().into_owned()
}

fn first_run(folder: &Path) -> Option<PathBuf> {
    let text = bounded::read_text(&folder.join(MOSAIC_FILE)).ok()?;
    let metrics: Value = serde_json::from_str(&text).ok()?;
    let unit = metrics.pointer("/pieces/0/unit")?.as_str()?;
    let name = unit.rsplit('/').next().filter(|name| !name.starts_with('.'))?;
    Some(folder.join("..").join(name).join("run"))
}

/// Light of a tile's model; `None` if its file cannot be read.
fn light(run: &Path) -> Option<LightTable> {
    let file = load_file(run).ok()?;
    let (bands, reference) = (file.options.bands, file.options.reference);
    let skies = &file.globals.groups.get(SKY)?.values;
    let sky = skies.get(reference * bands..(reference + 1) * bands)?;
    let sky: Vec<f32> = sky.iter().map(|&x| softplus(x)).collect();
    Some(LightTable::of_model(&file, &sky))
}

/// Dates with shadow masks in the folder.
fn dates(folder: &Path, exhibit: &Exhibit) -> Result<Vec<TracedDate>, ViewError> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter_map(|entry| {
            let name = entry.file_name().to_string_lossy().into_owned();
            let date = name.strip_prefix(SHADOWS)?.strip_suffix(".tif")?;
            Some(date.to_owned())
        })
        .collect();
    names.sort_unstable();
    let mut out = Vec::new();
    for name in names {
        let path = folder.join(format!("{SHADOWS}{name}.tif"));
        let metadata = RasterFile::open(&path)?.domain("");
        let degrees = |key: &str| metadata.get(key).and_then(|text| text.parse::<f64>().ok());
        let (Some(azimuth), Some(elevation)) = (degrees("SUN_AZIMUTH"), degrees("SUN_ELEVATION")) else {
            continue;
        };
        let shadows: Raster = on_grid(&GeoRaster::read(&path)?, 0, &exhibit.grid)?;
        out.push(TracedDate {
            name,
            time: None,
            sun: SunPosition::from_degrees(azimuth, elevation),
            shadows: Some(shadows),
        });
    }
    Ok(out)
}
