//! `report.html`: a run, or a mosaic of many, on one page that needs nothing else. It is made of what the folder holds, so it can be made
//! again at any time, without the scene.

pub mod mosaic;
pub mod object;
mod parts;

use crate::page::{STYLE, escaped};
use heliosplat_fitting::run_folder::RunError;
use heliosplat_objects::model::is_object_run;
use heliosplat_products::model::{ModelFile, load_file};
use heliosplat_raster::write_atomically;
use heliosplat_satellite::run_file::{RunFile, load_run};
use image::{ImageReader, Limits, RgbImage};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Name of the page.
pub const FILE: &str = "report.html";
/// Longest side of a picture that is read, pixels, and the most memory it may take.
const SIDE_MAX: u32 = 60_000;
const BYTES_MAX: u64 = 400 << 20;

const MORE_STYLE: &str = ".grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,18rem),1fr));gap:1rem}\
figure{margin:0}figure img{width:100%;height:auto;display:block;background:var(--panel)}figcaption{color:var(--faint);font-size:.9em}\
.four{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(45%,13rem),1fr));gap:.5rem;margin:.3rem 0 1.2rem}\
.key{display:grid;grid-template-columns:repeat(auto-fit,minmax(8.5rem,1fr));gap:.6rem;margin:1rem 0}\
.key div{background:var(--panel);padding:.5rem .7rem;border-radius:.4rem}.key b{display:block;font-size:1.25em;font-variant-numeric:tabular-nums}\
.charts{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,24rem),1fr));gap:1rem 2rem}.charts svg{max-width:36rem}\
h1{overflow-wrap:anywhere}h3{margin:.6rem 0 .2rem;font-size:1em}.off{color:var(--faint)}";

/// A folder of pictures, and what was measured there.
struct Folder {
    path: PathBuf,
    metrics: Value,
}

impl Folder {
    /// A folder whose measurements are in the file of this name; it may be absent: a run that was stopped before its measuring has none.
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
        let path = self.path.join(name);
        if !path.is_file() {
            return None;
        }
        let mut reader = ImageReader::open(path).ok()?;
        let mut limits = Limits::default();
        limits.max_image_width = Some(SIDE_MAX);
        limits.max_image_height = Some(SIDE_MAX);
        limits.max_alloc = Some(BYTES_MAX);
        reader.limits(limits);
        reader.decode().ok().map(|picture| picture.to_rgb8())
    }

    fn number(&self, pointer: &str) -> Option<f64> {
        self.metrics.pointer(pointer).and_then(Value::as_f64)
    }

    /// Its own name.
    fn name(&self) -> String {
        let whole = std::fs::canonicalize(&self.path).unwrap_or_else(|_| self.path.clone());
        whole.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }
}

/// What the folder of a run of a satellite scene holds.
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

/// Writes `report.html` into the folder of a run of a satellite scene; returns its path.
///
/// # Errors
/// When the folder holds no run, or the page cannot be written.
pub fn write(folder: &Path) -> Result<PathBuf, RunError> {
    let contents = Contents::read(folder)?;
    save(folder, &page(&contents))
}

/// Writes the page of a finished run that has none, because it was killed between its figures and its page.
///
/// # Errors
/// When the folder holds no run, or the page cannot be written.
pub fn complete(folder: &Path) -> Result<(), RunError> {
    if folder.join(FILE).is_file() {
        return Ok(());
    }
    match is_object_run(folder) {
        true => object::write(folder),
        false => write(folder),
    }
    .map(|_| ())
}

fn save(folder: &Path, page: &str) -> Result<PathBuf, RunError> {
    let path = folder.join(FILE);
    write_atomically(&path, page.as_bytes())?;
    Ok(path)
}

/// A page of some parts.
fn html(title: &str, parts: &[String]) -> String {
    let title = escaped(title);
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
         <title>{title}</title><style>{STYLE}{MORE_STYLE}</style><h1>{title}</h1>{}</html>\n",
        parts.concat()
    )
}

fn page(run: &Contents) -> String {
    let parts = [
        parts::head(run),
        parts::surface(&run.folder),
        parts::views(run),
        parts::curves(&run.folder),
        parts::accuracy(&run.folder),
        parts::plan(run),
        parts::costs(run),
    ];
    html(&run.folder.name(), &parts)
}

#[cfg(test)]
mod tests;
