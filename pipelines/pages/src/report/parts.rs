//! Sections of a report, from top to bottom; many of them are shared by runs, objects and mosaics.

use super::{Contents, Folder};
use crate::page::chart::{Line, lines, lines_within};
use crate::page::{MIB, calibration, inline_picture, number, plain, section};
use heliosplat_evaluate::uncertainty::Uncertainty;
use heliosplat_products::model::ModelImage;
use heliosplat_products::set::date_of;
use heliosplat_scene::Split;
use image::RgbImage;
use image::imageops::crop_imm;
use maud::{Markup, html};
use rayon::prelude::*;
use serde_json::Value;

/// Largest width of pictures of the surface and of views, pixels.
pub(super) const SURFACE_PX: u32 = 720;
const VIEW_PX: u32 = 420;
/// Most views on a page, which keeps it small enough for mail.
const VIEWS_MAX: usize = 40;
/// Panels of a view's picture, from left to right.
const PANELS: [&str; 4] = [
    "image",
    "rendering",
    "shadow mask",
    "shadow errors: blue missed, red false",
];

/// Key figure: label, value if known, digits after the point, unit.
pub(super) type Key<'a> = (&'a str, Option<f64>, usize, &'a str);

/// Key figures side by side, without unknown ones.
pub(super) fn keys(all: &[Key]) -> Markup {
    html! {
        div.key {
            @for (label, value, digits, unit) in all {
                @if value.is_some() {
                    div { b { (number(*value, *digits)) " " (unit) } (label) }
                }
            }
        }
    }
}

/// Line with input, preset, seed and version of a run.
pub(super) fn origin(scene: &std::path::Path, preset: &str, seed: u64, version: &str) -> Markup {
    html! { p.faint { (scene.display().to_string()) " · preset " (preset) " · seed " (seed) " · heliosplat " (version) } }
}

/// Picture of at most `width` pixels width over its caption; empty without a picture.
pub(super) fn figure(picture: Option<RgbImage>, width: u32, caption: &str) -> Markup {
    captioned(picture.and_then(|picture| inline_picture(picture, width)), caption)
}

/// Picture by its address, with a caption.
fn captioned(address: Option<String>, caption: &str) -> Markup {
    html! {
        @if let Some(address) = address {
            figure { img src=(address) alt=(caption); figcaption { (caption) } }
        }
    }
}

/// Figures side by side under a heading, in an element of CSS class `class`; empty without figures.
pub(super) fn gallery(heading: &str, class: &str, figures: &Markup) -> Markup {
    html! {
        @if !figures.0.is_empty() {
            h2 { (heading) }
            div class=(class) { (figures) }
        }
    }
}

/// Number and area of the courtyards and alleys that were reopened in the initial surface; empty if there are none.
pub(super) fn lowered(run: &Folder) -> Markup {
    let lowered = |key: &str| run.number(&format!("/lowered/{key}")).filter(|&count| count > 0.0);
    html! {
        @if let Some(parts) = lowered("parts") {
            p { "Shaded courtyards and alleys that were reopened after matching: " (number(Some(parts), 0)) ", " (number(lowered("area_m2"), 0)) " m²." }
        }
    }
}

/// Views beside their renderings and shadows, date by date.
pub(super) fn views(run: &Contents) -> Markup {
    let mut images: Vec<_> = run.model.images.iter().collect();
    images.sort_by_key(|image| (date_of(image), image.name.clone()));
    let addresses = |image: &&ModelImage| -> Option<Vec<Option<String>>> {
        let picture = run.folder.picture(&format!("views/{}.png", image.name))?;
        let panels = panels(&picture, image.crop.width as u32);
        Some(panels.into_iter().map(|panel| inline_picture(panel, VIEW_PX)).collect())
    };
    let addresses: Vec<_> = images.par_iter().take(VIEWS_MAX).map(addresses).collect();
    let mut date = None;
    let shown = images.iter().zip(addresses).filter_map(|(image, addresses)| {
        let addresses = addresses?;
        let this = date_of(image);
        let new_date = date.replace(this.clone()).as_ref() != Some(&this);
        let sun = match image.sun {
            Some(sun) => {
                let (azimuth, elevation) = (sun.azimuth_rad.to_degrees(), sun.elevation_rad.to_degrees());
                format!("sun at azimuth {azimuth:.1}°, elevation {elevation:.1}°")
            }
            None => "sun unknown".to_owned(),
        };
        Some(html! {
            @if new_date { h3 { (this) " " span.faint { (sun) } } }
            div.faint { (image.name) @if image.split == Split::Test { ", held out" } }
            div.four {
                @for (address, caption) in addresses.into_iter().zip(PANELS) { (captioned(address, caption)) }
            }
        })
    });
    let shown: Vec<Markup> = shown.collect();
    let body = html! {
        @for view in &shown { (view) }
        @if images.len() > VIEWS_MAX && !shown.is_empty() {
            p.faint { "The first " (VIEWS_MAX) " of " (images.len()) " views; the others are in views/." }
        }
    };
    section("Images by date", body)
}

/// Panels of this width, pixels, that lie side by side in a picture.
pub(super) fn panels(picture: &RgbImage, width: u32) -> Vec<RgbImage> {
    let count = picture.width().checked_div(width).unwrap_or(0);
    let panel = |place| crop_imm(picture, place * width, 0, width, picture.height()).to_image();
    (0..count.min(PANELS.len() as u32)).map(panel).collect()
}

/// Training curves: height error, PSNR, differences to the images and losses by step.
pub(super) fn curves(run: &Folder) -> Markup {
    let curve = run.list("/curve");
    let line = |name: &str, value: &dyn Fn(&Value) -> Option<f64>| {
        let points = curve.iter();
        let points = points.filter_map(|point| Some((point["step"].as_f64()?, value(point)?)));
        Line::new(name, points)
    };
    let chart = |title: &str, drawn: &[Line]| lines(title, "step", &several_points(drawn));
    let height = line("", &|point| point["accuracy"]["height_mae_m"].as_f64());
    let psnr = line("", &|point| point["accuracy"]["psnr_db"].as_f64());
    let difference = [
        line("all pixels, smoothed", &|point| point["l1"].as_f64()),
        line("held-out pixels", &|point| point["held_out_l1"].as_f64()),
    ];
    let mut charts = vec![
        chart("DSM mean absolute error, m", &[height]),
        lines_within("PSNR of held-out images, dB", "step", &[psnr]),
        chart("L1 difference to the images", &difference),
    ];
    let losses = curve.iter().filter_map(|point| point["losses"].as_object());
    let mut names: Vec<&String> = losses.flat_map(|losses| losses.keys()).collect();
    names.sort_unstable();
    names.dedup();
    charts.extend(names.into_iter().map(|name| {
        let loss = line("", &|point| point["losses"].get(name)?.as_f64());
        chart(&format!("Loss: {}", name.replace('_', " ")), &[loss])
    }));
    let charts = html! { @for chart in charts.iter().flatten() { (chart) } };
    gallery("Training", "charts", &charts)
}

/// Lines with at least two points.
fn several_points(lines: &[Line]) -> Vec<Line> {
    lines.iter().filter(|line| line.points.len() > 1).cloned().collect()
}

/// Height errors against truth: distribution, calibration plot of the standard deviations, and errors by class.
pub(super) fn accuracy(run: &Folder, uncertainty: Option<&Uncertainty>) -> Markup {
    // A longer axis would only show that large errors are rare.
    const WORST_M: f64 = 5.0;
    let line = |name: &str, pointer: &str| {
        let quantiles: Vec<f64> = run.list(pointer).iter().filter_map(Value::as_f64).collect();
        let last = quantiles.len().saturating_sub(1).max(1) as f64;
        let numbered = quantiles.into_iter().enumerate();
        let shares = numbered.map(|(i, m)| (m, 100.0 * i as f64 / last));
        Line::new(name, shares.take_while(|(m, _)| *m <= WORST_M))
    };
    let distributions = [
        line("DSM", "/dsm/error_quantiles_m"),
        line("initial surface", "/start/error_quantiles_m"),
    ];
    let drawn = several_points(&distributions);
    let chart = lines("Cells with a smaller height error, %", "height error, m", &drawn);
    let dsm = &run.metrics["dsm"];
    let static_classes = dsm.get("ground_and_buildings").filter(|errors| errors.is_object());
    let static_classes = static_classes.map(|errors| ("static classes (ground, road, building)", errors));
    let classes = dsm["by_class"].as_object().into_iter().flatten();
    let classes = classes.map(|(name, errors)| (name.as_str(), errors));
    let classes: Vec<_> = static_classes.into_iter().chain(classes).collect();
    let body = html! {
        @if chart.is_some() || uncertainty.is_some() {
            div.charts {
                @if let Some(chart) = chart { (chart) }
                @if let Some(uncertainty) = uncertainty { (calibration::draw(uncertainty, |chart| chart.inline())) }
            }
        }
        @if !classes.is_empty() {
            div.wide { table {
                tr { th { "class" } th { "MAE, m" } th { "median, m" } th { "RMSE, m" } th { "within 1 m, %" } th { "beyond 5 m, %" } }
                @for (name, errors) in classes {
                    tr {
                        td { (name) }
                        @for key in ["mae_m", "median_m", "rmse_m"] { td { (number(errors[key].as_f64(), 3)) } }
                        @for key in ["within_1m", "beyond_5m"] { td { (number(errors[key].as_f64().map(|share| 100.0 * share), 1)) } }
                    }
                }
            } }
        }
    };
    section("Accuracy against truth", body)
}

/// Collapsed section about the model: image similarity, training curves, components, time and memory.
pub(super) fn making(run: &Contents) -> Markup {
    let number = |pointer: &str| run.folder.number(pointer);
    html! {
        details {
            summary { "How the model was made" }
            (origin(&run.run.scene, &run.run.preset, run.run.seed, &run.run.version))
            (keys(&[
                ("PSNR of training images", number("/train/psnr"), 2, "dB"),
                ("PSNR of held-out images", number("/test/psnr"), 2, "dB"),
                ("time", run.folder.seconds(), 1, "s"),
                ("peak memory", number("/peak_rss_bytes").map(|b| b / MIB), 0, "MiB"),
                ("Gaussians", number("/gaussians"), 0, ""),
            ]))
            (curves(&run.folder))
            (plan(run))
            (costs(run))
        }
    }
}

/// Components of the model, each with the reason for its use or absence.
fn plan(run: &Contents) -> Markup {
    html! {
        h2 { "Component plan" }
        div.wide { table {
            tr { th { "component" } th.words { "used" } th.words { "reason" } }
            @for item in &run.run.plan {
                tr.off[!item.on] {
                    td { (item.component) }
                    td.words { (if item.on { "yes" } else { "no" }) }
                    td.words { (item.reason) }
                }
            }
        } }
    }
}

/// Row of [`costs_of`]: label, value if known, unit.
pub(super) type Cost<'a> = (&'a str, Option<f64>, &'a str);

/// Table of time and memory, and the configuration as TOML.
pub(super) fn costs_of(rows: &[Cost], configuration: &impl serde::Serialize) -> Markup {
    html! {
        h2 { "Time and memory" }
        div.wide { table {
            @for (label, value, unit) in rows {
                @if let Some(value) = value { tr { td { (label) } td { (plain(*value)) " " (unit) } } }
            }
        } }
        @if let Ok(text) = toml::to_string_pretty(configuration) {
            details { summary { "Configuration and inputs" } pre { (text) } }
        }
    }
}

/// Time and memory of a run of a satellite scene.
fn costs(run: &Contents) -> Markup {
    let number = |pointer: &str| run.folder.number(pointer);
    let mebibytes = |pointer: &str| number(pointer).map(|bytes| bytes / MIB);
    let rows = [
        ("camera bias correction", number("/stages_s/align"), "s"),
        ("plane sweep", number("/stages_s/sweep"), "s"),
        ("initial Gaussians", number("/stages_s/start"), "s"),
        ("training", number("/stages_s/train"), "s"),
        ("total before this page, products included", run.folder.seconds(), "s"),
        ("steps", number("/iterations"), ""),
        ("best step", number("/best_iteration"), ""),
        ("peak memory", mebibytes("/peak_rss_bytes"), "MiB"),
        ("estimated peak memory", mebibytes("/memory_estimate_bytes"), "MiB"),
    ];
    costs_of(&rows, &run.run)
}
