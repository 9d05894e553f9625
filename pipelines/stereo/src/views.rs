//! The input of the plane sweep: images with their cameras.

use glam::{Vec2, Vec3};
use heliosplat::{ProjectiveCamera, Raster};

/// Rays flatter than this (the vertical part of their unit direction) count as this steep, so that parallax stays
/// finite.
const FLATTEST_RAY: f32 = 1e-3;

/// Displacement over the ground of the pixel of `camera` that sees `centre`, per metre of altitude: east, north.
pub(super) fn parallax(camera: &ProjectiveCamera, centre: Vec3) -> Vec2 {
    let (col, row, _) = camera.project(centre);
    let ray = camera.ray_direction(col, row);
    ray.truncate()
        / if ray.z.abs() > FLATTEST_RAY {
            ray.z
        } else {
            -FLATTEST_RAY
        }
}

/// Viewing geometry and light of a view, without its pixels.
#[derive(Debug, Clone, Copy)]
pub struct ViewGeometry {
    /// Projects ground points (metres) into the image (pixels).
    pub camera: ProjectiveCamera,
    /// Equal for views of one date: same shadows, same season.
    pub date_group: u32,
    /// Unit vector toward the sun, east-north-up; `None` where it is unknown.
    pub sun: Option<Vec3>,
}

impl ViewGeometry {
    /// Ground distance between pixels at `centre`, metres.
    pub(super) fn ground_sampling_m(&self, centre: Vec3) -> f32 {
        let (col, row, denominator) = self.camera.project(centre);
        let (u, v) = self.camera.jacobian(col, row, denominator);
        let det = (u.x * v.y - u.y * v.x).abs();
        if det > 0.0 { det.sqrt().recip() } else { f32::INFINITY }
    }

    /// Unit vector from `centre` (metres) toward the camera, in the frame of the camera.
    pub fn toward(&self, centre: Vec3) -> Vec3 {
        let (col, row, _) = self.camera.project(centre);
        -self.camera.ray_direction(col, row)
    }
}

/// One image with its camera, in the frame of the request.
#[derive(Debug, Clone, Copy)]
pub struct SweepView<'a> {
    /// Projects ground points (metres) into the image (pixels).
    pub camera: ProjectiveCamera,
    /// Linear values, any number of bands, NaN where missing; their mean is compared.
    pub image: &'a Raster,
    /// Index of the same size, one band, that separates surfaces of equal brightness, such as a vegetation index.
    /// [`plane_sweep`](super::plane_sweep()) compares it where its parameters include it.
    pub index: Option<&'a Raster>,
    /// Equal for views of one date: same shadows, same season.
    pub date_group: u32,
    /// Unit vector toward the sun, east-north-up; `None` where it is unknown.
    pub sun: Option<Vec3>,
}

impl SweepView<'_> {
    /// Viewing geometry and light of the view.
    pub fn geometry(&self) -> ViewGeometry {
        ViewGeometry {
            camera: self.camera,
            date_group: self.date_group,
            sun: self.sun,
        }
    }
}
