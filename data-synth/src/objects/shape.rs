//! Shapes with exact intersections: spheres, boxes and tori, placed and turned.

use crate::ray::Ray;
use nalgebra::{Matrix3, Vector3};

/// Hits nearer than this along a ray are the surface that the ray starts on.
const SELF_HIT: f64 = 1e-6;
/// Steps after which a ray that creeps along a torus counts as a miss.
const TORUS_STEPS: usize = 200;

/// A shape around the origin of its own frame. Lengths are in the units of the capture.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Shape {
    /// Sphere of a radius.
    Sphere { radius: f64 },
    /// Box with half sides along the own axes.
    Box { half: Vector3<f64> },
    /// Torus around the own z axis: radius of its middle circle, and of its tube.
    Torus { major: f64, minor: f64 },
}

/// A shape in the world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Solid {
    /// Shape in its own frame.
    pub(crate) shape: Shape,
    /// Centre in the world.
    pub(crate) centre: Vector3<f64>,
    /// Rotation of directions of the world into the own frame.
    pub(crate) own_from_world: Matrix3<f64>,
}

/// Intersection of a ray with a solid.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Intersection {
    /// Distance along the ray.
    pub(crate) distance: f64,
    /// Unit normal of the world that points out of the solid.
    pub(crate) normal: Vector3<f64>,
    /// Point in the solid's own frame.
    pub(crate) own: Vector3<f64>,
}

impl Solid {
    /// First intersection nearer than `limit` along the ray.
    pub(crate) fn intersect(&self, ray: &Ray, limit: f64) -> Option<Intersection> {
        let origin = self.own_from_world * (ray.origin - self.centre);
        let direction = self.own_from_world * ray.direction;
        let (distance, normal) = match self.shape {
            Shape::Sphere { radius } => sphere(&origin, &direction, radius)?,
            Shape::Box { half } => cuboid(&origin, &direction, &half)?,
            Shape::Torus { major, minor } => torus(&origin, &direction, major, minor, limit)?,
        };
        (distance < limit).then(|| Intersection {
            distance,
            normal: self.own_from_world.transpose() * normal,
            own: origin + direction * distance,
        })
    }
}

type Crossing = Option<(f64, Vector3<f64>)>;

fn sphere(origin: &Vector3<f64>, direction: &Vector3<f64>, radius: f64) -> Crossing {
    let b = origin.dot(direction);
    // The squared distance of the line, without the cancellation of b² - c.
    let miss = (origin - direction * b).norm_squared();
    let root = radius * radius - miss;
    if root < 0.0 {
        return None;
    }
    let root = root.sqrt();
    let t = [-b - root, -b + root].into_iter().find(|&t| t > SELF_HIT)?;
    Some((t, (origin + direction * t) / radius))
}

fn cuboid(origin: &Vector3<f64>, direction: &Vector3<f64>, half: &Vector3<f64>) -> Crossing {
    let (mut enter, mut leave) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
    for k in 0..3 {
        if direction[k].abs() < 1e-15 {
            if origin[k].abs() > half[k] {
                return None;
            }
            continue;
        }
        let [a, b] = [-half[k], half[k]].map(|wall| (wall - origin[k]) / direction[k]);
        if a.min(b) > enter.0 {
            enter = (a.min(b), k);
        }
        if a.max(b) < leave.0 {
            leave = (a.max(b), k);
        }
    }
    if enter.0 > leave.0 {
        return None;
    }
    let (t, axis) = [enter, leave].into_iter().find(|(t, _)| *t > SELF_HIT)?;
    let mut normal = Vector3::zeros();
    normal[axis] = (origin[axis] + direction[axis] * t).signum();
    Some((t, normal))
}

/// Intersection with a torus: steps along the ray by its exact distance field, and a last step by Newton's method.
fn torus(origin: &Vector3<f64>, direction: &Vector3<f64>, major: f64, minor: f64, limit: f64) -> Crossing {
    let field = |p: &Vector3<f64>| (p.xy().norm() - major).hypot(p.z) - minor;
    let slope = |p: &Vector3<f64>| {
        let ring = p.xy().norm().max(1e-12);
        let middle = Vector3::new(p.x / ring * major, p.y / ring * major, 0.0);
        (p - middle).normalize()
    };
    let reach = major + minor;
    let b = origin.dot(direction);
    let root = reach * reach - (origin - direction * b).norm_squared();
    if root < 0.0 {
        return None;
    }
    let (first, last) = ((-b - root.sqrt()).max(0.0), (-b + root.sqrt()).min(limit));
    let mut t = first;
    // A ray that starts on the surface first moves off it; a ray from afar may hit it where it enters the sphere.
    if first == 0.0 && field(origin).abs() < 10.0 * SELF_HIT {
        t += 20.0 * SELF_HIT;
    }
    let inside = first <= 0.0 && field(&(origin + direction * t)).is_sign_negative();
    let sign = if inside { -1.0 } else { 1.0 };
    for _ in 0..TORUS_STEPS {
        if t > last {
            return None;
        }
        let distance = sign * field(&(origin + direction * t));
        if distance < SELF_HIT {
            break;
        }
        t += distance;
    }
    let point = origin + direction * t;
    let across = slope(&point).dot(direction);
    if field(&point).abs() > 2.0 * SELF_HIT {
        return None;
    }
    if across.abs() > 0.1 {
        t -= field(&point) / across;
    }
    (t > SELF_HIT).then(|| (t, slope(&(origin + direction * t))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn solid(shape: Shape) -> Solid {
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, -0.5, 1.1);
        Solid {
            shape,
            centre: Vector3::new(0.2, -0.1, 0.4),
            own_from_world: turn.into_inner(),
        }
    }

    /// Approximate distance of a point in a shape's own frame from its surface.
    fn off(shape: Shape, p: &Vector3<f64>) -> f64 {
        match shape {
            Shape::Sphere { radius } => p.norm() - radius,
            Shape::Box { half } => (p.abs() - half).max(),
            Shape::Torus { major, minor } => (p.xy().norm() - major).hypot(p.z) - minor,
        }
    }

    #[test]
    fn rays_meet_surfaces_where_they_are_and_leave_them() {
        let shapes = [
            Shape::Sphere { radius: 0.7 },
            Shape::Box {
                half: Vector3::new(0.5, 0.3, 0.6),
            },
            Shape::Torus { major: 0.6, minor: 0.2 },
        ];
        for shape in shapes {
            let solid = solid(shape);
            let mut met = 0;
            for i in 0..400 {
                let a = f64::from(i) * 0.7;
                let eye = Vector3::new(3.0 * a.cos(), 3.0 * a.sin(), 1.0 + (a * 0.3).sin());
                let aim = solid.centre + Vector3::new((a * 1.3).sin(), (a * 1.7).cos(), (a * 2.1).sin()) * 0.6;
                let ray = Ray::new(eye, (aim - eye).normalize());
                let Some(hit) = solid.intersect(&ray, f64::INFINITY) else {
                    continue;
                };
                met += 1;
                assert!(off(shape, &hit.own).abs() < 1e-6, "{shape:?} {}", off(shape, &hit.own));
                let facing = hit.normal.dot(&ray.direction);
                assert!(
                    (hit.normal.norm() - 1.0).abs() < 1e-9 && facing < 1e-2,
                    "{shape:?} {} {facing}",
                    hit.normal.norm()
                );
                // A ray that starts there and goes outward does not meet the surface it starts on.
                let out = Ray::new(ray.at(hit.distance), hit.normal);
                assert!(
                    solid
                        .intersect(&out, f64::INFINITY)
                        .is_none_or(|again| again.distance > 1e-2),
                    "{shape:?}"
                );
            }
            assert!(met > 50, "{shape:?}: {met}");
        }
    }
}
