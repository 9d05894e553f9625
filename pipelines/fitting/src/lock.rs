//! Lock of a folder: one process writes into it at a time.

use heliosplat_raster::RasterError;
use std::fs::{File, TryLockError};
use std::io::Result;
use std::path::{Path, PathBuf};

/// Name of the file that is locked.
const FILE: &str = ".lock";

/// The right to write into a folder; released when dropped, or when the process ends in any way.
#[derive(Debug)]
pub struct Lock {
    /// `None` on a file system without locks: the user must then keep processes apart.
    held: Option<(PathBuf, File)>,
}

impl Lock {
    /// Locks `folder`, which must exist; `None` where another process holds the lock. On a file system without locks
    /// the folder is not locked.
    ///
    /// # Errors
    /// When the lock file cannot be opened for writing.
    pub fn take(folder: &Path) -> std::result::Result<Option<Self>, RasterError> {
        let path = folder.join(FILE);
        loop {
            let file = File::options().create(true).append(true).open(&path);
            let file = file.map_err(|error| RasterError::from_io(&path, &error))?;
            match file.try_lock() {
                // The holder may have removed the file after it was opened here: then another process may lock a new
                // one.
                Ok(()) if is_at(&file, &path).unwrap_or(false) => {
                    let held = Some((path, file));
                    return Ok(Some(Self { held }));
                }
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(_)) => return Ok(Some(Self { held: None })),
            }
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        if let Some((path, _locked)) = &self.held {
            // A file that stays is no obstacle: the next process locks it.
            let _ = std::fs::remove_file(path);
        }
    }
}

/// True if an open file is the one at this path.
fn is_at(file: &File, path: &Path) -> Result<bool> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let (open, there) = (file.metadata()?, std::fs::metadata(path)?);
        Ok((open.dev(), open.ino()) == (there.dev(), there.ino()))
    }
    #[cfg(not(unix))]
    Ok(file.metadata().is_ok() && path.exists())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_at_a_time_writes_into_a_folder_and_leaves_nothing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let take = || Lock::take(folder.path()).expect("lockable");
        let first = take();
        assert!(first.is_some() && take().is_none());
        drop(first);
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0);
        assert!(take().is_some());
    }
}
