//! Formulas of one number, and steps of Adam for any gradient.

use crate::config;
use heliosplat::fast;
use heliosplat::gaussians::{GroupSpec, Table, logit, normalised, rotation_backward, sigmoid};
use heliosplat::model::shadow_gs::{softplus, softplus_inverse};
use heliosplat::optim::{Adam, exponential_decay};
use proptest::prelude::*;

/// Any number, near zero, ordinary or huge.
fn any_size() -> impl Strategy<Value = f32> {
    prop_oneof![
        -100.0f32..100.0,
        prop::num::f32::NORMAL | prop::num::f32::ZERO | prop::num::f32::SUBNORMAL
    ]
}

proptest! {
    #![proptest_config(config("numbers"))]
    #[test]
    fn formulas_keep_their_ranges(x in any_size(), y in any_size(), q in prop::array::uniform4(any_size())) {
        prop_assert!((0.0..=1.0).contains(&sigmoid(x)) && (0.0..=1.0).contains(&fast::sigmoid(x)));
        prop_assert!(softplus(x) >= 0.0 && softplus(x) >= x && softplus(x) <= x.max(0.0) + 0.6932);
        prop_assert!(fast::exp(x) > 0.0 && fast::exp(x).is_finite());
        let (low, high) = if x < y { (x, y) } else { (y, x) };
        prop_assert!(sigmoid(low) <= sigmoid(high) * (1.0 + 3e-7) && softplus(low) <= softplus(high) * (1.0 + 3e-7));
        if x.abs() <= 12.0 {
            let back = logit(sigmoid(x));
            // The precision of a large logit is an ulp of a probability near one.
            prop_assert!((back - x).abs() <= 1e-6 + 1e-6 * x.abs() + 3e-7 * x.exp(), "{x}: {back}");
            prop_assert!((softplus_inverse(softplus(x)) - x).abs() <= 1e-3 + 1e-5 * (-x).exp(), "{x}");
        }
        let unit = normalised(q);
        prop_assert!((unit.length() - 1.0).abs() < 1e-5, "{q:?}: {unit}");
        let d = rotation_backward(q, glam::Mat3::from_diagonal(glam::Vec3::new(1.0, -2.0, 0.5)));
        let norm = q.iter().map(|c| c * c).sum::<f32>().sqrt();
        // Below a unit's rounding of nothing the gradient may leave the numbers: such a step is rejected.
        prop_assert!(d.iter().all(|d| d.is_finite()) || norm < 1e-12, "{q:?}: {d:?}");
    }
}

proptest! {
    #![proptest_config(config("rates"))]
    #[test]
    fn a_step_of_adam_is_bounded_whatever_the_gradient(
        gradients in prop::collection::vec(prop_oneof![-1e18f32..1e18, -1.0f32..1.0, Just(0.0f32), Just(1e-30)], 1..60),
        rate in prop_oneof![Just(0.0f32), 1e-6f32..1.0], end in 0.0f32..1.0, fraction in -1.0f32..2.0,
    ) {
        let rate = exponential_decay(rate, rate * end, fraction);
        prop_assert!(rate.is_finite() && rate >= 0.0);
        let mut parameters = Table::zeros(vec![GroupSpec::new("x", 1)], 1);
        let mut adam = Adam::new(&parameters);
        let mut table = parameters.zeros_like();
        for &gradient in &gradients {
            let before = parameters.group(0)[0];
            table.group_mut(0)[0] = gradient;
            adam.step(&mut parameters, &table, &[rate]);
            let after = parameters.group(0)[0];
            // (1 - β1) / sqrt(1 - β2) bounds the first moment over the root of the second (Kingma and Ba 2015, §2.1).
            prop_assert!((after - before).abs() <= 10.0 * rate + 1e-6 * before.abs(), "{before} to {after} at rate {rate}");
        }
    }
}
