//! What is found out of a scene before any training: clouds, pointing, ties and the swept surface.

use super::adjust::{self, AdjustInput};
use super::clouds;
use super::config::{Align, PointingMethod, SatelliteConfig};
use super::fit::FitError;
use super::ground::Ground;
use glam::Vec3;
use heliosplat::Raster;
use heliosplat_rpc::RpcError;
use heliosplat_rpc::adjust::BiasModel;
use heliosplat_scene::Scene;
use heliosplat_session::Session;
use heliosplat_stereo::{Surface, SweepView, align::estimate_shifts, sweep::sweep};
use std::time::Instant;

/// Results that are computed once before training, and kept in its checkpoint.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Preprocessed {
    /// The swept surface.
    pub surface: Surface,
    /// Pointing corrections, pixels.
    pub shifts_px: Vec<[f32; 2]>,
    /// Ground points that ties between the images agree on, metres of the scene's frame.
    pub ties_m: Vec<glam::Vec3>,
    /// The pixels of each image that show clouds; empty where there are none.
    pub clouds: Vec<Vec<bool>>,
    /// Seconds spent on alignment and on the sweep.
    pub seconds: [f64; 2],
}

/// A scene's surface before any training, and what it was found with.
pub(super) struct Swept<'a> {
    pub(super) ground: Ground<'a>,
    pub(super) found: Preprocessed,
}

impl<'a> Swept<'a> {
    /// Finds it out.
    ///
    /// # Errors
    /// [`FitError::TooFewViews`] when too few images show the common ground.
    pub(super) fn new(scene: &'a Scene, config: &SatelliteConfig, session: &Session) -> Result<Self, FitError> {
        let started = Instant::now();
        let ground = Ground::new(scene, scene.training(), config.start.margin_m)?;
        let mut rasters = ground.rasters();
        let clouds = match config.model.clouds {
            Some(true) => clouds::find(&ground, &rasters, config.start.cell_gsd * scene.gsd_m),
            _ => vec![Vec::new(); rasters.len()],
        };
        let clouded = rasters.iter_mut().zip(&clouds);
        clouded.for_each(|(raster, mask)| clouds::blank(raster, mask));
        let Pointing { shifts_px, ties_m } = align(&ground, &rasters, config, scene.gsd_m);
        let aligned = started.elapsed();
        let request = ground.request(config.start.cell_gsd * scene.gsd_m);
        let progress = session.progress("sweep", 100);
        let indices = ground.vegetation_indices(&rasters);
        let mut views = ground.sweep_views(&rasters, &shifts_px);
        for (view, index) in views.iter_mut().zip(indices.iter().flatten()) {
            view.index = Some(index);
        }
        let surface = sweep(&views, &request, &|share| progress.set((100.0 * share) as u64));
        let seconds = [aligned.as_secs_f64(), (started.elapsed() - aligned).as_secs_f64()];
        let found = Preprocessed {
            surface,
            shifts_px,
            ties_m,
            clouds,
            seconds,
        };
        Ok(Self { ground, found })
    }

    /// The same as it was found out before; `None` where it is not of this scene.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub(super) fn again(
        scene: &'a Scene,
        config: &SatelliteConfig,
        found: Preprocessed,
    ) -> Result<Option<Self>, FitError> {
        let ground = Ground::new(scene, scene.training(), config.start.margin_m)?;
        let images = ground.images.len();
        let mut masks = found.clouds.iter().zip(&ground.crops);
        let fits = found.shifts_px.len() == images
            && found.clouds.len() == images
            && masks.all(|(mask, crop)| mask.is_empty() || mask.len() == crop.width * crop.height)
            && found.surface.is_whole();
        Ok(fits.then_some(Self { ground, found }))
    }
}

/// The surface that all views of `scene` find together, without training.
///
/// # Errors
/// [`FitError::TooFewViews`] when too few images show the common ground.
pub fn sweep_only(scene: &Scene, config: &SatelliteConfig, session: &Session) -> Result<Surface, FitError> {
    Swept::new(scene, config, session).map(|swept| swept.found.surface)
}

/// How the images lie on each other.
#[derive(Default)]
struct Pointing {
    /// Corrections, pixels.
    shifts_px: Vec<[f32; 2]>,
    /// Ground points found on the way, metres of the scene's frame.
    ties_m: Vec<Vec3>,
}

/// Corrections of the images' pointing; zero where the configuration or the estimate says so.
fn align(ground: &Ground, rasters: &[Raster], config: &SatelliteConfig, gsd_m: f64) -> Pointing {
    let none = vec![[0.0; 2]; ground.images.len()];
    if config.cameras.align == Align::Off {
        return Pointing {
            shifts_px: none,
            ..Pointing::default()
        };
    }
    let views = ground.sweep_views(rasters, &none);
    let by_shifts = || Pointing {
        shifts_px: estimate_shifts(&views, &ground.request(config.start.cell_gsd * gsd_m)),
        ..Pointing::default()
    };
    let pointing = match config.cameras.method {
        PointingMethod::Shifts => by_shifts(),
        PointingMethod::Ties => by_ties(ground, &views, gsd_m).unwrap_or_else(|error| {
            tracing::warn!("whole images are compared, because ties do not tell: {error}");
            by_shifts()
        }),
    };
    let largest = pointing.shifts_px.iter().flatten().fold(0.0f32, |a, &b| a.max(b.abs()));
    tracing::info!(largest_px = largest, "pointing of the images relative to each other");
    if config.cameras.align == Align::On || largest > config.cameras.threshold_px {
        pointing
    } else {
        Pointing {
            shifts_px: none,
            ..pointing
        }
    }
}

fn by_ties(ground: &Ground, views: &[SweepView], gsd_m: f64) -> Result<Pointing, RpcError> {
    // Patches of whole pixels, however coarse the model's cells are.
    let input = AdjustInput {
        ground,
        views,
        cell_m: gsd_m,
    };
    let adjustment = input.adjust(BiasModel::Translation, &|_| {})?;
    Ok(Pointing {
        shifts_px: adjust::shifts(&adjustment),
        ties_m: adjust::points(&adjustment, ground),
    })
}
