//! Which files make up a scene: a `scene.toml`, a folder of images, or the folders of Sat-NeRF and EOGS, where images,
//! cameras (JSON) and truth may lie in folders of their own.

use super::files::{IMAGE_EXTENSIONS, entries_of, file_name, has_extension, images_in, neighbours, stem};
use super::manifest::{Counts, Manifest, ManifestImage, reject_address};
use super::satnerf::{self, JsonIndex};
use super::{BandKind, SceneError, Split, Truth};
use heliosplat_raster::{is_virtual, list_virtual};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// An image to read, and what was said about it outside of it.
#[derive(Debug, Clone)]
pub(super) struct ImageEntry {
    pub(super) name: String,
    pub(super) path: PathBuf,
    pub(super) split: Split,
    /// Sat-NeRF-like JSON that names it.
    pub(super) json: Option<PathBuf>,
    /// What `scene.toml` says of it.
    pub(super) said: Option<ManifestImage>,
}

/// The files of a scene.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    pub(super) images: Vec<ImageEntry>,
    pub(super) altitude_range_m: Option<(f64, f64)>,
    pub(super) bands: Option<Vec<BandKind>>,
    pub(super) counts: Option<Counts>,
    pub(super) truth: Truth,
    pub(super) warnings: Vec<String>,
}

/// Folders of a scene in which its images may lie.
const IMAGE_FOLDERS: [&str; 3] = ["images", "img", "imgs"];

/// Finds the files of the scene at `path`.
pub(super) fn find(path: &Path) -> Result<Layout, SceneError> {
    if is_virtual(path) {
        return from_virtual_folder(path);
    }
    reject_address(path)?;
    if path.is_file() {
        return if has_extension(path, &["toml"]) {
            from_manifest(path)
        } else {
            Err(SceneError::Manifest {
                path: path.to_owned(),
                reason: "a scene is a folder of images or a scene.toml; give the folder this file is in".to_owned(),
            })
        };
    }
    if !path.is_dir() {
        return Err(if path.exists() {
            SceneError::Unreadable {
                path: path.to_owned(),
                reason: "it is a device or a pipe; give a folder of images or a scene.toml".to_owned(),
            }
        } else {
            SceneError::Missing(path.to_owned())
        });
    }
    let manifest = path.join("scene.toml");
    if manifest.exists() {
        from_manifest(&manifest)
    } else {
        from_folder(path)
    }
}

/// A folder on one of GDAL's virtual file systems, which the user named: its images, with the cameras and dates that GDAL finds there.
fn from_virtual_folder(folder: &Path) -> Result<Layout, SceneError> {
    let entry = |path: PathBuf| ImageEntry {
        name: stem(&path),
        split: Split::Train,
        json: None,
        said: None,
        path,
    };
    let files = list_virtual(folder)?;
    let images: Vec<ImageEntry> = files
        .into_iter()
        .filter(|path| has_extension(path, &IMAGE_EXTENSIONS))
        .map(entry)
        .collect();
    if images.is_empty() {
        return Err(SceneError::Empty(folder.to_owned()));
    }
    Ok(Layout {
        images: with_distinct_names(images),
        altitude_range_m: None,
        bands: None,
        counts: None,
        truth: Truth::default(),
        warnings: Vec::new(),
    })
}

fn from_manifest(path: &Path) -> Result<Layout, SceneError> {
    let manifest = Manifest::read(path)?;
    let images = manifest
        .images
        .iter()
        .map(|image| ImageEntry {
            name: stem(&image.path),
            path: image.path.clone(),
            split: image.split.unwrap_or(Split::Train),
            json: satnerf::beside(&image.path),
            said: Some(image.clone()),
        })
        .collect();
    let truth = match manifest.truth {
        Some(truth) => Truth {
            dsm: truth.dsm,
            classes: truth.classes,
            shadows: truth.shadows.into_iter().collect(),
        },
        None => super::truth::find(path.parent().unwrap_or_else(|| Path::new("."))),
    };
    Ok(Layout {
        images: with_distinct_names(images),
        altitude_range_m: manifest.altitude_range_m.map(|[low, high]| (low, high)),
        bands: manifest.bands,
        counts: manifest.counts,
        truth,
        warnings: Vec::new(),
    })
}

fn from_folder(folder: &Path) -> Result<Layout, SceneError> {
    let home = scene_folder(folder)?;
    let mut images = images_in(&home)?;
    let mut index = JsonIndex::read(&home)?;
    for name in IMAGE_FOLDERS {
        if images.is_empty() {
            images = images_in(&home.join(name))?;
        }
    }
    let lists = SplitLists::read(&home)?;
    if images.is_empty() && !index.is_empty() {
        images = index.find_images(&home)?;
    } else if index.is_empty() {
        // Images of Sat-NeRF or EOGS given without the folder of their JSONs: look beside.
        for neighbour in neighbours(&home) {
            index.extend(JsonIndex::read(&neighbour)?.restricted_to(&images));
        }
    }
    if images.is_empty() {
        return Err(SceneError::Empty(folder.to_owned()));
    }
    let lists = match (lists, index.folder()) {
        (None, Some(json_folder)) => SplitLists::read(json_folder)?,
        (lists, _) => lists,
    };
    let mut warnings = Vec::new();
    let entries = images
        .into_iter()
        .filter_map(|path| {
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
                name: stem(&path),
                split: split?,
                path,
                json,
                said: None,
            })
        })
        .collect();
    Ok(Layout {
        images: with_distinct_names(entries),
        altitude_range_m: None,
        bands: None,
        counts: None,
        truth: super::truth::find(&home),
        warnings,
    })
}

/// The folder that holds the scene: `folder` itself, or the only folder below it that looks like one.
fn scene_folder(folder: &Path) -> Result<PathBuf, SceneError> {
    let looks_like_scene = |folder: &Path| -> Result<bool, SceneError> {
        Ok(!images_in(folder)?.is_empty() || !JsonIndex::read(folder)?.is_empty())
    };
    if looks_like_scene(folder)? {
        return Ok(folder.to_owned());
    }
    for name in IMAGE_FOLDERS {
        if !images_in(&folder.join(name))?.is_empty() {
            return Ok(folder.to_owned());
        }
    }
    const DEEPEST: usize = 4;
    let below = folders_below(folder, DEEPEST)?;
    let mut with_cameras = Vec::new();
    let mut with_images = Vec::new();
    for candidate in below {
        if !JsonIndex::read(&candidate)?.is_empty() {
            with_cameras.push(candidate);
        } else if !images_in(&candidate)?.is_empty() {
            with_images.push(candidate);
        }
    }
    let mut candidates = if with_cameras.is_empty() {
        with_images
    } else {
        with_cameras
    };
    match candidates.len() {
        0 => Err(SceneError::Empty(folder.to_owned())),
        1 => Ok(candidates.remove(0)),
        _ => {
            let names: Vec<String> = candidates.iter().map(|path| path.display().to_string()).collect();
            Err(SceneError::Several {
                path: folder.to_owned(),
                candidates: names.join(", "),
            })
        }
    }
}

/// `train.txt` and `test.txt` of Sat-NeRF: names of images or of their JSONs, one per line.
struct SplitLists {
    train: Vec<String>,
    test: Vec<String>,
}

impl SplitLists {
    fn read(folder: &Path) -> Result<Option<Self>, SceneError> {
        let read = |name: &str| -> Result<Option<Vec<String>>, SceneError> {
            let path = folder.join(name);
            if !path.is_file() {
                return Ok(None);
            }
            let text = heliosplat_raster::bounded::read_text_lossy(&path).map_err(|error| SceneError::Unreadable {
                path,
                reason: error.to_string(),
            })?;
            let names = text.lines().map(str::trim).filter(|line| !line.is_empty());
            Ok(Some(names.map(|name| stem(Path::new(name))).collect()))
        };
        let (train, test) = (read("train.txt")?, read("test.txt")?);
        if train.is_none() && test.is_none() {
            return Ok(None);
        }
        Ok(Some(Self {
            train: train.unwrap_or_default(),
            test: test.unwrap_or_default(),
        }))
    }

    /// The split of an image; a list of tests alone leaves all others to training.
    fn split_of(&self, image: &Path, json: Option<&Path>) -> Option<Split> {
        let names = [Some(stem(image)), json.map(stem)];
        let listed = |list: &[String]| names.iter().flatten().any(|name| list.contains(name));
        if listed(&self.train) || (self.train.is_empty() && !listed(&self.test)) {
            Some(Split::Train)
        } else if listed(&self.test) {
            Some(Split::Test)
        } else {
            None
        }
    }
}

fn folders_below(folder: &Path, depth: usize) -> Result<Vec<PathBuf>, SceneError> {
    let mut found = Vec::new();
    for path in entries_of(folder)?.into_iter().filter(|path| path.is_dir()) {
        let name = file_name(&path).to_lowercase();
        if name.contains("truth") {
            continue;
        }
        found.push(path.clone());
        if depth > 1 {
            found.extend(folders_below(&path, depth - 1)?);
        }
    }
    Ok(found)
}

fn with_distinct_names(mut images: Vec<ImageEntry>) -> Vec<ImageEntry> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    for image in &mut images {
        let count = seen.entry(image.name.clone()).or_insert(0);
        *count += 1;
        if *count > 1 {
            image.name = format!("{}_{count}", image.name);
        }
    }
    images
}
