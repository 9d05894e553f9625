//! Files and folders that are being written, under temporary names beside their targets.
//!
//! Each is locked while its process lives. A killed process leaves them unlocked: the next process that writes into
//! their folder removes them.

use crate::RasterError;
use std::collections::BTreeSet;
use std::fs::{File, TryLockError};
use std::io::Result;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use tempfile::{Builder, NamedTempFile, TempDir};

/// Prefix of temporary names.
const PREFIX: &str = ".heliosplat-part-";
/// Symbolic links that are followed, as many as Linux follows.
const LINKS: usize = 40;

/// The target of a path after symbolic links: writing replaces the target and keeps the link.
pub(crate) fn target(path: &Path) -> PathBuf {
    let mut target = path.to_owned();
    for _ in 0..LINKS {
        let Ok(named) = std::fs::read_link(&target) else { break };
        target = folder_of(&target).join(named);
    }
    target
}

/// The folder of a file; `.` for a bare name.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// A new locked file in the folder of `path`, which is created where it is absent.
pub(crate) fn file_beside(path: &Path) -> Result<NamedTempFile> {
    let folder = folder_of(path);
    prepare(folder)?;
    let mut builder = Builder::new();
    builder.prefix(PREFIX);
    #[cfg(unix)]
    {
        // A temporary file is private by default; the finished one follows the user's umask like any other.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    loop {
        let file = builder.tempfile_in(folder)?;
        if is_ours(file.as_file(), file.path()) {
            return Ok(file);
        }
    }
}

/// A temporary folder, removed when dropped.
#[derive(Debug)]
pub struct TemporaryFolder {
    folder: TempDir,
    _lock: Option<File>,
}

impl TemporaryFolder {
    /// A new folder in `home`, which is created where it is absent.
    ///
    /// # Errors
    /// [`RasterError::DiskFull`], [`RasterError::Permission`] or [`RasterError::Write`].
    pub fn inside(home: &Path) -> std::result::Result<Self, RasterError> {
        Self::make(home).map_err(|error| RasterError::from_io(home, &error))
    }

    /// A new folder in the folder of `path`.
    ///
    /// # Errors
    /// [`RasterError::DiskFull`], [`RasterError::Permission`] or [`RasterError::Write`], as [`Self::inside`].
    pub fn beside(path: &Path) -> std::result::Result<Self, RasterError> {
        Self::make(folder_of(&target(path))).map_err(|error| RasterError::from_io(path, &error))
    }

    fn make(home: &Path) -> Result<Self> {
        prepare(home)?;
        loop {
            let folder = Builder::new().prefix(PREFIX).tempdir_in(home)?;
            // A folder that cannot be opened has no lock, and is not removed as a leftover either.
            let lock = File::open(folder.path()).ok();
            if lock.as_ref().is_none_or(|lock| is_ours(lock, folder.path())) {
                return Ok(Self { folder, _lock: lock });
            }
        }
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Locks a new file or folder; false if another process took it for a leftover meanwhile.
fn is_ours(file: &File, path: &Path) -> bool {
    !matches!(file.try_lock(), Err(TryLockError::WouldBlock)) && path.exists()
}

/// Creates a folder, and removes the leftovers of killed processes from it, once per process.
fn prepare(folder: &Path) -> Result<()> {
    static SEEN: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    std::fs::create_dir_all(folder)?;
    let first = SEEN.lock().is_ok_and(|mut seen| seen.insert(folder.to_owned()));
    if first {
        remove_leftovers(folder);
    }
    Ok(())
}

fn remove_leftovers(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let is_part = entry.file_name().to_string_lossy().starts_with(PREFIX);
        let Some(kind) = entry.file_type().ok().filter(|_| is_part) else {
            continue;
        };
        let path = entry.path();
        let unlocked = || File::open(&path).ok().filter(|file| file.try_lock().is_ok());
        // A leftover that cannot be removed takes space and does no other harm.
        if kind.is_dir()
            && let Some(_lock) = unlocked()
        {
            let _ = std::fs::remove_dir_all(&path);
        } else if kind.is_file()
            && let Some(_lock) = unlocked()
        {
            let _ = std::fs::remove_file(&path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).expect("a folder");
        let name = |entry: Result<fs::DirEntry>| entry.expect("an entry").file_name().into_string().expect("a name");
        entries.map(name).collect()
    }

    #[test]
    fn what_a_killed_process_left_is_removed_and_nothing_that_is_being_written() {
        let home = tempfile::tempdir().expect("a temporary folder");
        let (file, folder) = (home.path().join("dsm.tif"), home.path().join(".heliosplat-part-dead"));
        let living = file_beside(&file).expect("made");
        let busy = TemporaryFolder::beside(&file).expect("made");
        fs::create_dir(&folder).expect("made");
        fs::write(folder.join("tile.glb"), "").expect("written");
        for name in [".heliosplat-part-file", ".heliosplat-notes", "image.tif"] {
            fs::write(home.path().join(name), "").expect("written");
        }
        remove_leftovers(home.path());
        let mut left = names(home.path());
        let kept = |path: &Path| path.file_name().expect("a name").to_string_lossy().into_owned();
        let mut expected = vec![
            ".heliosplat-notes".to_owned(),
            kept(living.path()),
            kept(busy.path()),
            "image.tif".to_owned(),
        ];
        left.sort();
        expected.sort();
        assert_eq!(left, expected);
        drop((living, busy));
        assert_eq!(names(home.path()).len(), 2);
    }

    #[test]
    #[cfg(unix)]
    fn a_symbolic_link_stays_and_the_file_it_leads_to_is_written() {
        let home = tempfile::tempdir().expect("a temporary folder");
        let real = home.path().join("disk/real.txt");
        let (link, second) = (home.path().join("link"), home.path().join("second"));
        std::os::unix::fs::symlink("disk/real.txt", &link).expect("linked");
        std::os::unix::fs::symlink(&link, &second).expect("linked");
        crate::write_atomically(&second, b"new").expect("written");
        assert!(link.is_symlink() && second.is_symlink());
        assert_eq!(fs::read(&real).expect("there"), b"new");
    }
}
