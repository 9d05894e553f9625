//! The page of a mosaic: the whole area, its borders, its tiles. Made of what lies in its folder and in those of its tiles beside it.

use super::parts::{self, MIB, SURFACE_PX, figure, keys};
use super::{Folder, html, save};
use crate::page::escaped;
use heliosplat_fitting::run_folder::RunError;
use image::{Rgb, RgbImage};
use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Name of the file that says what came of a mosaic.
pub const FILE: &str = "mosaic.json";
/// Widest picture of a date, pixels.
const DATE_PX: u32 = 480;
/// Widest picture of a tile, pixels.
const TILE_PX: u32 = 260;
/// More pictures of dates, or of tiles, than this are not shown.
const SHOWN: usize = 40;
/// Most rows of a table.
const ROWS: usize = 400;
/// Colour of the lines between tiles.
const LINE: Rgb<u8> = Rgb([230, 80, 30]);

/// A tile as the page knows it.
struct Tile {
    /// Its folder beside the mosaic's.
    name: String,
    /// First and one past last column and row of its core.
    core: [[u32; 2]; 2],
    /// Its stamp.
    stamp: Folder,
}

/// Writes `report.html` into the folder of a mosaic; returns its path.
///
/// # Errors
/// When the folder holds none, or the page cannot be written.
pub fn write(folder: &Path) -> Result<PathBuf, RunError> {
    if !folder.join(FILE).is_file() {
        return Err(RunError::NotARun(folder.to_owned()));
    }
    let mosaic = Folder::read(folder, FILE)?;
    let tiles = tiles(&mosaic)?;
    let whole = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    // Area, images, preset.
    let mut title: Vec<String> = whole
        .ancestors()
        .skip(1)
        .take(3)
        .filter_map(|part| Some(part.file_name()?.to_string_lossy().into_owned()))
        .collect();
    title.reverse();
    let sections = [
        head(&mosaic, &tiles),
        surface(&mosaic, &tiles),
        dates(&mosaic),
        borders(&mosaic),
        parts::accuracy(&mosaic),
        table(&tiles),
        products(&mosaic),
    ];
    save(folder, &html(&title.join(" / "), &sections))
}

fn tiles(mosaic: &Folder) -> Result<Vec<Tile>, RunError> {
    let empty = Vec::new();
    let pieces = mosaic.metrics["pieces"].as_array().unwrap_or(&empty);
    let mut tiles = Vec::with_capacity(pieces.len());
    for piece in pieces {
        let name = piece["unit"]
            .as_str()
            .and_then(|unit| unit.rsplit('/').next())
            .unwrap_or("");
        // It becomes part of a path and of an address.
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

fn head(mosaic: &Folder, tiles: &[Tile]) -> String {
    let number = |pointer: &str| mosaic.number(pointer);
    let gsd_m = number("/gsd_m").unwrap_or(0.0);
    let side = |key: &str| number(key).map(|cells| cells * gsd_m);
    let all = |pointer: &str| {
        tiles
            .iter()
            .filter_map(|tile| tile.stamp.number(pointer))
            .collect::<Vec<_>>()
    };
    let memory = all("/peak_rss_bytes").into_iter().reduce(f64::max);
    keys(&[
        ("mean height error, raw", number("/dsm/mae_m"), 3, "m"),
        ("median height error", number("/dsm/median_m"), 3, "m"),
        (
            "of the ground known",
            number("/completeness").map(|share| 100.0 * share),
            1,
            "%",
        ),
        ("mean step between tiles", number("/seams/border/mean_m"), 3, "m"),
        ("mean step elsewhere", number("/seams/interior/mean_m"), 3, "m"),
        ("from west to east", side("/width"), 0, "m"),
        ("from south to north", side("/height"), 0, "m"),
        ("tiles", number("/tiles"), 0, ""),
        ("time of all tiles", Some(all("/seconds").iter().sum()), 0, "s"),
        ("memory of the largest", memory.map(|bytes| bytes / MIB), 0, "MiB"),
    ])
}

/// The surface with the lines between tiles, its errors, its albedo.
fn surface(mosaic: &Folder, tiles: &[Tile]) -> String {
    let surface = mosaic.picture("dsm.png");
    let lined = surface.clone().filter(|_| tiles.len() > 1).map(|mut picture| {
        tiles.iter().for_each(|tile| outline(&mut picture, tile.core));
        picture
    });
    let show = |name: &str, caption: &str| figure(mosaic.picture(name), SURFACE_PX, caption);
    let figures = figure(surface, SURFACE_PX, "The surface, lit from the north-west")
        + &figure(lined, SURFACE_PX, "The same with the lines between tiles")
        + &show("error.png", "Its height errors: blue too low, red too high")
        + &show("pictures/albedo.png", "Albedo, seen from straight above")
        + &show("pictures/relit.png", "Lit by the sun asked for");
    format!("<h2>Surface</h2><div class=\"grid\">{figures}</div>")
}

/// Draws the outline of a tile's core; thick enough to be seen when the picture is made small.
fn outline(picture: &mut RgbImage, [columns, rows]: [[u32; 2]; 2]) {
    let (width, height) = picture.dimensions();
    let thick = width.max(height).div_ceil(SURFACE_PX);
    let mut fill = |[left, right]: [u32; 2], [top, bottom]: [u32; 2]| {
        for row in top..bottom.min(height) {
            for col in left..right.min(width) {
                picture.put_pixel(col, row, LINE);
            }
        }
    };
    let [[left, right], [top, bottom]] = [columns, rows];
    for at in [left, right.saturating_sub(thick)] {
        fill([at, at.saturating_add(thick)], rows);
    }
    for at in [top, bottom.saturating_sub(thick)] {
        fill(columns, [at, at.saturating_add(thick)]);
    }
}

/// The shadows of every date over the albedo.
fn dates(mosaic: &Folder) -> String {
    let empty = Vec::new();
    let dates = mosaic
        .metrics
        .pointer("/products/dates")
        .and_then(Value::as_array)
        .unwrap_or(&empty);
    let mut out = String::new();
    for date in dates.iter().filter_map(Value::as_str).take(SHOWN) {
        if !date.contains(['/', '\\']) {
            out += &figure(mosaic.picture(&format!("pictures/shadow_{date}.png")), DATE_PX, date);
        }
    }
    if out.is_empty() {
        return out;
    }
    format!("<h2>Shadows, date by date</h2><div class=\"grid\">{out}</div>")
}

fn metres(value: Option<f64>) -> String {
    value.map_or_else(String::new, |v| format!("{v:.3}"))
}

/// Steps at the borders of tiles and elsewhere, and how tiles differ where they overlap.
fn borders(mosaic: &Folder) -> String {
    let mut rows = String::new();
    for (key, label) in [
        ("border", "across the lines between tiles"),
        ("border_within_tiles", "at the same places within each tile"),
        ("edge", "where tiles begin and end"),
        ("interior", "elsewhere"),
    ] {
        let number = |name: &str| mosaic.number(&format!("/seams/{key}/{name}"));
        if number("mean_m").is_some() {
            let above = number("above_1m").map_or_else(String::new, |v| format!("{:.1}", 100.0 * v));
            // Writing to a String cannot fail.
            let _ = write!(
                rows,
                "<tr><td>{label}<td>{}<td>{}<td>{}<td>{above}</tr>",
                metres(number("mean_m")),
                metres(number("median_m")),
                metres(number("p95_m"))
            );
        }
    }
    let mut overlaps = String::new();
    let empty = Vec::new();
    let all = mosaic
        .metrics
        .pointer("/seams/overlaps")
        .and_then(Value::as_array)
        .unwrap_or(&empty);
    for overlap in all.iter().take(ROWS) {
        let name = |index: usize| {
            let unit = overlap["tiles"][index].as_str().unwrap_or("");
            escaped(unit.rsplit('/').next().unwrap_or(unit))
        };
        let number = |key: &str| metres(overlap[key].as_f64());
        let _ = write!(
            overlaps,
            "<tr><td>{} and {}<td>{}<td>{}<td>{}<td>{}</tr>",
            name(0),
            name(1),
            overlap["cells"].as_u64().unwrap_or(0),
            number("median_m"),
            number("nmad_m"),
            number("mean_abs_m")
        );
    }
    if overlaps.is_empty() {
        return String::new();
    }
    format!(
        "<h2>Borders of tiles</h2><p>Steps between neighbouring cells.</p><div class=\"wide\"><table><tr><th>steps<th>mean m<th>median m<th>95 % below, m\
         <th>above 1 m, %</tr>{rows}</table></div><p>Where two tiles overlap, the second minus the first.</p><div class=\"wide\"><table><tr><th>tiles\
         <th>cells<th>median m<th>spread (NMAD) m<th>mean distance m</tr>{overlaps}</table></div>"
    )
}

/// The tiles, each with its own page.
fn table(tiles: &[Tile]) -> String {
    let (mut rows, mut figures) = (String::new(), String::new());
    for (place, tile) in tiles.iter().take(ROWS).enumerate() {
        let number = |pointer: &str, digits: usize| {
            let value = tile.stamp.number(pointer);
            value.map_or_else(String::new, |v| format!("{v:.digits$}"))
        };
        let name = escaped(&tile.name);
        let memory = tile
            .stamp
            .number("/peak_rss_bytes")
            .map_or_else(String::new, |b| format!("{:.0}", b / MIB));
        let _ = write!(
            rows,
            "<tr><td><a href=\"../{name}/run/report.html\">{name}</a><td>{}<td>{}<td>{}<td>{}<td>{}<td>{memory}</tr>",
            number("/metrics/dsm/mae_m", 3),
            number("/metrics/test/psnr", 2),
            number("/metrics/residual_px", 4),
            number("/metrics/gaussians", 0),
            number("/seconds", 1)
        );
        if place < SHOWN {
            figures += &figure(tile.stamp.picture("run/dsm.png"), TILE_PX, &tile.name);
        }
    }
    format!(
        "<h2>Tiles</h2><div class=\"wide\"><table><tr><th>tile<th>mean height error m<th>PSNR held out dB<th>camera residual px<th>Gaussians<th>s<th>MiB</tr>\
         {rows}</table></div><div class=\"four\">{figures}</div>"
    )
}

/// The files that lie beside the page.
fn products(mosaic: &Folder) -> String {
    let mut names: Vec<String> = std::fs::read_dir(&mosaic.path)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| [".tif", ".laz", "item.json"].iter().any(|end| name.ends_with(end)) && !name.starts_with('.'))
        .collect();
    names.sort_unstable();
    let links: Vec<String> = names
        .iter()
        .map(|name| format!("<a href=\"{0}\">{0}</a>", escaped(name)))
        .collect();
    if links.is_empty() {
        return String::new();
    }
    format!("<h2>Files</h2><p>{}</p>", links.join(", "))
}
