//! Subsurface scattering of a translucent half space: the standard dipole (Jensen et al. 2001).
//!
//! ```text
//! R(r) = α'/(4π) [ z_r (1 + σ_tr d_r) e^(-σ_tr d_r) / d_r³  +  z_v (1 + σ_tr d_v) e^(-σ_tr d_v) / d_v³ ]
//! ```
//!
//! with `σ_t' = σ_s' + σ_a`, `α' = σ_s'/σ_t'`, `σ_tr = √(3 σ_a σ_t')`, `z_r = 1/σ_t'`, `z_v = z_r (1 + 4A/3)` and
//! `d² = r² + z²`. The code published with SSD-GS multiplies the second term by `z_r` once more, which gives that term
//! a wrong unit. The form here integrates to the reflectance in closed form.

use std::f32::consts::PI;

/// Index of refraction of the scattering medium (SSD-GS).
pub const ETA: f32 = 1.3;
/// `(1 + F)/(1 - F)` of the internally reflected share `F(η) = -1.440/η² + 0.710/η + 0.668 + 0.0636 η` at [`ETA`].
const A: f32 = 2.602_064;
/// Largest coefficient, per length: beyond it a surface lets no light in. The least extinction is its inverse.
const MOST: f32 = 1e9;
/// Depths of transport beyond which nothing arrives: `e^-80` is 2e-35.
const FAR: f32 = 80.0;

/// Optical coefficients of the medium under a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Medium {
    /// Reduced scattering coefficient, per length.
    pub scattering: f32,
    /// Absorption coefficient, per length.
    pub absorption: f32,
}

/// The profile at one distance, and its gradients.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Scattered {
    /// Light that leaves per light that enters, per area.
    pub value: f32,
    /// Gradient to the distance.
    pub distance: f32,
    /// Gradient to the scattering coefficient.
    pub scattering: f32,
    /// Gradient to the absorption coefficient.
    pub absorption: f32,
}

/// One pole: `z (1 + s d) e^(-s d) / d³` with `d² = r² + z²`, and its gradients to r, z and s².
///
/// The gradient is to s² because s is a root of the absorption: `d[(1 + x) e^-x] = -½ e^-x d(x²)` has a limit at zero
/// absorption.
#[inline]
fn pole(r: f32, z: f32, s: f32) -> (f32, f32, f32, f32) {
    let square = r * r + z * z;
    let d = square.sqrt();
    if s * d > FAR {
        return (0.0, 0.0, 0.0, 0.0);
    }
    let falling = (-s * d).exp() / (d * square);
    let grown = 1.0 + s * d;
    // d/dd [(1 + s d) e^(-s d) d⁻³] = -e^(-s d) d⁻⁴ (s² d² + 3 s d + 3)
    let by_d = -z * falling / d * (s * s * square + 3.0 * grown);
    (
        z * grown * falling,
        by_d * (r / d),
        grown * falling + by_d * (z / d),
        -0.5 * z * falling * square,
    )
}

impl Medium {
    /// The profile at distance `r`, which may be zero, in the unit of length of the coefficients; these may be zero or
    /// infinite.
    #[inline]
    pub fn profile(&self, r: f32) -> Scattered {
        let within = |x: f32| if x < MOST { x } else { MOST };
        let (s, a) = (within(self.scattering), within(self.absorption));
        let extinction = (s + a).max(1.0 / MOST);
        let albedo = s / extinction;
        let depth = 1.0 / extinction;
        let transport = (3.0 * a * extinction).sqrt();
        let virtual_depth_ratio = 1.0 + 4.0 / 3.0 * A;
        let (real, real_r, real_z, real_s) = pole(r, depth, transport);
        let (virt, virt_r, virt_z, virt_s) = pole(r, depth * virtual_depth_ratio, transport);
        let (unit, sum) = (albedo / (4.0 * PI), real + virt);
        let to_depth = unit * (real_z + virt_z * virtual_depth_ratio);
        let to_transport_square = unit * (real_s + virt_s);
        // Both coefficients are in the extinction: d depth = -depth², d transport² = 3 a.
        let both = -to_depth * depth * depth + to_transport_square * 3.0 * a;
        let to_albedo = sum / (4.0 * PI);
        Scattered {
            value: unit * sum,
            distance: unit * (real_r + virt_r),
            scattering: to_albedo * (a * depth) * depth + both,
            absorption: -to_albedo * (s * depth) * depth + both + to_transport_square * 3.0 * extinction,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: [f32; 5] = [0.05, 0.3, 1.0, 2.05, 10.0];

    /// All light that leaves per light that enters: the integral of the profile over the plane, in closed form.
    fn reflectance(medium: &Medium) -> f32 {
        let albedo = medium.scattering / (medium.scattering + medium.absorption);
        let q = (3.0 * (1.0 - albedo)).sqrt();
        0.5 * albedo * (1.0 + (-4.0 / 3.0 * A * q).exp()) * (-q).exp()
    }

    /// `∫ 2π r R(r) dr` with `r = z sinh t`: Simpson's rule is exact to rounding on the smooth, falling integrand.
    fn integral(medium: &Medium) -> f64 {
        let (depth, steps, end) = (1.0 / f64::from(medium.scattering + medium.absorption), 4000, 14.0);
        let at = |n: usize| {
            let t = end * n as f64 / f64::from(steps);
            let r = depth * t.sinh();
            let density = f64::from(medium.profile(r as f32).value);
            2.0 * std::f64::consts::PI * r * density * depth * t.cosh()
        };
        let weight = |n: usize| if n % 2 == 1 { 4.0 } else { 2.0 };
        let inner: f64 = (1..steps as usize).map(|n| weight(n) * at(n)).sum();
        (at(0) + inner + at(steps as usize)) * end / f64::from(steps) / 3.0
    }

    #[test]
    fn the_profile_integrates_to_its_closed_form() {
        for scattering in GRID {
            for absorption in GRID {
                let medium = Medium { scattering, absorption };
                let (found, exact) = (integral(&medium), f64::from(reflectance(&medium)));
                assert!(
                    (found - exact).abs() < 1e-6 * exact,
                    "{medium:?}: {found} {exact} {:e}",
                    found / exact - 1.0
                );
            }
        }
    }

    #[test]
    fn the_closed_form_has_its_published_values() {
        for (scattering, absorption, expected) in [(2.0, 0.05, 0.518), (10.0, 0.1, 0.646)] {
            let found = reflectance(&Medium { scattering, absorption });
            assert!((found - expected).abs() < 1e-3, "{found}");
        }
        let f = -1.440 / (ETA * ETA) + 0.710 / ETA + 0.668 + 0.0636 * ETA;
        assert!(((1.0 + f) / (1.0 - f) - A).abs() < 2e-6);
    }

    /// The profile as printed, in f64.
    fn printed(s: f64, a: f64, r: f64) -> f64 {
        let t = s + a;
        let tr = (3.0 * a * t).sqrt();
        let pole = |z: f64| {
            let d = (r * r + z * z).sqrt();
            z * (1.0 + tr * d) * (-tr * d).exp() / d.powi(3)
        };
        s / t / (4.0 * std::f64::consts::PI) * (pole(1.0 / t) + pole((1.0 + 4.0 / 3.0 * f64::from(A)) / t))
    }

    #[test]
    fn value_and_gradients_are_those_of_the_printed_form() {
        let h = 1e-6;
        for s in GRID.map(f64::from) {
            for a in GRID.map(f64::from) {
                for r in [1e-3, 0.1, 0.7, 3.1] {
                    let medium = Medium {
                        scattering: s as f32,
                        absorption: a as f32,
                    };
                    let (found, exact) = (medium.profile(r as f32), printed(s, a, r));
                    assert!((f64::from(found.value) - exact).abs() < 2e-5 * exact);
                    let numeric = [
                        printed(s, a, r + h) - printed(s, a, r - h),
                        printed(s + h, a, r) - printed(s - h, a, r),
                        printed(s, a + h, r) - printed(s, a - h, r),
                    ]
                    .map(|d| d / (2.0 * h));
                    for (k, analytic) in [found.distance, found.scattering, found.absorption]
                        .into_iter()
                        .enumerate()
                    {
                        let scale = numeric[k].abs() + 1e-2 * exact;
                        assert!(
                            (f64::from(analytic) - numeric[k]).abs() < 1e-3 * scale,
                            "{s} {a} {r} {k}: {analytic} {}",
                            numeric[k]
                        );
                    }
                }
            }
        }
    }
}
