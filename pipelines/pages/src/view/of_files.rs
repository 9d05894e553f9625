//! Content of the page of a surface model in a file of any source.

use super::ViewError;
use super::exhibit::{Exhibit, LightTable};
use heliosplat::Raster;
use heliosplat_evaluate::resample::Placement;
use heliosplat_products::export::shown;
use heliosplat_raster::{GeoRaster, GridSpec, RasterFile, dsm_bands};
use heliosplat_scene::BandKind;
use std::path::Path;

/// Gathers the content of the page of a surface model, with an albedo or another ortho image if given.
///
/// # Errors
/// When a file cannot be read, no height is known, or the surface model has no coordinate reference system.
pub fn of_files(dsm: &Path, albedo: Option<&Path>) -> Result<Exhibit, ViewError> {
    let mut exhibit = surface(dsm)?;
    if let Some(path) = albedo {
        exhibit.albedo = Some(albedo_on(path, &exhibit.grid)?);
    }
    Ok(exhibit)
}

/// Exhibit of the surface in a file, without albedo and dates.
///
/// # Errors
/// When the file cannot be read, no height is known, or it has no coordinate reference system.
pub(super) fn surface(path: &Path) -> Result<Exhibit, ViewError> {
    let file = GeoRaster::read_heights(path)?;
    let grid = file.grid().ok_or_else(|| ViewError::NoCrs(path.to_owned()))?;
    let altitude = file.raster.band(file.band(dsm_bands::ALTITUDE).unwrap_or(0));
    if !altitude.values.iter().any(|z| z.is_finite()) {
        return Err(ViewError::Nothing(path.display().to_string()));
    }
    let metadata = RasterFile::open(path)?.domain("");
    let datum = metadata.get("VERTICAL_DATUM").cloned();
    Ok(Exhibit {
        title: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        gsd_m: grid.transform.pixel_size().1 * grid.crs.metres_per_unit(),
        grid,
        altitude,
        vertical_datum: datum.unwrap_or_default(),
        albedo: None,
        light: LightTable::usual(),
        old_shadows: false,
        dates: Vec::new(),
        layers: Vec::new(),
    })
}

/// Red, green and blue of an albedo file, resampled onto a grid.
///
/// # Errors
/// When the file cannot be read or resampled.
pub(super) fn albedo_on(path: &Path, grid: &GridSpec) -> Result<Raster, ViewError> {
    let file = GeoRaster::read(path)?;
    let kinds: Vec<BandKind> = file.band_names.iter().map(|name| kind(name)).collect();
    let mut three = Raster::filled(grid.width, grid.height, 3, f32::NAN);
    for (place, band) in shown(&kinds).into_iter().enumerate() {
        let values = on_grid(&file, band, grid)?.values;
        three.plane_mut(place).copy_from_slice(&values);
    }
    Ok(three)
}

/// Kind of the band with this name; `Other` for unknown names.
fn kind(name: &str) -> BandKind {
    let all = [BandKind::Red, BandKind::Green, BandKind::Blue, BandKind::NearInfrared];
    let found = all.into_iter().find(|kind| kind.name() == name);
    found.unwrap_or(BandKind::Other)
}

/// Band `band` (from 0) of a raster, resampled bilinearly onto a grid.
///
/// # Errors
/// When a coordinate reference system cannot be used.
pub(super) fn on_grid(source: &GeoRaster, band: usize, grid: &GridSpec) -> Result<Raster, ViewError> {
    let target = GeoRaster {
        raster: Raster::filled(grid.width, grid.height, 0, f32::NAN),
        transform: grid.transform,
        crs: Some(grid.crs.clone()),
        band_names: Vec::new(),
    };
    Ok(Placement::new(source, &target)?.moved_band(band, 0.0, 0.0))
}
