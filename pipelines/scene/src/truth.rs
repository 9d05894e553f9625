//! Truth that comes with a scene: our own `truth/` folder, or the rasters of Sat-NeRF, EOGS and DFC2019.

use super::files::{file_name, files_in, has_extension, is_truth, neighbours, stem};
use super::{Area, Scene, Truth, relit_truth};
use heliosplat_raster::{Crs, CrsTransform, GeoTransform, RasterFile};
use heliosplat_rpc::{GeoPoint, LocalFrame};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Looks for truth in the scene's `truth` folder and its own, then in truth folders beside it, where only rasters
/// that bear the scene's name are taken: that of its folder, or what the names of its images begin with.
pub(super) fn find_for(home: &Path, images: &[String]) -> Truth {
    let folder = file_name(&home.canonicalize().unwrap_or_else(|_| home.to_owned()));
    let named_by_folder = find(home, &folder);
    let truth = match area_of(images) {
        Some(area) if named_by_folder.dsm.is_none() && area != folder => find(home, &area),
        _ => named_by_folder,
    };
    Truth {
        relit: relit_truth::folder_of(truth.dsm.as_deref(), home),
        ..truth
    }
}

impl Truth {
    /// The map of changes beside the surface model, `change.tif`, if there is one.
    pub fn changes(&self) -> Option<PathBuf> {
        self.beside("change.tif")
    }

    /// The surface model at the time of the first image beside the one at the last, `dsm_before.tif`, if there is one.
    pub fn before(&self) -> Option<PathBuf> {
        self.beside("dsm_before.tif")
    }

    fn beside(&self, name: &str) -> Option<PathBuf> {
        let path = self.dsm.as_ref()?.with_file_name(name);
        path.is_file().then_some(path)
    }
}

/// What the names of all images begin with, up to an underscore: `JAX_068` of `JAX_068_001_RGB` and `JAX_068_012_RGB`.
fn area_of(images: &[String]) -> Option<String> {
    let first = images.first()?;
    let shared = images.iter().fold(first.as_str(), |shared, name| {
        let same = shared.chars().zip(name.chars()).take_while(|(a, b)| a == b);
        &shared[..same.map(|(a, _)| a.len_utf8()).sum()]
    });
    let area = &shared[..shared.rfind('_')?];
    (images.len() > 1 && !area.is_empty()).then(|| area.to_owned())
}

fn find(home: &Path, scene: &str) -> Truth {
    for folder in [home.join("truth"), home.to_owned()] {
        let truth = in_folder(&folder, scene, true);
        if truth.dsm.is_some() || !truth.shadows.is_empty() {
            return truth;
        }
    }
    for folder in neighbours(home) {
        let tail: Vec<_> = folder.components().rev().take(2).collect();
        let is_truth_folder =
            |part: &std::path::Component| part.as_os_str().to_string_lossy().to_lowercase().contains("truth");
        if tail.iter().any(is_truth_folder) {
            let truth = in_folder(&folder, scene, false);
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
        relit: None,
    }
}

/// Takes out truth that lies on other ground than the scene, and says so. Truth without a place of its own is left to whoever reads it.
pub(super) fn keep_if_here(truth: &mut Truth, frame: &LocalFrame, area: &Area, warnings: &mut Vec<String>) {
    let Some(path) = truth.dsm.as_deref() else { return };
    let Some(ground) = ground_of(path, frame) else { return };
    if ground.intersection(area).is_none() {
        warnings.push(format!(
            "{}: this truth lies on other ground than the scene, left out",
            path.display()
        ));
        truth.dsm = None;
        truth.classes = None;
        truth.relit = None;
    }
}

/// The rectangle of the frame that holds a truth raster; `None` where the raster or its place cannot be read.
fn ground_of(path: &Path, frame: &LocalFrame) -> Option<Area> {
    let file = RasterFile::open(path).ok()?;
    let (width, height) = file.size();
    let transform = match file.geo_transform() {
        Some(transform) => transform,
        None => {
            let text = heliosplat_raster::bounded::read_text(&path.with_extension("txt")).ok()?;
            GeoTransform::from_region_text(&text, height)?
        }
    };
    let crs = match file.crs() {
        Some(crs) => crs,
        None => Crs::utm(frame.origin).ok()?,
    };
    let to_lon_lat = CrsTransform::to_lon_lat(&crs).ok()?;
    let mut area: Option<Area> = None;
    let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
    for (col, row) in [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)] {
        let [x, y] = transform.map_from_pixel(col, row);
        let (lon_deg, lat_deg) = to_lon_lat.apply(x, y).ok()?;
        let at = frame.enu_from_geo(GeoPoint {
            lon_deg,
            lat_deg,
            height_m: frame.origin.height_m,
        });
        let known = area.get_or_insert(Area {
            west_m: at.x,
            south_m: at.y,
            east_m: at.x,
            north_m: at.y,
        });
        known.west_m = known.west_m.min(at.x);
        known.east_m = known.east_m.max(at.x);
        known.south_m = known.south_m.min(at.y);
        known.north_m = known.north_m.max(at.y);
    }
    area.filter(|area| area.west_m.is_finite() && area.north_m.is_finite())
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
