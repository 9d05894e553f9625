//! Short fits of a capture, at half size and with few Gaussians, scored on held-out training images.
//!
//! Every held-out image is cut into four pieces; two fits are compared piece by piece ([`super::paired`]).

use super::capture::{Capture, Frame};
use super::config::{ModelKind, ObjectConfig, Parts};
use super::paired::{Gain, Piece};
use super::prepare;
use heliosplat::model::View;
use heliosplat::render::{PassOptions, render};
use heliosplat::train::Trainer;
use heliosplat_evaluate::image::psnr_db;
use heliosplat_fitting::training::TrainingError;
use heliosplat_scene::Split;
use std::time::Instant;

/// One in so many training images is held out.
const ASIDE: usize = 6;
/// Fewest images for a trial: with fewer the remaining ones would not suffice.
pub(super) const LEAST_IMAGES: usize = 18;
/// Factor by which short fits downscale images.
const SMALLER: usize = 2;
/// Most Gaussians that a short fit starts from: enough for half-size images, whose steps are many and cheap
/// (docs/lab/objects.md).
const MOST_GAUSSIANS: usize = 1500;
/// Pieces of a held-out image along each side.
const PIECES: usize = 2;

/// Result of a short fit.
pub(super) struct Scored {
    /// Squared error of each held-out piece, summed over its values.
    pieces: Vec<f64>,
    /// PSNR on all pieces, decibels.
    pub(super) psnr_db: f64,
    /// Mean time of a step, seconds.
    pub(super) step_s: f64,
    /// Numbers that describe a Gaussian.
    pub(super) numbers_per_gaussian: usize,
}

impl Scored {
    /// Gain of this fit over one `without` a part; `None` for too few pieces.
    pub(super) fn gain_over(&self, without: &Self) -> Option<Gain> {
        let pairs = without.pieces.iter().zip(&self.pieces);
        let pieces: Vec<Piece> = pairs.map(|(&without, &with)| Piece { without, with }).collect();
        Gain::of(&pieces)
    }
}

fn smaller(view: View) -> View {
    if view.image.width < 16 * SMALLER || view.image.height < 16 * SMALLER {
        return view;
    }
    let image = view.image.downscaled(SMALLER);
    View {
        camera: view.camera.downscaled(SMALLER),
        weight: vec![1.0; image.plane_len()],
        image: image.into(),
        ..view
    }
}

/// A short fit of a kind of model with these parts.
///
/// # Errors
/// [`TrainingError`] when the training fails.
pub(super) fn fit(
    capture: &Capture,
    config: &ObjectConfig,
    kind: ModelKind,
    parts: Parts,
) -> Result<Scored, TrainingError> {
    let mut config = parts.of(config);
    config.start.gaussians = config.start.gaussians.min(MOST_GAUSSIANS);
    config.train.iterations = config.model.pilot_steps;
    config.train.density.every = 0;
    config.train.pyramid_share = 0.0;
    let all: Vec<&Frame> = capture.of(Split::Train).collect();
    let kept = |n: usize| n % ASIDE == ASIDE / 2;
    let frames: Vec<&Frame> = (0..all.len()).filter(|&n| !kept(n)).map(|n| all[n]).collect();
    let input = prepare::input(capture, kind, &config, &frames);
    let (model, preparation) = (input.kind.model(), input.preparation);
    let view = |frame: &Frame, n: usize| Some(smaller(super::views::view(frame, capture.centre, &preparation, n)?));
    let views: Vec<View> = frames.iter().enumerate().filter_map(|(n, f)| view(f, n)).collect();
    let mut options = config.train.clone();
    options.gsd_m = (SMALLER as f64 * capture.pixel_size) as f32;
    let mut trainer = Trainer::new(&*model, views, input.parameters, options, input.bounds, None)?;
    let begun = Instant::now();
    while !trainer.finished() {
        trainer.step()?;
    }
    let step_s = begun.elapsed().as_secs_f64() / trainer.steps().max(1) as f64;
    let (parameters, _) = trainer.into_best();
    let mut pieces = Vec::new();
    let (mut sum, mut count) = (0.0f64, 0usize);
    for (n, frame) in all.iter().enumerate().filter(|(n, _)| kept(*n)) {
        let Some(view) = view(frame, n) else { continue };
        let options = PassOptions::default();
        let seen = render(&*model, &parameters, &view.camera, view.light, None, options).image;
        let mut of_image = [0.0f64; PIECES * PIECES];
        let (width, plane) = (seen.width, seen.plane_len());
        for (i, (a, b)) in seen.values.iter().zip(&view.image.values).enumerate() {
            let (col, row) = (i % plane % width, i % plane / width);
            if b.is_finite() {
                let piece = row * PIECES / seen.height * PIECES + col * PIECES / width;
                of_image[piece] += f64::from(a - b).powi(2);
                count += 1;
            }
        }
        sum += of_image.iter().sum::<f64>();
        pieces.extend(of_image);
    }
    let specs = parameters.gaussians.groups.iter().map(|group| group.spec.width);
    Ok(Scored {
        pieces,
        psnr_db: psnr_db((sum / count.max(1) as f64).max(1e-12), 1.0),
        step_s,
        numbers_per_gaussian: specs.sum(),
    })
}
