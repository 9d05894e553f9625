//! Short fit under the known suns, for a surface on which shadows determine the unknown suns.
//!
//! Roofs of a swept surface are too wide and its walls lean, and its shadows have the same errors. A model after a few
//! steps has its walls in the right place: shadows and dark ground agree better on it by half (docs/lab/suns.md).

use super::config::SatelliteConfig;
use super::error::SatelliteError;
use super::initial_state::{self, InitialState, SKY};
use super::plan::Decisions;
use super::preprocess::Preprocess;
use super::suns;
use heliosplat::ProjectiveCamera;
use heliosplat::splat::ProjectionOptions;
use heliosplat::timeline::stage;
use heliosplat::train::Trainer;
use heliosplat_products::dsm;
use heliosplat_products::surface::SurfaceGaussians;
use heliosplat_radiometry::{colours, linear};
use heliosplat_scene::Scene;
use heliosplat_session::Session;

/// Number of steps, as in the preset `fast`.
const STEPS: usize = 40;
/// Number of views under known suns at or above which the other views are left out.
const FEWEST_KNOWN: usize = 4;

/// Altitudes of a shortly fitted model on the cells of the swept surface, metres; NaN where it has none.
///
/// # Errors
/// [`SatelliteError`] when training fails or does not fit into the given memory.
pub(super) fn altitudes(
    (scene, config, decisions): (&Scene, &SatelliteConfig, &Decisions),
    memory: Option<u64>,
    swept: &Preprocess,
    session: &Session,
) -> Result<Vec<f32>, SatelliteError> {
    let _part = stage("short fit");
    tracing::info!("Short training to estimate the suns from shadows on a better surface");
    let Preprocess { ground, found } = swept;
    let (suns, decisions) = suns::decided(scene, ground, &found.shadow_suns, decisions);
    let initial = InitialState::new(ground, found, &suns, &decisions, config)?;
    let (model, mut parameters, mut views) = (initial.model, initial.parameters, initial.views);
    let mut options = initial_state::train_options(config, scene, views.len());
    options.iterations = options.iterations.min(STEPS);
    options.patience = 0;
    initial_state::fit_into_memory(memory, scene, &parameters, &views, config, &mut options)?;
    colours::initialise(&model, &mut parameters, &mut views, SKY);
    linear::begin(&model, &mut parameters, &views);
    if views.iter().filter(|view| view.light.is_some()).count() >= FEWEST_KNOWN {
        initial_state::keep_known_suns(&mut views);
    }
    let progress = session.progress("short fit", options.iterations as u64);
    let mut trainer = Trainer::new(&model, views, parameters, options, initial_state::bounds(ground), None)?;
    let mut steps = 0;
    while !trainer.finished() {
        trainer.step()?;
        steps += 1;
        progress.set(steps);
    }
    let (parameters, _) = trainer.into_best();
    let surface = &found.surface;
    let cell_m = f64::from(surface.cell_m);
    let nadir = ProjectiveCamera::nadir(
        f64::from(surface.west_m) + 0.5 * cell_m,
        f64::from(surface.north_m) - 0.5 * cell_m,
        cell_m,
        (surface.width, surface.height),
    );
    let gaussians = SurfaceGaussians {
        gaussians: &parameters.gaussians,
        bands: scene.bands().len(),
        leaves: None,
        projection: ProjectionOptions::default(),
        gsd_m: scene.gsd_m as f32,
    };
    Ok(dsm::altitudes(&nadir, &gaussians, surface.cell_m))
}
