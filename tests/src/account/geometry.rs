//! Formulas of splats: the footprint of a Gaussian, the stack of splats along a ray, brightness in a window.

use super::{Errors, Row, Worst, ratio, relative, steps};
use crate::reference;
use glam::{Mat3, Quat, Vec3};
use heliosplat::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};
use heliosplat::loss::photometric::photometric;
use heliosplat::splat::project::{project, project_backward};
use heliosplat::splat::{MapGradients, Projected, ProjectionOptions, Rasteriser, SplatGradient};
use heliosplat::{ProjectiveCamera, Raster};
use nalgebra::Vector3;

/// Rows of splats; costs only if `timed`.
pub(super) fn rows(timed: bool) -> Vec<Row> {
    let [conic, dimming, slope, alpha] = footprint_rows(timed);
    vec![conic, dimming, slope, alpha, stack_row(), frame_row(), window_row()]
}

const OPTIONS: ProjectionOptions = ProjectionOptions {
    filter_px2: 0.1,
    antialias: true,
};

/// A Gaussian in the middle of an image with pixels of a metre, seen obliquely.
fn one(log_scale: [f32; 3], rotation: Quat) -> Table {
    let mut table = Table::zeros(core_groups(), 1);
    table.group_mut(POSITION).copy_from_slice(&[0.3, -0.2, 0.1]);
    table.group_mut(LOG_SCALE).copy_from_slice(&log_scale);
    table.group_mut(ROTATION).copy_from_slice(&rotation.to_array());
    table.group_mut(OPACITY)[0] = 4.0;
    table
}

fn exact(table: &Table, log_scale: Vector3<f64>) -> reference::Gaussian {
    let wide = |values: &[f32]| Vector3::new(values[0].into(), values[1].into(), values[2].into());
    let q = table.raw_rotation(0).map(f64::from);
    reference::Gaussian {
        position: wide(table.group(POSITION)),
        log_scale,
        rotation: q,
        opacity: table.group(OPACITY)[0].into(),
        albedo: vec![],
    }
}

fn camera() -> (ProjectiveCamera, reference::Camera) {
    let u = [1.0, 0.0, 0.35, 31.5];
    let v = [0.0, -1.0, 0.2, 31.5];
    let camera = ProjectiveCamera::new(u, v, [0.0; 3], (64, 64), -glam::DVec3::Z);
    let four = |x: Vec3, c: f32| [x.x, x.y, x.z, c].map(f64::from);
    let exact = reference::Camera {
        u: four(camera.u, camera.u0),
        v: four(camera.v, camera.v0),
        w: Vector3::zeros(),
        axis: Vector3::new(
            camera.depth_axis.x.into(),
            camera.depth_axis.y.into(),
            camera.depth_axis.z.into(),
        ),
        width: 64,
        height: 64,
    };
    (camera, exact)
}

/// The footprint by the determinant of the covariance, as it is usually written; f32.
fn naive_footprint(table: &Table, camera: &ProjectiveCamera) -> ([f32; 3], f32) {
    let turned =
        Mat3::from_quat(Quat::from_array(table.raw_rotation(0)).normalize()) * Mat3::from_diagonal(table.scale(0));
    let sigma = turned * turned.transpose();
    let (xx, xy, yy) = (
        camera.u.dot(sigma * camera.u),
        camera.u.dot(sigma * camera.v),
        camera.v.dot(sigma * camera.v),
    );
    let det = xx * yy - xy * xy;
    let (fx, fy) = (xx + OPTIONS.filter_px2, yy + OPTIONS.filter_px2);
    let filtered = fx * fy - xy * xy;
    let opacity = table.opacity(0) * (det.max(0.0) / filtered).sqrt();
    ([fy / filtered, -xy / filtered, fx / filtered], opacity)
}

/// Conic, dimming and slope over discs and needles from a twentieth of a pixel to thirty pixels, up to three hundred
/// times as long as thick: the range that training allows, and several times beyond.
fn footprint_rows(timed: bool) -> [Row; 4] {
    let (camera, wide_camera) = camera();
    let mut robust: [Errors; 4] = Default::default();
    let mut naive: [Errors; 4] = Default::default();
    robust[1].gradient = Some(Worst::default());
    for size in steps((0.05f64).ln(), (30.0f64).ln(), 12) {
        for aspect in steps(0.0, (300.0f64).ln(), 7) {
            for shape in 0..2 {
                for turn in 0..9 {
                    let rotation =
                        Quat::from_axis_angle(Vec3::new(1.0, 0.4 * turn as f32, -0.7).normalize(), 0.7 * turn as f32);
                    let (long, thin) = (size as f32, (size - aspect) as f32);
                    let scales = if shape == 0 {
                        [long, long, thin]
                    } else {
                        [long, thin, thin]
                    };
                    let table = one(scales, rotation);
                    let at = || {
                        let kind = if shape == 0 { "a disc" } else { "a needle" };
                        format!("{kind} of {:.2} px, {:.0} : 1, turn {turn}", size.exp(), aspect.exp())
                    };
                    let log_scale = Vector3::from(scales.map(f64::from));
                    let of =
                        |log_scale| reference::project(&exact(&table, log_scale), 0, &wide_camera, 0.1f32.into(), true);
                    let truth = of(log_scale);
                    let projected = project(&table, &camera, &OPTIONS);
                    let norm = truth.conic.norm();
                    let conic_error = |c: [f32; 3]| {
                        let parts = [c[0], c[1], c[1], c[2]].map(f64::from);
                        let differences = parts.iter().zip(truth.conic.iter()).map(|(a, b)| (a - b).powi(2));
                        differences.sum::<f64>().sqrt() / norm
                    };
                    let (plain_conic, plain_opacity) = naive_footprint(&table, &camera);
                    naive[0].value.see(conic_error(plain_conic), at);
                    naive[1]
                        .value
                        .see(relative(plain_opacity.into(), truth.opacity, 1.0 / 255.0), at);
                    let Some(splat) = projected.splats.first() else {
                        // A splat below the visible opacity may be absent.
                        if truth.opacity > 1.01 / 255.0 {
                            robust[0].value.see(f64::NAN, at);
                        }
                        continue;
                    };
                    robust[0].value.see(conic_error(splat.conic), at);
                    if turn % 3 == 1 {
                        let pixels =
                            reference::render(&[exact(&table, log_scale)], &wide_camera, &[1.0], 0.1f32.into(), true);
                        let alphas = Rasteriser::new(&projected, 64, 64).forward(&[], 0).alpha;
                        for (i, pixel) in pixels.iter().enumerate().filter(|(_, pixel)| pixel.is_stable) {
                            robust[3].value.see((f64::from(alphas[i]) - pixel.alpha).abs(), at);
                            let (x, y) = ((i % 64) as f32 - splat.col, (i / 64) as f32 - splat.row);
                            let [a, b, c] = plain_conic;
                            let plain = plain_opacity * (-0.5 * (a * x * x + 2.0 * b * x * y + c * y * y)).exp();
                            let plain = if pixel.alpha > 0.0 { plain.min(0.99) } else { 0.0 };
                            naive[3].value.see((f64::from(plain) - pixel.alpha).abs(), at);
                        }
                    }
                    robust[1]
                        .value
                        .see(relative(splat.opacity.into(), truth.opacity, 1.0 / 255.0), at);
                    let slope = Vec3::new(splat.slope[0], splat.slope[1], 0.0).as_dvec3();
                    let difference = ((slope.x - truth.slope.x).powi(2) + (slope.y - truth.slope.y).powi(2)).sqrt();
                    robust[2].value.see(difference / truth.slope.norm().max(1.0), at);
                    if let Some(worst) = &mut robust[1].gradient {
                        let got = opacity_gradient(&table, &camera, &projected);
                        let numeric = |k: usize| {
                            let mut step = Vector3::zeros();
                            step[k] = 1e-5;
                            (of(log_scale + step).opacity - of(log_scale - step).opacity) / 2e-5
                        };
                        let expected = Vector3::from_fn(|k, _| numeric(k));
                        worst.see((got - expected).norm() / expected.norm().max(0.01), at);
                    }
                }
            }
        }
    }
    let cost = footprint_cost(timed);
    let [conic, dimming, slope, alpha] = robust;
    let [naive_conic, naive_dimming, naive_slope, naive_alpha] = naive;
    let row = |formula, robust, limit, naive, cost| Row {
        formula,
        domain: "discs and needles of 0.05 to 30 px, up to 300 : 1, relative",
        robust,
        limit,
        naive,
        cost,
    };
    [
        row(
            "inverse image covariance, its determinant `‖a × b‖² + f (xx + yy) + f²`",
            conic,
            (2e-4, 0.0),
            naive_conic,
            cost,
        ),
        row(
            "dimming of thin splats `sqrt(‖a × b‖² / det)` times opacity; gradient to log scales",
            dimming,
            (2e-4, 1e-3),
            naive_dimming,
            None,
        ),
        row(
            "slope of depth `(Σ₂ + δ)⁻¹ [c·a, c·b]`",
            slope,
            (1e-3, 0.0),
            naive_slope,
            None,
        ),
        row(
            "alpha at a pixel (error absolute), its exponent a quadratic form of the footprint",
            alpha,
            (5e-3, 0.0),
            naive_alpha,
            None,
        ),
    ]
}

/// Gradient of a splat's opacity to the log scales, by the engine.
fn opacity_gradient(table: &Table, camera: &ProjectiveCamera, projected: &Projected) -> Vector3<f64> {
    let mut out = table.zeros_like();
    let d = SplatGradient {
        opacity: 1.0,
        ..SplatGradient::default()
    };
    project_backward(table, camera, &OPTIONS, projected, &[d], &mut out);
    let d = out.group(LOG_SCALE);
    Vector3::new(d[0].into(), d[1].into(), d[2].into())
}

/// The determinant from whitened rows over that from the covariance.
fn footprint_cost(timed: bool) -> Option<f64> {
    let rows: Vec<(Vec3, Vec3)> = (0..1 << 16)
        .map(|i| {
            (
                Vec3::new(1.0, i as f32 * 1e-4, 0.3),
                Vec3::new(0.2, 0.7, i as f32 * 2e-4),
            )
        })
        .collect();
    let sum =
        |of: fn(&(Vec3, Vec3)) -> f32| std::hint::black_box(std::hint::black_box(&rows).iter().map(of).sum::<f32>());
    let robust = |(a, b): &(Vec3, Vec3)| a.cross(*b).length_squared() + 0.1 * (a.dot(*a) + b.dot(*b) + 0.1) + a.dot(*b);
    let naive = |(a, b): &(Vec3, Vec3)| {
        let (xx, xy, yy) = (a.dot(*a) + 0.1, a.dot(*b), b.dot(*b) + 0.1);
        xx * yy - xy * xy + xy
    };
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

/// Layers of equal splats over one pixel.
fn stack_row() -> Row {
    let (mut value, mut gradient) = (Worst::default(), Worst::default());
    let mut naive = Errors {
        gradient: Some(Worst::default()),
        ..Errors::default()
    };
    for opacity in [0.01f32, 0.3, 0.9, 0.985, 0.9999] {
        for layers in [1usize, 2, 10, 23, 60, 200] {
            let at = || format!("{layers} layers of {opacity}");
            let splat = heliosplat::splat::Splat {
                conic: [1.0, 0.0, 1.0],
                opacity,
                reach: 2.0 * (opacity * 255.0).ln(),
                half: [1.5, 1.5],
                ..Default::default()
            };
            let splats = (0..layers)
                .map(|i| heliosplat::splat::Splat {
                    depth: i as f32,
                    ..splat
                })
                .collect();
            let projected = Projected {
                splats,
                gaussian: (0..layers as u32).collect(),
                non_finite: 0,
            };
            let rasteriser = Rasteriser::new(&projected, 1, 1);
            let maps = rasteriser.forward(&[], 0);
            let mut d = MapGradients::zeros(0, 1);
            d.alpha[0] = 1.0;
            let back = rasteriser.backward(&[], 0, &maps, &d);
            let alpha = f64::from(opacity).min(0.99);
            let clear = (1.0 - alpha).powi(layers as i32);
            value.see((f64::from(maps.alpha[0]) - (1.0 - clear)).abs(), at);
            // ∂(1 - Π)/∂o of any layer; none where alpha saturates. The engine stops where 1e-4 of the light is left.
            let slope = if f64::from(opacity) < 0.99 {
                clear / (1.0 - alpha)
            } else {
                0.0
            };
            let worst = back.splats.iter().map(|s| (f64::from(s.opacity) - slope).abs());
            gradient.see(worst.fold(0.0, |a, b| if b.is_nan() { b } else { f64::max(a, b) }), at);
            let product = (0..layers).fold(1.0f32, |t, _| t * (1.0 - opacity));
            let exact = (1.0 - f64::from(opacity)).powi(layers as i32);
            naive.value.see((f64::from(product) - exact).abs(), at);
            if let Some(worst) = &mut naive.gradient {
                // By dividing the product by each layer's own share, without a bound to alpha.
                let share = 1.0 - (opacity + 1e-4);
                let product = (0..layers).fold(1.0f32, |t, _| t * share);
                let exact = f64::from(share).powi(layers as i32 - 1);
                worst.see((f64::from(product / share) - exact).abs(), at);
            }
        }
    }
    Row {
        formula: "compositing `T_i = Π (1 - α)`, α at most 0.99; gradient to opacities",
        domain: "1 to 200 layers of opacity 0.01 to 0.9999, absolute",
        robust: Errors {
            value,
            gradient: Some(gradient),
        },
        limit: (1.1e-4, 1e-2),
        naive,
        cost: None,
    }
}

fn frame_row() -> Row {
    let (mut robust, mut naive) = (Worst::default(), Worst::default());
    for polar in steps(0.0, 180.0, 361) {
        for turn in steps(0.0, 350.0, 36) {
            let ((st, ct), (sp, cp)) = (
                (polar as f32).to_radians().sin_cos(),
                (turn as f32).to_radians().sin_cos(),
            );
            let light = Vec3::new(st * cp, st * sp, ct).normalize();
            let light = if polar == 0.0 { Vec3::Z } else { light };
            let off = |right: Vec3, up: Vec3| {
                let parts = [
                    right.dot(up),
                    right.dot(light),
                    up.dot(light),
                    right.length() - 1.0,
                    up.length() - 1.0,
                ];
                parts.iter().fold(0.0f64, |a, &b| {
                    if b.is_nan() {
                        f64::NAN
                    } else {
                        a.max(f64::from(b.abs()))
                    }
                })
            };
            let at = || format!("{polar:.1} degrees from the zenith");
            let (right, up) = light.any_orthonormal_pair();
            robust.see(off(right, up), at);
            let side = light.cross(Vec3::Z) / light.cross(Vec3::Z).length();
            naive.see(off(side, side.cross(light)), at);
        }
    }
    Row {
        formula: "axes beside a light (Duff et al. 2017)",
        domain: "all directions, departure from orthonormal",
        robust: Errors {
            value: robust,
            gradient: None,
        },
        limit: (1e-6, 0.0),
        naive: Errors {
            value: naive,
            gradient: None,
        },
        cost: None,
    }
}

/// Uniform images of any brightness against themselves with slight noise: SSIM's variances are rounding.
fn window_row() -> Row {
    let size = 24;
    let (mut robust, mut naive) = (Worst::default(), Worst::default());
    let pair = |bright: f32| {
        let mut image = Raster::filled(size, size, 1, bright);
        image
            .values
            .iter_mut()
            .enumerate()
            .for_each(|(i, v)| *v *= 1.0 + 1e-7 * ((i * 7919) % 3) as f32);
        (image, Raster::filled(size, size, 1, bright))
    };
    for exponent in steps(-2.0, 4.9, 140) {
        let bright = 10f32.powf(exponent as f32);
        let (image, truth) = pair(bright);
        let (value, gradient) = photometric(&image, &truth, &vec![1.0; size * size], 1.0);
        let at = || format!("brightness {bright:.3e}");
        let steepest = gradient
            .values
            .iter()
            .fold(0.0f32, |a, g| if g.is_nan() { f32::NAN } else { a.max(g.abs()) });
        robust.see(if steepest.is_finite() { value.abs() } else { f64::NAN }, at);
        naive.see(plain_ssim_loss(bright), at);
    }
    Row {
        formula: "1 - SSIM of even images, variances `max(E[x²] - E[x]², 0)`",
        domain: "brightness from 0.01 to 8e4 (1 is white), absolute: the loss should be 0",
        robust: Errors {
            value: robust,
            gradient: None,
        },
        limit: (2.0, 0.0),
        naive: Errors {
            value: naive,
            gradient: None,
        },
        cost: None,
    }
}

/// `1 - SSIM` of two even areas as the textbook has it, in f32, from sums over a window of 121 pixels.
fn plain_ssim_loss(bright: f32) -> f64 {
    let (mut worst, n) = (0.0f64, 121);
    for shift in 0..40 {
        let value = bright * (1.0 + 1e-7 * shift as f32);
        let weight = 1.0 / n as f32;
        let (mut m, mut s) = (0.0f32, 0.0f32);
        for _ in 0..n {
            m += weight * value;
            s += weight * value * value;
        }
        let variance = s - m * m;
        let ssim = (2.0 * variance + 9e-4) / (variance + variance + 9e-4);
        let other = (2.0 * (s - m * bright) + 9e-4) / (variance + 9e-4);
        worst = worst.max(f64::from((1.0 - ssim).abs().max((1.0 - other).abs())));
    }
    worst
}
