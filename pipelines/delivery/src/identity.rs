//! The identity of files: size, time of change, and a hash of the content that is computed once and kept.

use super::SceneError;
use heliosplat_raster::bounded::{TEXT_MAX, read_bytes};
use heliosplat_raster::write::write_atomically;
use heliosplat_raster::{RasterError, is_virtual};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Bytes at the beginning of a raster that count for its identity: its header.
const HEADER_BYTES: u64 = 1 << 16;
/// Name of the file that hashes are kept in.
const HASHES: &str = "inputs.json";

/// A file as it was when it was read.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct FileIdentity {
    /// The file.
    pub path: PathBuf,
    /// Size and time of change.
    pub seen: Seen,
    /// SHA-256 of its content, hexadecimal.
    pub sha256: String,
}

impl FileIdentity {
    /// True if the file is unchanged: of the same size and time of change, or of the same content. A file that is gone is not.
    pub fn is_unchanged(&self) -> bool {
        let now = seen(&self.path);
        now == self.seen || (now.bytes == self.seen.bytes && hash(&self.path).is_ok_and(|sha256| sha256 == self.sha256))
    }
}

/// SHA-256 of a file, hexadecimal.
///
/// # Errors
/// [`SceneError::Unreadable`].
pub fn hash(path: &Path) -> Result<String, SceneError> {
    hash_of_start(path, u64::MAX)
}

/// SHA-256 of the first `bytes` of a file, hexadecimal.
fn hash_of_start(path: &Path, bytes: u64) -> Result<String, SceneError> {
    let unreadable = |error: std::io::Error| SceneError::Unreadable {
        path: path.to_owned(),
        reason: error.to_string(),
    };
    let file = std::fs::File::open(path).map_err(unreadable)?;
    let mut hasher = Sha256::new();
    std::io::copy(&mut file.take(bytes), &mut hasher).map_err(unreadable)?;
    Ok(hex::encode(hasher.finalize()))
}

/// SHA-256 of some numbers, hexadecimal.
pub fn hash_of_values(values: &[f32]) -> String {
    let mut hasher = Sha256::new();
    values.iter().for_each(|value| hasher.update(value.to_le_bytes()));
    hex::encode(hasher.finalize())
}

/// Size and time of change of a file, as far as they can be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Seen {
    bytes: u64,
    changed_ns: u128,
}

/// Size and time of change of a file, without reading it; `None` if it does not exist.
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
    /// The hashes that are kept in `out`.
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

    /// The identity of a file; its content is read only where size or time of change are not those known.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn identify(&mut self, path: &Path) -> Result<FileIdentity, SceneError> {
        let now = seen(path);
        let sha256 = match self.known.get(path).filter(|(then, _)| *then == now) {
            Some((_, sha256)) => sha256.clone(),
            None => hash(path)?,
        };
        self.known.insert(path.to_owned(), (now, sha256.clone()));
        Ok(FileIdentity {
            path: path.to_owned(),
            seen: now,
            sha256,
        })
    }

    /// Takes over identities that are known from elsewhere.
    pub fn learn(&mut self, identities: impl IntoIterator<Item = FileIdentity>) {
        let known = identities.into_iter();
        self.known
            .extend(known.map(|file| (file.path, (file.seen, file.sha256))));
    }

    /// Names and hashes of files, a line each. Of `rasters`, which may be too large to be read, size, time of change and header count. A file
    /// on a virtual file system counts by its name.
    ///
    /// # Errors
    /// When one cannot be read.
    pub fn of(&mut self, files: &[PathBuf], rasters: &BTreeSet<&Path>) -> Result<String, SceneError> {
        let mut text = String::new();
        for file in files {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            if is_virtual(file) {
                text += &format!("{}\n", file.display());
            } else if !file.is_file() {
                continue;
            } else if rasters.contains(file.as_path()) {
                let Seen { bytes, changed_ns } = seen(file);
                text += &format!("{name} {bytes} {changed_ns} {}\n", hash_of_start(file, HEADER_BYTES)?);
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
