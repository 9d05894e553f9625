//! What a run is worth: images, shadows and surface against what the scene knows of the truth.

use super::fit::Fitted;
use crate::cli::CliError;
use crate::evaluate::shadow::ShadowCounts;
use crate::evaluate::{DsmEvaluation, ImageScore, Protocol, error_map, evaluate_dsm};
use crate::product::views::{render_view, score, shadow_counts};
use crate::raster::{RasterFile, preview};
use crate::run::{LoadedModel, peak_rss_bytes};
use crate::scene::{Scene, Split};
use heliosplat::Raster;
use serde_json::{Value, json};
use std::path::Path;

/// The run's `dsm.tif` against the scene's true one; `None` without truth.
pub(super) fn dsm(scene: &Scene, run: &Path, protocol: Protocol) -> Result<Option<DsmEvaluation>, CliError> {
    let Some(truth) = &scene.truth.dsm else { return Ok(None) };
    Ok(Some(evaluate_dsm(
        &run.join("dsm.tif"),
        truth,
        scene.truth.classes.as_deref(),
        protocol,
    )?))
}

/// `metrics.json` as far as it follows from model and scene; also draws pictures into the run's folder.
pub(super) fn metrics(scene: &Scene, model: &LoadedModel, run: &Path, protocol: Protocol) -> Result<Value, CliError> {
    let mut out = json!({ "gaussians": model.parameters.gaussians.count });
    if let Some(evaluation) = dsm(scene, run, protocol)? {
        out["dsm"] = serde_json::to_value(&evaluation.metrics).unwrap_or_default();
        preview::write_png(&run.join("error.png"), &error_map::draw(&evaluation.errors))?;
    }
    let (mut train, mut test) = (Vec::new(), Vec::new());
    let mut shadows = ShadowCounts::default();
    let mut colour = None;
    for known in &model.file.images {
        let Some(image) = scene.images.iter().find(|i| i.name == known.name) else {
            continue;
        };
        let truth = known.crop.cut(&image.pixels);
        let held_out = known.split == Split::Test;
        let rendered = render_view(model, known, Some(&truth));
        if let Some(score) = score(&rendered, &truth, held_out) {
            if held_out {
                colour = Some(rendered.colour);
                test.push(score);
            } else {
                train.push(score);
            }
        }
        if let (false, Some((_, path))) = (
            held_out,
            scene.truth.shadows.iter().find(|(name, _)| *name == known.name),
        ) {
            let mask = RasterFile::open(path)?.read_all()?;
            shadows.add(shadow_counts(&rendered, &known.crop, &mask));
        }
        draw(run, &known.name, &truth, &rendered.image, &rendered.visibility)?;
    }
    let mean = |scores: &[ImageScore], pick: fn(&ImageScore) -> f64| {
        scores.iter().map(pick).sum::<f64>() / scores.len().max(1) as f64
    };
    if !train.is_empty() {
        out["train"] = json!({"psnr": mean(&train, |s| s.psnr), "ssim": mean(&train, |s| s.ssim)});
    }
    if !test.is_empty() {
        out["test"] = json!({"psnr": mean(&test, |s| s.psnr), "ssim": mean(&test, |s| s.ssim), "colour": colour});
    }
    if let Some(score) = shadows.score().filter(|_| !scene.truth.shadows.is_empty()) {
        out["shadow"] = serde_json::to_value(score).unwrap_or_default();
    }
    Ok(out)
}

/// The image, its rendering, and the shadows over the image, side by side.
fn draw(run: &Path, name: &str, truth: &Raster, rendered: &Raster, visibility: &Raster) -> Result<(), CliError> {
    let folder = run.join("views");
    std::fs::create_dir_all(&folder)
        .map_err(|error| CliError::Failed(format!("{}: the folder cannot be made ({error})", folder.display())))?;
    let left = preview::stretched(truth);
    let middle = preview::stretched(rendered);
    let mut right = left.clone();
    let mut shadow = visibility.clone();
    shadow.values.iter_mut().for_each(|v| *v = 1.0 - *v);
    preview::overlay(&mut right, &shadow, [40, 80, 255]);
    let (width, height) = left.dimensions();
    let picture = image::RgbImage::from_fn(width * 3, height, |col, row| {
        *[&left, &middle, &right][(col / width) as usize].get_pixel(col % width, row)
    });
    Ok(preview::write_png(&folder.join(format!("{name}.png")), &picture)?)
}

/// Hillshade of the surface that training started from, to compare.
pub(super) fn write_start(run: &Path, fitted: &Fitted, model: &LoadedModel) -> Result<(), CliError> {
    let surface = &fitted.surface;
    let raster = Raster {
        width: surface.width,
        height: surface.height,
        bands: 1,
        values: surface.altitude.clone(),
    };
    Ok(preview::write_png(
        &run.join("start.png"),
        &preview::hillshade(&raster, model.file.gsd_m),
    )?)
}

/// Adds what only the fit knows.
pub(super) fn add_fit(metrics: &mut Value, fitted: &Fitted, model: &LoadedModel, seconds: f64) {
    let [align, sweep, start, train] = fitted.seconds;
    metrics["seconds"] = json!(seconds);
    metrics["stages_s"] = json!({"align": align, "sweep": sweep, "start": start, "train": train});
    metrics["iterations"] = json!(fitted.early_stop.steps);
    metrics["best_iteration"] = json!(fitted.early_stop.best_step);
    metrics["rejected_steps"] = json!(fitted.rejected);
    metrics["gaussians"] = json!(model.parameters.gaussians.count);
    metrics["peak_rss_bytes"] = json!(peak_rss_bytes());
    metrics["shifts_px"] = json!(fitted.shifts_px);
    metrics["curve"] = json!(fitted.curve);
}

/// The main numbers for people.
pub(super) fn summary(metrics: &Value) -> String {
    let number = |pointer: &str| metrics.pointer(pointer).and_then(Value::as_f64);
    let mut lines = Vec::new();
    let protocol = metrics
        .pointer("/dsm/protocol")
        .and_then(Value::as_str)
        .unwrap_or("raw");
    let mut say = |label: &str, value: Option<f64>, unit: &str| {
        if let Some(value) = value {
            lines.push(format!("{label:<14} {value:.3} {unit}"));
        }
    };
    say("DSM MAE", number("/dsm/mae_m"), &format!("m ({protocol})"));
    say("DSM median", number("/dsm/median_m"), &format!("m ({protocol})"));
    say("shadow BER", number("/shadow/ber").map(|b| 100.0 * b), "%");
    say("shadows right", number("/shadow/accuracy").map(|a| 100.0 * a), "%");
    say("PSNR train", number("/train/psnr"), "dB");
    say(
        "PSNR held out",
        number("/test/psnr"),
        "dB (colour fitted on the left half, scored on the right)",
    );
    say("time", number("/seconds"), "s");
    say(
        "memory",
        number("/peak_rss_bytes").map(|b| b / f64::from(1 << 20)),
        "MiB at most",
    );
    if let Some(count) = metrics["gaussians"].as_u64() {
        lines.push(format!("{:<14} {count}", "Gaussians"));
    }
    lines.join("\n")
}
