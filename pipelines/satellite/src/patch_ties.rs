//! Ties of patches of an area, in pixels of the image files, and the file that keeps them.
//!
//! Searches in patches are independent of each other, so that several processes share them; one adjustment reads the
//! ties of all.

use crate::adjust::{AdjustInput, TILES};
use crate::config::SatelliteConfig;
use crate::error::SatelliteError;
use crate::ground::GroundViews;
use crate::plan::Decisions;
use crate::preprocess::clear_rasters;
use heliosplat_raster::bounded::{MODEL_MAX, read_bytes};
use heliosplat_raster::write_atomically;
use heliosplat_rpc::ImagePoint;
use heliosplat_rpc::adjust::{BiasModel, Sighting, Track};
use heliosplat_scene::{AreaRequest, Cut, Index, IngestOptions, Scene, SceneError};
use heliosplat_session::Session;
use std::collections::BTreeMap;
use std::path::Path;

/// Approximate largest number of ties of a patch.
pub const MOST_TIES: usize = TILES[1];

/// Ties of patches of ground, by patch; their images are those of the index.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct PatchTies(pub Vec<Vec<Track>>);

impl PatchTies {
    /// Searches the ties of all `patches`.
    ///
    /// # Errors
    /// When an image cannot be read, or the user stops the search.
    pub fn find(
        index: &Index,
        options: &IngestOptions,
        patches: &[AreaRequest],
        config: &SatelliteConfig,
        session: &Session,
    ) -> Result<Self, SatelliteError> {
        session.stop_gently();
        let progress = session.progress("ties", patches.len() as u64);
        let mut found = Self::default();
        for patch in patches {
            if session.stopped() {
                return Err(SatelliteError::Stopped);
            }
            let options = IngestOptions {
                area: Some(patch.clone()),
                ..options.clone()
            };
            let ties = ties_of(index, &options, config)?;
            tracing::info!("patch {} of {}: {} ties", found.0.len() + 1, patches.len(), ties.len());
            found.0.push(ties);
            progress.set(found.0.len() as u64);
        }
        Ok(found)
    }

    /// Number of ties.
    pub fn count(&self) -> usize {
        self.0.iter().map(Vec::len).sum()
    }

    /// Writes the ties in the order of the search, so that their file has the same bytes for any number of threads.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), SatelliteError> {
        Ok(write_atomically(path, &self.to_bytes()?)?)
    }

    /// Content of the file of the ties.
    ///
    /// # Errors
    /// When memory for it is lacking.
    pub fn to_bytes(&self) -> Result<Vec<u8>, SatelliteError> {
        postcard::to_stdvec(self).map_err(|error| SatelliteError::Unwritable(error.to_string()))
    }

    /// Ties from a file.
    ///
    /// # Errors
    /// When the file cannot be read, or is damaged.
    pub fn read(path: &Path) -> Result<Self, SatelliteError> {
        let failed = |reason: String| SatelliteError::Input(format!("{}: {reason}", path.display()));
        let bytes = read_bytes(path, MODEL_MAX).map_err(|error| failed(error.to_string()))?;
        Self::from_bytes(&bytes).ok_or_else(|| failed("its ties are damaged; remove it, and search them again".into()))
    }

    /// Ties from the content of their file; `None` if it is damaged.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (ties, rest) = postcard::take_from_bytes(bytes).ok()?;
        rest.is_empty().then_some(ties)
    }
}

/// Ties of a patch, in pixels of the image files; none where too few images show the patch or match there.
fn ties_of(index: &Index, options: &IngestOptions, config: &SatelliteConfig) -> Result<Vec<Track>, SatelliteError> {
    let mut cut = match Cut::of(index, options, &mut Vec::new()) {
        Err(SceneError::NotCovered(..)) => return Ok(Vec::new()),
        cut => cut?,
    };
    cut.is_part = true;
    let scene = match Scene::read(index, &cut, Vec::new()) {
        Err(SceneError::NotCovered(..)) => return Ok(Vec::new()),
        scene => scene?,
    };
    let decisions = Decisions::of(&scene, config);
    let (Ok(ground), Some(matching)) = (GroundViews::new(&scene, scene.training()), decisions.matching) else {
        return Ok(Vec::new());
    };
    let none = vec![[0.0; 2]; ground.images.len()];
    let request = ground.request(config.start.cell_gsd * scene.gsd_m, matching);
    let (rasters, _) = clear_rasters(&ground, &decisions, &none, &request);
    let input = AdjustInput {
        ground: &ground,
        views: &ground.sweep_views(&rasters, &none),
        cell_m: scene.gsd_m,
        matching,
    };
    let Ok((_, tracks)) = input.tied(BiasModel::Translation, &|_| {}) else {
        return Ok(Vec::new());
    };
    let places: BTreeMap<&str, usize> = index
        .images
        .iter()
        .zip(0..)
        .map(|(image, k)| (image.name.as_str(), k))
        .collect();
    let in_file = |sighting: &Sighting| {
        let image = ground.images.get(sighting.image)?;
        Some(Sighting {
            image: *places.get(image.name.as_str())?,
            at: ImagePoint::new(
                sighting.at.col + image.window.col0 as f64,
                sighting.at.row + image.window.row0 as f64,
            ),
            ..*sighting
        })
    };
    let track = |track: Track| Track {
        sightings: track.sightings.iter().filter_map(in_file).collect(),
        ..track
    };
    Ok(tracks.into_iter().map(track).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat_rpc::GeoPoint;

    #[test]
    fn ties_come_back_from_their_file_to_the_last_bit_and_a_damaged_file_is_refused() {
        let track = |k: usize| Track {
            near: GeoPoint::new(36.9 + 0.1 / 3.0 * k as f64, 37.5, 700.0 / 3.0),
            sightings: vec![
                Sighting {
                    image: k,
                    at: ImagePoint::new(100.0 / 3.0, 39_999.1),
                    weight: 1.0 / 7.0,
                };
                2
            ],
        };
        let ties = PatchTies(vec![vec![track(0), track(1)], Vec::new(), vec![track(200)]]);
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("ties.bin");
        ties.write(&path).expect("written");
        assert_eq!(PatchTies::read(&path).expect("readable"), ties);
        assert_eq!(ties.count(), 3);
        let bytes = std::fs::read(&path).expect("readable");
        std::fs::write(&path, &bytes[..bytes.len() - 3]).expect("written");
        let refused = PatchTies::read(&path).expect_err("half a file").to_string();
        assert!(refused.contains("ties.bin") && refused.contains("damaged"), "{refused}");
    }
}
