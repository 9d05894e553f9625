//! Surfaces and primitives put together: the parts of buildings, trees and cars.

use crate::materials::{Class, Material, Season, Spectrum, Spot};
use crate::panels;
use crate::raytrace::{Ellipsoid, Primitives, SurfaceId, Triangle};
use nalgebra::Vector3;

/// A surface: its class, its material, and the coordinates of its texture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Face {
    /// Class, material and random number of the surface.
    pub(crate) finish: Finish,
    /// Origin of the texture, metres.
    pub(crate) origin: Vector3<f64>,
    /// Texture axis u, unit length on flat surfaces.
    pub(crate) along_u: Vector3<f64>,
    /// Texture axis v, unit length on flat surfaces.
    pub(crate) along_v: Vector3<f64>,
    /// True if solar panels lie on the surface.
    pub(crate) panels: bool,
}

impl Face {
    /// Albedo at a point of the surface in a season.
    pub(crate) fn albedo(&self, point: Vector3<f64>, season: &Season) -> Spectrum {
        let at = self.spot(point);
        let module = if self.panels { panels::albedo(at) } else { None };
        module.unwrap_or_else(|| self.finish.material.albedo(at, season))
    }

    /// Texture coordinates of a point of the surface, metres.
    pub(crate) fn spot(&self, point: Vector3<f64>) -> Spot {
        let offset = point - self.origin;
        Spot {
            u: offset.dot(&self.along_u),
            v: offset.dot(&self.along_v),
            seed: self.finish.seed,
        }
    }
}

/// Class, material and random number of a part. Its texture axes follow from its shape.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Finish {
    /// Class of the part.
    pub(crate) class: Class,
    /// Material of the part.
    pub(crate) material: Material,
    /// Random number of the part.
    pub(crate) seed: u32,
}

impl Finish {
    /// The finish of a part.
    pub(crate) fn new(class: Class, material: Material, seed: u32) -> Self {
        Self { class, material, seed }
    }
}

/// A horizontal rectangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Footprint {
    /// Distance of the centre east of the site's centre, metres.
    pub(crate) x: f64,
    /// Distance of the centre north of the site's centre, metres.
    pub(crate) y: f64,
    /// Direction of the length, radians from east, counter-clockwise.
    pub(crate) angle_rad: f64,
    /// Half length and half width, metres.
    pub(crate) half: [f64; 2],
}

impl Footprint {
    /// The point at `a` along the length and `b` along the width from the centre, metres.
    pub(crate) fn at(&self, a: f64, b: f64) -> [f64; 2] {
        let (sin, cos) = self.angle_rad.sin_cos();
        [self.x + a * cos - b * sin, self.y + a * sin + b * cos]
    }

    /// (along the length, along the width) of a point, metres from the centre.
    pub(crate) fn local(&self, x: f64, y: f64) -> [f64; 2] {
        let (sin, cos) = self.angle_rad.sin_cos();
        let (dx, dy) = (x - self.x, y - self.y);
        [dx * cos + dy * sin, dy * cos - dx * sin]
    }

    /// Distance of a point outside the rectangle, negative inside, metres.
    pub(crate) fn distance_m(&self, x: f64, y: f64) -> f64 {
        let [a, b] = self.local(x, y);
        let (da, db) = (a.abs() - self.half[0], b.abs() - self.half[1]);
        da.max(0.0).hypot(db.max(0.0)) + da.max(db).min(0.0)
    }

    /// Rectangle of half size `half`, turned as this one, around the point (`a`, `b`) on the axes of this one, metres.
    pub(crate) fn part(&self, a: f64, b: f64, half: [f64; 2]) -> Self {
        let [x, y] = self.at(a, b);
        Self { x, y, half, ..*self }
    }

    /// The four corners at altitude `z`, counter-clockwise from (-, -).
    pub(crate) fn corners(&self, z: f64) -> [Vector3<f64>; 4] {
        let [l, w] = self.half;
        [(-l, -w), (l, -w), (l, w), (-l, w)].map(|(a, b)| self.point(a, b, z))
    }

    /// The point at altitude `z` over [`Self::at`].
    pub(crate) fn point(&self, a: f64, b: f64, z: f64) -> Vector3<f64> {
        let [x, y] = self.at(a, b);
        Vector3::new(x, y, z)
    }
}

/// Surfaces and the primitives that refer to them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Solids {
    /// Surfaces, indexed by the primitives.
    pub(crate) surfaces: Vec<Face>,
    /// Triangles and ellipsoids.
    pub(crate) primitives: Primitives,
}

impl Solids {
    /// Adds a surface with the axes `along` of its texture.
    fn surface(&mut self, finish: Finish, origin: Vector3<f64>, [along_u, along_v]: [Vector3<f64>; 2]) -> SurfaceId {
        self.surfaces.push(Face {
            finish,
            origin,
            along_u,
            along_v,
            panels: false,
        });
        (self.surfaces.len() - 1) as SurfaceId
    }

    /// Adds a convex flat polygon with its corners in order. The u axis of its texture is the first edge, v points
    /// inwards.
    pub(crate) fn polygon(&mut self, corners: &[Vector3<f64>], finish: Finish) {
        let edge = corners[1] - corners[0];
        let (normal, along_u) = (edge.cross(&(corners[2] - corners[0])).normalize(), edge.normalize());
        let surface = self.surface(finish, corners[0], [along_u, normal.cross(&along_u)]);
        for k in 1..corners.len() - 1 {
            let triangle = Triangle::new([corners[0], corners[k], corners[k + 1]], surface);
            self.primitives.triangles.push(triangle);
        }
    }

    /// Adds the four walls of a rectangle between the altitudes `from_z` and `to_z`.
    pub(crate) fn walls(&mut self, footprint: &Footprint, from_z: f64, to_z: f64, finish: Finish) {
        let (low, high) = (footprint.corners(from_z), footprint.corners(to_z));
        for k in 0..4 {
            let n = (k + 1) % 4;
            self.polygon(&[low[k], low[n], high[n], high[k]], finish);
        }
    }

    /// Lays solar panels on some of the roofs.
    pub(crate) fn lay_panels(&mut self) {
        for surface in &mut self.surfaces {
            let faces_up = surface.along_u.cross(&surface.along_v).z > 0.5;
            let roof = surface.finish.class == Class::Building && faces_up;
            surface.panels = roof && panels::carried_by(&surface.finish.material, surface.finish.seed);
        }
    }

    /// Adds a box with a flat top between the altitudes `from_z` and `to_z`.
    pub(crate) fn block(&mut self, footprint: &Footprint, from_z: f64, to_z: f64, sides: Finish, top: Finish) {
        self.walls(footprint, from_z, to_z, sides);
        self.polygon(&footprint.corners(to_z), top);
    }

    /// Adds an ellipsoid with half axes `radii` along east, north and up, metres.
    pub(crate) fn ellipsoid(&mut self, centre: Vector3<f64>, radii: Vector3<f64>, surface: SurfaceId) {
        self.primitives.ellipsoids.push(Ellipsoid { centre, radii, surface });
    }

    /// Adds a surface to be shared by many ellipsoids. Its texture axes are slanted, so that the sides of ellipsoids
    /// are textured too.
    pub(crate) fn foliage_surface(&mut self, origin: Vector3<f64>, finish: Finish) -> SurfaceId {
        let slanted = [Vector3::new(1.0, 0.0, 0.8), Vector3::new(0.0, 1.0, -0.6)];
        self.surface(finish, origin, slanted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::materials::grey;
    use crate::ray::Ray;
    use crate::raytrace::Tracer;
    use crate::terrain::HeightField;

    fn plain(class: Class) -> Finish {
        Finish::new(class, Material::Plain(grey(0.3)), 0)
    }

    #[test]
    fn a_box_has_its_top_where_its_corners_say_and_throws_a_shadow_of_h_over_tan_e() {
        let ground = HeightField::sample(60.0, 1.0, |_, _| 0.0);
        let footprint = Footprint {
            x: 3.0,
            y: -2.0,
            angle_rad: 0.4,
            half: [6.0, 4.0],
        };
        let mut solids = Solids::default();
        let height_m = 11.0;
        solids.block(
            &footprint,
            -1.0,
            height_m,
            plain(Class::Building),
            plain(Class::Building),
        );
        let tracer = Tracer::new(&ground, solids.primitives);
        let down = |x: f64, y: f64| {
            let ray = Ray::new(Vector3::new(x, y, 100.0), -Vector3::z());
            tracer.trace(&ray).map(|hit| hit.point.z)
        };
        for k in 0..2000 {
            let (x, y) = (f64::from(k % 50) * 0.531 - 10.0, f64::from(k / 50) * 0.517 - 12.0);
            let distance_m = footprint.distance_m(x, y);
            if distance_m.abs() > 1e-6 {
                let expected = if distance_m < 0.0 { height_m } else { 0.0 };
                let z = down(x, y).unwrap_or(f64::NAN);
                assert!((z - expected).abs() < 1e-9, "({x}, {y}): {z}");
            }
        }
        // Away from the sun, from the middle of the wall on the shadow's side.
        let elevation = 35f64.to_radians();
        let (sin, cos) = footprint.angle_rad.sin_cos();
        let sun = Vector3::new(-cos * elevation.cos(), -sin * elevation.cos(), elevation.sin());
        let reach_m = height_m / elevation.tan();
        let lit = |beyond_m: f64| {
            let [x, y] = footprint.at(footprint.half[0] + beyond_m, 0.0);
            let ray = Ray::new(Vector3::new(x, y, 1e-6), sun);
            !tracer.occluded(&ray, f64::INFINITY)
        };
        assert!(!lit(reach_m - 0.001) && lit(reach_m + 0.001) && !lit(0.01));
    }

    #[test]
    fn the_texture_of_a_wall_runs_along_it_and_up() {
        let mut solids = Solids::default();
        let footprint = Footprint {
            x: 0.0,
            y: 0.0,
            angle_rad: 0.0,
            half: [5.0, 4.0],
        };
        solids.walls(&footprint, 0.0, 9.0, plain(Class::Building));
        let wall = solids.surfaces[0];
        assert!((wall.along_u - Vector3::x()).norm() < 1e-12);
        assert!((wall.along_v - Vector3::z()).norm() < 1e-12);
    }
}
