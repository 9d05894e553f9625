//! Page of a mosaic: the whole area, the consistency of its tiles at their edges, and every tile. It is made from the
//! files in the mosaic's folder and in the folders of the tiles beside it.

use super::parts::{self, SURFACE_PX, figure, gallery, keys};
use super::{Folder, page_of, save, surface};
use crate::page::{MIB, MOSAIC_FILE, number, section};
use crate::view::{self, Exhibit, ViewError};
use heliosplat_fitting::run_folder::RunError;
use image::RgbImage;
use maud::{Markup, html};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Largest width of the picture of a date, pixels.
const DATE_PX: u32 = 480;
/// Largest width of the picture of a tile, pixels.
const TILE_PX: u32 = 260;
/// Most pictures of dates, and most of tiles.
const SHOWN: usize = 40;
/// Most rows of a table.
const ROWS: usize = 400;

/// Tile of the mosaic.
struct Tile {
    /// Name of its folder, which lies beside the mosaic's.
    name: String,
    /// First and one past last column and row of its core.
    core: [[u32; 2]; 2],
    /// Its folder with its metrics.
    stamp: Folder,
}

/// Writes `report.html` into the folder of a mosaic; returns its path.
///
/// # Errors
/// When the folder holds no mosaic, a file cannot be read, or the page cannot be written.
pub fn write(folder: &Path) -> Result<PathBuf, ViewError> {
    if !folder.join(MOSAIC_FILE).is_file() {
        return Err(RunError::NotARun(folder.to_owned()).into());
    }
    let mosaic = Folder::read(folder, MOSAIC_FILE)?;
    let tiles = tiles(&mosaic)?;
    let whole = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    // Area, images, preset.
    let names = whole.ancestors().skip(1).take(3).filter_map(Path::file_name);
    let mut title: Vec<_> = names.map(|name| name.to_string_lossy()).collect();
    title.reverse();
    let shown = match view::of_mosaic(folder, None) {
        Err(ViewError::Nothing(_)) => None,
        other => Some(other?),
    };
    let relit = mosaic.picture("pictures/relit.png");
    let sections = [
        head(&mosaic, &tiles, shown.as_ref()),
        html! { @if let Some(shown) = &shown { (surface::maps(shown, &borders_of(&mosaic, &tiles))) } },
        figure(relit, SURFACE_PX, "Relit with the requested sun"),
        surface::files(&mosaic),
        blocks(&mosaic),
        dates(&mosaic),
        borders(&mosaic),
        parts::accuracy(&mosaic, None),
        table(&tiles),
    ];
    let page = page_of(&title.join(" / "), &sections);
    Ok(save(&folder.join(super::FILE), &page)?)
}

fn tiles(mosaic: &Folder) -> Result<Vec<Tile>, RunError> {
    let pieces = mosaic.list("/pieces");
    let mut tiles = Vec::with_capacity(pieces.len());
    for piece in pieces {
        let unit = piece["unit"].as_str().unwrap_or("");
        let name = unit.rsplit('/').next().unwrap_or("");
        // The name becomes part of a path and of an address.
        if name.is_empty() || name.starts_with('.') || name.contains('\\') {
            continue;
        }
        let beside = mosaic.path.join("..").join(name);
        tiles.push(Tile {
            core: serde_json::from_value(piece["core"].clone()).unwrap_or_default(),
            stamp: Folder::read(&beside, "unit.json")?,
            name: name.to_owned(),
        });
    }
    Ok(tiles)
}

fn head(mosaic: &Folder, tiles: &[Tile], shown: Option<&Exhibit>) -> Markup {
    let number = |pointer: &str| mosaic.number(pointer);
    let all = |pointer: &'static str| tiles.iter().filter_map(move |tile| tile.stamp.number(pointer));
    let at_borders = number("/seams/border/mean_m");
    let memory = all("/peak_rss_bytes").reduce(f64::max);
    let figures = [
        ("mean absolute height error, raw", number("/dsm/mae_m"), 3, "m"),
        ("median height error", number("/dsm/median_m"), 3, "m"),
        ("mean height step across tile boundaries", at_borders, 3, "m"),
        ("mean height step elsewhere", number("/seams/interior/mean_m"), 3, "m"),
        ("tiles", number("/tiles"), 0, ""),
        ("total time of tiles", Some(all("/seconds").sum()), 0, "s"),
        ("peak memory of a tile", memory.map(|bytes| bytes / MIB), 0, "MiB"),
    ];
    shown.map_or_else(|| keys(&figures), |shown| surface::head(mosaic, shown, &figures))
}

/// Outlines of the tiles' cores, drawn over the surface.
fn borders_of(mosaic: &Folder, tiles: &[Tile]) -> Markup {
    let [width, height] = ["/width", "/height"].map(|side| mosaic.number(side).unwrap_or(1.0));
    html! {
        svg viewBox=(format_args!("0 0 {width} {height}")) preserveAspectRatio="none" {
            @for Tile { core: [[left, right], [top, bottom]], name, .. } in tiles {
                rect x=(left) y=(top) width=(right.saturating_sub(*left)) height=(bottom.saturating_sub(*top)) vector-effect="non-scaling-stroke" {
                    title { (name) }
                }
            }
        }
    }
}

/// Blocks of the mosaic, with links to their pages.
fn blocks(mosaic: &Folder) -> Markup {
    let names = mosaic.list("/blocks").iter().filter_map(Value::as_str);
    // A name becomes part of an address.
    let names: Vec<&str> = names.filter(|name| !name.contains(['/', '\\', '.'])).collect();
    let body = html! {
        @if !names.is_empty() {
            p { "The rasters of the whole area (" code { ".vrt" } ") refer to the GeoTIFFs of these blocks." }
            p { @for name in names.iter().take(ROWS) { a href={ "../" (name) "/report.html" } { (name) } " " } }
        }
    };
    section("Blocks", body)
}

/// Pictures of the shadows of each date over the albedo.
fn dates(mosaic: &Folder) -> Markup {
    let dates = mosaic.list("/products/dates").iter().filter_map(Value::as_str);
    let figures = html! {
        // A date becomes part of a path.
        @for date in dates.take(SHOWN).filter(|date| !date.contains(['/', '\\'])) {
            (figure(mosaic.picture(&format!("pictures/shadow_{date}.png")), DATE_PX, date))
        }
    };
    gallery("Shadows by date", "grid", &figures)
}

/// Height steps at tile boundaries and elsewhere, and height differences of tiles in their overlaps.
fn borders(mosaic: &Folder) -> Markup {
    let steps = [
        ("border", "across tile boundaries, in the mosaic"),
        ("border_within_tiles", "at the same places, within single tiles"),
        ("edge", "where a tile's overlap ends"),
        ("interior", "elsewhere"),
    ];
    let metric = |key: &str, name: &str| mosaic.number(&format!("/seams/{key}/{name}"));
    let measured = steps.iter().filter(|(key, _)| metric(key, "mean_m").is_some());
    // A mosaic in blocks has means of its blocks alone.
    let columns = [
        ("mean_m", "mean, m"),
        ("median_m", "median, m"),
        ("p95_m", "95th percentile, m"),
    ];
    let columns = || columns.iter().filter(|(name, _)| metric("border", name).is_some());
    let overlaps = mosaic.list("/seams/overlaps");
    let tile = |overlap: &Value, place: usize| {
        let unit = overlap["tiles"][place].as_str().unwrap_or("");
        unit.rsplit('/').next().unwrap_or(unit).to_owned()
    };
    html! {
        @if metric("border", "mean_m").is_some() {
            h2 { "Tile-edge consistency" }
            p { "Height steps between neighbouring cells." }
            div.wide { table {
                tr { th { "cells" } @for (_, label) in columns() { th { (label) } } th { "above 1 m, %" } }
                @for (key, label) in measured {
                    tr {
                        td { (label) }
                        @for (name, _) in columns() { td { (number(metric(key, name), 3)) } }
                        td { (number(metric(key, "above_1m").map(|share| 100.0 * share), 1)) }
                    }
                }
            } }
            @if !overlaps.is_empty() { p { "Where two tiles overlap: height of the second minus that of the first." } }
            @if !overlaps.is_empty() { div.wide { table {
                tr { th { "tiles" } th { "cells" } th { "median, m" } th { "NMAD, m" } th { "mean absolute, m" } }
                @for overlap in overlaps.iter().take(ROWS) {
                    tr {
                        td { (tile(overlap, 0)) " and " (tile(overlap, 1)) }
                        td { (overlap["cells"].as_u64().unwrap_or(0)) }
                        @for name in ["median_m", "nmad_m", "mean_abs_m"] { td { (number(overlap[name].as_f64(), 3)) } }
                    }
                }
            } } }
        }
    }
}

/// Table of the tiles with links to their pages, and pictures of their surfaces.
fn table(tiles: &[Tile]) -> Markup {
    html! {
        h2 { "Tiles" }
        div.wide { table {
            tr {
                th { "tile" } th { "DSM MAE, m" } th { "PSNR held out, dB" } th { "camera residual, px" } th { "Gaussians" } th { "time, s" }
                th { "peak memory, MiB" }
            }
            @for tile in tiles.iter().take(ROWS) {
                @let metric = |pointer: &str, digits: usize| number(tile.stamp.number(pointer), digits);
                tr {
                    td {
                        @if tile.stamp.path.join("run/report.html").is_file() {
                            a href={ "../" (tile.name) "/run/report.html" } { (tile.name) }
                        } @else { (tile.name) }
                    }
                    td { (metric("/metrics/dsm/mae_m", 3)) }
                    td { (metric("/metrics/test/psnr", 2)) }
                    td { (metric("/metrics/residual_px", 4)) }
                    td { (metric("/metrics/gaussians", 0)) }
                    td { (metric("/seconds", 1)) }
                    td { (number(tile.stamp.number("/peak_rss_bytes").map(|bytes| bytes / MIB), 0)) }
                }
            }
        } }
        div.four {
            @for tile in tiles.iter().take(SHOWN) { (figure(picture(tile), TILE_PX, &tile.name)) }
        }
    }
}

/// Picture of a tile's surface, trained or swept.
fn picture(tile: &Tile) -> Option<RgbImage> {
    let of_run = tile.stamp.picture("run/dsm.png");
    of_run.or_else(|| tile.stamp.picture("dsm.png"))
}
