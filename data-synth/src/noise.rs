//! Hashes, value noise and random streams: the same numbers on every thread and machine.

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

/// Mixes two words into one (the finaliser of SplitMix64 over their combination).
pub(crate) fn hash2(a: u64, b: u64) -> u64 {
    let mut z = a.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ b.wrapping_add(0xD1B5_4A32_D192_ED03).rotate_left(29);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// Separate random stream for each `label` of a seed, so that a change in one place moves nothing elsewhere.
pub(crate) fn stream(seed: u64, label: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(hash2(seed, label))
}

/// Uniform number in [0, 1) from a hash.
pub(crate) fn unit(hash: u64) -> f64 {
    (hash >> 11) as f64 / (1u64 << 53) as f64
}

/// Standard normal number from a hash, by the transform of Box and Muller.
pub(crate) fn normal(hash: u64) -> f64 {
    let u = 1.0 - unit(hash);
    let v = unit(hash2(hash, 0x5EED));
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Value at a lattice point, in [-1, 1).
fn lattice(seed: u32, i: i64, j: i64) -> f64 {
    let mut h = (i as u32).wrapping_mul(0x85EB_CA6B) ^ (j as u32).wrapping_mul(0xC2B2_AE35) ^ seed;
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    h ^= h >> 15;
    f64::from(h) / 2_147_483_648.0 - 1.0
}

/// Smooth noise of unit lattice spacing, in [-1, 1).
pub(crate) fn noise(seed: u32, x: f64, y: f64) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let (fx, fy) = (x - i, y - j);
    let (sx, sy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
    let (i, j) = (i as i64, j as i64);
    let low = lattice(seed, i, j) * (1.0 - sx) + lattice(seed, i + 1, j) * sx;
    let high = lattice(seed, i, j + 1) * (1.0 - sx) + lattice(seed, i + 1, j + 1) * sx;
    low * (1.0 - sy) + high * sy
}

/// A different constant in each unit cell, in [-1, 1).
pub(crate) fn cell_noise(seed: u32, x: f64, y: f64) -> f64 {
    lattice(seed, x.floor() as i64, y.floor() as i64)
}

/// Sum of octaves of [`noise`] from `wavelength` (in the units of `x` and `y`) downwards, each about half as long and
/// half as strong as the one before; about [-1, 1].
pub(crate) fn fractal(seed: u32, x: f64, y: f64, wavelength: f64, octaves: u32) -> f64 {
    let (mut sum, mut strength, mut scale) = (0.0, 1.0, 1.0 / wavelength);
    for octave in 0..octaves {
        let seed = seed.wrapping_add(octave.wrapping_mul(0x9E37_79B1));
        sum += strength * noise(seed, x * scale, y * scale);
        strength *= 0.5;
        scale *= 2.03;
    }
    sum * 0.7
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(crate) fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_stays_in_range_and_is_continuous() {
        for k in 0..2000 {
            let (x, y) = (f64::from(k) * 0.173 - 150.0, f64::from(k) * -0.091);
            let here = noise(7, x, y);
            assert!((-1.0..=1.0).contains(&here));
            assert!((noise(7, x + 1e-7, y) - here).abs() < 1e-5);
        }
    }

    #[test]
    fn normal_has_zero_mean_and_unit_variance() {
        let n = 20_000;
        let draws: Vec<f64> = (0..n).map(|k| normal(hash2(3, k))).collect();
        let mean = draws.iter().sum::<f64>() / n as f64;
        let variance = draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n as f64;
        assert!(mean.abs() < 0.03, "{mean}");
        assert!((variance - 1.0).abs() < 0.04, "{variance}");
    }

    #[test]
    fn streams_of_different_labels_differ() {
        use rand::RngExt;
        let a: u64 = stream(1, 1).random();
        assert_ne!(a, stream(1, 2).random::<u64>());
        assert_eq!(a, stream(1, 1).random::<u64>());
    }
}
