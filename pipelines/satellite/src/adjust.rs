//! Camera adjustment of a scene: ties between its images, corrections of their pointing, and corrected cameras as
//! files.
//!
//! Ties need cameras that agree to a few pixels and a surface of that accuracy, so pointing is estimated from coarse to
//! fine: shifts from a coarse sweep, then ties and an adjustment at half and at full resolution. Coarse shifts can be
//! wrong (little texture, few views), so the adjustment at half resolution also runs without them. Where the two differ
//! by a pixel, both go on to full resolution: a small image has too few ties at half resolution to decide. Where an
//! image has so few that both can be wrong, the cameras as delivered are a third start. The result with more agreeing
//! ties is used.

pub mod camera_error;
mod contradiction;
mod report;
mod vectors;
mod write;

pub use contradiction::findings;
pub(crate) use contradiction::{contradictions, left_out};
pub use report::{AdjustRequest, AdjustedScene, adjust_scene};
pub use vectors::ImageVectors;

use super::error::SatelliteError;
use super::ground::GroundViews;
use heliosplat::Raster;
use heliosplat_rpc::adjust::{
    AdjustImage, AdjustOptions, Adjustment, BiasModel, Exchange, Sighting, Track, adjust, exchange,
};
use heliosplat_rpc::{ImagePoint, Rpc, RpcError};
use heliosplat_scene::Scene;
use heliosplat_stereo::pointing::align::coarse_shifts;
use heliosplat_stereo::pointing::ties::{Tie, TieOptions, find_ties};
use heliosplat_stereo::{MatchingParameters, SweepView};
use nalgebra::Vector3;

/// Approximate number of tiles of the ground, with at most one tie each, at half and at full resolution.
pub(crate) const TILES: [usize; 2] = [900, 2000];
/// Correlation at or below which a sighting has no weight.
const WORTHLESS_SCORE: f32 = 0.7;
/// Residual of tie points above which cameras contradict each other, pixels. A match is right to a fifth of a pixel:
/// sound real scenes have 0.06 to 0.24 px, four images of which two have swapped cameras 0.74 px.
const CONTRADICTORY_PX: f64 = 0.5;

/// Difference of two shifts of an image from which ties at full resolution may find other ground, pixels: within one,
/// the same patches correlate.
const APART_PX: f32 = 1.0;
/// Agreeing sightings of an image at half resolution below which its shift there may be wrong: images of some 100
/// pixels have 9 to 35 of them, those of sound real scenes hundreds.
const FEW: usize = 40;

/// An adjustment and its ties.
type Tied = (Adjustment, Vec<Track>);

/// The common ground of a scene in all of its images. Held-out images are included: their cameras have errors too.
///
/// # Errors
/// When fewer than two images show the common ground.
pub fn ground(scene: &Scene) -> Result<GroundViews<'_>, SatelliteError> {
    GroundViews::new(scene, scene.images.iter())
}

/// Input of the search for ties.
#[derive(Clone, Copy)]
pub struct AdjustInput<'a> {
    /// The ground and the images that show it.
    pub ground: &'a GroundViews<'a>,
    /// Views of the ground with the cameras as delivered.
    pub views: &'a [SweepView<'a>],
    /// Width of the cells of a patch, metres: one pixel on the ground.
    pub cell_m: f64,
    /// Parameters of the plane sweeps whose surface the ties lie on.
    pub matching: MatchingParameters,
}

/// Adjustment of the images' pointing by tie points between them. `gsd_m` is the width of a pixel on the ground, metres.
///
/// # Errors
/// [`RpcError::Invalid`] when there are too few ties.
pub(super) fn adjustment_of_ties(
    ground: &GroundViews,
    rasters: &[Raster],
    matching: MatchingParameters,
    gsd_m: f64,
) -> Result<Adjustment, RpcError> {
    let none = vec![[0.0; 2]; ground.images.len()];
    let views = ground.sweep_views(rasters, &none);
    let input = AdjustInput {
        ground,
        views: &views,
        // Cells of one pixel, even where the model's cells are coarser.
        cell_m: gsd_m,
        matching,
    };
    input.adjust(BiasModel::Translation, &|_| {})
}

impl AdjustInput<'_> {
    /// Finds ties, and the corrections that make the images agree on them; `progress` receives the completed share,
    /// 0..1.
    ///
    /// # Errors
    /// [`RpcError::Invalid`] when there are too few ties.
    pub fn adjust(&self, model: BiasModel, progress: &dyn Fn(f32)) -> Result<Adjustment, RpcError> {
        self.tied(model, progress).map(|(adjustment, _)| adjustment)
    }

    /// Finds ties and corrections; returns both. Sightings of the ties are in pixels of the windows that were read.
    ///
    /// # Errors
    /// [`RpcError::Invalid`] when there are too few ties.
    pub(crate) fn tied(&self, model: BiasModel, progress: &dyn Fn(f32)) -> Result<Tied, RpcError> {
        let halves = self.at_half_resolution()?;
        progress(0.5);
        let mut starts: Vec<Vec<[f32; 2]>> = halves.iter().map(|(half, _)| shifts(half)).collect();
        if halves
            .iter()
            .any(|(half, _)| half.images.iter().any(|ties| ties.good < FEW))
        {
            starts.push(vec![[0.0; 2]; self.views.len()]);
        }
        starts.dedup_by(|other, best| !are_apart(best, other));
        let (full, tracks) = best_first(starts.iter().map(|start| self.round(start, 1, model)))?.swap_remove(0);
        progress(1.0);
        if !full.converged {
            tracing::warn!(
                "camera adjustment did not converge in {} rounds; check its residuals, or set cameras.align = \"off\"",
                full.rounds
            );
        }
        tracing::info!(
            "Cameras adjusted by {} tie points, residual {:.2} px",
            full.points.len(),
            full.sigma_px
        );
        if full.sigma_px > CONTRADICTORY_PX {
            tracing::warn!(
                "tie points agree to {:.2} px only, those of sound cameras to 0.1 to 0.3 px: check that each image has its own camera",
                full.sigma_px
            );
        }
        if let Some(exchange) = self.exchange(&tracks) {
            tracing::warn!("{}", contradiction::of_exchange(&exchange, self.ground).message);
        }
        Ok((full, tracks))
    }

    /// Two images whose ties agree better with each other's cameras.
    fn exchange(&self, tracks: &[Track]) -> Option<Exchange> {
        let cameras = self.cameras();
        exchange(&self.images(&cameras), tracks, self.ground.frame)
    }

    /// Adjustments at half resolution with their ties, the better one first: one from the shifts of a coarse sweep, one
    /// from none.
    ///
    /// # Errors
    /// [`RpcError::Invalid`] when there are too few ties from either.
    fn at_half_resolution(&self) -> Result<Vec<Tied>, RpcError> {
        let coarse = coarse_shifts(self.views, &self.ground.request(self.cell_m, self.matching));
        let none = vec![[0.0; 2]; self.views.len()];
        best_first(
            [coarse, none]
                .iter()
                .map(|shifts| self.round(shifts, 0, BiasModel::Translation)),
        )
    }

    /// Ties between the cameras moved by `shifts` (columns, rows; pixels), at half (0) or full (1) resolution, and the
    /// adjustment of the cameras as delivered.
    fn round(&self, shifts: &[[f32; 2]], level: usize, model: BiasModel) -> Result<Tied, RpcError> {
        let moved: Vec<SweepView> = self
            .views
            .iter()
            .zip(shifts)
            .map(|(view, shift)| SweepView {
                camera: view.camera.shifted(shift[0], shift[1]),
                ..*view
            })
            .collect();
        let options = TieOptions {
            factor: 2 - level,
            tiles: TILES[level],
        };
        let ties = find_ties(&moved, &self.ground.request(self.cell_m, self.matching), options);
        let tracks: Vec<Track> = ties.iter().map(|tie| self.track(tie)).collect();
        let cameras = self.cameras();
        let options = AdjustOptions {
            model,
            ..Default::default()
        };
        let adjustment = adjust(&self.images(&cameras), &tracks, self.ground.frame, options)?;
        tracing::debug!(
            level,
            ties = tracks.len(),
            good = agreement(&adjustment),
            sigma_px = adjustment.sigma_px,
            "adjustment"
        );
        Ok((adjustment, tracks))
    }

    /// Cameras as delivered, in pixels of the windows that were read, as sightings are.
    fn cameras(&self) -> Vec<Rpc> {
        self.ground.images.iter().map(|image| image.window_rpc()).collect()
    }

    fn images<'a>(&self, cameras: &'a [Rpc]) -> Vec<AdjustImage<'a>> {
        let images = self.ground.images.iter().zip(cameras);
        images
            .map(|(image, rpc)| AdjustImage {
                rpc,
                width: image.pixels.width,
                height: image.pixels.height,
            })
            .collect()
    }

    fn track(&self, tie: &Tie) -> Track {
        let near = tie.near.as_dvec3();
        let sightings = tie.sightings.iter().map(|sighting| Sighting {
            image: sighting.view,
            at: ImagePoint::new(
                f64::from(sighting.col) + self.ground.crops[sighting.view].col0 as f64,
                f64::from(sighting.row) + self.ground.crops[sighting.view].row0 as f64,
            ),
            weight: weight(sighting.score),
        });
        Track {
            near: self.ground.frame.geo_from_enu(Vector3::new(near.x, near.y, near.z)),
            sightings: sightings.collect(),
        }
    }
}

/// Weight of a sighting by its correlation, 0..1. Correlation between dates falls mostly because of shadows, which also
/// shift matches.
fn weight(score: f32) -> f64 {
    f64::from((score - WORTHLESS_SCORE) / (1.0 - WORTHLESS_SCORE))
        .clamp(0.0, 1.0)
        .powi(2)
}

/// Number of sightings that fit.
fn agreement(adjustment: &Adjustment) -> usize {
    adjustment.images.iter().map(|image| image.good).sum()
}

/// The adjustments that exist, those with more agreeing sightings first.
///
/// # Errors
/// The first error if none exists.
fn best_first(found: impl Iterator<Item = Result<Tied, RpcError>>) -> Result<Vec<Tied>, RpcError> {
    let (good, bad): (Vec<_>, Vec<_>) = found.partition(Result::is_ok);
    let mut good: Vec<Tied> = good.into_iter().flatten().collect();
    good.sort_by_key(|(adjustment, _)| std::cmp::Reverse(agreement(adjustment)));
    match bad.into_iter().next() {
        Some(Err(error)) if good.is_empty() => Err(error),
        _ => Ok(good),
    }
}

/// True if an image is shifted otherwise by [`APART_PX`] or more.
fn are_apart(some: &[[f32; 2]], others: &[[f32; 2]]) -> bool {
    let mut pairs = some.iter().flatten().zip(others.iter().flatten());
    pairs.any(|(one, other)| (one - other).abs() >= APART_PX)
}

/// Shift of each image (columns, rows; pixels) in an adjustment.
pub fn shifts(adjustment: &Adjustment) -> Vec<[f32; 2]> {
    let shift = |c: &heliosplat_rpc::adjust::Correction| c.shift_px.map(|v| v as f32);
    adjustment.corrections.iter().map(shift).collect()
}
