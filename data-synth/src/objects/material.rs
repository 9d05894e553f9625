//! Surfaces: reflection and transmission of light by a part of an object.
//!
//! A diffuse base and, where there is one, an anisotropic GGX lobe (B. Walter et al., "Microfacet models for refraction
//! through rough surfaces", EGSR 2007; E. Heitz, "Understanding the masking-shadowing function in microfacet-based
//! BRDFs", JCGT 3(2), 2014) with Schlick's Fresnel term. Light that the lobe reflects does not reach the base.

use nalgebra::{Vector2, Vector3};
use std::f64::consts::PI;

/// Red, green and blue.
pub(crate) type Colour = Vector3<f64>;

/// Distribution of two colours over a surface; lengths are in the units of the capture.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Pattern {
    /// The first colour alone.
    Plain,
    /// Blocks of this width.
    Checks(f64),
    /// Bands around the own z axis of this width.
    Bands(f64),
    /// Soft spots of this size.
    Spots(f64),
}

/// A glossy lobe.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gloss {
    /// GGX roughness `α` along the tangent and across it.
    pub(crate) alpha: [f64; 2],
    /// Reflectance at normal incidence (F0), 0 to 1.
    pub(crate) normal_reflectance: Colour,
}

/// An isotropic scattering medium under a surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Medium {
    /// Extinction coefficient: scattering and absorption events per unit length.
    pub(crate) extinction: f64,
    /// Share of the events that are scattering, 0 to 1.
    pub(crate) albedo: Colour,
}

/// Material of a part.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PartMaterial {
    /// The two colours of the pattern: albedo, or for a metal reflectance at normal incidence.
    pub(crate) colours: [Colour; 2],
    /// Distribution of the colours.
    pub(crate) pattern: Pattern,
    /// Glossy lobe, if any.
    pub(crate) gloss: Option<Gloss>,
    /// True for a metal, which has no diffuse base.
    pub(crate) metal: bool,
    /// Medium below the surface. Light enters such a part and leaves it elsewhere; it has no diffuse base.
    pub(crate) medium: Option<Medium>,
}

/// A surface at one point: its frame, its base and its lobe.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfacePoint {
    /// Unit normal.
    pub(crate) normal: Vector3<f64>,
    /// Unit tangent, along the first width of the lobe.
    pub(crate) tangent: Vector3<f64>,
    /// Albedo of the diffuse base.
    pub(crate) base: Colour,
    /// Glossy lobe, if any.
    pub(crate) gloss: Option<Gloss>,
    /// Medium below the surface, if any.
    pub(crate) medium: Option<Medium>,
}

impl PartMaterial {
    /// Surface at the point `own` in the part's own frame. `normal` and the part's axis `own_up` are unit vectors of
    /// the world.
    pub(crate) fn at(&self, own: &Vector3<f64>, normal: Vector3<f64>, own_up: Vector3<f64>) -> SurfacePoint {
        let share = match self.pattern {
            Pattern::Plain => 0.0,
            Pattern::Checks(width) => {
                // Off the planes of a box's faces, where rounding would decide.
                let cell = own.map(|x| (x / width + 0.123).floor() as i64);
                (cell.x + cell.y + cell.z).rem_euclid(2) as f64
            }
            Pattern::Bands(width) => 0.5 + 0.5 * (2.0 * PI * own.z / width + 3.0 * own.y.atan2(own.x)).sin(),
            Pattern::Spots(size) => {
                let waves = own.map(|x| (2.0 * PI * x / size).sin());
                0.5 + 0.5 * (2.0 * (waves.x * waves.y + waves.y * waves.z + waves.z * waves.x)).tanh()
            }
        };
        let colour = self.colours[0] * (1.0 - share) + self.colours[1] * share;
        // Brushed around the own axis.
        let around = own_up.cross(&normal).try_normalize(1e-6);
        let tangent = around.unwrap_or_else(|| across(&normal));
        let gloss = self.gloss.map(|gloss| Gloss {
            normal_reflectance: if self.metal { colour } else { gloss.normal_reflectance },
            ..gloss
        });
        let baseless = self.metal || self.medium.is_some();
        SurfacePoint {
            normal,
            tangent,
            base: if baseless { Colour::zeros() } else { colour },
            gloss,
            medium: self.medium,
        }
    }
}

/// Unit vector at right angles to the unit vector `n`.
pub(crate) fn across(n: &Vector3<f64>) -> Vector3<f64> {
    let other = if n.x.abs() < 0.5 { Vector3::x() } else { Vector3::y() };
    n.cross(&other).normalize()
}

impl SurfacePoint {
    /// White, matte surface: the interface through which light enters and leaves a medium.
    pub(crate) fn white(normal: Vector3<f64>) -> Self {
        Self {
            normal,
            tangent: across(&normal),
            base: Colour::repeat(1.0),
            gloss: None,
            medium: None,
        }
    }

    /// A direction's components along tangent, bitangent and normal.
    fn local(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let bitangent = self.normal.cross(&self.tangent);
        Vector3::new(self.tangent.dot(v), bitangent.dot(v), self.normal.dot(v))
    }

    fn world(&self, v: &Vector3<f64>) -> Vector3<f64> {
        self.tangent * v.x + self.normal.cross(&self.tangent) * v.y + self.normal * v.z
    }

    /// Widens the lobe to a roughness of at least `least_alpha` in both directions.
    pub(crate) fn blurred(mut self, least_alpha: f64) -> Self {
        if let Some(gloss) = &mut self.gloss {
            gloss.alpha = gloss.alpha.map(|alpha| alpha.max(least_alpha));
        }
        self
    }

    /// Bidirectional reflectance, 1/sr, between the unit vectors `to_light` and `to_eye`, without the cosine.
    pub(crate) fn reflect(&self, to_light: &Vector3<f64>, to_eye: &Vector3<f64>) -> Colour {
        let (light, eye) = (self.local(to_light), self.local(to_eye));
        if light.z <= 0.0 || eye.z <= 0.0 {
            return Colour::zeros();
        }
        let Some(gloss) = &self.gloss else {
            return self.base / PI;
        };
        let half = (light + eye).normalize();
        let fresnel = gloss.fresnel(light.dot(&half));
        let [ax, ay] = gloss.alpha;
        let stretch = |v: &Vector3<f64>| Vector3::new(ax * v.x, ay * v.y, v.z).norm();
        // Height-correlated masking over the four cosines (Heitz 2014).
        let visible = 0.5 / (light.z * stretch(&eye) + eye.z * stretch(&light));
        let entering = (Colour::repeat(1.0) - fresnel).component_mul(&self.base) / PI;
        entering + fresnel * (gloss.density(&half) * visible)
    }

    /// Probability per solid angle with which [`Self::sample`] gives `to_light`.
    pub(crate) fn density(&self, to_light: &Vector3<f64>, to_eye: &Vector3<f64>) -> f64 {
        let (light, eye) = (self.local(to_light), self.local(to_eye));
        let base = light.z.max(0.0) / PI;
        let Some(gloss) = &self.gloss else { return base };
        let half = (light + eye).normalize();
        let lobe = gloss.density(&half) * half.z.max(0.0) / (4.0 * eye.dot(&half).max(1e-9));
        let share = self.lobe_share();
        share * lobe + (1.0 - share) * base
    }

    /// Probability of sampling the lobe instead of the base.
    fn lobe_share(&self) -> f64 {
        match &self.gloss {
            None => 0.0,
            Some(_) if self.base.max() <= 0.0 => 1.0,
            Some(_) => 0.5,
        }
    }

    /// Direction to a light, drawn with the probability [`Self::density`] from three numbers in [0, 1); `None` if it is
    /// below the surface.
    pub(crate) fn sample(&self, to_eye: &Vector3<f64>, choice: f64, u: Vector2<f64>) -> Option<Vector3<f64>> {
        let light = if choice < self.lobe_share() {
            let [ax, ay] = self.gloss.as_ref().map_or([1.0; 2], |g| g.alpha);
            let (azimuth, radius) = (2.0 * PI * u.x, (u.y / (1.0 - u.y).max(1e-12)).sqrt());
            let half = Vector3::new(ax * radius * azimuth.cos(), ay * radius * azimuth.sin(), 1.0).normalize();
            let eye = self.local(to_eye);
            half * (2.0 * half.dot(&eye)) - eye
        } else {
            let (azimuth, radius) = (2.0 * PI * u.x, u.y.sqrt());
            let up = (1.0 - u.y).max(0.0).sqrt();
            Vector3::new(radius * azimuth.cos(), radius * azimuth.sin(), up)
        };
        (light.z > 1e-6).then(|| self.world(&light).normalize())
    }
}

impl Gloss {
    fn fresnel(&self, cosine: f64) -> Colour {
        let rest = (1.0 - cosine).clamp(0.0, 1.0).powi(5);
        self.normal_reflectance + (Colour::repeat(1.0) - self.normal_reflectance) * rest
    }

    /// Density of the facets' normals.
    fn density(&self, half: &Vector3<f64>) -> f64 {
        let [ax, ay] = self.alpha;
        let length = Vector3::new(half.x / ax, half.y / ay, half.z).norm_squared();
        1.0 / (PI * ax * ay * length * length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface(base: f64, gloss: Option<Gloss>) -> SurfacePoint {
        let normal = Vector3::new(0.2, -0.3, 0.9).normalize();
        SurfacePoint {
            normal,
            tangent: across(&normal),
            base: Colour::repeat(base),
            gloss,
            medium: None,
        }
    }

    fn surfaces() -> [SurfacePoint; 3] {
        let gloss = |alpha, normal_reflectance| {
            Some(Gloss {
                alpha,
                normal_reflectance: Colour::repeat(normal_reflectance),
            })
        };
        [
            surface(0.8, None),
            surface(0.8, gloss([0.3, 0.3], 0.04)),
            surface(0.0, gloss([0.15, 0.5], 1.0)),
        ]
    }

    #[test]
    fn sampling_follows_its_density_and_no_surface_makes_light() {
        let side = 400;
        for surface in surfaces() {
            let eye = (surface.normal + surface.tangent * 0.8).normalize();
            let (mut sampled, mut summed) = (0.0, 0.0);
            for i in 0..side * side {
                let (x, y) = ((i % side) as f64 + 0.5, (i / side) as f64 + 0.5);
                let u = Vector2::new(x / side as f64, y / side as f64);
                // The same integral over the hemisphere by its own samples, and by uniform ones.
                let choice = ((i * 7919) % 1000) as f64 / 1000.0;
                if let Some(light) = surface.sample(&eye, choice, u) {
                    let cosine = surface.normal.dot(&light);
                    sampled += surface.reflect(&light, &eye).x * cosine / surface.density(&light, &eye);
                }
                let (azimuth, z) = (2.0 * PI * u.x, u.y);
                let flat = Vector3::new(
                    (1.0 - z * z).sqrt() * azimuth.cos(),
                    (1.0 - z * z).sqrt() * azimuth.sin(),
                    z,
                );
                summed += surface.reflect(&surface.world(&flat), &eye).x * z * 2.0 * PI;
            }
            let count = (side * side) as f64;
            let (sampled, summed) = (sampled / count, summed / count);
            assert!((sampled - summed).abs() < 0.01 * summed, "{sampled} {summed}");
            assert!(summed < 1.001, "{summed}");
        }
    }

    #[test]
    fn light_goes_both_ways_alike() {
        // Except for the base under a lobe, whose light enters by the one Fresnel term of the half vector: that is
        // symmetric too.
        for surface in surfaces() {
            let a = (surface.normal + surface.tangent * 0.4).normalize();
            let b = (surface.normal * 0.7 + across(&surface.tangent)).normalize();
            if surface.normal.dot(&b) > 0.0 {
                assert!((surface.reflect(&a, &b) - surface.reflect(&b, &a)).norm() < 1e-9);
            }
        }
    }
}
