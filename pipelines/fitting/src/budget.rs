//! The time budget of a training.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Share of the time kept in reserve.
const SLACK: f64 = 0.04;
/// Cost of one image after training (its rendering, its shadows, its scores), and of the DSM, in steps. 1.5 to 2.6 were
/// measured on ground.
const STEPS_PER_PRODUCT: f64 = 2.2;

/// Cost of the products of a scene of `images` images after training, in steps.
pub fn steps_of_products(images: usize) -> f64 {
    STEPS_PER_PRODUCT * (images + 2) as f64
}

/// Time that a run may take in all, products included.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    begun: Instant,
    limit: Duration,
    steps_after: f64,
}

impl Budget {
    /// Budget of `limit` from `begun` on. The work after training costs as much time as `steps_after` training steps.
    pub fn new(begun: Instant, limit: Duration, steps_after: f64) -> Self {
        Self {
            begun,
            limit,
            steps_after,
        }
    }

    /// Total number of steps that fit into the budget, when `done` steps are done and one takes `step_s` seconds.
    pub fn steps(&self, done: usize, step_s: f64) -> usize {
        done + self.steps_left(self.begun.elapsed().as_secs_f64(), step_s)
    }

    /// Share of the time that has passed, 0 to 1 and beyond.
    pub fn spent(&self) -> f64 {
        self.begun.elapsed().as_secs_f64() / self.limit.as_secs_f64()
    }

    fn steps_left(&self, elapsed_s: f64, step_s: f64) -> usize {
        let after_s = self.steps_after * step_s;
        let left_s = self.limit.as_secs_f64() * (1.0 - SLACK) - elapsed_s - after_s;
        (left_s / step_s.max(1e-6)).max(0.0) as usize
    }
}

/// Mean time of a step over the last four epochs: steps that trace light take longer than others.
#[derive(Debug)]
pub struct Pace {
    last: VecDeque<f64>,
    window: usize,
}

impl Pace {
    /// The pace of a training on `views` views.
    pub fn new(views: usize) -> Self {
        let (last, window) = (VecDeque::new(), 4 * views.max(1));
        Self { last, window }
    }

    /// Adds the duration of a step.
    pub fn add(&mut self, step: Duration) {
        if self.last.len() == self.window {
            self.last.pop_front();
        }
        self.last.push_back(step.as_secs_f64());
    }

    /// Mean seconds per step; zero before the first step.
    pub fn step_s(&self) -> f64 {
        self.last.iter().sum::<f64>() / self.last.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_what_follows_them_fit_into_the_time() {
        let budget = Budget::new(Instant::now(), Duration::from_secs(100), 24.0);
        for step_s in [0.01, 0.2, 1.0] {
            let steps = budget.steps_left(20.0, step_s);
            let end_s = 20.0 + (steps as f64 + 24.0) * step_s;
            assert!(end_s <= 96.0 && end_s > 94.0, "{step_s}: {end_s}");
        }
        assert_eq!(budget.steps_left(99.0, 0.1), 0);
        assert!(budget.spent() < 0.1);
        std::thread::sleep(Duration::from_millis(2));
        assert!(Budget::new(budget.begun, Duration::from_millis(1), 24.0).spent() > 1.0);
    }

    #[test]
    fn the_pace_follows_the_last_epochs() {
        let mut pace = Pace::new(1);
        for step in [9, 9, 9, 1, 1, 1, 1] {
            pace.add(Duration::from_secs(step));
        }
        assert!((pace.step_s() - 1.0).abs() < 1e-12);
    }
}
