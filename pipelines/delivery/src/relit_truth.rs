//! Truth for relighting: images from straight above under suns that no image of the scene had.
//!
//! A folder contains `relit.json`, a list of `{sun_azimuth_deg, sun_elevation_deg}`, and for each entry K, counted from
//! zero, the georeferenced rasters `relit_K.tif` (linear counts, the scene's bands) and `relit_K_shadow.tif` (1 = in
//! cast shadow).

use super::{Result, SceneError};
use heliosplat_rpc::sun::SunPosition;
use std::path::{Path, PathBuf};

/// Name of the list of suns.
pub(super) const LIST: &str = "relit.json";
/// Largest number of suns in a list.
const MOST_SUNS: usize = 10_000;

/// Truth under one sun.
#[derive(Debug, Clone, PartialEq)]
pub struct RelitTruth {
    /// Position of the sun.
    pub sun: SunPosition,
    /// Path of the image, linear counts in the scene's bands.
    pub image: PathBuf,
    /// Path of the shadow mask (1 = in cast shadow).
    pub shadow: PathBuf,
}

#[derive(serde::Deserialize)]
struct Entry {
    sun_azimuth_deg: f64,
    sun_elevation_deg: f64,
}

/// Truth for relighting in a folder, in the order of its list.
///
/// # Errors
/// [`SceneError::Unreadable`] without a readable `relit.json`, [`SceneError::Manifest`] where it is no list of suns,
/// and [`SceneError::MissingImage`] where a raster is missing.
pub fn relit_truth(folder: &Path) -> Result<Vec<RelitTruth>> {
    let list = folder.join(LIST);
    let text = heliosplat_raster::bounded::read_text(&list)
        .map_err(|error| SceneError::Unreadable(list.clone(), error.to_string()))?;
    let fault = |reason: String| SceneError::Manifest(list.clone(), reason);
    let entries: Vec<Entry> = serde_json::from_str(&text).map_err(|error| fault(error.to_string()))?;
    if !(1..=MOST_SUNS).contains(&entries.len()) {
        let count = entries.len();
        return Err(fault(format!("lists {count} suns; 1 to {MOST_SUNS} are read")));
    }
    let truth = |(number, entry): (usize, Entry)| {
        let here = |name: String| match folder.join(&name) {
            path if path.is_file() => Ok(path),
            _ => Err(SceneError::MissingImage(name, list.clone())),
        };
        Ok(RelitTruth {
            sun: SunPosition::stated(entry.sun_azimuth_deg, entry.sun_elevation_deg).map_err(fault)?,
            image: here(format!("relit_{number}.tif"))?,
            shadow: here(format!("relit_{number}_shadow.tif"))?,
        })
    };
    entries.into_iter().enumerate().map(truth).collect()
}

/// The folder of a truth raster, or else the scene's `truth` folder, if it contains truth for relighting.
pub(super) fn folder_of(dsm: Option<&Path>, home: &Path) -> Option<PathBuf> {
    let beside = dsm.and_then(Path::parent).map(Path::to_owned);
    let mut folders = beside.into_iter().chain([home.join("truth")]);
    folders.find(|folder| folder.join(LIST).is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_says_the_suns_and_its_rasters_must_be_there() {
        let home = tempfile::tempdir().expect("a folder");
        let folder = home.path();
        assert!(relit_truth(folder).is_err());
        let list = |text: &str| std::fs::write(folder.join(LIST), text).expect("written");
        list(r#"[{"sun_azimuth_deg": 120, "sun_elevation_deg": 30.5}]"#);
        let missing = relit_truth(folder).expect_err("no rasters").to_string();
        assert!(missing.contains("relit_0.tif"), "{missing}");
        for name in ["relit_0.tif", "relit_0_shadow.tif"] {
            std::fs::write(folder.join(name), "x").expect("written");
        }
        let truth = relit_truth(folder).expect("a list");
        assert_eq!(truth.len(), 1);
        assert!((truth[0].sun.elevation_rad.to_degrees() - 30.5).abs() < 1e-9);
        for bad in ["[]", "{}", r#"[{"sun_azimuth_deg": 1}]"#] {
            list(bad);
            let said = relit_truth(folder).expect_err(bad).to_string();
            assert!(said.contains(LIST) && !said.contains('\n'), "{said}");
        }
    }
}
