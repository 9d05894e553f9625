//! Finished units on an object store: each machine takes the units that it waits for from there, so that machines need
//! no common disk.

use super::BatchError;
use super::plan::Unit;
use super::stamp::{Output, STAMP, Stamp, finished, is_of};
use heliosplat_raster::RasterError;
use heliosplat_raster::bounded::TEXT_MAX;
use heliosplat_raster::virtual_files::{deliver, fetch, read_virtual};
use std::path::{Path, PathBuf};

/// Place of a file of a unit on its store; `None` without a store.
fn place(unit: &Unit, name: &str) -> Option<PathBuf> {
    let to = unit.deliver.as_ref()?;
    Some(PathBuf::from(format!("{to}/{}/{name}", unit.id)))
}

/// Copies the products of a unit to its store, and last the stamp from its own `file`.
///
/// # Errors
/// When a file cannot be read or written.
pub(super) fn keep(unit: &Unit, folder: &Path, stamp: &Stamp, file: &Path) -> Result<(), RasterError> {
    let products = stamp.outputs.iter().map(|output| output.path.as_str());
    let products = products.map(|name| (folder.join(name), name));
    for (source, name) in products.chain([(file.to_owned(), STAMP)]) {
        if let Some(target) = place(unit, name) {
            deliver(&source, &target)?;
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
    let take = |name: &str| place(unit, name).map_or(Ok(()), |source| fetch(&source, &folder.join(name)));
    for output in &stamp.outputs {
        take(&output.path)?;
        if Output::of(&folder, &output.path)? != *output {
            return Err(BatchError::Failed(format!(
                "{}/{}: it is not the file of its stamp; remove {STAMP} beside it and run the unit again",
                unit.deliver.as_deref().unwrap_or_default(),
                Path::new(&unit.id).join(&output.path).display()
            )));
        }
    }
    take(STAMP)?;
    Ok(finished(out, unit))
}
