//! Finished units on an object store: each machine takes the units that it waits for from there, so that machines need
//! no common disk.

use super::BatchError;
use super::plan::Unit;
use super::stamp::{STAMP, Stamp, finished, is_of};
use heliosplat_raster::RasterError;
use heliosplat_raster::bounded::TEXT_MAX;
use heliosplat_raster::virtual_files::{deliver, fetch, read_virtual};
use std::path::{Path, PathBuf};

/// Place of a file of a unit on its store; `None` without a store.
fn place(unit: &Unit, name: &str) -> Option<PathBuf> {
    let to = unit.deliver.as_ref()?;
    Some(PathBuf::from(format!("{to}/{}/{name}", unit.id)))
}

/// Copies the products of a finished unit to its store, its stamp last.
///
/// # Errors
/// When a file cannot be read or written.
pub(super) fn keep(unit: &Unit, folder: &Path, stamp: &Stamp) -> Result<(), RasterError> {
    let names = stamp.outputs.iter().map(|output| output.path.as_str());
    for name in names.chain([STAMP]) {
        if let Some(target) = place(unit, name) {
            deliver(&folder.join(name), &target)?;
        }
    }
    Ok(())
}

/// Stamp of a unit that is finished in the folder `out` or on its store, from where its products are then copied.
///
/// # Errors
/// When a product cannot be copied or is not that of the stamp.
pub(super) fn taken(out: &Path, unit: &Unit) -> Result<Option<Stamp>, BatchError> {
    if let Some(stamp) = finished(out, unit) {
        return Ok(Some(stamp));
    }
    let stored = place(unit, STAMP).and_then(|path| read_virtual(&path, TEXT_MAX));
    let stamp: Option<Stamp> = stored.and_then(|(text, _)| serde_json::from_slice(&text).ok());
    let Some(stamp) = stamp.filter(|stamp| is_of(stamp, unit)) else {
        return Ok(None);
    };
    let folder = out.join(&unit.id);
    for name in stamp.outputs.iter().map(|output| output.path.as_str()).chain([STAMP]) {
        if let Some(source) = place(unit, name) {
            fetch(&source, &folder.join(name))?;
        }
    }
    match finished(out, unit) {
        Some(stamp) => Ok(Some(stamp)),
        None => Err(BatchError::Failed(format!(
            "{}: its products on {} are not those of its stamp; remove them there and run it again",
            unit.id,
            unit.deliver.as_deref().unwrap_or_default()
        ))),
    }
}
