//! Formulas of one number.

use super::{Errors, Row, Worst, ratio_over, relative, steps};
use heliosplat::fast;
use heliosplat::gaussians::{GroupSpec, Table, normalised, sigmoid};
use heliosplat::model::shadow_gs::{softplus, softplus_inverse};
use heliosplat::optim::{Adam, exponential_decay};
use heliosplat::splat::kernel::exp2;

/// Rows of formulas of one number; costs only if `timed`.
pub(super) fn rows(timed: bool) -> Vec<Row> {
    vec![
        softplus_row(timed),
        softplus_inverse_row(timed),
        sigmoid_row(timed),
        exp_row(timed),
        ln_row(timed),
        exp2_row(timed),
        decay_row(),
        quaternion_row(),
        adam_row(),
    ]
}

/// The worst relative error of `form` against `exact` at numbers from `low` to `high`.
fn worst(low: f64, high: f64, form: impl Fn(f32) -> f32, exact: impl Fn(f64) -> f64) -> Worst {
    let mut worst = Worst::default();
    for x in steps(low, high, 400_001) {
        let x = x as f32;
        worst.see(
            relative(form(x).into(), exact(x.into()), f64::from(f32::MIN_POSITIVE)),
            || format!("x = {x:.4}"),
        );
    }
    worst
}

fn softplus_row(timed: bool) -> Row {
    let exact = |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p();
    let slope = |x: f64| 1.0 / (1.0 + (-x).exp());
    let naive = |x: f32| (1.0 + x.exp()).ln();
    Row {
        formula: "`softplus(x) = max(x, 0) + ln1p(e^-‖x‖)`; gradient: sigmoid",
        domain: "x from -80 to 100, relative",
        robust: Errors {
            value: worst(-80.0, 100.0, softplus, exact),
            gradient: Some(worst(-80.0, 100.0, sigmoid, slope)),
        },
        limit: (3e-7, 3e-7),
        naive: Errors {
            value: worst(-80.0, 100.0, naive, exact),
            gradient: Some(worst(-80.0, 100.0, |x| x.exp() / (1.0 + x.exp()), slope)),
        },
        cost: ratio_over(timed, -20.0, 20.0, softplus, naive),
    }
}

fn softplus_inverse_row(timed: bool) -> Row {
    let exact = |y: f64| y + (-(-y).exp_m1()).ln();
    let naive = |y: f32| (y.exp() - 1.0).ln();
    // Near ln 2 the result passes through zero: there the error is absolute.
    let sweep = |form: &dyn Fn(f32) -> f32| {
        let mut worst = Worst::default();
        for exponent in steps(-6.0, 2.0, 100_001) {
            let y = 10f64.powf(exponent) as f32;
            worst.see(relative(form(y).into(), exact(y.into()), 1.0), || {
                format!("y = {y:.3e}")
            });
        }
        worst
    };
    Row {
        formula: "`softplus⁻¹(y) = y + ln(-expm1(-y))`",
        domain: "y from 1e-6 to 100, relative, absolute below 1",
        robust: Errors {
            value: sweep(&softplus_inverse),
            gradient: None,
        },
        limit: (3e-7, 0.0),
        naive: Errors {
            value: sweep(&naive),
            gradient: None,
        },
        cost: ratio_over(timed, 0.01, 20.0, softplus_inverse, naive),
    }
}

fn sigmoid_row(timed: bool) -> Row {
    let exact = |x: f64| 1.0 / (1.0 + (-x).exp());
    let naive = |x: f32| x.exp() / (1.0 + x.exp());
    Row {
        formula: "`sigmoid(x)` by the sign of x",
        domain: "x from -87 to 100, relative",
        robust: Errors {
            value: worst(-87.0, 100.0, sigmoid, exact),
            gradient: None,
        },
        limit: (3e-7, 0.0),
        naive: Errors {
            value: worst(-87.0, 100.0, naive, exact),
            gradient: None,
        },
        cost: ratio_over(timed, -20.0, 20.0, sigmoid, naive),
    }
}

fn exp_row(timed: bool) -> Row {
    let std = f32::exp;
    Row {
        formula: "`exp` in lanes (saturates; naive: the standard library's)",
        domain: "x from -87 to 88, relative",
        robust: Errors {
            value: worst(-87.0, 88.0, fast::exp, f64::exp),
            gradient: None,
        },
        limit: (2.4e-7, 0.0),
        naive: Errors {
            value: worst(-87.0, 88.0, std, f64::exp),
            gradient: None,
        },
        cost: ratio_over(timed, -20.0, 20.0, fast::exp, std),
    }
}

fn ln_row(timed: bool) -> Row {
    let sweep = |form: &dyn Fn(f32) -> f32| {
        let mut worst = Worst::default();
        for exponent in steps(-36.0, 38.0, 200_001) {
            let x = 10f64.powf(exponent) as f32;
            worst.see(relative(form(x).into(), f64::from(x).ln(), 1e-2), || {
                format!("x = {x:.3e}")
            });
        }
        worst
    };
    Row {
        formula: "`ln` in lanes (naive: the standard library's)",
        domain: "x from 1e-36 to 1e38, relative, absolute below 0.01",
        robust: Errors {
            value: sweep(&fast::ln),
            gradient: None,
        },
        limit: (3e-7, 0.0),
        naive: Errors {
            value: sweep(&f32::ln),
            gradient: None,
        },
        cost: ratio_over(timed, 0.01, 20.0, fast::ln, f32::ln),
    }
}

fn exp2_row(timed: bool) -> Row {
    Row {
        formula: "`2^x` of the rasteriser, a polynomial of degree four (naive: the standard library's)",
        domain: "x from -8 (alpha 1/255) to 0, relative",
        robust: Errors {
            value: worst(-8.0, 0.0, exp2, f64::exp2),
            gradient: None,
        },
        limit: (4e-6, 0.0),
        naive: Errors {
            value: worst(-8.0, 0.0, f32::exp2, f64::exp2),
            gradient: None,
        },
        cost: ratio_over(timed, -8.0, 0.0, exp2, f32::exp2),
    }
}

fn decay_row() -> Row {
    let sweep = |form: &dyn Fn(f32, f32, f32) -> f32| {
        let mut worst = Worst::default();
        for (from, to) in [(0.0f32, 0.0f32), (0.0, 0.01), (0.01, 0.0), (0.01, 5e-4), (1.0, 0.1)] {
            for fraction in steps(0.0, 1.0, 101) {
                let (a, b) = (f64::from(from), f64::from(to));
                let exact = if a == 0.0 {
                    0.0
                } else {
                    a * (b / a).powf(f64::from(fraction as f32))
                };
                let value = f64::from(form(from, to, fraction as f32));
                worst.see(relative(value, exact, 1e-30), || format!("{from} to {to}"));
            }
        }
        worst
    };
    Row {
        formula: "learning rate `a (b/a)^t`, 0 for a = 0",
        domain: "a and b from 0 to 1, t from 0 to 1, relative",
        robust: Errors {
            value: sweep(&exponential_decay),
            gradient: None,
        },
        limit: (1e-6, 0.0),
        naive: Errors {
            value: sweep(&|a, b, t| a * (b / a).powf(t)),
            gradient: None,
        },
        cost: None,
    }
}

fn quaternion_row() -> Row {
    let (mut robust, mut naive) = (Worst::default(), Worst::default());
    let unit = [0.3f64, -0.5, 0.2, 0.787_400_787];
    for exponent in -40..=37 {
        let q = unit.map(|c| (c * 10f64.powi(exponent)) as f32);
        let length = q.iter().map(|&c| f64::from(c).powi(2)).sum::<f64>().sqrt();
        let at = || format!("‖q‖ = 1e{exponent}");
        // A quaternion whose square overflows f32 counts as degenerate and becomes the identity, of length one.
        let got = normalised(q).to_array().map(f64::from);
        let degenerate = got == [0.0, 0.0, 0.0, 1.0];
        let error = if degenerate && !(-11..=18).contains(&exponent) {
            0.0
        } else {
            (0..4)
                .map(|k| (got[k] - f64::from(q[k]) / length).abs())
                .fold(0.0, f64::max)
        };
        robust.see(error, at);
        let norm = q.iter().map(|c| c * c).sum::<f32>().sqrt();
        let plain = (0..4).map(|k| (f64::from(q[k] / norm) - f64::from(q[k]) / length).abs());
        naive.see(plain.fold(0.0, |a, b| if b.is_nan() { b } else { f64::max(a, b) }), at);
    }
    Row {
        formula: "unit quaternion, the identity where degenerate (‖q‖ below 1e-12, or beyond squares)",
        domain: "‖q‖ from 1e-40 to 1e37, absolute",
        robust: Errors {
            value: robust,
            gradient: None,
        },
        limit: (3e-7, 0.0),
        naive: Errors {
            value: naive,
            gradient: None,
        },
        cost: None,
    }
}

fn adam_row() -> Row {
    let (mut robust, mut naive) = (Worst::default(), Worst::default());
    for exponent in -30..=18 {
        let gradient = 0.99 * 10f64.powi(exponent) as f32;
        let mut parameters = Table::zeros(vec![GroupSpec::new("x", 1)], 1);
        let mut adam = Adam::new(&parameters);
        let mut table = parameters.zeros_like();
        table.group_mut(0)[0] = gradient;
        adam.step(&mut parameters, &table, &[0.01]);
        let at = || format!("gradient 1e{exponent}");
        // The first step of Adam is the rate, whatever the size of the gradient above its epsilon of 1e-15.
        let g = f64::from(gradient);
        let second = f64::from(0.001f32 * gradient * gradient);
        let exact = -0.01 * g / (g.abs() + 1e-15);
        if second > 1e-37 {
            robust.see(relative(parameters.group(0)[0].into(), exact, 1e-30), at);
        } else {
            // Without a bound on the size: it must be finite.
            robust.see(if parameters.is_finite() { 0.0 } else { f64::NAN }, at);
        }
        let plain = f64::from(-0.01 * gradient / (gradient * gradient * 0.001).sqrt() * 0.001f32.sqrt());
        naive.see(relative(plain, -0.01, 1.0), at);
    }
    Row {
        formula: "Adam's first step, with its epsilon; gradients beyond 1e18 are rejected before",
        domain: "gradients from 1e-30 to 1e18, relative where their squares are normal numbers",
        robust: Errors {
            value: robust,
            gradient: None,
        },
        limit: (1e-4, 0.0),
        naive: Errors {
            value: naive,
            gradient: None,
        },
        cost: None,
    }
}
