//! Files as a vendor would deliver them, and the truth. Everything is written into a folder of its own inside the
//! target and moved into place at the end: a failure leaves nothing behind.

pub(crate) mod geotiff;
pub(crate) mod metadata;

use crate::error::SynthError;
use std::fs;
use std::path::{Path, PathBuf};

/// Folder whose content moves into its parent when all of it is complete.
pub(crate) struct Staging {
    target: PathBuf,
    staged: PathBuf,
}

impl Staging {
    /// Creates the target if it is absent, and an empty staging folder in it.
    ///
    /// # Errors
    /// `SynthError::Failed` when a folder cannot be created.
    pub(crate) fn new(target: &Path) -> Result<Self, SynthError> {
        let staged = target.join(".synth-part");
        if staged.exists() {
            fs::remove_dir_all(&staged).map_err(SynthError::unwritable(&staged))?;
        }
        fs::create_dir_all(&staged).map_err(SynthError::unwritable(&staged))?;
        Ok(Self {
            target: target.to_owned(),
            staged,
        })
    }

    /// Temporary path of a file until it is complete. Its folder is created.
    ///
    /// # Errors
    /// `SynthError::Failed` when the folder cannot be created.
    pub(crate) fn path(&self, relative: &str) -> Result<PathBuf, SynthError> {
        let path = self.staged.join(relative);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(SynthError::unwritable(folder))?;
        }
        Ok(path)
    }

    /// Writes a text file.
    ///
    /// # Errors
    /// `SynthError::Failed` when it cannot be written.
    pub(crate) fn text(&self, relative: &str, text: &str) -> Result<(), SynthError> {
        let path = self.path(relative)?;
        fs::write(&path, text).map_err(SynthError::unwritable(&path))
    }

    /// Moves all files into the target.
    ///
    /// # Errors
    /// `SynthError::Failed` when a file cannot be moved.
    pub(crate) fn finish(self) -> Result<(), SynthError> {
        move_into(&self.staged, &self.target)
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // Nothing more can be done if the leavings of a failure cannot be removed.
        let _ = fs::remove_dir_all(&self.staged);
    }
}

fn move_into(from: &Path, to: &Path) -> Result<(), SynthError> {
    fs::create_dir_all(to).map_err(SynthError::unwritable(to))?;
    for entry in fs::read_dir(from).map_err(SynthError::unwritable(from))? {
        let entry = entry.map_err(SynthError::unwritable(from))?;
        let (source, target) = (entry.path(), to.join(entry.file_name()));
        if source.is_dir() {
            move_into(&source, &target)?;
        } else {
            fs::rename(&source, &target).map_err(SynthError::unwritable(&target))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_finished_leaves_nothing_behind() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let staging = Staging::new(folder.path()).expect("staging");
        staging.text("truth/a.txt", "a").expect("text");
        drop(staging);
        assert_eq!(fs::read_dir(folder.path()).expect("folder").count(), 0);
    }

    #[test]
    fn what_is_finished_lies_in_place() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let target = folder.path().join("deep/scene");
        let staging = Staging::new(&target).expect("staging");
        staging.text("truth/a.txt", "a").expect("text");
        staging.finish().expect("finished");
        assert_eq!(fs::read_to_string(target.join("truth/a.txt")).expect("file"), "a");
        assert!(!target.join(".synth-part").exists());
    }

    #[test]
    fn a_target_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("taken");
        fs::write(&file, "x").expect("file");
        let error = Staging::new(&file)
            .err()
            .map(|error| error.to_string())
            .unwrap_or_default();
        assert!(error.contains("taken"), "{error}");
    }
}
