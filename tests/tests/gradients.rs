//! The engine against the slow f64 reference: values to 1e-4, gradients to 1e-3 of central differences of the
//! reference, per parameter group. The scenes keep away from exact ties in depth, where the order of two splats flips.

use glam::{DVec3, Vec3};
use heliosplat::gaussians::{FEATURES, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};
use heliosplat::light::Light;
use heliosplat::model::shadow_gs::{COLOUR, OFFSET, SKY, ShadowGs, ShadowGsOptions, softplus};
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::{Lit, Pass, PassOptions};
use heliosplat::splat::{Depths, ProjectionOptions};
use heliosplat::trace::Occluders;
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_tests::harmonics::harmonics;
use heliosplat_tests::reference::{self, Gaussian};
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

const BANDS: usize = 3;
const SIZE: usize = 20;

struct Case {
    parameters: Parameters,
    model: ShadowGs,
    camera: ProjectiveCamera,
    reference_camera: reference::Camera,
    sun: Vec3,
    options: PassOptions,
    /// Random weights of the maps' values in the loss.
    functional: Vec<f64>,
}

fn model(near_light: bool, degree: usize) -> ShadowGs {
    ShadowGs::new(ShadowGsOptions {
        near_light,
        degree,
        bands: BANDS,
        images: 2,
        ..ShadowGsOptions::default()
    })
}

fn cameras(perspective: bool) -> (ProjectiveCamera, reference::Camera) {
    let axis = DVec3::new(0.25, -0.15, -0.95).normalize();
    let right = axis.cross(DVec3::Y).normalize();
    let down = axis.cross(right).normalize();
    let (scale, distance) = if perspective { (1.6, 25.0) } else { (1.6, 600e3) };
    let w = axis / distance;
    let centre = (SIZE as f64 - 1.0) / 2.0;
    let (u, v) = (right * scale + w * centre, down * scale + w * centre);
    let (u, v) = ([u.x, u.y, u.z, centre], [v.x, v.y, v.z, centre]);
    let camera = ProjectiveCamera::new(u, v, [w.x, w.y, w.z], (SIZE, SIZE), axis);
    // The reference takes the engine's own rounded coefficients, so that only arithmetic differs.
    let vec = |x: Vec3| Vector3::new(f64::from(x.x), f64::from(x.y), f64::from(x.z));
    let four = |x: Vec3, c: f32| [f64::from(x.x), f64::from(x.y), f64::from(x.z), f64::from(c)];
    let reference_camera = reference::Camera {
        u: four(camera.u, camera.u0),
        v: four(camera.v, camera.v0),
        w: vec(camera.w),
        axis: vec(camera.depth_axis),
        width: SIZE,
        height: SIZE,
    };
    (camera, reference_camera)
}

fn case(seed: u64, count: usize, perspective: bool, antialias: bool) -> Case {
    case_of(model(false, 0), seed, count, perspective, antialias)
}

fn case_of(model: ShadowGs, seed: u64, count: usize, perspective: bool, antialias: bool) -> Case {
    let mut random = Pcg32::seed_from_u64(seed);
    let mut uniform = |lo: f32, hi: f32| lo + (hi - lo) * random.random::<f32>();
    let mut groups = core_groups();
    groups.extend(model.feature_groups());
    let mut gaussians = Table::zeros(groups, count);
    for i in 0..count {
        for k in 0..3 {
            gaussians.group_mut(POSITION)[i * 3 + k] = uniform(-5.0, 5.0);
            gaussians.group_mut(LOG_SCALE)[i * 3 + k] = uniform(-1.2, 0.6);
            gaussians.group_mut(FEATURES)[i * 3 + k] = uniform(0.1, 0.9);
        }
        for k in 0..4 {
            gaussians.group_mut(ROTATION)[i * 4 + k] = uniform(-1.0, 1.0);
        }
        gaussians.group_mut(OPACITY)[i] = uniform(-2.0, 2.0);
    }
    for group in &mut gaussians.groups[FEATURES + 1..] {
        group.values.iter_mut().for_each(|v| *v = uniform(0.0, 0.4));
    }
    let mut globals = model.initial_globals(0.3);
    for k in 0..globals.group(COLOUR).len() {
        globals.group_mut(COLOUR)[k] += uniform(-0.2, 0.2);
    }
    for k in 0..globals.group(OFFSET).len() {
        globals.group_mut(OFFSET)[k] += uniform(-0.1, 0.1);
    }
    let (camera, reference_camera) = cameras(perspective);
    let mut functional: Vec<f64> = (0..SIZE * SIZE * (BANDS + 6))
        .map(|_| f64::from(uniform(-1.0, 1.0)))
        .collect();
    // No loss uses squared depths: their values are compared, and they have no gradients.
    functional
        .iter_mut()
        .skip(BANDS + 2)
        .step_by(BANDS + 6)
        .for_each(|f| *f = 0.0);
    let projection = ProjectionOptions {
        antialias,
        ..ProjectionOptions::default()
    };
    let options = PassOptions {
        projection,
        normals: true,
        depths: Depths::Median,
        ..PassOptions::default()
    };
    let sun = Vec3::new(0.5, 0.3, 0.7).normalize();
    Case {
        parameters: Parameters { gaussians, globals },
        model,
        camera,
        reference_camera,
        sun,
        options,
        functional,
    }
}

/// The parameters in f64, in the table's own layout.
#[derive(Clone)]
struct Flat {
    gaussians: Vec<Vec<f64>>,
    globals: Vec<Vec<f64>>,
}

fn flat(parameters: &Parameters) -> Flat {
    let wide = |t: &Table| {
        t.groups
            .iter()
            .map(|g| g.values.iter().map(|&v| f64::from(v)).collect())
            .collect()
    };
    Flat {
        gaussians: wide(&parameters.gaussians),
        globals: wide(&parameters.globals),
    }
}

/// Common point of all rays of a camera: there both numerators and the denominator of its projection vanish.
fn eye(camera: &reference::Camera) -> Vector3<f64> {
    let ([a, b, c, u], [d, e, f, v], w) = (camera.u, camera.v, camera.w);
    Matrix3::new(a, b, c, d, e, f, w.x, w.y, w.z)
        .lu()
        .solve(&Vector3::new(-u, -v, -1.0))
        .expect("a camera with an eye")
}

/// Albedo and, behind it, near-surface light of Gaussian `i` as the case's camera sees them.
fn colours(case: &Case, g: &[Vec<f64>], i: usize) -> Vec<f64> {
    let options = &case.model.options;
    let parts = if options.near_light { 2 } else { 1 };
    let position = Vector3::from_row_slice(&g[POSITION][i * 3..i * 3 + 3]);
    let sight = (position - eye(&case.reference_camera)).normalize();
    let functions = harmonics(options.degree, &sight);
    let down = harmonics(options.degree, &-Vector3::z());
    let mut all = Vec::new();
    for part in 0..parts {
        for k in 0..BANDS {
            let mut value = g[FEATURES + part][i * BANDS + k];
            for f in 1..functions.len() {
                let degree = f.isqrt();
                let group = FEATURES + parts + part * options.degree + degree - 1;
                let place = (i * (2 * degree + 1) + f - degree * degree) * BANDS + k;
                value += g[group][place] * (functions[f] - down[f]);
            }
            all.push(value);
        }
    }
    all
}

fn reference_gaussians(case: &Case, flat: &Flat) -> Vec<Gaussian> {
    let g = &flat.gaussians;
    (0..g[OPACITY].len())
        .map(|i| Gaussian {
            position: Vector3::from_row_slice(&g[POSITION][i * 3..i * 3 + 3]),
            log_scale: Vector3::from_row_slice(&g[LOG_SCALE][i * 3..i * 3 + 3]),
            rotation: [0, 1, 2, 3].map(|k| g[ROTATION][i * 4 + k]),
            opacity: g[OPACITY][i],
            albedo: colours(case, g, i),
        })
        .collect()
}

/// All values of a view in the order of the functional: per pixel the image, then alpha, depth, depth², normal.
fn reference_values(case: &Case, flat: &Flat) -> Vec<f64> {
    let gaussians = reference_gaussians(case, flat);
    let sun = Vector3::new(f64::from(case.sun.x), f64::from(case.sun.y), f64::from(case.sun.z));
    let visibility: Vec<f64> = (0..gaussians.len())
        .map(|i| reference::transmittance(&gaussians, i, &sun))
        .collect();
    let filter = f64::from(case.options.projection.filter_px2);
    let pixels = reference::render(
        &gaussians,
        &case.reference_camera,
        &visibility,
        filter,
        case.options.projection.antialias,
    );
    let softplus = |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p();
    let sky: Vec<f64> = flat.globals[SKY][BANDS..].iter().map(|&x| softplus(x)).collect();
    let (matrix, offset) = (&flat.globals[COLOUR][BANDS * BANDS..], &flat.globals[OFFSET][BANDS..]);
    pixels
        .iter()
        .flat_map(|p| {
            let mut values = reference::compose(p, &sky, matrix, offset);
            values.extend([p.alpha, p.depth, p.depth_square, p.normal.x, p.normal.y, p.normal.z]);
            values
        })
        .collect()
}

fn engine_pass(case: &Case) -> (Vec<f64>, Parameters) {
    let occluders = Occluders::new(&case.parameters.gaussians);
    let context = Context {
        parameters: &case.parameters,
        camera: &case.camera,
        light: Some(Light::Directional(case.sun)),
        appearance: Some(1),
    };
    let pass = Pass::new(&case.model, context, Lit::Traced(&occluders), case.options);
    let image = pass.image();
    let (maps, n) = (&pass.maps, pass.normal_channel());
    let pixels = SIZE * SIZE;
    let mut values = Vec::new();
    let mut d_image = Raster::filled(SIZE, SIZE, BANDS, 0.0);
    let mut d_maps = pass.zero_gradients();
    for i in 0..pixels {
        let f = &case.functional[i * (BANDS + 6)..(i + 1) * (BANDS + 6)];
        for k in 0..BANDS {
            values.push(f64::from(image.values[k * pixels + i]));
            d_image.values[k * pixels + i] = f[k] as f32;
        }
        values.extend([maps.alpha[i], maps.depth[i], maps.depth_square[i]].map(f64::from));
        d_maps.alpha[i] = f[BANDS] as f32;
        d_maps.depth[i] = f[BANDS + 1] as f32;
        for k in 0..3 {
            values.push(f64::from(maps.channels[n + k][i]));
            d_maps.channels[n + k][i] = f[BANDS + 3 + k] as f32;
        }
    }
    let mut grads = case.parameters.zeros_like();
    case.model
        .compose_backward(&context, maps, &d_image, &mut d_maps, &mut grads);
    pass.backward(d_maps, &mut grads);
    (values, grads)
}

fn check_values(case: &Case) {
    let (engine, _) = engine_pass(case);
    let reference = reference_values(case, &flat(&case.parameters));
    let norm = reference.iter().map(|v| v * v).sum::<f64>().sqrt();
    let error = engine
        .iter()
        .zip(&reference)
        .map(|(a, b)| (a - b).powi(2))
        .sum::<f64>()
        .sqrt();
    assert!(error < 1e-4 * norm, "relative error {}", error / norm);
}

fn check_gradients(case: &Case) {
    let (_, grads) = engine_pass(case);
    let base = flat(&case.parameters);
    let loss = |flat: &Flat| -> f64 {
        reference_values(case, flat)
            .iter()
            .zip(&case.functional)
            .map(|(v, f)| v * f)
            .sum()
    };
    let step = 1e-6;
    let compare = |name: &str, table: &Table, pick: &dyn Fn(&mut Flat) -> &mut Vec<Vec<f64>>| {
        for (group, values) in table.groups.iter().enumerate() {
            let (mut difference, mut norm) = (0.0f64, 0.0f64);
            for (i, &analytic) in values.values.iter().enumerate() {
                let (mut hi, mut lo) = (base.clone(), base.clone());
                pick(&mut hi)[group][i] += step;
                pick(&mut lo)[group][i] -= step;
                let numeric = (loss(&hi) - loss(&lo)) / (2.0 * step);
                difference += (numeric - f64::from(analytic)).powi(2);
                norm += numeric.powi(2);
            }
            let relative = (difference / norm.max(1e-30)).sqrt();
            println!("{name} {}: {relative:.2e}", values.spec.name);
            assert!(
                relative < 1e-3,
                "{name} group {}: relative error {relative}",
                values.spec.name
            );
        }
    };
    compare("gaussians", &grads.gaussians, &|f| &mut f.gaussians);
    compare("globals", &grads.globals, &|f| &mut f.globals);
}

#[test]
fn the_forward_pass_matches_the_f64_reference() {
    for seed in 0..4 {
        for (perspective, antialias) in [(false, false), (false, true), (true, false), (true, true)] {
            check_values(&case(seed, 60, perspective, antialias));
            check_values(&case_of(model(true, 0), seed, 60, perspective, antialias));
            check_values(&case_of(model(true, 3), seed, 60, perspective, antialias));
        }
    }
}

#[test]
fn gradients_match_central_differences_from_a_satellite() {
    check_gradients(&case(11, 24, false, false));
}

#[test]
fn gradients_match_central_differences_from_nearby() {
    check_gradients(&case(12, 24, true, true));
}

#[test]
fn gradients_match_central_differences_with_near_surface_light() {
    check_gradients(&case_of(model(true, 0), 13, 24, false, true));
}

/// Those to positions too: the engine leaves out the change of the viewing direction with a Gaussian's position, which
/// is too small to show.
#[test]
fn gradients_match_central_differences_with_colours_that_change_with_the_view() {
    check_gradients(&case_of(model(false, 2), 14, 20, false, false));
    check_gradients(&case_of(model(true, 3), 15, 12, false, true));
}

#[test]
fn harmonics_of_zero_change_no_number() {
    let plain = case(6, 60, false, false);
    let mut with = case_of(model(false, 3), 6, 60, false, false);
    with.functional.clone_from(&plain.functional);
    with.parameters.globals.clone_from(&plain.parameters.globals);
    for group in &mut with.parameters.gaussians.groups[FEATURES + 1..] {
        group.values.fill(0.0);
    }
    let ((values, grads), (with_values, with_grads)) = (engine_pass(&plain), engine_pass(&with));
    assert!(values == with_values && grads.globals == with_grads.globals);
    assert!(grads.gaussians.groups[..] == with_grads.gaussians.groups[..=FEATURES]);
    assert!(
        with_grads.gaussians.groups[FEATURES + 1..]
            .iter()
            .all(|g| g.values.iter().any(|&d| d != 0.0))
    );
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let case = case(5, 300, true, false);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool of threads");
        pool.install(|| engine_pass(&case))
    };
    let (one, two, five) = (run(1), run(2), run(5));
    assert!(one.0 == two.0 && one.1 == two.1 && one.0 == five.0 && one.1 == five.1);
}

#[test]
fn the_engines_softplus_is_the_references() {
    for x in [-30.0f32, -1.0, 0.0, 2.0, 40.0] {
        let exact = f64::from(x).max(0.0) + (-f64::from(x).abs()).exp().ln_1p();
        assert!((f64::from(softplus(x)) - exact).abs() <= 1e-6 * exact.max(1e-6));
    }
}
