//! Rotations of training cameras about their centres, for captures whose cameras are known to a few pixels only.
//!
//! A rotation about a camera's centre moves each pixel by an amount that does not depend on the scene, so the rendering
//! alone says which rotation brings it nearer to the photograph: a step of Gauss and Newton on three numbers (Lucas and
//! Kanade 1981). Translations and rotations of the whole scene can stand in for rotations of all cameras; what they
//! explain is taken out again, so that held-out cameras, which are never turned, keep seeing the scene in its place.

use super::options::TrainOptions;
use crate::camera::ProjectiveCamera;
use crate::raster::Raster;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

/// Epoch after which cameras that have hardly turned are taken to be right, as after every later one.
pub(super) const FIRST_DECISION: usize = 4;
/// Movement of the images, root of the mean square, pixels, up to which turns are noise. With exact cameras it is 0.05
/// to 0.22 pixels, with errors of half a pixel 0.5 (docs/lab/objects.md).
const NOISE_PX: f64 = 0.3;
/// Relative addition to the diagonal of normal equations, for rotations that the image does not determine.
const DAMPING: f64 = 1e-6;

/// Rotation of a view's camera that training has found.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct CameraTurn {
    /// Name of the view.
    pub image: String,
    /// Axis times angle in the axes of the scene, radians.
    pub radians: [f64; 3],
    /// Movement of the image's centre, pixels.
    pub pixels: f64,
}

/// The camera turned about its centre by `turn` (axis times angle, radians); the same camera without a centre.
pub(super) fn turned(camera: &ProjectiveCamera, turn: DVec3) -> ProjectiveCamera {
    let Some(eye) = camera.eye().filter(|_| turn != DVec3::ZERO) else {
        return *camera;
    };
    let (eye, rotation) = (eye.as_dvec3(), DQuat::from_scaled_axis(turn));
    let [u, v, w, axis] = [camera.u, camera.v, camera.w, camera.depth_axis].map(|row| rotation * row.as_dvec3());
    // Both numerators and the denominator vanish at the centre; the denominator is one at the origin.
    let at_origin = -w.dot(eye);
    ProjectiveCamera {
        u: (u / at_origin).as_vec3(),
        u0: (-u.dot(eye) / at_origin) as f32,
        v: (v / at_origin).as_vec3(),
        v0: (-v.dot(eye) / at_origin) as f32,
        w: (w / at_origin).as_vec3(),
        depth_axis: axis.as_vec3(),
        ..*camera
    }
}

/// Movements of a pixel's content (columns, rows) when the camera turns about each axis of the scene, pixels per
/// radian.
fn flow(camera: &ProjectiveCamera, col: f32, row: f32) -> [DVec3; 2] {
    let (w, [col, row]) = (camera.w.as_dvec3(), [col, row].map(f64::from));
    let (a, b) = (camera.u.as_dvec3() - w * col, camera.v.as_dvec3() - w * row);
    let ray = a.cross(b);
    [a.cross(ray) / w.dot(ray), b.cross(ray) / w.dot(ray)]
}

/// Movement of the image's centre by `turn`, pixels.
pub(super) fn moved_px(camera: &ProjectiveCamera, turn: DVec3) -> f64 {
    let [col, row] = [camera.width, camera.height].map(|size| (size as f32 - 1.0) / 2.0);
    let [along, across] = flow(camera, col, row).map(|flow| flow.dot(turn));
    along.hypot(across)
}

/// True if turns of these cameras are no more than an exact capture has.
pub(super) fn are_noise(cameras: &[ProjectiveCamera], turns: &[DVec3]) -> bool {
    let squares = cameras
        .iter()
        .zip(turns)
        .map(|(camera, turn)| moved_px(camera, *turn).powi(2));
    squares.sum::<f64>() < NOISE_PX * NOISE_PX * turns.len() as f64
}

/// Turns at the start; `None` where cameras must not turn, or training is over before it is clear whether they should.
pub(super) fn begin(options: &TrainOptions, views: usize) -> Option<Vec<DVec3>> {
    let turn = options.turn_cameras && options.iterations > FIRST_DECISION * views;
    turn.then(|| vec![DVec3::ZERO; views])
}

/// Normal equations of one row of the image.
#[derive(Clone, Copy)]
struct Normal {
    matrix: DMat3,
    right: DVec3,
}

/// The rotation that brings `image`, rendered for `camera`, nearer to `truth`: a step of Gauss and Newton.
/// `weight` is that of each pixel.
pub(super) fn toward(camera: &ProjectiveCamera, image: &Raster, truth: &Raster, weight: &[f32]) -> Option<DVec3> {
    camera.eye()?;
    let (width, height) = (image.width, image.height);
    let of_row = |row: usize| {
        let mut sum = Normal {
            matrix: DMat3::ZERO,
            right: DVec3::ZERO,
        };
        for col in 1..width.saturating_sub(1) {
            let i = row * width + col;
            let mut known = None;
            for band in 0..image.bands {
                let (seen, wanted) = (image.plane(band), truth.plane(band));
                let along = f64::from(seen[i + 1] - seen[i - 1]) / 2.0;
                let across = f64::from(seen[i + width] - seen[i - width]) / 2.0;
                if weight[i] == 0.0 || !wanted[i].is_finite() || (along == 0.0 && across == 0.0) {
                    continue;
                }
                let [of_col, of_row] = *known.get_or_insert_with(|| flow(camera, col as f32, row as f32));
                // Content that moves along a slope lowers the value behind it.
                let slope = -(of_col * along + of_row * across);
                let weight = f64::from(weight[i]);
                sum.matrix += DMat3::from_cols(slope * slope.x, slope * slope.y, slope * slope.z) * weight;
                sum.right += slope * f64::from(wanted[i] - seen[i]) * weight;
            }
        }
        sum
    };
    let rows: Vec<Normal> = (1..height.saturating_sub(1)).into_par_iter().map(of_row).collect();
    let (matrix, right) = rows.iter().fold((DMat3::ZERO, DVec3::ZERO), |(matrix, right), row| {
        (matrix + row.matrix, right + row.right)
    });
    solved(matrix, right)
}

/// Solution of damped normal equations; `None` where they say nothing.
fn solved(matrix: DMat3, right: DVec3) -> Option<DVec3> {
    let trace = matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z;
    if !(trace > 0.0 && trace.is_finite()) {
        return None;
    }
    let solution = (matrix + DMat3::from_diagonal(DVec3::splat(DAMPING * trace))).inverse() * right;
    solution.is_finite().then_some(solution)
}

/// Takes out of `turns`, of the cameras at `eyes`, what one translation and one rotation of the scene about its centre
/// explain: a translation `t` turns the camera at distance `d` from the centre by `d × t / |d|²`, a rotation `r` by its
/// part along the line of sight.
pub(super) fn without_gauge(turns: &mut [DVec3], eyes: &[DVec3]) {
    let skew = |d: DVec3| DMat3::from_cols(d.cross(DVec3::X), d.cross(DVec3::Y), d.cross(DVec3::Z));
    let translating = |eye: DVec3| skew(-eye) * (1.0 / eye.length_squared());
    let rolling = |eye: DVec3| {
        let d = eye.normalize();
        DMat3::from_cols(d * d.x, d * d.y, d * d.z)
    };
    let best = |of: &dyn Fn(DVec3) -> DMat3| {
        let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
        for (turn, eye) in turns.iter().zip(eyes) {
            let design = of(*eye);
            matrix += design.transpose() * design;
            right += design.transpose() * *turn;
        }
        solved(matrix, right).unwrap_or_default()
    };
    let (translation, rotation) = (best(&translating), best(&rolling));
    for (turn, eye) in turns.iter_mut().zip(eyes) {
        *turn -= translating(*eye) * translation + rolling(*eye) * rotation;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera at `eye` that looks at the origin, 200 pixels of focal length.
    fn camera(eye: DVec3) -> ProjectiveCamera {
        let axis = -eye.normalize();
        let right = axis.cross(DVec3::Z).normalize();
        let (down, w, f) = (axis.cross(right), axis / eye.length(), 200.0 / eye.length());
        let (u, v) = (right * f + w * 49.5, down * f + w * 39.5);
        ProjectiveCamera::new([u.x, u.y, u.z, 49.5], [v.x, v.y, v.z, 39.5], w.into(), (100, 80), axis)
    }

    #[test]
    fn a_turned_camera_keeps_its_centre_and_moves_pixels_by_its_flow() {
        let camera = camera(DVec3::new(2.0, -3.0, 1.0));
        let turn = DVec3::new(1e-3, -2e-3, 1.5e-3);
        let other = turned(&camera, turn);
        let centres = [camera, other].map(|camera| camera.eye().expect("rays meet"));
        assert!((centres[0] - centres[1]).length() < 1e-4);
        for p in [[0.2, 0.1, -0.3], [-0.4, 0.3, 0.2]].map(glam::Vec3::from) {
            let ((col, row, _), (to_col, to_row, _)) = (camera.project(p), other.project(p));
            let [along, across] = flow(&camera, col, row).map(|flow| flow.dot(turn));
            assert!(
                (f64::from(to_col - col) - along).abs() < 0.02,
                "{} {along}",
                to_col - col
            );
            assert!(
                (f64::from(to_row - row) - across).abs() < 0.02,
                "{} {across}",
                to_row - row
            );
        }
    }

    #[test]
    fn a_rendering_says_how_its_camera_is_turned() {
        let camera = camera(DVec3::new(2.0, -3.0, 1.0));
        let turn = DVec3::new(4e-3, -3e-3, 6e-3);
        // Light by direction, as an infinitely far scene.
        let picture = |camera: &ProjectiveCamera| {
            let mut image = Raster::filled(camera.width, camera.height, 1, 0.0);
            for i in 0..image.plane_len() {
                let ray = camera.ray_direction((i % camera.width) as f32, (i / camera.width) as f32);
                image.values[i] = (25.0 * ray.x).sin() + (31.0 * ray.y).cos() * (22.0 * ray.z).sin();
            }
            image
        };
        let truth = picture(&turned(&camera, turn));
        let weight = vec![1.0; truth.plane_len()];
        let mut found = DVec3::ZERO;
        for _ in 0..6 {
            let now = turned(&camera, found);
            found += toward(&now, &picture(&now), &truth, &weight).expect("the picture has slopes");
        }
        assert!((found - turn).length() < 2e-5, "{found}");
    }

    #[test]
    fn a_translation_and_a_rotation_of_the_scene_are_no_turns() {
        let eyes: Vec<DVec3> = (0..9)
            .map(|k| {
                let angle = 0.7 * f64::from(k);
                DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.0 + 0.2 * f64::from(k))
            })
            .collect();
        let (t, r) = (DVec3::new(0.01, -0.02, 0.03), DVec3::new(0.004, 0.001, -0.002));
        let of_scene = |eye: &DVec3| {
            let sight = eye.normalize();
            (-*eye).cross(t) / eye.length_squared() + sight * sight.dot(r)
        };
        let mut turns: Vec<DVec3> = eyes.iter().map(of_scene).collect();
        without_gauge(&mut turns, &eyes);
        assert!(turns.iter().all(|turn| turn.length() < 1e-6), "{turns:?}");
    }
}
