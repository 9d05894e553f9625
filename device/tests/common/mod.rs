//! A scene for tests: Gaussians around the origin, seen from nearby, and images that they do not make yet.

use glam::DVec3;
use heliosplat::gaussians::{FEATURES, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};
use heliosplat::model::radiance::{Radiance, RadianceOptions};
use heliosplat::model::{Parameters, SceneModel, View};
use heliosplat::render::{PassOptions, render};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_device::Adapter;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// The first device of this machine; `None`, said aloud, where it has none and `HELIOSPLAT_REQUIRE_DEVICE` is not set.
pub(crate) fn adapter() -> Option<Adapter> {
    let found = Adapter::all().into_iter().next();
    assert!(
        found.is_some() || std::env::var_os("HELIOSPLAT_REQUIRE_DEVICE").is_none(),
        "HELIOSPLAT_REQUIRE_DEVICE is set, and no device is here: install mesa-vulkan-drivers"
    );
    if found.is_none() {
        eprintln!("NOT TESTED: this machine has no Vulkan device; install mesa-vulkan-drivers");
    }
    found
}

/// The model, with coverage as a fourth band.
pub(crate) fn model() -> Radiance {
    Radiance::new(RadianceOptions {
        degree: 3,
        background: [0.9, 0.2, 0.5],
        coverage: true,
    })
}

/// Random Gaussians of the model; some colours are below black.
pub(crate) fn parameters(count: usize, seed: u64) -> Parameters {
    let mut random = Pcg32::seed_from_u64(seed);
    let mut uniform = |lo: f32, hi: f32| lo + (hi - lo) * random.random::<f32>();
    let mut groups = core_groups();
    groups.extend(model().feature_groups());
    let mut gaussians = Table::zeros(groups, count);
    for i in 0..count {
        for k in 0..3 {
            gaussians.group_mut(POSITION)[i * 3 + k] = uniform(-1.0, 1.0);
            gaussians.group_mut(LOG_SCALE)[i * 3 + k] = uniform(-3.6, -1.6);
        }
        for k in 0..4 {
            gaussians.group_mut(ROTATION)[i * 4 + k] = uniform(-1.0, 1.0);
        }
        gaussians.group_mut(OPACITY)[i] = uniform(-2.0, 4.0);
    }
    for degree in 0..4 {
        let reach = [2.0, 0.4, 0.2, 0.1][degree];
        let values = gaussians.group_mut(FEATURES + degree).iter_mut();
        values.for_each(|value| *value = uniform(-reach, reach));
    }
    Parameters {
        gaussians,
        globals: Table::zeros(Vec::new(), 1),
    }
}

/// A camera that looks at the origin from an angle around it.
pub(crate) fn camera(angle: f64, (width, height): (usize, usize)) -> ProjectiveCamera {
    let eye = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.5);
    let axis = -eye.normalize();
    let right = axis.cross(DVec3::Z).normalize();
    let (down, w) = (axis.cross(right), axis / eye.length());
    let focal = 1.3 * width as f64 / eye.length();
    let (col, row) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
    let (u, v) = (right * focal + w * col, down * focal + w * row);
    let (u, v) = ([u.x, u.y, u.z, col], [v.x, v.y, v.z, row]);
    ProjectiveCamera::new(u, v, w.into(), (width, height), axis)
}

/// Images of the Gaussians of `parameters` from around, of different sizes; some values and weights are missing.
pub(crate) fn views(parameters: &Parameters, count: usize) -> Vec<View> {
    let view = |n: usize| {
        let camera = camera(n as f64 * 0.9, (97 + 3 * n, 70 + 5 * n));
        let mut image: Raster = render(&model(), parameters, &camera, None, None, PassOptions::default()).image;
        let mut weight = vec![1.0; image.plane_len()];
        weight[40..60].fill(0.0);
        weight[300..320].fill(0.5);
        image.values[500] = f32::NAN;
        View {
            name: format!("view {n}"),
            camera,
            image: image.into(),
            light: None,
            appearance: n,
            weight,
            visibility_prior: None,
            ceiling: vec![0.8, f32::INFINITY, f32::INFINITY, f32::INFINITY],
        }
    };
    (0..count).map(view).collect()
}

/// Distance of two lists as a share of the second's length.
pub(crate) fn apart(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let pairs = found.iter().zip(expected);
    let square = |x: f32| f64::from(x) * f64::from(x);
    let difference: f64 = pairs.map(|(a, b)| square(a - b)).sum();
    let norm: f64 = expected.iter().map(|&b| square(b)).sum();
    (difference / norm.max(1e-30)).sqrt()
}
