//! Files and folders of a scene by their names: what is an image, what is truth, and where the other half of a scene may lie.

use super::SceneError;
use std::collections::BTreeSet;
use std::fs::DirEntry;
use std::path::{Path, PathBuf};

/// Extensions of images, in lower case.
pub(super) const IMAGE_EXTENSIONS: [&str; 6] = ["tif", "tiff", "jp2", "ntf", "nitf", "img"];

/// Reads a text of at most a few megabytes; bytes that are no UTF-8 are replaced.
pub(super) fn read_text(path: &Path) -> Result<String, SceneError> {
    heliosplat_raster::bounded::read_text_lossy(path).map_err(|error| SceneError::Unreadable {
        path: path.to_owned(),
        reason: error.to_string(),
    })
}

/// Images directly in a folder, sorted by name; truth rasters are no images. An absent folder has none.
pub(super) fn images_in(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let is_image = |path: &PathBuf| has_extension(path, &IMAGE_EXTENSIONS) && !is_truth(path);
    Ok(files_in(folder)?.into_iter().filter(is_image).collect())
}

/// Files directly in a folder, sorted by name, hidden ones left out. An absent folder has none.
pub(super) fn files_in(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    listed(folder, |entry| match entry.file_type() {
        // The listing knows the kind, so the file system is not asked again for each file.
        Ok(kind) if !kind.is_symlink() => kind.is_file(),
        _ => entry.path().is_file(),
    })
}

/// What is directly in a folder, sorted by name, hidden entries left out. An absent folder has nothing.
pub(super) fn entries_of(folder: &Path) -> Result<Vec<PathBuf>, SceneError> {
    listed(folder, |_| true)
}

fn listed(folder: &Path, keep: impl Fn(&DirEntry) -> bool) -> Result<Vec<PathBuf>, SceneError> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let unreadable = |error: std::io::Error| SceneError::Unreadable {
        path: folder.to_owned(),
        reason: error.to_string(),
    };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        if !entry.file_name().to_string_lossy().starts_with('.') && keep(&entry) {
            found.push(entry.path());
        }
    }
    // In one folder the order of bytes is that of paths, without taking these apart.
    found.sort_by(|a, b| a.as_os_str().cmp(b.as_os_str()));
    Ok(found)
}

/// Whether a raster is truth by its name, not an image: `*_DSM.tif`, `*_CLS.tif`, `*_DTM.tif` and our own names.
pub(super) fn is_truth(path: &Path) -> bool {
    let name = stem(path).to_lowercase();
    let ends = ["_dsm", "_dtm", "_cls", "_cls_v2", "_agl", "_water"];
    ["dsm", "classes", "albedo", "water"].contains(&name.as_str())
        || name.starts_with("shadow_")
        || name.starts_with("cloud_")
        || ends.iter().any(|end| name.ends_with(end))
}

/// Names of folders, in lower case, under which DFC2019, Sat-NeRF and EOGS publish one part of a scene each.
const PUBLISHED_NAMES: [&str; 7] = ["dfc2019", "root_dir", "images", "img", "imgs", "truth", "cameras"];
/// How such names begin where they are numbered or say what is inside: `Track3-RGB-crops`, `crops_rpcs_ba_v2`, `rpcs_raw`.
const PUBLISHED_BEGINNINGS: [&str; 3] = ["track3", "crops_rpcs", "rpcs"];
/// How far above a folder its other half is looked for under such names: `root_dir/crops_rpcs_raw/JAX_068` and
/// `DFC2019/Track3-RGB-crops/JAX_068` meet three levels up.
const LEVELS_UP: usize = 4;

/// Folders in which the other half of a Sat-NeRF or EOGS scene may lie, given one half, nearest first: siblings of the folder and
/// of its parent, and folders of the same name inside them; then, up to [`LEVELS_UP`] levels above, folders of published names.
pub(super) fn neighbours(folder: &Path) -> Vec<PathBuf> {
    let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = file_name(&absolute);
    let mut found = Vec::new();
    for ancestor in absolute.ancestors().skip(1).take(2) {
        let siblings = entries_of(ancestor).unwrap_or_default();
        for sibling in siblings.into_iter().filter(|path| path.is_dir() && *path != absolute) {
            found.push(sibling.join(&name));
            found.push(sibling);
        }
    }
    for ancestor in absolute.ancestors().skip(1).take(LEVELS_UP) {
        for outer in published_in(ancestor) {
            let inner = published_in(&outer);
            for place in std::iter::once(outer).chain(inner) {
                found.push(place.join(&name));
                found.push(place);
            }
        }
    }
    let mut seen = BTreeSet::new();
    found.retain(|path| path.is_dir() && *path != absolute && seen.insert(path.clone()));
    found
}

/// Folders of published names directly in a folder.
fn published_in(folder: &Path) -> Vec<PathBuf> {
    let is_published = |path: &PathBuf| {
        let name = file_name(path).to_lowercase();
        PUBLISHED_NAMES.contains(&name.as_str()) || PUBLISHED_BEGINNINGS.iter().any(|start| name.starts_with(start))
    };
    let entries = entries_of(folder).unwrap_or_default().into_iter();
    entries.filter(|path| is_published(path) && path.is_dir()).collect()
}

/// File name without its extension.
pub(super) fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// File name as text.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Whether a path has one of the extensions, in upper or lower case.
pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    extensions.contains(&extension.as_str())
}
