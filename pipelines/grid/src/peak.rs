//! Peak of a sampled function between its samples.

use crate::statistics::Real;

/// Offset, in steps within ±½, of the top of the parabola through three values one step apart from the middle one;
/// `None` where it has no top. The bottom is the top of the negated values.
pub fn parabola_top<T: Real>([before, here, after]: [T; 3]) -> Option<T> {
    let (half, two) = (T::from(0.5), T::from(2.0));
    let bend = two * here - before - after;
    let offset = half * (after - before) / bend;
    (bend > T::from(0.0)).then(|| match offset {
        beyond if beyond > half => half,
        beyond if beyond < -half => -half,
        inside => inside,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_top_is_that_of_the_parabola_and_stays_within_half_a_step() {
        let at = |x: f64| 3.0 - (x - 0.2) * (x - 0.2);
        let top = parabola_top([at(-1.0), at(0.0), at(1.0)]).expect("a top");
        assert!((top - 0.2).abs() < 1e-12);
        assert_eq!(parabola_top([0.0f32, 1.0, 1.9]), Some(0.5));
        assert_eq!(parabola_top([1.9f32, 1.0, 0.0]), Some(-0.5));
    }

    #[test]
    fn a_valley_a_line_and_unknown_values_have_no_top() {
        for values in [[1.0f32, 0.0, 1.0], [0.0, 1.0, 2.0], [f32::NAN, 1.0, 0.0]] {
            assert_eq!(parabola_top(values), None);
        }
    }
}
