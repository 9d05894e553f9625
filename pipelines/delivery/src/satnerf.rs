//! JSON files of Sat-NeRF and EOGS: name and altitudes of each image.

use super::files::{Folders, neighbours};
use super::names::{file_name, has_extension, stem};
use super::{Result, SceneError};
use heliosplat_raster::RasterFile;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Fields of a Sat-NeRF JSON that describe the image; its camera and sun are read by `heliosplat_rpc`.
#[derive(Debug, Clone, serde::Deserialize)]
struct Description {
    img: String,
    #[serde(default, deserialize_with = "lenient_number")]
    width: Option<f64>,
    #[serde(default, deserialize_with = "lenient_number")]
    height: Option<f64>,
    #[serde(default, deserialize_with = "lenient_number")]
    min_alt: Option<f64>,
    #[serde(default, deserialize_with = "lenient_number")]
    max_alt: Option<f64>,
    rpc: serde::de::IgnoredAny,
}

fn lenient_number<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    let value: serde_json::Value = serde::Deserialize::deserialize(deserializer)?;
    Ok(match value {
        serde_json::Value::Number(number) => number.as_f64(),
        serde_json::Value::String(text) => text.trim().parse().ok(),
        _ => None,
    })
}

fn describe(path: &Path, folders: &Folders) -> Option<Description> {
    description(&folders.text(path).ok()?)
}

fn description(text: &str) -> Option<Description> {
    let description: Description = serde_json::from_str(text).ok()?;
    let _ = &description.rpc;
    Some(description)
}

/// Name of the image in the text of a Sat-NeRF JSON, and the lowest and highest altitude there, metres; `None` where
/// the text is no such JSON.
pub(super) fn image_and_altitudes(text: &str) -> Option<(String, [Option<f64>; 2])> {
    let description = description(text)?;
    Some((description.img, [description.min_alt, description.max_alt]))
}

/// The Sat-NeRF JSON beside an image, under the image's name; `None` where there is none.
pub(super) fn json_of(image: &Path, folders: &Folders) -> Option<PathBuf> {
    let json = image.with_extension("json");
    (json.is_file() && describe(&json, folders).is_some()).then_some(json)
}

/// Lowest and highest altitude in a Sat-NeRF JSON, metres; `None` where one is missing.
pub(super) fn altitude_range(json: &Path, folders: &Folders) -> Option<(f64, f64)> {
    let description = describe(json, folders)?;
    Some((description.min_alt?, description.max_alt?))
}

/// The Sat-NeRF JSONs of a folder, by the stem of the image they describe.
#[derive(Debug, Default)]
pub(super) struct JsonIndex {
    by_image: BTreeMap<String, (PathBuf, String)>,
}

impl JsonIndex {
    /// Reads all JSONs directly in a folder; JSONs that describe no image are ignored.
    pub(super) fn read(folder: &Path, folders: &Folders) -> Result<Self> {
        let mut index = Self::default();
        for path in folders.files(folder)? {
            if has_extension(&path, &["json"])
                && let Some(description) = describe(&path, folders)
            {
                let image = stem(Path::new(&description.img));
                index.by_image.insert(image, (path, description.img));
            }
        }
        Ok(index)
    }

    /// True if no JSON of the folder describes an image.
    pub(super) fn is_empty(&self) -> bool {
        self.by_image.is_empty()
    }

    /// Keeps the JSONs that describe one of `images`, by its whole file name.
    pub(super) fn restricted_to(mut self, images: &[PathBuf]) -> Self {
        let names: BTreeSet<String> = images.iter().map(|image| file_name(image)).collect();
        self.by_image
            .retain(|_, (_, image)| names.contains(&file_name(Path::new(image))));
        self
    }

    /// Number of `images` that a JSON of this index describes.
    pub(super) fn count_of(&self, images: &[PathBuf]) -> usize {
        let is_known = |image: &&PathBuf| self.by_image.contains_key(&stem(image));
        images.iter().filter(is_known).count()
    }

    /// True if both indices describe an image of the same name.
    pub(super) fn shares_an_image(&self, other: &Self) -> bool {
        self.by_image.keys().any(|image| other.by_image.contains_key(image))
    }

    /// The folder of the first JSON; `None` for an empty index.
    pub(super) fn folder(&self) -> Option<&Path> {
        self.by_image.values().next().and_then(|(json, _)| json.parent())
    }

    /// The JSON that describes an image, by the image's stem.
    pub(super) fn json_of(&self, image: &Path) -> Option<PathBuf> {
        self.by_image.get(&stem(image)).map(|(json, _)| json.clone())
    }

    /// Finds the described images in another folder near `home`; fails with `SceneError::MissingImage` where one is not
    /// found.
    pub(super) fn find_images(&self, home: &Path, folders: &Folders) -> Result<Vec<PathBuf>> {
        let mut available: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
        for folder in neighbours(home, folders) {
            for image in folders.images(&folder)? {
                available.entry(file_name(&image)).or_default().push(image);
            }
        }
        let mut found = Vec::new();
        for (json, image) in self.by_image.values() {
            let paths = available.get(&file_name(Path::new(image)));
            let paths = paths.ok_or_else(|| SceneError::MissingImage(image.clone(), json.clone()))?;
            found.push(of_stated_size(paths, json, folders).clone());
        }
        Ok(found)
    }
}

/// The first of several images of one name whose size is that in the JSON, else the first image: crops have the names
/// of the whole images.
fn of_stated_size<'a>(paths: &'a [PathBuf], json: &Path, folders: &Folders) -> &'a PathBuf {
    let stated = || {
        let description = describe(json, folders)?;
        Some((description.width? as usize, description.height? as usize))
    };
    let fitting = match paths {
        [_] => None,
        _ => stated().and_then(|stated| {
            let fits = |path: &&PathBuf| RasterFile::open(path).is_ok_and(|file| file.size() == stated);
            paths.iter().find(fits)
        }),
    };
    fitting.unwrap_or(&paths[0])
}
