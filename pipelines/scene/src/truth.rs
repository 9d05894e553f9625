//! Truth that comes with a scene: our own `truth/` folder, or the rasters of Sat-NeRF, EOGS and DFC2019.

use super::files::{file_name, files_in, has_extension, is_truth, neighbours, stem};
use super::{Scene, Truth};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Looks for truth in the scene's `truth` folder and its own, then in truth folders beside it, where only rasters
/// that bear the scene's name are taken.
pub(super) fn find(home: &Path) -> Truth {
    let scene = file_name(&home.canonicalize().unwrap_or_else(|_| home.to_owned()));
    for folder in [home.join("truth"), home.to_owned()] {
        let truth = in_folder(&folder, &scene, true);
        if truth.dsm.is_some() || !truth.shadows.is_empty() {
            return truth;
        }
    }
    for folder in neighbours(home) {
        let tail: Vec<_> = folder.components().rev().take(2).collect();
        let is_truth_folder =
            |part: &std::path::Component| part.as_os_str().to_string_lossy().to_lowercase().contains("truth");
        if tail.iter().any(is_truth_folder) {
            let truth = in_folder(&folder, &scene, false);
            if truth.dsm.is_some() {
                return truth;
            }
        }
    }
    Truth::default()
}

fn in_folder(folder: &Path, scene: &str, own_folder: bool) -> Truth {
    let rasters: Vec<PathBuf> = files_in(folder)
        .unwrap_or_default()
        .into_iter()
        .filter(|path| has_extension(path, &["tif", "tiff"]) && is_truth(path))
        .collect();
    // A folder of many scenes' truth has one raster per scene: the one of this scene counts.
    let pick = |own: &str, ends: &[&str]| -> Option<PathBuf> {
        let named = |name: String| {
            rasters
                .iter()
                .find(|path| stem(path).eq_ignore_ascii_case(&name))
                .cloned()
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
    }
}

impl Scene {
    /// The error that was put into each image's camera (columns, rows, pixels), by its name; `None` where the scene does not know.
    pub fn true_camera_biases_px(&self) -> Option<BTreeMap<String, [f64; 2]>> {
        #[derive(serde::Deserialize)]
        struct Summary {
            images: Vec<Made>,
        }
        #[derive(serde::Deserialize)]
        struct Made {
            name: String,
            pointing_bias_px: [f64; 2],
        }
        let text = heliosplat_raster::bounded::read_text(&self.source.join("truth/summary.json")).ok()?;
        let summary: Summary = serde_json::from_str(&text).ok()?;
        let made = summary.images.into_iter();
        Some(made.map(|image| (image.name, image.pointing_bias_px)).collect())
    }
}
