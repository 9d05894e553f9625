//! Files and folders of a scene, by name: images, truth, masks, and the folders of published layouts.

use super::dimap::Dimaps;
use super::names::{IMAGE_EXTENSIONS, file_name, folder_of, has_extension, is_truth, mask_of, stem};
use super::{Result, SceneError};
use heliosplat_raster::bounded;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Cache of folders, texts and DIMAPs while a scene is opened: each folder is listed once, each text read once, each
/// DIMAP parsed once.
#[derive(Debug, Default)]
pub(super) struct Folders {
    listed: RefCell<BTreeMap<PathBuf, Rc<Vec<Entry>>>>,
    texts: RefCell<BTreeMap<PathBuf, Rc<str>>>,
    by_name: RefCell<BTreeMap<PathBuf, Rc<BTreeMap<String, PathBuf>>>>,
    dimaps: RefCell<BTreeMap<PathBuf, Rc<Dimaps>>>,
}

/// One entry of a folder.
#[derive(Debug, Clone)]
struct Entry {
    path: PathBuf,
    is_file: bool,
}

impl Folders {
    /// Content of a text file of at most a few megabytes; invalid UTF-8 is replaced.
    pub(super) fn text(&self, path: &Path) -> Result<Rc<str>> {
        let read = || bounded::read_text_lossy(path).map_err(|error| unreadable(path, &error));
        remembered(&self.texts, path, || Ok(read()?.into()))
    }

    /// Paths of the texts that were read.
    pub(super) fn texts_read(&self) -> Vec<PathBuf> {
        self.texts.borrow().keys().cloned().collect()
    }

    /// Images directly in a folder, sorted by name, without truth rasters and masks. Empty for a missing folder.
    pub(super) fn images(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        let is_image =
            |path: &PathBuf| has_extension(path, &IMAGE_EXTENSIONS) && !is_truth(path) && mask_of(path).is_none();
        Ok(self.files(folder)?.into_iter().filter(is_image).collect())
    }

    /// Files directly in a folder, sorted by name, without hidden ones. Empty for a missing folder.
    pub(super) fn files(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        let entries = self.entries(folder)?;
        let files = entries.iter().filter(|entry| entry.is_file);
        Ok(files.map(|entry| entry.path.clone()).collect())
    }

    /// Folders directly in a folder, sorted by name, without hidden ones. Empty for a missing folder.
    pub(super) fn folders(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        let entries = self.entries(folder)?;
        let others = entries.iter().filter(|entry| !entry.is_file && entry.path.is_dir());
        Ok(others.map(|entry| entry.path.clone()).collect())
    }

    /// Files of a folder by their name in lower case; the first file of each name.
    pub(super) fn by_name(&self, folder: &Path) -> Result<Rc<BTreeMap<String, PathBuf>>> {
        remembered(&self.by_name, folder, || {
            let mut named = BTreeMap::new();
            for path in self.files(folder)? {
                named.entry(file_name(&path).to_lowercase()).or_insert(path);
            }
            Ok(named.into())
        })
    }

    /// The DIMAPs of a folder that list files.
    pub(super) fn dimaps(&self, folder: &Path) -> Result<Rc<Dimaps>> {
        let read = || Dimaps::read(folder, self.files(folder)?, |path| self.text(path));
        remembered(&self.dimaps, folder, || Ok(read()?.into()))
    }

    fn entries(&self, folder: &Path) -> Result<Rc<Vec<Entry>>> {
        remembered(&self.listed, folder, || Ok(listed(folder)?.into()))
    }
}

/// The value that is known of a path, found once.
fn remembered<T: ?Sized>(
    known: &RefCell<BTreeMap<PathBuf, Rc<T>>>,
    path: &Path,
    find: impl FnOnce() -> Result<Rc<T>>,
) -> Result<Rc<T>> {
    if let Some(found) = known.borrow().get(path) {
        return Ok(Rc::clone(found));
    }
    let found = find()?;
    known.borrow_mut().insert(path.to_owned(), Rc::clone(&found));
    Ok(found)
}

fn unreadable(path: &Path, error: &std::io::Error) -> SceneError {
    SceneError::Unreadable(path.to_owned(), error.to_string())
}

fn listed(folder: &Path) -> Result<Vec<Entry>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|error| unreadable(folder, &error))? {
        let entry = entry.map_err(|error| unreadable(folder, &error))?;
        if entry.file_name().to_string_lossy().starts_with('.') {
            continue;
        }
        let path = entry.path();
        let is_file = match entry.file_type() {
            // The listing contains the kind of each entry; a query for each file would be slow.
            Ok(kind) if !kind.is_symlink() => kind.is_file(),
            _ => path.is_file(),
        };
        found.push(Entry { path, is_file });
    }
    // Within one folder, byte order equals path order, and is cheaper than comparing path components.
    found.sort_by(|a, b| a.path.as_os_str().cmp(b.path.as_os_str()));
    Ok(found)
}

/// Planet's mask of unusable pixels for an image: `x_3B_udm2` or `x_3B_AnalyticMS_DN_udm` for `x_3B_AnalyticMS`. `udm2`
/// is preferred to `udm`.
pub(super) fn usable_mask(image: &Path, folders: &Folders) -> Option<PathBuf> {
    let name = stem(image).to_lowercase();
    let masks = folders.files(folder_of(image)).unwrap_or_default();
    let fits = |path: &PathBuf| {
        // Only whole parts of names match: `x_1` is no beginning of `x_10`.
        let begins = |of: String| {
            format!("{name}_").starts_with(&format!("{of}_")) || format!("{of}_").starts_with(&format!("{name}_"))
        };
        has_extension(path, &IMAGE_EXTENSIONS)
            && stem(path).to_lowercase().contains("_udm")
            && mask_of(path).is_some_and(begins)
    };
    let is_old = |path: &PathBuf| !stem(path).to_lowercase().contains("_udm2");
    masks.into_iter().filter(fits).min_by_key(is_old)
}

/// Warning about a raster that this program wrote, which is neither image nor truth; `None` for any other raster.
pub(super) fn own_output(file: &heliosplat_raster::RasterFile) -> Option<String> {
    let software = file.domain("").remove("SOFTWARE")?;
    software.starts_with("heliosplat").then(|| {
        let path = file.path().display();
        format!("{path}: written by {software}, neither an image nor truth; left out")
    })
}

/// True if this program wrote the folder: a run, products, or a batch.
pub(super) fn is_own_folder(folder: &Path) -> bool {
    let ours = |name: &str| {
        let start = bounded::read_start(&folder.join(name), 1 << 16);
        String::from_utf8_lossy(&start).contains("heliosplat")
    };
    let mut files = ["run.toml", "model.json"].iter();
    let of_run = files.any(|name| folder.join(name).is_file());
    of_run || ["item.json", "collection.json"].into_iter().any(ours)
}

/// Names, in lower case, of folders in which DFC2019, Sat-NeRF and EOGS publish one part of a scene each.
const PUBLISHED_NAMES: [&str; 7] = ["dfc2019", "root_dir", "images", "img", "imgs", "truth", "cameras"];
/// Beginnings of folder names that continue with a number or a content: `Track3-RGB-crops`, `crops_rpcs_ba_v2`,
/// `rpcs_raw`.
const PUBLISHED_BEGINNINGS: [&str; 3] = ["track3", "crops_rpcs", "rpcs"];
/// Number of levels above a folder that are searched for its other half: `root_dir/crops_rpcs_raw/JAX_068` and
/// `DFC2019/Track3-RGB-crops/JAX_068` meet three levels up.
const LEVELS_UP: usize = 4;

/// Folders of published names that may contain the other half of a Sat-NeRF or EOGS scene, nearest first, up to
/// [`LEVELS_UP`] levels above `folder`. A subfolder with the name of `folder` precedes the published folder itself. No
/// other folder is searched.
pub(super) fn neighbours(folder: &Path, folders: &Folders) -> Vec<PathBuf> {
    let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = file_name(&absolute);
    let mut found = Vec::new();
    for ancestor in absolute.ancestors().skip(1).take(LEVELS_UP) {
        for outer in published_in(ancestor, folders) {
            let inner = published_in(&outer, folders);
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
fn published_in(folder: &Path, folders: &Folders) -> Vec<PathBuf> {
    let is_published = |path: &PathBuf| {
        let name = file_name(path).to_lowercase();
        PUBLISHED_NAMES.contains(&name.as_str()) || PUBLISHED_BEGINNINGS.iter().any(|start| name.starts_with(start))
    };
    let inside = folders.folders(folder).unwrap_or_default().into_iter();
    inside.filter(is_published).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_of_planet_belong_to_their_images() {
        let home = tempfile::tempdir().expect("a temporary folder");
        for name in [
            "20200814_ssc4_basic_panchromatic_dn.tif",
            "20200814_ssc4_basic_panchromatic_udm.tif",
            "20200814_ssc4_basic_panchromatic_udm2.tif",
            "20160831_0e26_3B_AnalyticMS.tif",
            "20160831_0e26_3B_AnalyticMS_DN_udm.tif",
            "alone.tif",
        ] {
            std::fs::write(home.path().join(name), "").expect("written");
        }
        let folders = Folders::default();
        let images = folders.images(home.path()).expect("listed");
        let masks: Vec<Option<String>> = images
            .iter()
            .map(|image| usable_mask(image, &folders).map(|mask| file_name(&mask)))
            .collect();
        assert_eq!(
            masks,
            [
                Some("20160831_0e26_3B_AnalyticMS_DN_udm.tif".to_owned()),
                Some("20200814_ssc4_basic_panchromatic_udm2.tif".to_owned()),
                None
            ]
        );
    }

    #[test]
    fn a_folder_is_listed_and_a_text_is_read_once() {
        let home = tempfile::tempdir().expect("a temporary folder");
        let text = home.path().join("dim_a.xml");
        std::fs::write(&text, "once").expect("written");
        let folders = Folders::default();
        assert_eq!(&*folders.text(&text).expect("readable"), "once");
        assert_eq!(folders.files(home.path()).expect("listed"), std::slice::from_ref(&text));
        std::fs::remove_file(&text).expect("removed");
        assert_eq!(&*folders.text(&text).expect("known"), "once");
        assert_eq!(folders.by_name(home.path()).expect("known").len(), 1);
    }
}
