//! Which model explains a capture, and which of its parts: what is needed is measured, not guessed.
//!
//! Lights decide between the kinds that know them and those that do not. A part whose worth only images can tell is tried: short fits
//! at half size with and without it, scored on images of training kept aside. It is taken when it helps by 0.3 dB, and is otherwise not
//! there at all.

use super::capture::{Capture, Frame};
use super::config::{ModelKind, ObjectConfig};
use super::prepare::{self, FitInput};
use heliosplat::light::Light;
use heliosplat::model::View;
use heliosplat::render::{PassOptions, render};
use heliosplat::train::Trainer;
use heliosplat_evaluate::image::psnr_db;
use heliosplat_fitting::training::TrainingError;
use heliosplat_scene::Split;
use heliosplat_session::Session;

/// Every so many images of training one is kept aside.
const ASIDE: usize = 6;
/// With fewer images nothing is tried: those left would not do.
const LEAST_IMAGES: usize = 18;
/// Short fits look at images this many times smaller.
const SMALLER: usize = 2;
/// Most Gaussians a short fit starts from.
const MOST_GAUSSIANS: usize = 6000;

/// Decibels on images kept aside by which a part must help to be taken: short fits find gloss worth 0.16 to 0.31 dB to
/// matt objects, which have none.
const LEAST_GAIN_DB: f64 = 0.3;
/// Share of the gain asked for that is enough for scattering: light that seeps out is smooth, and takes longer to learn than gloss
/// (wax: 0.30 dB in short fits, 1.2 dB in the end).
const SCATTERING_SHARE: f64 = 2.0 / 3.0;

/// One short fit.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Trial {
    /// What was tried, in words.
    pub what: String,
    /// PSNR on the images kept aside, decibels.
    pub psnr_db: f64,
}

/// What is fitted, and why.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Plan {
    /// The kind; never [`ModelKind::Auto`].
    pub kind: ModelKind,
    /// Whether surfaces are glossy, where the kind can be told.
    pub specular: bool,
    /// Whether light scatters under surfaces.
    pub scattering: bool,
    /// Why, in words.
    pub reason: String,
    /// The short fits that decided.
    pub trials: Vec<Trial>,
}

/// Whether every image of training has a light, and they are in different places.
fn lights_move(capture: &Capture) -> bool {
    let lights: Vec<_> = capture
        .of(Split::Train)
        .map(|f| f.light.map(|light| light.position))
        .collect();
    let first = lights.first().copied().flatten();
    lights.iter().all(Option::is_some) && lights.iter().any(|light| *light != first)
}

/// What a capture will be taken for, as far as its files tell.
pub fn outlook(capture: &Capture) -> (ModelKind, &'static str) {
    if lights_move(capture) {
        return (
            ModelKind::Olat,
            "every image has a light, and they are in different places; short fits decide whether surfaces are glossy",
        );
    }
    (
        ModelKind::Auto,
        "the images do not have lights in different places; short fits decide between reflective and radiance",
    )
}

/// Parts that may be there or not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Parts {
    specular: bool,
    scattering: bool,
}

/// Decides.
///
/// # Errors
/// [`TrainingError`] when a short fit cannot go on.
pub fn plan(capture: &Capture, config: &ObjectConfig, session: &Session) -> Result<Plan, TrainingError> {
    let lamps = lights_move(capture);
    let (dull, glossy) = match config.model.kind {
        ModelKind::Auto if lamps => (ModelKind::Olat, ModelKind::Olat),
        ModelKind::Auto => (ModelKind::Radiance, ModelKind::Reflective),
        ModelKind::Olat => (ModelKind::Olat, ModelKind::Olat),
        told => {
            return Ok(Plan {
                kind: told,
                specular: config.model.specular,
                scattering: false,
                reason: "as told".into(),
                trials: Vec::new(),
            });
        }
    };
    // With lamps, what is not tried is there: it can only be told in the light of one lamp, and costs little.
    let untried = config.model.pilot_steps == 0 || capture.of(Split::Train).count() < LEAST_IMAGES;
    let may = Parts {
        specular: config.model.specular,
        scattering: config.model.scattering && dull == ModelKind::Olat,
    };
    if untried || may == NOTHING {
        let specular = may.specular && dull == ModelKind::Olat;
        let reason = if may == NOTHING {
            "parts are switched off"
        } else {
            "too few images, or steps, to try parts"
        };
        return Ok(Plan {
            kind: dull,
            specular,
            scattering: false,
            reason: reason.into(),
            trials: Vec::new(),
        });
    }
    let progress = session.progress("plan", 3);
    let mut trials = Vec::new();
    let mut tried = |what: &str, kind, parts| -> Result<f64, TrainingError> {
        let psnr_db = trial(capture, config, kind, parts)?;
        trials.push(Trial {
            what: what.into(),
            psnr_db,
        });
        progress.set(trials.len() as u64);
        Ok(psnr_db)
    };
    let least = LEAST_GAIN_DB;
    let (mut kind, mut parts) = (dull, NOTHING);
    let mut best = tried("neither", dull, NOTHING)?;
    let mut basis = format!("short fits, on images kept aside ({least} dB is needed");
    let mut verdicts = Vec::new();
    if may.specular {
        let with = Parts {
            specular: true,
            ..parts
        };
        let psnr = tried("gloss", glossy, with)?;
        // A model of material is ahead of one of radiance by its normals already; that is not gloss.
        let without = match glossy == dull {
            true => best,
            false => best.max(tried("material without gloss", glossy, parts)?),
        };
        let taken = psnr - without >= least;
        verdicts.push(verdict("gloss", psnr - without, taken));
        if taken {
            (kind, parts, best) = (glossy, with, psnr);
        }
    }
    if may.scattering {
        basis.push_str(", for scattering two thirds of it");
        let with = Parts {
            scattering: true,
            ..parts
        };
        let gain = tried("scattering", kind, with)? - best;
        let taken = gain >= SCATTERING_SHARE * least;
        verdicts.push(verdict("scattering", gain, taken));
        if taken {
            parts = with;
        }
    }
    Ok(Plan {
        kind,
        specular: parts.specular,
        scattering: parts.scattering,
        reason: format!("{basis}): {}", verdicts.join("; ")),
        trials,
    })
}

/// What was found of a part, in words.
fn verdict(part: &str, gain_db: f64, taken: bool) -> String {
    format!("{part} {gain_db:+.2} dB: {}", if taken { "taken" } else { "left out" })
}

const NOTHING: Parts = Parts {
    specular: false,
    scattering: false,
};

fn smaller(view: View) -> View {
    if view.image.width < 16 * SMALLER || view.image.height < 16 * SMALLER {
        return view;
    }
    let image = view.image.downscaled(SMALLER);
    View {
        camera: view.camera.downscaled(SMALLER),
        weight: vec![1.0; image.plane_len()],
        image,
        ..view
    }
}

/// A short fit of a kind of model; its PSNR on the images kept aside.
fn trial(capture: &Capture, config: &ObjectConfig, kind: ModelKind, parts: Parts) -> Result<f64, TrainingError> {
    let mut config = config.clone();
    config.model.specular = parts.specular;
    config.model.scattering = parts.scattering;
    config.start.gaussians = config.start.gaussians.min(MOST_GAUSSIANS);
    config.train.iterations = config.model.pilot_steps;
    config.train.density.every = 0;
    config.train.pyramid_share = 0.0;
    let all: Vec<&Frame> = capture.of(Split::Train).collect();
    let kept = |n: usize| n % ASIDE == ASIDE / 2;
    let frames: Vec<&Frame> = (0..all.len()).filter(|&n| !kept(n)).map(|n| all[n]).collect();
    let FitInput {
        kind,
        preparation,
        parameters,
        ..
    } = prepare::input(capture, kind, &config, &frames);
    let model = kind.model();
    let view = |frame: &Frame, n: usize| Some(smaller(super::views::view(frame, capture.centre, &preparation, n)?));
    let views: Vec<View> = frames.iter().enumerate().filter_map(|(n, f)| view(f, n)).collect();
    let mut options = config.train.clone();
    options.gsd_m = (SMALLER as f64 * capture.pixel_size) as f32;
    let mut trainer = Trainer::new(&*model, views, parameters, options, prepare::bounds(capture), None)?;
    while !trainer.finished() {
        trainer.step()?;
    }
    let (parameters, _) = trainer.into_best();
    let (mut sum, mut count) = (0.0f64, 0usize);
    for (n, frame) in all.iter().enumerate().filter(|(n, _)| kept(*n)) {
        let Some(view) = view(frame, n) else { continue };
        let light: Option<Light> = view.light;
        let seen = render(&*model, &parameters, &view.camera, light, None, PassOptions::default()).image;
        for (a, b) in seen.values.iter().zip(&view.image.values) {
            if b.is_finite() {
                sum += f64::from(a - b).powi(2);
                count += 1;
            }
        }
    }
    Ok(psnr_db((sum / count.max(1) as f64).max(1e-12), 1.0))
}
