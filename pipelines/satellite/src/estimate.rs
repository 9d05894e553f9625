//! Memory of a training, estimated before it starts.
//!
//! The constants were fitted to runs on `block` and a town (0.17 to 0.62 million Gaussians); `metrics.json` contains
//! the estimate and the memory used.

use super::config::{ModelOptions, SatelliteConfig};
use super::error::SatelliteError;
use super::ground;
use super::sweep_memory::{SweepExtent, SweepModel, search_bytes};
use heliosplat::shade::sh::functions;
use heliosplat_scene::crop;
use heliosplat_scene::survey::{Survey, TileSurvey};
use heliosplat_scene::{Area, Scene};
use heliosplat_stereo::height_levels;

pub use super::sweep_memory::PROGRAM_BYTES;

/// Gaussians per cell of the ground grid: walls and uncertain ground add to one per cell (1.3 to 2.3 were measured).
const GAUSSIANS_PER_CELL: f64 = 1.8;
/// Number of tables of all parameters in a training: values, gradients, two moments, the best state.
const TABLES: f64 = 5.0;
/// Further bytes per Gaussian in one step: splats, lists of tiles, gradients, ellipses on the plane of the sun,
/// neighbours.
const STEP_BYTES_PER_GAUSSIAN: f64 = 580.0;
/// Free memory kept by the allocator, bytes.
const SPARE_BYTES: f64 = 64.0 * 1_048_576.0;
/// Planes of 32-bit numbers per step, the size of the largest view, besides those per channel.
const PLANES: f64 = 24.0;
/// Further planes per channel.
const PLANES_PER_CHANNEL: f64 = 4.0;

/// Estimated size and memory of a training.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Estimate {
    /// Number of Gaussians at the start.
    pub gaussians: f64,
    /// Peak memory, bytes.
    pub peak_bytes: f64,
    /// Peak memory with one Gaussian per cell, bytes.
    pub least_bytes: f64,
    /// Number of training steps.
    pub steps: usize,
}

/// Memory of the process with an open scene, bytes: the program and the images. The memory reported by the system is no
/// measure, since allocators keep freed memory.
pub fn held_bytes(scene: &Scene) -> f64 {
    let values: usize = scene.images.iter().map(|image| image.pixels.values.len()).sum();
    PROGRAM_BYTES + 4.0 * values as f64
}

/// Memory of two copies of `pixels`, bytes: one is swept, the other is trained on and has weights.
pub fn copies_bytes(pixels: f64, bands: usize) -> f64 {
    4.0 * pixels * (2.0 * bands as f64 + 1.0)
}

/// Memory that training adds, bytes, with at most `gaussians` Gaussians, `views` views of `bands` bands, and `pixels`
/// pixels of the largest view.
pub fn training_bytes(gaussians: f64, views: usize, bands: usize, pixels: f64) -> f64 {
    let width = 11.0 + bands as f64;
    let per_gaussian = TABLES * 4.0 * width + 4.0 * views as f64 + STEP_BYTES_PER_GAUSSIAN;
    let planes = PLANES + PLANES_PER_CHANNEL * (bands as f64 + 4.0);
    SPARE_BYTES + gaussians * per_gaussian + pixels * planes * 4.0
}

/// Bytes per Gaussian for the options of `model` beyond one albedo per band: near-surface light, and harmonics of both.
pub fn light_bytes(model: &ModelOptions, bands: usize) -> f64 {
    let parts = if model.near_light { 2 } else { 1 };
    TABLES * 4.0 * ((parts * functions(model.sh_degree) - 1) * bands) as f64
}

/// Largest number of Gaussians within `limit` bytes; `bytes` returns the memory for a number of them, and is linear.
pub fn gaussians_within(limit: f64, bytes: impl Fn(f64) -> f64) -> f64 {
    let fixed = bytes(0.0);
    let each = bytes(1.0) - fixed;
    ((limit - fixed) / each).max(0.0)
}

/// Quantities of the memory of a training, besides its configuration.
#[derive(Debug, Clone, Copy)]
pub struct Extent {
    /// Ground, metres.
    pub area: Area,
    /// Ground sampling distance, metres.
    pub gsd_m: f64,
    /// Number of bands of every image.
    pub bands: usize,
    /// Number of training images.
    pub training: usize,
    /// Difference between the highest and the lowest searched altitude, metres.
    pub altitudes_m: f64,
    /// Largest base-to-height ratio of two images.
    pub widest_base_to_height: f64,
}

impl From<&Scene> for Extent {
    fn from(scene: &Scene) -> Self {
        Self {
            area: scene.area,
            gsd_m: scene.gsd_m,
            bands: scene.bands().len(),
            training: scene.training().count(),
            altitudes_m: scene.altitude_range_m.1 - scene.altitude_range_m.0,
            widest_base_to_height: ground::GroundViews::new(scene, scene.training())
                .map_or(0.0, |ground| ground.widest_base_to_height()),
        }
    }
}

impl From<&Survey<'_>> for Extent {
    fn from(survey: &Survey<'_>) -> Self {
        let (low_m, high_m) = survey.altitude_range_m;
        Self {
            area: *survey.area(),
            gsd_m: survey.gsd_m,
            bands: survey.bands,
            training: survey.images().1,
            altitudes_m: high_m - low_m,
            widest_base_to_height: survey.widest_base_to_height,
        }
    }
}

/// Refuses a scene whose training will not fit into `limit` bytes, before its pixels are read.
///
/// # Errors
/// `SatelliteError::Input` where it does not fit.
pub fn must_fit_unread(survey: &Survey, limit: Option<u64>, config: &SatelliteConfig) -> Result<(), SatelliteError> {
    let held = PROGRAM_BYTES + 4.0 * survey.bands as f64 * survey.pixels();
    must_fit(estimate_of(&survey.into(), config, held).least_bytes, limit, config)
}

/// Estimate for the training of `scene`, whose images are in memory already.
pub fn estimate(scene: &Scene, config: &SatelliteConfig) -> Estimate {
    estimate_of(&scene.into(), config, held_bytes(scene))
}

/// Estimate for any ground; `held` is the memory of the process at the start of training, images included, bytes.
pub fn estimate_of(extent: &Extent, config: &SatelliteConfig, held: f64) -> Estimate {
    let (bands, training) = (extent.bands, extent.training);
    let area = crop::grown(&extent.area, ground::MARGIN_M);
    let cell_m = config.start.cell_gsd * extent.gsd_m;
    let cells = (area.east_m - area.west_m) * (area.north_m - area.south_m) / (cell_m * cell_m);
    let gaussians = GAUSSIANS_PER_CELL * cells;
    let options = config.train.clone().for_views(training);
    let pixels = cells * config.start.cell_gsd * config.start.cell_gsd * 1.2;
    let fixed = held + copies_bytes(training as f64 * pixels, bands);
    let light = light_bytes(&config.model, bands);
    let training_bytes = |gaussians: f64| training_bytes(gaussians, training, bands, pixels) + gaussians * light;
    let levels = height_levels(
        extent.altitudes_m as f32,
        cell_m as f32,
        extent.widest_base_to_height as f32,
    );
    let search = search_bytes(cells, levels, training as f64 * pixels);
    let peak = |gaussians: f64| fixed + training_bytes(gaussians).max(search);
    Estimate {
        gaussians,
        peak_bytes: peak(gaussians * options.growth()),
        least_bytes: peak(cells),
        steps: options.iterations,
    }
}

/// Estimate for the sweep of a tile, without training.
pub fn sweep_estimate(survey: &Survey, tile: &TileSurvey, config: &SatelliteConfig) -> Estimate {
    let area = crop::grown(&tile.area, ground::MARGIN_M);
    let cell_m = config.start.cell_gsd * survey.gsd_m;
    let cells = (area.east_m - area.west_m) * (area.north_m - area.south_m) / (cell_m * cell_m);
    let peak_bytes = SweepModel::of(survey, cell_m).bytes(&SweepExtent {
        cells,
        map_cells: cells,
        pixels: tile.pixels,
        largest: tile.largest,
    });
    Estimate {
        gaussians: 0.0,
        peak_bytes,
        least_bytes: peak_bytes,
        steps: 0,
    }
}

/// Refuses a scene that needs `needed` bytes within `limit` bytes, with a remedy; `None` is no limit.
///
/// # Errors
/// `SatelliteError::Input` when `needed` exceeds `limit`.
pub fn must_fit(needed: f64, limit: Option<u64>, config: &SatelliteConfig) -> Result<(), SatelliteError> {
    let gib = |bytes: f64| bytes / f64::from(1 << 30);
    match limit.map(|bytes| bytes as f64) {
        Some(limit) if needed > limit => Err(SatelliteError::Input(format!(
            "--memory: training needs about {:.2} GiB and {:.2} GiB are allowed; give more, fewer images, or a coarser model with --set start.cell_gsd={:.2}",
            gib(needed),
            gib(limit),
            config.start.cell_gsd * (needed / limit).sqrt() * 1.05
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn what_fits_is_what_was_asked_for() {
        let bytes = |gaussians: f64| training_bytes(gaussians, 10, 4, 2.5e5);
        assert!((gaussians_within(bytes(1e6), bytes) - 1e6).abs() < 1.0);
        assert!(gaussians_within(1e6, bytes) == 0.0);
    }

    #[test]
    fn light_takes_memory_only_where_it_is_asked_for() {
        let mut model = ModelOptions::default();
        assert!(light_bytes(&model, 4) == 0.0);
        model.sh_degree = 2;
        assert!(light_bytes(&model, 4) == TABLES * 4.0 * 32.0);
    }

    #[test]
    fn a_scene_that_is_too_large_is_told_what_would_fit() {
        let config = SatelliteConfig::default();
        assert!(must_fit(1e9, None, &config).is_ok() && must_fit(1e9, Some(1 << 30), &config).is_ok());
        let error = must_fit(4e9, Some(1 << 30), &config)
            .expect_err("too large")
            .to_string();
        assert!(error.contains("start.cell_gsd=2.0"), "{error}");
    }
}
