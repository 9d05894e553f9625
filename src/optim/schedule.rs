//! Learning rates of the groups of parameters, with their schedules.
//!
//! A model describes every group once, as a [`ParameterGroup`]: name, width, learning rate and schedule together. The
//! trainer keeps these descriptions in the order of the table's groups, so no rate is ever looked up by name.

use crate::gaussians::GroupSpec;

/// Learning rate of a group over the course of a training.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LearningRate {
    /// Rate at the first step, in the group's own unit per step of Adam.
    rate: f32,
    /// Share of training, 0 to 1, before which the group is frozen.
    from: f32,
    /// Share of the rate that is left at the last step, after an exponential decay; `None`: it does not decay.
    end: Option<f32>,
}

impl LearningRate {
    /// Rate zero: the group does not change.
    pub const FROZEN: Self = Self::constant(0.0);

    /// A constant rate.
    pub const fn constant(rate: f32) -> Self {
        Self {
            rate,
            from: 0.0,
            end: None,
        }
    }

    /// This rate, frozen until the share `from` (0 to 1) of training is done. The decay still counts from the first
    /// step.
    pub const fn starting_at(self, from: f32) -> Self {
        Self { from, ..self }
    }

    /// This rate, decaying exponentially to the share `end` of the rate at the last step.
    pub const fn decaying_to(self, end: f32) -> Self {
        Self { end: Some(end), ..self }
    }

    /// The rate when the share `progress` (0 to 1) of training is done.
    pub fn at(&self, progress: f32) -> f32 {
        if progress < self.from {
            return 0.0;
        }
        match self.end {
            None => self.rate,
            Some(end) => exponential_decay(self.rate, end * self.rate, progress),
        }
    }
}

/// A group of parameters of a model: its storage in the table and its learning rate.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterGroup {
    /// Name and width.
    pub spec: GroupSpec,
    /// Learning rate and schedule.
    pub rate: LearningRate,
}

impl ParameterGroup {
    /// A group `name` of `width` numbers per element, trained at `rate`.
    pub fn new(name: &str, width: usize, rate: LearningRate) -> Self {
        Self {
            spec: GroupSpec::new(name, width),
            rate,
        }
    }
}

/// `from · (to / from)^fraction`: a learning rate that falls by a constant factor per step; `fraction` 0 to 1. A rate
/// of zero stays zero.
pub fn exponential_decay(from: f32, to: f32, fraction: f32) -> f32 {
    if from == 0.0 {
        return 0.0;
    }
    from * (to / from).powf(fraction.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_of_zero_decays_to_zero_and_not_to_nan() {
        assert_eq!(exponential_decay(0.0, 0.0, 0.3), 0.0);
        assert_eq!(exponential_decay(0.5, 0.0, 0.0), 0.5);
        assert_eq!(LearningRate::FROZEN.decaying_to(0.1).at(0.5), 0.0);
    }

    #[test]
    fn a_group_is_frozen_until_its_start_and_decays_from_the_first_step() {
        let rate = LearningRate::constant(0.2).starting_at(0.3).decaying_to(0.1);
        assert_eq!(rate.at(0.29), 0.0);
        assert_eq!(rate.at(0.3), exponential_decay(0.2, 0.1 * 0.2, 0.3));
        assert!((rate.at(1.0) - 0.02).abs() < 1e-7);
    }
}
