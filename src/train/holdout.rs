//! Early stopping: some tiles of every image are held out; when they stop improving, training has begun to overfit.

use super::options::TrainOptions;
use crate::model::{Parameters, View};
use crate::raster::Raster;

/// Side of a held-out tile, pixels: several times the SSIM window, so that its inside is hardly affected by trained
/// pixels.
const TILE: usize = 24;
/// Least relative decrease of the held-out loss that counts as progress.
const PROGRESS: f64 = 1e-3;

/// Result of early stopping at the end of a training.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EarlyStop {
    /// Number of steps done.
    pub steps: usize,
    /// Step of the state that is kept.
    pub best_step: usize,
    /// Mean absolute difference on held-out tiles at that step, if any were held out.
    pub best_l1: Option<f64>,
}

/// Held-out pixels of all views, and the progress on them.
pub(super) struct Holdout {
    held: Vec<Vec<u32>>,
    patience: usize,
    /// Its state.
    pub(super) now: HoldoutState,
}

/// State of the watch over held-out tiles. The tiles follow from the seed.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct HoldoutState {
    /// Latest loss of each view.
    pub(super) losses: Vec<Option<f64>>,
    /// Step, loss and parameters of the best state so far; `None` before the first epoch that was compared.
    pub(super) best: Option<(usize, f64, Parameters)>,
    epochs_without: usize,
    keep_from: usize,
}

/// A pseudo-random number from 0 to 1 that depends only on seed and tile.
fn tile_draw(seed: u64, view: usize, column: usize, row: usize) -> f32 {
    let mut h = seed ^ (view as u64) << 40 ^ (column as u64) << 20 ^ row as u64;
    h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((h ^ (h >> 31)) >> 40) as f32 / (1u64 << 24) as f32
}

/// Mean absolute difference over the `held` pixels of a view; `None` without any.
pub(super) fn loss(held: &[u32], image: &Raster, truth: &Raster) -> Option<f64> {
    let plane = image.plane_len();
    let (mut sum, mut count) = (0.0f64, 0usize);
    for &i in held {
        for band in 0..image.bands {
            let t = truth.values[band * plane + i as usize];
            if t.is_finite() {
                sum += f64::from((image.values[band * plane + i as usize] - t).abs());
                count += 1;
            }
        }
    }
    (count > 0).then(|| sum / count as f64)
}

impl Holdout {
    /// Holds tiles of `views` out: sets the weight of their pixels to zero. Without early stopping, all pixels are
    /// trained on.
    pub(super) fn new(views: &mut [View], options: &TrainOptions) -> Self {
        let share = if options.patience > 0 { options.holdout } else { 0.0 };
        let mut held = Vec::new();
        for (v, view) in views.iter_mut().enumerate() {
            let width = view.image.width;
            let held_out = |i: usize| {
                let (column, row) = (i % width / TILE, i / width / TILE);
                tile_draw(options.seed, v, column, row) < share
            };
            let counts = |i: &usize| view.weight[*i] > 0.0;
            let mut out: Vec<u32> = Vec::new();
            // A small image may be one tile: some pixels must remain for training.
            if (0..view.weight.len()).filter(counts).any(|i| !held_out(i)) {
                out = (0..view.weight.len())
                    .filter(counts)
                    .filter(|&i| held_out(i))
                    .map(|i| i as u32)
                    .collect();
            }
            for &i in &out {
                view.weight[i as usize] = 0.0;
            }
            held.push(out);
        }
        Self {
            held,
            patience: options.patience,
            now: HoldoutState {
                losses: vec![None; views.len()],
                best: None,
                epochs_without: 0,
                keep_from: options.iterations / 4,
            },
        }
    }

    /// Held-out pixels of a view.
    pub(super) fn held(&self, view: usize) -> &[u32] {
        &self.held[view]
    }

    /// Records the loss of a view; drops one that is not finite, which would pass for the best.
    pub(super) fn record(&mut self, view: usize, loss: Option<f64>) {
        self.now.losses[view] = loss.filter(|loss| loss.is_finite());
    }

    /// True if `step` ends an epoch over `views` views whose parameters may be kept.
    pub(super) fn compares(&self, step: usize, views: usize) -> bool {
        self.patience > 0 && step.is_multiple_of(views) && step >= self.now.keep_from
    }

    /// Keeps `parameters` if their held-out losses are the best so far; counts epochs without progress.
    pub(super) fn epoch_done(&mut self, step: usize, parameters: &Parameters) {
        let Some(mean) = self.mean() else { return };
        match &self.now.best {
            Some((_, best, _)) if mean > best * (1.0 - PROGRESS) => self.now.epochs_without += 1,
            _ => {
                self.now.best = Some((step, mean, parameters.clone()));
                self.now.epochs_without = 0;
            }
        }
    }

    /// Mean of the latest held-out losses of all views; `None` until every view has one. Means of some and of all views
    /// cannot be compared: training passes from half to full size within an epoch, and the first views may be easy
    /// ones.
    pub(super) fn mean(&self) -> Option<f64> {
        let with_tiles = || {
            self.now
                .losses
                .iter()
                .zip(&self.held)
                .filter(|(_, held)| !held.is_empty())
        };
        let losses: Option<Vec<f64>> = with_tiles().map(|(loss, _)| *loss).collect();
        let losses = losses.filter(|losses| !losses.is_empty())?;
        Some(losses.iter().sum::<f64>() / losses.len() as f64)
    }

    /// True if training should stop: `patience` epochs have passed without progress.
    pub(super) fn stop(&self) -> bool {
        self.patience > 0 && self.now.epochs_without >= self.patience
    }

    /// Result of early stopping after `steps` steps.
    pub(super) fn summary(&self, steps: usize) -> EarlyStop {
        let best = self.now.best.as_ref();
        EarlyStop {
            steps,
            best_step: best.map_or(steps, |(step, ..)| *step),
            best_l1: best.map(|(_, loss, _)| *loss),
        }
    }

    /// Best parameters; `None` if no epoch was compared.
    pub(super) fn into_best(self) -> Option<Parameters> {
        self.now.best.map(|(_, _, parameters)| parameters)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::ProjectiveCamera;

    fn views(size: usize) -> Vec<View> {
        let view = View {
            name: String::new(),
            camera: ProjectiveCamera::nadir(0.0, 0.0, 1.0, (size, size)),
            image: Raster::filled(size, size, 1, 0.5).into(),
            light: None,
            appearance: 0,
            weight: vec![1.0; size * size],
            visibility_prior: None,
            ceiling: Vec::new(),
        };
        vec![view]
    }

    #[test]
    fn a_loss_that_is_no_number_is_not_the_best() {
        let mut holdout = Holdout::new(&mut views(200), &TrainOptions::default());
        holdout.record(0, Some(0.25));
        holdout.record(0, Some(f64::NAN));
        assert_eq!(holdout.now.losses, [None]);
        holdout.epoch_done(1000, &Parameters::default());
        assert_eq!(holdout.summary(1000).best_l1, None);
    }

    #[test]
    fn states_are_compared_once_every_view_has_been_seen() {
        let options = TrainOptions {
            holdout: 0.5,
            ..TrainOptions::default()
        };
        let mut pair = [views(200), views(200)].concat();
        let mut holdout = Holdout::new(&mut pair, &options);
        let steps = options.iterations;
        // The easy view alone has a lower difference than both will ever have.
        holdout.record(0, Some(0.1));
        holdout.epoch_done(2 * steps, &Parameters::default());
        assert_eq!(holdout.summary(2 * steps).best_l1, None);
        holdout.record(1, Some(0.5));
        holdout.epoch_done(2 * steps + 2, &Parameters::default());
        assert_eq!(holdout.summary(2 * steps + 2).best_l1, Some(0.3));
    }

    #[test]
    fn a_training_that_never_stops_early_learns_from_every_pixel() {
        let options = |patience| TrainOptions {
            holdout: 0.5,
            patience,
            ..TrainOptions::default()
        };
        let mut views = views(200);
        Holdout::new(&mut views, &options(0));
        assert!(views[0].weight.iter().all(|&weight| weight == 1.0));
        Holdout::new(&mut views, &options(1));
        assert!(views[0].weight.contains(&0.0));
    }

    #[test]
    fn an_image_of_one_tile_is_learnt_from_whatever_the_draw() {
        let options = TrainOptions {
            holdout: 1.0,
            ..TrainOptions::default()
        };
        let mut views = views(TILE);
        let holdout = Holdout::new(&mut views, &options);
        assert!(views[0].weight.iter().all(|&w| w == 1.0) && holdout.held[0].is_empty());
    }
}
