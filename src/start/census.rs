//! The census transform: which neighbours are darker than the centre. It survives any monotone change of brightness,
//! so exposure, haze and season move it little (Zabih & Woodfill 1994).

use crate::simd::vectorised;

/// Cells from the centre to the edge of the window.
pub(super) const RADIUS: usize = 3;
/// Neighbours compared: the full 5 × 5 window, and every other cell of the ring around it for reach.
pub(super) const COMPARISONS: u32 = 24;
/// Set where the window is not complete.
pub(super) const INVALID: u64 = 1 << 63;
const MASK: u64 = (1 << COMPARISONS) - 1;

const fn offsets() -> [(isize, isize); COMPARISONS as usize] {
    let mut list = [(0, 0); COMPARISONS as usize];
    let (mut n, mut row) = (0, -3);
    while row <= 3 {
        let mut col = -3;
        while col <= 3 {
            if (row + col) % 2 == 0 && (row != 0 || col != 0) {
                list[n] = (col, row);
                n += 1;
            }
            col += 1;
        }
        row += 1;
    }
    list
}
const OFFSETS: [(isize, isize); COMPARISONS as usize] = offsets();

vectorised! {
    /// Descriptors of a block of `width × height` cells from their values, which reach [`RADIUS`] further on every side.
    pub(super) fn describe(values: &[f32], width: usize, height: usize, alike: f32, out: &mut [u64]) {
        let stride = width + 2 * RADIUS;
        for row in 0..height {
            let centre_at = (row + RADIUS) * stride + RADIUS;
            let centre = &values[centre_at..centre_at + width];
            let out = &mut out[row * width..(row + 1) * width];
            for (word, value) in out.iter_mut().zip(centre) {
                *word = if value.is_nan() { INVALID } else { 0 };
            }
            for (bit, &(dc, dr)) in OFFSETS.iter().enumerate() {
                let at = (centre_at as isize + dr * stride as isize + dc) as usize;
                let near = &values[at..at + width];
                for ((word, value), other) in out.iter_mut().zip(centre).zip(near) {
                    let missing = if other.is_nan() { INVALID } else { 0 };
                    *word |= (u64::from(other < value) << bit)
                        | (u64::from((other - value).abs() < alike) << (bit + 24))
                        | missing;
                }
            }
        }
    }
}

vectorised! {
    /// Adds to `sum` the weighted distance between two blocks of descriptors, cut off at `cut`, and to `weights` the weight,
    /// where both are valid.
    pub(super) fn compare(a: &[u64], b: &[u64], weight: u32, cut: u32, sum: &mut [u32], weights: &mut [u32]) {
        for (((a, b), sum), weights) in a.iter().zip(b).zip(sum.iter_mut()).zip(weights.iter_mut()) {
            let both = ((a & b) >> 24) & MASK;
            let n = both.count_ones() as f32;
            let distance = (24.0 * (((a ^ b) & both).count_ones() as f32 + 1.0) / (n + 2.0)) as u32;
            let distance = distance.min(cut);
            let weight = if (a | b) & INVALID == 0 { weight } else { 0 };
            *sum += weight * distance;
            *weights += weight;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(stride: usize, gain: f32) -> Vec<f32> {
        (0..stride * stride)
            .map(|i| gain * ((i * 7919 % 101) as f32) + 5.0)
            .collect()
    }

    #[test]
    fn the_descriptor_does_not_see_gain_and_offset() {
        let (width, stride) = (6, 6 + 2 * RADIUS);
        let (mut a, mut b) = (vec![0; 36], vec![0; 36]);
        describe(&ramp(stride, 1.0), width, width, 1e3, &mut a);
        describe(&ramp(stride, 3.5), width, width, 3.5e3, &mut b);
        assert_eq!(a, b);
        assert!(a.iter().any(|&word| word != a[0]));
    }

    #[test]
    fn a_missing_neighbour_makes_the_window_invalid_and_the_comparison_weightless() {
        let (width, stride) = (6, 6 + 2 * RADIUS);
        let mut values = ramp(stride, 1.0);
        values[0] = f32::NAN;
        let mut words = vec![0; 36];
        describe(&values, width, width, 1e3, &mut words);
        assert_ne!(words[0] & INVALID, 0, "the window of the first cell holds the hole");
        assert_eq!(words[35] & INVALID, 0);
        let (mut sum, mut weights) = (vec![0; 36], vec![0; 36]);
        compare(&words, &words, 3, 10, &mut sum, &mut weights);
        assert_eq!((weights[0], weights[35], sum[35]), (0, 3, 0));
    }
}
