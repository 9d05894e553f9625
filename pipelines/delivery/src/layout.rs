//! Layout of a scene: a `scene.toml`, a folder of images, or the folders of Sat-NeRF and EOGS, where images, cameras
//! (JSON) and truth may lie in separate folders.

use super::entry::ImageEntry;
use super::files::{Folders, is_own_folder, neighbours};
use super::manifest::{Counts, Manifest, ManifestImage, reject_address};
use super::names::{IMAGE_EXTENSIONS, file_name, has_extension, stem};
use super::satnerf::{self, JsonIndex};
use super::stacks;
use super::tiles::ImageFiles;
use super::{BandKind, Result, SceneError, Split, Truth, pair_names, relit_truth, truth};
use heliosplat_raster::{is_virtual, list_virtual};
use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The files of a scene.
#[derive(Debug, Clone, Default)]
pub(super) struct Layout {
    /// Images, in the order of the folder or the manifest.
    pub(super) images: Vec<ImageEntry>,
    /// Lowest and highest altitude in `scene.toml`, metres above the ellipsoid.
    pub(super) altitude_range_m: Option<(f64, f64)>,
    /// Bands of every file from `scene.toml`, in file order.
    pub(super) bands: Option<Vec<BandKind>>,
    /// Meaning of pixel values from `scene.toml`.
    pub(super) counts: Option<Counts>,
    /// Truth, where the scene contains it.
    pub(super) truth: Truth,
    /// Warnings, one line each.
    pub(super) warnings: Vec<String>,
}

/// Names of subfolders that may contain a scene's images.
const IMAGE_FOLDERS: [&str; 3] = ["images", "img", "imgs"];

/// Finds the files of the scene at `path`, a folder or a `scene.toml`.
pub(super) fn find(path: &Path, folders: &Folders) -> Result<Layout> {
    if is_virtual(path) {
        return from_virtual_folder(path);
    }
    reject_address(path)?;
    if path.is_file() {
        let reason = "a scene is a folder of images or a scene.toml; give the folder this file is in".to_owned();
        return match has_extension(path, &["toml"]) {
            true => from_manifest(path, folders),
            false => Err(SceneError::Manifest(path.to_owned(), reason)),
        };
    }
    if !path.is_dir() {
        let reason = "it is a device or a pipe; give a folder of images or a scene.toml".to_owned();
        return Err(match path.exists() {
            true => SceneError::Unreadable(path.to_owned(), reason),
            false => SceneError::Missing(path.to_owned()),
        });
    }
    let manifest = path.join("scene.toml");
    match manifest.exists() {
        true => from_manifest(&manifest, folders),
        false => from_folder(path, folders),
    }
}

/// Layout of a folder on one of GDAL's virtual file systems: its images, with the cameras and dates that GDAL finds
/// there.
fn from_virtual_folder(folder: &Path) -> Result<Layout> {
    let files = list_virtual(folder)?;
    let files = files.into_iter().filter(|path| has_extension(path, &IMAGE_EXTENSIONS));
    let images: Vec<ImageEntry> = files.map(|path| ImageEntry::of(ImageFiles::one(path))).collect();
    if images.is_empty() {
        return Err(SceneError::Empty(folder.to_owned()));
    }
    Ok(Layout {
        images: with_distinct_names(images),
        ..Layout::default()
    })
}

fn from_manifest(path: &Path, folders: &Folders) -> Result<Layout> {
    let manifest = Manifest::read(path)?;
    let entry = |image: &ManifestImage| ImageEntry {
        split: image.split.unwrap_or(Split::Train),
        json: satnerf::json_of(&image.path, folders),
        said: Some(image.clone()),
        ..ImageEntry::of(ImageFiles::one(image.path.clone()))
    };
    let images = manifest.images.iter().map(entry).collect();
    let home = path.parent().unwrap_or_else(|| Path::new("."));
    let mut warnings = Vec::new();
    let truth = match manifest.truth {
        Some(truth) => Truth {
            relit: relit_truth::folder_of(truth.dsm.as_deref(), home),
            dsm: truth.dsm,
            classes: truth.classes,
            shadows: truth.shadows.into_iter().collect(),
        },
        None => truth::find_for(home, &[], folders, &mut warnings),
    };
    Ok(Layout {
        images: with_distinct_names(images),
        altitude_range_m: manifest.altitude_range_m.map(|[low, high]| (low, high)),
        bands: manifest.bands,
        counts: manifest.counts,
        truth,
        warnings,
    })
}

fn from_folder(folder: &Path, folders: &Folders) -> Result<Layout> {
    let mut warnings = Vec::new();
    let (home, delivered) = scene_folder(folder, folders, &mut warnings)?;
    let mut images = delivered.map_or_else(|| folders.images(&home), Ok)?;
    let mut index = JsonIndex::read(&home, folders)?;
    for name in IMAGE_FOLDERS {
        if images.is_empty() {
            images = folders.images(&home.join(name))?;
        }
    }
    let lists = SplitLists::read(&home)?;
    if images.is_empty() && !index.is_empty() {
        images = index.find_images(&home, folders)?;
    } else if index.is_empty() {
        // The images lie outside of the folder with their JSONs: search the folders of the published layouts.
        index = cameras_beside(&home, &images, folders, &mut warnings)?;
    }
    if images.is_empty() {
        return Err(SceneError::Empty(folder.to_owned()));
    }
    let (images, mut partners) = pair_names::by_name(stacks::images(images, folders)?);
    let lists = match (lists, index.folder()) {
        (None, Some(json_folder)) => SplitLists::read(json_folder)?,
        (lists, _) => lists,
    };
    let entries: Vec<ImageEntry> = images
        .into_iter()
        .filter_map(|files| {
            let path = files.path.clone();
            let json = index.json_of(&path);
            let split = match &lists {
                Some(lists) => lists.split_of(&path, json.as_deref()),
                None => Some(Split::Train),
            };
            if split.is_none() {
                warnings.push(format!(
                    "{}: in neither train.txt nor test.txt, left out",
                    path.display()
                ));
            }
            Some(ImageEntry {
                split: split?,
                multispectral: partners.remove(&path),
                json,
                ..ImageEntry::of(files)
            })
        })
        .collect();
    let names: Vec<String> = entries.iter().map(|entry| stem(&entry.path)).collect();
    Ok(Layout {
        truth: truth::find_for(&home, &names, folders, &mut warnings),
        images: with_distinct_names(entries),
        warnings,
        ..Layout::default()
    })
}

/// JSONs of the images from another folder. The folder that describes most images is used alone, since cameras of
/// several kinds must not be mixed; of equal folders, the one with better cameras. A folder that contains images of the
/// same names is another scene, and its JSONs describe those images.
fn cameras_beside(home: &Path, images: &[PathBuf], folders: &Folders, warnings: &mut Vec<String>) -> Result<JsonIndex> {
    let mut found = Vec::new();
    let is_another_scene = |folder: &Path| images.iter().any(|image| folder.join(file_name(image)).is_file());
    // The sort is stable: nearer folders stay before farther ones.
    let others = neighbours(home, folders);
    let others = others.into_iter().filter(|folder| !is_another_scene(folder));
    for folder in others {
        let index = JsonIndex::read(&folder, folders)?.restricted_to(images);
        if !index.is_empty() {
            found.push((folder, index));
        }
    }
    found.sort_by_key(|(folder, index)| {
        let (kind, name) = camera_kind(folder);
        (Reverse(index.count_of(images)), kind, Reverse(name))
    });
    let mut found = found.into_iter();
    let Some((folder, index)) = found.next() else {
        return Ok(JsonIndex::default());
    };
    let count = index.count_of(images);
    if let Some((other, _)) = found.find(|(_, other)| other.count_of(images) == count) {
        warnings.push(chosen_cameras(home, &folder, &other));
    }
    Ok(index)
}

/// Quality of a folder's cameras by its path (0 bundle-adjusted, 1 unknown, 2 raw), and the name that shows it; the
/// last version in alphabetical order is preferred. `crops_rpcs_ba_v2/JAX_068` is `(0, "crops_rpcs_ba_v2")`.
fn camera_kind(folder: &Path) -> (u8, String) {
    for part in folder.iter().rev().take(3) {
        let name = part.to_string_lossy().to_lowercase();
        let says = |word: &str| name.split(['_', '-', '.', ' ']).any(|part| part == word);
        if says("ba") || says("adjusted") {
            return (0, name);
        }
        if says("raw") {
            return (2, name);
        }
    }
    (1, String::new())
}

/// Warning that names the camera folder in use and an equal one.
fn chosen_cameras(scene: &Path, used: &Path, other: &Path) -> String {
    let why = match (camera_kind(used).0, camera_kind(other).0) {
        (0, 1..) => "the bundle-adjusted ones of ",
        _ => "those of ",
    };
    let (scene, used, other) = (scene.display(), used.display(), other.display());
    let remedy = format!("to use others give their folder, as {other}");
    format!("{scene}: cameras in several folders; {why}{used} are used; {remedy}")
}

/// A candidate folder of cameras.
struct CameraFolder {
    path: PathBuf,
    index: JsonIndex,
    /// Path below the scene's top, without names that only state the kind of cameras.
    place: Vec<String>,
}

impl CameraFolder {
    fn new(top: &Path, path: PathBuf, index: JsonIndex) -> Self {
        let below = path.strip_prefix(top).unwrap_or(&path);
        let names = below.iter().map(|part| part.to_string_lossy().into_owned());
        let is_kind = |name: &String| {
            let name = name.to_lowercase();
            name.contains("rpc") || name.contains("camera")
        };
        let place = names.filter(|name| !is_kind(name)).collect();
        Self { path, index, place }
    }

    /// True if both folders describe cameras of the same images, of different kinds.
    fn is_same_scene(&self, other: &Self) -> bool {
        self.place == other.place && self.index.shares_an_image(&other.index)
    }
}

/// Best of several folders with cameras of the same images, with a warning that names the other folders.
fn best_cameras(top: &Path, mut candidates: Vec<CameraFolder>) -> Vec<(PathBuf, Option<String>)> {
    candidates.sort_by_key(|folder| {
        let (kind, name) = camera_kind(&folder.path);
        (kind, Reverse(name))
    });
    let mut scenes: Vec<(CameraFolder, Option<String>)> = Vec::new();
    for folder in candidates {
        match scenes.iter_mut().find(|(known, _)| known.is_same_scene(&folder)) {
            Some((known, warning)) => {
                warning.get_or_insert_with(|| chosen_cameras(top, &known.path, &folder.path));
            }
            None => scenes.push((folder, None)),
        }
    }
    let scenes = scenes.into_iter();
    let mut scenes: Vec<_> = scenes.map(|(folder, warning)| (folder.path, warning)).collect();
    scenes.sort();
    scenes
}

/// The folder of the scene: `folder` itself, or the only scene below it; of several kinds of cameras for one scene, the
/// best. With images where these lie in subfolders with one image each, as vendors deliver them.
fn scene_folder(
    folder: &Path,
    folders: &Folders,
    warnings: &mut Vec<String>,
) -> Result<(PathBuf, Option<Vec<PathBuf>>)> {
    let looks_like_scene = |folder: &Path| -> Result<bool> {
        Ok(!folders.images(folder)?.is_empty() || !JsonIndex::read(folder, folders)?.is_empty())
    };
    if looks_like_scene(folder)? {
        return Ok((folder.to_owned(), None));
    }
    for name in IMAGE_FOLDERS {
        if !folders.images(&folder.join(name))?.is_empty() {
            return Ok((folder.to_owned(), None));
        }
    }
    const DEEPEST: usize = 4;
    let below = folders_below(folder, DEEPEST, folders)?;
    let mut with_cameras = Vec::new();
    let mut with_images = Vec::new();
    for candidate in below {
        let index = JsonIndex::read(&candidate, folders)?;
        if !index.is_empty() {
            with_cameras.push(CameraFolder::new(folder, candidate, index));
        } else if !folders.images(&candidate)?.is_empty() {
            with_images.push((candidate, None));
        }
    }
    let mut candidates = if with_cameras.is_empty() {
        if let Some(images) = delivered(&with_images, folders)? {
            return Ok((folder.to_owned(), Some(images)));
        }
        with_images
    } else {
        best_cameras(folder, with_cameras)
    };
    match candidates.len() {
        0 => Err(SceneError::Empty(folder.to_owned())),
        1 => {
            let (home, warning) = candidates.remove(0);
            warnings.extend(warning);
            Ok((home, None))
        }
        _ => Err(SceneError::Several(folder.to_owned(), listed(&candidates))),
    }
}

/// Images of vendor folders with one image each: a panchromatic file, a multispectral file, both of one acquisition, or
/// the tiles of one. `None` where a folder has several images, since it is then a separate scene.
fn delivered(candidates: &[(PathBuf, Option<String>)], folders: &Folders) -> Result<Option<Vec<PathBuf>>> {
    let mut all = Vec::new();
    for (folder, _) in candidates {
        let images = folders.images(folder)?;
        if pair_names::by_name(stacks::images(images.clone(), folders)?).0.len() > 1 {
            return Ok(None);
        }
        all.extend(images);
    }
    Ok((candidates.len() > 1).then_some(all))
}

/// The folders of several scenes in one line, shortened where there are many.
fn listed(candidates: &[(PathBuf, Option<String>)]) -> String {
    const MOST: usize = 20;
    let names = candidates.iter().take(MOST).map(|(path, _)| path.display().to_string());
    let mut names: Vec<String> = names.collect();
    if candidates.len() > MOST {
        names.push(format!("and {} more", candidates.len() - MOST));
    }
    names.join(", ")
}

/// `train.txt` and `test.txt` of Sat-NeRF: names of images or of their JSONs, one per line.
struct SplitLists {
    train: Vec<String>,
    test: Vec<String>,
}

impl SplitLists {
    fn read(folder: &Path) -> Result<Option<Self>> {
        let read = |name: &str| -> Result<Option<Vec<String>>> {
            let path = folder.join(name);
            if !path.is_file() {
                return Ok(None);
            }
            let text = heliosplat_raster::bounded::read_text_lossy(&path)
                .map_err(|error| SceneError::Unreadable(path, error.to_string()))?;
            let names = text.lines().map(str::trim).filter(|line| !line.is_empty());
            Ok(Some(names.map(|name| stem(Path::new(name))).collect()))
        };
        let (train, test) = (read("train.txt")?, read("test.txt")?);
        let is_given = train.is_some() || test.is_some();
        let (train, test) = (train.unwrap_or_default(), test.unwrap_or_default());
        Ok(is_given.then_some(Self { train, test }))
    }

    /// The split of an image; `None` for an image in neither list. Without training names, all images outside of
    /// `test.txt` are trained on.
    fn split_of(&self, image: &Path, json: Option<&Path>) -> Option<Split> {
        let names = [Some(stem(image)), json.map(stem)];
        let listed = |list: &[String]| names.iter().flatten().any(|name| list.contains(name));
        match (listed(&self.train), listed(&self.test)) {
            (true, _) => Some(Split::Train),
            (false, true) => Some(Split::Test),
            (false, false) => self.train.is_empty().then_some(Split::Train),
        }
    }
}

fn folders_below(folder: &Path, depth: usize, folders: &Folders) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for path in folders.folders(folder)? {
        let name = file_name(&path).to_lowercase();
        if name.contains("truth") || is_own_folder(&path) {
            continue;
        }
        found.push(path.clone());
        if depth > 1 {
            found.extend(folders_below(&path, depth - 1, folders)?);
        }
    }
    Ok(found)
}

/// Numbers images of equal names, without using the name of another image.
fn with_distinct_names(mut images: Vec<ImageEntry>) -> Vec<ImageEntry> {
    let given: BTreeSet<String> = images.iter().map(|image| image.name.clone()).collect();
    let mut taken = BTreeSet::new();
    for image in &mut images {
        let mut name = image.name.clone();
        let mut number = 1;
        while taken.contains(&name) || (number > 1 && given.contains(&name)) {
            number += 1;
            name = format!("{}_{number}", image.name);
        }
        taken.insert(name.clone());
        image.name = name;
    }
    images
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_one_name_get_names_that_no_other_image_has() {
        let named = |paths: &[&str]| {
            let entry = |path: &&str| ImageEntry {
                name: stem(Path::new(path)),
                path: PathBuf::from(path),
                split: Split::Train,
                json: None,
                said: None,
                tiles: ImageFiles::one(PathBuf::from(path)),
                multispectral: None,
            };
            let images = with_distinct_names(paths.iter().map(entry).collect());
            images.into_iter().map(|image| image.name).collect::<Vec<_>>()
        };
        assert_eq!(named(&["x/a.tif", "y/a.tif", "z/a_2.tif"]), ["a", "a_3", "a_2"]);
        assert_eq!(named(&["z/a_2.tif", "x/a.tif", "y/a.tif"]), ["a_2", "a", "a_3"]);
        assert_eq!(named(&["x/a.tif", "y/a.tif", "z/a.tif"]), ["a", "a_2", "a_3"]);
    }
}
