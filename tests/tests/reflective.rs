//! The reflective model against its f64 form, written anew: values to 1e-4, gradients to 1e-3 of central differences,
//! per parameter group. Surfaces that are not glossy must not evaluate the decoder.

use heliosplat::ProjectiveCamera;
use heliosplat::gaussians::{FEATURES, POSITION, Table, core_groups};
use heliosplat::model::reflective::{ALBEDO, EMBEDDING, FRAME, LIGHT, MATERIAL, Reflective, ReflectiveOptions};
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::Lit;
use heliosplat_tests::capture::{
    BANDS, Flat, SIZE, camera, engine_values, flat, network, reference_gaussians, reference_pixels, scatter,
};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::f64::consts::PI;
use std::sync::OnceLock;

const HALF_SIZE: f64 = 1.5;

struct Case {
    parameters: Parameters,
    model: Reflective,
    camera: ProjectiveCamera,
    eye: Vector3<f64>,
    functional: Vec<f64>,
}

fn case(seed: u64, specular: bool, display: bool) -> Case {
    let mut random = Pcg32::seed_from_u64(seed);
    let mut uniform = |lo: f32, hi: f32| lo + (hi - lo) * random.random::<f32>();
    let model = Reflective::new(ReflectiveOptions {
        specular,
        width: 16,
        hidden: 2,
        half_size: HALF_SIZE as f32,
        coverage: true,
        display,
        background: [0.1, 0.0, 0.3],
        ..ReflectiveOptions::default()
    });
    let mut groups = core_groups();
    groups.extend(model.feature_groups());
    let mut gaussians = Table::zeros(groups, 20);
    for (at, group) in gaussians.groups.iter_mut().enumerate().skip(FEATURES) {
        let reach = if at >= LIGHT { 0.25 } else { 1.0 };
        group.values.iter_mut().for_each(|v| *v = uniform(-reach, reach));
    }
    scatter(&mut gaussians, &mut uniform);
    let mut globals = model.initial_globals(seed);
    for group in &mut globals.groups {
        group.values.iter_mut().for_each(|v| *v += uniform(-0.1, 0.1));
    }
    let (camera, eye) = camera();
    Case {
        camera,
        eye,
        functional: (0..SIZE * SIZE * BANDS)
            .map(|_| f64::from(uniform(-1.0, 1.0)))
            .collect(),
        parameters: Parameters { gaussians, globals },
        model,
    }
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// The functions in the engine's order, from their definition in Cartesian form (Sloan 2008).
fn harmonics(d: &Vector3<f64>) -> [f64; 16] {
    let (x, y, z) = (d.x, d.y, d.z);
    let root = |a: f64, b: f64| 0.5 * (a / (b * PI)).sqrt();
    [
        root(1.0, 1.0),
        -root(3.0, 1.0) * y,
        root(3.0, 1.0) * z,
        -root(3.0, 1.0) * x,
        root(15.0, 1.0) * x * y,
        -root(15.0, 1.0) * y * z,
        0.5 * root(5.0, 1.0) * (2.0 * z * z - x * x - y * y),
        -root(15.0, 1.0) * x * z,
        0.5 * root(15.0, 1.0) * (x * x - y * y),
        -root(35.0, 2.0) * y * (3.0 * x * x - y * y) * 0.5,
        root(105.0, 1.0) * x * y * z,
        -root(21.0, 2.0) * y * (4.0 * z * z - x * x - y * y) * 0.5,
        0.5 * root(7.0, 1.0) * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y),
        -root(21.0, 2.0) * x * (4.0 * z * z - x * x - y * y) * 0.5,
        0.5 * root(105.0, 1.0) * z * (x * x - y * y),
        -root(35.0, 2.0) * x * (x * x - 3.0 * y * y) * 0.5,
    ]
}

/// Nodes of the table of split sums along each side, and facets drawn for each node, squared.
const NODES: usize = 65;
const FACETS: usize = 40;

/// The split sum as it is defined (Karis 2013): of facets drawn from GGX, those that mirror light to the eye, with
/// Schlick's masking.
fn split_sum_at(roughness: f64, cosine: f64) -> [f64; 2] {
    let (normal, alpha, cosine) = (Vector3::z(), roughness.powi(2), cosine.max(1e-4));
    let eye = Vector3::new((1.0 - cosine.powi(2)).sqrt(), 0.0, cosine);
    let masking = |c: f64| c / (c + alpha / 2.0 - c * alpha / 2.0);
    let (mut sums, side) = ([0.0; 2], FACETS as f64);
    for i in 0..FACETS {
        // Finer where the draw is steep.
        let left = ((side - i as f64 - 0.5) / side).powi(3);
        let weight = 3.0 * left.powf(2.0 / 3.0) / (side * side);
        let tilt = (alpha * ((1.0 - left) / left).sqrt()).atan();
        for j in 0..FACETS {
            let turn = PI * (j as f64 + 0.5) / side;
            let half = Vector3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos());
            let seen = eye.dot(&half);
            let light = half * (2.0 * seen) - eye;
            if light.z <= 0.0 || seen <= 0.0 {
                continue;
            }
            let shown = masking(eye.z) * masking(light.z) * seen / (normal.dot(&half) * eye.z) * weight;
            let grazing = (1.0 - seen).powi(5);
            sums[0] += (1.0 - grazing) * shown;
            sums[1] += grazing * shown;
        }
    }
    sums
}

/// The split sum between its nodes, even in the roughness and the root of the cosine.
fn split_sums(roughness: f64, cosine: f64) -> [f64; 2] {
    static TABLE: OnceLock<Vec<[f64; 2]>> = OnceLock::new();
    let last = (NODES - 1) as f64;
    let table = TABLE.get_or_init(|| {
        let places = (0..NODES * NODES).map(|n| ((n / NODES) as f64 / last, (n % NODES) as f64 / last));
        places.map(|(r, root)| split_sum_at(r, root * root)).collect()
    });
    let (x, y) = (roughness * last, cosine.sqrt() * last);
    let (i, j) = ((x as usize).min(NODES - 2), (y as usize).min(NODES - 2));
    let (u, v) = (x - i as f64, y - j as f64);
    let value = |k: usize| {
        let at = |i: usize, j: usize| table[i * NODES + j][k];
        (at(i, j) * (1.0 - v) + at(i, j + 1) * v) * (1.0 - u) + (at(i + 1, j) * (1.0 - v) + at(i + 1, j + 1) * v) * u
    };
    [value(0), value(1)]
}

fn shown(display: bool, light: f64) -> f64 {
    match display {
        true if light <= 0.003_130_8 => 12.92 * light,
        true => 1.055 * light.powf(1.0 / 2.4) - 0.055,
        false => light,
    }
}

/// Channels of Gaussian `i`: diffuse light, facing normal, reflected light of the harmonics, reflectance, weight of the
/// specular term, mean square of the lobe's widths, embedding.
fn channels(case: &Case, gaussians: &Flat, globals: &Flat, i: usize) -> Vec<f64> {
    let part = |group: usize, width: usize| &gaussians[group][i * width..(i + 1) * width];
    let position = Vector3::from_row_slice(part(POSITION, 3));
    let q = part(FRAME, 4);
    let frame = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]));
    let n = frame * Vector3::z();
    let eye = (case.eye - position).normalize();
    let n_dot_eye = n.dot(&eye);
    let facing = n * n_dot_eye.signum();
    let t = n * (2.0 * n_dot_eye) - eye;
    let material: Vec<f64> = part(MATERIAL, 4).iter().map(|&v| sigmoid(v)).collect();
    let (metallic, gloss) = (material[0], material[3]);
    let alpha = [0.03 + 0.97 * material[1], 0.03 + 0.97 * material[2]];
    let albedo: Vec<f64> = part(ALBEDO, 3).iter().map(|&v| sigmoid(v)).collect();
    let light = |f: usize, k: usize| {
        let degree = (f as f64).sqrt() as usize;
        let own = part(LIGHT + degree, (2 * degree + 1) * 3);
        own[(f - degree * degree) * 3 + k] + globals[0][f * 3 + k]
    };
    let cosine_kernel = [1.0, 2.0 / 3.0, 0.25, 0.0];
    let (diffuse_basis, reflected_basis) = (harmonics(&facing), harmonics(&t));
    let rho = alpha[0] * alpha[0] + alpha[1] * alpha[1];
    let (mut irradiance, mut reflected) = ([0.0; 3], [0.0; 3]);
    for f in 0..16 {
        let degree = (f as f64).sqrt() as usize;
        let blur = (-rho * (degree * (degree + 1)) as f64 / 2.0).exp();
        for k in 0..3 {
            irradiance[k] += cosine_kernel[degree] * diffuse_basis[f] * light(f, k);
            reflected[k] += blur * reflected_basis[f] * light(f, k);
        }
    }
    let mut channels: Vec<f64> = (0..3)
        .map(|k| albedo[k] * (1.0 - metallic) * irradiance[k].max(0.0))
        .collect();
    channels.extend(facing.iter());
    channels.extend(reflected);
    channels.extend(albedo.iter().map(|a| gloss * (0.04 * (1.0 - metallic) + metallic * a)));
    channels.extend([gloss, rho / 2.0]);
    channels.extend(part(EMBEDDING, 2));
    channels
}

/// Specular light of a pixel from its channels over alpha, the direction to the eye, and the point that it shows.
fn specular(channels: &[f64], eye: Vector3<f64>, position: Vector3<f64>, weights: &[f64]) -> [f64; 3] {
    let n = Vector3::from_row_slice(&channels[3..6]).normalize();
    let n_dot_eye = n.dot(&eye);
    let t = n * (2.0 * n_dot_eye) - eye;
    let (reflected, reflectance) = (&channels[6..9], &channels[9..12]);
    let (gloss, alpha) = (channels[12], channels[13].sqrt());
    let x = n.cross(&Vector3::new(0.3, -0.2, 0.9)).normalize();
    let lobe_deviation = [x, n.cross(&x)].map(|axis| (n * eye.dot(&axis) + axis * n_dot_eye) * (2f64.sqrt() * alpha));
    // Corners of an icosahedron: a unit vector whose parts are in the golden ratio.
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    let (a, b) = (
        1.0 / (1.0 + golden * golden).sqrt(),
        golden / (1.0 + golden * golden).sqrt(),
    );
    let axes = [
        [0.0, a, b],
        [0.0, a, -b],
        [a, b, 0.0],
        [a, -b, 0.0],
        [b, 0.0, a],
        [-b, 0.0, a],
    ];
    let mut inputs = Vec::new();
    for axis in axes.map(Vector3::from) {
        for wave in [1.5, 3.0, 6.0, 12.0] {
            let variance = axis.dot(&lobe_deviation[0]).powi(2) + axis.dot(&lobe_deviation[1]).powi(2);
            let factor = (-0.5 * wave * wave * variance).exp();
            let angle = wave * axis.dot(&t);
            inputs.extend([factor * angle.sin(), factor * angle.cos()]);
        }
    }
    inputs.extend(reflected);
    inputs.extend([n_dot_eye.abs(), alpha]);
    inputs.extend((position / HALF_SIZE).iter());
    inputs.extend(&channels[14..16]);
    let decoded = network(weights, &inputs, 16, 3);
    let sums = split_sums(alpha.sqrt(), n_dot_eye.abs());
    std::array::from_fn(|k| {
        let u = reflected[k] + decoded[k];
        let arriving = u.max(0.0) + (-u.abs()).exp().ln_1p();
        arriving * (reflectance[k] * sums[0] + gloss * sums[1])
    })
}

/// Direction to the eye and the point at `depth` on the ray of pixel `i`.
fn on_ray(case: &Case, i: usize, depth: f64) -> (Vector3<f64>, Vector3<f64>) {
    let wide = |v: glam::Vec3| Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z));
    let (camera, (col, row)) = (&case.camera, ((i % SIZE) as f64, (i / SIZE) as f64));
    let (u, v, w, axis) = (wide(camera.u), wide(camera.v), wide(camera.w), wide(camera.depth_axis));
    let ray = (u - w * col).cross(&(v - w * row)).normalize();
    let ray = ray * ray.dot(&axis).signum();
    let along = (depth - axis.dot(&case.eye)) / axis.dot(&ray);
    (-ray, case.eye + ray * along)
}

fn reference_of(case: &Case, flat: &Flat, globals: &Flat) -> Vec<f64> {
    let mut gaussians = reference_gaussians(flat);
    for (i, gaussian) in gaussians.iter_mut().enumerate() {
        gaussian.albedo = channels(case, flat, globals, i);
    }
    let options = &case.model.options;
    let pixels = reference_pixels(&gaussians, &case.camera);
    let values = pixels.iter().enumerate().flat_map(|(i, pixel)| {
        // Fainter pixels show no surface.
        let share = 1.0 / pixel.alpha.max(1e-3);
        let channels: Vec<f64> = pixel.albedo.iter().map(|value| value * share).collect();
        let mut light = [channels[0], channels[1], channels[2]];
        if options.specular && pixel.alpha > 1e-3 && channels[12] > 0.02 {
            let (eye, position) = on_ray(case, i, pixel.depth * share);
            let specular = specular(&channels, eye, position, &globals[1]);
            light.iter_mut().zip(specular).for_each(|(light, more)| *light += more);
        }
        let over = |k: usize| {
            pixel.alpha * shown(options.display, light[k]) + (1.0 - pixel.alpha) * f64::from(options.background[k])
        };
        [over(0), over(1), over(2), pixel.alpha]
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
    engine_values(&case.model, context, Lit::Everywhere, &case.functional)
}

const CASES: [(u64, bool, bool); 3] = [(3, true, true), (4, true, false), (5, false, true)];

#[test]
fn values_match_the_f64_form() {
    for (seed, specular, display) in CASES {
        let case = case(seed, specular, display);
        let (engine, _) = engine(&case);
        let reference = reference_of(
            &case,
            &flat(&case.parameters.gaussians),
            &flat(&case.parameters.globals),
        );
        let norm = reference.iter().map(|v| v * v).sum::<f64>().sqrt();
        let apart = engine.iter().zip(&reference).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        assert!(apart.sqrt() < 1e-4 * norm, "{}", apart.sqrt() / norm);
    }
}

#[test]
fn gradients_match_central_differences_of_the_f64_form() {
    for (seed, specular, display) in CASES {
        let case = case(seed, specular, display);
        let (_, grads) = engine(&case);
        let base = (flat(&case.parameters.gaussians), flat(&case.parameters.globals));
        let loss = |of: &(Flat, Flat)| -> f64 {
            let values = reference_of(&case, &of.0, &of.1);
            values.iter().zip(&case.functional).map(|(v, f)| v * f).sum()
        };
        let step = 1e-6;
        let compare = |table: &Table, pick: &dyn Fn(&mut (Flat, Flat)) -> &mut Flat| {
            for (group, values) in table.groups.iter().enumerate() {
                let (mut apart, mut norm) = (0.0, 0.0);
                // A sample of a long group.
                let every = (values.values.len() / 80).max(1) | 1;
                for (i, &analytic) in values.values.iter().enumerate().step_by(every) {
                    let (mut hi, mut lo) = (base.clone(), base.clone());
                    pick(&mut hi)[group][i] += step;
                    pick(&mut lo)[group][i] -= step;
                    let numeric = (loss(&hi) - loss(&lo)) / (2.0 * step);
                    apart += (numeric - f64::from(analytic)).powi(2);
                    norm += numeric.powi(2);
                }
                let relative = (apart / norm.max(1e-30)).sqrt();
                println!("{}: {relative:.2e} of {norm:.2e}", values.spec.name);
                assert!(
                    relative < 1e-3 || apart.sqrt() < 1e-7,
                    "{}: {relative}",
                    values.spec.name
                );
            }
        };
        compare(&grads.gaussians, &|of| &mut of.0);
        compare(&grads.globals, &|of| &mut of.1);
    }
}

#[test]
fn without_gloss_the_decoder_is_not_asked_and_learns_nothing() {
    let mut case = case(3, true, true);
    for material in case.parameters.gaussians.group_mut(MATERIAL).chunks_mut(4) {
        material[3] = -9.0;
    }
    let (before, grads) = engine(&case);
    assert!(grads.globals.groups[1].values.iter().all(|&d| d == 0.0));
    case.parameters.globals.groups[1].values.fill(f32::NAN);
    assert_eq!(engine(&case).0, before);
}
