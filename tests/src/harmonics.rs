//! Real spherical harmonics from their definition, in f64.

use nalgebra::Vector3;
use std::f64::consts::PI;

/// Associated Legendre functions with the Condon–Shortley phase, by their recurrences.
fn legendre(l: usize, m: usize, x: f64) -> f64 {
    let root = (1.0 - x * x).max(0.0).sqrt();
    let mut at_m = 1.0;
    for k in 1..=m {
        at_m *= -((2 * k - 1) as f64) * root;
    }
    if l == m {
        return at_m;
    }
    let (mut below, mut at) = (at_m, x * (2 * m + 1) as f64 * at_m);
    for k in m + 2..=l {
        let next = ((2 * k - 1) as f64 * x * at - (k + m - 1) as f64 * below) / (k - m) as f64;
        (below, at) = (at, next);
    }
    at
}

/// Real spherical harmonic of degree `l` and order `m`, from `-l` to `l`, in the unit direction `d`.
pub fn harmonic(l: usize, m: i32, d: &Vector3<f64>) -> f64 {
    let order = m.unsigned_abs() as usize;
    let factorial = |n: usize| (1..=n).map(|k| k as f64).product::<f64>();
    let norm = ((2 * l + 1) as f64 / (4.0 * PI) * factorial(l - order) / factorial(l + order)).sqrt();
    let (azimuth, p) = (d.y.atan2(d.x), norm * legendre(l, order, d.z));
    match m {
        0 => p,
        m if m > 0 => 2f64.sqrt() * p * (f64::from(m) * azimuth).cos(),
        m => 2f64.sqrt() * p * (f64::from(-m) * azimuth).sin(),
    }
}

/// All real spherical harmonics up to `degree` in the unit direction `d`, by degree, then by order.
pub fn harmonics(degree: usize, d: &Vector3<f64>) -> Vec<f64> {
    (0..=degree)
        .flat_map(|l| (-(l as i32)..=l as i32).map(move |m| harmonic(l, m, d)))
        .collect()
}
