//! The radiance model against its f64 form: values to 1e-4, gradients to 1e-3 of central differences, per parameter group.

use glam::{DVec3, Vec3};
use heliosplat::gaussians::{FEATURES, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};
use heliosplat::model::radiance::{Radiance, RadianceOptions};
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::{Lit, Pass, PassOptions};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_tests::harmonics::harmonics;
use heliosplat_tests::reference::{self, Gaussian};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

const SIZE: usize = 20;
const BANDS: usize = 4;
const BACKGROUND: [f32; 3] = [0.9, 0.2, 0.5];

struct Case {
    parameters: Parameters,
    model: Radiance,
    camera: ProjectiveCamera,
    eye: Vector3<f64>,
    functional: Vec<f64>,
}

fn case(seed: u64) -> Case {
    let mut random = Pcg32::seed_from_u64(seed);
    let mut uniform = |lo: f32, hi: f32| lo + (hi - lo) * random.random::<f32>();
    let model = Radiance::new(RadianceOptions {
        degree: 3,
        background: BACKGROUND,
        coverage: true,
    });
    let mut groups = core_groups();
    groups.extend(model.feature_groups());
    let mut gaussians = Table::zeros(groups, 24);
    for i in 0..gaussians.count {
        for k in 0..3 {
            gaussians.group_mut(POSITION)[i * 3 + k] = uniform(-1.0, 1.0);
            gaussians.group_mut(LOG_SCALE)[i * 3 + k] = uniform(-2.6, -1.2);
        }
        for k in 0..4 {
            gaussians.group_mut(ROTATION)[i * 4 + k] = uniform(-1.0, 1.0);
        }
        gaussians.group_mut(OPACITY)[i] = uniform(-2.0, 2.0);
    }
    // Colours stay above black, where the gradient is the derivative.
    for degree in 0..4 {
        let reach = [0.5, 0.15, 0.05, 0.03][degree];
        gaussians
            .group_mut(FEATURES + degree)
            .iter_mut()
            .for_each(|c| *c = uniform(-reach, reach));
    }
    let eye = DVec3::new(2.5, -1.5, 2.0);
    let axis = -eye.normalize();
    let right = axis.cross(DVec3::Z).normalize();
    let (down, w) = (axis.cross(right), axis / eye.length());
    let (focal, centre) = (26.0 / eye.length(), (SIZE as f64 - 1.0) / 2.0);
    let (u, v) = (right * focal + w * centre, down * focal + w * centre);
    let (u, v) = ([u.x, u.y, u.z, centre], [v.x, v.y, v.z, centre]);
    Case {
        camera: ProjectiveCamera::new(u, v, w.into(), (SIZE, SIZE), axis),
        eye: Vector3::new(eye.x, eye.y, eye.z),
        functional: (0..SIZE * SIZE * BANDS)
            .map(|_| f64::from(uniform(-1.0, 1.0)))
            .collect(),
        parameters: Parameters {
            gaussians,
            globals: Table::default(),
        },
        model,
    }
}

type Flat = Vec<Vec<f64>>;

fn flat(table: &Table) -> Flat {
    let wide = |values: &Vec<f32>| values.iter().map(|&v| f64::from(v)).collect();
    table.groups.iter().map(|g| wide(&g.values)).collect()
}

fn colour(flat: &Flat, i: usize, eye: &Vector3<f64>) -> Vec<f64> {
    let position = Vector3::from_row_slice(&flat[POSITION][i * 3..i * 3 + 3]);
    let functions = harmonics(3, &(position - eye).normalize());
    (0..3)
        .map(|k| {
            let mut sum = 0.5;
            for (f, value) in functions.iter().enumerate() {
                let degree = f.isqrt();
                let place = (i * (2 * degree + 1) + f - degree * degree) * 3 + k;
                sum += value * flat[FEATURES + degree][place];
            }
            sum.max(0.0)
        })
        .collect()
}

/// The image's values, pixel after pixel: red, green, blue, coverage.
fn reference_values(case: &Case, flat: &Flat) -> Vec<f64> {
    let gaussians: Vec<Gaussian> = (0..flat[OPACITY].len())
        .map(|i| Gaussian {
            position: Vector3::from_row_slice(&flat[POSITION][i * 3..i * 3 + 3]),
            log_scale: Vector3::from_row_slice(&flat[LOG_SCALE][i * 3..i * 3 + 3]),
            rotation: [0, 1, 2, 3].map(|k| flat[ROTATION][i * 4 + k]),
            opacity: flat[OPACITY][i],
            albedo: colour(flat, i, &case.eye),
        })
        .collect();
    let vec = |x: Vec3| Vector3::new(f64::from(x.x), f64::from(x.y), f64::from(x.z));
    let four = |x: Vec3, c: f32| [f64::from(x.x), f64::from(x.y), f64::from(x.z), f64::from(c)];
    let camera = reference::Camera {
        u: four(case.camera.u, case.camera.u0),
        v: four(case.camera.v, case.camera.v0),
        w: vec(case.camera.w),
        axis: vec(case.camera.depth_axis),
        width: SIZE,
        height: SIZE,
    };
    let options = PassOptions::default().projection;
    let lit = vec![1.0; gaussians.len()];
    let pixels = reference::render(
        &gaussians,
        &camera,
        &lit,
        f64::from(options.filter_px2),
        options.antialias,
    );
    let values = pixels.iter().flat_map(|p| {
        let behind = |k: usize| p.albedo[k] + (1.0 - p.alpha) * f64::from(BACKGROUND[k]);
        [behind(0), behind(1), behind(2), p.alpha]
    });
    values.collect()
}

fn engine(case: &Case) -> (Vec<f64>, Parameters) {
    let context = Context {
        parameters: &case.parameters,
        camera: &case.camera,
        light: None,
        appearance: None,
    };
    let pass = Pass::new(&case.model, context, Lit::Everywhere, PassOptions::default());
    let image = pass.image();
    let plane = SIZE * SIZE;
    let mut d_image = Raster::filled(SIZE, SIZE, BANDS, 0.0);
    let mut values = Vec::new();
    for i in 0..plane {
        for k in 0..BANDS {
            values.push(f64::from(image.values[k * plane + i]));
            d_image.values[k * plane + i] = case.functional[i * BANDS + k] as f32;
        }
    }
    let (mut d_maps, mut grads) = (pass.zero_gradients(), case.parameters.zeros_like());
    case.model
        .compose_backward(&context, &pass.maps, &d_image, &mut d_maps, &mut grads);
    pass.backward(&d_maps, &mut grads);
    (values, grads)
}

#[test]
fn values_match_the_f64_form() {
    for seed in 0..3 {
        let case = case(seed);
        let (engine, _) = engine(&case);
        let reference = reference_values(&case, &flat(&case.parameters.gaussians));
        let norm = reference.iter().map(|v| v * v).sum::<f64>().sqrt();
        let apart = engine
            .iter()
            .zip(&reference)
            .map(|(a, b)| (a - b).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!(apart < 1e-4 * norm, "{}", apart / norm);
    }
}

#[test]
fn gradients_match_central_differences_of_the_f64_form() {
    let case = case(7);
    let (_, grads) = engine(&case);
    let base = flat(&case.parameters.gaussians);
    let loss = |flat: &Flat| -> f64 {
        let values = reference_values(&case, flat);
        values.iter().zip(&case.functional).map(|(v, f)| v * f).sum()
    };
    let step = 1e-6;
    for (group, values) in grads.gaussians.groups.iter().enumerate() {
        let (mut apart, mut norm) = (0.0, 0.0);
        for (i, &analytic) in values.values.iter().enumerate() {
            let (mut hi, mut lo) = (base.clone(), base.clone());
            hi[group][i] += step;
            lo[group][i] -= step;
            let numeric = (loss(&hi) - loss(&lo)) / (2.0 * step);
            apart += (numeric - f64::from(analytic)).powi(2);
            norm += numeric.powi(2);
        }
        let relative = (apart / norm.max(1e-30)).sqrt();
        assert!(relative < 1e-3, "{}: {relative}", values.spec.name);
    }
}

#[test]
fn a_colour_below_black_hears_what_would_make_it_brighter_and_nothing_else() {
    let mut case = case(3);
    case.parameters.gaussians.group_mut(FEATURES).fill(-4.0);
    let gradient = |case: &Case| -> Vec<f32> { engine(case).1.gaussians.group(FEATURES).to_vec() };
    // All values above what is wanted: darker is asked for, and black cannot.
    case.functional.fill(1.0);
    assert!(gradient(&case).iter().all(|&d| d == 0.0));
    case.functional.fill(-1.0);
    assert!(gradient(&case).iter().any(|&d| d < 0.0));
}
