//! Rules for outputs: no output replaces an input of the command, and the extension states the format.

use crate::outcome::CliError;
use heliosplat_fitting::run_folder::inputs;
use heliosplat_products::dsm::{BANDS, file_of};
use heliosplat_raster::temporary::folder_of;
use heliosplat_scene::Index;
use std::path::{Path, PathBuf};

/// Files of a run from which other files are made.
const OF_A_RUN: [&str; 4] = ["model.ply", "model.json", "run.toml", "metrics.json"];

/// Files that a command reads.
#[derive(Debug, Clone, Default)]
pub struct Inputs(Vec<PathBuf>);

impl Inputs {
    /// Inputs from paths of files; absent files are ignored by the checks.
    pub fn of_files<P: Into<PathBuf>>(files: impl IntoIterator<Item = P>) -> Self {
        Self(files.into_iter().map(Into::into).collect())
    }

    /// Files of a run, of a scene or of an object, and its training images.
    pub fn of_run(folder: &Path) -> Self {
        let own = OF_A_RUN.map(|name| folder.join(name)).into_iter();
        // The command itself reports a damaged or missing `run.toml`.
        let images = inputs(folder).unwrap_or_default().into_iter().map(|input| input.path);
        Self::of_files(own.chain(images))
    }

    /// Files of a delivery: images, truth and metadata.
    pub fn of_index(index: &Index) -> Self {
        Self::of_files(index.files.iter().cloned())
    }

    /// Refuses an output that is one of the inputs, also by another path or a link.
    ///
    /// # Errors
    /// [`CliError::Input`] for such an output.
    pub fn keep(&self, out: &Path) -> Result<(), CliError> {
        let same_as = |id| self.0.iter().find(|file| identity(file).as_ref() == Some(&id));
        let Some(same) = identity(out).and_then(same_as) else {
            return Ok(());
        };
        let (out, same) = (out.display(), same.display());
        let text = format!("{out}: this would replace {same}, which the command reads; give another --out");
        Err(CliError::Input(text))
    }

    /// Refuses a surface model if one of its files is an input.
    ///
    /// # Errors
    /// [`CliError::Input`] for such an output.
    pub fn keep_surface(&self, out: &Path) -> Result<(), CliError> {
        (0..BANDS.len()).try_for_each(|band| self.keep(&file_of(out, band)))
    }

    /// Refuses an output folder that directly holds one of the inputs.
    ///
    /// # Errors
    /// [`CliError::Input`] for such a folder.
    pub fn keep_folder(&self, out: &Path) -> Result<(), CliError> {
        let holds = |file: &&PathBuf| file.is_file() && identity(folder_of(file)) == identity(out);
        let Some(held) = self.0.iter().find(holds).filter(|_| out.exists()) else {
            return Ok(());
        };
        Err(CliError::Input(format!(
            "{}: this folder holds {}, which the command reads, and may have files of the same names; give another --out",
            out.display(),
            held.file_name().unwrap_or_default().to_string_lossy()
        )))
    }
}

/// Identity of a file or folder, equal for all paths to it; `None` if it does not exist.
#[cfg(unix)]
fn identity(path: &Path) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    std::fs::metadata(path).ok().map(|data| (data.dev(), data.ino()))
}

/// Identity of a file or folder, equal for all paths to it; `None` if it does not exist.
#[cfg(not(unix))]
fn identity(path: &Path) -> Option<PathBuf> {
    std::fs::canonicalize(path).ok()
}

/// Refuses a file name whose extension is none of `formats`; upper and lower case are equal.
///
/// # Errors
/// [`CliError::Input`], which names `option` and the formats.
pub fn must_end_in(option: &str, path: &Path, formats: &[&str]) -> Result<(), CliError> {
    let extension = path.extension().unwrap_or_default();
    if formats.iter().any(|format| extension.eq_ignore_ascii_case(format)) {
        return Ok(());
    }
    let (path, endings) = (path.display(), formats.join(" or ."));
    let text = format!("{option} {path}: give it a name that ends in .{endings}");
    Err(CliError::Input(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_is_known_by_any_of_its_paths() {
        let home = tempfile::tempdir().expect("a temporary folder");
        let image = home.path().join("a.tif");
        std::fs::write(&image, "pixels").expect("written");
        let inputs = Inputs::of_files([&image, &home.path().join("absent.tif")]);
        let folder = home.path().join("new/..");
        std::fs::create_dir(home.path().join("new")).expect("made");
        assert!(inputs.keep(&image).is_err() && inputs.keep(&folder.join("a.tif")).is_err());
        assert!(
            inputs.keep(&home.path().join("b.tif")).is_ok() && inputs.keep(&home.path().join("absent.tif")).is_ok()
        );
        assert!(inputs.keep_folder(&folder).is_err() && inputs.keep_folder(&home.path().join("new")).is_ok());
        #[cfg(unix)]
        {
            let [link, hard] = ["link.tif", "hard.tif"].map(|name| home.path().join(name));
            std::os::unix::fs::symlink(&image, &link).expect("linked");
            std::fs::hard_link(&image, &hard).expect("linked");
            assert!(inputs.keep(&link).is_err() && inputs.keep(&hard).is_err());
        }
    }

    #[test]
    fn an_extension_is_a_format_that_exists() {
        let check = |path: &str| must_end_in("--out", Path::new(path), &["tif", "tiff"]);
        assert!(check("a.tif").is_ok() && check("a/b.TIFF").is_ok());
        for bad in ["a.jpg", "tif", "a.tif.bak", ".tif"] {
            let said = check(bad).expect_err(bad).to_string();
            assert!(said.contains(".tif or .tiff"), "{said}");
        }
    }
}
