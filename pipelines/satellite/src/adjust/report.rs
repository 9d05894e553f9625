//! Camera adjustment of a whole scene, with the results as text, as JSON, and as files.

use super::camera_error::{CameraError, camera_error};
use super::vectors::{ImageVectors, image_vectors};
use super::{AdjustInput, write};
use crate::error::SatelliteError;
use crate::ground::GroundViews;
use heliosplat_fitting::run_folder::create_folder;
use heliosplat_raster::write_atomically;
use heliosplat_rpc::adjust::{Adjustment, BiasModel, Correction, ImageResiduals, PairResiduals};
use heliosplat_scene::Scene;
use heliosplat_session::Session;
use heliosplat_stereo::MatchingParameters;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

/// Options of an adjustment, besides its scene.
#[derive(Debug, Clone, Copy)]
pub struct AdjustRequest<'a> {
    /// Folder for the corrected cameras and `adjustment.json`; created where missing.
    pub out: &'a Path,
    /// Error model of the cameras.
    pub model: BiasModel,
    /// True to write copies of the images with the corrected cameras too.
    pub images: bool,
}

/// The adjusted cameras of a scene.
pub struct AdjustedScene<'a> {
    /// The ground and the images that show it.
    pub ground: GroundViews<'a>,
    /// Corrections and residuals.
    pub adjustment: Adjustment,
    /// Largest error of each image's corrected camera, fitted as an RPC, pixels.
    pub refit_px: Vec<f64>,
    /// Error against true cameras, where the scene has them.
    pub error: Option<CameraError>,
    /// Time of ties and adjustment, seconds.
    pub seconds: f64,
}

/// Adjusts the cameras of a scene, and writes them with `adjustment.json`.
///
/// # Errors
/// When too few images show the common ground, the ties are too few, or the folder cannot be written.
pub fn adjust_scene<'a>(
    scene: &'a Scene,
    request: &AdjustRequest,
    session: &Session,
) -> Result<AdjustedScene<'a>, SatelliteError> {
    let ground = super::ground(scene)?;
    create_folder(request.out)?;
    let begun = Instant::now();
    let progress = session.progress("adjust", 100);
    let rasters = ground.rasters();
    let views = ground.sweep_views(&rasters, &vec![[0.0; 2]; rasters.len()]);
    let input = AdjustInput {
        ground: &ground,
        views: &views,
        cell_m: scene.gsd_m,
        matching: MatchingParameters::choose(&ground.matching_facts(scene.gsd_m)),
    };
    let adjustment = input
        .adjust(request.model, &|share| progress.set((100.0 * share) as u64))
        .map_err(|error| {
            let scene = scene.source.display();
            SatelliteError::Input(format!(
                "{scene}: the cameras cannot be adjusted: {error}; check the overlap and --altitude with `heliosplat inspect`"
            ))
        })?;
    drop(progress);
    let seconds = begun.elapsed().as_secs_f64();
    for mut contradiction in super::contradictions(&ground.pixels(), &adjustment) {
        // The camera is written, although the image contradicts it.
        contradiction.is_out = false;
        tracing::warn!("{}", contradiction.message(&ground.images[contradiction.image].name));
    }
    let refit_px = write::cameras(scene, &ground, &adjustment, request)?;
    let shifts: Vec<[f64; 2]> = adjustment.corrections.iter().map(|c| c.shift_px).collect();
    let error = camera_error(scene, &ground.images, &shifts);
    let adjusted = AdjustedScene {
        ground,
        adjustment,
        refit_px,
        error,
        seconds,
    };
    let text = serde_json::to_string_pretty(&adjusted.json()).unwrap_or_default() + "\n";
    write_atomically(&request.out.join("adjustment.json"), text.as_bytes())?;
    Ok(adjusted)
}

impl AdjustedScene<'_> {
    /// Residuals of each image, for a plot.
    pub fn vectors(&self) -> Vec<ImageVectors> {
        image_vectors(&self.ground, &self.adjustment)
    }

    fn images(&self) -> impl Iterator<Item = (&str, &Correction, &ImageResiduals, f64)> {
        let corrections = self.ground.images.iter().zip(&self.adjustment.corrections);
        let residuals = self.adjustment.images.iter().zip(&self.refit_px);
        corrections
            .zip(residuals)
            .map(|((image, correction), (residuals, refit))| (image.name.as_str(), correction, residuals, *refit))
    }

    fn pair_names(&self, pair: &PairResiduals) -> [&str; 2] {
        pair.images.map(|image| self.ground.images[image].name.as_str())
    }

    /// Content of `adjustment.json`.
    pub fn json(&self) -> Value {
        let images: Vec<Value> = self
            .images()
            .map(|(name, correction, residuals, refit_px)| {
                json!({
                    "name": name,
                    "correction": correction,
                    "sightings": residuals.sightings,
                    "good": residuals.good,
                    "before": residuals.before,
                    "after": residuals.after,
                    "refit_max_px": refit_px,
                })
            })
            .collect();
        let pair = |pair: &PairResiduals| {
            json!({
                "images": self.pair_names(pair),
                "ties": pair.ties,
                "across_epipolar_before": pair.before,
                "across_epipolar_after": pair.after,
            })
        };
        let mut json = json!({
            "model": self.adjustment.model,
            "gauge": "smallest corrections: a common translation of the scene is left as the cameras have it",
            "ties": self.adjustment.points.len(),
            "sigma_px": self.adjustment.sigma_px,
            "rounds": self.adjustment.rounds,
            "converged": self.adjustment.converged,
            "seconds": self.seconds,
            "images": images,
            "pairs": self.adjustment.pairs.iter().map(pair).collect::<Vec<_>>(),
        });
        if let Some(error) = &self.error {
            json["camera_error"] = json!(error);
        }
        json
    }

    /// Report in words.
    pub fn text(&self) -> String {
        let mut text = format!(
            "{} ties in {:.1} s, a good one is {:.2} px off in one direction\n\n{:<20} {:>16} {:>11} {:>15}\n",
            self.adjustment.points.len(),
            self.seconds,
            self.adjustment.sigma_px,
            "image",
            "col, row px",
            "good ties",
            "rms px"
        );
        for (name, correction, residuals, _) in self.images() {
            let [col, row] = correction.shift_px;
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{name:<20} {col:>+7.3}, {row:>+7.3} {:>5}/{:<5} {:>6.2} -> {:<5.2}",
                residuals.good, residuals.sightings, residuals.before.rms_px, residuals.after.rms_px
            );
        }
        text += "\nacross the epipolar lines of pairs\n";
        for pair in &self.adjustment.pairs {
            let [a, b] = self.pair_names(pair);
            let _ = writeln!(
                text,
                "{a} - {b}: {} ties, rms {:.2} -> {:.2} px, median {:.2} -> {:.2}",
                pair.ties, pair.before.rms_px, pair.after.rms_px, pair.before.median_px, pair.after.median_px
            );
        }
        if let Some(error) = &self.error {
            let _ = writeln!(
                text,
                "\nagainst truth, a common translation apart: rms {:.2} -> {:.3} px, largest {:.3}",
                error.before_rms_px, error.after_rms_px, error.after_max_px
            );
        }
        text
    }
}
