//! The twenty-term cubic of RPC00B, its monomials and its derivatives.

/// The monomials of normalised longitude, latitude and height, in RPC00B order.
pub(crate) type Monomials = [f64; 20];

/// Monomials `1 L P H LP LH PH LL PP HH LPH LLL LPP LHH LLP PPP PHH LLH PPH HHH` of normalised longitude, latitude and
/// height.
#[inline]
pub(crate) fn monomials([l, p, h]: [f64; 3]) -> Monomials {
    let (ll, pp, hh) = (l * l, p * p, h * h);
    let lp = l * p;
    [
        1.0,
        l,
        p,
        h,
        lp,
        l * h,
        p * h,
        ll,
        pp,
        hh,
        lp * h,
        ll * l,
        l * pp,
        l * hh,
        ll * p,
        pp * p,
        p * hh,
        ll * h,
        pp * h,
        hh * h,
    ]
}

/// Value of the polynomial. Four partial sums in a fixed order can be vectorised and give the same result on every
/// machine.
#[inline]
pub(crate) fn value(coefficients: &[f64; 20], m: &Monomials) -> f64 {
    let mut sums = [0.0; 4];
    for (c, m) in coefficients.chunks_exact(4).zip(m.chunks_exact(4)) {
        for lane in 0..4 {
            sums[lane] += c[lane] * m[lane];
        }
    }
    (sums[0] + sums[2]) + (sums[1] + sums[3])
}

/// Derivatives of the polynomial with respect to normalised longitude and latitude.
#[inline]
pub(crate) fn gradient_horizontal(c: &[f64; 20], m: &Monomials) -> [f64; 2] {
    [
        c[1] + c[4] * m[2]
            + c[5] * m[3]
            + 2.0 * c[7] * m[1]
            + c[10] * m[6]
            + 3.0 * c[11] * m[7]
            + c[12] * m[8]
            + c[13] * m[9]
            + 2.0 * c[14] * m[4]
            + 2.0 * c[17] * m[5],
        c[2] + c[4] * m[1]
            + c[6] * m[3]
            + 2.0 * c[8] * m[2]
            + c[10] * m[5]
            + 2.0 * c[12] * m[4]
            + c[14] * m[7]
            + 3.0 * c[15] * m[8]
            + c[16] * m[9]
            + 2.0 * c[18] * m[6],
    ]
}

/// Derivatives of the polynomial with respect to normalised longitude, latitude and height.
#[inline]
pub(crate) fn gradient(c: &[f64; 20], m: &Monomials) -> [f64; 3] {
    let [along_l, along_p] = gradient_horizontal(c, m);
    let along_h = c[3]
        + c[5] * m[1]
        + c[6] * m[2]
        + 2.0 * c[9] * m[3]
        + c[10] * m[4]
        + 2.0 * c[13] * m[5]
        + 2.0 * c[16] * m[6]
        + c[17] * m[7]
        + c[18] * m[8]
        + 3.0 * c[19] * m[9];
    [along_l, along_p, along_h]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradient_is_the_derivative_of_the_value() {
        let coefficients: [f64; 20] = std::array::from_fn(|i| 0.3 + (i as f64 * 1.7).sin());
        let at = [0.31, -0.72, 0.45];
        let step = 1e-5;
        let analytic = gradient(&coefficients, &monomials(at));
        for axis in 0..3 {
            let mut high = at;
            let mut low = at;
            high[axis] += step;
            low[axis] -= step;
            let numeric =
                (value(&coefficients, &monomials(high)) - value(&coefficients, &monomials(low))) / (2.0 * step);
            assert!(
                (numeric - analytic[axis]).abs() < 1e-8,
                "axis {axis}: {numeric} against {}",
                analytic[axis]
            );
        }
    }

    #[test]
    fn each_coefficient_multiplies_the_monomial_of_the_standard() {
        let [l, p, h] = [2.0, 3.0, 5.0];
        let expected = [
            1.0,
            l,
            p,
            h,
            l * p,
            l * h,
            p * h,
            l * l,
            p * p,
            h * h,
            l * p * h,
            l * l * l,
            l * p * p,
            l * h * h,
            l * l * p,
            p * p * p,
            p * h * h,
            l * l * h,
            p * p * h,
            h * h * h,
        ];
        assert_eq!(monomials([l, p, h]), expected);
    }
}
