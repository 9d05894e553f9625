//! `report.html`: a run or a mosaic on one page that loads nothing from the network.
//!
//! The page is made from the files in the folder, so that it can be made again without the scene.

mod change;
pub mod mosaic;
pub mod object;
mod parts;
mod relit;
mod surface;

use crate::page::{calibration, document, picture_of};
use crate::view::{self, Exhibit, ViewError};
use heliosplat::timeline::{self, stage};
use heliosplat_evaluate::uncertainty::Uncertainty;
use heliosplat_fitting::run_folder::{RunError, save_metrics};
use heliosplat_objects::model::is_object_run;
use heliosplat_products::model::{ModelFile, load_file};
use heliosplat_products::set::date_of;
use heliosplat_raster::write_atomically;
use heliosplat_satellite::run_file::{RunFile, load_run};
use image::RgbImage;
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Name of the page in the folder of a run or of a mosaic.
pub const FILE: &str = "report.html";
/// Name of the calibration plot of runs with truth.
const CALIBRATION: &str = "calibration.svg";

/// Stage of a run that writes its pages, in its timeline.
const PAGES: &str = "report";

/// Folder with pictures and metrics.
struct Folder {
    path: PathBuf,
    metrics: Value,
}

impl Folder {
    /// Reads the metrics of a folder from the file of this name; null if it is absent, as in a run that was stopped
    /// early.
    fn read(path: &Path, metrics: &str) -> Result<Self, RunError> {
        let file = path.join(metrics);
        let metrics = match heliosplat_raster::bounded::read_text(&file) {
            Ok(text) => serde_json::from_str(&text).map_err(|error| RunError::Damaged(file, error.to_string()))?,
            Err(_) => Value::Null,
        };
        let path = path.to_owned();
        Ok(Self { path, metrics })
    }

    /// Reads a picture; `None` if it is absent, damaged or too large.
    fn picture(&self, name: &str) -> Option<RgbImage> {
        picture_of(&self.path.join(name))
    }

    fn number(&self, pointer: &str) -> Option<f64> {
        self.metrics.pointer(pointer).and_then(Value::as_f64)
    }

    /// Seconds of the run without its pages, so that a page that is made again states the same time.
    fn seconds(&self) -> Option<f64> {
        Some(self.number("/seconds")? - pages_s(&self.metrics))
    }

    /// An array of the metrics; empty where it is absent.
    fn list(&self, pointer: &str) -> &[Value] {
        let list = self.metrics.pointer(pointer).and_then(Value::as_array);
        list.map_or(&[], Vec::as_slice)
    }

    /// Name of the folder.
    fn name(&self) -> String {
        let whole = std::fs::canonicalize(&self.path).unwrap_or_else(|_| self.path.clone());
        whole.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }
}

/// Files of a run of a satellite scene.
struct Contents {
    folder: Folder,
    run: RunFile,
    model: ModelFile,
}

impl Contents {
    fn read(folder: &Path) -> Result<Self, RunError> {
        let (run, model) = (load_run(folder)?, load_file(folder)?);
        let folder = Folder::read(folder, "metrics.json")?;
        Ok(Self { folder, run, model })
    }
}

/// Writes the pages of a run of a satellite scene: `sun.html`, then `report.html`, which links to it, and
/// `calibration.svg` if its DSM states standard deviations and was compared with truth. Returns the path of the report.
///
/// # Errors
/// When the folder holds no run, or a file cannot be written.
pub fn write(folder: &Path) -> Result<PathBuf, ViewError> {
    let contents = Contents::read(folder)?;
    let shown = view::into_folder(folder, view::of_run(folder))?;
    // Written last, so that its presence means that the other pages are complete.
    Ok(save(&folder.join(FILE), &page(&contents, shown.as_ref())?)?)
}

/// Writes the page of a surface model of any source beside its file, `x.html` for `x.tif`, and returns its path.
///
/// # Errors
/// When the file cannot be read or has no coordinate reference system, or the page cannot be written.
pub fn write_of_file(dsm: &Path) -> Result<PathBuf, ViewError> {
    let mut exhibit = view::of_files(dsm, None)?;
    exhibit.layers = view::companions(dsm, &exhibit)?;
    let path = dsm.parent().unwrap_or(Path::new("")).to_owned();
    let folder = Folder {
        path,
        metrics: Value::Null,
    };
    let head = surface::head(&folder, &exhibit, &[]);
    let body = [head, surface::maps(&exhibit, &html! {})];
    Ok(save(&dsm.with_extension("html"), &page_of(&exhibit.title, &body))?)
}

/// Seconds in which the pages were written, from the timeline in `metrics`; 0 if it has none.
fn pages_s(metrics: &Value) -> f64 {
    let stages = metrics["timeline"].as_array().map_or(&[][..], Vec::as_slice);
    let pages = stages.iter().filter(|stage| stage["stage"] == PAGES);
    pages.filter_map(|stage| stage["wall_s"].as_f64()).sum()
}

/// Calls `write` to write the pages of a run that was just trained, and adds their time to its `metrics`, in memory
/// and in `folder`.
///
/// # Errors
/// The error of `write`, and an error if the metrics cannot be written.
pub fn add_report<T, E: From<RunError>>(
    folder: &Path,
    metrics: &mut Value,
    write: impl FnOnce() -> Result<T, E>,
) -> Result<(), E> {
    let part = stage(PAGES);
    write()?;
    drop(part);
    let pages = serde_json::to_value(timeline::take()).unwrap_or_default();
    if let (Value::Array(stages), Value::Array(pages)) = (&mut metrics["timeline"], pages) {
        stages.extend(pages);
    }
    if let Some(before_s) = metrics["seconds"].as_f64() {
        metrics["seconds"] = (before_s + pages_s(metrics)).into();
    }
    Ok(save_metrics(folder, metrics)?)
}

/// Writes the pages of a finished run without a report, which was killed after its metrics were written.
///
/// # Errors
/// When the folder holds no run, or the page cannot be written.
pub fn complete(folder: &Path) -> Result<(), ViewError> {
    if folder.join(FILE).is_file() {
        return Ok(());
    }
    match is_object_run(folder) {
        true => Ok(object::write(folder).map(drop)?),
        false => write(folder).map(drop),
    }
}

fn save(path: &Path, page: &str) -> Result<PathBuf, RunError> {
    write_atomically(path, page.as_bytes())?;
    Ok(path.to_owned())
}

/// Document of some sections.
fn page_of(title: &str, sections: &[Markup]) -> String {
    document(title, &html! { @for section in sections { (section) } })
}

/// Dates of the images, and the key figures of the surface and its accuracy.
fn head(run: &Contents, shown: Option<&Exhibit>) -> Markup {
    let measured = &run.folder;
    let protocol = measured.metrics.pointer("/dsm/protocol").and_then(Value::as_str);
    let mae = format!("mean absolute height error, {}", protocol.unwrap_or("raw"));
    let number = |pointer: &str| measured.number(pointer);
    let percent = |pointer: &str| number(pointer).map(|share| 100.0 * share);
    let mut dates: Vec<String> = run.model.images.iter().map(date_of).collect();
    let images = dates.len();
    dates.sort_unstable();
    dates.dedup();
    let more = [
        (mae.as_str(), number("/dsm/mae_m"), 3, "m"),
        ("median height error", number("/dsm/median_m"), 3, "m"),
        ("of the truth's cells known", percent("/dsm/completeness"), 1, "%"),
        ("shadow accuracy", percent("/shadow/accuracy"), 1, "%"),
    ];
    html! {
        p.faint {
            (images) " images"
            @if let ([first, .., last], true) = (&dates[..], run.model.images.iter().any(|image| image.time.is_some())) {
                " on " (dates.len()) " dates from " (first) " to " (last)
            } @else if let [date] = &dates[..] { ", " (date) }
        }
        @match shown {
            Some(shown) => (surface::head(measured, shown, &more)),
            None => (parts::keys(&more)),
        }
    }
}

/// Report of a run; also writes the calibration plot into its folder.
fn page(run: &Contents, shown: Option<&Exhibit>) -> Result<String, RunError> {
    let folder = &run.folder;
    let uncertainty = Uncertainty::deserialize(&folder.metrics["dsm"]["uncertainty"]).ok();
    if let Some(uncertainty) = &uncertainty {
        let drawn = calibration::draw(uncertainty, |chart| chart.file());
        write_atomically(&folder.path.join(CALIBRATION), drawn.as_bytes())?;
    }
    let sections = [
        head(run, shown),
        html! { @if let Some(shown) = shown { (surface::maps(shown, &html! {})) } },
        parts::lowered(folder),
        surface::files(folder),
        change::changes(run),
        parts::accuracy(folder, uncertainty.as_ref()),
        relit::relit(folder),
        parts::views(run),
        parts::making(run),
    ];
    let title = shown.map_or_else(|| folder.name(), |shown| shown.title.clone());
    Ok(page_of(&title, &sections))
}

#[cfg(test)]
mod tests;
