//! The blocks of a mosaic as one: a virtual raster for each product, an overview with its page, and the root of the 3D
//! Tiles. Memory is that of one block.

use super::layers::ALBEDO;
use super::mosaic::{Places, grid_of, nothing};
use super::plan::{JoinedWork, MosaicTile};
use super::products::{SPLATS, SURFACE};
use super::stamp::{self, Done, Stamp};
use super::{BatchError, Result};
use heliosplat::Raster;
use heliosplat_pages::page::MOSAIC_FILE;
use heliosplat_pages::view::OVERVIEW;
use heliosplat_pages::{report, view};
use heliosplat_products::blend::BANDS;
use heliosplat_products::dsm::{self, Dsm};
use heliosplat_products::export::{TILESET, join_tilesets};
use heliosplat_products::style::{Layer, Style, layer_file};
use heliosplat_products::writer::LAYERS;
use heliosplat_raster::virtual_raster::{Part, virtual_raster};
use heliosplat_raster::{GridSpec, ImageSpec, RasterFile, bounded, preview, write_atomically, write_cog};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Most cells of the overview: those of the page.
const OVERVIEW_CELLS: usize = 1024 * 1024;
/// Picture of the surface.
const PICTURE: &str = "dsm.png";
/// File of the surface model of a block.
const DSM: &str = "dsm.tif";

/// Finished block with a surface.
struct Block {
    /// Name of its folder, beside that of the mosaic.
    name: String,
    folder: PathBuf,
    /// Column and row of the mosaic at which it begins.
    at: [usize; 2],
    stamp: Stamp,
}

impl Block {
    fn has(&self, file: &str) -> bool {
        self.stamp.outputs.iter().any(|output| output.path == file)
    }

    fn number(&self, pointer: &str) -> Option<f64> {
        self.stamp.metrics.pointer(pointer).and_then(Value::as_f64)
    }
}

/// Joins the blocks of a mosaic, and returns the names of its files and its metrics.
///
/// # Errors
/// When a file of a block cannot be read, or one of the mosaic cannot be written.
pub(super) fn join(work: &JoinedWork, unit: &str, out: &Path, folder: &Path) -> Result<Done> {
    let grid = grid_of(work.bounds, work.gsd_m, &work.crs)?;
    let places = Places::of(work.bounds, work.gsd_m);
    let mut blocks = Vec::new();
    for (id, [west, _, _, north]) in &work.blocks {
        let folder = out.join(id);
        let stamp = stamp::read(&folder).ok_or_else(|| BatchError::Failed(format!("{id}: its stamp is gone")))?;
        let block = Block {
            name: id.rsplit('/').next().unwrap_or(id).to_owned(),
            folder,
            at: places.cells([*west, *north]).map(|at| at.max(0) as usize),
            stamp,
        };
        if block.has(DSM) {
            blocks.push(block);
        }
    }
    if blocks.is_empty() {
        return Ok(nothing(unit));
    }
    let mut outputs = virtual_rasters(unit, &grid, &blocks, folder)?;
    outputs.extend(overview(&grid, &blocks, work, &folder.join(OVERVIEW))?);
    for name in [SPLATS, SURFACE] {
        let file = format!("{name}/{TILESET}");
        let children = blocks.iter().filter(|block| block.has(&file));
        let paths = |block: &Block| (format!("../../{}/{file}", block.name), block.folder.join(&file));
        let children: Vec<(String, PathBuf)> = children.map(paths).collect();
        if !children.is_empty() {
            join_tilesets(&folder.join(&file), &children)?;
            outputs.push(file);
        }
    }
    let metrics = metrics(&grid, &blocks, work);
    write_atomically(&folder.join(MOSAIC_FILE), format!("{metrics:#}\n").as_bytes())?;
    if view::into_folder(folder, view::of_mosaic(folder, None))?.is_some() {
        outputs.push(view::FILE.into());
    }
    report::mosaic::write(folder)?;
    outputs.extend([MOSAIC_FILE.into(), report::FILE.into()]);
    Ok((outputs, metrics))
}

/// Writes a virtual raster for each raster of the blocks, with a style for the range of all, and a layer file.
fn virtual_rasters(unit: &str, grid: &GridSpec, blocks: &[Block], folder: &Path) -> Result<Vec<String>> {
    let files = blocks.iter().flat_map(|block| &block.stamp.outputs);
    let is_raster = |path: &&str| path.ends_with(".tif") && !path.contains('/');
    let names: BTreeSet<&str> = files.map(|output| output.path.as_str()).filter(is_raster).collect();
    let read = |block: &&Block, name: &str| {
        let path = block.folder.join(name);
        let text = bounded::read_text(&path);
        text.map_err(|error| BatchError::Failed(format!("{}: {error}", path.display())))
    };
    let (mut outputs, mut styles) = (Vec::new(), BTreeMap::new());
    for name in names {
        let with: Vec<&Block> = blocks.iter().filter(|block| block.has(name)).collect();
        let mut first = None;
        let mut parts = Vec::with_capacity(with.len());
        for block in &with {
            let file = RasterFile::open(&block.folder.join(name))?;
            let (path, at, size) = (format!("../{}/{name}", block.name), block.at, file.size());
            parts.push(Part { path, at, size });
            first.get_or_insert((file.bands.clone(), file.domain("")));
        }
        let Some((bands, metadata)) = first else { continue };
        let kept = metadata.into_iter().filter(|(key, _)| key != "AREA_OR_POINT");
        let text = virtual_raster(grid, &bands, &kept.collect::<Vec<_>>(), &parts);
        let file = name.replace(".tif", ".vrt");
        write_atomically(&folder.join(&file), text.as_bytes())?;
        outputs.push(file);
        let style = name.replace(".tif", ".qml");
        let texts = with.iter().filter(|block| block.has(&style));
        let texts: Vec<String> = texts.map(|block| read(block, &style)).collect::<Result<_>>()?;
        let whole = Style::of_joined(&texts);
        if let Some(text) = whole.as_ref().map(Style::qml).as_ref().or(texts.first()) {
            write_atomically(&folder.join(&style), text.as_bytes())?;
            outputs.push(style);
        }
        styles.insert(name.to_owned(), whole);
    }
    let mut with: Vec<&Block> = blocks.iter().filter(|block| block.has(LAYERS)).collect();
    with.sort_by_key(|block| std::cmp::Reverse(block.stamp.outputs.len()));
    let texts: Vec<String> = with.iter().map(|block| read(block, LAYERS)).collect::<Result<_>>()?;
    let layers = Layer::of_virtual(&texts, &styles);
    if !layers.is_empty() {
        write_atomically(&folder.join(LAYERS), layer_file(unit, &layers).as_bytes())?;
        outputs.push(LAYERS.into());
    }
    Ok(outputs)
}

/// Writes the surface model and the albedo with larger cells into `folder`.
fn overview(grid: &GridSpec, blocks: &[Block], work: &JoinedWork, folder: &Path) -> Result<Vec<String>> {
    // A power of two, so that coarse cells end where blocks end.
    let steps = (0..).map(|power| 1usize << power);
    let is_small = |step: &usize| grid.width.div_ceil(*step) * grid.height.div_ceil(*step) <= OVERVIEW_CELLS;
    let factor = steps.into_iter().find(is_small).unwrap_or(1);
    let small = grid.reduced(factor);
    let reduced = |name: &str| -> Result<Option<(Raster, Vec<String>)>> {
        let mut whole: Option<(Raster, Vec<String>)> = None;
        for block in blocks.iter().filter(|block| block.has(name)) {
            let file = RasterFile::open(&block.folder.join(name))?;
            let bands: Vec<usize> = (0..file.bands.len()).collect();
            let part = file.read_reduced(file.whole(), factor, &bands)?;
            let names = || file.bands.iter().map(|band| band.description.clone()).collect();
            let unknown = || Raster::filled(small.width, small.height, bands.len(), f32::NAN);
            let (all, _) = whole.get_or_insert_with(|| (unknown(), names()));
            all.put(&part, (block.at[0] / factor, block.at[1] / factor));
        }
        Ok(whole)
    };
    let mut raster = Raster::filled(small.width, small.height, 0, f32::NAN);
    for band in 0..BANDS {
        let file = dsm::file_of(Path::new(DSM), band);
        if let Some((plane, _)) = reduced(&file.to_string_lossy())? {
            raster.values.extend(plane.values);
            raster.bands += 1;
        }
    }
    let mut dsm = Dsm::above_ellipsoid(raster, small.clone());
    dsm.geoid = work.geoid;
    dsm.write(&folder.join(DSM))?;
    let shade = preview::hillshade(&dsm.altitude(), work.gsd_m * factor as f64);
    preview::write_png(&folder.with_file_name(PICTURE), &shade)?;
    let mut outputs = dsm::files(DSM);
    if let Some((raster, names)) = reduced(ALBEDO)? {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let spec = ImageSpec {
            band_descriptions: &names,
            georeference: Some((&small.transform, &small.crs)),
            ..ImageSpec::plain(&raster)
        };
        write_cog(&folder.join(ALBEDO), &spec)?;
        outputs.push(ALBEDO.into());
    }
    let within = outputs.into_iter().map(|name| format!("{OVERVIEW}/{name}"));
    Ok(within.chain([PICTURE.to_owned()]).collect())
}

/// Metrics of the whole mosaic: means of those of the blocks, weighted with their cells.
fn metrics(grid: &GridSpec, blocks: &[Block], work: &JoinedWork) -> Value {
    let mean = |pointer: &str, weight: &dyn Fn(&Block) -> Option<f64>| {
        let known = |block: &Block| Some((block.number(pointer)?, weight(block)?));
        let add = |(sum, all), (value, weight)| (sum + value * weight, all + weight);
        let (sum, all) = blocks.iter().filter_map(known).fold((0.0, 0.0), add);
        (all > 0.0).then_some(sum / all)
    };
    let cells = |block: &Block| Some(block.number("/width")? * block.number("/height")?);
    let whole = (grid.width * grid.height) as f64;
    let known = |block: &Block| Some(block.number("/completeness")? * cells(block)?);
    let all_known: f64 = blocks.iter().filter_map(known).sum();
    let places = Places::of(work.bounds, work.gsd_m);
    let tile = |tile: &MosaicTile| {
        let (core, bounds) = (places.span(tile.core), places.span(tile.bounds));
        json!({"unit": tile.unit, "core": core, "bounds": bounds})
    };
    let tiles: Vec<Value> = work.tiles.iter().map(tile).collect();
    let mut metrics = json!({
        "tiles": tiles.len(),
        "blocks": blocks.iter().map(|block| block.name.as_str()).collect::<Vec<_>>(),
        "width": grid.width,
        "height": grid.height,
        "gsd_m": work.gsd_m,
        "completeness": all_known / whole,
        "pieces": tiles,
    });
    for kind in ["border", "edge", "interior", "border_within_tiles"] {
        let of = |name: &str| format!("/seams/{kind}/{name}");
        let count = |block: &Block| block.number(&of("count"));
        if let Some(mean_m) = mean(&of("mean_m"), &count) {
            let above = mean(&of("above_1m"), &count);
            let count: f64 = blocks.iter().filter_map(count).sum();
            metrics["seams"][kind] = json!({"count": count, "mean_m": mean_m, "above_1m": above});
        }
    }
    for name in ["mae_m", "within_1m", "beyond_5m"] {
        if let Some(value) = mean(&format!("/dsm/{name}"), &known) {
            metrics["dsm"][name] = value.into();
        }
    }
    metrics
}
