//! The split sum: the reflectance of a glossy surface under uniform light, `F0 F1 + F2` (Karis 2013).
//!
//! `F1 = 1/N Σ (1 - F_c) G_v`, `F2 = 1/N Σ F_c G_v` over facets drawn from GGX, with `F_c = (1 - v·h)⁵`,
//! `G_v = G v·h / (n·h n·v)`, `α = roughness²` and Schlick's masking with `k = α/2`. Karis' analytic fit is off by up
//! to 0.17, so the sums are baked at first use.

use rayon::prelude::*;
use std::f64::consts::PI;
use std::sync::OnceLock;

/// Nodes along each side of the table, at roughness and cosine from 0 to 1.
const NODES: usize = 65;
/// Facets per node: this many squared.
const SAMPLES: usize = 40;

/// Both sums, and their gradients.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SplitSum {
    /// Values of `F1` and `F2`.
    pub values: [f32; 2],
    /// Gradients of `F1` and `F2` to the roughness.
    pub roughness: [f32; 2],
    /// Gradients of `F1` and `F2` to the cosine between normal and eye.
    pub cosine: [f32; 2],
}

/// Both sums in f64 with `side²` facets, by the midpoint rule on the square that facets are drawn from, finer where
/// they are steep.
pub fn integrate(roughness: f64, cosine: f64, side: usize) -> [f64; 2] {
    let (alpha, cosine) = (roughness * roughness, cosine.max(1e-4));
    let k = 0.5 * alpha;
    let masking = |c: f64| c / (c * (1.0 - k) + k);
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let mut sums = [0.0; 2];
    for i in 0..side {
        let rest = 1.0 - (i as f64 + 0.5) / side as f64;
        let (u, weight) = (1.0 - rest.powi(3), 3.0 * rest * rest);
        let up = ((1.0 - u) / (1.0 + (alpha * alpha - 1.0) * u)).sqrt();
        let aside = (1.0 - up * up).max(0.0).sqrt();
        for j in 0..side {
            let azimuth = PI * (j as f64 + 0.5) / side as f64;
            let seen = sine * aside * azimuth.cos() + cosine * up;
            let light = 2.0 * seen * up - cosine;
            if light > 0.0 && seen > 0.0 {
                let visible = masking(cosine) * masking(light) * seen / (up * cosine) * weight;
                let grazing = (1.0 - seen).powi(5);
                sums[0] += (1.0 - grazing) * visible;
                sums[1] += grazing * visible;
            }
        }
    }
    sums.map(|s| s / (side * side) as f64)
}

fn table() -> &'static [[f32; 2]] {
    static TABLE: OnceLock<Vec<[f32; 2]>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let share = |n: usize| n as f64 / (NODES - 1) as f64;
        (0..NODES * NODES)
            .into_par_iter()
            .map(|n| integrate(share(n / NODES), share(n % NODES).powi(2), SAMPLES).map(|s| s as f32))
            .collect()
    })
}

/// Both sums at a roughness and a cosine from 0 to 1, bilinear in the roughness and the root of the cosine, which
/// resolves grazing angles.
pub fn look_up(roughness: f32, cosine: f32) -> SplitSum {
    let table = table();
    let last = (NODES - 1) as f32;
    let root = cosine.clamp(1e-6, 1.0).sqrt();
    let (x, y) = (roughness.clamp(0.0, 1.0) * last, root * last);
    let (i, j) = ((x as usize).min(NODES - 2), (y as usize).min(NODES - 2));
    let (u, v) = (x - i as f32, y - j as f32);
    let at = |i: usize, j: usize, k: usize| table[i * NODES + j][k];
    let mut out = SplitSum::default();
    for k in 0..2 {
        let (a, b, c, d) = (at(i, j, k), at(i, j + 1, k), at(i + 1, j, k), at(i + 1, j + 1, k));
        let (near, far) = (a + (b - a) * v, c + (d - c) * v);
        out.values[k] = near + (far - near) * u;
        out.roughness[k] = (far - near) * last;
        out.cosine[k] = ((b - a) * (1.0 - u) + (d - c) * u) * last * 0.5 / root;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sums_have_their_published_values() {
        // Expected values from 1024 random facets.
        for (roughness, cosine, expected) in [
            (0.2, 0.5, [0.9282, 0.0310]),
            (0.2, 0.05, [0.2665, 0.3817]),
            (0.8, 0.5, [0.5418, 0.0057]),
            (0.8, 1.0, [0.5370, 0.0000]),
        ] {
            let found = look_up(roughness, cosine).values;
            for k in 0..2 {
                assert!(
                    (found[k] - expected[k]).abs() < 4e-3,
                    "{roughness} {cosine}: {found:?} {expected:?}"
                );
            }
        }
    }

    #[test]
    fn the_table_is_the_integral() {
        for roughness in [0.07f32, 0.33, 0.61, 0.97] {
            for cosine in [0.03f32, 0.2, 0.55, 0.9] {
                let exact = integrate(f64::from(roughness), f64::from(cosine), 512);
                let found = look_up(roughness, cosine);
                for k in 0..2 {
                    assert!(
                        (f64::from(found.values[k]) - exact[k]).abs() < 6e-3,
                        "{roughness} {cosine}: {found:?} {exact:?}"
                    );
                }
                let step = 1e-4;
                let numeric = |hi: SplitSum, lo: SplitSum, k: usize| (hi.values[k] - lo.values[k]) / (2.0 * step);
                for k in 0..2 {
                    let by_cosine = numeric(look_up(roughness, cosine + step), look_up(roughness, cosine - step), k);
                    assert!(
                        (by_cosine - found.cosine[k]).abs() < 0.02 * (1.0 + by_cosine.abs()),
                        "{by_cosine}"
                    );
                    let by_roughness = numeric(look_up(roughness + step, cosine), look_up(roughness - step, cosine), k);
                    assert!((by_roughness - found.roughness[k]).abs() < 0.02 * (1.0 + by_roughness.abs()));
                }
            }
        }
    }
}
