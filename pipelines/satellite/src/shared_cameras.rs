//! Pointing corrections for the images of an area that is trained in tiles: ties of patches all over it, and one
//! solution.
//!
//! Separately corrected tiles have different datums, since the ties of one tile leave some directions open. One
//! solution has one gauge, and an image that a tile shows in a corner is corrected by all of its ground.

use crate::adjust::{AdjustInput, contradictions};
use crate::config::SatelliteConfig;
use crate::error::SatelliteError;
use crate::ground::GroundViews;
use crate::plan::Decisions;
use crate::preprocess::{clear_rasters, worth_correcting};
use heliosplat_rpc::adjust::{AdjustImage, AdjustOptions, Adjustment, BiasModel, Sighting, Track, adjust};
use heliosplat_rpc::{ImagePoint, LocalFrame};
use heliosplat_scene::{AreaRequest, Cut, Index, IngestOptions, Scene, SceneError};
use heliosplat_session::Session;
use std::collections::BTreeMap;

/// Pointing corrections of an area.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SharedCameras {
    /// Columns and rows by image name, pixels; images without ties are missing.
    pub shifts_px: BTreeMap<String, [f32; 2]>,
    /// Names of the images that are left out: their ties contradict their cameras.
    #[serde(default)]
    pub left_out: Vec<String>,
    /// Number of ties.
    pub ties: usize,
    /// Number of patches with ties.
    pub patches: usize,
    /// Standard deviation of a good sighting along one axis, pixels.
    pub sigma_px: Option<f64>,
}

/// Corrections that make the training images agree on the ties of all `patches`; none, with a warning, where the ties
/// are too few.
///
/// # Errors
/// When an image cannot be read, or the user stops the search.
pub fn shared_cameras(
    index: &Index,
    options: &IngestOptions,
    patches: &[AreaRequest],
    config: &SatelliteConfig,
    session: &Session,
) -> Result<SharedCameras, SatelliteError> {
    session.stop_gently();
    let progress = session.progress("adjust", patches.len() as u64);
    let mut found = SharedCameras::default();
    let mut tracks = Vec::new();
    for (done, patch) in patches.iter().enumerate() {
        if session.stopped() {
            return Err(SatelliteError::Stopped);
        }
        let options = IngestOptions {
            area: Some(patch.clone()),
            ..options.clone()
        };
        let ties = ties_of(index, &options, config)?;
        tracing::info!("patch {} of {}: {} ties", done + 1, patches.len(), ties.len());
        found.patches += usize::from(!ties.is_empty());
        tracks.extend(ties);
        progress.set(done as u64 + 1);
    }
    drop(progress);
    found.ties = tracks.len();
    let solved = match tracks.first() {
        Some(first) => solve(index, &tracks, &LocalFrame::new(first.near)).map_err(|error| error.to_string()),
        None => Err("no patch has any".to_owned()),
    };
    match solved {
        Ok(solved) => {
            let shifts = solved
                .corrections
                .iter()
                .map(|correction| correction.shift_px.map(|v| v as f32));
            let shifts = worth_correcting(shifts.collect(), config.cameras.align);
            let pixels: Vec<usize> = index.images.iter().map(|image| image.size.0 * image.size.1).collect();
            for contradiction in contradictions(&pixels, &solved) {
                let name = &index.images[contradiction.image].name;
                // Only parts of the images were searched, so the lack of ties is no contradiction.
                if contradiction.sightings > 0 {
                    tracing::warn!("{}", contradiction.message(name));
                    found.left_out.extend(contradiction.is_out.then(|| name.clone()));
                }
            }
            let tied = index.images.iter().zip(&solved.images).zip(shifts);
            let tied = tied.filter(|((_, residuals), _)| residuals.sightings > 0);
            found.shifts_px = tied.map(|((image, _), shift)| (image.name.clone(), shift)).collect();
            found.sigma_px = Some(solved.sigma_px);
        }
        Err(error) => tracing::warn!("too few tie points to correct the cameras ({error}); they are used as delivered"),
    }
    Ok(found)
}

fn solve(index: &Index, tracks: &[Track], frame: &LocalFrame) -> Result<Adjustment, heliosplat_rpc::RpcError> {
    let images = index.images.iter().map(|image| AdjustImage {
        rpc: &image.rpc,
        width: image.size.0,
        height: image.size.1,
    });
    let images: Vec<AdjustImage> = images.collect();
    adjust(&images, tracks, frame, AdjustOptions::default())
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
