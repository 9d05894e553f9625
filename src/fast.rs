//! Exponential and logarithm for loops over lanes: no branch, no call, the same bits on every machine. The coefficients
//! of both polynomials are those of Cephes (Moshier, `expf` and `logf`).

/// The number `1.5 · 2²³`: added to a number below 2²², it leaves the nearest whole number in the sum's low bits.
pub(crate) const MAGIC: f32 = 12_582_912.0;

/// Whole part of a number from 0 to below 2²², as a float and as an integer; avoids casts, which are slow in lanes.
#[inline(always)]
pub fn floor(x: f32) -> (f32, u32) {
    let nearest = (x + MAGIC) - MAGIC;
    let whole = if nearest > x { nearest - 1.0 } else { nearest };
    (whole, (whole + MAGIC).to_bits() & 0x003f_ffff)
}

/// An integer below 2²² as a float, without a cast.
#[inline(always)]
pub fn number(n: u32) -> f32 {
    f32::from_bits(MAGIC.to_bits() | n) - MAGIC
}

/// `e^x`, two units in the last place; saturates outside -87 to 88, keeps NaN.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    // Written so that NaN passes.
    let x = if x > 88.0 { 88.0 } else { x };
    let x = if x < -87.0 { -87.0 } else { x };
    let n = x * std::f32::consts::LOG2_E + MAGIC;
    let whole = n - MAGIC;
    // ln 2 in two parts, the first with few bits, so that the products are exact (Cody and Waite 1980).
    let r = x - whole * 0.693_359_4 + whole * 2.121_944_4e-4;
    let p = 0.166_666_55 + r * (0.041_665_795 + r * (0.008_333_452 + r * (0.001_398_2 + r * 1.987_569_1e-4)));
    let series = 1.0 + (r + (r * r) * (0.5 + r * p));
    f32::from_bits(series.to_bits().wrapping_add(n.to_bits() << 23))
}

/// `ln x` for finite `x > 1e-37`, two units in the last place; NaN for NaN.
#[inline(always)]
pub fn ln(x: f32) -> f32 {
    // x = m · 2^n with m in [√½, √2).
    let bits = x.to_bits().wrapping_sub(0x3f35_04f3);
    let n = ((bits as i32) >> 23) as f32;
    let m = f32::from_bits((bits & 0x007f_ffff).wrapping_add(0x3f35_04f3)) - 1.0;
    let square = m * m;
    let high = -1.242_014_1e-1 + m * (1.167_699_9e-1 + m * (-1.151_461e-1 + m * 7.037_683_6e-2));
    let p = 0.333_333_3
        + m * (-2.499_999_4e-1 + m * (2.000_071_4e-1 + m * (-1.666_805_8e-1 + m * (1.424_932_3e-1 + m * high))));
    let series = (m * square) * p - 0.5 * square - n * 2.121_944_4e-4;
    let sum = m + series + n * 0.693_359_4;
    if x.is_nan() { x } else { sum }
}

/// The logistic function `1 / (1 + e^-x)`, by [`exp`].
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_parts_are_those_of_the_number() {
        for n in 0..3_000_000u32 {
            let x = n as f32 / 7.0;
            assert_eq!(floor(x), (x.floor(), x as u32), "{x}");
        }
        assert_eq!(floor(4_194_303.0), (4_194_303.0, 4_194_303));
        assert!((0..5000).all(|n| number(n) == n as f32));
    }

    #[test]
    fn the_exponential_is_accurate_over_its_domain() {
        for i in -86_000..88_000 {
            let x = i as f32 * 1e-3;
            let (fast, exact) = (f64::from(exp(x)), f64::from(x).exp());
            assert!((fast - exact).abs() <= 2.4e-7 * exact, "{x}: {fast} against {exact}");
        }
        assert!(exp(f32::NAN).is_nan() && exp(1e9) > 1e38 && exp(-1e9) < 1e-37 && exp(f32::INFINITY) > 1e38);
    }

    #[test]
    fn the_logarithm_is_accurate_over_its_domain() {
        for i in 1..200_000 {
            let x = (i as f32 * 4e-4 - 40.0).exp();
            let (fast, exact) = (f64::from(ln(x)), f64::from(x).ln());
            assert!(
                (fast - exact).abs() <= 2.4e-7 * exact.abs() + 1e-9,
                "{x}: {fast} against {exact}"
            );
        }
        assert!(ln(f32::NAN).is_nan() && ln(1.0) == 0.0);
    }

    #[test]
    fn the_sigmoid_is_that_of_the_table() {
        for i in -300..300 {
            let x = i as f32 * 0.1;
            let exact = crate::gaussians::sigmoid(x);
            assert!((sigmoid(x) - exact).abs() <= 4e-7 * exact, "{x}");
        }
    }
}
