//! Real spherical harmonics to degree 3, as polynomials of a unit direction.
//!
//! Order and signs are those of Gaussian splatting files (`f_dc`, `f_rest`): by degree, then by order from `-l` to `l`,
//! with the Condon–Shortley phase (Sloan, "Stupid Spherical Harmonics Tricks", 2008, appendix A2).

use glam::Vec3;

/// Largest degree of the functions.
pub const MAX_DEGREE: usize = 3;
/// Number of functions to degree 3.
pub const MAX_FUNCTIONS: usize = 16;
/// Value of the constant function, `1 / (2 √π)`.
pub const C0: f32 = 0.282_094_8;
const C1: f32 = 0.488_602_52;
const C2: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_24];
const C3: [f32; 4] = [0.590_043_6, 2.890_611_4, 0.457_045_8, 0.373_176_34];
const C3_5: f32 = 1.445_305_7;

/// Number of functions of degrees 0 to `degree`.
pub const fn functions(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// Values of the functions to degree 3 in the unit direction `d`.
#[inline]
pub fn basis(d: Vec3) -> [f32; MAX_FUNCTIONS] {
    let Vec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C0,
        -C1 * y,
        C1 * z,
        -C1 * x,
        C2[0] * x * y,
        -C2[0] * y * z,
        C2[1] * (2.0 * zz - xx - yy),
        -C2[0] * x * z,
        C2[2] * (xx - yy),
        -C3[0] * y * (3.0 * xx - yy),
        C3[1] * x * y * z,
        -C3[2] * y * (4.0 * zz - xx - yy),
        C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -C3[2] * x * (4.0 * zz - xx - yy),
        C3_5 * z * (xx - yy),
        -C3[0] * x * (xx - 3.0 * yy),
    ]
}

/// Gradients of the polynomials of [`basis`] to `d`; along the sphere, those of the functions.
#[inline]
pub fn basis_gradients(d: Vec3) -> [Vec3; MAX_FUNCTIONS] {
    let Vec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let v = Vec3::new;
    [
        Vec3::ZERO,
        v(0.0, -C1, 0.0),
        v(0.0, 0.0, C1),
        v(-C1, 0.0, 0.0),
        v(y, x, 0.0) * C2[0],
        v(0.0, z, y) * -C2[0],
        v(-2.0 * x, -2.0 * y, 4.0 * z) * C2[1],
        v(z, 0.0, x) * -C2[0],
        v(2.0 * x, -2.0 * y, 0.0) * C2[2],
        v(6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0) * -C3[0],
        v(y * z, x * z, x * y) * C3[1],
        v(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z) * -C3[2],
        v(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy) * C3[3],
        v(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z) * -C3[2],
        v(2.0 * x * z, -2.0 * y * z, xx - yy) * C3_5,
        v(3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0) * -C3[0],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::f64::consts::PI;

    /// Associated Legendre functions with the Condon–Shortley phase, by their recurrences.
    fn legendre(l: usize, m: usize, x: f64) -> f64 {
        let root = (1.0 - x * x).max(0.0).sqrt();
        let mut pmm = 1.0;
        for k in 1..=m {
            pmm *= -((2 * k - 1) as f64) * root;
        }
        if l == m {
            return pmm;
        }
        let (mut below, mut at) = (pmm, x * (2 * m + 1) as f64 * pmm);
        for k in m + 2..=l {
            let next = ((2 * k - 1) as f64 * x * at - (k + m - 1) as f64 * below) / (k - m) as f64;
            (below, at) = (at, next);
        }
        at
    }

    /// The definition, in f64.
    fn harmonic(l: usize, m: i32, d: DVec3) -> f64 {
        let order = m.unsigned_abs() as usize;
        let factorial = |n: usize| (1..=n).map(|k| k as f64).product::<f64>();
        let norm = ((2 * l + 1) as f64 / (4.0 * PI) * factorial(l - order) / factorial(l + order)).sqrt();
        let azimuth = d.y.atan2(d.x);
        let p = norm * legendre(l, order, d.z);
        match m {
            0 => p,
            m if m > 0 => 2f64.sqrt() * p * (f64::from(m) * azimuth).cos(),
            m => 2f64.sqrt() * p * (f64::from(-m) * azimuth).sin(),
        }
    }

    fn directions() -> impl Iterator<Item = DVec3> {
        (0..40).map(|i| {
            let (z, a) = (1.0 - (2 * i + 1) as f64 / 40.0, 2.399_963 * i as f64);
            DVec3::new((1.0 - z * z).sqrt() * a.cos(), (1.0 - z * z).sqrt() * a.sin(), z)
        })
    }

    #[test]
    fn the_polynomials_are_the_definition() {
        for d in directions() {
            let values = basis(d.as_vec3());
            for l in 0..=MAX_DEGREE {
                for m in -(l as i32)..=l as i32 {
                    let value = values[(l * l + l).wrapping_add_signed(m as isize)];
                    assert!((f64::from(value) - harmonic(l, m, d)).abs() < 1e-6, "{l} {m}");
                }
            }
        }
    }

    #[test]
    fn gradients_along_the_sphere_match_central_differences() {
        let step = 1e-5;
        for d in directions() {
            let gradients = basis_gradients(d.as_vec3());
            let across = d.any_orthonormal_vector();
            let (hi, lo) = ((d + across * step).normalize(), (d - across * step).normalize());
            for l in 0..=MAX_DEGREE {
                for m in -(l as i32)..=l as i32 {
                    let numeric = (harmonic(l, m, hi) - harmonic(l, m, lo)) / (2.0 * step);
                    let at = (l * l + l).wrapping_add_signed(m as isize);
                    let analytic = f64::from(gradients[at].dot(across.as_vec3()));
                    assert!((numeric - analytic).abs() < 1e-5, "{l} {m}: {numeric} {analytic}");
                }
            }
        }
    }
}
