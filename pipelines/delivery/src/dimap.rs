//! DIMAP files (`DIM_*.XML`) beside images: the tiles of one image, whatever their names.

use super::names::{file_name, has_extension};
use super::{Result, SceneError};
use heliosplat_rpc::read::{DataFile, DataFiles, data_files};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};
use std::rc::Rc;

/// Beginning of the names of DIMAP files, in lower case.
pub(super) const PREFIX: &str = "dim_";

/// The tiles of one image in a DIMAP.
pub(super) struct ListedTiles {
    /// Paths of the tiles by row and column.
    pub(super) tiles: BTreeMap<[u32; 2], PathBuf>,
    /// Columns and rows from one tile to the next, where the DIMAP states them.
    pub(super) step_px: Option<[usize; 2]>,
}

/// The DIMAPs of a folder that list files.
#[derive(Debug, Default)]
pub(super) struct Dimaps {
    all: Vec<(PathBuf, DataFiles)>,
    /// The first DIMAP of the folder that lists a file of this name.
    of_file: BTreeMap<String, PathBuf>,
}

impl Dimaps {
    /// Reads the DIMAPs of a folder.
    pub(super) fn read(folder: &Path, files: Vec<PathBuf>, text: impl Fn(&Path) -> Result<Rc<str>>) -> Result<Self> {
        let is_dimap =
            |path: &PathBuf| has_extension(path, &["xml"]) && file_name(path).to_lowercase().starts_with(PREFIX);
        let mut found = Self::default();
        for path in files.into_iter().filter(is_dimap) {
            let Some(files) = data_files(&text(&path)?) else {
                continue;
            };
            for listed in files.images.iter().flatten().filter_map(|file| place(folder, file)) {
                if listed.parent() == Some(folder) {
                    found.of_file.entry(file_name(&listed)).or_insert_with(|| path.clone());
                }
            }
            found.all.push((path, files));
        }
        Ok(found)
    }

    /// Images with several tiles of this folder's DIMAPs, at least one of which is in `files`.
    ///
    /// # Errors
    /// [`SceneError::MissingTile`] when a tile of such an image does not exist.
    pub(super) fn tiled(&self, folder: &Path, files: &BTreeSet<&PathBuf>) -> Result<Vec<ListedTiles>> {
        let mut found = Vec::new();
        for (dimap, DataFiles { images, step_px }) in &self.all {
            for listed in images.iter().filter(|listed| listed.len() > 1) {
                let tiles = listed.iter().filter_map(|file| Some((file.tile, place(folder, file)?)));
                let tiles: BTreeMap<[u32; 2], PathBuf> = tiles.collect();
                if !tiles.values().any(|tile| files.contains(tile)) {
                    continue;
                }
                if let Some(tile) = tiles.values().find(|tile| !tile.is_file()) {
                    return Err(SceneError::MissingTile(tile.clone(), dimap.clone()));
                }
                let step_px = *step_px;
                found.push(ListedTiles { tiles, step_px });
            }
        }
        Ok(found)
    }

    /// The DIMAP that lists an image of this folder; `None` where there is none.
    pub(super) fn of_image(&self, image: &Path) -> Option<&PathBuf> {
        self.of_file.get(&file_name(image))
    }
}

/// Path of a listed file; `None` for a path outside of the DIMAP's folder.
fn place(folder: &Path, file: &DataFile) -> Option<PathBuf> {
    let parts = || Path::new(&file.href).components();
    let below = parts().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    let names: PathBuf = parts().filter(|part| *part != Component::CurDir).collect();
    below.then(|| folder.join(names))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_listed_file_never_leads_away_from_its_folder() {
        let at = |href: &str| {
            let file = DataFile {
                tile: [1, 1],
                href: href.to_owned(),
            };
            place(Path::new("a"), &file)
        };
        assert_eq!(at("./b/c.tif"), Some(PathBuf::from("a/b/c.tif")));
        for elsewhere in ["../c.tif", "/etc/c.tif", "b/../../c.tif"] {
            assert_eq!(at(elsewhere), None, "{elsewhere}");
        }
    }
}
