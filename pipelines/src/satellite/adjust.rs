//! Camera adjustment of a scene: ties between its images, corrections of their pointing, corrected cameras as files.
//!
//! Ties need cameras that agree to a few pixels, and the surface they lie on needs the same; so pointing is estimated from coarse
//! to fine: shifts from a coarse sweep, ties and an adjustment at half resolution, and again at full resolution. The coarse
//! shifts can be wrong (few textures, few views); ties from the cameras as they are compete with them, and what more ties agree
//! on wins.

mod plot;
mod report;
pub mod truth;
mod write;

pub use report::run;

use super::fit::FitError;
use super::views::{self, Crop};
use crate::scene::{Scene, SceneImage};
use heliosplat::Raster;
use heliosplat::start::ties::{Tie, TieOptions, find_ties};
use heliosplat::start::{SweepOptions, SweepRequest, SweepView, align::coarse_shifts};
use heliosplat_rpc::adjust::{AdjustImage, AdjustOptions, Adjustment, BiasModel, Sighting, Track, adjust};
use heliosplat_rpc::{ImagePoint, LocalFrame, RpcError};
use nalgebra::Vector3;

/// Ties sought at half resolution, and at full.
const TILES: [usize; 2] = [900, 2000];
/// Correlation at which a sighting counts nothing.
const WORTHLESS_SCORE: f32 = 0.7;
/// Shifts that change by more than this are sought anew from where they are, pixels: half the reach of the search, which is in cells
/// of two pixels.
const FAR_PX: f32 = 4.0;
/// How often.
const MOST_REPEATS: usize = 4;
/// Ground added around the area so that ties near its edge have a surface, metres.
const MARGIN_M: f64 = 4.0;

/// What ties are sought in.
pub struct AdjustInput<'a> {
    /// Crops of the images with their cameras as delivered.
    pub views: &'a [SweepView<'a>],
    /// The images, in the order of the views.
    pub images: &'a [&'a SceneImage],
    /// Their crops.
    pub crops: &'a [Crop],
    /// The scene's frame.
    pub frame: &'a LocalFrame,
    /// The ground.
    pub request: &'a SweepRequest,
}

impl AdjustInput<'_> {
    /// Finds ties and the corrections that make the images agree on them; `progress` hears the share done.
    ///
    /// # Errors
    /// [`RpcError::Invalid`] when there are too few ties.
    pub fn adjust(&self, model: BiasModel, progress: &dyn Fn(f32)) -> Result<Adjustment, RpcError> {
        let coarse = coarse_shifts(self.views, self.request);
        progress(0.1);
        let half = self.at_half_resolution(&coarse)?;
        progress(0.5);
        let full = self.round(&shifts(&half), 1, model)?;
        progress(1.0);
        tracing::info!(
            ties = full.points.len(),
            sigma_px = full.sigma_px,
            rounds = full.rounds,
            "cameras adjusted"
        );
        Ok(full)
    }

    /// The best of what comes of the coarse shifts and of none, repeated while that moves images far: what lay beyond the reach of
    /// the first search lies within that of the next.
    fn at_half_resolution(&self, coarse: &[[f32; 2]]) -> Result<Adjustment, RpcError> {
        let none = vec![[0.0; 2]; self.views.len()];
        let from_coarse = self.round(coarse, 0, BiasModel::Translation);
        let from_none = self.round(&none, 0, BiasModel::Translation);
        let (mut best, mut from) = match (from_coarse, from_none) {
            (Ok(a), Ok(b)) if agreement(&a) < agreement(&b) => (b, none),
            (Ok(a), _) => (a, coarse.to_vec()),
            (Err(_), other) => (other?, none),
        };
        for _ in 0..MOST_REPEATS {
            let now = shifts(&best);
            if farthest(&now, &from) < FAR_PX {
                break;
            }
            let next = self.round(&now, 0, BiasModel::Translation)?;
            if agreement(&next) <= agreement(&best) {
                break;
            }
            (best, from) = (next, now);
        }
        Ok(best)
    }

    /// Ties between the cameras moved by `shifts`, at half (0) or full (1) resolution, and the adjustment of the delivered ones.
    fn round(&self, shifts: &[[f32; 2]], level: usize, model: BiasModel) -> Result<Adjustment, RpcError> {
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
        let ties = find_ties(&moved, self.request, options);
        let tracks: Vec<Track> = ties.iter().map(|tie| self.track(tie)).collect();
        let images: Vec<AdjustImage> = self
            .images
            .iter()
            .map(|image| AdjustImage {
                rpc: &image.rpc,
                width: image.pixels.width,
                height: image.pixels.height,
            })
            .collect();
        let options = AdjustOptions {
            model,
            ..Default::default()
        };
        let adjustment = adjust(&images, &tracks, self.frame, options)?;
        tracing::debug!(
            level,
            ties = tracks.len(),
            good = agreement(&adjustment),
            sigma_px = adjustment.sigma_px,
            "adjustment"
        );
        Ok(adjustment)
    }

    fn track(&self, tie: &Tie) -> Track {
        let near = tie.near.as_dvec3();
        let sightings = tie.sightings.iter().map(|sighting| Sighting {
            image: sighting.view,
            at: ImagePoint {
                col: f64::from(sighting.col) + self.crops[sighting.view].col0 as f64,
                row: f64::from(sighting.row) + self.crops[sighting.view].row0 as f64,
            },
            weight: weight(sighting.score),
        });
        Track {
            near: self.frame.geo_from_enu(Vector3::new(near.x, near.y, near.z)),
            sightings: sightings.collect(),
        }
    }
}

/// How much a sighting of this correlation counts. What lowers correlation between dates are shadows above all, and those move
/// matches too.
fn weight(score: f32) -> f64 {
    f64::from((score - WORTHLESS_SCORE) / (1.0 - WORTHLESS_SCORE))
        .clamp(0.0, 1.0)
        .powi(2)
}

/// Sightings that fit.
fn agreement(adjustment: &Adjustment) -> usize {
    adjustment.images.iter().map(|image| image.good).sum()
}

/// The largest distance between two sets of shifts, pixels.
fn farthest(a: &[[f32; 2]], b: &[[f32; 2]]) -> f32 {
    let apart = |(a, b): (&[f32; 2], &[f32; 2])| (a[0] - b[0]).hypot(a[1] - b[1]);
    a.iter().zip(b).map(apart).fold(0.0, f32::max)
}

/// The corrections' shifts as the engine takes them.
pub fn shifts(adjustment: &Adjustment) -> Vec<[f32; 2]> {
    let shift = |c: &heliosplat_rpc::adjust::Correction| c.shift_px.map(|v| v as f32);
    adjustment.corrections.iter().map(shift).collect()
}

/// The crops of a scene's images that show its ground.
pub struct Material<'a> {
    /// The images, held-out ones too: their cameras are as wrong as the others.
    pub images: Vec<&'a SceneImage>,
    /// What of them is looked at.
    pub crops: Vec<Crop>,
    /// The pixels of the crops.
    pub rasters: Vec<Raster>,
    groups: Vec<u32>,
    /// The ground.
    pub request: SweepRequest,
    frame: &'a LocalFrame,
}

impl<'a> Material<'a> {
    /// Takes what a scene has.
    ///
    /// # Errors
    /// [`FitError::TooFewViews`] when fewer than two images show the common ground.
    pub fn of(scene: &'a Scene) -> Result<Self, FitError> {
        let area = views::grown(&scene.area, MARGIN_M);
        let up_m = views::altitude_range(scene);
        let (images, crops): (Vec<&SceneImage>, Vec<Crop>) = scene
            .images
            .iter()
            .filter_map(|image| Some((image, Crop::of(image, &area, up_m)?)))
            .unzip();
        if images.len() < 2 {
            return Err(FitError::TooFewViews { images: images.len() });
        }
        let rasters = images
            .iter()
            .zip(&crops)
            .map(|(image, crop)| crop.cut(&image.pixels))
            .collect();
        let cell_m = scene.gsd_m;
        let snapped = |v: f64| ((v / cell_m).round() * cell_m) as f32;
        Ok(Self {
            groups: views::date_groups(&images),
            request: SweepRequest {
                west_m: snapped(area.west_m),
                south_m: snapped(area.south_m),
                east_m: snapped(area.east_m),
                north_m: snapped(area.north_m),
                cell_m: cell_m as f32,
                altitude_min_m: up_m.0 as f32,
                altitude_max_m: up_m.1 as f32,
                options: SweepOptions::default(),
            },
            images,
            crops,
            rasters,
            frame: &scene.frame,
        })
    }

    /// The crops with their cameras as delivered.
    pub fn views(&self) -> Vec<SweepView<'_>> {
        (0..self.images.len())
            .map(|i| SweepView {
                camera: views::camera(&self.images[i].pinhole.map, &self.crops[i], [0.0; 2]),
                image: &self.rasters[i],
                date_group: self.groups[i],
                sun: views::sun(self.images[i]),
            })
            .collect()
    }

    /// What ties are sought in.
    pub fn input<'b>(&'b self, views: &'b [SweepView<'b>]) -> AdjustInput<'b> {
        AdjustInput {
            views,
            images: &self.images,
            crops: &self.crops,
            frame: self.frame,
            request: &self.request,
        }
    }
}
