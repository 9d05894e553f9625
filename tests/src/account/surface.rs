//! Reflection and transmission of surfaces: facets, lobes, scattering, the table of split sums, lamps, displays.

use super::{Errors, Row, Worst, ratio, relative, steps};
use glam::{DVec3, Vec3};
use heliosplat::shade::asg::Lobe;
use heliosplat::shade::dipole::Medium;
use heliosplat::shade::falloff::{LEAST_RADIUS, falloff};
use heliosplat::shade::{display, ggx, split_sum};
use std::f64::consts::PI;

/// Rows of reflection and transmission; costs only if `timed`.
pub(super) fn rows(timed: bool) -> Vec<Row> {
    vec![
        density_row(timed),
        reflected_row(),
        split_sum_row(),
        lobe_row(timed),
        dipole_row(),
        falloff_row(),
        display_row(),
    ]
}

/// Unit vectors from the normal to grazing, as f32 has them.
fn directions() -> Vec<Vec3> {
    let turned = |angle: f64| {
        (0..5).map(move |k| {
            let azimuth = 0.3 + 1.3 * f64::from(k);
            DVec3::new(angle.sin() * azimuth.cos(), angle.sin() * azimuth.sin(), angle.cos()).as_vec3()
        })
    };
    let near = steps(-7.0, -1.0, 61).map(|e| 10f64.powf(e));
    near.chain(steps(0.1, PI / 2.0, 40)).flat_map(turned).collect()
}

const ALPHAS: [f32; 7] = [1e-4, 1e-3, 0.01, 0.03, 0.2, 0.7, 1.0];

/// The textbook's density in f64 (Walter et al. 2007), of the direction in f64.
fn exact_density(h: DVec3, alpha: f64) -> f64 {
    let h = h.normalize();
    let across = (h.x * h.x + h.y * h.y) / (alpha * alpha);
    1.0 / (PI * alpha * alpha * (across + h.z * h.z).powi(2))
}

/// The density as it is usually written: `α² / (π ((n·h)² (α² - 1) + 1)²)`; f32.
fn naive_density(h: Vec3, alpha: f32) -> f32 {
    let square = alpha * alpha;
    let sum = h.z * h.z * (square - 1.0) + 1.0;
    square / (std::f32::consts::PI * sum * sum)
}

fn density_row(timed: bool) -> Row {
    let (mut robust, mut naive) = (Worst::default(), Worst::default());
    for alpha in ALPHAS {
        for h in directions() {
            let exact = exact_density(h.as_dvec3(), alpha.into());
            let at = || format!("alpha {alpha}, {:.1e} degrees from the normal", across_deg(h));
            robust.see(relative(ggx::density(h, [alpha; 2]).into(), exact, 0.0), at);
            naive.see(relative(naive_density(h, alpha).into(), exact, 0.0), at);
        }
    }
    let all = directions();
    let sum = |of: &dyn Fn(Vec3) -> f32| {
        std::hint::black_box(std::hint::black_box(&all).iter().map(|&h| of(h)).sum::<f32>());
    };
    Row {
        formula: "GGX `1 / (π α_x α_y (h_x²/α_x² + h_y²/α_y² + h_z²)²)`",
        domain: "α from 1e-4 to 1, half vectors from the normal to grazing, relative",
        robust: Errors {
            value: robust,
            gradient: None,
        },
        limit: (2e-6, 0.0),
        naive: Errors {
            value: naive,
            gradient: None,
        },
        cost: ratio(
            timed,
            || (0..200).for_each(|_| sum(&|h| ggx::density(h, [0.2; 2]))),
            || (0..200).for_each(|_| sum(&|h| naive_density(h, 0.2))),
        ),
    }
}

fn across_deg(h: Vec3) -> f64 {
    let h = h.as_dvec3();
    h.x.hypot(h.y).atan2(h.z).to_degrees()
}

/// Light to eye over facets, away from the peak's own conditioning: the half vector is that of f32 in both forms.
fn reflected_row() -> Row {
    let (mut robust, mut naive) = (Worst::default(), Worst::default());
    let masking = |w: DVec3, a: f64| 2.0 * w.z / (w.z + DVec3::new(a * w.x, a * w.y, w.z).length());
    let heights = steps(-30.0, 0.0, 31).map(|e| 10f64.powf(e) as f32);
    let across = |z: f32, azimuth: f32| {
        let sine = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(sine * azimuth.cos(), sine * azimuth.sin(), z)
    };
    let heights: Vec<f32> = heights.collect();
    for alpha in [0.03f32, 0.2, 0.7, 1.0] {
        for &low in &heights {
            for &high in &heights {
                for turn in [0.0f32, 1.0, 3.0] {
                    let (light, eye) = (across(low, 0.3), across(high, 0.3 + turn));
                    let (l, v, a) = (light.as_dvec3(), eye.as_dvec3(), f64::from(alpha));
                    let half = (l + v).normalize();
                    let exact = exact_density(half, a) * masking(l, a) * masking(v, a) / (4.0 * v.z);
                    let at = || format!("alpha {alpha}, light {low:.0e} and eye {high:.0e} above the surface");
                    let floor = 1e-30;
                    robust.see(
                        relative(ggx::reflected(light, eye, [alpha; 2]).into(), exact, floor),
                        at,
                    );
                    let half = (light + eye).normalize();
                    let parts = ggx::masking(light, [alpha; 2]) * ggx::masking(eye, [alpha; 2]);
                    let plain = ggx::density(half, [alpha; 2]) * parts / (4.0 * light.z * eye.z) * light.z;
                    naive.see(relative(plain.into(), exact, floor), at);
                }
            }
        }
    }
    Row {
        formula: "microfacet term `D / ((n·l + …)(n·v + …))`, masking and cosines in one",
        domain: "α from 0.03 to 1, light and eye from the normal to 1e-30 above the surface, relative",
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

/// The analytic fit that is used instead of a table (Karis 2014), as printed; f32.
fn fitted_split_sum(roughness: f32, cosine: f32) -> [f32; 2] {
    let r = [
        1.0 - roughness,
        0.0425 - 0.0275 * roughness,
        1.04 - 0.572 * roughness,
        -0.04 + 0.022 * roughness,
    ];
    let a = (r[0] * r[0]).min((-9.28 * cosine).exp2()) * r[0] + r[1];
    [-1.04 * a + r[2], 1.04 * a + r[3]]
}

fn split_sum_row() -> Row {
    let (mut robust, mut naive) = (Worst::default(), Worst::default());
    for roughness in steps(0.05, 1.0, 20) {
        for root in steps(0.02, 1.0, 25) {
            let exact = split_sum::integrate(roughness, root * root, 256);
            let (r, c) = (roughness as f32, (root * root) as f32);
            let at = || format!("roughness {roughness:.2}, cosine {:.4}", root * root);
            let (found, plain) = (split_sum::look_up(r, c).values, fitted_split_sum(r, c));
            for k in 0..2 {
                robust.see((f64::from(found[k]) - exact[k]).abs(), at);
                naive.see((f64::from(plain[k]) - exact[k]).abs(), at);
            }
        }
    }
    Row {
        formula: "split sum, a table against its integral (naive: the analytic fit of Karis 2014)",
        domain: "roughness from 0.05 to 1, cosines from 4e-4 to 1, absolute",
        robust: Errors {
            value: robust,
            gradient: None,
        },
        limit: (2e-2, 0.0),
        naive: Errors {
            value: naive,
            gradient: None,
        },
        cost: None,
    }
}

/// A lobe as printed (Bi et al. 2024): the angle to its axis, and the direction it leans to.
fn printed_lobe(v: DVec3, lobe: [f64; 3]) -> f64 {
    let v = v.normalize();
    let (sine, angle) = (v.x.hypot(v.y), v.x.hypot(v.y).atan2(v.z));
    if sine == 0.0 {
        return 1.0 / (2f64.sqrt() * PI.powf(2.0 / 3.0) * lobe[2]);
    }
    let ratio = (v.x / sine / lobe[0]).hypot(v.y / sine / lobe[1]);
    (-0.5 * (angle * ratio / lobe[2]).powi(2)).exp() / (2f64.sqrt() * PI.powf(2.0 / 3.0) * lobe[2])
}

/// The printed lobe with an arc cosine and a normalised tangent; f32.
fn naive_lobe(v: Vec3, lobe: Lobe) -> f32 {
    let tangent = v.truncate() / v.truncate().length();
    let ratio = (tangent.x / lobe.lambda).hypot(tangent.y / lobe.mu);
    let angle = v.z.min(1.0).acos();
    0.329_648_9 / lobe.sigma * (-0.5 * (angle * ratio / lobe.sigma).powi(2)).exp()
}

fn lobe_row(timed: bool) -> Row {
    let (mut value, mut slope, mut naive) = (Worst::default(), Worst::default(), Worst::default());
    let shapes = [
        [2.5f32, 1.0, 0.35],
        [0.7, 4.0, 0.01],
        [1.0, 1.0, 0.9],
        [10.0, 1e-2, 1e-3],
    ];
    let mut all = directions();
    all.push(Vec3::Z);
    for shape in shapes {
        let lobe = Lobe {
            lambda: shape[0],
            mu: shape[1],
            sigma: shape[2],
        };
        let wide = shape.map(f64::from);
        let peak = 0.33 / wide[2];
        let narrow = wide[2] * wide[0].min(wide[1]).min(1.0);
        for &v in &all {
            let exact = printed_lobe(v.as_dvec3(), wide);
            let at = || format!("shape {shape:?}, {:.1e} degrees from the axis", across_deg(v));
            let found = lobe.value_and_gradients(v);
            value.see((f64::from(found.value) - exact).abs() / peak, at);
            naive.see((f64::from(naive_lobe(v, lobe)) - exact).abs() / peak, at);
            let step = 1e-4 * narrow;
            for across in [
                v.as_dvec3().any_orthonormal_vector(),
                v.as_dvec3().normalize().cross(v.as_dvec3().any_orthonormal_vector()),
            ] {
                let moved = |sign: f64| printed_lobe(v.as_dvec3() + across * (sign * step), wide);
                let numeric = (moved(1.0) - moved(-1.0)) / (2.0 * step);
                let got = f64::from(found.direction.dot(across.as_vec3()));
                slope.see((got - numeric).abs() * narrow / peak, at);
            }
        }
    }
    let lobe = Lobe {
        lambda: 2.5,
        mu: 1.0,
        sigma: 0.35,
    };
    let sum = |of: &dyn Fn(Vec3) -> f32| {
        std::hint::black_box(std::hint::black_box(&all).iter().map(|&v| of(v)).sum::<f32>());
    };
    Row {
        formula: "lobe over half vectors `exp(-½ q ((h_x/λ)² + (h_y/μ)²) / σ²)`, `q = (θ / sin θ)²` by its series near the axis",
        domain: "σ from 1e-3 to 0.9, λ and μ from 0.01 to 10, from the axis to grazing; relative to its peak, and to its steepest",
        robust: Errors {
            value,
            gradient: Some(slope),
        },
        limit: (2e-5, 2e-4),
        naive: Errors {
            value: naive,
            gradient: None,
        },
        cost: ratio(
            timed,
            || (0..200).for_each(|_| sum(&|v| lobe.value(v))),
            || (0..200).for_each(|_| sum(&|v| naive_lobe(v, lobe))),
        ),
    }
}

/// The dipole as printed (Jensen et al. 2001), in f64.
fn printed_dipole(s: f64, a: f64, r: f64) -> f64 {
    let extinction = s + a;
    let transport = (3.0 * a * extinction).sqrt();
    let pole = |z: f64| {
        let d = r.hypot(z);
        z * (1.0 + transport * d) * (-transport * d).exp() / d.powi(3)
    };
    s / extinction / (4.0 * PI) * (pole(1.0 / extinction) + pole((1.0 + 4.0 / 3.0 * 2.602_064) / extinction))
}

/// Slope of the dipole to the absorption, with `σ_tr` as a variable of its own, as its derivation suggests; f32.
fn naive_dipole_slope(s: f32, a: f32, r: f32) -> f32 {
    let extinction = s + a;
    let transport = (3.0 * a * extinction).sqrt();
    let by_transport = |z: f32| {
        let d = r.hypot(z);
        -z * transport * (-transport * d).exp() / d
    };
    let mirrored = (1.0 + 4.0 / 3.0 * 2.602_064) / extinction;
    let transport_by_absorption = 1.5 * (extinction + a) / transport;
    s / extinction / (4.0 * std::f32::consts::PI)
        * (by_transport(1.0 / extinction) + by_transport(mirrored))
        * transport_by_absorption
}

fn dipole_row() -> Row {
    let (mut value, mut slope, mut naive) = (Worst::default(), Worst::default(), Worst::default());
    for s in [0.0f32, 0.05, 1.0, 30.0, 1e3] {
        for a in [0.0f32, 1e-12, 1e-6, 1e-3, 0.05, 1.0, 30.0] {
            if s + a == 0.0 {
                continue;
            }
            for r in [0.0f32, 1e-3, 0.1, 0.7, 3.0] {
                let [ws, wa, wr] = [s, a, r].map(f64::from);
                // Depth in the medium beyond which the value is too small for a relative error.
                if (3.0 * wa * (ws + wa)).sqrt() * wr > 30.0 {
                    continue;
                }
                let at = || format!("scattering {s}, absorption {a}, {r} away");
                let exact = printed_dipole(ws, wa, wr);
                let found = Medium {
                    scattering: s,
                    absorption: a,
                }
                .profile(r);
                value.see(relative(found.value.into(), exact, 1e-20), at);
                // One-sided at nearly zero absorption, with a step so small that the root has no effect.
                let reach_square = wr * wr + (5.0 / (ws + wa)).powi(2);
                let little = 1e-7 / (3.0 * (ws + wa) * reach_square);
                let numeric = if wa > 1e4 * little {
                    let step = 1e-4 * wa;
                    (printed_dipole(ws, wa + step, wr) - printed_dipole(ws, wa - step, wr)) / (2.0 * step)
                } else {
                    let [one, two] = [1.0, 2.0].map(|n| printed_dipole(ws, wa + n * little, wr));
                    (4.0 * one - 3.0 * exact - two) / (2.0 * little)
                };
                let steepest = exact / (ws + wa) + numeric.abs();
                slope.see((f64::from(found.absorption) - numeric).abs() / steepest.max(1e-20), at);
                let plain = naive_dipole_slope(s, a, r).is_finite();
                naive.see(if plain { 0.0 } else { f64::NAN }, at);
            }
        }
    }
    Row {
        formula: "dipole; gradient to the absorption through `σ_tr²`, not through its root",
        domain: "scattering from 0 to 1000, absorption from 0 to 30, 0 to 3 away, relative (naive gradient: only if it is not finite)",
        robust: Errors {
            value,
            gradient: Some(slope),
        },
        limit: (5e-5, 5e-3),
        naive: Errors {
            value: Worst::default(),
            gradient: Some(naive),
        },
        cost: None,
    }
}

fn falloff_row() -> Row {
    let mut robust = (Worst::default(), Worst::default());
    let mut naive = (Worst::default(), Worst::default());
    let (distance, radius) = (3.0f32, 0.0f32);
    let least = f64::from(LEAST_RADIUS) * f64::from(distance);
    for away in std::iter::once(0.0).chain(steps(-12.0, 6.0, 400).map(|e| 10f64.powf(e) as f32)) {
        let at = || format!("{away:.1e} from a lamp of reference distance 3");
        let (d, full) = (f64::from(away), f64::from(distance).powi(2));
        let exact = full / (d * d + least * least);
        let slope = -2.0 * d * exact / (d * d + least * least);
        let found = falloff(away, distance, radius);
        robust.0.see(relative(found.0.into(), exact, 0.0), at);
        robust.1.see(relative(found.1.into(), slope, 1e-30), at);
        let plain = distance * distance / (away * away);
        naive.0.see(relative(plain.into(), exact, 0.0), at);
        naive.1.see(relative((-2.0 * plain / away).into(), slope, 1e-30), at);
    }
    Row {
        formula: "falloff of a lamp `D² / (d² + r²)`, r at least D/1000",
        domain: "0 to 1e6 away, relative",
        robust: Errors {
            value: robust.0,
            gradient: Some(robust.1),
        },
        limit: (1e-6, 2e-6),
        naive: Errors {
            value: naive.0,
            gradient: Some(naive.1),
        },
        cost: None,
    }
}

fn display_row() -> Row {
    let mut robust = (Worst::default(), Worst::default());
    let mut naive = (Worst::default(), Worst::default());
    for light in std::iter::once(0.0).chain(steps(-12.0, 4.0, 4000).map(|e| 10f64.powf(e) as f32)) {
        let at = || format!("light {light:.1e}");
        let wide = f64::from(light);
        let (exact, slope) = if light <= 0.003_130_8 {
            (12.92 * wide, 12.92)
        } else {
            (
                1.055 * wide.powf(1.0 / 2.4) - 0.055,
                1.055 / 2.4 * wide.powf(1.0 / 2.4 - 1.0),
            )
        };
        let found = display::encode(light);
        robust.0.see(relative(found.0.into(), exact, 1e-30), at);
        robust.1.see(relative(found.1.into(), slope, 0.0), at);
        // The plain power has the right value, but no finite slope at zero.
        let power = light.powf(1.0 / 2.4);
        naive.0.see(relative(power.into(), wide.powf(1.0 / 2.4), 1e-30), at);
        naive.1.see(
            relative((power / light / 2.4).into(), wide.powf(1.0 / 2.4 - 1.0) / 2.4, 0.0),
            at,
        );
    }
    Row {
        formula: "sRGB encoding, with its linear part near 0 (naive: the power alone)",
        domain: "light from 0 to 1e4, relative",
        robust: Errors {
            value: robust.0,
            gradient: Some(robust.1),
        },
        limit: (1e-6, 1e-6),
        naive: Errors {
            value: naive.0,
            gradient: Some(naive.1),
        },
        cost: None,
    }
}
