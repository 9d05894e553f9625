//! `sun.html`: a surface under a movable sun, in one file that a browser opens without a server.
//!
//! The page holds the heights, the albedo and the light of a model, and computes the shadows itself (`page/sweep.js`).
//! Its content security policy forbids network access. [`of_run()`], [`of_mosaic()`] and [`of_files()`] gather an
//! [`Exhibit`]; `pack` compresses it, and `document` joins it with the sources of the page.
//!
//! Limits: the page has one height per cell, so bridges and eaves cast shadows as if solid down to the ground. At most
//! 1024² cells are shown; a larger surface is averaged down.

mod document;
mod exhibit;
mod layer;
mod of_files;
mod of_mosaic;
mod of_run;
mod ortho_image;
mod pack;
mod place;

pub use exhibit::{Exhibit, LightTable, TracedDate};
pub use layer::{Layer, Ramp};
pub use of_files::of_files;
pub use of_mosaic::of_mosaic;
pub(crate) use of_run::companions;
pub use of_run::of_run;
pub(crate) use place::GridLocation;

use crate::page::MOSAIC_FILE;
use heliosplat_evaluate::EvaluateError;
use heliosplat_fitting::run_folder::RunError;
use heliosplat_products::relight::RelightError;
use heliosplat_raster::{RasterError, write_atomically};
use std::path::{Path, PathBuf};

/// Name of the page in the folder of a run or of a mosaic.
pub const FILE: &str = "sun.html";

/// Folder, within that of a mosaic of blocks, of its surface model and albedo with larger cells.
pub const OVERVIEW: &str = "overview";

/// Failure to make a page.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// Run on an object, which has no ground and no sun.
    #[error("{}: a run on an object has no ground and no sun; `heliosplat export` and `relight` show it", .0.display())]
    Object(PathBuf),
    /// Surface without a known height: its path or title.
    #[error("{0}: no height of the surface is known, so there is nothing to show")]
    Nothing(String),
    /// Raster without a coordinate reference system.
    #[error("{}: says no coordinate system; the page needs one to place the sun", .0.display())]
    NoCrs(PathBuf),
    /// Unusable run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Model that cannot be relit.
    #[error(transparent)]
    Relight(#[from] RelightError),
    /// Raster that cannot be read, or page that cannot be written.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// Raster that cannot be resampled onto the grid.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
}

impl ViewError {
    /// True if the input of the user is the cause, rather than the machine.
    pub fn is_input_fault(&self) -> bool {
        match self {
            Self::Object(_) | Self::Nothing(_) | Self::NoCrs(_) => true,
            Self::Run(error) => error.is_input_fault(),
            Self::Relight(error) => error.is_input_fault(),
            Self::Raster(error) => error.is_input_fault(),
            Self::Evaluate(error) => error.is_input_fault(),
        }
    }
}

/// Page that was written.
#[derive(Debug, Clone, PartialEq)]
pub struct Written {
    /// Path of the file.
    pub path: PathBuf,
    /// File size, bytes.
    pub bytes: usize,
    /// Columns and rows of the grid shown.
    pub size: (usize, usize),
}

/// Exhibit of the run or of the batch mosaic in a folder.
///
/// # Errors
/// When the folder holds neither or the run of an object, or a file of it cannot be read.
pub fn of_folder(folder: &Path) -> Result<Exhibit, ViewError> {
    if folder.join(MOSAIC_FILE).is_file() {
        return of_mosaic(folder, None);
    }
    if heliosplat_objects::model::is_object_run(folder) {
        return Err(ViewError::Object(folder.to_owned()));
    }
    of_run(folder)
}

/// Writes the page of an exhibit to `path`.
///
/// # Errors
/// When no height is known, or the file cannot be written.
pub fn write(exhibit: &Exhibit, path: &Path) -> Result<Written, ViewError> {
    let exhibit = exhibit.reduced();
    let size = (exhibit.altitude.width, exhibit.altitude.height);
    let page = document::page(&exhibit)?;
    write_atomically(path, page.as_bytes())?;
    let (path, bytes) = (path.to_owned(), page.len());
    Ok(Written { path, bytes, size })
}

/// Writes the page of an exhibit into the folder of its run or mosaic, and returns the exhibit. A surface without known
/// heights gets a warning and no page.
///
/// # Errors
/// The error of `exhibit`, and an error if the page cannot be written.
pub fn into_folder(folder: &Path, exhibit: Result<Exhibit, ViewError>) -> Result<Option<Exhibit>, ViewError> {
    if let Err(error @ ViewError::Nothing(_)) = &exhibit {
        tracing::warn!("no {FILE}: {error}");
        return Ok(None);
    }
    let exhibit = exhibit?;
    write(&exhibit, &folder.join(FILE))?;
    Ok(Some(exhibit))
}

#[cfg(test)]
mod tests;
