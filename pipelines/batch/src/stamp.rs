//! Stamps of finished units, with a key of their inputs.

use super::plan::Unit;
use heliosplat_fitting::lock::Lock;
use heliosplat_fitting::program::build;
use heliosplat_fitting::run_folder;
use heliosplat_raster::RasterError;
use heliosplat_raster::bounded::{TEXT_MAX, read_bytes};
use heliosplat_raster::write::remove;
use serde_json::Value;
use std::path::Path;
use std::time::Duration;

/// Name of the stamp in a unit's folder.
pub const STAMP: &str = "unit.json";

/// Names of the products of a unit, and its metrics.
pub(super) type Done = (Vec<String>, Value);

/// Stamp of a finished unit, written after all its products.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Stamp {
    /// Name of the unit.
    pub unit: String,
    /// Key of the unit when it ran.
    pub key: String,
    /// Build of the program that ran it; empty in stamps of versions that did not state it.
    #[serde(default)]
    pub build: String,
    /// Products of the unit.
    pub outputs: Vec<Output>,
    /// Duration without pauses, seconds.
    pub seconds: f64,
    /// Peak memory, bytes.
    pub peak_rss_bytes: u64,
    /// Metrics, such as errors of the surface model.
    pub metrics: Value,
}

/// Product file of a unit.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Output {
    /// Path relative to the unit's folder.
    pub path: String,
    /// File size, bytes.
    pub bytes: u64,
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
}

impl Output {
    /// True if the file lies in the folder: a stamp comes from the disk and may name other files.
    fn is_plain(&self) -> bool {
        Path::new(&self.path).is_relative() && !self.path.contains("..")
    }

    /// Describes the file at `path` below a unit's folder.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn of(folder: &Path, path: &str) -> Result<Self, run_folder::RunError> {
        let file = folder.join(path);
        let sha256 = run_folder::hash(&file)?;
        let bytes = std::fs::metadata(&file).map_or(0, |data| data.len());
        let path = path.into();
        Ok(Self { path, bytes, sha256 })
    }
}

/// Build that finished a unit with another key, if it is not this build. Such a unit runs again, because products of
/// two builds are not mixed.
pub fn other_build(out: &Path, unit: &Unit) -> Option<String> {
    let stamp = read(&out.join(&unit.id))?;
    (stamp.key != unit.key && stamp.build != build()).then_some(stamp.build)
}

/// Stamp in the folder of a unit, whatever its key.
pub(super) fn read(folder: &Path) -> Option<Stamp> {
    serde_json::from_slice(&read_bytes(&folder.join(STAMP), TEXT_MAX).ok()?).ok()
}

/// Removes the products that the stamp in a folder lists, so that none of earlier work stands beside those of new work.
///
/// # Errors
/// When a file cannot be removed.
pub(super) fn remove_outputs(folder: &Path) -> Result<(), RasterError> {
    let outputs = read(folder).map(|stamp| stamp.outputs).unwrap_or_default();
    for output in outputs.iter().filter(|output| output.is_plain()) {
        let path = folder.join(&output.path);
        remove(&path)?;
        if let Some(within) = path.parent().filter(|within| *within != folder) {
            // Only an empty folder is removed.
            let _ = std::fs::remove_dir(within);
        }
    }
    Ok(())
}

/// Stamp of a unit if it is finished: name and key agree, and all products exist with their recorded sizes.
pub fn finished(out: &Path, unit: &Unit) -> Option<Stamp> {
    let folder = out.join(&unit.id);
    let stamp = read(&folder)?;
    let bytes = |output: &Output| std::fs::metadata(folder.join(&output.path)).map(|data| data.len());
    let there = |output: &Output| bytes(output).is_ok_and(|bytes| bytes == output.bytes);
    (is_of(&stamp, unit) && stamp.outputs.iter().all(there)).then_some(stamp)
}

/// True if a stamp is of a unit with its present key, and names files in its folder alone.
pub(super) fn is_of(stamp: &Stamp, unit: &Unit) -> bool {
    stamp.key == unit.key && stamp.unit == unit.id && stamp.outputs.iter().all(Output::is_plain)
}

/// Locks `folder`, and waits while another process holds the lock; `None` if `stopped` returns true first.
///
/// # Errors
/// When the lock cannot be made.
pub fn claim(folder: &Path, stopped: &dyn Fn() -> bool) -> Result<Option<Lock>, run_folder::RunError> {
    let mut told = false;
    loop {
        if let Some(lock) = Lock::take(folder)? {
            return Ok(Some(lock));
        }
        if stopped() {
            return Ok(None);
        }
        if !told {
            tracing::info!("{}: another process works here; waiting for it", folder.display());
            told = true;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::ProductOptions;
    use crate::plan::{MosaicWork, Work};

    fn unit() -> Unit {
        Unit {
            id: "a/b/c/mosaic".into(),
            work: Work::Mosaic(MosaicWork {
                tiles: Vec::new(),
                colours: None,
                crs: "EPSG:32637".into(),
                gsd_m: 0.5,
                bounds: [0.0; 4],
                around: [0.0; 4],
                truth: None,
                classes: None,
                products: ProductOptions::default(),
            }),
            after: Vec::new(),
            mem_mb: 1,
            runtime_s: 1,
            key: "k".into(),
            deliver: None,
        }
    }

    #[test]
    fn a_unit_is_finished_when_its_stamp_its_key_and_its_products_agree() {
        let out = tempfile::tempdir().expect("a temporary folder");
        let mut unit = unit();
        let folder = out.path().join(&unit.id);
        std::fs::create_dir_all(&folder).expect("made");
        assert!(finished(out.path(), &unit).is_none());
        std::fs::write(folder.join("dsm.tif"), b"product").expect("written");
        let mut stamp = Stamp {
            unit: unit.id.clone(),
            key: "k".into(),
            build: "b".into(),
            outputs: vec![Output::of(&folder, "dsm.tif").expect("readable")],
            seconds: 1.0,
            peak_rss_bytes: 1,
            metrics: Value::Null,
        };
        let write = |stamp: &Stamp| {
            std::fs::write(folder.join(STAMP), serde_json::to_string(stamp).expect("JSON")).expect("written");
        };
        write(&stamp);
        assert!(finished(out.path(), &unit).is_some());
        unit.key = "other".into();
        assert!(finished(out.path(), &unit).is_none(), "other inputs");
        unit.key = "k".into();
        std::fs::write(folder.join("dsm.tif"), b"prod").expect("written");
        assert!(finished(out.path(), &unit).is_none(), "a truncated product");
        stamp.outputs[0].path = "../../../../../etc/passwd".into();
        write(&stamp);
        assert!(finished(out.path(), &unit).is_none(), "a stamp that names other files");
        std::fs::write(folder.join(STAMP), "{").expect("written");
        assert!(finished(out.path(), &unit).is_none(), "half a stamp");
    }

    #[test]
    fn a_folder_is_claimed_once_at_a_time() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let claimed = claim(folder.path(), &|| false).expect("lockable");
        assert!(claimed.is_some());
        assert!(claim(folder.path(), &|| true).expect("lockable").is_none());
        drop(claimed);
        assert!(claim(folder.path(), &|| true).expect("lockable").is_some());
    }
}
