//! The normalised projective camera: satellites 600 km away and object cameras 2 m away are the same type.
//!
//! `col = (u·p + u0)/(1 + w·p)`, `row = (v·p + v0)/(1 + w·p)` with `p` in metres from the scene centre. Coefficients
//! are derived in f64 and evaluated in f32. Depth is metres along the camera's central ray, counted from the scene
//! centre and growing away from the camera. It is not counted from the camera: at 600 km an f32 has steps of 6 cm.

use glam::{DVec3, Vec3};

/// A projective camera with its image size; pixel centres are at integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProjectiveCamera {
    /// Coefficients of the column's numerator, pixels per metre.
    pub u: Vec3,
    /// Column of the scene centre, pixels.
    pub u0: f32,
    /// Coefficients of the row's numerator, pixels per metre.
    pub v: Vec3,
    /// Row of the scene centre, pixels.
    pub v0: f32,
    /// Coefficients of the denominator, 1/m.
    pub w: Vec3,
    /// Unit vector along which depth is measured, away from the camera.
    pub depth_axis: Vec3,
    /// Image columns, pixels.
    pub width: usize,
    /// Image rows, pixels.
    pub height: usize,
}

impl ProjectiveCamera {
    /// A camera of `size` (columns, rows; pixels) from f64 coefficients: three per-metre terms and a constant for
    /// column and row, three for the denominator.
    ///
    /// The depth axis is the ray through the image centre, oriented so that `away` (a rough viewing direction from the
    /// camera to the scene; straight down for satellites) has a positive component along it.
    pub fn new(u: [f64; 4], v: [f64; 4], w: [f64; 3], size: (usize, usize), away: DVec3) -> Self {
        let (width, height) = size;
        let (du, dv, dw) = (
            DVec3::new(u[0], u[1], u[2]),
            DVec3::new(v[0], v[1], v[2]),
            DVec3::from(w),
        );
        let (col, row) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
        // A ray is where both (u - col·w)·p and (v - row·w)·p stay constant.
        let ray = (du - dw * col).cross(dv - dw * row).normalize();
        let ray = if ray.dot(away) < 0.0 { -ray } else { ray };
        Self {
            u: du.as_vec3(),
            u0: u[3] as f32,
            v: dv.as_vec3(),
            v0: v[3] as f32,
            w: dw.as_vec3(),
            depth_axis: ray.as_vec3(),
            width,
            height,
        }
    }

    /// A nadir orthographic camera: pixel (0, 0) is centred `west_m`, `north_m` of the scene centre, columns run east,
    /// rows south, `gsd_m` metres apart.
    pub fn nadir(west_m: f64, north_m: f64, gsd_m: f64, size: (usize, usize)) -> Self {
        let u = [1.0 / gsd_m, 0.0, 0.0, -west_m / gsd_m];
        let v = [0.0, -1.0 / gsd_m, 0.0, north_m / gsd_m];
        Self::new(u, v, [0.0; 3], size, -DVec3::Z)
    }

    /// Projects a point: column, row and `1 + w·p`, which is positive in front of the camera.
    #[inline]
    pub fn project(&self, p: Vec3) -> (f32, f32, f32) {
        let denominator = 1.0 + self.w.dot(p);
        let inverse = 1.0 / denominator;
        (
            (self.u.dot(p) + self.u0) * inverse,
            (self.v.dot(p) + self.v0) * inverse,
            denominator,
        )
    }

    /// Index of the pixel that shows a point, row after row, and the denominator of its projection, which is above zero
    /// in front of the camera; `None` outside of the image.
    #[inline]
    pub fn pixel(&self, p: Vec3) -> Option<(usize, f32)> {
        let (col, row, denominator) = self.project(p);
        let (col, row) = (col.round(), row.round());
        let inside = col >= 0.0 && row >= 0.0 && col < self.width as f32 && row < self.height as f32;
        inside.then(|| (row as usize * self.width + col as usize, denominator))
    }

    /// Depth of a point, metres along the central ray from the scene centre.
    #[inline]
    pub fn depth(&self, p: Vec3) -> f32 {
        self.depth_axis.dot(p)
    }

    /// Rows of the Jacobian, `d col / d p` and `d row / d p`, pixels per metre, at a point that projects to (`col`,
    /// `row`) with the denominator `1 + w·p`.
    #[inline]
    pub fn jacobian(&self, col: f32, row: f32, denominator: f32) -> (Vec3, Vec3) {
        let inverse = 1.0 / denominator;
        ((self.u - self.w * col) * inverse, (self.v - self.w * row) * inverse)
    }

    /// Unit direction of the ray through a pixel, away from the camera.
    pub fn ray_direction(&self, col: f32, row: f32) -> Vec3 {
        let ray = (self.u - self.w * col).cross(self.v - self.w * row).normalize();
        if ray.dot(self.depth_axis) < 0.0 { -ray } else { ray }
    }

    /// Common point of all rays, metres; `None` when they are nearly parallel.
    pub fn eye(&self) -> Option<Vec3> {
        // At the eye both numerators and the denominator vanish: three equations linear in the point, solved in f64.
        let (u, v, w) = (self.u.as_dvec3(), self.v.as_dvec3(), self.w.as_dvec3());
        let det = u.dot(v.cross(w));
        if det.abs() <= 1e-12 * u.length() * v.length() {
            return None;
        }
        let (a, b) = (f64::from(self.u0), f64::from(self.v0));
        let sum = v.cross(w) * a + w.cross(u) * b + u.cross(v);
        Some((-sum / det).as_vec3())
    }

    /// The point at altitude `z` (metres up) on the ray through a pixel; `None` when the ray is level.
    pub fn point_at_altitude(&self, col: f32, row: f32, z: f32) -> Option<Vec3> {
        // Two equations linear in (x, y): (u - col·w)·p = col - u0, (v - row·w)·p = row - v0; solved in f64.
        let a = (self.u - self.w * col).as_dvec3();
        let b = (self.v - self.w * row).as_dvec3();
        let (ra, rb) = (
            f64::from(col - self.u0) - a.z * f64::from(z),
            f64::from(row - self.v0) - b.z * f64::from(z),
        );
        let det = a.x * b.y - a.y * b.x;
        let scale = a.length() * b.length();
        if det.abs() <= 1e-9 * scale {
            return None;
        }
        Some(Vec3::new(
            ((ra * b.y - rb * a.y) / det) as f32,
            ((a.x * rb - b.x * ra) / det) as f32,
            z,
        ))
    }

    /// This camera for an image scaled by `1 / factor` (a pyramid level whose pixels average `factor × factor`).
    pub fn downscaled(&self, factor: usize) -> Self {
        let f = factor as f32;
        // Pixel centres at integers: col' = (col + 0.5)/f - 0.5, an affine map of (u, u0) with the denominator mixed
        // in.
        let shift = (0.5 / f) - 0.5;
        Self {
            u: self.u / f + self.w * shift,
            u0: self.u0 / f + shift,
            v: self.v / f + self.w * shift,
            v0: self.v0 / f + shift,
            width: self.width / factor,
            height: self.height / factor,
            ..*self
        }
    }

    /// This camera with its image moved by (`col`, `row`) pixels, the effect of a pointing bias.
    pub fn shifted(&self, col: f32, row: f32) -> Self {
        Self {
            u: self.u + self.w * col,
            u0: self.u0 + col,
            v: self.v + self.w * row,
            v0: self.v0 + row,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn satellite() -> ProjectiveCamera {
        // 600 km away, 20 degrees off nadir, 0.5 m pixels.
        let axis = DVec3::new(0.3, 0.1, -0.9).normalize();
        let right = axis.cross(DVec3::Y).normalize();
        let down = axis.cross(right).normalize();
        let distance = 600e3;
        let w = axis / distance;
        let u = right * 2.0 + w * 256.0;
        let v = down * 2.0 + w * 256.0;
        ProjectiveCamera::new(
            [u.x, u.y, u.z, 256.0],
            [v.x, v.y, v.z, 256.0],
            [w.x, w.y, w.z],
            (512, 512),
            axis,
        )
    }

    #[test]
    fn a_point_is_shown_by_its_nearest_pixel_or_by_none() {
        let camera = satellite();
        let shown = |col: f32, row: f32| {
            let point = camera.point_at_altitude(col, row, 35.0).expect("the ray is not level");
            camera.pixel(point).map(|(index, _)| index)
        };
        assert_eq!(shown(17.25, 400.4), Some(400 * 512 + 17));
        assert_eq!(shown(-0.4, 511.4), Some(511 * 512));
        for (col, row) in [(-0.6, 3.0), (3.0, -0.6), (511.6, 3.0), (3.0, 511.6)] {
            assert_eq!(shown(col, row), None, "{col} {row}");
        }
    }

    #[test]
    fn a_point_at_altitude_projects_back_to_its_pixel() {
        let camera = satellite();
        let p = camera
            .point_at_altitude(17.25, 400.5, 35.0)
            .expect("the ray is not level");
        let (col, row, _) = camera.project(p);
        assert!((col - 17.25).abs() < 1e-3 && (row - 400.5).abs() < 1e-3, "{col} {row}");
    }

    #[test]
    fn points_along_a_ray_share_a_pixel_and_gain_depth() {
        let camera = satellite();
        let p = camera
            .point_at_altitude(100.0, 50.0, 0.0)
            .expect("the ray is not level");
        let q = p + camera.ray_direction(100.0, 50.0) * 80.0;
        let (col, row, _) = camera.project(q);
        assert!((col - 100.0).abs() < 1e-3 && (row - 50.0).abs() < 1e-3);
        assert!((camera.depth(q) - camera.depth(p) - 80.0).abs() < 1e-2);
    }

    #[test]
    fn all_rays_meet_in_the_eye() {
        let eye = DVec3::new(1.0, -2.0, 3.5);
        let axis = -eye.normalize();
        let (right, distance) = (axis.cross(DVec3::Z).normalize(), eye.length());
        let (down, w) = (axis.cross(right), axis / distance);
        let (u, v) = (right * 50.0 + w * 31.5, down * 50.0 + w * 31.5);
        let (u, v) = ([u.x, u.y, u.z, 31.5], [v.x, v.y, v.z, 31.5]);
        let camera = ProjectiveCamera::new(u, v, w.into(), (64, 64), axis);
        let found = camera.eye().expect("a camera nearby has an eye");
        assert!((found.as_dvec3() - eye).length() < 1e-4, "{found}");
        assert!(ProjectiveCamera::nadir(0.0, 0.0, 1.0, (8, 8)).eye().is_none());
    }

    #[test]
    fn downscaling_keeps_the_half_pixel_convention() {
        let camera = satellite();
        let p = Vec3::new(12.0, -40.0, 3.0);
        let (col, row, _) = camera.project(p);
        let (c2, r2, _) = camera.downscaled(2).project(p);
        assert!((c2 - ((col + 0.5) / 2.0 - 0.5)).abs() < 1e-4 && (r2 - ((row + 0.5) / 2.0 - 0.5)).abs() < 1e-4);
    }

    #[test]
    fn shifting_moves_every_projection_by_the_shift() {
        let p = Vec3::new(12.0, -40.0, 3.0);
        let (col, row, _) = satellite().project(p);
        let (c2, r2, _) = satellite().shifted(1.5, -0.25).project(p);
        assert!((c2 - col - 1.5).abs() < 1e-4 && (r2 - row + 0.25).abs() < 1e-4);
    }
}
