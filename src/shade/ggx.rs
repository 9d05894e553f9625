//! Microfacets as an anisotropic spherical Gaussian of the half vector (ARS-GS), corrected so that it is GGX.
//!
//! With `λ = 1/α_x² - 1` and `μ = 1/α_y² - 1`
//!
//! ```text
//! D(h) = √((1+λ)(1+μ)) / (π (1 + λ h_x² + μ h_y²)²)
//! G1(ω) = 2 n·ω / (n·ω + √(α_x² (x·ω)² + α_y² (y·ω)² + (n·ω)²))
//! ```
//!
//! The paper prints `D` without `1 +`, which has no bound at `h = n`, and `G1` with `λ`, `μ` and `h`, which masks
//! nothing. As corrected here, `D` of a unit vector is anisotropic GGX (Walter et al. 2007; Heitz 2014).

use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Density `D` of the facets that face the unit vector `h`, in the frame of the surface; widths `alpha` from 1e-3 to 1.
#[inline]
pub fn density(h: Vec3, alpha: [f32; 2]) -> f32 {
    // 1 + λ h_x² + μ h_y² of a unit vector, without the difference of large numbers.
    let (x, y) = (h.x / alpha[0], h.y / alpha[1]);
    let sum = x * x + y * y + h.z * h.z;
    FRAC_1_PI / (alpha[0] * alpha[1] * sum * sum)
}

/// Masking `G1`: visible share of the facets, 0 to 1, from the unit direction `w` in the frame of the surface; zero
/// from below.
#[inline]
pub fn masking(w: Vec3, alpha: [f32; 2]) -> f32 {
    let cosine = w.z.max(0.0);
    let stretched = Vec3::new(alpha[0] * w.x, alpha[1] * w.y, w.z).length();
    2.0 * cosine / (cosine + stretched).max(1e-12)
}

/// Schlick's Fresnel reflectance (1994) with reflectance `f0` at normal incidence, at the cosine between light and half
/// vector.
#[inline]
pub fn schlick(f0: f32, cosine: f32) -> f32 {
    f0 + (1.0 - f0) * (1.0 - cosine).clamp(0.0, 1.0).powi(5)
}

/// `D G / (4 (n·l) (n·v))` times `n·l`, for unit vectors to light and eye in the frame of the surface: the reflected
/// share without Fresnel's term. Bounded by 1/(4 α_x α_y) times masking, at any angle.
#[inline]
pub fn reflected(to_light: Vec3, to_eye: Vec3, alpha: [f32; 2]) -> f32 {
    if to_light.z <= 0.0 || to_eye.z <= 0.0 {
        return 0.0;
    }
    let half = (to_light + to_eye).normalize_or(Vec3::Z);
    let stretched = |w: Vec3| Vec3::new(alpha[0] * w.x, alpha[1] * w.y, w.z).length();
    // G1(l) G1(v) / (4 n·l n·v) = 1 / ((n·l + ...) (n·v + ...))
    let visible = 1.0 / ((to_light.z + stretched(to_light)) * (to_eye.z + stretched(to_eye)));
    density(half, alpha) * visible * to_light.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::f64::consts::PI;

    fn directions() -> Vec<DVec3> {
        let mut all = vec![DVec3::Z];
        for angle in [1e-4, 1e-3, 1e-2, 0.1, 0.5, 1.0, 1.5] {
            for k in 0..7 {
                let (azimuth, sine) = (0.2 + 0.9 * f64::from(k), f64::sin(angle));
                all.push(DVec3::new(sine * azimuth.cos(), sine * azimuth.sin(), f64::cos(angle)));
            }
        }
        all
    }

    const ALPHAS: [f32; 6] = [1e-3, 5e-3, 0.03, 0.2, 0.7, 1.0];

    #[test]
    fn the_lobe_is_anisotropic_ggx() {
        for ax in ALPHAS {
            for ay in ALPHAS {
                for h in directions() {
                    let h = h.as_vec3();
                    let found = f64::from(density(h, [ax, ay]));
                    // The textbook's: tangents of the angle to the normal, in f64.
                    let (h, ax, ay) = (h.as_dvec3().normalize(), f64::from(ax), f64::from(ay));
                    let tangent = (h.x / h.z / ax).powi(2) + (h.y / h.z / ay).powi(2);
                    let ggx = 1.0 / (PI * ax * ay * h.z.powi(4) * (1.0 + tangent).powi(2));
                    // The form of the paper, without the `1 +`.
                    let (lambda, mu) = (1.0 / (ax * ax) - 1.0, 1.0 / (ay * ay) - 1.0);
                    let sum = 1.0 + lambda * h.x * h.x + mu * h.y * h.y;
                    let asg = ((1.0 + lambda) * (1.0 + mu)).sqrt() / (PI * sum * sum);
                    assert!((asg - ggx).abs() < 1e-9 * ggx, "{ax} {ay} {h}: {asg} {ggx}");
                    assert!((found - ggx).abs() < 1e-6 * ggx, "{ax} {ay} {h}: {found} {ggx}");
                }
            }
        }
    }

    #[test]
    fn facets_cover_the_surface_once_and_no_more_is_seen_than_there_is() {
        // ∫ D (n·h) dh = 1, and ∫ G1(v) D max(v·h, 0) dh = n·v.
        let steps = 1500;
        for alpha in [[0.3f32, 0.3], [0.15, 0.5], [1.0, 1.0]] {
            let view = Vec3::new(0.6, 0.3, 0.742).normalize();
            let (mut flat, mut seen) = (0.0, 0.0);
            for i in 0..steps {
                let z = (i as f64 + 0.5) / f64::from(steps);
                for j in 0..256 {
                    let (azimuth, sine) = (2.0 * PI * (f64::from(j) + 0.5) / 256.0, (1.0 - z * z).sqrt());
                    let h = DVec3::new(sine * azimuth.cos(), sine * azimuth.sin(), z).as_vec3();
                    let area = 2.0 * PI / (f64::from(steps) * 256.0);
                    flat += f64::from(density(h, alpha)) * z * area;
                    seen += f64::from(density(h, alpha) * view.dot(h).max(0.0)) * area;
                }
            }
            assert!((flat - 1.0).abs() < 1e-3, "{alpha:?} {flat}");
            let masked = seen * f64::from(masking(view, alpha));
            assert!((masked - f64::from(view.z)).abs() < 2e-3, "{alpha:?} {masked}");
        }
    }

    #[test]
    fn what_reflects_is_the_product_of_its_parts() {
        let (light, eye) = (
            Vec3::new(0.3, -0.2, 0.8).normalize(),
            Vec3::new(-0.7, 0.1, 0.3).normalize(),
        );
        let alpha = [0.2, 0.6];
        let half = (light + eye).normalize();
        let parts = density(half, alpha) * masking(light, alpha) * masking(eye, alpha) / (4.0 * eye.z);
        assert!((reflected(light, eye, alpha) - parts).abs() < 1e-5 * parts);
        assert!(reflected(-light, eye, alpha) == 0.0);
        assert!((schlick(0.04, 1.0) - 0.04).abs() < 1e-7 && schlick(0.04, 0.0) == 1.0);
    }
}
