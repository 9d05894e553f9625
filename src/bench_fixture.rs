//! Fixture for benchmarks: a synthetic site of a standard kind, and training steps on it. `heliosplat bench` and the
//! benches measure the engine's speed with it; nothing else uses it.
//!
//! A sheet of flat Gaussians over a town of blocks, spread over a square image seen from near the nadir. Its size in
//! pixels and its number of Gaussians are free; the splats' sizes follow, so that the number of splats per pixel is
//! about constant.

use crate::camera::ProjectiveCamera;
use crate::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};
use crate::light::Light;
use crate::model::shadow_gs::{ALBEDO, ShadowGs, ShadowGsOptions};
use crate::model::{Context, Parameters, SceneModel};
use crate::optim::Adam;
use crate::render::{Lit, Pass, PassOptions};
use crate::splat::{MapGradients, Maps};
use crate::trace::{OccluderGradients, Occluders, SunVisibility, transmittance};
use glam::{DVec3, Quat, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use rayon::prelude::*;

/// Ground sampling distance, metres.
const GSD_M: f32 = 0.5;
/// Side of a block of the town, metres.
const BLOCK_M: f32 = 24.0;
/// Colour bands.
const BANDS: usize = 3;
/// Elevation of the sun, degrees.
const SUN_ELEVATION_DEG: f32 = 35.0;

/// A site with its camera and its sun.
pub struct Site {
    /// The satellite model with three bands and the sun's visibility.
    pub model: ShadowGs,
    /// Parameters of the Gaussians, and the shared ones.
    pub parameters: Parameters,
    /// The camera, 600 km away and 15 degrees off the nadir.
    pub camera: ProjectiveCamera,
    /// The sun, 35 degrees above the horizon.
    pub sun: Light,
}

impl Site {
    /// A site of `count` Gaussians, seen by an image of `size_px × size_px` pixels. `sigma` is a Gaussian's standard
    /// deviation in units of the distance between neighbours; with 0.6, some fifteen splats cover a pixel.
    pub fn new(count: usize, size_px: usize, sigma: f32) -> Self {
        let model = ShadowGs::new(ShadowGsOptions {
            bands: BANDS,
            ..ShadowGsOptions::default()
        });
        let mut groups = core_groups();
        groups.extend(model.feature_groups());
        let mut gaussians = Table::zeros(groups, count);
        let mut random = Pcg32::seed_from_u64(7);
        let side_m = size_px as f32 * GSD_M;
        let spacing = side_m / (count as f32).sqrt();
        // Row by row, the order in which a start on a surface lists them.
        let per_row = (count as f32).sqrt().ceil() as usize;
        for index in 0..count {
            let cell = [(index % per_row) as f32, (index / per_row) as f32];
            let corner = cell.map(|c| c * spacing - 0.5 * side_m);
            place(&mut gaussians, index, corner, spacing, sigma, &mut random);
        }
        let (sin, cos) = SUN_ELEVATION_DEG.to_radians().sin_cos();
        Self {
            parameters: Parameters {
                gaussians,
                globals: model.initial_globals(0.3),
            },
            camera: camera(size_px),
            sun: Light::Directional(Vec3::new(0.6 * cos, -0.8 * cos, sin)),
            model,
        }
    }

    /// The rendering context of the site's own camera and sun.
    pub fn context(&self) -> Context<'_> {
        Context {
            parameters: &self.parameters,
            camera: &self.camera,
            light: Some(self.sun),
            appearance: Some(0),
        }
    }
}

/// Height of the town at a place, metres: blocks of up to 20 m on two cells of five.
fn height_m(x: f32, y: f32) -> f32 {
    let cell = |v: f32| (v / BLOCK_M).floor() as i32 as u32;
    let hash = cell(x)
        .wrapping_mul(0x9e37_79b9)
        .wrapping_add(cell(y).wrapping_mul(0x85eb_ca6b));
    let hash = (hash ^ (hash >> 15)).wrapping_mul(0x2c1b_3c6d);
    if (hash >> 8) % 5 < 2 {
        3.0 + (hash >> 16) as f32 / 65_536.0 * 17.0
    } else {
        0.0
    }
}

fn place(gaussians: &mut Table, index: usize, corner: [f32; 2], cell: f32, sigma: f32, random: &mut Pcg32) {
    let sigma_m = sigma * cell;
    let mut uniform = |low: f32, high: f32| low + (high - low) * random.random::<f32>();
    let (x, y) = (corner[0] + uniform(0.0, cell), corner[1] + uniform(0.0, cell));
    let position = [x, y, height_m(x, y) + uniform(-0.1, 0.1)];
    gaussians.group_mut(POSITION)[index * 3..index * 3 + 3].copy_from_slice(&position);
    let log_scale = [
        (sigma_m * uniform(0.7, 1.3)).ln(),
        (sigma_m * uniform(0.7, 1.3)).ln(),
        (0.2 * sigma_m).ln(),
    ];
    gaussians.group_mut(LOG_SCALE)[index * 3..index * 3 + 3].copy_from_slice(&log_scale);
    let tilt = Quat::from_rotation_z(uniform(0.0, 6.3)) * Quat::from_rotation_x(uniform(-0.2, 0.2));
    gaussians.group_mut(ROTATION)[index * 4..index * 4 + 4].copy_from_slice(&tilt.to_array());
    gaussians.group_mut(OPACITY)[index] = uniform(-1.5, 3.0);
    for band in 0..BANDS {
        gaussians.group_mut(ALBEDO)[index * BANDS + band] = uniform(0.1, 0.9);
    }
}

/// A satellite's camera 600 km away, 15 degrees off the nadir.
fn camera(size_px: usize) -> ProjectiveCamera {
    let axis = DVec3::new(0.2, -0.17, -0.965).normalize();
    let right = DVec3::X;
    let right = (right - axis * right.dot(axis)).normalize();
    let down = axis.cross(right);
    let centre = (size_px as f64 - 1.0) / 2.0;
    let per_metre = 1.0 / f64::from(GSD_M);
    let w = axis / 600e3;
    let (u, v) = (right * per_metre + w * centre, down * per_metre + w * centre);
    ProjectiveCamera::new(
        [u.x, u.y, u.z, centre],
        [v.x, v.y, v.z, centre],
        w.to_array(),
        (size_px, size_px),
        axis,
    )
}

/// A training on the site; each step renders, runs the backward pass and takes an Adam step.
pub struct Descent {
    site: Site,
    gradients: Parameters,
    adam: Adam,
}

impl Descent {
    /// A training of `site` that is ready for its first step.
    pub fn new(site: Site) -> Self {
        Self {
            gradients: site.parameters.zeros_like(),
            adam: Adam::new(&site.parameters.gaussians),
            site,
        }
    }

    /// Runs one step of three colours, visibility, depth and alpha toward a grey image; returns its number of (splat,
    /// pixel) pairs.
    pub fn step(&mut self) -> u64 {
        let gaussians = &self.site.parameters.gaussians;
        self.gradients.gaussians.reset(gaussians.count);
        self.gradients.globals.reset(1);
        let pass = Pass::new(
            &self.site.model,
            self.site.context(),
            Lit::Everywhere,
            PassOptions::default(),
        );
        let d_maps = toward_grey(&pass.maps);
        let pairs = pass.maps.pairs;
        pass.backward(d_maps, &mut self.gradients);
        // Small enough that the site hardly changes over any number of steps.
        let rates = vec![1e-6; self.gradients.gaussians.groups.len()];
        self.adam
            .step(&mut self.site.parameters.gaussians, &self.gradients.gaussians, &rates);
        pairs
    }
}

/// Light from the sun onto every Gaussian of a site, as a training step computes it.
pub struct Lighting<'a> {
    site: &'a Site,
    occluders: Occluders,
    origins: Vec<u32>,
    visibility_gradients: Vec<f32>,
    gradients: Table,
}

impl<'a> Lighting<'a> {
    /// Lighting of `site` that is ready for its first step; `sun_visibility` selects the tracer.
    pub fn new(site: &'a Site, sun_visibility: SunVisibility) -> Self {
        let gaussians = &site.parameters.gaussians;
        Self {
            site,
            occluders: Occluders::tracing_by(sun_visibility, gaussians),
            origins: (0..gaussians.count as u32).collect(),
            visibility_gradients: vec![1.0; gaussians.count],
            gradients: gaussians.zeros_like(),
        }
    }

    /// Rebuilds the occluders, traces a ray from each Gaussian, and computes the gradients of all; returns the number
    /// of rays.
    pub fn step(&mut self) -> usize {
        let gaussians = &self.site.parameters.gaussians;
        self.occluders.renew(gaussians);
        let traced = transmittance(&self.occluders, &self.origins, &self.site.sun);
        let all = (&self.occluders, OccluderGradients::All);
        traced.backward(
            gaussians,
            all,
            &self.origins,
            &self.visibility_gradients,
            &mut self.gradients,
        );
        self.origins.len()
    }
}

/// Gradients of the mean absolute difference to a grey (0.5), opaque image, and a small constant gradient of the depth.
pub fn toward_grey(maps: &Maps) -> MapGradients {
    let unit = 1.0 / maps.alpha.len() as f32;
    let mut grads = MapGradients::zeros(maps.channels.len(), maps.alpha.len());
    for (grads, plane) in grads.channels.iter_mut().zip(&maps.channels) {
        grads
            .par_iter_mut()
            .with_min_len(1 << 14)
            .zip(plane)
            .for_each(|(d, value)| *d = (value - 0.5).signum() * unit);
    }
    grads.alpha.fill(-unit);
    grads.depth.fill(1e-3 * unit);
    grads
}
