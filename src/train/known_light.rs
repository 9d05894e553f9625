//! Light of earlier steps that still serves.

use super::options::TrainOptions;
use crate::gaussians::Table;
use glam::Vec3;

/// Every so many Gaussians one is watched.
const WATCHED: usize = 16;
/// Light that waits for movement is traced again after this many times the visits it would serve otherwise.
const PATIENCE: usize = 4;

/// A view's transmittances of an earlier step, by Gaussian.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct KnownLight {
    /// Transmittances; what the view did not show counts as lit.
    pub(super) values: Vec<f32>,
    /// Visits it has served.
    pub(super) visits: usize,
    /// [`Movement::total`] when it was traced.
    pub(super) traced_at: f64,
}

impl KnownLight {
    /// Whether it serves one visit more.
    pub(super) fn serves(&self, options: &TrainOptions, movement: &Movement) -> bool {
        if options.light_moved <= 0.0 {
            return self.visits < options.light_every;
        }
        let still = movement.total - self.traced_at < f64::from(options.light_moved);
        still && self.visits < PATIENCE * options.light_every
    }
}

/// How far Gaussians have moved since training began, seen on some of them.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct Movement {
    watched: Vec<(Vec3, f32)>,
    /// Mean length of the way of a Gaussian, ground sampling distances, its changes of opacity added.
    pub(super) total: f64,
}

impl Movement {
    /// Nothing has moved yet.
    pub(super) fn new(gaussians: &Table) -> Self {
        Self {
            watched: watch(gaussians),
            total: 0.0,
        }
    }

    /// Forgets where Gaussians were, after a rebuild of their table.
    pub(super) fn rebuilt(&mut self, gaussians: &Table) {
        self.watched = watch(gaussians);
    }

    /// Adds the way since the last call.
    pub(super) fn add(&mut self, gaussians: &Table, gsd_m: f32) {
        let now = watch(gaussians);
        let way = |((p, o), (q, n)): (&(Vec3, f32), &(Vec3, f32))| f64::from(p.distance(*q) / gsd_m + (o - n).abs());
        let sum: f64 = self.watched.iter().zip(&now).map(way).sum();
        self.total += sum / now.len().max(1) as f64;
        self.watched = now;
    }
}

fn watch(gaussians: &Table) -> Vec<(Vec3, f32)> {
    (0..gaussians.count)
        .step_by(WATCHED)
        .map(|i| (gaussians.position(i), gaussians.opacity(i)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::{POSITION, core_groups};

    #[test]
    fn light_serves_until_its_visits_are_over_or_the_gaussians_have_moved() {
        let mut gaussians = Table::zeros(core_groups(), 100);
        let mut movement = Movement::new(&gaussians);
        let light = |visits: usize| KnownLight {
            values: Vec::new(),
            visits,
            traced_at: 0.0,
        };
        let counted = TrainOptions {
            light_every: 2,
            ..TrainOptions::default()
        };
        let watched = TrainOptions {
            light_moved: 0.5,
            ..counted.clone()
        };
        assert!(light(1).serves(&counted, &movement) && !light(2).serves(&counted, &movement));
        assert!(light(7).serves(&watched, &movement) && !light(8).serves(&watched, &movement));
        for _ in 0..2 {
            for x in gaussians.group_mut(POSITION).iter_mut().step_by(3) {
                *x += 0.15;
            }
            movement.add(&gaussians, 0.5);
        }
        assert!((movement.total - 0.6).abs() < 1e-6, "{}", movement.total);
        assert!(light(1).serves(&counted, &movement) && !light(0).serves(&watched, &movement));
    }
}
