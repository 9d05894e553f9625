//! Short fits on pieces of the scene, with and without a component whose worth only the images can tell.
//!
//! All fits start from the same Gaussians, see the same crops in the same order and learn nothing from the same tiles of pixels. There
//! they are compared, piece of ground by piece of ground ([`heliosplat_fitting::paired`]). What is better beyond chance is kept for
//! those that follow; where nothing is beyond chance, the plan stays as it was.

mod windows;

use heliosplat::gaussians::Table;
use heliosplat::light::Light;
use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
use heliosplat::model::{Parameters, SceneModel, View};
use heliosplat::render::{PassOptions, render};
use heliosplat::train::{TrainError, TrainOptions, Trainer};
use heliosplat_fitting::paired::{Gain, Piece, Verdict};
use heliosplat_scene::Area;
use std::time::Instant;
use windows::{Window, windows};

/// Passes over all views that a short fit makes, and its fewest and most steps.
const EPOCHS: usize = 3;
const STEPS: (usize, usize) = (24, 48);
/// Fewest steps of a training before which components are tried.
pub(super) const WORTH_STEPS: usize = 200;
/// Share of a training's work that short fits may take, in steps times Gaussians; one window is tried at any rate.
const MOST_WORK: f64 = 0.1;
/// Most windows.
const MOST_WINDOWS: usize = 4;
/// Decibels by which a component must help besides being better beyond chance: what helps less is not worth its memory
/// (docs/lab/planner.md: near-surface light was taken twice at 0.06 and 0.07, and whole trainings did not gain from it).
const LEAST_GAIN_DB: f64 = 0.1;

/// A component that is tried. The shadow prior is not: it leads a training, so short fits gain by it where whole trainings
/// lose (docs/lab/planner.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Component {
    /// Near-surface light per Gaussian.
    NearLight,
    /// Spherical harmonics of albedo, of degree 1.
    Harmonics,
}

impl Component {
    /// All of them, in the order in which they are tried.
    pub const ALL: [Self; 2] = [Self::NearLight, Self::Harmonics];

    /// Its name in the configuration.
    pub fn key(self) -> &'static str {
        match self {
            Self::NearLight => "model.near_light",
            Self::Harmonics => "model.sh_degree",
        }
    }

    fn is_on(self, options: &ShadowGsOptions) -> bool {
        match self {
            Self::NearLight => options.near_light,
            Self::Harmonics => options.degree > 0,
        }
    }

    fn switched(self, options: &ShadowGsOptions) -> ShadowGsOptions {
        let on = !self.is_on(options);
        let mut options = options.clone();
        match self {
            Self::NearLight => options.near_light = on,
            Self::Harmonics => options.degree = usize::from(on),
        }
        options
    }
}

/// What short fits said of a component.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Trial {
    /// The component.
    pub component: Component,
    /// What having it gains on pixels kept aside; `None` of too few pieces, or when a fit could not go on.
    pub gain: Option<Gain>,
    /// Time of a step with it over that of one without, medians.
    pub step_time_ratio: f64,
    /// What it adds to each Gaussian, numbers.
    pub numbers_per_gaussian: usize,
    /// Whether the model has it.
    pub on: bool,
    /// Whether the gain says so; else the plan before it.
    pub decided: bool,
}

/// What was tried, and how.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Trials {
    /// Component by component; empty where nothing was tried.
    pub trials: Vec<Trial>,
    /// Why nothing was tried, if so.
    pub untried: Option<String>,
    /// Windows of ground.
    pub windows: usize,
    /// Steps of each fit.
    pub steps: usize,
    /// Seconds that all took.
    pub seconds: f64,
}

/// What is tried on what.
pub(super) struct Request<'a> {
    /// The model as it is without trials.
    pub(super) options: &'a ShadowGsOptions,
    /// Its start.
    pub(super) parameters: &'a Parameters,
    /// The views.
    pub(super) views: &'a [View],
    /// The training to come.
    pub(super) train: &'a TrainOptions,
    /// The ground, metres.
    pub(super) area: &'a Area,
    /// Which components may be tried.
    pub(super) open: &'a [Component],
}

impl Request<'_> {
    /// Tries all open components, one after the other.
    pub(super) fn run(&self) -> Trials {
        let begun = Instant::now();
        let untried = |reason: &str| Trials {
            untried: Some(reason.into()),
            ..Trials::default()
        };
        if self.open.is_empty() {
            return Trials::default();
        }
        let iterations = self.train.iterations;
        if iterations < WORTH_STEPS {
            return untried(&format!(
                "short fits would take too large a share of {iterations} steps"
            ));
        }
        let steps = (EPOCHS * self.views.len()).clamp(STEPS.0, STEPS.1);
        let all = windows(self.parameters, self.views, self.area, self.train.seed, MOST_WINDOWS);
        // As many as the work allows.
        let fits = (self.open.len() + 1) * steps;
        let most = MOST_WORK * iterations as f64 * self.parameters.gaussians.count as f64;
        let mut work = 0.0;
        let affordable = all.iter().take_while(|window| {
            work += (fits * window.gaussians.len()) as f64;
            work <= most
        });
        let count = affordable.count().max(1).min(all.len());
        let windows = &all[..count];
        if windows.is_empty() {
            return untried("no piece of the ground shows enough");
        }
        let mut options = self.options.clone();
        let fit = |options: &ShadowGsOptions| self.fit(options, windows, steps);
        let mut trials = Vec::new();
        let mut current = fit(&options);
        for &component in self.open {
            let other_options = component.switched(&options);
            let other = fit(&other_options);
            let was_on = component.is_on(&options);
            let (without, with) = if was_on { (&other, &current) } else { (&current, &other) };
            let (gain, step_time_ratio) = compare(without, with);
            let verdict = gain.map_or(Verdict::Undecided, |gain| gain.verdict(LEAST_GAIN_DB));
            let on = match verdict {
                Verdict::Better => true,
                Verdict::Worse => false,
                Verdict::Undecided => was_on,
            };
            let numbers = |options: &ShadowGsOptions| -> usize {
                let groups = ShadowGs::new(options.clone()).feature_groups();
                groups.iter().map(|group| group.width).sum()
            };
            trials.push(Trial {
                component,
                gain,
                step_time_ratio,
                numbers_per_gaussian: numbers(&options).abs_diff(numbers(&other_options)),
                on,
                decided: verdict != Verdict::Undecided,
            });
            if on != was_on {
                (options, current) = (other_options, other);
            }
        }
        Trials {
            trials,
            untried: None,
            windows: windows.len(),
            steps,
            seconds: begun.elapsed().as_secs_f64(),
        }
    }

    /// Short fits of a model on all windows.
    fn fit(&self, options: &ShadowGsOptions, windows: &[Window], steps: usize) -> Result<Scored, TrainError> {
        let model = ShadowGs::new(options.clone());
        let mut train = self.train.clone();
        train.iterations = steps;
        train.density.every = 0;
        train.pyramid_share = 0.0;
        train.consistency_weight = 0.0;
        train.depth_normal_weight = 0.0;
        train.patience = 0;
        train.holdout = 0.0;
        let mut scored = Scored::default();
        for window in windows {
            let whole = Parameters {
                gaussians: self.parameters.gaussians.gather(&window.gaussians),
                globals: self.parameters.globals.clone(),
            };
            let parameters = regrouped(&model, &whole);
            let views = window.training_views();
            let mut trainer = Trainer::new(&model, views, parameters, train.clone(), window.bounds, None)?;
            while !trainer.finished() {
                let begun = Instant::now();
                trainer.step()?;
                scored.step_s.push(begun.elapsed().as_secs_f64());
            }
            let (parameters, _) = trainer.into_best();
            scored.errors.push(errors(&model, &parameters, window));
        }
        Ok(scored)
    }
}

/// How short fits went.
#[derive(Default)]
struct Scored {
    /// Squared errors of each piece of ground, window by window.
    errors: Vec<Vec<f64>>,
    /// Seconds of each step.
    step_s: Vec<f64>,
}

impl Scored {
    fn median_step_s(&self) -> f64 {
        let mut seconds = self.step_s.clone();
        seconds.sort_by(f64::total_cmp);
        seconds.get(seconds.len() / 2).copied().unwrap_or(f64::NAN)
    }
}

/// What having a component gains, and the time of its steps over that of those without.
fn compare(without: &Result<Scored, TrainError>, with: &Result<Scored, TrainError>) -> (Option<Gain>, f64) {
    let (Ok(without), Ok(with)) = (without, with) else {
        return (None, f64::NAN);
    };
    let errors = without.errors.iter().zip(&with.errors);
    let windows: Vec<Vec<Piece>> = errors
        .map(|(without, with)| {
            let pieces = without.iter().zip(with);
            pieces.map(|(&without, &with)| Piece { without, with }).collect()
        })
        .collect();
    (
        Gain::of_groups(&windows),
        with.median_step_s() / without.median_step_s(),
    )
}

/// Squared errors over the pixels kept aside, summed over views, of each piece of ground of a window.
fn errors(model: &ShadowGs, parameters: &Parameters, window: &Window) -> Vec<f64> {
    let mut sums = vec![0.0; window.pieces];
    for cut in &window.cuts {
        let View { camera, light, .. } = &cut.view;
        let light: Option<Light> = *light;
        let appearance = Some(cut.view.appearance);
        let seen = render(model, parameters, camera, light, appearance, PassOptions::default()).image;
        let truth = cut.view.truth(&seen);
        for &(pixel, piece) in &cut.aside {
            for band in 0..seen.bands {
                let error = f64::from(seen.plane(band)[pixel] - truth.plane(band)[pixel]);
                if error.is_finite() {
                    sums[piece] += error * error;
                }
            }
        }
    }
    sums
}

/// The same parameters with the groups of `model`: those it does not have are left out, those that were not there are zero.
pub(super) fn regrouped(model: &ShadowGs, parameters: &Parameters) -> Parameters {
    let from = &parameters.gaussians;
    let mut groups = heliosplat::gaussians::core_groups();
    groups.extend(model.feature_groups());
    let mut gaussians = Table::zeros(groups, from.count);
    for group in &mut gaussians.groups {
        if let Some(same) = from.groups.iter().find(|other| other.spec == group.spec) {
            group.values.copy_from_slice(&same.values);
        }
    }
    Parameters {
        gaussians,
        globals: parameters.globals.clone(),
    }
}
