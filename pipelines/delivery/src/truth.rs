//! Truth of a scene: our own `truth/` folder, or the rasters of Sat-NeRF, EOGS and DFC2019.

use super::files::{Folders, neighbours, own_output};
use super::names::{file_name, has_extension, is_truth, stem};
use super::{Truth, relit_truth};
use heliosplat_raster::RasterFile;
use std::path::{Path, PathBuf};

/// Finds the truth of a scene: in the scene's `truth` folder and in the scene's own folder, then in truth folders of
/// published layouts. In the latter, only rasters with the scene's name count: the name of its folder, or the common
/// beginning of its image names.
pub(super) fn find_for(home: &Path, images: &[String], folders: &Folders, warnings: &mut Vec<String>) -> Truth {
    let folder = file_name(&home.canonicalize().unwrap_or_else(|_| home.to_owned()));
    let named_by_folder = find(home, &folder, folders, warnings);
    let truth = match area_of(images) {
        Some(area) if named_by_folder.dsm.is_none() && area != folder => find(home, &area, folders, &mut Vec::new()),
        _ => named_by_folder,
    };
    let relit = relit_truth::folder_of(truth.dsm.as_deref(), home);
    Truth { relit, ..truth }
}

impl Truth {
    /// The map of changes beside the surface model (`change.tif`), if there is one.
    pub fn changes(&self) -> Option<PathBuf> {
        self.sibling("change.tif")
    }

    /// The surface model at the time of the first image (`dsm_before.tif`, beside the surface model at the time of the
    /// last image), if there is one.
    pub fn before(&self) -> Option<PathBuf> {
        self.sibling("dsm_before.tif")
    }

    fn sibling(&self, name: &str) -> Option<PathBuf> {
        let path = self.dsm.as_ref()?.with_file_name(name);
        path.is_file().then_some(path)
    }
}

/// Common beginning of the names of all images, up to an underscore: `JAX_068` for `JAX_068_001_RGB` and
/// `JAX_068_012_RGB`.
fn area_of(images: &[String]) -> Option<String> {
    let first = images.first()?;
    let shared = images.iter().fold(first.as_str(), |shared, name| {
        let same = shared.chars().zip(name.chars()).take_while(|(a, b)| a == b);
        &shared[..same.map(|(a, _)| a.len_utf8()).sum()]
    });
    let area = &shared[..shared.rfind('_')?];
    (images.len() > 1 && !area.is_empty()).then(|| area.to_owned())
}

fn find(home: &Path, scene: &str, folders: &Folders, warnings: &mut Vec<String>) -> Truth {
    for folder in [home.join("truth"), home.to_owned()] {
        let truth = in_folder(&folder, scene, true, folders, warnings);
        if truth.dsm.is_some() || !truth.shadows.is_empty() {
            return truth;
        }
    }
    for folder in neighbours(home, folders) {
        let tail: Vec<_> = folder.components().rev().take(2).collect();
        let is_truth_folder =
            |part: &std::path::Component| part.as_os_str().to_string_lossy().to_lowercase().contains("truth");
        if tail.iter().any(is_truth_folder) {
            let truth = in_folder(&folder, scene, false, folders, &mut Vec::new());
            if truth.dsm.is_some() {
                return truth;
            }
        }
    }
    Truth::default()
}

fn in_folder(folder: &Path, scene: &str, own_folder: bool, folders: &Folders, warnings: &mut Vec<String>) -> Truth {
    let files = folders.files(folder).unwrap_or_default().into_iter();
    let is_raster = |path: &PathBuf| has_extension(path, &["tif", "tiff"]) && is_truth(path);
    let mut rasters: Vec<PathBuf> = files.filter(is_raster).collect();
    // This program writes no folder with the truth of several scenes.
    if own_folder {
        rasters.retain(|path| {
            let own = RasterFile::open(path).ok().as_ref().and_then(own_output);
            let is_other = own.is_none();
            warnings.extend(own);
            is_other
        });
    }
    // A folder with the truth of several scenes has one raster per scene; the raster with this scene's name is used.
    let pick = |own: &str, ends: &[&str]| -> Option<PathBuf> {
        let named = |name: String| {
            let named = rasters.iter().find(|path| stem(path).eq_ignore_ascii_case(&name));
            named.cloned()
        };
        let by_scene = ends.iter().find_map(|end| named(format!("{scene}{end}")));
        if !own_folder {
            return by_scene;
        }
        named(own.to_owned()).or(by_scene).or_else(|| {
            let mut fitting = rasters.iter().filter(|path| {
                let name = stem(path).to_lowercase();
                ends.iter().any(|end| name.ends_with(&end.to_lowercase()))
            });
            match (fitting.next(), fitting.next()) {
                (Some(only), None) => Some(only.clone()),
                _ => None,
            }
        })
    };
    let shadows = rasters.iter().filter_map(|path| {
        let name = stem(path);
        Some((name.strip_prefix("shadow_")?.to_owned(), path.clone()))
    });
    Truth {
        dsm: pick("dsm", &["_DSM"]),
        classes: pick("classes", &["_CLS_v2", "_CLS"]),
        shadows: shadows.collect(),
        relit: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_is_what_all_names_begin_with() {
        let of = |names: &[&str]| area_of(&names.iter().map(|&name| name.to_owned()).collect::<Vec<_>>());
        assert_eq!(of(&["JAX_068_001_RGB", "JAX_068_012_RGB"]).as_deref(), Some("JAX_068"));
        assert_eq!(of(&["JAX_068_001_RGB", "JAX_214_001_RGB"]).as_deref(), Some("JAX"));
        assert_eq!(of(&["a_1"]), None);
        assert_eq!(of(&["_1", "_2"]), None);
        assert_eq!(of(&["left", "right"]), None);
        assert_eq!(of(&["é_1", "è_1"]), None);
    }
}
