//! The one-light-at-a-time model against its f64 form: transmittance to point lights, values to 1e-4, gradients to 1e-3 of central
//! differences, per parameter group.

use glam::{DVec3, Vec3};
use heliosplat::gaussians::{FEATURES, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};
use heliosplat::light::Light;
use heliosplat::model::olat::{DIFFUSE, FRAME, LOBES, Olat, OlatOptions, SPECULAR, WEIGHT};
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::{Lit, Pass, PassOptions};
use heliosplat::trace::{Occluders, TraceOptions, transmittance};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_tests::reference::{self, Gaussian};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::f64::consts::PI;

const SIZE: usize = 20;
const BANDS: usize = 4;
const DISTANCE: f64 = 3.0;
const RADIUS: f64 = 0.5;

struct Case {
    parameters: Parameters,
    model: Olat,
    camera: ProjectiveCamera,
    eye: Vector3<f64>,
    light: Vector3<f64>,
    functional: Vec<f64>,
}

fn case(seed: u64, specular: bool) -> Case {
    let mut random = Pcg32::seed_from_u64(seed);
    let mut uniform = |lo: f32, hi: f32| lo + (hi - lo) * random.random::<f32>();
    let model = Olat::new(OlatOptions {
        specular,
        coverage: true,
        background: [0.1, 0.0, 0.3],
        distance: DISTANCE as f32,
        radius: RADIUS as f32,
        ..OlatOptions::default()
    });
    let mut groups = core_groups();
    groups.extend(model.feature_groups());
    let mut gaussians = Table::zeros(groups, 20);
    for group in &mut gaussians.groups[FEATURES..] {
        group.values.iter_mut().for_each(|v| *v = uniform(-1.0, 1.0));
    }
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
    let mut globals = model.initial_globals();
    for group in &mut globals.groups {
        group.values.iter_mut().for_each(|v| *v += uniform(-0.4, 0.4));
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
        light: Vector3::new(0.5, 1.75, 2.5),
        functional: (0..SIZE * SIZE * BANDS)
            .map(|_| f64::from(uniform(-1.0, 1.0)))
            .collect(),
        parameters: Parameters { gaussians, globals },
        model,
    }
}

type Flat = Vec<Vec<f64>>;

fn flat(table: &Table) -> Flat {
    let wide = |values: &Vec<f32>| values.iter().map(|&v| f64::from(v)).collect();
    table.groups.iter().map(|g| wide(&g.values)).collect()
}

fn rotation(q: &[f64]) -> Matrix3<f64> {
    let q = Quaternion::new(q[3], q[0], q[1], q[2]);
    UnitQuaternion::from_quaternion(q).to_rotation_matrix().into_inner()
}

fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

fn soft_cosine(c: f64) -> f64 {
    let t = 0.01 * (1.0 - (-1.0f64).exp());
    (if c > 0.0 { c } else { 0.01 * c.exp_m1() } + t) / (1.0 + t)
}

/// A lobe as printed: an arc cosine and a normalised tangent.
fn lobe(lambda: f64, mu: f64, sigma: f64, v: &Vector3<f64>) -> f64 {
    let tangent = v.xy().normalize();
    let ratio = ((tangent.x / lambda).powi(2) + (tangent.y / mu).powi(2)).sqrt();
    let angle = v.z.clamp(-1.0, 1.0).acos();
    (-0.5 * (angle * ratio / sigma).powi(2)).exp() / (2f64.sqrt() * PI.powf(2.0 / 3.0) * sigma)
}

/// What Gaussian `i` reflects of a light of strength one that reaches it wholly.
fn reflected(case: &Case, gaussians: &Flat, globals: &Flat, i: usize) -> Vec<f64> {
    let position = Vector3::from_row_slice(&gaussians[POSITION][i * 3..i * 3 + 3]);
    let (to_light, to_eye) = (case.light - position, case.eye - position);
    let falling = DISTANCE * DISTANCE / (to_light.norm_squared() + RADIUS * RADIUS);
    let (to_light, to_eye) = (to_light.normalize(), to_eye.normalize());
    let frame = rotation(&gaussians[FRAME][i * 4..i * 4 + 4]);
    let cosine = soft_cosine(frame.column(2).dot(&to_light));
    let mut gloss = 0.0;
    if case.model.options.specular {
        let half = (to_light + to_eye).normalize();
        let fresnel = 0.04 + 0.96 * (1.0 - to_light.dot(&half)).powi(5);
        let own = frame.transpose() * half;
        for j in 0..LOBES {
            let v = rotation(&globals[0][j * 4..j * 4 + 4]).transpose() * own;
            let widest = softplus(-2.0 + 2.0 * j as f64 / 7.0);
            let (lambda, mu) = (10.0 * sigmoid(globals[1][j * 2]), 10.0 * sigmoid(globals[1][j * 2 + 1]));
            let value = lobe(lambda, mu, sigmoid(globals[2][j]) * widest, &v);
            gloss += softplus(gaussians[WEIGHT][i * LOBES + j]) * value * fresnel;
        }
    }
    (0..3)
        .map(|k| {
            let diffuse = softplus(gaussians[DIFFUSE][i * 3 + k]) / PI;
            let specular = if gloss > 0.0 {
                softplus(gaussians[SPECULAR][i * 3 + k]) * gloss
            } else {
                0.0
            };
            (diffuse + specular) * cosine * falling
        })
        .collect()
}

fn reference_gaussians(flat: &Flat) -> Vec<Gaussian> {
    (0..flat[OPACITY].len())
        .map(|i| Gaussian {
            position: Vector3::from_row_slice(&flat[POSITION][i * 3..i * 3 + 3]),
            log_scale: Vector3::from_row_slice(&flat[LOG_SCALE][i * 3..i * 3 + 3]),
            rotation: [0, 1, 2, 3].map(|k| flat[ROTATION][i * 4 + k]),
            opacity: flat[OPACITY][i],
            albedo: Vec::new(),
        })
        .collect()
}

/// The image's values, pixel after pixel: red, green, blue, coverage.
fn reference_values(case: &Case, flat: &Flat, globals: &Flat) -> Vec<f64> {
    let mut gaussians = reference_gaussians(flat);
    let lit: Vec<f64> = (0..gaussians.len())
        .map(|i| reference::transmittance_to_point(&gaussians, i, &case.light))
        .collect();
    for (i, gaussian) in gaussians.iter_mut().enumerate() {
        gaussian.albedo = reflected(case, flat, globals, i)
            .into_iter()
            .map(|c| c * lit[i])
            .collect();
    }
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
    let pixels = reference::render(
        &gaussians,
        &camera,
        &lit,
        f64::from(options.filter_px2),
        options.antialias,
    );
    let background = case.model.options.background;
    let values = pixels.iter().flat_map(|p| {
        let behind = |k: usize| p.albedo[k] + (1.0 - p.alpha) * f64::from(background[k]);
        [behind(0), behind(1), behind(2), p.alpha]
    });
    values.collect()
}

fn light(case: &Case) -> Light {
    Light::Point(Vec3::new(case.light.x as f32, case.light.y as f32, case.light.z as f32))
}

fn engine(case: &Case) -> (Vec<f64>, Parameters) {
    let occluders = Occluders::new(&case.parameters.gaussians);
    let context = Context {
        parameters: &case.parameters,
        camera: &case.camera,
        light: Some(light(case)),
        appearance: None,
    };
    let pass = Pass::new(&case.model, context, Lit::Traced(&occluders), PassOptions::default());
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
fn transmittance_to_a_point_light_is_that_of_the_f64_reference() {
    let mut shaded = 0;
    for seed in 0..6 {
        let case = case(seed, false);
        let table = &case.parameters.gaussians;
        let gaussians = reference_gaussians(&flat(table));
        let origins: Vec<u32> = (0..table.count as u32).collect();
        let traced = transmittance(
            &Occluders::new(table),
            &origins,
            &light(&case),
            &TraceOptions::default(),
        );
        for (i, value) in traced.values.iter().enumerate() {
            let exact = reference::transmittance_to_point(&gaussians, i, &case.light);
            assert!((f64::from(*value) - exact).abs() < 1e-4, "{seed} {i}: {value} {exact}");
            shaded += usize::from(exact < 0.9);
        }
    }
    assert!(shaded > 10, "{shaded}");
}

#[test]
fn values_match_the_f64_form() {
    for (seed, specular) in [(0, false), (1, true), (2, true)] {
        let case = case(seed, specular);
        let (engine, _) = engine(&case);
        let (gaussians, globals) = (flat(&case.parameters.gaussians), flat(&case.parameters.globals));
        let reference = reference_values(&case, &gaussians, &globals);
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

fn check_gradients(case: &Case) {
    let (_, grads) = engine(case);
    let base = (flat(&case.parameters.gaussians), flat(&case.parameters.globals));
    let loss = |of: &(Flat, Flat)| -> f64 {
        let values = reference_values(case, &of.0, &of.1);
        values.iter().zip(&case.functional).map(|(v, f)| v * f).sum()
    };
    let step = 1e-6;
    let compare = |table: &Table, pick: &dyn Fn(&mut (Flat, Flat)) -> &mut Flat| {
        for (group, values) in table.groups.iter().enumerate() {
            let (mut apart, mut norm) = (0.0, 0.0);
            for (i, &analytic) in values.values.iter().enumerate() {
                let (mut hi, mut lo) = (base.clone(), base.clone());
                pick(&mut hi)[group][i] += step;
                pick(&mut lo)[group][i] -= step;
                let numeric = (loss(&hi) - loss(&lo)) / (2.0 * step);
                apart += (numeric - f64::from(analytic)).powi(2);
                norm += numeric.powi(2);
            }
            let relative = (apart / norm.max(1e-30)).sqrt();
            println!("{}: {relative:.2e}", values.spec.name);
            assert!(relative < 1e-3, "{}: {relative}", values.spec.name);
        }
    };
    compare(&grads.gaussians, &|of| &mut of.0);
    compare(&grads.globals, &|of| &mut of.1);
}

#[test]
fn gradients_match_central_differences_of_the_f64_form() {
    check_gradients(&case(11, true));
    check_gradients(&case(12, false));
}
