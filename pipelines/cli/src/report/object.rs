//! The page of a run on a capture of an object: its held-out images, the parts of its light, how training went.

use super::parts::{self, Cost, MIB, costs_of, figure, keys};
use super::{Folder, html, save};
use crate::page::escaped;
use heliosplat_fitting::run_folder::RunError;
use heliosplat_objects::measure::{file_name, normal_picture, picture};
use heliosplat_objects::model::{self, ObjectModel, components};
use heliosplat_objects::run::{self, ObjectRun};
use heliosplat_scene::Split;
use image::imageops::crop_imm;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Widest picture, pixels.
const VIEW_PX: u32 = 420;
/// Most images held out that are shown beside what the model shows.
const VIEWS: usize = 16;
/// Views whose light is shown part by part.
const PARTED: usize = 3;

/// Writes `report.html` into the folder of a run on a capture; returns its path.
///
/// # Errors
/// When the folder holds no run, or the page cannot be written.
pub fn write(folder: &Path) -> Result<PathBuf, RunError> {
    let (model, run) = (model::load(folder)?, run::load_run(folder)?);
    of(folder, &model, &run)
}

/// The same of a run that is at hand.
///
/// # Errors
/// When the page cannot be written.
pub fn of(folder: &Path, model: &ObjectModel, run: &ObjectRun) -> Result<PathBuf, RunError> {
    let measured = Folder::read(folder, "metrics.json")?;
    let sections = [
        head(&measured, run),
        views(&measured, model),
        light(model),
        parts::curves(&measured),
        plan(run),
        costs(&measured, run),
    ];
    save(folder, &html(&measured.name(), &sections))
}

fn head(measured: &Folder, run: &ObjectRun) -> String {
    let number = |pointer: &str| measured.number(pointer);
    let said = format!(
        "<p class=\"faint\">{} · preset {} · seed {} · heliosplat {}</p>",
        escaped(&run.capture.display().to_string()),
        escaped(&run.preset),
        run.seed,
        escaped(&run.version)
    );
    said + &keys(&[
        ("PSNR of images held out", number("/test/psnr"), 2, "dB"),
        ("SSIM of images held out", number("/test/ssim"), 4, ""),
        ("PSNR near lights of training", number("/test/near/psnr"), 2, "dB"),
        ("PSNR far from them", number("/test/far/psnr"), 2, "dB"),
        ("PSNR of images trained on", number("/train/psnr"), 2, "dB"),
        ("normals off in the mean", number("/test/normals/mean_deg"), 1, "°"),
        ("time", number("/seconds"), 1, "s"),
        ("memory at most", number("/peak_rss_bytes").map(|b| b / MIB), 0, "MiB"),
        ("Gaussians", number("/gaussians"), 0, ""),
    ])
}

/// Images held out beside what the model shows in their place.
fn views(measured: &Folder, model: &ObjectModel) -> String {
    let images = model.file.images.iter();
    let held_out: Vec<_> = images.filter(|image| image.split == Split::Test).collect();
    let mut out = String::new();
    for image in held_out.iter().step_by(held_out.len().div_ceil(VIEWS).max(1)) {
        let name = file_name(&image.name);
        let Some(pair) = measured.picture(&format!("views/{name}.png")) else {
            continue;
        };
        let half = pair.width() / 2;
        let part = |left: u32| Some(crop_imm(&pair, left, 0, half, pair.height()).to_image());
        out += &figure(part(0), VIEW_PX, &format!("{}: image", image.name));
        out += &figure(part(half), VIEW_PX, "rendering");
    }
    if out.is_empty() {
        return out;
    }
    format!("<h2>Images held out</h2><div class=\"four\">{out}</div><p class=\"faint\">All are in views/.</p>")
}

/// The parts of the light and the normals of some views.
fn light(model: &ObjectModel) -> String {
    let has = model.file.kind.parts();
    let mut parts = components(model);
    parts.retain(|(name, _)| has.contains(name));
    let of_split = |split: Split| model.file.images.iter().filter(move |image| image.split == split);
    let all: Vec<_> = of_split(Split::Test).chain(of_split(Split::Train)).collect();
    let mut out = String::new();
    // Spread over those held out, which come first.
    let step = (of_split(Split::Test).count() / PARTED).max(1);
    for image in all.iter().step_by(step).take(PARTED) {
        let mut row = figure(
            model.render(image).map(|seen| picture(&seen, model)),
            VIEW_PX,
            "all light",
        );
        for (name, shown) in &parts {
            let seen = model.render_as(&**shown, image);
            row += &figure(seen.map(|seen| picture(&seen, model)), VIEW_PX, name);
        }
        row += &figure(model.normals(image).map(|n| normal_picture(&n)), VIEW_PX, "normals");
        // Writing to a String cannot fail.
        let _ = write!(out, "<h3>{}</h3><div class=\"four\">{row}</div>", escaped(&image.name));
    }
    format!("<h2>What it is made of</h2>{out}")
}

/// Which model was taken, and what was tried.
fn plan(run: &ObjectRun) -> String {
    let Some(plan) = &run.plan else { return String::new() };
    let kind = serde_json::to_value(plan.kind).unwrap_or_default();
    let yes = |on: bool| if on { "yes" } else { "no" };
    let mut out = format!(
        "<h2>Component plan</h2><p>{}</p><div class=\"wide\"><table><tr><td>model<td>{}</tr><tr><td>glossy<td>{}</tr>\
         <tr><td>light under the surface<td>{}</tr></table></div>",
        escaped(&plan.reason),
        escaped(kind.as_str().unwrap_or("")),
        yes(plan.specular),
        yes(plan.scattering)
    );
    if !plan.trials.is_empty() {
        out += "<div class=\"wide\"><table><tr><th>tried in a short fit<th>PSNR dB</tr>";
        for trial in &plan.trials {
            let _ = write!(out, "<tr><td>{}<td>{:.2}</tr>", escaped(&trial.what), trial.psnr_db);
        }
        out += "</table></div>";
    }
    out
}

fn costs(measured: &Folder, run: &ObjectRun) -> String {
    let number = |pointer: &str| measured.number(pointer);
    let rows: [Cost; 5] = [
        ("start", number("/stage_seconds/start"), "s"),
        ("training", number("/stage_seconds/train"), "s"),
        ("all, measuring included", number("/seconds"), "s"),
        ("steps", number("/iterations"), ""),
        ("memory used at most", number("/peak_rss_bytes").map(|b| b / MIB), "MiB"),
    ];
    costs_of(&rows, run)
}
