//! An image of a scene before its file is opened.

use super::Split;
use super::manifest::ManifestImage;
use super::names::stem;
use super::tiles::ImageFiles;
use std::path::PathBuf;

/// An image to read, with the information from outside of its file.
#[derive(Debug, Clone)]
pub(super) struct ImageEntry {
    /// Name of the image: its file stem, distinct among the images.
    pub(super) name: String,
    /// The file, or the first of its tiles.
    pub(super) path: PathBuf,
    /// Train or test.
    pub(super) split: Split,
    /// Sat-NeRF JSON that names the image.
    pub(super) json: Option<PathBuf>,
    /// Entry of the image in `scene.toml`.
    pub(super) said: Option<ManifestImage>,
    /// The file at `path`, or all tiles if `path` is the first of several.
    pub(super) tiles: ImageFiles,
    /// The multispectral image of the same acquisition, matched by name.
    pub(super) multispectral: Option<ImageFiles>,
}

impl ImageEntry {
    /// Training image in `files`, named by its file stem, without further information.
    pub(super) fn of(files: ImageFiles) -> Self {
        Self {
            name: stem(&files.path),
            path: files.path.clone(),
            split: Split::Train,
            json: None,
            said: None,
            tiles: files,
            multispectral: None,
        }
    }
}
