//! Hashes of the input files of a batch, kept so that a file is read again only where it has changed.

use super::BatchError;
use heliosplat_fitting::run_folder;
use heliosplat_raster::bounded::{TEXT_MAX, read_bytes};
use heliosplat_raster::write::write_atomically;
use heliosplat_raster::{RasterError, is_virtual};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Name of the file that hashes are kept in.
const HASHES: &str = "inputs.json";

/// Size and time of change of a file, as far as they can be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Seen {
    bytes: u64,
    changed_ns: u128,
}

/// What can be seen of a file without reading it; nothing of one that is not there.
pub fn seen(path: &Path) -> Seen {
    let data = std::fs::metadata(path).ok();
    let changed = data.as_ref().and_then(|data| data.modified().ok());
    let since = changed.and_then(|time| time.duration_since(SystemTime::UNIX_EPOCH).ok());
    Seen {
        bytes: data.map_or(0, |data| data.len()),
        changed_ns: since.unwrap_or_default().as_nanos(),
    }
}

/// Hashes of files that have not changed since.
#[derive(Debug, Default)]
pub struct Hashes {
    known: BTreeMap<PathBuf, (Seen, String)>,
}

impl Hashes {
    /// Those that are kept in `out`.
    pub fn open(out: &Path) -> Self {
        let text = read_bytes(&out.join(HASHES), TEXT_MAX).unwrap_or_default();
        Self {
            known: serde_json::from_slice(&text).unwrap_or_default(),
        }
    }

    /// Keeps them in `out`.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn save(&self, out: &Path) -> Result<(), RasterError> {
        let text = serde_json::to_string(&self.known).unwrap_or_default();
        write_atomically(&out.join(HASHES), text.as_bytes())
    }

    /// Names and hashes of files, a line each. A file on a virtual file system stands for itself by its name.
    ///
    /// # Errors
    /// When one cannot be read.
    pub fn of(&mut self, files: &[PathBuf]) -> Result<String, BatchError> {
        let mut text = String::new();
        for file in files {
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if is_virtual(file) {
                text += &format!("{}\n", file.display());
                continue;
            }
            if !file.is_file() {
                continue;
            }
            let now = seen(file);
            let before = self.known.get(file).filter(|(then, _)| *then == now);
            let sum = match before {
                Some((_, sum)) => sum.clone(),
                None => run_folder::hash(file).map_err(|error| BatchError::Io {
                    path: file.clone(),
                    reason: std::io::Error::other(error.to_string()),
                })?,
            };
            text += &format!("{name} {sum}\n");
            self.known.insert(file.clone(), (now, sum));
        }
        Ok(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hash_is_taken_again_when_a_file_has_changed() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("a.tif");
        std::fs::write(&file, b"one").expect("written");
        let mut hashes = Hashes::default();
        let before = hashes.of(std::slice::from_ref(&file)).expect("readable");
        hashes.save(folder.path()).expect("written");
        let mut hashes = Hashes::open(folder.path());
        assert_eq!(hashes.of(std::slice::from_ref(&file)).expect("readable"), before);
        std::fs::write(&file, b"three").expect("written");
        assert_ne!(hashes.of(std::slice::from_ref(&file)).expect("readable"), before);
    }
}
