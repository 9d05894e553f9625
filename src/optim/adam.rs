//! Adam (Kingma and Ba 2015), one learning rate per group.

use crate::gaussians::Table;
use rayon::prelude::*;

/// Default decay of the first moment per step (Kingma and Ba 2015).
pub const BETA1: f32 = 0.9;
/// Decay of the second moment per step.
pub const BETA2: f32 = 0.999;
/// Added to the root of the second moment.
pub const EPSILON: f32 = 1e-15;

/// First and second moments of one table.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Adam {
    /// Decaying mean of the gradients.
    pub first: Table,
    /// Decaying mean of the squared gradients.
    pub second: Table,
    /// Number of steps taken.
    pub steps: u32,
}

impl Adam {
    /// Zero moments, for tables shaped like `parameters`.
    pub fn new(parameters: &Table) -> Self {
        Self {
            first: parameters.zeros_like(),
            second: parameters.zeros_like(),
            steps: 0,
        }
    }

    /// True if every moment is a finite number.
    pub fn is_finite(&self) -> bool {
        self.first.is_finite() && self.second.is_finite()
    }

    /// Takes one step down `gradients`; `rates[group]` is each group's learning rate (a group of rate zero does not
    /// change).
    pub fn step(&mut self, parameters: &mut Table, gradients: &Table, rates: &[f32]) {
        self.step_with(BETA1, parameters, gradients, rates);
    }

    /// Takes one step with `beta1`, 0 to 1, as the decay of the first moment.
    pub fn step_with(&mut self, beta1: f32, parameters: &mut Table, gradients: &Table, rates: &[f32]) {
        self.steps += 1;
        let correction1 = 1.0 - beta1.powi(self.steps as i32);
        let correction2 = (1.0 - BETA2.powi(self.steps as i32)).sqrt();
        for (group, &rate) in rates.iter().enumerate() {
            if rate == 0.0 {
                continue;
            }
            let step = rate / correction1;
            let width = parameters.groups[group].spec.width.max(1);
            let chunk = 1024 * width;
            let values = parameters.group_mut(group).par_chunks_mut(chunk);
            let gradients = gradients.group(group).par_chunks(chunk);
            let first = self.first.group_mut(group).par_chunks_mut(chunk);
            let second = self.second.group_mut(group).par_chunks_mut(chunk);
            values
                .zip(gradients)
                .zip(first)
                .zip(second)
                .for_each(|(((values, gradients), first), second)| {
                    for (((p, &g), m), v) in values.iter_mut().zip(gradients).zip(first).zip(second) {
                        *m = beta1 * *m + (1.0 - beta1) * g;
                        *v = BETA2 * *v + (1.0 - BETA2) * g * g;
                        *p -= step * *m / (v.sqrt() / correction2 + EPSILON);
                    }
                });
        }
    }

    /// Follows a rebuild of the table: element `i` of the new one was `sources[i]` of the old one; from `fresh` on,
    /// elements are new and start with zero moments.
    pub fn follow(&mut self, sources: &[u32], fresh: usize) {
        for table in [&mut self.first, &mut self.second] {
            *table = table.gather(sources);
            for group in &mut table.groups {
                let width = group.spec.width;
                group.values[fresh * width..].fill(0.0);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::GroupSpec;
    use crate::optim::schedule::exponential_decay;

    #[test]
    fn a_quadratic_is_descended_to_its_minimum() {
        let mut parameters = Table::zeros(vec![GroupSpec::new("x", 2)], 1);
        parameters.group_mut(0).copy_from_slice(&[3.0, -2.0]);
        let mut adam = Adam::new(&parameters);
        let mut gradients = parameters.zeros_like();
        for step in 0..2000 {
            let x: Vec<f32> = parameters.group(0).to_vec();
            gradients
                .group_mut(0)
                .copy_from_slice(&[2.0 * (x[0] - 1.0), 20.0 * (x[1] + 1.0)]);
            adam.step(
                &mut parameters,
                &gradients,
                &[exponential_decay(0.05, 1e-4, step as f32 / 2000.0)],
            );
        }
        assert!((parameters.group(0)[0] - 1.0).abs() < 1e-2 && (parameters.group(0)[1] + 1.0).abs() < 1e-2);
    }

    #[test]
    fn without_memory_a_turned_gradient_turns_the_next_step() {
        let after = |beta1: f32| {
            let mut parameters = Table::zeros(vec![GroupSpec::new("x", 1)], 1);
            let mut adam = Adam::new(&parameters);
            let mut gradients = parameters.zeros_like();
            for gradient in [1.0, 1.0, -1.0] {
                gradients.group_mut(0)[0] = gradient;
                adam.step_with(beta1, &mut parameters, &gradients, &[0.1]);
            }
            parameters.group(0)[0]
        };
        assert!((after(0.0) + 0.1).abs() < 1e-4 && after(BETA1) < -0.2);
    }

    #[test]
    fn a_rate_of_zero_freezes_a_group() {
        let mut parameters = Table::zeros(vec![GroupSpec::new("x", 1)], 1);
        let mut gradients = parameters.zeros_like();
        gradients.group_mut(0)[0] = 1.0;
        Adam::new(&parameters.clone()).step(&mut parameters, &gradients, &[0.0]);
        assert_eq!(parameters.group(0), &[0.0]);
    }
}
