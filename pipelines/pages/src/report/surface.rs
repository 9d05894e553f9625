//! Surface section of a report: place, key figures, maps with their scales, and files.

use super::Folder;
use super::parts::{Key, SURFACE_PX, figure, keys};
use crate::page::{inline_picture, number, plain, section};
use crate::view::{self, Exhibit, GridLocation, Layer, Ramp};
use heliosplat::Raster;
use heliosplat_products::style::{FELL_AND_ROSE, GROUND, SUN, colour};
use heliosplat_raster::preview::{UNKNOWN, hillshade, percentiles, stretched};
use image::{Rgb, RgbImage};
use maud::{Markup, html};

/// Largest width of the maps below the map of heights, pixels.
const MAP_PX: u32 = 480;
/// Brightness of level ground in a hillshade, 0 to 255; level ground keeps the colour of its height.
const LEVEL: f64 = 0.72 * 255.0;
/// Least brightness of a slope, and largest brightness of a lit slope relative to level ground: colours stay readable
/// on both.
const DARKEST: f64 = 0.35;
const BRIGHTEST: f64 = 1.25;
/// Longest scale bar, as a share of the map's width.
const BAR_MOST: f64 = 0.4;

/// List of files for users: on each line a file name, or a prefix of raster names, and a description.
const FILES: &str = include_str!("files.txt");

/// Place, coordinate reference system, extent and cells of the surface, the link to `sun.html`, and the key figures,
/// followed by `more`.
pub(super) fn head(folder: &Folder, shown: &Exhibit, more: &[Key]) -> Markup {
    let known = shown.altitude.values.iter().filter(|z| z.is_finite()).count();
    let share = known as f64 / shown.altitude.values.len().max(1) as f64;
    let [low, high] = heights(shown);
    let deviation = shown.layers.iter().find(|layer| layer.id == "deviation");
    let deviation = deviation.and_then(|layer| percentiles(&layer.values.values, 0.5, 0.5));
    let crs = &shown.grid.crs;
    let code = Some(crs.definition()).filter(|code| code.starts_with("EPSG:"));
    let [width, height] = [shown.altitude.width, shown.altitude.height].map(|cells| cells as f64 * shown.gsd_m);
    let deviation = deviation.map(|(m, _)| f64::from(m));
    let figures = [
        ("of the map known", Some(100.0 * share), 1, "%"),
        ("lowest height (1st percentile)", Some(low), 1, "m"),
        ("highest (99th percentile)", Some(high), 1, "m"),
        ("median standard deviation", deviation, 2, "m"),
    ];
    html! {
        p {
            @if let Ok(place) = GridLocation::of(&shown.grid, low) {
                (format!("{:.5}° {}, {:.5}° {}", place.lat_deg.abs(), if place.lat_deg < 0.0 { "S" } else { "N" },
                    place.lon_deg.abs(), if place.lon_deg < 0.0 { "W" } else { "E" })) " · "
            }
            (crs.name()) @if let Some(code) = code { " (" (code) ")" }
            (format!(" · {width:.0} × {height:.0} m · cells of ")) (plain(shown.gsd_m)) " m"
            @if !shown.vertical_datum.is_empty() { " · heights above " (shown.vertical_datum) }
        }
        @if folder.path.join(view::FILE).is_file() {
            p { a href={ "./" (view::FILE) } { "Move the sun over this surface" } }
        }
        (keys(&[&figures[..], more].concat()))
    }
}

/// 1st and 99th percentile of the heights, metres; 0 and 1 without known heights.
fn heights(shown: &Exhibit) -> [f64; 2] {
    percentiles(shown.altitude.plane(0), 0.01, 0.99).map_or([0.0, 1.0], |(low, high)| [low, high].map(f64::from))
}

/// Map of heights with its scales, overlaid with `over`, and the maps of uncertainty, views, errors and albedo.
pub(super) fn maps(shown: &Exhibit, over: &Markup) -> Markup {
    let shown = &*shown.reduced();
    let [low, high] = heights(shown);
    let albedo = shown.albedo.as_ref().map(stretched);
    html! {
        h2 { "Surface" }
        figure {
            @if let Some(address) = inline_picture(relief(shown, [low as f32, high as f32]), SURFACE_PX) {
                div.over { img src=(address) alt="Map of heights"; (over) }
            }
            (bar(shown))
            (scale(&GROUND, [low, high].map(|z| format!("{z:.0} m"))))
            figcaption { "Heights" @if !shown.vertical_datum.is_empty() { " above " (shown.vertical_datum) } "; grid north is up, dark is unknown." }
        }
        div.grid {
            @for layer in shown.layers.iter().filter(|layer| layer.ramp != Ramp::Picture) { (of_layer(layer)) }
            (figure(albedo, MAP_PX, "Colours without light (albedo), from above"))
        }
    }
}

/// Colours by height `low..high`, metres, darker on slopes that face away from the north-west.
fn relief(shown: &Exhibit, [low, high]: [f32; 2]) -> RgbImage {
    let mut picture = hillshade(&shown.altitude, shown.gsd_m);
    for (z, pixel) in shown.altitude.plane(0).iter().zip(picture.pixels_mut()) {
        if z.is_finite() {
            let shade = DARKEST + (1.0 - DARKEST) * (f64::from(pixel.0[1]) / LEVEL).min(BRIGHTEST);
            let tint = colour(&GROUND, (z - low) / (high - low).max(1e-3));
            *pixel = Rgb(tint.map(|value| (f64::from(value) * shade).min(255.0) as u8));
        }
    }
    picture
}

/// Map of a layer in the colours of its ramp, over its scale.
fn of_layer(layer: &Layer) -> Markup {
    let [low, high] = layer.range;
    let colours = match layer.ramp {
        Ramp::Diverging => &FELL_AND_ROSE,
        _ => &SUN,
    };
    let painted = |values: &Raster| {
        RgbImage::from_fn(values.width as u32, values.height as u32, |col, row| {
            let value = values.at(0, col as usize, row as usize);
            if !value.is_finite() {
                return UNKNOWN;
            }
            Rgb(colour(colours, (value - low) / (high - low).max(f32::MIN_POSITIVE)))
        })
    };
    html! {
        @if let Some(address) = inline_picture(painted(&layer.values), MAP_PX) {
            figure {
                img src=(address) alt=(layer.name);
                (scale(colours, layer.range.map(|end| format!("{} {}", plain_signed(end), layer.unit))))
                figcaption { (layer.name) }
            }
        }
    }
}

fn plain_signed(value: f32) -> String {
    let sign = if value < 0.0 { "−" } else { "" };
    format!("{sign}{}", plain(f64::from(value.abs())))
}

/// Colour scale with labels at both ends.
fn scale(colours: &[&str], [low, high]: [String; 2]) -> Markup {
    html! {
        div.scale style={ "background:linear-gradient(to right," (colours.join(",")) ")" } {}
        div.ends { span { (low) } span { (high) } }
    }
}

/// Scale bar of a round length.
fn bar(shown: &Exhibit) -> Markup {
    let width_m = shown.altitude.width as f64 * shown.gsd_m;
    let most_m = BAR_MOST * width_m;
    let power = 10f64.powf(most_m.log10().floor());
    let mut lengths = [5.0, 2.0, 1.0].into_iter().map(|step| step * power);
    let length_m = lengths.find(|&m| m <= most_m).unwrap_or(power);
    let share = number(Some(100.0 * length_m / width_m), 2);
    html! { div.bar style={ "width:" (share) "%" } { (plain(length_m)) " m" } }
}

/// Table of the files for users in the folder and in its `products` folder, each with a description.
pub(super) fn files(folder: &Folder) -> Markup {
    let mut rows = Vec::new();
    for within in ["", "products/"] {
        let entries = std::fs::read_dir(folder.path.join(within));
        let names = entries.into_iter().flatten().flatten().map(|entry| entry.file_name());
        let mut names: Vec<String> = names.map(|name| name.to_string_lossy().into_owned()).collect();
        names.sort_unstable();
        for (start, meaning) in FILES.lines().filter_map(|line| line.split_once(' ')) {
            let is_raster = |name: &str| !start.contains('.') && name.starts_with(start) && name.ends_with(".tif");
            // A mosaic of blocks has virtual rasters of the same names.
            let plain = |name: &str| match name.strip_suffix(".vrt") {
                Some(name) => format!("{name}.tif"),
                None => name.to_owned(),
            };
            let names = names.iter();
            let found = names.filter(|name| plain(name) == start || is_raster(&plain(name)));
            rows.extend(found.map(|name| (format!("{within}{name}"), meaning)));
        }
    }
    let body = html! {
        @if !rows.is_empty() {
            div.wide { table { @for (name, meaning) in rows { tr { td { a href={ "./" (name) } { (name) } } td.words { (meaning) } } } } }
        }
    };
    section("Files", body)
}
