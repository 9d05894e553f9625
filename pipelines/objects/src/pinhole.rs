//! Pinhole cameras of captures, and their conversion to cameras of the engine.

use glam::{DMat3, DQuat, DVec3};
use heliosplat::ProjectiveCamera;

/// Farthest that a camera may stand from the origin, in the capture's units.
const FARTHEST: f64 = 1e6;

/// A pinhole camera in the capture's own frame and units; pixel centres at integers.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Pinhole {
    /// Position of the camera.
    pub eye: DVec3,
    /// Unit vector of growing columns, to the right in the image.
    pub right: DVec3,
    /// Unit vector of growing rows, downwards in the image.
    pub down: DVec3,
    /// Unit vector of the optical axis, away from the camera.
    pub forward: DVec3,
    /// Focal lengths along columns and rows, pixels.
    pub focal_px: [f64; 2],
    /// Column and row of the principal point, pixels.
    pub principal_px: [f64; 2],
    /// Numbers of columns and rows.
    pub size_px: [usize; 2],
}

impl Pinhole {
    /// Camera without intrinsics and size, whose axes are the columns of `world_from_camera`: right, up and backward as
    /// in OpenGL. They need not be of unit length, nor quite at right angles. `None` when they span no space or are
    /// mirrored, or when a number is not finite or `eye` is a million units or more from the origin.
    pub fn from_opengl(world_from_camera: DMat3, eye: DVec3) -> Option<Self> {
        let (right, backward) = (world_from_camera.x_axis, world_from_camera.z_axis);
        // Beyond the limit an f32 no longer resolves the object's parts.
        let sound = world_from_camera.is_finite() && eye.abs().max_element() < FARTHEST;
        let volume = world_from_camera.determinant();
        let size = right.length() * world_from_camera.y_axis.length() * backward.length();
        // A mirrored frame would be a camera that does not exist.
        if !sound || !size.is_finite() || volume <= 1e-3 * size || size <= 0.0 {
            return None;
        }
        let forward = -backward.normalize();
        let down = forward.cross(right).normalize();
        Some(Self {
            eye,
            right: down.cross(forward),
            down,
            forward,
            focal_px: [1.0; 2],
            principal_px: [0.0; 2],
            size_px: [0; 2],
        })
    }

    /// This camera turned about its centre by `turn`, axis times angle, radians.
    pub fn turned(&self, turn: DVec3) -> Self {
        let rotation = DQuat::from_scaled_axis(turn);
        Self {
            right: rotation * self.right,
            down: rotation * self.down,
            forward: rotation * self.forward,
            ..*self
        }
    }

    /// Distance of a point along the optical axis, in the capture's units; negative behind the camera.
    pub fn depth(&self, point: DVec3) -> f64 {
        self.forward.dot(point - self.eye)
    }

    /// Camera of the engine in a frame with the origin `centre`; `None` when `centre` is not in front of this camera.
    pub fn projective(&self, centre: DVec3) -> Option<ProjectiveCamera> {
        let depth = self.depth(centre);
        if depth <= 1e-9 {
            return None;
        }
        let w = self.forward / depth;
        let axis = |axis: DVec3, k: usize| {
            let numerator = (axis * self.focal_px[k] + self.forward * self.principal_px[k]) / depth;
            let constant = self.focal_px[k] * axis.dot(centre - self.eye) / depth + self.principal_px[k];
            [numerator.x, numerator.y, numerator.z, constant]
        };
        let (u, v) = (axis(self.right, 0), axis(self.down, 1));
        let size = (self.size_px[0], self.size_px[1]);
        let camera = ProjectiveCamera::new(u, v, w.into(), size, self.forward);
        Some(camera)
    }
}

/// Point nearest to the optical axes of all cameras (least squares): the centre of a capture. Parallel axes are assumed
/// to meet one unit in front of their mean.
pub fn common_centre(cameras: &[Pinhole]) -> DVec3 {
    let count = cameras.len().max(1) as f64;
    let (mut matrix, mut vector, mut ahead) = (DMat3::ZERO, DVec3::ZERO, DVec3::ZERO);
    for camera in cameras {
        let f = camera.forward;
        let across = DMat3::IDENTITY - DMat3::from_cols(f * f.x, f * f.y, f * f.z);
        matrix += across;
        vector += across * camera.eye;
        ahead += (camera.eye + f) / count;
    }
    // A minimal weight of the fallback, which acts only in directions that the axes leave open.
    let weight = 1e-6 * count;
    (matrix + DMat3::IDENTITY * weight).inverse() * (vector + ahead * weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Pinhole {
        let eye = DVec3::new(2.0, -1.0, 0.5);
        let backward = eye.normalize();
        let right = DVec3::Z.cross(backward).normalize();
        let matrix = DMat3::from_cols(right, backward.cross(right), backward);
        Pinhole {
            focal_px: [100.0, 90.0],
            principal_px: [31.0, 22.5],
            size_px: [64, 48],
            ..Pinhole::from_opengl(matrix, eye).expect("a sound frame")
        }
    }

    #[test]
    fn the_engines_camera_projects_as_the_pinhole_does() {
        let (camera, centre) = (camera(), DVec3::new(0.1, 0.2, -0.1));
        let projective = camera.projective(centre).expect("the centre is in front");
        for point in [DVec3::ZERO, DVec3::new(0.3, -0.2, 0.4), DVec3::new(-0.5, 0.1, 0.0)] {
            let (offset, depth) = (point - camera.eye, camera.depth(point));
            let col = 100.0 * camera.right.dot(offset) / depth + 31.0;
            let row = 90.0 * camera.down.dot(offset) / depth + 22.5;
            let found = projective.project((point - centre).as_vec3());
            assert!((f64::from(found.0) - col).abs() < 1e-3 && (f64::from(found.1) - row).abs() < 1e-3);
        }
        let eye = projective.eye().expect("a camera nearby").as_dvec3();
        assert!((eye - (camera.eye - centre)).length() < 1e-4);
    }

    #[test]
    fn up_in_the_world_is_up_in_the_image() {
        let projective = camera().projective(DVec3::ZERO).expect("in front");
        let above = projective.project(glam::Vec3::new(0.0, 0.0, 0.2));
        assert!(above.1 < projective.project(glam::Vec3::ZERO).1);
    }

    #[test]
    fn frames_that_span_no_space_are_refused() {
        assert!(Pinhole::from_opengl(DMat3::ZERO, DVec3::ZERO).is_none());
        assert!(Pinhole::from_opengl(DMat3::IDENTITY * f64::NAN, DVec3::ZERO).is_none());
        assert!(Pinhole::from_opengl(DMat3::IDENTITY, DVec3::splat(1e200)).is_none());
        assert!(Pinhole::from_opengl(DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)), DVec3::ZERO).is_none());
    }

    #[test]
    fn axes_that_meet_give_the_point_where_they_do() {
        let target = DVec3::new(0.5, -0.25, 1.0);
        let cameras: Vec<Pinhole> = [DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 1.0)]
            .into_iter()
            .map(|way| Pinhole {
                eye: target + way * 3.0,
                forward: -way.normalize(),
                ..camera()
            })
            .collect();
        assert!((common_centre(&cameras) - target).length() < 1e-5);
        let parallel = vec![camera(); 3];
        assert!(common_centre(&parallel).is_finite());
    }
}
