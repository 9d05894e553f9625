//! Options of a training run, each with its default and reason.

use super::fault::TrainError;
use crate::optim::DensityOptions;
use crate::optim::adam::BETA1;
use crate::optim::density::UNTIL_FRACTION;
use crate::trace::SunVisibility;

/// Options of a training run. Lengths are in ground sampling distances where they should follow the imagery.
///
/// Fields that serde skips are not user settings: they follow from the scene and its kind, and the program sets them.
/// Their defaults are for ground seen from satellites.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainOptions {
    /// Largest number of steps, one view each. 100 in `fast`, 1000 in `accurate`.
    pub iterations: usize,
    /// Largest number of epochs, passes over all views: a scene of few views needs fewer steps. 10 in `fast`, 100 in
    /// `accurate`.
    pub epochs: usize,
    /// First learning rate of positions, ground sampling distances per step: 0.002 in `accurate`, because level ground
    /// gets rougher with every step that moves it, 0.04 for objects, which start from a hull.
    pub position_rate_gsd: f32,
    /// Weight of shadow consistency; 0 is off. 0.2 for ground, 0 for objects, which have no zenith.
    pub consistency_weight: f32,
    /// Steps between two passes of shadow consistency, each with a weight larger by this factor: 16 in `fast`, 4 in
    /// `accurate`.
    pub consistency_every: usize,
    /// Steps of a view that share one trace of its light; gradients go back along the light on the step that traces. 2
    /// in `fast`, 1 in `balanced`.
    pub light_every: usize,
    /// Number of traces of which a Gaussian takes part in one while its light hardly changes the view's image; 1: in
    /// all. 8 for ground, 1 for objects.
    pub negligible_light_every: usize,
    /// Search for the Gaussians between a Gaussian and the sun: `plane`, grids on the plane normal to the sun, or
    /// `bvh`, the bounding volume hierarchy, which takes half as long again and gives the same light to 0.002.
    pub sun_visibility: SunVisibility,
    /// True if gradients of light reach the occluders; without them only the origins of rays move. Off in the ablation,
    /// in which it has the largest effect.
    pub occluder_gradients: bool,
    /// Share of the steps spent on images of half size, at the beginning; 0 is off. 0.4 for ground, 0.15 for objects.
    pub pyramid_share: f32,
    /// Epochs without progress on held-out tiles after which training stops; 0 is never, and all pixels are trained on.
    /// 0 in `fast`, 2 in the ablation.
    pub patience: usize,
    /// Options of density control.
    pub density: DensityOptions,
    /// Seed of all random numbers.
    #[serde(skip)]
    pub seed: u64,
    /// Ground sampling distance, metres.
    #[serde(skip)]
    pub gsd_m: f32,
    /// Factor on the learning rates of positions and features at the last step.
    #[serde(skip)]
    pub final_rate: f32,
    /// Learning rate of opacity logits.
    #[serde(skip)]
    pub opacity_rate: f32,
    /// Number of steps from which on opacities, log scales and features have their own learning rates. A shorter
    /// training raises these rates by the root of the ratio of steps, more steeply below a quarter of that number, and
    /// at most eightfold, because the parameters have as far to go. 0 disables this.
    #[serde(skip)]
    pub own_rate_steps: usize,
    /// Weight of the smoothness of a model's first feature between neighbours on one surface
    /// ([`smoothness`](crate::loss::smoothness)); 0 is off. 0.1 for the albedo of ground.
    #[serde(skip)]
    pub smoothness_weight: f32,
    /// Weights of the mean standard deviation, ground sampling distances, and of the mean opacity in the loss: Gaussians
    /// that an image does not need get small and fade (Kheradmand et al. 2024). 0 is off.
    #[serde(skip)]
    pub prior_weights: (f32, f32),
    /// True if cameras may turn about their centres, as the images ask; a device other than the CPU leaves them.
    #[serde(skip)]
    pub turn_cameras: bool,
    /// Smallest and largest standard deviation, ground sampling distances.
    #[serde(skip)]
    pub scale_gsd: (f32, f32),
    /// Share of each image's tiles held out to watch for overfitting; 0 is none.
    #[serde(skip)]
    pub holdout: f32,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            iterations: 2000,
            epochs: 1000,
            position_rate_gsd: 0.01,
            consistency_weight: 0.2,
            consistency_every: 8,
            light_every: 4,
            negligible_light_every: 8,
            sun_visibility: SunVisibility::default(),
            occluder_gradients: true,
            pyramid_share: 0.0,
            patience: 25,
            density: DensityOptions::default(),
            seed: 1,
            gsd_m: 0.5,
            final_rate: 0.05,
            opacity_rate: 0.06,
            own_rate_steps: 0,
            smoothness_weight: 0.0,
            prior_weights: (0.0, 0.0),
            turn_cameras: false,
            scale_gsd: (0.1, 8.0),
            holdout: 0.04,
        }
    }
}

/// Largest factor on the learning rates of opacities, log scales and features.
const MOST_RATE_FACTOR: f32 = 8.0;
/// Share of `own_rate_steps` below which a training is short: rates grow faster with fewer steps, and Adam remembers
/// less.
const SHORT_SHARE: f32 = 0.25;
/// Least decay of Adam's first moment per step.
const LEAST_BETA1: f32 = 0.7;

impl TrainOptions {
    /// Ratio of the steps to those below which a training is short; one if `own_rate_steps` is 0.
    fn shortness(&self) -> f32 {
        let short = SHORT_SHARE * self.own_rate_steps as f32;
        match short > 0.0 {
            true => self.iterations.max(1) as f32 / short,
            false => 1.0,
        }
    }

    /// Factor on the learning rates of opacities, log scales and features, 1 to [`MOST_RATE_FACTOR`]: the root of
    /// `own_rate_steps` over the steps, and in a short training the power of three quarters (docs/lab/start.md, by
    /// ablation).
    pub(super) fn rate_factor(&self) -> f32 {
        let root = (self.own_rate_steps as f32 / self.iterations.max(1) as f32).sqrt();
        let steeper = self.shortness().min(1.0).powf(-0.25);
        (root * steeper).clamp(1.0, MOST_RATE_FACTOR)
    }

    /// Decay of Adam's first moment per step. The default remembers ten steps; in a short training these are a large
    /// part, and their gradients are outdated. There the memory shrinks in proportion to the steps, to three at least.
    pub(super) fn beta1(&self) -> f32 {
        match self.shortness() < 1.0 {
            true => (1.0 - (1.0 - BETA1) / self.shortness()).max(LEAST_BETA1),
            false => BETA1,
        }
    }

    /// These options with at most `epochs` steps per view, for `views` views.
    pub fn for_views(mut self, views: usize) -> Self {
        self.iterations = self.iterations.min(self.epochs.saturating_mul(views));
        self
    }

    /// Checks the range of every option.
    ///
    /// # Errors
    /// [`TrainError::Option`] names the first option out of range.
    pub fn check(&self) -> Result<(), TrainError> {
        let not_negative = |option, value: f32| {
            let fits = value >= 0.0 && value.is_finite();
            (option, value, fits, "a finite number that is not negative")
        };
        let above_zero = |option, value: f32| {
            let fits = value > 0.0 && value.is_finite();
            (option, value, fits, "a finite number above zero")
        };
        let share = |option, value: f32| (option, value, (0.0..=1.0).contains(&value), "a number from 0 to 1");
        for (option, value, fits, expected) in [
            not_negative("position_rate_gsd", self.position_rate_gsd),
            not_negative("consistency_weight", self.consistency_weight),
            not_negative("smoothness_weight", self.smoothness_weight),
            share("pyramid_share", self.pyramid_share),
            above_zero("gsd_m", self.gsd_m),
        ] {
            if !fits {
                return Err(TrainError::Option {
                    option,
                    value: value.to_string(),
                    expected,
                });
            }
        }
        Ok(())
    }

    /// Largest ratio of the final number of Gaussians to the initial one.
    pub fn growth(&self) -> f64 {
        let d = &self.density;
        let last = (UNTIL_FRACTION * self.iterations as f32) as usize;
        if d.every == 0 || last < d.from {
            return 1.0;
        }
        let times = last / d.every - d.from.saturating_sub(1) / d.every;
        (1.0 + f64::from(d.growth)).powi(times as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_of_the_steps_moves_twice_as_fast_and_more_steps_no_slower_than_at_their_own_rate() {
        let of = |iterations| of_steps(iterations).rate_factor();
        assert_eq!([5000, 1600, 400, 10].map(of), [1.0, 1.0, 2.0, 8.0]);
        assert!((of(100) - 4.0 * 2f32.sqrt()).abs() < 1e-3);
        assert_eq!(TrainOptions::default().rate_factor(), 1.0);
    }

    #[test]
    fn a_short_training_remembers_fewer_gradients() {
        let of = |iterations| of_steps(iterations).beta1();
        assert_eq!([1000, 400, 100, 10].map(of), [0.9, 0.9, 0.7, 0.7]);
        assert!((of(200) - 0.8).abs() < 1e-6);
        assert_eq!(
            TrainOptions {
                iterations: 100,
                ..TrainOptions::default()
            }
            .beta1(),
            0.9
        );
    }

    /// Options of a training of ground in `iterations` steps.
    fn of_steps(iterations: usize) -> TrainOptions {
        TrainOptions {
            iterations,
            own_rate_steps: 1600,
            ..TrainOptions::default()
        }
    }

    #[test]
    fn few_views_get_few_steps_and_many_no_more_than_said() {
        let options = TrainOptions {
            iterations: 600,
            epochs: 60,
            ..TrainOptions::default()
        };
        assert_eq!(options.clone().for_views(2).iterations, 120);
        assert_eq!(options.for_views(40).iterations, 600);
    }

    #[test]
    fn an_option_that_means_nothing_is_named() {
        assert_eq!(TrainOptions::default().check(), Ok(()));
        let named = |change: fn(&mut TrainOptions)| {
            let mut options = TrainOptions::default();
            change(&mut options);
            options.check().expect_err("no meaning").to_string()
        };
        assert!(named(|o| o.gsd_m = f32::NAN).contains("train.gsd_m is NaN"));
        assert!(named(|o| o.pyramid_share = 1.5).contains("from 0 to 1"));
        assert!(named(|o| o.position_rate_gsd = f32::INFINITY).contains("train.position_rate_gsd is inf"));
    }

    #[test]
    fn growth_counts_the_times_that_gaussians_are_added() {
        let mut options = TrainOptions {
            iterations: 600,
            ..TrainOptions::default()
        };
        options.density.every = 100;
        options.density.growth = 0.05;
        assert!((options.growth() - 1.05f64.powi(3)).abs() < 1e-6);
        options.density.from = 300;
        assert!((options.growth() - 1.05f64).abs() < 1e-6);
        options.density.every = 0;
        assert!(options.growth() == 1.0);
    }
}
