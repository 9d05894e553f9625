//! GIS products of units: from the model of a tile, and of a mosaic, merged from its tiles.

use super::blocks::common;
use super::colours::{self, Colours};
use super::layers::{ALBEDO, Layer, Merge};
use super::mosaic::{Mosaic, grid_of};
use super::plan::{self, MosaicWork, RUN, Unit};
use super::summary::COLLECTION;
use super::{BatchError, Result};
use heliosplat::Raster;
use heliosplat_pages::view;
use heliosplat_products::blend::Piece;
use heliosplat_products::change::ChangeMap;
use heliosplat_products::dsm::Dsm;
use heliosplat_products::export::{self, ExportError, Look, MosaicTile, Reference, Subject, TILESET};
use heliosplat_products::model::{self, LoadedModel, ModelFile, ModelImage};
use heliosplat_products::nadir::NadirGrid;
use heliosplat_products::points;
use heliosplat_products::relit_light::BandLight;
use heliosplat_products::set::{self, Request, dates, only_sun, own_name, times};
use heliosplat_products::stac::ItemMetadata;
use heliosplat_products::sunshine::sunshine;
use heliosplat_products::writer::Writer;
use heliosplat_raster::{RasterFile, preview};
use heliosplat_rpc::sun::SunPosition;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Name of the relit image.
const RELIT: &str = "relit.tif";
/// Name of the point cloud.
const POINTS: &str = "points.laz";
/// Folder of preview pictures.
pub const PICTURES: &str = "pictures";
/// Folders of the 3D Tiles of a mosaic: splats, and the textured surface.
pub(super) const SPLATS: &str = "splats";
pub(super) const SURFACE: &str = "surface";
/// Most tiles from which the look of all blocks is found.
const REFERENCES_MOST: usize = 16;
/// Values of each band of a tile from which the display of all blocks is found.
const REFERENCE_CELLS: usize = 100_000;
/// Largest side of a picture, pixels.
const PICTURE_PX: usize = 1600;
/// Colour of shadows in pictures: red, green, blue.
const SHADOW: [u8; 3] = [40, 80, 255];

/// Name of a unit's STAC item.
fn item_id(unit: &str) -> String {
    unit.replace('/', "_")
}

/// Sun at an azimuth and an elevation, degrees.
pub(super) fn sun_of([azimuth_deg, elevation_deg]: [f64; 2]) -> SunPosition {
    SunPosition::from_degrees(azimuth_deg, elevation_deg)
}

/// Writes the products of a tile's model on cells of `gsd_m` metres in `crs`; `sun` is azimuth and elevation of a relit
/// image, degrees. Returns the file names of the products.
///
/// # Errors
/// When one cannot be made or written.
pub fn of_tile(
    model: &LoadedModel,
    unit: &Unit,
    folder: &Path,
    (gsd_m, crs): (f64, &str),
    sun: Option<[f64; 2]>,
) -> Result<Vec<String>> {
    let request = Request {
        gsd_m: Some(gsd_m),
        crs: Some(crs.to_owned()),
        geoid: None,
        sun: sun.map(sun_of),
        sun_hours: None,
    };
    let set = set::write(model, folder, &request, (&item_id(&unit.id), None), &|_| {})?;
    Ok(set.names)
}

/// Model files of the tiles of a mosaic, with their run folders.
struct Models {
    files: Vec<ModelFile>,
    runs: Vec<PathBuf>,
}

impl Models {
    fn read(out: &Path, tiles: &[plan::MosaicTile]) -> Result<Self> {
        let runs: Vec<PathBuf> = tiles.iter().map(|tile| out.join(&tile.unit).join(RUN)).collect();
        let files = runs.iter().map(|run| model::load_file(run)).collect::<Result<_, _>>()?;
        Ok(Self { files, runs })
    }

    /// Days of the changed segments, counted from 1970.
    fn days_of_change(&self) -> Vec<i32> {
        let changes = self.files.iter().filter_map(|file| file.changes.as_ref());
        let segments = changes.flat_map(|changes| &changes.segments);
        segments.map(|segment| segment.day).collect()
    }

    /// Images of all tiles, each once, in the order of their names.
    fn images(&self) -> Vec<ModelImage> {
        let mut images: BTreeMap<&str, &ModelImage> = BTreeMap::new();
        for image in self.files.iter().flat_map(|file| &file.images) {
            images.entry(&image.name).or_insert(image);
        }
        images.into_values().cloned().collect()
    }

    /// Changes the images of the tiles relit under `sun` to the light `to` of all tiles; `albedos` are scaled by
    /// `gains`.
    fn share_light(
        &self,
        image: &mut Layer,
        (albedos, gains): (&Layer, &[Vec<f64>]),
        sun: &SunPosition,
        to: &[BandLight],
    ) {
        let lights: Vec<_> = self.files.iter().map(|file| BandLight::of(file, sun)).collect();
        image.change(albedos, |tile, band, value, albedo| {
            let gain = gains[tile].get(band).copied().unwrap_or(1.0);
            match (lights[tile].as_ref().and_then(|light| light.get(band)), to.get(band)) {
                (Some(light), Some(to)) => light.moved(to, value, albedo, gain),
                _ => value,
            }
        });
    }
}

/// Writes the products of a mosaic into `folder`. Returns their file names, and metrics: number of points, dates and
/// albedo gains.
///
/// # Errors
/// When a product of a tile cannot be read, or one of the mosaic cannot be written.
pub fn of_mosaic(
    out: &Path,
    work: &MosaicWork,
    mosaic: &Mosaic,
    unit: &Unit,
    folder: &Path,
) -> Result<(Vec<String>, Value)> {
    let models = Models::read(out, &mosaic.parts.tiles)?;
    let images = models.images();
    let bands = models.files.first().map_or(&[][..], |file| &file.bands);
    let (pieces, grid) = (&mosaic.parts.pieces, &mosaic.grid);
    let (size, gsd_m) = ((grid.width, grid.height), work.gsd_m as f32);
    let colours = match &work.colours {
        Some(unit) => Colours::read(&out.join(unit).join(colours::FILE))?,
        None => Colours::find(out, &work.tiles, work.gsd_m, work.products.sun.map(sun_of).as_ref())?,
    };
    let read = |name: &str| Layer::read(out, &mosaic.parts, name);

    let mut writer = Writer::new(grid, work.gsd_m, folder)?;
    writer.surface(&mosaic.dsm, &mosaic.around)?;
    let heaviest = |name: &str| Ok::<_, BatchError>(read(name)?.merged(pieces, size, gsd_m, Merge::Heaviest));
    let moments = [heaviest("change_date.tif")?, heaviest("change_confidence.tif")?];
    if let Some(changes) = ChangeMap::read(heaviest("change.tif")?, moments, &models.days_of_change()) {
        writer.changes(&changes)?;
    }
    let mut albedos = read(ALBEDO)?;
    let gains = colours.gains(pieces.iter().map(|piece| piece.unit.as_str()));
    albedos.scale(&gains);
    let albedo = albedos.merged(pieces, size, gsd_m, Merge::Mean);
    let index = models.files.first().and_then(ModelFile::ndvi);
    writer.colours(&albedo, bands, index)?;
    let look = OrthoPreview::new(&albedo, folder);
    look.write("albedo", None)?;
    if let Some(sun) = work.products.sun.map(sun_of) {
        let mut image = read(RELIT)?;
        if let Some(to) = &colours.relit {
            models.share_light(&mut image, (&albedos, &gains), &sun, to);
        }
        let image = image.merged(pieces, size, gsd_m, Merge::Mean);
        let shadows = read("relit_shadow.tif")?.merged(pieces, size, gsd_m, Merge::Majority);
        writer.relit(&image, &shadows, bands, &sun)?;
        OrthoPreview::new(&image, folder).write("relit", None)?;
    }
    if let Some(days) = &work.products.sun_hours {
        hours_of_sun(days, work, mosaic, &mut writer)?;
    }
    let own_dates: Vec<_> = models.files.iter().map(|file| dates(&file.images)).collect();
    let dates = dates(&images);
    for (date, sun) in &dates {
        let name = |tile: usize| own_name((date, sun), own_dates.get(tile)?).map(|own| format!("shadow_{own}.tif"));
        let shadows = Layer::named(out, &mosaic.parts, name)?.merged(pieces, size, gsd_m, Merge::Majority);
        writer.shadows(date, &shadows, sun)?;
        look.write(&format!("shadow_{date}"), Some(&shadows))?;
    }
    let part = |tile: &plan::MosaicTile| (out.join(&tile.unit).join(POINTS), common(tile.core, work.bounds));
    let parts: Vec<points::Part> = mosaic.parts.tiles.iter().map(part).collect();
    let count = points::merge(&folder.join(POINTS), &parts, grid, work.products.geoid)?;
    writer.points(POINTS, count);
    let mut globe_files = Vec::new();
    if work.products.globe {
        let look = (colours.reference, work.products.sun.map(sun_of));
        globe_files = globe(mosaic, albedo, (&models.runs, &gains), look, folder)?;
        for (key, title) in [
            (SPLATS, "Splats for globes, 3D Tiles"),
            (SURFACE, "Textured surface for globes, 3D Tiles"),
        ] {
            let file = format!("{key}/{TILESET}");
            if globe_files.contains(&file) {
                writer.tiles(key, &file, title);
            }
        }
    }
    let light = models.runs.first().map(PathBuf::as_path);
    if view::into_folder(folder, view::of_mosaic(folder, light))?.is_some() {
        writer.page(view::FILE, "The surface in a browser, under a sun that can be moved");
    }
    let runs: Vec<&Path> = models.runs.iter().map(PathBuf::as_path).collect();
    let set = writer.finish(&ItemMetadata {
        id: &item_id(&unit.id),
        times: &times(&images, &runs),
        sun: only_sun(&images, &dates),
        collection: Some((COLLECTION, "../../../../collection.json")),
    })?;
    let names: Vec<&str> = dates.iter().map(|(date, _)| date.as_str()).collect();
    let said = json!({"points": count, "dates": names, "albedo_gains": gains});
    let mut outputs = set.names;
    globe_files.retain(|name| !outputs.contains(name));
    outputs.append(&mut globe_files);
    Ok((outputs, said))
}

/// Writes the hours of sun of a mosaic over a period, with the shadows of the ground around it.
fn hours_of_sun(days: &str, work: &MosaicWork, mosaic: &Mosaic, writer: &mut Writer) -> Result<()> {
    let period = days.parse().map_err(BatchError::Refused)?;
    let altitude = &mosaic.around.altitude;
    let around = grid_of(work.around, work.gsd_m, &work.crs)?;
    let (nadir, frame) = NadirGrid::of_surface(around, &altitude.values)?;
    let shone = sunshine(&nadir, altitude, frame.origin, &period);
    let size = (mosaic.grid.width, mosaic.grid.height);
    Ok(writer.sunshine(&shone.cut(&|raster| mosaic.around.inner(raster, size)), &period)?)
}

/// Look of the 3D Tiles of all blocks, from tiles spread over the area; `None` where no tile has a surface.
///
/// # Errors
/// When a tile cannot be read, or the sun cannot be used.
pub(super) fn reference(
    out: &Path,
    tiles: &[plan::MosaicTile],
    colours: &Colours,
    sun: Option<[f64; 2]>,
) -> Result<Option<Reference>> {
    let units = tiles.iter().map(|tile| tile.unit.as_str());
    let units: Vec<&str> = units.filter(|unit| out.join(unit).join(ALBEDO).is_file()).collect();
    let step = units.len().div_ceil(REFERENCES_MOST).max(1);
    let units: Vec<&str> = units.into_iter().step_by(step).collect();
    let Some(first) = units.first() else { return Ok(None) };
    let bands = model::load_file(&out.join(first).join(RUN))?.bands;
    let mut planes = vec![Vec::new(); bands.len()];
    let mut references = Vec::with_capacity(units.len());
    for (unit, gains) in units.iter().zip(colours.gains(units.iter().copied())) {
        let albedo = RasterFile::open(&out.join(unit).join(ALBEDO))?.read_all()?;
        let step = albedo.plane_len().div_ceil(REFERENCE_CELLS).max(1);
        for (band, plane) in planes.iter_mut().enumerate().take(albedo.bands) {
            let gain = gains.get(band).map_or(1.0, |gain| *gain as f32);
            plane.extend(albedo.plane(band).iter().step_by(step).map(|value| value * gain));
        }
        let (run, core) = (out.join(unit).join(RUN), [[0; 2]; 2]);
        references.push(MosaicTile { run, core, gains });
    }
    let albedo = Raster {
        width: planes.first().map_or(0, Vec::len),
        height: 1,
        bands: bands.len(),
        values: planes.concat(),
    };
    Ok(Some(Reference {
        look: Look::of(&references, sun.map(sun_of).as_ref())?,
        white: export::white_of(&albedo, &bands),
    }))
}

/// Writes the 3D Tiles of a mosaic, and returns the names of their files in `folder`.
fn globe(
    mosaic: &Mosaic,
    albedo: Raster,
    (runs, gains): (&[PathBuf], &[Vec<f64>]),
    (reference, sun): (Option<Reference>, Option<SunPosition>),
    folder: &Path,
) -> Result<Vec<String>> {
    let tile = |((piece, run), gains): ((&Piece, &PathBuf), &Vec<f64>)| MosaicTile {
        run: run.clone(),
        // A block shows the splats on its own ground.
        core: [0, 1].map(|axis| {
            let cells = [mosaic.grid.width, mosaic.grid.height][axis] as isize;
            piece.core[axis].map(|at| at.clamp(0, cells))
        }),
        gains: gains.clone(),
    };
    let tiles = mosaic.parts.pieces.iter().zip(runs).zip(gains).map(tile).collect();
    let dsm = Dsm::above_ellipsoid(mosaic.above_ellipsoid(), mosaic.grid.clone());
    let exported = Subject::Mosaic(Box::new(export::Mosaic::new(folder, dsm, albedo, tiles, reference)?));
    for (name, tiles_of_mesh) in [(SPLATS, false), (SURFACE, true)] {
        let request = export::Request {
            tiles: Some(folder.join(name)),
            tiles_of_mesh,
            sun,
            ..export::Request::default()
        };
        match export::write(&exported, &request) {
            // A block at the rim of an area may hold a few cells alone.
            Err(ExportError::NoSurface(_)) if reference.is_some() => (),
            written => drop(written?),
        }
    }
    let mut names = Vec::new();
    for name in [SPLATS, SURFACE] {
        let entries = std::fs::read_dir(folder.join(name)).into_iter().flatten().flatten();
        names.extend(entries.map(|entry| format!("{name}/{}", entry.file_name().to_string_lossy())));
    }
    names.sort_unstable();
    Ok(names)
}

/// Ortho image reduced to at most [`PICTURE_PX`] pixels a side, for previews.
struct OrthoPreview {
    image: Raster,
    step: usize,
    folder: PathBuf,
}

impl OrthoPreview {
    fn new(image: &Raster, folder: &Path) -> Self {
        let step = image.width.max(image.height).div_ceil(PICTURE_PX).max(1);
        let (image, folder) = (every(image, step), folder.join(PICTURES));
        Self { image, step, folder }
    }

    /// Writes it as `NAME.png`, with shadows over it if there are any.
    fn write(&self, name: &str, shadows: Option<&Raster>) -> Result<()> {
        let mut picture = preview::stretched(&self.image);
        if let Some(shadows) = shadows {
            preview::overlay(&mut picture, &every(shadows, self.step), SHADOW);
        }
        Ok(preview::write_png(&self.folder.join(format!("{name}.png")), &picture)?)
    }
}

/// Raster of every `step`th column and row.
fn every(raster: &Raster, step: usize) -> Raster {
    let (width, height) = (raster.width.div_ceil(step), raster.height.div_ceil(step));
    Raster::from_fn(width, height, raster.bands, |band, col, row| {
        raster.at(band, col * step, row * step)
    })
}
