//! The radiance model against its f64 form: values to 1e-4, gradients to 1e-3 of central differences, per parameter
//! group.

use heliosplat::ProjectiveCamera;
use heliosplat::gaussians::{FEATURES, POSITION, Table, core_groups};
use heliosplat::model::radiance::{Radiance, RadianceOptions};
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::Lit;
use heliosplat_tests::capture::{
    BANDS, Flat, SIZE, camera, engine_values, flat, reference_gaussians, reference_values, scatter,
};
use heliosplat_tests::harmonics::harmonics;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

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
    scatter(&mut gaussians, &mut uniform);
    // Colours stay above black, where the gradient is the derivative.
    for degree in 0..4 {
        let reach = [0.5, 0.15, 0.05, 0.03][degree];
        gaussians
            .group_mut(FEATURES + degree)
            .iter_mut()
            .for_each(|c| *c = uniform(-reach, reach));
    }
    let (camera, eye) = camera();
    Case {
        camera,
        eye,
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
fn reference_of(case: &Case, flat: &Flat) -> Vec<f64> {
    let mut gaussians = reference_gaussians(flat);
    for (i, gaussian) in gaussians.iter_mut().enumerate() {
        gaussian.albedo = colour(flat, i, &case.eye);
    }
    reference_values(&gaussians, &case.camera, BACKGROUND)
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

#[test]
fn values_match_the_f64_form() {
    for seed in 0..3 {
        let case = case(seed);
        let (engine, _) = engine(&case);
        let reference = reference_of(&case, &flat(&case.parameters.gaussians));
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
        let values = reference_of(&case, flat);
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
    // All values above the target: the gradient asks for darker ones, which black cannot become.
    case.functional.fill(1.0);
    assert!(gradient(&case).iter().all(|&d| d == 0.0));
    case.functional.fill(-1.0);
    assert!(gradient(&case).iter().any(|&d| d < 0.0));
}
