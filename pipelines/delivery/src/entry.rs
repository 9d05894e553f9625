//! One image of a scene before its pixels are read.

use super::Split;
use super::manifest::ManifestImage;
use super::tiles::ImageFiles;
use std::path::PathBuf;

/// An image to read, and what was said about it outside of it.
#[derive(Debug, Clone)]
pub(super) struct ImageEntry {
    pub(super) name: String,
    pub(super) path: PathBuf,
    pub(super) split: Split,
    /// Sat-NeRF-like JSON that names it.
    pub(super) json: Option<PathBuf>,
    /// Its entry in `scene.toml`.
    pub(super) said: Option<ManifestImage>,
    /// The file at `path`, or the tiles whose first it is.
    pub(super) tiles: ImageFiles,
    /// The multispectral image of the same acquisition, by its name.
    pub(super) multispectral: Option<ImageFiles>,
}
