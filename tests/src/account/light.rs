//! Formulas of light: the exponent of a ray that passes a Gaussian, the stack of layers above, self-shadowing, a light
//! at distance zero.

use super::{Errors, Row, Worst, ratio, steps};
use crate::reference::{self, Gaussian};
use glam::{Mat3, Vec3};
use heliosplat::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups, logit};
use heliosplat::light::Light;
use heliosplat::trace::{OccluderGradients, Occluders, SunVisibility, transmittance};
use nalgebra::Vector3;

/// Rows of light; costs only if `timed`.
pub(super) fn rows(timed: bool) -> Vec<Row> {
    vec![
        exponent_row(By::SunPlane, timed),
        exponent_row(By::Hierarchy, timed),
        exponent_row(By::Lamp, timed),
        layers_row(),
        sheet_row(),
        point_row(),
    ]
}

fn put(table: &mut Table, i: usize, position: Vec3, scales: [f32; 3], rotation: [f32; 4], opacity: f32) {
    table.group_mut(POSITION)[i * 3..i * 3 + 3].copy_from_slice(&position.to_array());
    table.group_mut(LOG_SCALE)[i * 3..i * 3 + 3].copy_from_slice(&scales.map(f32::ln));
    table.group_mut(ROTATION)[i * 4..i * 4 + 4].copy_from_slice(&rotation);
    table.group_mut(OPACITY)[i] = logit(opacity);
}

fn wide(table: &Table) -> Vec<Gaussian> {
    let three = |values: &[f32], i: usize| Vector3::from_fn(|k, _| f64::from(values[i * 3 + k]));
    (0..table.count)
        .map(|i| Gaussian {
            position: three(table.group(POSITION), i),
            log_scale: three(table.group(LOG_SCALE), i),
            rotation: table.raw_rotation(i).map(f64::from),
            opacity: table.group(OPACITY)[i].into(),
            albedo: vec![],
        })
        .collect()
}

fn traced(table: &Table, light: Light, by: By) -> (Vec<f32>, Table) {
    let by = match by {
        By::Hierarchy => SunVisibility::Bvh,
        By::SunPlane | By::Lamp => SunVisibility::Plane,
    };
    let occluders = Occluders::tracing_by(by, table);
    let traced = transmittance(&occluders, &[0], &light);
    let mut out = table.zeros_like();
    traced.backward(table, (&occluders, OccluderGradients::All), &[0], &[1.0], &mut out);
    (traced.values, out)
}

/// One Gaussian between another and the sun, `miss` standard deviations off the ray, `away` of them up it.
fn passing(size: f32, aspect: f32, away: f32, miss: f32, turn: f32) -> (Table, Vec3) {
    let sun = Vec3::new(0.48, 0.36, 0.8);
    let rotation = glam::Quat::from_axis_angle(Vec3::new(0.3, -0.8, 0.52).normalize(), turn);
    let scales = [size, size * aspect, size];
    let (right, up) = sun.any_orthonormal_pair();
    let side = (right * turn.cos() + up * turn.sin()).normalize();
    // Standard deviation of the Gaussian in the direction `side`.
    let spread = Mat3::from_quat(rotation) * Mat3::from_diagonal(Vec3::from(scales));
    let width = (spread.transpose() * side).length();
    let mut table = Table::zeros(core_groups(), 2);
    put(
        &mut table,
        0,
        Vec3::ZERO,
        [1e-3 * size, 0.9e-3 * size, 0.5e-3 * size],
        [0.0, 0.0, 0.0, 1.0],
        0.5,
    );
    put(
        &mut table,
        1,
        sun * (away * size) + side * (miss * width),
        scales,
        rotation.to_array(),
        0.9,
    );
    (table, sun)
}

/// `ΔᵀΣ⁻¹Δ - (ΔᵀΣ⁻¹r)² / (rᵀΣ⁻¹r)` as it is usually written, and the transmittance of it; f32.
fn naive_transmittance(table: &Table, sun: Vec3) -> f32 {
    let rotation = table.rotation(1);
    let inverse_scales = Mat3::from_diagonal((table.scale(1) * table.scale(1)).recip());
    let inverse = rotation * inverse_scales * rotation.transpose();
    let offset = table.position(0) - table.position(1);
    let (dd, dr, rr) = (
        offset.dot(inverse * offset),
        offset.dot(inverse * sun),
        sun.dot(inverse * sun),
    );
    1.0 - table.opacity(1) * (-0.5 * (dd - dr * dr / rr)).exp()
}

/// Kind of light and tracer.
#[derive(Clone, Copy, PartialEq)]
enum By {
    SunPlane,
    Hierarchy,
    /// From a lamp a little beyond the occluder.
    Lamp,
}

impl By {
    fn light(self, sun: Vec3, beyond: f32) -> Light {
        match self {
            Self::Lamp => Light::Point(sun * beyond),
            _ => Light::Directional(sun),
        }
    }

    fn exact(self, gaussians: &[Gaussian], sun: Vec3, beyond: f32) -> f64 {
        let wide = |v: Vec3| Vector3::new(v.x.into(), v.y.into(), v.z.into());
        match self {
            Self::Lamp => reference::transmittance_to_point(gaussians, 0, &wide(sun * beyond)),
            _ => reference::transmittance(gaussians, 0, &wide(sun)),
        }
    }
}

fn exponent_row(by: By, timed: bool) -> Row {
    let (mut robust, mut slopes, mut naive) = (Worst::default(), Worst::default(), Worst::default());
    for size in [1e-3f32, 0.3, 1e3] {
        for aspect in [1.0f32, 0.1, 0.01] {
            for away in [5.0f32, 50.0, 500.0] {
                for miss in [0.0f32, 0.5, 1.0, 2.0, 3.0] {
                    for turn in [0.4f32, 1.3, 2.9] {
                        let (table, sun) = passing(size, aspect, away, miss, turn);
                        let exact = wide(&table);
                        let beyond = 1.25 * away * size;
                        let value = by.exact(&exact, sun, beyond);
                        let at = || {
                            format!(
                                "size {size} m, {:.0} : 1, {away} sigmas away, {miss} beside",
                                1.0 / aspect
                            )
                        };
                        let (got, gradients) = traced(&table, by.light(sun, beyond), by);
                        robust.see((f64::from(got[0]) - value).abs(), at);
                        if by != By::Lamp {
                            naive.see((f64::from(naive_transmittance(&table, sun)) - value).abs(), at);
                        }
                        let unit = 1.0 / f64::from(size * aspect);
                        for of in 0..2 {
                            let numeric = Vector3::from_fn(|k, _| {
                                let step = 1e-5 / unit;
                                let moved = |sign: f64| {
                                    let mut other = exact.clone();
                                    other[of].position[k] += sign * step;
                                    by.exact(&other, sun, beyond)
                                };
                                (moved(1.0) - moved(-1.0)) / (2.0 * step)
                            });
                            let got = &gradients.group(POSITION)[3 * of..3 * of + 3];
                            let got = Vector3::from_fn(|k, _| f64::from(got[k]));
                            slopes.see((got - numeric).norm() / numeric.norm().max(0.05 * unit), at);
                        }
                    }
                }
            }
        }
    }
    let cost = (by == By::Hierarchy).then(|| exponent_cost(timed)).flatten();
    Row {
        formula: match by {
            By::SunPlane => "ray past a Gaussian, whitened on the sun's plane `‖A Δ‖²`",
            By::Hierarchy => {
                "ray past a Gaussian, nearest point in whitened space `‖e + d t*‖²`, from its closest approach to the centre"
            }
            By::Lamp => "the same toward a lamp: the direction of a ray depends on its origin",
        },
        domain: "sizes 1 mm to 1 km, 100 : 1, 5 to 500 standard deviations away; transmittance absolute, gradients to both centres relative",
        robust: Errors {
            value: robust,
            gradient: Some(slopes),
        },
        limit: (1e-4, 1e-2),
        naive: Errors {
            value: naive,
            gradient: None,
        },
        cost,
    }
}

/// The nearest point over the difference of squares, alone.
fn exponent_cost(timed: bool) -> Option<f64> {
    let pairs: Vec<(Vec3, Vec3)> = (0..1 << 16)
        .map(|i| {
            (
                Vec3::new(1.0, i as f32 * 1e-3, -40.0),
                Vec3::new(0.02, 0.1, 0.9 + i as f32 * 1e-6),
            )
        })
        .collect();
    let sum =
        |of: fn(&(Vec3, Vec3)) -> f32| std::hint::black_box(std::hint::black_box(&pairs).iter().map(of).sum::<f32>());
    let robust = |(e, d): &(Vec3, Vec3)| {
        // The foot in the scene costs another product and another sum of vectors.
        let beside = *e + *d * -e.dot(*d);
        (beside - *d * (beside.dot(*d) / d.dot(*d))).length_squared()
    };
    let naive = |(e, d): &(Vec3, Vec3)| e.dot(*e) - e.dot(*d) * e.dot(*d) / d.dot(*d);
    ratio(
        timed,
        || {
            sum(robust);
        },
        || {
            sum(naive);
        },
    )
}

fn layers_row() -> Row {
    let (mut value, mut gradient) = (Worst::default(), Worst::default());
    let mut naive = Errors {
        gradient: Some(Worst::default()),
        ..Errors::default()
    };
    for opacity in [0.01f32, 0.5, 0.95, 0.985, 0.9999] {
        for layers in [1usize, 3, 10, 23, 60, 200] {
            let mut table = Table::zeros(core_groups(), layers + 1);
            for i in 0..=layers {
                put(
                    &mut table,
                    i,
                    Vec3::Z * (3.0 * i as f32),
                    [5.0, 5.0, 0.05],
                    [0.0, 0.0, 0.0, 1.0],
                    opacity,
                );
            }
            let at = || format!("{layers} layers of {opacity}");
            let alpha = f64::from(table.opacity(0)).min(0.99);
            let clear = (1.0 - alpha).powi(layers as i32);
            let (got, gradients) = traced(&table, Light::Directional(Vec3::Z), By::SunPlane);
            value.see((f64::from(got[0]) - clear).abs(), at);
            let o = f64::from(table.opacity(1));
            let slope = if o < 0.99 {
                -clear / (1.0 - alpha) * o * (1.0 - o)
            } else {
                0.0
            };
            gradient.see((f64::from(gradients.group(OPACITY)[1]) - slope).abs(), at);
            // The product without a bound, and its gradient by dividing it by the transmittance of one layer.
            let leaves = 1.0 - table.opacity(0);
            let product = (0..layers).fold(1.0f32, |s, _| s * leaves);
            naive
                .value
                .see((f64::from(product) - f64::from(leaves).powi(layers as i32)).abs(), at);
            if let Some(worst) = &mut naive.gradient {
                let saturated = 1.0 - table.opacity(0).max(if opacity > 0.999 { 1.0 } else { 0.0 });
                let product = (0..layers).fold(1.0f32, |s, _| s * saturated);
                worst.see(
                    (f64::from(product / saturated) - f64::from(saturated).powi(layers as i32 - 1)).abs(),
                    at,
                );
            }
        }
    }
    Row {
        formula: "transmittance `Π (1 - α̃)`, α̃ at most 0.99, dark below 1e-6; gradient through its logarithm",
        domain: "1 to 200 layers of opacity 0.01 to 0.9999, absolute (naive gradient also at a saturated opacity of 1)",
        robust: Errors {
            value,
            gradient: Some(gradient),
        },
        limit: (1e-5, 2e-4),
        naive,
        cost: None,
    }
}

/// A sheet of discs side by side, all in the light, which must not shadow itself.
fn sheet_row() -> Row {
    let sheet = |sigma: f32| {
        let side = 11;
        let mut table = Table::zeros(core_groups(), side * side);
        for i in 0..side * side {
            let place = Vec3::new((i % side) as f32 - 5.0, (i / side) as f32 - 5.0, 0.0) * (1.2 * sigma);
            put(
                &mut table,
                i,
                place,
                [sigma, sigma, 0.1 * sigma],
                [0.0, 0.0, 0.0, 1.0],
                0.97,
            );
        }
        table
    };
    let toward = |elevation: f64| {
        let (sin, cos) = elevation.to_radians().sin_cos();
        Vec3::new(cos as f32, 0.0, sin as f32)
    };
    let least = |table: &Table, elevation: f64| {
        let origins: Vec<u32> = (0..table.count as u32).collect();
        let traced = transmittance(&Occluders::new(table), &origins, &Light::Directional(toward(elevation)));
        f64::from(traced.values.iter().copied().fold(1.0, f32::min))
    };
    let (mut robust, mut naive) = (Worst::default(), Worst::default());
    for sigma in [1e-3f32, 0.3, 100.0] {
        let table = sheet(sigma);
        for elevation in steps(1.0, 90.0, 90) {
            let at = || format!("{elevation:.0} degrees, discs of {sigma} m");
            robust.see(1.0 - least(&table, elevation), at);
            naive.see(1.0 - f64::from(least_from_centres(&table, toward(elevation))), at);
        }
    }
    Row {
        formula: "self-shadow: ray lifted off its sheet, near peaks not counted",
        domain: "a lit plane, 1 to 90 degrees, sizes 1 mm to 100 m; false shadow",
        robust: Errors {
            value: robust,
            gradient: None,
        },
        limit: (0.01, 0.0),
        naive: Errors {
            value: naive,
            gradient: None,
        },
        cost: None,
    }
}

/// The least transmittance of a table whose rays start in the centres of the Gaussians and include every peak ahead;
/// f32.
fn least_from_centres(table: &Table, sun: Vec3) -> f32 {
    let whitened = |i: usize| Mat3::from_diagonal(table.scale(i).recip()) * table.rotation(i).transpose();
    let through = |origin: usize| -> f32 {
        let of_one = |i: usize| {
            let offset = whitened(i) * (table.position(origin) - table.position(i));
            let along = whitened(i) * sun;
            let peak = -offset.dot(along) / along.length_squared();
            match i != origin && peak > 0.0 {
                true => 1.0 - table.opacity(i) * (-0.5 * (offset + along * peak).length_squared()).exp(),
                false => 1.0,
            }
        };
        (0..table.count).map(of_one).product()
    };
    (0..table.count).map(through).fold(1.0, f32::min)
}

/// A point light at the position of a Gaussian, and at ever smaller distances from it.
fn point_row() -> Row {
    let (mut robust, mut naive) = (Worst::default(), Worst::default());
    let at_place = Vec3::new(3.0, -2.0, 1.0);
    for exponent in -8..=3 {
        for distance in [0.0, 10f32.powi(exponent)] {
            let light = Light::Point(at_place + Vec3::new(0.6, 0.0, 0.8) * distance);
            let at = || format!("{distance:e} m away");
            let (direction, _) = light.seen_from(at_place);
            robust.see(f64::from((direction.length() - 1.0).abs()), at);
            let Light::Point(position) = light else { continue };
            let plain = (position - at_place) / (position - at_place).length();
            naive.see(f64::from((plain.length() - 1.0).abs()), at);
        }
    }
    Row {
        formula: "direction to a point light, up at the position of the light",
        domain: "0 to 1 km, departure from unit length",
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
