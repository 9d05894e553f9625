//! Finished units on an object store: each machine takes the units that it waits for from there, so that machines need
//! no common disk.

use super::plan::Unit;
use super::stamp::{Output, STAMP, Stamp, finished, is_of};
use super::{BatchError, Result};
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
pub(super) fn taken(out: &Path, unit: &Unit) -> Result<Option<Stamp>> {
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
            let (to, id, path) = (unit.deliver.as_deref().unwrap_or_default(), &unit.id, &output.path);
            return Err(BatchError::Failed(format!(
                "{to}/{id}/{path}: it is not the file of its stamp; remove {STAMP} beside it and run the unit again"
            )));
        }
    }
    take(STAMP)?;
    Ok(finished(out, unit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Work;
    use serde_json::Value;

    #[test]
    fn a_unit_comes_from_its_store_whole_or_not_at_all() {
        let [here, there] = [(); 2].map(|()| tempfile::tempdir().expect("a temporary folder"));
        let unit = Unit {
            id: "a/b/c/tile-r0c0".into(),
            work: Work::Refused { reason: String::new() },
            after: Vec::new(),
            mem_mb: 1,
            runtime_s: 1,
            key: "k".into(),
            deliver: Some("/vsimem/store_test".into()),
        };
        assert!(
            taken(there.path(), &unit).expect("readable").is_none(),
            "nothing is stored"
        );
        let folder = here.path().join(&unit.id);
        std::fs::create_dir_all(&folder).expect("made");
        std::fs::write(folder.join("dsm.tif"), b"product").expect("written");
        let stamp = Stamp {
            unit: unit.id.clone(),
            key: unit.key.clone(),
            build: "b".into(),
            outputs: vec![Output::of(&folder, "dsm.tif").expect("readable")],
            seconds: 1.0,
            peak_rss_bytes: 1,
            metrics: Value::Null,
        };
        let file = here.path().join("stamp.json");
        std::fs::write(&file, serde_json::to_string(&stamp).expect("JSON")).expect("written");
        keep(&unit, &folder, &stamp, &file).expect("stored");
        let other = Unit {
            key: "other".into(),
            ..unit.clone()
        };
        assert!(taken(there.path(), &other).expect("readable").is_none(), "other inputs");
        assert_eq!(taken(there.path(), &unit).expect("readable"), Some(stamp));
        assert_eq!(
            std::fs::read(there.path().join(&unit.id).join("dsm.tif")).expect("a copy"),
            b"product"
        );
        // Other content of the same size on the store.
        std::fs::write(&file, b"changed").expect("written");
        deliver(&file, &place(&unit, "dsm.tif").expect("a store")).expect("stored");
        let elsewhere = tempfile::tempdir().expect("a temporary folder");
        let refused = taken(elsewhere.path(), &unit).expect_err("not the product").to_string();
        assert!(refused.contains("not the file of its stamp"), "{refused}");
        assert!(finished(elsewhere.path(), &unit).is_none());
    }
}
