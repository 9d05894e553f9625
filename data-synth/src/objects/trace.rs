//! A path tracer with next-event estimation: radiance along random paths of at most three bounces, and the lights
//! sampled directly at each of them.

use super::material::{Colour, PartMaterial, SurfacePoint, across};
use super::sampler::PathSampler;
use super::shape::{Intersection, Solid};
use crate::ray::Ray;
use nalgebra::{Vector2, Vector3};
use std::f64::consts::PI;

/// Bounces of a path.
const BOUNCES: usize = 3;
/// Least width of lobes after the first bounce of a path: light reflected by gloss onto other surfaces is blurred,
/// since a path finds a sharp reflection of a light once in a thousand, as a speck (A. Kaplanyan and C. Dachsbacher,
/// Computer Graphics Forum 32(2), 2013, on robust light transport).
const LEAST_ALPHA: f64 = 0.5;

/// Most turns of a walk through a medium.
const LONGEST_WALK: usize = 400;

/// Exit of a walk through a medium, with its remaining weight.
struct WalkExit {
    point: Vector3<f64>,
    normal: Vector3<f64>,
    weight: Colour,
}

/// A light without extent.
#[derive(Debug, Clone, Copy)]
pub(crate) enum LightSource {
    /// Parallel light from the unit direction `toward`; `strength` is the irradiance of a surface that faces it.
    Sun { toward: Vector3<f64>, strength: Colour },
    /// Point that radiates evenly; `strength` is its radiant intensity.
    Point { position: Vector3<f64>, strength: Colour },
}

/// Unit direction, sharpness (concentration of von Mises and Fisher) and peak radiance of a bright patch.
pub(crate) type Patch = (Vector3<f64>, f64, Colour);

/// Light from infinitely far: a smooth environment map and bright patches on it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Environment {
    /// Radiance straight up, at the horizon and straight down.
    pub(crate) shades: [Colour; 3],
    /// The patches.
    pub(crate) patches: Vec<Patch>,
}

impl Environment {
    /// Light from a unit direction, without that of the patches.
    fn smooth(&self, from: &Vector3<f64>) -> Colour {
        let (up, down) = (from.z.max(0.0), (-from.z).max(0.0));
        let [above, level, below] = self.shades;
        above * up + below * down + level * (1.0 - up - down)
    }

    /// Light of the patches from a unit direction.
    fn glow(&self, from: &Vector3<f64>) -> Colour {
        let glow = |(toward, sharpness, peak): &Patch| *peak * (sharpness * (toward.dot(from) - 1.0)).exp();
        self.patches.iter().map(glow).sum()
    }

    /// Sampling probability of each patch, by its power.
    fn shares(&self) -> impl Iterator<Item = f64> {
        let power = |(_, sharpness, peak): &Patch| peak.sum() / sharpness;
        let all: f64 = self.patches.iter().map(power).sum();
        self.patches.iter().map(move |patch| power(patch) / all)
    }

    /// Probability per solid angle with which [`Self::toward_patch`] gives a unit direction (von Mises and Fisher's
    /// density).
    fn density(&self, from: &Vector3<f64>) -> f64 {
        let density = |((toward, sharpness, _), share): (&Patch, f64)| {
            let peak = sharpness / (2.0 * PI * -(-2.0 * sharpness).exp_m1());
            share * peak * (sharpness * (toward.dot(from) - 1.0)).exp()
        };
        self.patches.iter().zip(self.shares()).map(density).sum()
    }

    /// A direction from which patches shine, from three numbers in [0, 1); `None` without patches.
    fn toward_patch(&self, mut choice: f64, u: Vector2<f64>) -> Option<Vector3<f64>> {
        let mut chosen = self.patches.last()?;
        for (patch, share) in self.patches.iter().zip(self.shares()) {
            if choice < share {
                chosen = patch;
                break;
            }
            choice -= share;
        }
        let (toward, sharpness, _) = chosen;
        let up = 1.0 + (u.x + (1.0 - u.x) * (-2.0 * sharpness).exp()).ln() / sharpness;
        let (azimuth, sine) = (2.0 * PI * u.y, (1.0 - up * up).max(0.0).sqrt());
        let side = across(toward);
        let turned = side * azimuth.cos() + toward.cross(&side) * azimuth.sin();
        Some((toward * up + turned * sine).normalize())
    }
}

/// One part of an object.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    /// Shape and place.
    pub(crate) solid: Solid,
    /// Material.
    pub(crate) material: PartMaterial,
}

/// An object under its light.
#[derive(Debug, Clone)]
pub(crate) struct Stage {
    /// Parts of the object.
    pub(crate) parts: Vec<Part>,
    /// Sun and point lights.
    pub(crate) lights: Vec<LightSource>,
    /// Light from infinitely far.
    pub(crate) environment: Environment,
}

/// First hit of a path from the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PathSample {
    /// Radiance toward the camera.
    pub(crate) radiance: Colour,
    /// Unit normal of the surface.
    pub(crate) normal: Vector3<f64>,
    /// Number of the part of the object, from 0.
    pub(crate) part: usize,
}

impl Stage {
    fn first_hit(&self, ray: &Ray) -> Option<(Vector3<f64>, SurfacePoint, usize)> {
        let mut nearest: Option<(usize, Intersection)> = None;
        for (number, part) in self.parts.iter().enumerate() {
            let limit = nearest.as_ref().map_or(f64::INFINITY, |(_, hit)| hit.distance);
            let nearer = part.solid.intersect(ray, limit).map(|hit| (number, hit));
            nearest = nearer.or(nearest);
        }
        let (number, hit) = nearest?;
        let Part { solid, material } = &self.parts[number];
        let own_up = solid.own_from_world.row(2).transpose();
        Some((ray.at(hit.distance), material.at(&hit.own, hit.normal, own_up), number))
    }

    fn blocked(&self, ray: &Ray, limit: f64) -> bool {
        self.parts.iter().any(|part| part.solid.intersect(ray, limit).is_some())
    }

    /// Light of the point lights and the sun that `surface` at `point` sends to the eye.
    fn direct_light_at(&self, point: &Vector3<f64>, surface: &SurfacePoint, to_eye: &Vector3<f64>) -> Colour {
        let mut sum = Colour::zeros();
        for light in &self.lights {
            let (toward, limit, falling) = match light {
                LightSource::Sun { toward, strength } => (*toward, f64::INFINITY, *strength),
                LightSource::Point { position, strength } => {
                    let offset = position - point;
                    let distance = offset.norm().max(1e-9);
                    (offset / distance, distance, strength / (distance * distance))
                }
            };
            let cosine = surface.normal.dot(&toward);
            let ray = Ray::new(*point, toward);
            if cosine > 0.0 && !self.blocked(&ray, limit) {
                sum += surface.reflect(&toward, to_eye).component_mul(&falling) * cosine;
            }
        }
        sum
    }

    /// Light from one sampled direction of a patch, weighted against the probability that the path samples it (balance
    /// heuristic; E. Veach and L. Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH
    /// 1995).
    fn patch_at(
        &self,
        point: &Vector3<f64>,
        surface: &SurfacePoint,
        to_eye: &Vector3<f64>,
        choice: f64,
        u: Vector2<f64>,
    ) -> Colour {
        let Some(toward) = self.environment.toward_patch(choice, u) else {
            return Colour::zeros();
        };
        let cosine = surface.normal.dot(&toward);
        let ray = Ray::new(*point, toward);
        if cosine <= 0.0 || self.blocked(&ray, f64::INFINITY) {
            return Colour::zeros();
        }
        let density = self.environment.density(&toward) + surface.density(&toward, to_eye);
        let reflected = surface
            .reflect(&toward, to_eye)
            .component_mul(&self.environment.glow(&toward));
        reflected * (cosine / density.max(1e-12))
    }

    /// A random walk through the medium of a part, from the surface inward until it leaves. By reciprocity, light that
    /// leaves the part at the start of the walk has entered it at the end. Both interfaces are matte, without internal
    /// reflection. `None` when almost no weight remains.
    fn random_walk(
        &self,
        part: usize,
        point: &Vector3<f64>,
        surface: &SurfacePoint,
        sampler: &mut PathSampler,
    ) -> Option<WalkExit> {
        let (part, medium) = (&self.parts[part], surface.medium?);
        let inward = SurfacePoint::white(-surface.normal);
        let u = sampler.any_pair();
        let mut ray = Ray::new(*point, inward.sample(&-surface.normal, 1.0, u)?);
        let mut weight = Colour::repeat(1.0);
        for _ in 0..LONGEST_WALK {
            let distance = -(1.0 - sampler.any()).ln() / medium.extinction;
            if let Some(hit) = part.solid.intersect(&ray, distance) {
                let from_outside = hit.normal.dot(&ray.direction) < 0.0;
                let normal = if from_outside { -hit.normal } else { hit.normal };
                return Some(WalkExit {
                    point: ray.at(hit.distance),
                    normal,
                    weight,
                });
            }
            weight.component_mul_assign(&medium.albedo);
            if weight.max() < 1e-3 {
                return None;
            }
            let (up, azimuth) = (2.0 * sampler.any() - 1.0, 2.0 * PI * sampler.any());
            let sine = (1.0 - up * up).sqrt();
            let direction = Vector3::new(sine * azimuth.cos(), sine * azimuth.sin(), up);
            ray = Ray::new(ray.at(distance), direction);
        }
        None
    }

    /// Follows one path from the camera; `None` if it meets no part.
    pub(crate) fn look(&self, ray: &Ray, sampler: &mut PathSampler) -> Option<PathSample> {
        let (mut point, mut surface, part) = self.first_hit(ray)?;
        let (normal, mut within) = (surface.normal, part);
        let (mut light, mut weight) = (Colour::zeros(), Colour::repeat(1.0));
        let mut to_eye = -ray.direction;
        for bounce in 0..=BOUNCES {
            if surface.medium.is_some() {
                let Some(left) = self.random_walk(within, &point, &surface, sampler) else {
                    break;
                };
                weight.component_mul_assign(&left.weight);
                (point, surface) = (left.point, SurfacePoint::white(left.normal));
                to_eye = left.normal;
            }
            light += weight.component_mul(&self.direct_light_at(&point, &surface, &to_eye));
            if bounce == BOUNCES {
                break;
            }
            let (choice, u) = sampler.at_turn(bounce, 0);
            if !self.environment.patches.is_empty() {
                let (choice, u) = sampler.at_turn(bounce, 1);
                light += weight.component_mul(&self.patch_at(&point, &surface, &to_eye, choice, u));
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
            let ray = Ray::new(point, onward);
            match self.first_hit(&ray) {
                None => {
                    let own = density / (density + self.environment.density(&onward)).max(1e-12);
                    let arriving = self.environment.smooth(&onward) + self.environment.glow(&onward) * own;
                    light += weight.component_mul(&arriving);
                    break;
                }
                Some((met, next, part)) => {
                    (point, surface) = (met, next.blurred(LEAST_ALPHA));
                    within = part;
                }
            }
            to_eye = -onward;
        }
        Some(PathSample {
            radiance: light,
            normal,
            part,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::material::{Medium, Pattern};
    use super::super::shape::Shape;
    use super::*;
    use nalgebra::Matrix3;

    fn matte(shape: Shape, centre: Vector3<f64>) -> Part {
        Part {
            solid: Solid {
                shape,
                centre,
                own_from_world: Matrix3::identity(),
            },
            material: PartMaterial {
                colours: [Colour::repeat(0.5); 2],
                pattern: Pattern::Plain,
                gloss: None,
                metal: false,
                medium: None,
            },
        }
    }

    fn look(stage: &Stage, x: f64) -> Colour {
        let ray = Ray::new(Vector3::new(x, 0.0, 10.0), -Vector3::z());
        let paths = 4096;
        let sum = (0..paths).filter_map(|path| stage.look(&ray, &mut PathSampler::new(3, path)));
        sum.fold(Colour::zeros(), |sum, seen| sum + seen.radiance) / f64::from(paths)
    }

    #[test]
    fn a_matte_ball_under_an_even_sky_shows_its_albedo_times_the_sky() {
        let stage = Stage {
            parts: vec![matte(Shape::Sphere { radius: 1.0 }, Vector3::zeros())],
            lights: Vec::new(),
            environment: Environment {
                shades: [Colour::repeat(0.8); 3],
                patches: Vec::new(),
            },
        };
        assert!((look(&stage, 0.3).x - 0.4).abs() < 1e-6);
    }

    #[test]
    fn a_matte_ball_under_patches_shows_their_irradiance() {
        // A patch straight above: ∫ s-lobe (n·l) dl in closed form for n along it, times albedo over pi; another below
        // is not seen.
        let sharpness: f64 = 20.0;
        let floor = Shape::Box {
            half: Vector3::new(5.0, 5.0, 0.5),
        };
        let patch = |z: f64| (Vector3::z() * z, sharpness, Colour::repeat(3.0));
        let stage = Stage {
            parts: vec![matte(floor, Vector3::new(0.0, 0.0, -0.5))],
            lights: Vec::new(),
            environment: Environment {
                shades: [Colour::zeros(); 3],
                patches: vec![patch(1.0), patch(-1.0)],
            },
        };
        // ∫₀¹ c e^(s(c-1)) dc = 1/s - (1 - e^-s)/s².
        let lobe = 1.0 / sharpness - (1.0 - (-sharpness).exp()) / (sharpness * sharpness);
        let expected = 0.5 / PI * 3.0 * 2.0 * PI * lobe;
        let found = look(&stage, 0.0).x;
        assert!((found - expected).abs() < 0.02 * expected, "{found} {expected}");
    }

    #[test]
    fn light_comes_out_of_the_dark_side_of_a_translucent_ball_and_none_is_made() {
        let mut ball = matte(Shape::Sphere { radius: 1.0 }, Vector3::zeros());
        ball.material.medium = Some(Medium {
            extinction: 4.0,
            albedo: Colour::new(1.0, 0.9, 0.5),
        });
        let even = Stage {
            parts: vec![ball],
            lights: Vec::new(),
            environment: Environment {
                shades: [Colour::repeat(0.8); 3],
                patches: Vec::new(),
            },
        };
        // Without absorption only a uniform environment is visible; with absorption it is darker.
        let seen = look(&even, 0.3);
        assert!(
            (seen.x - 0.8).abs() < 0.01 && seen.y < 0.75 && seen.z < seen.y,
            "{seen}"
        );
        let below = Stage {
            lights: vec![LightSource::Sun {
                toward: -Vector3::z(),
                strength: Colour::repeat(1.0),
            }],
            environment: Environment::default(),
            ..even
        };
        let through = look(&below, 0.3);
        assert!(through.x > 0.005 && through.z < through.x, "{through}");
    }

    #[test]
    fn a_point_lamp_follows_the_inverse_square_and_casts_shadows() {
        let floor = Shape::Box {
            half: Vector3::new(5.0, 5.0, 0.5),
        };
        let light = |z: f64| LightSource::Point {
            position: Vector3::new(0.0, 0.0, z),
            strength: Colour::repeat(9.0),
        };
        let stage = |parts, z| Stage {
            parts,
            lights: vec![light(z)],
            environment: Environment::default(),
        };
        let ground = matte(floor, Vector3::new(0.0, 0.0, -0.5));
        let open = stage(vec![ground], 3.0);
        assert!((look(&open, 0.0).x - 0.5 / PI).abs() < 1e-6);
        // A ball between light and floor, off the camera's way.
        let ball = matte(Shape::Sphere { radius: 0.3 }, Vector3::new(0.5, 0.0, 1.5));
        let shaded = stage(vec![ground, ball], 3.0);
        assert!(look(&shaded, 1.0).x < 0.05 * look(&open, 1.0).x);
    }
}
