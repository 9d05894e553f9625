//! Drawing worlds: Gaussians, cameras and suns, ordinary ones and the extremes that are legal.

use glam::{DVec3, Vec3};
use heliosplat::ProjectiveCamera;
use heliosplat::gaussians::{FEATURES, GroupSpec, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};
use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
use heliosplat::model::{Parameters, SceneModel};
use heliosplat_tests::reference::{self, Gaussian};
use nalgebra::Vector3;
use proptest::collection::vec;
use proptest::prelude::*;

/// A Gaussian in the form in which it is drawn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drawn {
    position: [f32; 3],
    log_scale: [f32; 3],
    rotation: [f32; 4],
    opacity: f32,
    albedo: f32,
}

/// Natural logarithm of a million: sizes from a micrometre to a thousand kilometres.
const SIX_DECADES: f32 = 13.815_51;

fn rotation() -> impl Strategy<Value = [f32; 4]> {
    prop_oneof![
        8 => prop::array::uniform4(-1.0f32..1.0),
        1 => Just([0.0, 0.0, 0.0, 1.0]),
        1 => Just([0.0; 4]),
        1 => (prop::array::uniform4(-1.0f32..1.0), prop_oneof![Just(1e-9f32), Just(1e15)])
            .prop_map(|(q, length)| q.map(|c| c * length)),
    ]
}

/// Discs, needles and balls of a tenth of a metre to some metres, none of them coincident or far.
fn ordinary() -> impl Strategy<Value = Drawn> {
    let rotation =
        prop::array::uniform4(-1.0f32..1.0).prop_filter("a direction", |q| q.iter().map(|c| c * c).sum::<f32>() > 0.1);
    let parts = (
        prop::array::uniform3(-8.0f32..8.0),
        prop::array::uniform3(-2.5f32..0.8),
        rotation,
        -6.0f32..9.0,
        0.0f32..1.0,
    );
    parts.prop_map(|(position, log_scale, rotation, opacity, albedo)| Drawn {
        position,
        log_scale,
        rotation,
        opacity,
        albedo,
    })
}

fn log_scale() -> impl Strategy<Value = [f32; 3]> {
    let any = || -SIX_DECADES..SIX_DECADES;
    prop_oneof![
        3 => prop::array::uniform3(any()),
        // Needles and pancakes: two sizes, one of them along one axis.
        3 => (any(), any(), 0..3usize).prop_map(|(a, b, k)| std::array::from_fn(|i| if i == k { a } else { b })),
        3 => prop::array::uniform3(-2.5f32..0.8),
        1 => Just([-SIX_DECADES; 3]),
        1 => Just([SIX_DECADES; 3]),
    ]
}

fn extreme() -> impl Strategy<Value = Drawn> {
    let position = prop_oneof![
        5 => prop::array::uniform3(-8.0f32..8.0),
        2 => Just([0.0; 3]),
        1 => Just([3.0, -2.0, 1.0]),
        1 => prop::array::uniform3(-5000.0f32..5000.0),
    ];
    let opacity =
        prop_oneof![5 => -6.0f32..9.0, 1 => Just(12.0f32), 1 => Just(-12.0), 1 => Just(90.0), 1 => Just(-90.0)];
    let albedo = prop_oneof![4 => 0.0f32..1.0, 1 => Just(0.0f32), 1 => Just(1.0)];
    (position, log_scale(), rotation(), opacity, albedo).prop_map(|(position, log_scale, rotation, opacity, albedo)| {
        Drawn {
            position,
            log_scale,
            rotation,
            opacity,
            albedo,
        }
    })
}

/// Up to `most` ordinary Gaussians.
pub(crate) fn ordinary_gaussians(most: usize) -> impl Strategy<Value = Vec<Drawn>> {
    vec(ordinary(), 0..=most)
}

/// Up to `most` Gaussians, extreme ones and ordinary ones.
pub(crate) fn extreme_gaussians(most: usize) -> impl Strategy<Value = Vec<Drawn>> {
    vec(prop_oneof![2 => extreme(), 1 => ordinary()], 0..=most)
}

/// Unit vector toward a sun half a degree to ninety degrees high.
pub(crate) fn sun() -> impl Strategy<Value = Vec3> {
    let elevation = prop_oneof![3 => 0.5f32..90.0, 1 => 0.5f32..5.0, 1 => Just(90.0f32), 1 => Just(0.5)];
    (
        elevation,
        prop_oneof![3 => 0.0f32..360.0, 1 => Just(0.0f32), 1 => Just(90.0)],
    )
        .prop_map(|(e, a)| direction(e, a))
}

/// Toward an elevation and an azimuth from north, degrees.
pub(crate) fn direction(elevation_deg: f32, azimuth_deg: f32) -> Vec3 {
    let ((se, ce), (sa, ca)) = (elevation_deg.to_radians().sin_cos(), azimuth_deg.to_radians().sin_cos());
    Vec3::new(ce * sa, ce * ca, se).normalize()
}

/// A camera in the form in which it is drawn.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Looks {
    off_nadir_deg: f64,
    azimuth_deg: f64,
    gsd_m: f64,
    distance_m: f64,
    size: (usize, usize),
}

/// A camera up to sixty degrees off nadir, from orbit or nearby.
pub(crate) fn looks(size: impl Strategy<Value = (usize, usize)>) -> impl Strategy<Value = Looks> {
    let off_nadir = prop_oneof![3 => 0.0f64..60.0, 1 => Just(0.0f64), 1 => Just(60.0)];
    let distance = prop_oneof![2 => Just(600e3f64), 1 => Just(40.0)];
    (off_nadir, 0.0f64..360.0, 0.3f64..2.0, distance, size).prop_map(
        |(off_nadir_deg, azimuth_deg, gsd_m, distance_m, size)| Looks {
            off_nadir_deg,
            azimuth_deg,
            gsd_m,
            distance_m,
            size,
        },
    )
}

/// Images of one pixel to some tiles.
pub(crate) fn small_image() -> impl Strategy<Value = (usize, usize)> {
    prop_oneof![6 => (1..40usize, 1..40usize), 1 => Just((1, 1)), 1 => Just((64, 1)), 1 => Just((1, 64))]
}

impl Looks {
    pub(crate) fn with_size(self, size: (usize, usize)) -> Self {
        Self { size, ..self }
    }

    pub(crate) fn is_in_orbit(&self) -> bool {
        self.distance_m > 1e5
    }

    pub(crate) fn camera(&self) -> ProjectiveCamera {
        let ((st, ct), (sp, cp)) = (
            self.off_nadir_deg.to_radians().sin_cos(),
            self.azimuth_deg.to_radians().sin_cos(),
        );
        let axis = DVec3::new(st * sp, st * cp, -ct);
        let right = axis.cross(DVec3::Y).normalize();
        let down = axis.cross(right).normalize();
        let w = axis / self.distance_m;
        let (col, row) = ((self.size.0 as f64 - 1.0) / 2.0, (self.size.1 as f64 - 1.0) / 2.0);
        let (u, v) = (right / self.gsd_m + w * col, down / self.gsd_m + w * row);
        ProjectiveCamera::new(
            [u.x, u.y, u.z, col],
            [v.x, v.y, v.z, row],
            w.to_array(),
            self.size,
            axis,
        )
    }
}

/// The camera in f64, with the engine's own rounded coefficients: only arithmetic differs.
pub(crate) fn reference_camera(camera: &ProjectiveCamera) -> reference::Camera {
    let four = |x: Vec3, c: f32| [x.x, x.y, x.z, c].map(f64::from);
    reference::Camera {
        u: four(camera.u, camera.u0),
        v: four(camera.v, camera.v0),
        w: wide(camera.w),
        axis: wide(camera.depth_axis),
        width: camera.width,
        height: camera.height,
    }
}

/// A vector in f64.
pub(crate) fn wide(v: Vec3) -> Vector3<f64> {
    Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

/// A model of one band and two images.
pub(crate) fn model() -> ShadowGs {
    ShadowGs::new(ShadowGsOptions {
        bands: 1,
        images: 2,
        ..ShadowGsOptions::default()
    })
}

/// These Gaussians, with the groups of a model's own still zero.
pub(crate) fn gaussians(features: Vec<GroupSpec>, drawn: &[Drawn]) -> Table {
    let mut groups = core_groups();
    groups.extend(features);
    let mut gaussians = Table::zeros(groups, drawn.len());
    for (i, d) in drawn.iter().enumerate() {
        gaussians.group_mut(POSITION)[i * 3..i * 3 + 3].copy_from_slice(&d.position);
        gaussians.group_mut(LOG_SCALE)[i * 3..i * 3 + 3].copy_from_slice(&d.log_scale);
        gaussians.group_mut(ROTATION)[i * 4..i * 4 + 4].copy_from_slice(&d.rotation);
        gaussians.group_mut(OPACITY)[i] = d.opacity;
    }
    gaussians
}

/// The parameters of a model with these Gaussians.
pub(crate) fn parameters(model: &ShadowGs, drawn: &[Drawn]) -> Parameters {
    let mut gaussians = gaussians(model.feature_groups(), drawn);
    for (albedo, d) in gaussians.group_mut(FEATURES).iter_mut().zip(drawn) {
        *albedo = d.albedo;
    }
    Parameters {
        gaussians,
        globals: model.initial_globals(0.3),
    }
}

/// The same Gaussians for the reference.
pub(crate) fn reference_gaussians(drawn: &[Drawn]) -> Vec<Gaussian> {
    let three = |v: [f32; 3]| Vector3::from(v.map(f64::from));
    let gaussian = |d: &Drawn| Gaussian {
        position: three(d.position),
        log_scale: three(d.log_scale),
        rotation: d.rotation.map(f64::from),
        opacity: f64::from(d.opacity),
        albedo: vec![f64::from(d.albedo)],
    };
    drawn.iter().map(gaussian).collect()
}

/// Runs something with one thread and with two.
pub(crate) fn with_one_and_two_threads<T: Send>(run: impl Fn() -> T + Sync) -> (T, T) {
    let pool = |threads| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool of threads")
    };
    (pool(1).install(&run), pool(2).install(&run))
}
