//! Initial state of a training: the model of a scene's images, its Gaussians on the swept surface, and the views.

use super::config::SatelliteConfig;
use super::error::SatelliteError;
use super::ground::GroundViews;
use super::plan::Decisions;
use super::preprocess::Preprocessed;
use super::views;
use super::{estimate, initial};
use glam::Vec3;
use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
use heliosplat::model::{Parameters, SceneModel, View};
use heliosplat::train::TrainOptions;
use heliosplat_fitting::run_folder::peak_rss_bytes;
use heliosplat_products::change::day_of;
use heliosplat_radiometry::shadow_prior;
use heliosplat_scene::{ImageSun, Scene, crop};
use heliosplat_stereo::Surface;

/// Sky light at the start, as a share of the sun's light: that of a clear day; training fits it for each image.
pub(super) const SKY: f32 = 0.3;
/// Weight of the shadow prior, if it is on.
const PRIOR_WEIGHT: f32 = 1.0;
/// Number of steps below which a training raises its learning rates (docs/lab/start.md).
const OWN_RATE_STEPS: usize = 1600;
/// Weight of the albedo's smoothness (docs/lab/start.md).
const SMOOTHNESS_WEIGHT: f32 = 0.1;

/// Model before its first step.
pub(super) struct InitialState {
    /// Options and parameters of the model.
    pub(super) model: ShadowGs,
    /// Parameters of the model, with its Gaussians.
    pub(super) parameters: Parameters,
    /// Views of the training images.
    pub(super) views: Vec<View>,
}

impl InitialState {
    /// Initial state for the images of `ground` under `suns`, on the surface in `found`.
    ///
    /// # Errors
    /// [`SatelliteError`] when a shadow mask of the user cannot be read.
    pub(super) fn new(
        ground: &GroundViews,
        found: &Preprocessed,
        suns: &[ImageSun],
        decisions: &Decisions,
        config: &SatelliteConfig,
    ) -> Result<Self, SatelliteError> {
        let Preprocessed { surface, changes, .. } = found;
        let changing = !changes.segments.is_empty();
        let model = model(ground, suns, decisions, changing);
        let covered = surface.supported();
        let start = initial::Start {
            surface,
            covered: &covered,
        };
        let parameters = Parameters {
            gaussians: match changing {
                false => start.gaussians(model.feature_groups()),
                true => initial::changing(&start, changes, &model.feature_groups()),
            },
            globals: model.initial_globals(SKY),
        };
        let mut views: Vec<View> = (0..ground.images.len())
            .map(|i| {
                let (clouds, shift_px) = (&found.clouds[i], found.shifts_px[i]);
                views::view(ground.images[i], &suns[i], &ground.crops[i], clouds, shift_px, i)
            })
            .collect();
        if !decisions.saturation {
            views.iter_mut().for_each(|view| view.ceiling.clear());
        }
        if decisions.shadow_prior {
            give_priors(&mut views, suns, ground, surface, config)?;
        }
        Ok(Self {
            model,
            parameters,
            views,
        })
    }
}

/// Removes the views under unknown suns, whose shadows would become dark ground.
pub(super) fn keep_known_suns(views: &mut Vec<View>) {
    views.retain(|view| view.light.is_some());
}

/// Training options for a model with `views` views of `scene`.
pub(super) fn train_options(config: &SatelliteConfig, scene: &Scene, views: usize) -> TrainOptions {
    TrainOptions {
        gsd_m: scene.gsd_m as f32,
        own_rate_steps: OWN_RATE_STEPS,
        smoothness_weight: SMOOTHNESS_WEIGHT,
        ..config.train.clone().for_views(views)
    }
}

/// Index of the reference image, whose colour is the model's: the image under the highest sun, with the least ground in
/// shadow; the first image if no sun is known.
fn reference(suns: &[ImageSun]) -> usize {
    let elevation = |i: usize| suns[i].position.map_or(f64::NEG_INFINITY, |sun| sun.elevation_rad);
    (0..suns.len())
        .max_by(|&a, &b| elevation(a).total_cmp(&elevation(b)).then(b.cmp(&a)))
        .unwrap_or(0)
}

/// Model for the images of `ground`.
fn model(ground: &GroundViews, suns: &[ImageSun], decisions: &Decisions, changing: bool) -> ShadowGs {
    let images = ground.images.len();
    let days = ground
        .images
        .iter()
        .filter_map(|image| Some(day_of(image.time?) as f32));
    let options = ShadowGsOptions {
        bands: ground.images.first().map_or(0, |image| image.pixels.bands),
        images,
        reference: reference(suns),
        image_colour: decisions.image_colour,
        prior_weight: if decisions.shadow_prior { PRIOR_WEIGHT } else { 0.0 },
        near_light: decisions.near_light,
        degree: decisions.sh_degree,
        days: if changing { days.collect() } else { Vec::new() },
    };
    ShadowGs::new(options)
}

/// Gives each view its shadow prior: from the user's mask, else from the dark areas of the image.
fn give_priors(
    views: &mut [View],
    suns: &[ImageSun],
    ground: &GroundViews,
    surface: &Surface,
    config: &SatelliteConfig,
) -> Result<(), SatelliteError> {
    let priors = match &config.model.shadow_masks {
        Some(folder) => {
            let images = ground.images.iter().zip(&ground.crops);
            images
                .map(|(image, crop)| shadow_prior::from_folder(folder, image, crop))
                .collect::<Result<Vec<_>, _>>()
                .map_err(SatelliteError::Input)?
        }
        None => {
            let (rasters, cameras): (Vec<_>, Vec<_>) = views.iter().map(|view| (&*view.image, view.camera)).unzip();
            let suns: Vec<_> = suns.iter().map(crop::direction).collect();
            shadow_prior::found(&ground.images, &rasters, surface, &cameras, &suns)
        }
    };
    // Without a sun there is no shadow, and no mask can change that.
    let lit_views = views.iter_mut().zip(priors).filter(|(view, _)| view.light.is_some());
    for (view, lit) in lit_views {
        view.visibility_prior = Some(lit);
    }
    Ok(())
}

/// Lowest and highest corner of the box outside of which Gaussians are pruned, metres of the scene's frame.
pub(super) fn bounds(ground: &GroundViews) -> (Vec3, Vec3) {
    let (area, slack) = (&ground.area, 2.0);
    (
        Vec3::new(
            (area.west_m - slack) as f32,
            (area.south_m - slack) as f32,
            (ground.up_m.0 - slack) as f32,
        ),
        Vec3::new(
            (area.east_m + slack) as f32,
            (area.north_m + slack) as f32,
            (ground.up_m.1 + slack) as f32,
        ),
    )
}

/// Limits the number of Gaussians to `limit` bytes; returns the largest memory of training, bytes. Fails if the initial
/// Gaussians do not fit.
pub(super) fn fit_into_memory(
    limit: Option<u64>,
    scene: &Scene,
    parameters: &Parameters,
    views: &[View],
    config: &SatelliteConfig,
    options: &mut TrainOptions,
) -> Result<f64, SatelliteError> {
    let count = parameters.gaussians.count;
    let pixels = |view: &View| view.image.plane_len() as f64;
    let largest = views.iter().map(pixels).fold(0.0, f64::max);
    let bands = views.first().map_or(0, |v| v.image.bands);
    let held = estimate::held_bytes(scene) + estimate::copies_bytes(views.iter().map(pixels).sum(), bands);
    let light = estimate::light_bytes(&config.model, bands);
    let bytes =
        |gaussians: f64| held + estimate::training_bytes(gaussians, views.len(), bands, largest) + gaussians * light;
    estimate::must_fit(bytes(count as f64), limit, config)?;
    if let Some(limit) = limit {
        let most = estimate::gaussians_within(limit as f64, bytes);
        options.density.cap = options.density.cap.min(most as usize);
    }
    let grown = count as f64 * options.growth();
    Ok(bytes(grown.min(options.density.cap.max(count) as f64)).max(peak_rss_bytes() as f64))
}
