//! Identity of files: size, modification time, and a hash of the content that is computed once and stored.

use super::{Result, SceneError};
use heliosplat_raster::bounded::{TEXT_MAX, read_bytes};
use heliosplat_raster::virtual_files::read_virtual;
use heliosplat_raster::write::write_atomically;
use heliosplat_raster::{RasterError, is_virtual, sha256};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Size of a raster's header for its identity, bytes from the beginning of the file.
const HEADER_BYTES: u64 = 1 << 16;
/// Name of the file that stores the hashes.
const HASHES: &str = "inputs.json";

/// State of a file at the time of reading.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct FileIdentity {
    /// Path of the file.
    pub path: PathBuf,
    /// Size and modification time.
    pub seen: Seen,
    /// SHA-256 of the content, hexadecimal.
    pub sha256: String,
}

impl FileIdentity {
    /// True if the file has the same size and modification time, or the same content. False for a missing file.
    pub fn is_unchanged(&self) -> bool {
        let now = seen(&self.path);
        now == self.seen
            || (now.bytes == self.seen.bytes && sha256::of_file(&self.path).is_ok_and(|sum| sum == self.sha256))
    }
}

/// SHA-256 of a file, or the error that names it.
fn sum(path: &Path, of: impl FnOnce(&Path) -> std::io::Result<String>) -> Result<String> {
    of(path).map_err(|error| SceneError::Unreadable(path.to_owned(), error.to_string()))
}

/// Size and modification time of a file; zero where unavailable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Seen {
    bytes: u64,
    changed_ns: u128,
}

/// Size and modification time of a file, from its metadata alone; both are zero if it does not exist. Of a file on a
/// virtual file system, a hash of its beginning stands for the time.
pub fn seen(path: &Path) -> Seen {
    if is_virtual(path) {
        let (start, bytes) = read_virtual(path, HEADER_BYTES).unwrap_or_default();
        let hash = Sha256::digest(&start);
        let changed_ns = hash.iter().take(16).fold(0, |all, &byte| all << 8 | u128::from(byte));
        return Seen { bytes, changed_ns };
    }
    let data = std::fs::metadata(path).ok();
    let changed = data.as_ref().and_then(|data| data.modified().ok());
    let since = changed.and_then(|time| time.duration_since(SystemTime::UNIX_EPOCH).ok());
    let bytes = data.map_or(0, |data| data.len());
    let changed_ns = since.unwrap_or_default().as_nanos();
    Seen { bytes, changed_ns }
}

/// Hashes of files, reused for files with unchanged size and modification time.
#[derive(Debug, Default)]
pub struct Hashes {
    known: BTreeMap<PathBuf, (Seen, String)>,
}

impl Hashes {
    /// Loads the hashes stored in the folder `out`; empty where there are none.
    pub fn open(out: &Path) -> Self {
        let text = read_bytes(&out.join(HASHES), TEXT_MAX).unwrap_or_default();
        let known = serde_json::from_slice(&text).unwrap_or_default();
        Self { known }
    }

    /// Stores the hashes in the folder `out`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, out: &Path) -> Result<(), RasterError> {
        let text = serde_json::to_string(&self.known).unwrap_or_default();
        write_atomically(&out.join(HASHES), text.as_bytes())
    }

    /// Identity of a file; its content is read only if size or modification time differ from the stored ones.
    ///
    /// # Errors
    /// [`SceneError::Unreadable`] when the file cannot be read.
    pub fn identify(&mut self, path: &Path) -> Result<FileIdentity> {
        let now = seen(path);
        let sha256 = match self.known.get(path).filter(|(then, _)| *then == now) {
            Some((_, sha256)) => sha256.clone(),
            None => sum(path, sha256::of_file)?,
        };
        self.known.insert(path.to_owned(), (now, sha256.clone()));
        let (path, seen) = (path.to_owned(), now);
        Ok(FileIdentity { path, seen, sha256 })
    }

    /// Adds known identities, for example those of an earlier run.
    pub fn learn(&mut self, identities: impl IntoIterator<Item = FileIdentity>) {
        let known = identities.into_iter();
        let known = known.map(|file| (file.path, (file.seen, file.sha256)));
        self.known.extend(known);
    }

    /// Names and hashes of `files`, one line each. For `rasters`, which may be too large to read, size, modification
    /// time and header are used; for a file on a virtual file system, size and header. Missing files are left out.
    ///
    /// # Errors
    /// [`SceneError::Unreadable`] when a file cannot be read.
    pub fn of(&mut self, files: &[PathBuf], rasters: &BTreeSet<&Path>) -> Result<String> {
        let mut text = String::new();
        for file in files {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            if is_virtual(file) {
                let Seen { bytes, changed_ns } = seen(file);
                text += &format!("{} {bytes} {changed_ns}\n", file.display());
            } else if !file.is_file() {
                continue;
            } else if rasters.contains(file.as_path()) {
                let Seen { bytes, changed_ns } = seen(file);
                let header = sum(file, |file| sha256::of_start(file, HEADER_BYTES))?;
                text += &format!("{name} {bytes} {changed_ns} {header}\n");
            } else {
                text += &format!("{name} {}\n", self.identify(file)?.sha256);
            }
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
        let none = BTreeSet::new();
        let before = hashes.of(std::slice::from_ref(&file), &none).expect("readable");
        hashes.save(folder.path()).expect("written");
        let mut hashes = Hashes::open(folder.path());
        assert_eq!(hashes.of(std::slice::from_ref(&file), &none).expect("readable"), before);
        std::fs::write(&file, b"three").expect("written");
        assert_ne!(hashes.of(std::slice::from_ref(&file), &none).expect("readable"), before);
    }

    #[test]
    fn a_raster_of_many_gigabytes_is_identified_by_its_header() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.tif");
        let file = std::fs::File::create(&path).expect("created");
        file.set_len(1 << 38).expect("a sparse file");
        let rasters = BTreeSet::from([path.as_path()]);
        let of = || {
            Hashes::default()
                .of(std::slice::from_ref(&path), &rasters)
                .expect("readable")
        };
        let before = of();
        assert_eq!(of(), before);
        file.set_len(1 << 37).expect("a sparse file");
        assert_ne!(of(), before);
    }
}
