//! The one-light-at-a-time model against its f64 form: transmittance to point lights, values to 1e-4, gradients to 1e-3
//! of central differences, per parameter group.

use glam::Vec3;
use heliosplat::ProjectiveCamera;
use heliosplat::gaussians::{FEATURES, POSITION, Table, core_groups};
use heliosplat::light::Light;
use heliosplat::model::olat::{DIFFUSE, F0, FRAME, LOBES, Olat, OlatOptions, SPECULAR, WEIGHT};
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::Lit;
use heliosplat::trace::{Occluders, transmittance};
use heliosplat_tests::capture::{
    BANDS, Flat, SIZE, camera, engine_values, flat, network, reference_gaussians, reference_values, scatter,
};
use heliosplat_tests::reference;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::f64::consts::PI;

const DISTANCE: f64 = 3.0;
const RADIUS: f64 = 0.5;
const HALF_SIZE: f64 = 1.3;

struct Case {
    parameters: Parameters,
    model: Olat,
    camera: ProjectiveCamera,
    eye: Vector3<f64>,
    light: Vector3<f64>,
    functional: Vec<f64>,
}

fn case(seed: u64, specular: bool, networks: bool) -> Case {
    let mut random = Pcg32::seed_from_u64(seed);
    let mut uniform = |lo: f32, hi: f32| lo + (hi - lo) * random.random::<f32>();
    let model = Olat::new(OlatOptions {
        specular,
        scattering: networks,
        refined: networks,
        width: 16,
        hidden: 2,
        half_size: HALF_SIZE as f32,
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
    scatter(&mut gaussians, &mut uniform);
    let mut globals = model.initial_globals();
    for group in &mut globals.groups {
        group.values.iter_mut().for_each(|v| *v += uniform(-0.4, 0.4));
    }
    let (camera, eye) = camera();
    Case {
        camera,
        eye,
        light: Vector3::new(0.5, 1.75, 2.5),
        functional: (0..SIZE * SIZE * BANDS)
            .map(|_| f64::from(uniform(-1.0, 1.0)))
            .collect(),
        parameters: Parameters { gaussians, globals },
        model,
    }
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

/// Reflection of Gaussian `i` under a light of strength one that reaches it wholly.
fn reflected(case: &Case, gaussians: &Flat, globals: &Flat, i: usize) -> Vec<f64> {
    let position = Vector3::from_row_slice(&gaussians[POSITION][i * 3..i * 3 + 3]);
    let (to_light, to_eye) = (case.light - position, case.eye - position);
    let falloff = DISTANCE * DISTANCE / (to_light.norm_squared() + RADIUS * RADIUS);
    let (to_light, to_eye) = (to_light.normalize(), to_eye.normalize());
    let frame = rotation(&gaussians[FRAME][i * 4..i * 4 + 4]);
    let cosine = soft_cosine(frame.column(2).dot(&to_light));
    let mut gloss = 0.0;
    if case.model.options.specular {
        let half = (to_light + to_eye).normalize();
        let (cosine, f0) = (to_light.dot(&half), sigmoid(gaussians[F0][i]));
        let masking = 1.0 / cosine.max(0.25).powi(2);
        let fresnel = (f0 + (1.0 - f0) * (1.0 - cosine).powi(5)) * masking;
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
            (diffuse + specular) * cosine * falloff
        })
        .collect()
}

/// A vector as the networks read it.
fn encoded(v: &Vector3<f64>) -> Vec<f64> {
    v.iter()
        .flat_map(|x| [*x, x.sin(), x.cos(), (2.0 * x).sin(), (2.0 * x).cos()])
        .collect()
}

/// The directions to light and eye, and the other inputs of the networks for Gaussian `i`.
fn around(case: &Case, gaussians: &Flat, i: usize) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>, Vec<f64>) {
    let position = Vector3::from_row_slice(&gaussians[POSITION][i * 3..i * 3 + 3]);
    let embedding_group = case.model.embedding_group().expect("a network is on");
    let embedding = gaussians[embedding_group][i * 6..i * 6 + 6].to_vec();
    let (to_light, to_eye) = (case.light - position, case.eye - position);
    (
        position / HALF_SIZE,
        to_light.normalize(),
        to_eye.normalize(),
        embedding,
    )
}

/// Scattered light of Gaussian `i`: the dipole as printed, with the network's prediction.
fn scattered(case: &Case, gaussians: &Flat, globals: &Flat, i: usize) -> Vec<f64> {
    let (position, to_light, to_eye, embedding) = around(case, gaussians, i);
    let normal = rotation(&gaussians[FRAME][i * 4..i * 4 + 4]).column(2).into_owned();
    let inputs = [
        encoded(&position),
        encoded(&to_light),
        encoded(&to_eye),
        normal.as_slice().to_vec(),
        embedding,
    ]
    .concat();
    let at = if case.model.options.specular { 3 } else { 0 };
    let out = network(&globals[at], &inputs, 16, 3);
    let (r, s, a) = (
        3.0 * sigmoid(out[0]) + 0.1,
        2.0 * sigmoid(out[1]) + 0.05,
        2.0 * sigmoid(out[2]) + 0.05,
    );
    let (t, transport) = (s + a, (3.0 * a * (s + a)).sqrt());
    let pole = |z: f64| {
        let d = r.hypot(z);
        z * (1.0 + transport * d) * (-transport * d).exp() / d.powi(3)
    };
    let profile = s / t / (4.0 * PI) * (pole(1.0 / t) + pole((1.0 + 4.0 / 3.0 * 2.602_064) / t));
    let position = Vector3::from_row_slice(&gaussians[POSITION][i * 3..i * 3 + 3]);
    let falloff = DISTANCE * DISTANCE / ((case.light - position).norm_squared() + RADIUS * RADIUS);
    let scattered_group = case.model.scattered_group().expect("light scatters");
    let colours = &gaussians[scattered_group][i * 3..i * 3 + 3];
    colours.iter().map(|&c| softplus(c) * profile * falloff).collect()
}

/// A shadow as the network refines it.
fn refined(case: &Case, gaussians: &Flat, globals: &Flat, i: usize, transmittance: f64) -> f64 {
    let (position, to_light, _, embedding) = around(case, gaussians, i);
    let inputs = [encoded(&position), encoded(&to_light), embedding, vec![transmittance]].concat();
    let at = if case.model.options.specular { 4 } else { 1 };
    let logit_shift = network(&globals[at], &inputs, 16, 1)[0];
    let t = transmittance.clamp(0.02, 0.98);
    sigmoid((t / (1.0 - t)).ln() + logit_shift)
}

/// The image's values, pixel after pixel: red, green, blue, coverage.
fn reference_of(case: &Case, flat: &Flat, globals: &Flat) -> Vec<f64> {
    let mut gaussians = reference_gaussians(flat);
    let transmittance: Vec<f64> = (0..gaussians.len())
        .map(|i| reference::transmittance_to_point(&gaussians, i, &case.light))
        .collect();
    for (i, gaussian) in gaussians.iter_mut().enumerate() {
        let networks = case.model.options.scattering;
        let transmittance = if networks {
            refined(case, flat, globals, i, transmittance[i])
        } else {
            transmittance[i]
        };
        gaussian.albedo = reflected(case, flat, globals, i)
            .into_iter()
            .map(|c| c * transmittance)
            .collect();
        if networks {
            let more = scattered(case, flat, globals, i);
            gaussian.albedo.iter_mut().zip(more).for_each(|(sum, c)| *sum += c);
        }
    }
    reference_values(&gaussians, &case.camera, case.model.options.background)
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
    engine_values(&case.model, context, Lit::Traced(&occluders), &case.functional)
}

#[test]
fn transmittance_to_a_point_light_is_that_of_the_f64_reference() {
    let mut shaded = 0;
    for seed in 0..6 {
        let case = case(seed, false, false);
        let table = &case.parameters.gaussians;
        let gaussians = reference_gaussians(&flat(table));
        let origins: Vec<u32> = (0..table.count as u32).collect();
        let traced = transmittance(&Occluders::new(table), &origins, &light(&case));
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
    for (seed, specular, networks) in [(0, false, false), (1, true, false), (2, true, true), (3, false, true)] {
        let case = case(seed, specular, networks);
        let (engine, _) = engine(&case);
        let (gaussians, globals) = (flat(&case.parameters.gaussians), flat(&case.parameters.globals));
        let reference = reference_of(&case, &gaussians, &globals);
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
        let values = reference_of(case, &of.0, &of.1);
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
    check_gradients(&case(11, true, false));
    check_gradients(&case(12, false, false));
}

#[test]
fn gradients_of_scattering_and_of_refined_shadows_match_central_differences_of_the_f64_form() {
    check_gradients(&case(13, true, true));
    check_gradients(&case(14, false, true));
}
