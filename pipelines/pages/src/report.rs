//! `report.html`: a run, or a mosaic of many, on one page that fetches nothing.
//!
//! It is made from the files in the folder alone, so that it can be made again at any time, without the scene.

mod change;
pub mod mosaic;
pub mod object;
mod parts;
mod relit;

use crate::page::{calibration, document, picture_of};
use crate::view::{self, ViewError};
use heliosplat::timeline::{self, concurrently, stage};
use heliosplat_evaluate::uncertainty::Uncertainty;
use heliosplat_fitting::run_folder::{RunError, save_metrics};
use heliosplat_objects::model::is_object_run;
use heliosplat_products::model::{ModelFile, load_file};
use heliosplat_raster::write_atomically;
use heliosplat_satellite::run_file::{RunFile, load_run};
use image::RgbImage;
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Name of the page.
pub const FILE: &str = "report.html";
/// Name of the calibration plot of runs with truth.
const CALIBRATION: &str = "calibration.svg";

/// The stage of a run in which its pages are written.
const PAGES: &str = "report";

/// A folder of pictures with its metrics.
struct Folder {
    path: PathBuf,
    metrics: Value,
}

impl Folder {
    /// A folder whose metrics are in the file of this name. It may be absent: a run that was stopped early has none.
    fn read(path: &Path, metrics: &str) -> Result<Self, RunError> {
        let file = path.join(metrics);
        let metrics = match heliosplat_raster::bounded::read_text(&file) {
            Ok(text) => serde_json::from_str(&text).map_err(|error| RunError::Damaged {
                path: file,
                reason: error.to_string(),
            })?,
            Err(_) => Value::Null,
        };
        Ok(Self {
            path: path.to_owned(),
            metrics,
        })
    }

    /// A picture, if it is there and of a size that can be shown.
    fn picture(&self, name: &str) -> Option<RgbImage> {
        picture_of(&self.path.join(name))
    }

    fn number(&self, pointer: &str) -> Option<f64> {
        self.metrics.pointer(pointer).and_then(Value::as_f64)
    }

    /// Seconds of the run before its pages were written: what these can say, then and again later.
    fn seconds(&self) -> Option<f64> {
        Some(self.number("/seconds")? - pages_s(&self.metrics))
    }

    /// An array of the metrics; empty where it is absent.
    fn list(&self, pointer: &str) -> &[Value] {
        let list = self.metrics.pointer(pointer).and_then(Value::as_array);
        list.map_or(&[], Vec::as_slice)
    }

    /// Its own name.
    fn name(&self) -> String {
        let whole = std::fs::canonicalize(&self.path).unwrap_or_else(|_| self.path.clone());
        whole.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }
}

/// The folder of a run of a satellite scene.
struct Contents {
    folder: Folder,
    run: RunFile,
    model: ModelFile,
}

impl Contents {
    fn read(folder: &Path) -> Result<Self, RunError> {
        Ok(Self {
            run: load_run(folder)?,
            model: load_file(folder)?,
            folder: Folder::read(folder, "metrics.json")?,
        })
    }
}

/// Writes `report.html` into the folder of a run of a satellite scene, and `calibration.svg` where its DSM states standard
/// deviations and was compared with truth; returns the path of the page.
///
/// # Errors
/// When the folder holds no run, or a file cannot be written.
pub fn write(folder: &Path) -> Result<PathBuf, RunError> {
    let contents = Contents::read(folder)?;
    let sections = sections(&contents)?;
    // Last: where it is, the pictures are complete.
    save(folder, &page(&contents, sections))
}

/// Writes the pages of a run of a satellite scene that was trained now: `sun.html`, then `report.html`, which links it.
///
/// # Errors
/// When the folder holds no run, or a file cannot be written.
pub fn write_both(folder: &Path) -> Result<(), ViewError> {
    let contents = Contents::read(folder)?;
    // Only the head of the page asks whether the other one is there.
    let (sections, shown) = concurrently(
        || sections(&contents),
        || view::into_folder(folder, view::of_run(folder)),
    );
    shown?;
    save(folder, &page(&contents, sections?))?;
    Ok(())
}

/// Seconds that the pages took, as far as `metrics` say.
fn pages_s(metrics: &Value) -> f64 {
    let stages = metrics["timeline"].as_array().map_or(&[][..], Vec::as_slice);
    let pages = stages.iter().filter(|stage| stage["stage"] == PAGES);
    pages.filter_map(|stage| stage["wall_s"].as_f64()).sum()
}

/// Writes the pages of a run that was trained now by `write`, and adds the time that they took to its `metrics`, in memory and in its folder.
///
/// # Errors
/// The error of `write`, and an error if the metrics cannot be written.
pub fn add_report<T, E: From<RunError>>(
    folder: &Path,
    metrics: &mut Value,
    write: impl FnOnce() -> Result<T, E>,
) -> Result<(), E> {
    {
        let _part = stage(PAGES);
        write()?;
    }
    let pages = serde_json::to_value(timeline::take()).unwrap_or_default();
    if let (Value::Array(stages), Value::Array(pages)) = (&mut metrics["timeline"], pages) {
        stages.extend(pages);
    }
    if let Some(before_s) = metrics["seconds"].as_f64() {
        metrics["seconds"] = (before_s + pages_s(metrics)).into();
    }
    Ok(save_metrics(folder, metrics)?)
}

/// Writes the pages of a finished run that has none because it was killed after its metrics were written.
///
/// # Errors
/// When the folder holds no run, or the page cannot be written.
pub fn complete(folder: &Path) -> Result<(), ViewError> {
    if folder.join(FILE).is_file() {
        return Ok(());
    }
    match is_object_run(folder) {
        true => object::write(folder).map(|_| ())?,
        false => write_both(folder)?,
    }
    Ok(())
}

fn save(folder: &Path, page: &str) -> Result<PathBuf, RunError> {
    let path = folder.join(FILE);
    write_atomically(&path, page.as_bytes())?;
    Ok(path)
}

/// A page of some sections.
fn page_of(title: &str, sections: &[Markup]) -> String {
    document(title, &html! { @for section in sections { (section) } })
}

/// Sections below the head of the page; also draws the calibration plot.
fn sections(run: &Contents) -> Result<Vec<Markup>, RunError> {
    let uncertainty = &run.folder.metrics["dsm"]["uncertainty"];
    if let Ok(uncertainty) = Uncertainty::deserialize(uncertainty) {
        let path = run.folder.path.join(CALIBRATION);
        write_atomically(&path, calibration::picture(&uncertainty).as_bytes())?;
    }
    Ok(vec![
        parts::surface(&run.folder),
        parts::views(run),
        change::changes(run),
        relit::relit(&run.folder),
        parts::curves(&run.folder),
        parts::accuracy(&run.folder),
        parts::plan(run),
        parts::costs(run),
    ])
}

fn page(run: &Contents, mut sections: Vec<Markup>) -> String {
    sections.insert(0, parts::head(run));
    page_of(&run.folder.name(), &sections)
}

#[cfg(test)]
mod tests;
