//! Medians, quantiles and robust spreads, and the workspace's only definition of a median.
//!
//! Of an even number of values three numbers are called the median. [`lower_median`] and [`upper_median`] are values
//! that were measured; [`median`], the mean of the two, is the one that statistics of errors report. Code that picks
//! one picks it by name.
//!
//! All functions order values by [`f64::total_cmp`], so a result depends on the values alone and never on their order.
//! A `NaN` is a value like any other: it counts as greater than infinity, or as less than negative infinity where its
//! sign is set. Remove values that are not finite first. The result for no values is `None`.
//!
//! Functions that take `&mut [T]` work in place, in linear time on average, and leave the values in another order.
//!
//! ```
//! use heliosplat_grid::statistics::{median, nmad, upper_median};
//!
//! assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), Some(2.5));
//! assert_eq!(upper_median(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
//! // One blunder does not change the spread.
//! assert_eq!(nmad(&[1.0, 2.0, 3.0, 4.0, 1e9]), Some(1.4826));
//! assert_eq!(median::<f32>(&mut []), None);
//! ```

use std::cmp::Ordering;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Standard deviation of a normal distribution in units of its median absolute deviation: 1 / Φ⁻¹(3/4), as it is
/// usually rounded (J. Höhle, M. Höhle, "Accuracy assessment of digital elevation models by means of robust statistical
/// methods", 2009).
pub const SIGMA_PER_MAD: f64 = 1.4826;

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// Numbers that this crate works on: `f32` and `f64`, no others.
pub trait Real:
    sealed::Sealed
    + Copy
    + PartialOrd
    + From<f32>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// The order of IEEE 754, in which every two values can be compared.
    #[doc(hidden)]
    fn order(&self, other: &Self) -> Ordering;
    /// Absolute difference of two values.
    #[doc(hidden)]
    fn distance(self, other: Self) -> Self;
    /// Standard deviation of a normal distribution with this median absolute deviation.
    #[doc(hidden)]
    fn sigma_of_mad(self) -> Self;
}

macro_rules! real {
    ($($float:ident),*) => {$(
        impl Real for $float {
            fn order(&self, other: &Self) -> Ordering {
                self.total_cmp(other)
            }
            fn distance(self, other: Self) -> Self {
                (self - other).abs()
            }
            fn sigma_of_mad(self) -> Self {
                SIGMA_PER_MAD as $float * self
            }
        }
    )*};
}
real!(f32, f64);

/// The value with exactly `rank` values before it in order, counted from 0; `None` where there are not that many.
fn ranked<T: Real>(values: &mut [T], rank: usize) -> Option<T> {
    (rank < values.len()).then(|| *values.select_nth_unstable_by(rank, T::order).1)
}

/// The middle value; of an even number of values the mean of the two in the middle. `None` of no values.
pub fn median<T: Real>(values: &mut [T]) -> Option<T> {
    let (half, odd) = (values.len() / 2, values.len() % 2 == 1);
    let upper = ranked(values, half)?;
    if odd {
        return Some(upper);
    }
    // All values before the upper one are not greater; the greatest of them is the lower one.
    let lower = values[..half].iter().copied().max_by(T::order)?;
    Some((lower + upper) / T::from(2.0))
}

/// The middle value; of an even number of values the lesser of the two in the middle. `None` of no values.
pub fn lower_median<T: Real>(values: &mut [T]) -> Option<T> {
    ranked(values, values.len().saturating_sub(1) / 2)
}

/// The middle value; of an even number of values the greater of the two in the middle. `None` of no values.
pub fn upper_median<T: Real>(values: &mut [T]) -> Option<T> {
    ranked(values, values.len() / 2)
}

/// The value at the share `p` of the way from the least (`p` = 0) to the greatest (`p` = 1): of `n` values the one
/// whose rank from 0 is nearest to `p · (n − 1)`, halves rounded up. Nothing is interpolated. A `p` outside of 0 to 1
/// counts as the nearer end. `None` of no values.
pub fn quantile<T: Real>(values: &mut [T], p: f64) -> Option<T> {
    let last = values.len().checked_sub(1)?;
    ranked(values, ((last as f64 * p).round() as usize).min(last))
}

/// The value with the share `p` of all values before it in order: of `n` values the one whose rank from 0 is `p · n`,
/// rounded down. At `p` = 1/2 it is [`upper_median`]. A `p` outside of 0 to 1 counts as the nearer end. `None` of no
/// values.
pub fn upper_quantile<T: Real>(values: &mut [T], p: f64) -> Option<T> {
    let last = values.len().checked_sub(1)?;
    ranked(values, ((values.len() as f64 * p) as usize).min(last))
}

/// Median absolute deviation: median |x − median(x)|, both by [`median`]. `None` of no values.
pub fn median_absolute_deviation<T: Real>(values: &[T]) -> Option<T> {
    let mut values = values.to_vec();
    let middle = median(&mut values)?;
    values.iter_mut().for_each(|value| *value = value.distance(middle));
    median(&mut values)
}

/// Normalised median absolute deviation: [`SIGMA_PER_MAD`] · median |x − median(x)|, a standard deviation for normal
/// values that tolerates up to half of them being wrong. `None` of no values.
pub fn nmad<T: Real>(values: &[T]) -> Option<T> {
    median_absolute_deviation(values).map(T::sigma_of_mad)
}

/// Pearson's correlation of pairs, −1..1. `None` of no pairs, where a value is not finite, and where one of the two does
/// not vary.
pub fn correlation(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
    let (mut count, mut mean_a, mut mean_b) = (0usize, 0.0, 0.0);
    for (a, b) in pairs.clone() {
        count += 1;
        mean_a += a;
        mean_b += b;
    }
    mean_a /= count as f64;
    mean_b /= count as f64;
    let (mut both, mut of_a, mut of_b) = (0.0, 0.0, 0.0);
    for (a, b) in pairs {
        let (a, b) = (a - mean_a, b - mean_b);
        both += a * b;
        of_a += a * a;
        of_b += b * b;
    }
    let found = both / (of_a * of_b).sqrt();
    found.is_finite().then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlation_is_that_of_lines_and_unknown_of_constants() {
        let of = |b: [f64; 3]| correlation([1.0, 2.0, 3.0].into_iter().zip(b));
        assert_eq!(of([10.0, 20.0, 30.0]), Some(1.0));
        assert_eq!(of([3.0, 2.0, 1.0]), Some(-1.0));
        assert_eq!(of([1.0, 0.0, 1.0]), Some(0.0));
        for unknown in [[1.0; 3], [f64::NAN, 1.0, 2.0]] {
            assert_eq!(of(unknown), None);
        }
        assert_eq!(correlation(std::iter::empty()), None);
    }

    #[test]
    fn half_of_the_values_lie_on_either_side_of_a_median() {
        let odd = [3.0_f32, -1.0, 2.0];
        for of in [median, lower_median, upper_median] {
            assert_eq!(of(&mut odd.clone()), Some(2.0));
            assert_eq!(of(&mut [7.0]), Some(7.0));
            assert_eq!(of(&mut []), None);
        }
        let even = [4.0_f64, 1.0, 3.0, 2.0];
        assert_eq!(lower_median(&mut even.clone()), Some(2.0));
        assert_eq!(median(&mut even.clone()), Some(2.5));
        assert_eq!(upper_median(&mut even.clone()), Some(3.0));
    }

    #[test]
    fn medians_are_those_of_sorted_values() {
        let mut state = 1u64;
        for count in 1..60 {
            let values: Vec<f64> = (0..count)
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    ((state >> 40) % 23) as f64 - 11.0
                })
                .collect();
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            let (lower, upper) = (sorted[(count - 1) / 2], sorted[count / 2]);
            assert_eq!(lower_median(&mut values.clone()), Some(lower));
            assert_eq!(upper_median(&mut values.clone()), Some(upper));
            assert_eq!(median(&mut values.clone()), Some((lower + upper) / 2.0));
            for p in [0.0, 0.02, 0.5, 0.95, 1.0] {
                let at = ((count - 1) as f64 * p).round() as usize;
                assert_eq!(quantile(&mut values.clone(), p), Some(sorted[at]), "{p} of {count}");
            }
        }
    }

    #[test]
    fn quantiles_end_at_the_least_and_the_greatest() {
        let values = [5.0_f32, 1.0, 4.0, 2.0, 3.0];
        for of in [quantile, upper_quantile] {
            assert_eq!(of(&mut values.clone(), 0.0), Some(1.0));
            assert_eq!(of(&mut values.clone(), 1.0), Some(5.0));
            assert_eq!(of(&mut values.clone(), -3.0), Some(1.0));
            assert_eq!(of(&mut values.clone(), 7.0), Some(5.0));
            assert_eq!(of(&mut [], 0.5), None);
        }
        assert_eq!(quantile(&mut values.clone(), 0.3), Some(2.0));
        assert_eq!(upper_quantile(&mut values.clone(), 0.3), Some(2.0));
        assert_eq!(quantile(&mut values.clone(), 0.9), Some(5.0));
        assert_eq!(upper_quantile(&mut values.clone(), 0.79), Some(4.0));
    }

    #[test]
    fn blunders_do_not_widen_the_spread() {
        let values = [10.0_f64, 12.0, 11.0, 9.0, 1e9];
        assert_eq!(median_absolute_deviation(&values), Some(1.0));
        assert_eq!(nmad(&values), Some(1.4826));
        assert_eq!(nmad(&[2.0_f32, 4.0]), Some(1.4826));
        assert_eq!(nmad::<f64>(&[]), None);
    }

    #[test]
    fn what_is_not_a_number_stands_at_the_ends() {
        assert_eq!(median(&mut [f64::NAN, 1.0, 2.0, f64::INFINITY, 0.0]), Some(2.0));
        assert_eq!(upper_median(&mut [-f32::NAN, 1.0, 2.0]), Some(1.0));
    }
}
