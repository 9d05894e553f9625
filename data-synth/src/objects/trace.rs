//! A path tracer: light gathered along random paths, with the lamps asked for directly at every turn.

use super::material::{Colour, Material, Surface};
use super::shape::Solid;
use crate::raytrace::Ray;
use nalgebra::{Vector2, Vector3};
use rand::RngExt;
use rand_pcg::Pcg32;

/// Turns of a path.
const BOUNCES: usize = 3;
/// Least width of lobes behind the first turn of a path: light that gloss throws on other surfaces is blurred, for a path finds a
/// sharp reflection of a lamp once in a thousand and then as a speck (Kaplanyan and Dachsbacher 2013).
const LEAST_ALPHA: f64 = 0.5;

/// A lamp.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Lamp {
    /// Parallel light from a unit direction; what it lays on a surface that faces it.
    Sun { toward: Vector3<f64>, strength: Colour },
    /// A point that radiates evenly; radiant intensity.
    Point { position: Vector3<f64>, strength: Colour },
}

/// Light from infinitely far: a smooth sky and glowing patches on it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Sky {
    /// Straight up, at the horizon, straight down.
    pub(crate) shades: [Colour; 3],
    /// Direction, sharpness and peak of each patch.
    pub(crate) patches: Vec<(Vector3<f64>, f64, Colour)>,
}

impl Sky {
    /// Light from a unit direction.
    pub(crate) fn light(&self, from: &Vector3<f64>) -> Colour {
        let (up, down) = (from.z.max(0.0), (-from.z).max(0.0));
        let [above, level, below] = self.shades;
        let smooth = above * up + below * down + level * (1.0 - up - down);
        let glow = |(toward, sharpness, peak): &(Vector3<f64>, f64, Colour)| {
            *peak * (sharpness * (toward.dot(from) - 1.0)).exp()
        };
        self.patches.iter().map(glow).fold(smooth, |sum, light| sum + light)
    }
}

/// One part of an object.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    pub(crate) solid: Solid,
    pub(crate) material: Material,
}

/// An object under its light.
#[derive(Debug, Clone)]
pub(crate) struct Stage {
    pub(crate) parts: Vec<Part>,
    pub(crate) lamps: Vec<Lamp>,
    pub(crate) sky: Sky,
}

/// What a path from the camera saw first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Seen {
    /// Light toward the camera.
    pub(crate) light: Colour,
    /// Unit normal of the surface.
    pub(crate) normal: Vector3<f64>,
}

impl Stage {
    fn first(&self, ray: &Ray) -> Option<(Vector3<f64>, Surface)> {
        let mut nearest: Option<(f64, Vector3<f64>, Surface)> = None;
        for part in &self.parts {
            let limit = nearest.as_ref().map_or(f64::INFINITY, |n| n.0);
            if let Some(hit) = part.solid.meet(ray, limit) {
                let own_up = part.solid.own_from_world.row(2).transpose();
                let surface = part.material.at(&hit.own, hit.normal, own_up);
                nearest = Some((hit.distance, ray.at(hit.distance), surface));
            }
        }
        nearest.map(|(_, point, surface)| (point, surface))
    }

    fn blocked(&self, ray: &Ray, limit: f64) -> bool {
        self.parts.iter().any(|part| part.solid.meet(ray, limit).is_some())
    }

    /// Light of the lamps that `surface` at `point` sends to the eye.
    fn lamps_at(&self, point: &Vector3<f64>, surface: &Surface, to_eye: &Vector3<f64>) -> Colour {
        let mut sum = Colour::zeros();
        for lamp in &self.lamps {
            let (toward, limit, falling) = match lamp {
                Lamp::Sun { toward, strength } => (*toward, f64::INFINITY, *strength),
                Lamp::Point { position, strength } => {
                    let offset = position - point;
                    let distance = offset.norm().max(1e-9);
                    (offset / distance, distance, strength / (distance * distance))
                }
            };
            let cosine = surface.normal.dot(&toward);
            let ray = Ray {
                origin: *point,
                direction: toward,
            };
            if cosine > 0.0 && !self.blocked(&ray, limit) {
                sum += surface.reflect(&toward, to_eye).component_mul(&falling) * cosine;
            }
        }
        sum
    }

    /// Follows one path from the camera; `None` when it meets nothing.
    pub(crate) fn look(&self, ray: &Ray, random: &mut Pcg32) -> Option<Seen> {
        let (mut point, mut surface) = self.first(ray)?;
        let normal = surface.normal;
        let (mut light, mut weight) = (Colour::zeros(), Colour::repeat(1.0));
        let mut to_eye = -ray.direction;
        for bounce in 0..=BOUNCES {
            light += weight.component_mul(&self.lamps_at(&point, &surface, &to_eye));
            let (choice, u) = (random.random::<f64>(), Vector2::new(random.random(), random.random()));
            if bounce == BOUNCES {
                break;
            }
            let Some(onward) = surface.sample(&to_eye, choice, u) else {
                break;
            };
            let density = surface.density(&onward, &to_eye);
            let share = surface.reflect(&onward, &to_eye) * (surface.normal.dot(&onward) / density.max(1e-12));
            weight.component_mul_assign(&share);
            if weight.max() < 1e-4 {
                break;
            }
            let ray = Ray {
                origin: point,
                direction: onward,
            };
            match self.first(&ray) {
                None => {
                    light += weight.component_mul(&self.sky.light(&onward));
                    break;
                }
                Some((met, next)) => (point, surface) = (met, next.blurred(LEAST_ALPHA)),
            }
            to_eye = -onward;
        }
        Some(Seen { light, normal })
    }
}

#[cfg(test)]
mod tests {
    use super::super::material::Pattern;
    use super::super::shape::Shape;
    use super::*;
    use nalgebra::Matrix3;
    use rand::SeedableRng;
    use std::f64::consts::PI;

    fn matte(shape: Shape, centre: Vector3<f64>) -> Part {
        Part {
            solid: Solid {
                shape,
                centre,
                own_from_world: Matrix3::identity(),
            },
            material: Material {
                colours: [Colour::repeat(0.5); 2],
                pattern: Pattern::Plain,
                gloss: None,
                metal: false,
            },
        }
    }

    fn look(stage: &Stage, x: f64) -> Colour {
        let ray = Ray {
            origin: Vector3::new(x, 0.0, 10.0),
            direction: -Vector3::z(),
        };
        let mut random = Pcg32::seed_from_u64(3);
        let paths = 4000;
        let sum = (0..paths).filter_map(|_| stage.look(&ray, &mut random));
        sum.fold(Colour::zeros(), |sum, seen| sum + seen.light) / f64::from(paths)
    }

    #[test]
    fn a_matte_ball_under_an_even_sky_shows_its_albedo_times_the_sky() {
        let stage = Stage {
            parts: vec![matte(Shape::Sphere { radius: 1.0 }, Vector3::zeros())],
            lamps: Vec::new(),
            sky: Sky {
                shades: [Colour::repeat(0.8); 3],
                patches: Vec::new(),
            },
        };
        assert!((look(&stage, 0.3).x - 0.4).abs() < 1e-6);
    }

    #[test]
    fn a_point_lamp_follows_the_inverse_square_and_casts_shadows() {
        let floor = Shape::Box {
            half: Vector3::new(5.0, 5.0, 0.5),
        };
        let lamp = |z: f64| Lamp::Point {
            position: Vector3::new(0.0, 0.0, z),
            strength: Colour::repeat(9.0),
        };
        let stage = |parts, z| Stage {
            parts,
            lamps: vec![lamp(z)],
            sky: Sky::default(),
        };
        let ground = matte(floor, Vector3::new(0.0, 0.0, -0.5));
        let open = stage(vec![ground], 3.0);
        assert!((look(&open, 0.0).x - 0.5 / PI).abs() < 1e-6);
        // A ball between lamp and floor, off the camera's way.
        let ball = matte(Shape::Sphere { radius: 0.3 }, Vector3::new(0.5, 0.0, 1.5));
        let shaded = stage(vec![ground, ball], 3.0);
        assert!(look(&shaded, 1.0).x < 0.05 * look(&open, 1.0).x);
    }
}
