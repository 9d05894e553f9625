//! Common parts of the tests of models of objects: a camera nearby, Gaussians around the origin, the engine's image of
//! them with its gradients, and the image of the f64 reference.

use crate::reference::{self, Gaussian, Pixel};
use glam::{DVec3, Vec3};
use heliosplat::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, Table};
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::{Lit, Pass, PassOptions};
use heliosplat::{ProjectiveCamera, Raster};
use nalgebra::Vector3;

/// Side of the image, pixels.
pub const SIZE: usize = 20;
/// Bands of the image: three colours and coverage.
pub const BANDS: usize = 4;

/// Values of all groups of a table, in f64.
pub type Flat = Vec<Vec<f64>>;

/// Copies the values of a table to f64.
pub fn flat(table: &Table) -> Flat {
    let wide = |values: &Vec<f32>| values.iter().map(|&v| f64::from(v)).collect();
    table.groups.iter().map(|g| wide(&g.values)).collect()
}

/// Fills a table with random positions, sizes, rotations and opacities that fit into the image; `uniform` draws a
/// number between two bounds.
pub fn scatter(gaussians: &mut Table, uniform: &mut dyn FnMut(f32, f32) -> f32) {
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
}

/// A pinhole camera that looks at the origin from nearby, and its position.
pub fn camera() -> (ProjectiveCamera, Vector3<f64>) {
    let eye = DVec3::new(2.5, -1.5, 2.0);
    let axis = -eye.normalize();
    let right = axis.cross(DVec3::Z).normalize();
    let (down, w) = (axis.cross(right), axis / eye.length());
    let (focal, centre) = (26.0 / eye.length(), (SIZE as f64 - 1.0) / 2.0);
    let (u, v) = (right * focal + w * centre, down * focal + w * centre);
    let (u, v) = ([u.x, u.y, u.z, centre], [v.x, v.y, v.z, centre]);
    let camera = ProjectiveCamera::new(u, v, w.into(), (SIZE, SIZE), axis);
    (camera, Vector3::new(eye.x, eye.y, eye.z))
}

/// Gaussians of the reference from a flat table, without colours.
pub fn reference_gaussians(flat: &Flat) -> Vec<Gaussian> {
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

/// Pixels of the reference; the albedos of the Gaussians are the values that it composites.
pub fn reference_pixels(gaussians: &[Gaussian], camera: &ProjectiveCamera) -> Vec<Pixel> {
    let vec = |x: Vec3| Vector3::new(f64::from(x.x), f64::from(x.y), f64::from(x.z));
    let four = |x: Vec3, c: f32| [f64::from(x.x), f64::from(x.y), f64::from(x.z), f64::from(c)];
    let camera = reference::Camera {
        u: four(camera.u, camera.u0),
        v: four(camera.v, camera.v0),
        w: vec(camera.w),
        axis: vec(camera.depth_axis),
        width: SIZE,
        height: SIZE,
    };
    let options = PassOptions::default().projection;
    let lit = vec![1.0; gaussians.len()];
    reference::render(
        gaussians,
        &camera,
        &lit,
        f64::from(options.filter_px2),
        options.antialias,
    )
}

/// Image by the reference, pixel after pixel: red, green, blue, coverage. The albedos of the Gaussians are their
/// colours.
pub fn reference_values(gaussians: &[Gaussian], camera: &ProjectiveCamera, background: [f32; 3]) -> Vec<f64> {
    let pixels = reference_pixels(gaussians, camera);
    let values = pixels.iter().flat_map(|p| {
        let behind = |k: usize| p.albedo[k] + (1.0 - p.alpha) * f64::from(background[k]);
        [behind(0), behind(1), behind(2), p.alpha]
    });
    values.collect()
}

/// Image by the engine, pixel after pixel (red, green, blue, coverage), and the gradients of its weighted sum.
/// `functional` has a weight for every value of the image.
pub fn engine_values(
    model: &dyn SceneModel,
    context: Context,
    light: Lit,
    functional: &[f64],
) -> (Vec<f64>, Parameters) {
    let pass = Pass::new(model, context, light, PassOptions::default());
    let image = pass.image();
    let plane = SIZE * SIZE;
    let mut d_image = Raster::filled(SIZE, SIZE, BANDS, 0.0);
    let mut values = Vec::new();
    for i in 0..plane {
        for k in 0..BANDS {
            values.push(f64::from(image.values[k * plane + i]));
            d_image.values[k * plane + i] = functional[i * BANDS + k] as f32;
        }
    }
    let (mut d_maps, mut grads) = (pass.zero_gradients(), context.parameters.zeros_like());
    model.compose_backward(&context, &pass.maps, &d_image, &mut d_maps, &mut grads);
    pass.backward(d_maps, &mut grads);
    (values, grads)
}

/// Outputs of a network of two hidden layers of `width` units with leaky rectifiers; the second layer gets the inputs
/// too. `weights` has for each layer its weights `[input][output]`, then its biases.
pub fn network(weights: &[f64], inputs: &[f64], width: usize, outputs: usize) -> Vec<f64> {
    let mut from = 0;
    let mut layer = |into: &[f64], outputs: usize| -> Vec<f64> {
        let (start, bias) = (from, from + into.len() * outputs);
        from = bias + outputs;
        let weighed = |o: usize| {
            into.iter()
                .enumerate()
                .map(move |(i, x)| x * weights[start + i * outputs + o])
        };
        (0..outputs)
            .map(|o| weights[bias + o] + weighed(o).sum::<f64>())
            .collect()
    };
    let rectified = |v: Vec<f64>| -> Vec<f64> { v.into_iter().map(|x| if x > 0.0 { x } else { 0.01 * x }).collect() };
    let mut joined = rectified(layer(inputs, width));
    joined.extend(inputs);
    let last = rectified(layer(&joined, width));
    layer(&last, outputs)
}
