//! Page of a run on a capture of an object: held-out images, light components, training curves.

use super::parts::{self, Cost, costs_of, figure, gallery, keys, origin, panels};
use super::{Folder, page_of, save};
use crate::page::{MIB, number, section};
use heliosplat_fitting::run_folder::RunError;
use heliosplat_objects::measure::{file_name, normal_picture, picture};
use heliosplat_objects::model::{self, ObjectModel, components};
use heliosplat_objects::run::{self, ObjectRun};
use heliosplat_scene::Split;
use maud::{Markup, html};
use std::path::{Path, PathBuf};

/// Widest picture, pixels.
const VIEW_PX: u32 = 420;
/// Most held-out images that are shown.
const VIEWS: usize = 16;
/// Number of views whose light components are shown.
const PARTED: usize = 3;

/// Writes `report.html` into the folder of a run on a capture; returns its path.
///
/// # Errors
/// When the folder holds no run, or the page cannot be written.
pub fn write(folder: &Path) -> Result<PathBuf, RunError> {
    let (model, run) = (model::load(folder)?, run::load_run(folder)?);
    of(folder, &model, &run)
}

/// Writes `report.html` of a run that is in memory into `folder`; returns its path.
///
/// # Errors
/// When the metrics are damaged, or the page cannot be written.
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
    save(&folder.join(super::FILE), &page_of(&measured.name(), &sections))
}

fn head(measured: &Folder, run: &ObjectRun) -> Markup {
    let number = |pointer: &str| measured.number(pointer);
    html! {
        (origin(&run.capture, &run.preset, run.seed, &run.version))
        (keys(&[
            ("PSNR of held-out images", number("/test/psnr"), 2, "dB"),
            ("SSIM of held-out images", number("/test/ssim"), 4, ""),
            ("PSNR near training lights", number("/test/near/psnr"), 2, "dB"),
            ("PSNR far from training lights", number("/test/far/psnr"), 2, "dB"),
            ("PSNR of training images", number("/train/psnr"), 2, "dB"),
            ("mean normal error", number("/test/normals/mean_deg"), 1, "°"),
            ("time", measured.seconds(), 1, "s"),
            ("peak memory", number("/peak_rss_bytes").map(|b| b / MIB), 0, "MiB"),
            ("Gaussians", number("/gaussians"), 0, ""),
        ]))
    }
}

/// Held-out images beside their renderings.
fn views(measured: &Folder, model: &ObjectModel) -> Markup {
    let images = model.file.images.iter();
    let held_out: Vec<_> = images.filter(|image| image.split == Split::Test).collect();
    let pairs = held_out.iter().step_by(held_out.len().div_ceil(VIEWS).max(1));
    let figures = html! {
        @for image in pairs {
            @if let Some(pair) = measured.picture(&format!("views/{}.png", file_name(&image.name))) {
                @let captions = [format!("{}: image", image.name), "rendering".to_owned()];
                @for (half, caption) in panels(&pair, pair.width() / 2).into_iter().zip(captions) {
                    (figure(Some(half), VIEW_PX, &caption))
                }
            }
        }
    };
    html! {
        (gallery("Held-out images", "four", &figures))
        @if !figures.0.is_empty() { p.faint { "All are in views/." } }
    }
}

/// Light components and normals of some views.
fn light(model: &ObjectModel) -> Markup {
    let has = model.file.kind.parts();
    let mut parts = components(model);
    parts.retain(|(name, _)| has.contains(name));
    let of_split = |split: Split| model.file.images.iter().filter(move |image| image.split == split);
    let all: Vec<_> = of_split(Split::Test).chain(of_split(Split::Train)).collect();
    // Spread over the held-out views, which come first.
    let step = (of_split(Split::Test).count() / PARTED).max(1);
    let body = html! {
        @for image in all.iter().step_by(step).take(PARTED) {
            h3 { (image.name) }
            div.four {
                (figure(model.render(image).map(|seen| picture(&seen, model)), VIEW_PX, "all light"))
                @for (name, shown) in &parts {
                    (figure(model.render_as(&**shown, image).map(|seen| picture(&seen, model)), VIEW_PX, name))
                }
                (figure(model.normals(image).map(|n| normal_picture(&n)), VIEW_PX, "normals"))
            }
        }
    };
    section("Light components", body)
}

/// Chosen model, and the short fits behind the choice.
fn plan(run: &ObjectRun) -> Markup {
    let Some(plan) = &run.plan else { return html! {} };
    let kind = serde_json::to_value(plan.kind).unwrap_or_default();
    let yes = |on: bool| if on { "yes" } else { "no" };
    html! {
        h2 { "Component plan" }
        p { (plan.reason) }
        div.wide { table {
            tr { td { "model" } td { (kind.as_str().unwrap_or("")) } }
            tr { td { "specular reflection" } td { (yes(plan.parts.specular)) } }
            tr { td { "subsurface scattering" } td { (yes(plan.parts.scattering)) } }
        } }
        @if !plan.trials.is_empty() {
            div.wide { table {
                tr {
                    th { "short fits with and without" } th { "PSNR without, dB" } th { "with" } th { "gain" }
                    th { "time of a step" } th { "numbers per Gaussian" } th { "decision" }
                }
                @for trial in &plan.trials { tr {
                    td { (trial.part) }
                    td { (number(Some(trial.without_db), 2)) }
                    td { (number(Some(trial.with_db), 2)) }
                    td { (trial.gain.map(|gain| gain.in_words()).unwrap_or_default()) }
                    td { "× " (number(Some(trial.step_time_ratio), 2)) }
                    td { (format!("{:+}", trial.numbers_per_gaussian)) }
                    td { (if trial.taken { "taken" } else { "left out" }) }
                } }
            } }
        }
    }
}

fn costs(measured: &Folder, run: &ObjectRun) -> Markup {
    let number = |pointer: &str| measured.number(pointer);
    let rows: [Cost; 5] = [
        ("initial Gaussians", number("/stage_seconds/start"), "s"),
        ("training", number("/stage_seconds/train"), "s"),
        ("total before this page, evaluation included", measured.seconds(), "s"),
        ("steps", number("/iterations"), ""),
        ("peak memory", number("/peak_rss_bytes").map(|b| b / MIB), "MiB"),
    ];
    costs_of(&rows, run)
}
