//! What a training run is made of; each entry has a default and a reason.

use super::fault::TrainError;
use crate::optim::DensityOptions;
use crate::splat::ProjectionOptions;
use crate::trace::TraceOptions;

/// Options of a training run. Lengths are in ground sampling distances where they should follow the imagery.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainOptions {
    /// Steps, one view each; at most.
    pub iterations: usize,
    /// Rounds over all views, at most: a scene of few views needs fewer steps.
    pub rounds: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// Ground sampling distance, metres.
    pub gsd_m: f32,
    /// Gaussians to splats.
    pub projection: ProjectionOptions,
    /// Light to Gaussians.
    pub trace: TraceOptions,
    /// How the number of Gaussians changes.
    pub density: DensityOptions,
    /// First learning rate of positions, ground sampling distances per step.
    pub position_rate_gsd: f32,
    /// What remains of the learning rates of positions and features at the last step.
    pub final_rate: f32,
    /// Learning rate of log scales.
    pub log_scale_rate: f32,
    /// Learning rate of rotations.
    pub rotation_rate: f32,
    /// Learning rate of opacity logits.
    pub opacity_rate: f32,
    /// Smallest and largest standard deviation, ground sampling distances.
    pub scale_gsd: (f32, f32),
    /// Weight of the photometric loss.
    pub photometric_weight: f32,
    /// Share of the structural part in it.
    pub lambda_ssim: f32,
    /// Weight of depth–normal consistency; 0 is off.
    pub depth_normal_weight: f32,
    /// Depth range, ground sampling distances, beyond which neighbouring pixels are an edge and not a slope.
    pub depth_normal_edge_gsd: f32,
    /// Weight of shadow consistency; 0 is off.
    pub consistency_weight: f32,
    /// Steps between two passes of shadow consistency, which weigh that much more.
    pub consistency_every: usize,
    /// Weight of one surface per ray; 0 is off.
    pub one_surface_weight: f32,
    /// Standard deviation of depth, ground sampling distances, at which that loss saturates.
    pub one_surface_gsd: f32,
    /// Visits of a view that one trace of its light serves; gradients go back along the light on the visit that traces.
    pub light_every: usize,
    /// How far Gaussians have moved in the mean (ground sampling distances, plus the change of their opacities) before a view's
    /// light is traced anew, in place of a count of visits; 0 counts visits.
    pub light_moved: f32,
    /// Steps between two builds of the occluders' hierarchy, where that is the route of the light.
    pub hierarchy_every: usize,
    /// Levels of the image pyramid below full size, each half as wide; training begins at the coarsest. 0 is off.
    pub pyramid_levels: usize,
    /// Share of the steps spent on the coarser levels.
    pub pyramid_share: f32,
    /// Share of a view that a step looks at, a window at a random place; 1 is all of it.
    pub window_share: f32,
    /// Whether Adam leaves alone what a step did not see, instead of letting it coast.
    pub sparse: bool,
    /// Share of each image's tiles held out to watch for overfitting; 0 is none.
    pub holdout: f32,
    /// Rounds over all views without progress on held-out tiles after which training stops; 0 is never.
    pub patience: usize,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            iterations: 2000,
            rounds: 1000,
            seed: 1,
            gsd_m: 0.5,
            projection: ProjectionOptions::default(),
            trace: TraceOptions::default(),
            density: DensityOptions::default(),
            position_rate_gsd: 0.01,
            final_rate: 0.05,
            log_scale_rate: 5e-3,
            rotation_rate: 2e-3,
            opacity_rate: 0.06,
            scale_gsd: (0.1, 8.0),
            photometric_weight: 10.0,
            lambda_ssim: 0.2,
            depth_normal_weight: 0.5,
            depth_normal_edge_gsd: 3.0,
            consistency_weight: 0.2,
            consistency_every: 8,
            one_surface_weight: 0.0,
            one_surface_gsd: 2.0,
            light_every: 4,
            light_moved: 0.0,
            hierarchy_every: 25,
            pyramid_levels: 0,
            pyramid_share: 0.4,
            window_share: 1.0,
            sparse: false,
            holdout: 0.04,
            patience: 25,
        }
    }
}

impl TrainOptions {
    /// These options with the steps that a scene of `views` views gets.
    pub fn for_views(mut self, views: usize) -> Self {
        self.iterations = self.iterations.min(self.rounds.saturating_mul(views));
        self
    }

    /// Whether every option means something.
    ///
    /// # Errors
    /// [`TrainError::Option`] names the first that does not.
    pub fn check(&self) -> Result<(), TrainError> {
        let bad = |option, value: String, expected| {
            Err(TrainError::Option {
                option,
                value,
                expected,
            })
        };
        let (d, p, t) = (&self.density, &self.projection, &self.trace);
        for (option, value) in [
            ("position_rate_gsd", self.position_rate_gsd),
            ("final_rate", self.final_rate),
            ("log_scale_rate", self.log_scale_rate),
            ("rotation_rate", self.rotation_rate),
            ("opacity_rate", self.opacity_rate),
            ("photometric_weight", self.photometric_weight),
            ("depth_normal_weight", self.depth_normal_weight),
            ("consistency_weight", self.consistency_weight),
            ("one_surface_weight", self.one_surface_weight),
            ("light_moved", self.light_moved),
            ("density.growth", d.growth),
            ("density.until_fraction", d.until_fraction),
            ("density.prune_opacity", d.prune_opacity),
            ("projection.filter_px2", p.filter_px2),
            ("trace.bias_sigmas", t.bias_sigmas),
            ("trace.lift", t.lift),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                return bad(option, value.to_string(), "a finite number that is not negative");
            }
        }
        for (option, value) in [
            ("gsd_m", self.gsd_m),
            ("depth_normal_edge_gsd", self.depth_normal_edge_gsd),
            ("one_surface_gsd", self.one_surface_gsd),
            ("density.split_gsd", d.split_gsd),
            ("density.prune_gsd", d.prune_gsd),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return bad(option, value.to_string(), "a finite number above zero");
            }
        }
        for (option, value) in [
            ("lambda_ssim", self.lambda_ssim),
            ("pyramid_share", self.pyramid_share),
            ("window_share", self.window_share),
            ("holdout", self.holdout),
        ] {
            if !(0.0..=1.0).contains(&value) {
                return bad(option, value.to_string(), "a number from 0 to 1");
            }
        }
        let (least, most) = self.scale_gsd;
        if !(least > 0.0 && least <= most && most.is_finite()) {
            return bad(
                "scale_gsd",
                format!("[{least}, {most}]"),
                "two finite numbers above zero, the smaller first",
            );
        }
        Ok(())
    }

    /// How many times as many Gaussians as at the start there are at the end, at most.
    pub fn growth(&self) -> f64 {
        let d = &self.density;
        let last = (d.until_fraction * self.iterations as f32) as usize;
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
    fn few_views_get_few_steps_and_many_no_more_than_said() {
        let options = TrainOptions {
            iterations: 600,
            rounds: 60,
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
        assert!(named(|o| o.scale_gsd = (8.0, 0.1)).contains("train.scale_gsd is [8, 0.1]"));
        assert!(named(|o| o.gsd_m = f32::NAN).contains("train.gsd_m is NaN"));
        assert!(named(|o| o.lambda_ssim = 1.5).contains("from 0 to 1"));
        assert!(named(|o| o.opacity_rate = f32::INFINITY).contains("train.opacity_rate is inf"));
    }

    #[test]
    fn growth_counts_the_times_that_gaussians_are_added() {
        let mut options = TrainOptions {
            iterations: 600,
            ..TrainOptions::default()
        };
        options.density.every = 100;
        options.density.from = 100;
        options.density.until_fraction = 0.6;
        options.density.growth = 0.05;
        assert!((options.growth() - 1.05f64.powi(3)).abs() < 1e-6);
        options.density.every = 0;
        assert!(options.growth() == 1.0);
    }
}
