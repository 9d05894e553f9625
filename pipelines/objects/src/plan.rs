//! Selection of a model for a capture and of its parts, by measurement.
//!
//! The lights decide between the kinds with lamps and those without. Parts that depend on the images are tried: short
//! fits with and without a part (`trial.rs`) are compared on held-out training images. A part is included when it gains
//! more than two standard errors and more than a least gain.

use super::capture::Capture;
use super::config::{ModelKind, ObjectConfig, Parts};
use super::paired::{Gain, Verdict};
use super::trial::{self, LEAST_IMAGES, Scored};
use heliosplat_fitting::training::TrainingError;
use heliosplat_scene::Split;
use heliosplat_session::Session;

/// Least gain of a part on held-out images, decibels, in addition to its significance (docs/lab/objects.md).
const LEAST_GAIN_DB: f64 = 0.05;
/// Least gain of gloss that needs a model of another kind, decibels. That model takes twice as long, and gains a little
/// even on objects without gloss.
const LEAST_GAIN_OF_KIND_DB: f64 = 0.5;

/// Result of short fits with and without a part.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Trial {
    /// Name of the part: `gloss` or `scattering`.
    pub part: String,
    /// PSNR on held-out images without the part, decibels.
    pub without_db: f64,
    /// PSNR on held-out images with the part, decibels.
    pub with_db: f64,
    /// Gain over the pieces of held-out images; `None` for too few pieces.
    pub gain: Option<Gain>,
    /// Least gain for which the part is included, decibels.
    pub least_db: f64,
    /// Time of a step with the part over that of a step without.
    pub step_time_ratio: f64,
    /// Numbers that the part adds to each Gaussian.
    pub numbers_per_gaussian: i64,
    /// True if the part is included in the model.
    pub taken: bool,
}

/// The model to fit and the reasons.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Plan {
    /// The kind; never [`ModelKind::Auto`].
    pub kind: ModelKind,
    /// Optional parts of the model.
    pub parts: Parts,
    /// Reason for the choice, in words.
    pub reason: String,
    /// Results of the short fits.
    pub trials: Vec<Trial>,
}

/// True if every training image has a light, and the lights are in different places.
fn lights_move(capture: &Capture) -> bool {
    let lights: Vec<_> = capture
        .of(Split::Train)
        .map(|f| f.light.map(|light| light.position))
        .collect();
    let first = lights.first().copied().flatten();
    lights.iter().all(Option::is_some) && lights.iter().any(|light| *light != first)
}

/// Kind of model to expect from the files of a capture alone, and the reason in words.
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

/// A kind of model with its parts.
type Candidate = (ModelKind, Parts);

/// Short fits in turn, each compared with the best so far.
struct Trials<'a> {
    capture: &'a Capture,
    config: &'a ObjectConfig,
    best: (Candidate, Scored),
    trials: Vec<Trial>,
}

impl Trials<'_> {
    /// Fits `with`, and keeps it where it is better than the best so far. `with` must also be better than `also`, a
    /// model of its kind without the part.
    fn compare(&mut self, part: &str, with: Candidate, also: Option<Candidate>) -> Result<(), TrainingError> {
        let fit = |(kind, parts): Candidate| trial::fit(self.capture, self.config, kind, parts);
        let fitted = fit(with)?;
        let also = also.map(fit).transpose()?;
        let best = &self.best.1;
        let without = also.as_ref().filter(|also| also.psnr_db > best.psnr_db).unwrap_or(best);
        let gain = fitted.gain_over(without);
        let least_db = match with.0 == self.best.0.0 {
            true => LEAST_GAIN_DB,
            false => LEAST_GAIN_OF_KIND_DB,
        };
        let taken = gain.is_some_and(|gain| gain.verdict(least_db) == Verdict::Better);
        let numbers = |scored: &Scored| scored.numbers_per_gaussian as i64;
        self.trials.push(Trial {
            part: part.into(),
            without_db: without.psnr_db,
            with_db: fitted.psnr_db,
            gain,
            least_db,
            step_time_ratio: fitted.step_s / without.step_s.max(1e-9),
            numbers_per_gaussian: numbers(&fitted) - numbers(without),
            taken,
        });
        if taken {
            self.best = (with, fitted);
        }
        Ok(())
    }
}

/// Selects the model and its parts.
///
/// # Errors
/// [`TrainingError`] when a short fit fails.
pub fn plan(capture: &Capture, config: &ObjectConfig, session: &Session) -> Result<Plan, TrainingError> {
    let lamps = lights_move(capture);
    let (dull, glossy) = match config.model.kind {
        ModelKind::Auto if lamps => (ModelKind::Olat, ModelKind::Olat),
        ModelKind::Auto => (ModelKind::Radiance, ModelKind::Reflective),
        ModelKind::Olat => (ModelKind::Olat, ModelKind::Olat),
        kind => {
            let parts = Parts {
                specular: config.model.specular,
                ..Parts::default()
            };
            return Ok(untried(kind, parts, "as configured"));
        }
    };
    let olat = dull == ModelKind::Olat;
    let nothing = Parts::default();
    let may = Parts {
        specular: config.model.specular,
        scattering: config.model.scattering && olat,
    };
    if may == nothing {
        return Ok(untried(dull, nothing, "parts are switched off"));
    }
    if config.model.pilot_steps == 0 || capture.of(Split::Train).count() < LEAST_IMAGES {
        // With lamps, gloss that is not tried is included: it costs little, and only images under a single lamp measure
        // it.
        let parts = Parts {
            specular: may.specular && olat,
            ..nothing
        };
        let reason = match config.model.pilot_steps {
            0 => "no short fits",
            _ => "too few images for short fits",
        };
        return Ok(untried(dull, parts, reason));
    }
    let progress = session.progress("plan", 3);
    let mut trials = Trials {
        capture,
        config,
        best: ((dull, nothing), trial::fit(capture, config, dull, nothing)?),
        trials: Vec::new(),
    };
    progress.set(1);
    if may.specular {
        let without = trials.best.0.1;
        let mut with = without;
        with.specular = true;
        // A model of material is ahead of one of radiance by its normals already; that is not gloss.
        trials.compare("gloss", (glossy, with), (glossy != dull).then_some((glossy, without)))?;
        progress.set(if olat { 2 } else { 3 });
    }
    if may.scattering {
        let (kind, mut with) = trials.best.0;
        with.scattering = true;
        trials.compare("scattering", (kind, with), None)?;
        progress.set(3);
    }
    let (((kind, parts), _), trials) = (trials.best, trials.trials);
    let verdicts: Vec<String> = trials.iter().map(in_words).collect();
    Ok(Plan {
        kind,
        parts,
        reason: format!(
            "short fits, on pieces of images kept aside (taken beyond two standard errors and a least gain): {}",
            verdicts.join("; ")
        ),
        trials,
    })
}

/// A plan without short fits.
fn untried(kind: ModelKind, parts: Parts, reason: &str) -> Plan {
    Plan {
        kind,
        parts,
        reason: reason.into(),
        trials: Vec::new(),
    }
}

/// Result of a trial in words.
fn in_words(trial: &Trial) -> String {
    let gain = match trial.gain {
        Some(gain) => gain.in_words(),
        None => "too few pieces".into(),
    };
    let taken = if trial.taken { "taken" } else { "left out" };
    format!("{} {gain} (at least {} dB): {taken}", trial.part, trial.least_db)
}
