//! Content of the page of a run: its surface, albedo and light, the shadows traced for its dates, and the maps of its
//! height errors.

use super::ViewError;
use super::exhibit::{Exhibit, LightTable, TracedDate, coloured};
use super::layer::{Layer, Ramp};
use super::of_files::{on_grid, surface};
use super::ortho_image;
use crate::page::picture_of;
use heliosplat::timeline::concurrently;
use heliosplat_products::export::shown;
use heliosplat_products::model::{self, LoadedModel};
use heliosplat_products::nadir::NadirGrid;
use heliosplat_products::relight::{LOWEST_SUN_DEG, Viewpoint};
use heliosplat_products::set::{date_of, dates};
use heliosplat_products::{dsm, ortho};
use heliosplat_raster::preview::percentiles;
use heliosplat_raster::{GeoRaster, dsm_bands};
use heliosplat_satellite::run_file::load_run;
use std::ffi::OsStr;
use std::path::Path;

/// Most dates whose shadows are traced, and most images that are shown; a longer list is sampled evenly.
const DATES_MAX: usize = 12;
const IMAGES_MAX: usize = 3;
/// File of the height errors in the folder of a run or mosaic, and possible files of the changes.
const ERRORS: &str = "error.tif";
const CHANGES: [&str; 2] = ["change.tif", "products/change.tif"];
/// Errors at the ends of the colour ramp, metres, as in `error.png`.
const ERROR_M: f32 = heliosplat_evaluate::error_map::FULL_COLOUR_M;

/// Gathers the content of the page of a run.
///
/// # Errors
/// When the folder holds no satellite run, or a file of it cannot be read.
pub fn of_run(folder: &Path) -> Result<Exhibit, ViewError> {
    let (model, exhibit) = concurrently(|| model::load(folder), || surface(&folder.join("dsm.tif")));
    let (model, mut exhibit) = (model?, exhibit?);
    exhibit.title = title(folder);
    let sky = model.model.sky(&model.parameters, model.file.options.reference);
    exhibit.light = LightTable::of_model(&model.file, &sky);
    let nadir = NadirGrid::on(&(&model).into(), exhibit.grid.clone())?;
    let layers = || -> Result<Vec<Layer>, ViewError> {
        let mut layers = images(&model, &exhibit)?;
        layers.extend(maps(folder, &exhibit)?);
        Ok(layers)
    };
    let (layers, (albedo, dates)) = concurrently(layers, || {
        let albedo = ortho::albedo(&model, &dsm::maps(&model, &nadir));
        (coloured(&albedo, shown(&model.file.bands)), traced(&model, &nadir))
    });
    exhibit.albedo = Some(albedo);
    exhibit.old_shadows = !model.file.has_light();
    exhibit.dates = dates?;
    exhibit.layers = layers?;
    Ok(exhibit)
}

/// Name of the run's scene, or of its folder.
fn title(folder: &Path) -> String {
    let whole = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let scene = load_run(folder).map(|run| run.scene).unwrap_or(whole);
    let names: Vec<_> = scene.ancestors().filter_map(name_of).take(2).collect();
    // `scene` is a generic name; the folder around it is specific.
    let name = names.iter().find(|name| **name != "scene").or(names.first());
    name.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Name of a folder, or of a file without its extension.
fn name_of(path: &Path) -> Option<&OsStr> {
    match path.is_dir() {
        true => path.file_name(),
        false => path.file_stem(),
    }
}

/// Dates of the model with their traced shadows.
fn traced(model: &LoadedModel, nadir: &NadirGrid) -> Result<Vec<TracedDate>, ViewError> {
    let mut out = Vec::new();
    let above = Viewpoint::above(model, nadir);
    let all = dates(&model.file.images);
    let step = all.len().div_ceil(DATES_MAX).max(1);
    for (name, sun) in all.into_iter().step_by(step) {
        let image = model.file.images.iter().find(|image| image.sun == Some(sun));
        let is_lit = model.file.has_light() && sun.elevation_rad.to_degrees() >= LOWEST_SUN_DEG;
        let shadows = is_lit.then(|| above.shadows(&sun)).transpose()?;
        out.push(TracedDate {
            time: image.and_then(|image| image.time),
            name,
            sun,
            shadows,
        });
    }
    Ok(out)
}

/// Evenly sampled training images of the run, projected onto the grid.
fn images(model: &LoadedModel, exhibit: &Exhibit) -> Result<Vec<Layer>, ViewError> {
    let mut out = Vec::new();
    let images = model.file.images.iter();
    let trained: Vec<_> = images.filter(|image| image.appearance.is_some()).collect();
    let step = trained.len().div_ceil(IMAGES_MAX).max(1);
    for image in trained.into_iter().step_by(step) {
        let path = model.folder.join("views").join(format!("{}.png", image.name));
        let Some(picture) = picture_of(&path) else { continue };
        if picture.width() < image.crop.width as u32 || picture.height() < image.crop.height as u32 {
            continue;
        }
        let values = ortho_image::project(model, image, &picture, (&exhibit.grid, &exhibit.altitude))?;
        let name = format!("Image of {}", date_of(image));
        out.push(Layer::picture(&format!("image-{}", image.name), &name, values));
    }
    Ok(out)
}

/// Maps of standard deviation, number of images, height errors and changes that exist in the folder.
///
/// # Errors
/// When one of the files is damaged.
pub(super) fn maps(folder: &Path, exhibit: &Exhibit) -> Result<Vec<Layer>, ViewError> {
    let mut out = companions(&folder.join("dsm.tif"), exhibit)?;
    let errors = folder.join(ERRORS);
    if errors.is_file() {
        let values = on_grid(&GeoRaster::read(&errors)?, 0, &exhibit.grid)?;
        let ramp = (Ramp::Diverging, [-ERROR_M, ERROR_M]);
        out.push(Layer::map("errors", "Height errors against truth", ramp, values));
    }
    if let Some(path) = CHANGES.map(|name| folder.join(name)).iter().find(|path| path.is_file()) {
        let changes = GeoRaster::read(path)?;
        let band = changes.band("difference_m").unwrap_or(0);
        let values = on_grid(&changes, band, &exhibit.grid)?;
        if values.values.iter().any(|metres| metres.abs() > 0.0) {
            let ramp = (Ramp::Diverging, [-10.0, 10.0]);
            out.push(Layer::map("change", "Change of heights between dates", ramp, values));
        }
    }
    Ok(out)
}

/// Maps of the standard deviation (metres) and the number of images of a surface model, if it has them.
///
/// # Errors
/// When a file is damaged.
pub(crate) fn companions(dsm: &Path, exhibit: &Exhibit) -> Result<Vec<Layer>, ViewError> {
    let mut out = Vec::new();
    let surface = GeoRaster::read_surface(dsm)?;
    // Band, key, name and unit of the map, share of the values below the end of its ramp, and least end.
    let maps = [
        (
            dsm_bands::STANDARD_DEVIATION,
            "deviation",
            ("Standard deviation of heights", "m"),
            (0.98, 0.1),
        ),
        (
            dsm_bands::VIEWS,
            "views",
            ("Number of images that see the ground", ""),
            (1.0, 1.0),
        ),
    ];
    for (band, id, (name, unit), (share, least)) in maps {
        let Some(band) = surface.band(band) else { continue };
        let values = on_grid(&surface, band, &exhibit.grid)?;
        if let Some((_, high)) = percentiles(&values.values, 0.0, share) {
            let ramp = (Ramp::Sequential, [0.0, high.max(least)]);
            let map = Layer::map(id, name, ramp, values);
            out.push(Layer { unit, ..map });
        }
    }
    Ok(out)
}
