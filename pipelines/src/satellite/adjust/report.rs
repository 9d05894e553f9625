//! The adjustment of a scene's cameras as a user asks for it: its files, and its report as text and as JSON.

use super::plot::{ImageVectors, image_vectors};
use super::truth::{CameraError, camera_error};
use super::{AdjustInput, write};
use crate::cli::adjust::AdjustArgs;
use crate::cli::{CliError, Outcome, Session};
use crate::satellite::training::create_folder;
use crate::scene::Scene;
use heliosplat_rpc::adjust::{Adjustment, Correction, ImageResiduals, PairResiduals};
use serde_json::{Value, json};
use std::fmt::Write;
use std::time::Instant;

/// An adjustment whose cameras are written.
#[derive(Debug)]
pub struct Adjusted {
    /// The report.
    pub outcome: Outcome,
    /// The residuals of every image, for a picture of them.
    pub residuals: Vec<ImageVectors>,
}

/// Adjusts a scene's cameras and writes them, with `adjustment.json`.
///
/// # Errors
/// When the scene cannot be read, its images have too few ties, or the folder cannot be written.
pub fn run(args: &AdjustArgs, session: &Session) -> Result<Adjusted, CliError> {
    let scene = Scene::open(&args.scene, &args.ingest.options())?;
    let ground = super::ground(&scene)?;
    create_folder(&args.out)?;
    let begun = Instant::now();
    let progress = session.progress("adjust", 100);
    let rasters = ground.rasters();
    let views = ground.sweep_views(&rasters, &vec![[0.0; 2]; rasters.len()]);
    let input = AdjustInput {
        ground: &ground,
        views: &views,
        cell_m: scene.gsd_m,
    };
    let adjustment = input
        .adjust(args.model.into(), &|share| progress.set((100.0 * share) as u64))
        .map_err(|error| {
            CliError::Input(format!(
                "{}: the cameras cannot be adjusted: {error}; check the overlap and --altitude with `heliosplat inspect`",
                args.scene.display()
            ))
        })?;
    drop(progress);
    let seconds = begun.elapsed().as_secs_f64();
    let names: Vec<&str> = ground.images.iter().map(|image| image.name.as_str()).collect();
    for (name, image) in names.iter().zip(&adjustment.images) {
        if image.good < heliosplat_rpc::adjust::FEWEST_SIGHTINGS {
            tracing::warn!("{name}: too few good ties ({}), do not trust its camera", image.good);
        }
    }
    let exported = write::cameras(&scene, &ground, &adjustment, args)?;
    let shifts: Vec<[f64; 2]> = adjustment.corrections.iter().map(|c| c.shift_px).collect();
    let error = camera_error(&args.scene, &ground.images, &scene.frame, &shifts);
    let report = Report {
        names: &names,
        adjustment: &adjustment,
        refit_px: &exported,
        error,
        seconds,
    };
    let json = report.json();
    let text = serde_json::to_string_pretty(&json).unwrap_or_default() + "\n";
    crate::raster::write_atomically(&args.out.join("adjustment.json"), text.as_bytes())?;
    Ok(Adjusted {
        outcome: Outcome {
            text: report.text() + &format!("written to {}\n", args.out.display()),
            json,
        },
        residuals: image_vectors(&ground, &adjustment),
    })
}

struct Report<'a> {
    names: &'a [&'a str],
    adjustment: &'a Adjustment,
    refit_px: &'a [f64],
    error: Option<CameraError>,
    seconds: f64,
}

impl Report<'_> {
    fn images(&self) -> impl Iterator<Item = (&str, &Correction, &ImageResiduals, f64)> {
        let corrections = self.names.iter().zip(&self.adjustment.corrections);
        let residuals = self.adjustment.images.iter().zip(self.refit_px);
        corrections
            .zip(residuals)
            .map(|((name, correction), (residuals, refit))| (*name, correction, residuals, *refit))
    }

    fn pair_names(&self, pair: &PairResiduals) -> [&str; 2] {
        pair.images.map(|image| self.names[image])
    }

    fn json(&self) -> Value {
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
            "seconds": self.seconds,
            "images": images,
            "pairs": self.adjustment.pairs.iter().map(pair).collect::<Vec<_>>(),
        });
        if let Some(error) = &self.error {
            json["camera_error"] = json!(error);
        }
        json
    }

    fn text(&self) -> String {
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
