//! Surfaces that are not Lambertian: one microfacet lobe above the diffuse reflection.
//!
//! GGX distribution, Smith's masking and shadowing (B. Walter et al., "Microfacet models for refraction through rough
//! surfaces", EGSR 2007), Schlick's Fresnel term. Truth albedo stays the surface's colour.

use crate::materials::{Class, Material, Spectrum};
use crate::noise::{hash2, unit};
use crate::panels;
use crate::raytrace::Hit;
use crate::solid::Face;
use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};

/// Reflectance at normal incidence of glass and varnish.
const DIELECTRIC: f64 = 0.04;
/// Slope of the modules on flat roofs.
const MODULE_SLOPE: f64 = 0.2;

/// The glossy part of a surface's reflection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Lobe {
    /// Reflectance at normal incidence.
    pub(crate) f0: Spectrum,
    /// GGX roughness `α`.
    pub(crate) alpha: f64,
    /// Share of the diffuse albedo that is left.
    pub(crate) diffuse: f64,
    /// Unit normal of the lobe: that of the surface, tilted for modules on flat roofs.
    pub(crate) normal: Vector3<f64>,
}

/// The lobe of the hit surface, if it has one.
pub(crate) fn lobe_of(surface: &Face, hit: &Hit) -> Option<Lobe> {
    let coated = |alpha: f64| Lobe {
        f0: Spectrum::repeat(DIELECTRIC),
        alpha,
        diffuse: 1.0,
        normal: hit.normal,
    };
    if surface.panels && panels::on_module(surface.spot(hit.point)) {
        let flat = hit.normal.z > 0.98;
        let tilted = hit.normal + surface.along_v * if flat { MODULE_SLOPE } else { 0.0 };
        return Some(Lobe {
            normal: tilted.normalize(),
            ..coated(0.08)
        });
    }
    match surface.finish.material {
        Material::Metal(mean) => Some(Lobe {
            f0: (mean * 1.5).map(|value| value.min(0.9)),
            alpha: 0.28,
            diffuse: 0.45,
            normal: hit.normal,
        }),
        Material::Membrane(_) => Some(coated(0.3)),
        Material::Plain(_) if surface.finish.class == Class::Car => Some(coated(0.12)),
        _ => None,
    }
}

impl Lobe {
    /// Schlick's approximation of Fresnel's equations.
    fn fresnel(&self, cosine: f64) -> Spectrum {
        let rest = (1.0 - cosine.clamp(0.0, 1.0)).powi(5);
        self.f0.map(|f0| f0 + (1.0 - f0) * rest)
    }

    /// Smith's term for one direction.
    fn unmasked(&self, cosine: f64) -> f64 {
        let tangent2 = (1.0 - cosine * cosine).max(0.0) / (cosine * cosine);
        2.0 / (1.0 + (1.0 + self.alpha * self.alpha * tangent2).sqrt())
    }

    /// Radiance towards `to_eye` per irradiance of a distant light on a surface that faces it. Directions are unit
    /// vectors.
    pub(crate) fn of_light(&self, to_eye: &Vector3<f64>, to_light: &Vector3<f64>) -> Spectrum {
        let (eye, light) = (self.normal.dot(to_eye), self.normal.dot(to_light));
        if eye <= 0.0 || light <= 0.0 {
            return Spectrum::zeros();
        }
        let half = (to_eye + to_light).normalize();
        let (cosine, alpha2) = (self.normal.dot(&half), self.alpha * self.alpha);
        let density = alpha2 / (PI * (cosine * cosine * (alpha2 - 1.0) + 1.0).powi(2));
        self.fresnel(to_eye.dot(&half)) * (density * self.unmasked(eye) * self.unmasked(light) / (4.0 * eye))
    }

    /// Random direction of incident light in the lobe, and the share of its radiance that goes towards `to_eye`; `None`
    /// if the direction is below the surface. `draw` is a random word.
    pub(crate) fn draw(&self, to_eye: &Vector3<f64>, draw: u64) -> Option<(Vector3<f64>, Spectrum)> {
        let (u, turn) = (unit(hash2(draw, 0x610)), TAU * unit(hash2(draw, 0x611)));
        let cosine = ((1.0 - u) / (1.0 + (self.alpha * self.alpha - 1.0) * u)).sqrt();
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let level = self.normal.z.abs() >= 0.9;
        let other = if level { Vector3::x() } else { Vector3::z() };
        let across = self.normal.cross(&other).normalize();
        let half = self.normal * cosine + (across * turn.cos() + self.normal.cross(&across) * turn.sin()) * sine;
        let (eye, eye_half) = (self.normal.dot(to_eye), half.dot(to_eye));
        let to_light = half * (2.0 * eye_half) - to_eye;
        let light = self.normal.dot(&to_light);
        if eye <= 1e-3 || light <= 1e-3 || eye_half <= 0.0 {
            return None;
        }
        let weight = self.unmasked(eye) * self.unmasked(light) * eye_half / (eye * cosine);
        Some((to_light.normalize(), self.fresnel(eye_half) * weight))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lobe(f0: f64, alpha: f64) -> Lobe {
        Lobe {
            f0: Spectrum::repeat(f0),
            alpha,
            diffuse: 0.0,
            normal: Vector3::z(),
        }
    }

    fn direction(zenith_rad: f64, azimuth_rad: f64) -> Vector3<f64> {
        let (sin, cos) = zenith_rad.sin_cos();
        Vector3::new(sin * azimuth_rad.cos(), sin * azimuth_rad.sin(), cos)
    }

    #[test]
    fn the_lobe_is_brightest_in_the_mirror_direction_and_narrower_when_smoother() {
        let to_light = direction(0.5, 0.0);
        for (alpha, nearby) in [(0.08, 0.5), (0.28, 0.95)] {
            let lobe = lobe(0.04, alpha);
            let mirror = lobe.of_light(&direction(0.5, PI), &to_light).x;
            let beside = lobe.of_light(&direction(0.5, PI - 0.25), &to_light).x;
            assert!(beside < nearby * mirror, "{alpha}: {beside} {mirror}");
            assert!(lobe.of_light(&direction(0.5, 0.0), &to_light).x < 0.5 * mirror);
        }
    }

    #[test]
    fn the_lobe_is_reciprocal_and_its_two_forms_reflect_the_same_share() {
        for alpha in [0.15, 0.3] {
            let lobe = lobe(1.0, alpha);
            let (a, b) = (direction(0.3, 1.0), direction(0.8, 2.2));
            // of_light is f times the cosine at the light.
            let (forth, back) = (lobe.of_light(&a, &b).x / b.z, lobe.of_light(&b, &a).x / a.z);
            assert!((forth - back).abs() < 1e-12 * forth.abs().max(1.0));
            // With a reflectance of 1 all light but the masked share is reflected: checked by sampling and by a sum
            // over the hemisphere.
            let eye = direction(0.4, 0.0);
            let draws = 40_000;
            let drawn: f64 = (0..draws)
                .filter_map(|k| lobe.draw(&eye, hash2(9, k)))
                .map(|(_, share)| share.x)
                .sum::<f64>()
                / draws as f64;
            let mut summed = 0.0;
            let steps = 400;
            for i in 0..steps {
                let zenith = (i as f64 + 0.5) / steps as f64 * 0.5 * PI;
                for j in 0..steps {
                    let light = direction(zenith, (j as f64 + 0.5) / steps as f64 * TAU);
                    summed +=
                        lobe.of_light(&eye, &light).x * zenith.sin() * (0.5 * PI / steps as f64) * (TAU / steps as f64);
                }
            }
            assert!((drawn - summed).abs() < 0.01, "{alpha}: {drawn} {summed}");
            assert!((0.85..1.001).contains(&summed), "{alpha}: {summed}");
        }
    }
}
