//! The parts of a report, from top to bottom.

use super::{Contents, Folder};
use crate::page::chart::{Line, lines, lines_within};
use crate::page::{escaped, inline_picture, plain};
use heliosplat_products::set::date_of;
use heliosplat_scene::Split;
use image::RgbImage;
use image::imageops::crop_imm;
use serde_json::Value;
use std::fmt::Write;

/// Widest pictures of the surface and of views, pixels.
pub(super) const SURFACE_PX: u32 = 720;
const VIEW_PX: u32 = 420;
/// More views than this are not shown: the page is to be sent by mail.
const VIEWS_MAX: usize = 40;
/// What the panels of a view's picture are.
const PANELS: [&str; 4] = [
    "image",
    "rendering",
    "shadows found",
    "shadows against truth: blue missing, red too many",
];

pub(super) const MIB: f64 = 1_048_576.0;

/// A number that matters: what it is, its value if it is known, digits after the point, its unit.
pub(super) type Key<'a> = (&'a str, Option<f64>, usize, &'a str);

/// Numbers that matter, side by side; those that are not known are left out.
pub(super) fn keys(all: &[Key]) -> String {
    let mut out = "<div class=\"key\">".to_owned();
    for (label, value, digits, unit) in all {
        if let Some(value) = value {
            // Writing to a String cannot fail.
            let _ = write!(out, "<div><b>{value:.digits$} {unit}</b>{label}</div>");
        }
    }
    out + "</div>"
}

/// What was trained, and the numbers that matter.
pub(super) fn head(run: &Contents) -> String {
    let file = &run.run;
    let said = format!(
        "<p class=\"faint\">{} · preset {} · seed {} · heliosplat {}</p>",
        escaped(&file.scene.display().to_string()),
        escaped(&file.preset),
        file.seed,
        escaped(&file.version)
    );
    let measured = &run.folder;
    let protocol = measured
        .metrics
        .pointer("/dsm/protocol")
        .and_then(Value::as_str)
        .unwrap_or("raw");
    let height_error = format!("mean height error, {}", escaped(protocol));
    let number = |pointer: &str| measured.number(pointer);
    let percent = |pointer: &str| number(pointer).map(|share| 100.0 * share);
    let numbers = keys(&[
        (&height_error, number("/dsm/mae_m"), 3, "m"),
        ("median height error", number("/dsm/median_m"), 3, "m"),
        ("of the ground known", percent("/dsm/completeness"), 1, "%"),
        ("shadows right", percent("/shadow/accuracy"), 1, "%"),
        ("PSNR of images trained on", number("/train/psnr"), 2, "dB"),
        ("PSNR of images held out", number("/test/psnr"), 2, "dB"),
        ("time", number("/seconds"), 1, "s"),
        ("memory at most", number("/peak_rss_bytes").map(|b| b / MIB), 0, "MiB"),
        ("Gaussians", number("/gaussians"), 0, ""),
    ]);
    said + &numbers
}

pub(super) fn figure(picture: Option<RgbImage>, width: u32, caption: &str) -> String {
    let address = picture.and_then(|picture| inline_picture(picture, width));
    address.map_or_else(String::new, |address| {
        let caption = escaped(caption);
        format!("<figure><img src=\"{address}\" alt=\"{caption}\"><figcaption>{caption}</figcaption></figure>")
    })
}

/// Hillshades of the surface, and the map of its errors.
pub(super) fn surface(run: &Folder) -> String {
    let show = |name: &str, caption: &str| figure(run.picture(name), SURFACE_PX, caption);
    let figures = show("dsm.png", "The surface, lit from the north-west")
        + &show("error.png", "Its height errors: blue too low, red too high")
        + &show("start.png", "The surface that training started from");
    if figures.is_empty() {
        return String::new();
    }
    format!("<h2>Surface</h2><div class=\"grid\">{figures}</div>")
}

/// Each view beside its rendering and its shadows, date by date.
pub(super) fn views(run: &Contents) -> String {
    let mut images: Vec<_> = run.model.images.iter().collect();
    images.sort_by_key(|image| (date_of(image), image.name.clone()));
    let mut out = String::new();
    let mut date = None;
    for image in images.iter().take(VIEWS_MAX) {
        let Some(picture) = run.folder.picture(&format!("views/{}.png", image.name)) else {
            continue;
        };
        let this = date_of(image);
        if date.as_ref() != Some(&this) {
            let (azimuth, elevation) = (image.sun.azimuth_rad.to_degrees(), image.sun.elevation_rad.to_degrees());
            let _ = write!(
                out,
                "<h3>{} <span class=\"faint\">sun at azimuth {azimuth:.1}°, elevation {elevation:.1}°</span></h3>",
                escaped(&this)
            );
            date = Some(this);
        }
        let held_out = if image.split == Split::Test { ", held out" } else { "" };
        let width = image.crop.width as u32;
        let _ = write!(
            out,
            "<div class=\"faint\">{}{held_out}</div><div class=\"four\">",
            escaped(&image.name)
        );
        for (place, panel) in PANELS.iter().enumerate() {
            let left = place as u32 * width;
            if width > 0 && left + width <= picture.width() {
                let panel_picture = crop_imm(&picture, left, 0, width, picture.height()).to_image();
                out += &figure(Some(panel_picture), VIEW_PX, panel);
            }
        }
        out += "</div>";
    }
    if out.is_empty() {
        return out;
    }
    if images.len() > VIEWS_MAX {
        let _ = write!(
            out,
            "<p class=\"faint\">The first {VIEWS_MAX} of {} views; the others are in views/.</p>",
            images.len()
        );
    }
    format!("<h2>Images and shadows, date by date</h2>{out}")
}

/// The course of training.
pub(super) fn curves(run: &Folder) -> String {
    let empty = Vec::new();
    let curve = run.metrics.get("curve").and_then(Value::as_array).unwrap_or(&empty);
    let line = |name: &str, pick: &dyn Fn(&Value) -> Option<f64>| Line {
        name: name.to_owned(),
        points: curve
            .iter()
            .filter_map(|point| Some((point["step"].as_f64()?, pick(point)?)))
            .collect(),
    };
    let chart = |title: &str, drawn: &[Line]| {
        let known: Vec<Line> = drawn.iter().filter(|line| line.points.len() > 1).cloned().collect();
        lines(title, "step", &known)
    };
    let psnr = line("", &|point| point["accuracy"]["psnr_db"].as_f64());
    let accuracy = chart(
        "Mean height error, metres",
        &[line("", &|point| point["accuracy"]["height_mae_m"].as_f64())],
    ) + &lines_within("PSNR of images held out, dB", "step", &[psnr]);
    let difference = chart(
        "Difference to the images",
        &[
            line("all pixels, smoothed", &|point| point["l1"].as_f64()),
            line("pixels held out", &|point| point["held_out_l1"].as_f64()),
        ],
    );
    let mut names: Vec<&String> = curve
        .iter()
        .filter_map(|point| point["losses"].as_object())
        .flat_map(|losses| losses.keys())
        .collect();
    names.sort_unstable();
    names.dedup();
    let mut losses = String::new();
    for name in names {
        losses += &chart(
            &format!("Loss: {name}"),
            &[line("", &|point| point["losses"].get(name.as_str())?.as_f64())],
        );
    }
    if (accuracy.len() + difference.len() + losses.len()) == 0 {
        return String::new();
    }
    format!("<h2>Training</h2><div class=\"charts\">{accuracy}{difference}{losses}</div>")
}

/// How many cells are how near to the truth.
pub(super) fn accuracy(run: &Folder) -> String {
    let list = |pointer: &str| -> Vec<f64> {
        let values = run.metrics.pointer(pointer).and_then(Value::as_array);
        values.map_or_else(Vec::new, |v| v.iter().filter_map(Value::as_f64).collect())
    };
    let shares = |quantiles: Vec<f64>| -> Vec<(f64, f64)> {
        let last = quantiles.len().saturating_sub(1).max(1) as f64;
        // Beyond this the line would only show how rare the worst errors are.
        const WORST_M: f64 = 5.0;
        let points = quantiles
            .into_iter()
            .enumerate()
            .map(|(i, m)| (m, 100.0 * i as f64 / last));
        points.take_while(|(m, _)| *m <= WORST_M).collect()
    };
    let line = |name: &str, pointer: &str| Line {
        name: name.into(),
        points: shares(list(pointer)),
    };
    let all = [
        line("the surface", "/dsm/error_quantiles_m"),
        line("as it started", "/start/error_quantiles_m"),
    ];
    let known: Vec<Line> = all.into_iter().filter(|line| line.points.len() > 1).collect();
    let chart = lines("Cells nearer to the truth than this, %", "metres", &known);
    let mut table = String::new();
    if let Some(classes) = run.metrics.pointer("/dsm/by_class").and_then(Value::as_object) {
        table += "<div class=\"wide\"><table><tr><th>class<th>mean m<th>median m<th>RMSE m<th>in 1 m %</tr>";
        for (name, class) in classes {
            let number = |key: &str, gain: f64| {
                class[key]
                    .as_f64()
                    .map_or_else(String::new, |v| format!("{:.3}", gain * v))
            };
            let _ = write!(
                table,
                "<tr><td>{}<td>{}<td>{}<td>{}<td>{}</tr>",
                escaped(name),
                number("mae_m", 1.0),
                number("median_m", 1.0),
                number("rmse_m", 1.0),
                class["within_1m"]
                    .as_f64()
                    .map_or_else(String::new, |v| format!("{:.1}", 100.0 * v)),
            );
        }
        table += "</table></div>";
    }
    if chart.is_empty() && table.is_empty() {
        return String::new();
    }
    format!("<h2>Accuracy against truth</h2><div class=\"charts\">{chart}</div>{table}")
}

/// Which components the scene required, and why.
pub(super) fn plan(run: &Contents) -> String {
    let mut out = "<h2>Component plan</h2><div class=\"wide\"><table><tr><th>component<th class=\"words\">used<th class=\"words\">why</tr>".to_owned();
    for item in &run.run.plan {
        let (class, used) = if item.on { ("", "yes") } else { (" class=\"off\"", "no") };
        let _ = write!(
            out,
            "<tr{class}><td>{}<td class=\"words\">{used}<td class=\"words\">{}</tr>",
            escaped(&item.component),
            escaped(&item.reason)
        );
    }
    out + "</table></div>"
}

/// A row of [`costs_of`]: what it is, its value if it is known, its unit.
pub(super) type Cost<'a> = (&'a str, Option<f64>, &'a str);

/// What was taken, and the configuration.
pub(super) fn costs_of(rows: &[Cost], configuration: &impl serde::Serialize) -> String {
    let mut out = "<h2>Time and memory</h2><div class=\"wide\"><table>".to_owned();
    for (label, value, unit) in rows {
        if let Some(value) = value {
            let _ = write!(out, "<tr><td>{}<td>{} {unit}</tr>", escaped(label), plain(*value));
        }
    }
    out += "</table></div>";
    if let Ok(text) = toml::to_string_pretty(configuration) {
        let _ = write!(
            out,
            "<details><summary>Configuration and inputs</summary><pre>{}</pre></details>",
            escaped(&text)
        );
    }
    out
}

/// Time and memory of a run of a satellite scene.
pub(super) fn costs(run: &Contents) -> String {
    let number = |pointer: &str| run.folder.number(pointer);
    let mebibytes = |pointer: &str| number(pointer).map(|bytes| bytes / MIB);
    let rows = [
        ("pointing of the images", number("/stages_s/align"), "s"),
        ("sweep", number("/stages_s/sweep"), "s"),
        ("start", number("/stages_s/start"), "s"),
        ("training", number("/stages_s/train"), "s"),
        ("all, products included", number("/seconds"), "s"),
        ("steps", number("/iterations"), ""),
        ("best step", number("/best_iteration"), ""),
        ("memory used at most", mebibytes("/peak_rss_bytes"), "MiB"),
        ("memory expected", mebibytes("/memory_estimate_bytes"), "MiB"),
    ];
    costs_of(&rows, &run.run)
}
