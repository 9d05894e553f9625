//! The census transform: bits that mark neighbours darker than the centre (Zabih and Woodfill 1994).
//!
//! It is invariant to monotone changes of brightness, so exposure, haze and season hardly change it. Differences beyond
//! a contrast limit are not compared, because they lie across the edge of a shadow or of another surface; the distance
//! is the share of differing bits among those compared by both cells. The limit follows the contrast around the cell,
//! so other parts of an image (sea, snow, deep shade) do not matter. Views of one date are also compared by brightness
//! itself ([`compare_values`]).
//!
//! Descriptors have 32 bits per cell and sums are integers, so that eight cells are processed together and the result
//! does not depend on the order.

use heliosplat::fast::{floor, number};
use heliosplat::vectorised;
use std::cmp::Ordering;

/// Cells from the centre to the edge of the window.
pub(super) const RADIUS: usize = 2;
/// Cells across the window.
pub const CENSUS_CELLS: usize = 2 * RADIUS + 1;
/// Number of neighbours compared: all of the 5 × 5 window. Every other cell of a 7 × 7 window blurs edges more
/// (docs/lab/plane-sweep.md).
pub(super) const COMPARISONS: u32 = 24;
/// Bit of [`Descriptors::darker`] that marks cells without a complete window, or hidden from the view.
pub(super) const INVALID: u32 = 1 << 31;

/// Descriptors of some cells, one entry per cell in each list; `darker` and `compared` have one bit per neighbour.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Descriptors {
    /// Neighbours that are darker than the cell.
    pub(super) darker: Vec<u32>,
    /// Neighbours that are compared: those within the contrast limit.
    pub(super) compared: Vec<u32>,
    /// Brightness of the cell less the median of its image, in median differences between neighbours.
    pub(super) value: Vec<f32>,
}

impl Descriptors {
    /// Zero descriptors of `cells` cells.
    pub(super) fn new(cells: usize) -> Self {
        Self {
            darker: vec![0; cells],
            compared: vec![0; cells],
            value: vec![0.0; cells],
        }
    }

    /// The descriptors with each neighbourhood rotated by 90 degrees about its centre.
    pub(super) fn rotated(&self) -> Self {
        let rotate = |list: &[u32]| list.iter().map(|&word| rotated(word)).collect();
        Self {
            darker: rotate(&self.darker),
            compared: rotate(&self.compared),
            value: self.value.clone(),
        }
    }
}

/// The bit that each neighbour's bit moves to when a neighbourhood is rotated by 90 degrees.
const ROTATED: [u32; COMPARISONS as usize] = {
    let mut list = [0; COMPARISONS as usize];
    let mut from = 0;
    while from < OFFSETS.len() {
        let (col, row) = OFFSETS[from];
        let mut to = 0;
        while OFFSETS[to].0 != -row || OFFSETS[to].1 != col {
            to += 1;
        }
        list[from] = to as u32;
        from += 1;
    }
    list
};

fn rotated(word: u32) -> u32 {
    let bits = ROTATED.iter().enumerate();
    bits.fold(word & INVALID, |rotated, (from, to)| {
        rotated | (((word >> from) & 1) << to)
    })
}

const fn offsets() -> [(isize, isize); COMPARISONS as usize] {
    let mut list = [(0, 0); COMPARISONS as usize];
    let reach = RADIUS as isize;
    let (mut n, mut row) = (0, -reach);
    while row <= reach {
        let mut col = -reach;
        while col <= reach {
            if row != 0 || col != 0 {
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
    /// Writes to `out` the bits of a block of `width × height` cells from `values`, which reach [`RADIUS`] cells
    /// further on every side. A neighbour is compared if its absolute difference from the cell is less than the cell's
    /// limit (`limits`) and at least `noise` times that limit.
    pub(super) fn describe(values: &[f32], width: usize, height: usize, limits: &[f32], noise: f32, out: &mut Descriptors) {
        let stride = width + 2 * RADIUS;
        for row in 0..height {
            let centre_at = (row + RADIUS) * stride + RADIUS;
            let cells = row * width..(row + 1) * width;
            let (darker, compared) = (&mut out.darker[cells.clone()], &mut out.compared[cells]);
            describe_row(&values[centre_at - RADIUS * stride - RADIUS..], stride, &limits[row * width..(row + 1) * width], noise, darker, compared);
        }
    }
}

/// Cells that are described together: their descriptors stay in registers.
const LANES: usize = 8;
/// Rows and columns of a window.
const SIDE: usize = 2 * RADIUS + 1;
/// Values of one row within the windows of [`LANES`] neighbouring cells.
const REACH: usize = LANES + 2 * RADIUS;

/// Descriptors of a row of cells; `values` begins at the upper left corner of the first window.
#[inline(always)]
fn describe_row(values: &[f32], stride: usize, limits: &[f32], noise: f32, darker: &mut [u32], compared: &mut [u32]) {
    let width = darker.len();
    for group in (0..width).step_by(LANES) {
        // The last group begins earlier, so that it is whole, if the row is as long.
        let first = group.min(width.saturating_sub(LANES));
        let window = &values[first..];
        let parts = (
            limits[first..].first_chunk::<LANES>(),
            darker[first..].first_chunk_mut::<LANES>(),
            compared[first..].first_chunk_mut::<LANES>(),
        );
        if let (Some(limits), Some(darker), Some(compared)) = parts {
            [*darker, *compared] = describe_group(window, stride, limits, noise);
        } else {
            let mut some = [0.0; LANES];
            some.iter_mut().zip(limits).for_each(|(to, from)| *to = *from);
            let [d, c] = describe_group(window, stride, &some, noise);
            darker.iter_mut().zip(d).for_each(|(to, from)| *to = from);
            compared.iter_mut().zip(c).for_each(|(to, from)| *to = from);
        }
    }
}

/// Bits of darker and of compared neighbours for a group of cells; `values` begins at the upper left corner of the
/// first window.
#[inline(always)]
fn describe_group(values: &[f32], stride: usize, limits: &[f32; LANES], noise: f32) -> [[u32; LANES]; 2] {
    if values.len() >= (SIDE - 1) * stride + REACH {
        describe_cells(values, stride, limits, noise)
    } else {
        describe_cells(&padded(values, stride), REACH, limits, noise)
    }
}

/// Values of the windows of a group at the end of the list, where fewer follow than a window needs; missing ones are
/// zero.
#[cold]
fn padded(values: &[f32], stride: usize) -> [f32; SIDE * REACH] {
    let mut all = [0.0; SIDE * REACH];
    for (row, to) in all.chunks_exact_mut(REACH).enumerate() {
        let from = values.get(row * stride..).unwrap_or_default();
        to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
    }
    all
}

/// Census of eight cells of `values`, which contain all cells in reach of the windows.
#[inline(always)]
fn describe_cells(values: &[f32], stride: usize, limits: &[f32; LANES], noise: f32) -> [[u32; LANES]; 2] {
    let lanes = |line: &[f32; REACH], col: usize| -> [f32; LANES] { std::array::from_fn(|l| line[col + l]) };
    let line = |row: usize| values[row * stride..].first_chunk::<REACH>().unwrap_or(&[0.0; REACH]);
    let centre = lanes(line(RADIUS), RADIUS);
    let least: [f32; LANES] = std::array::from_fn(|l| noise * limits[l]);
    let (mut darker, mut compared) = ([0u32; LANES], [0u32; LANES]);
    // A sum is NaN where any part of it is.
    let mut sum = centre;
    for row in 0..SIDE {
        let line = line(row);
        // The centre is included here; its bit is left out when rows are joined.
        let (mut row_darker, mut row_compared) = ([0u32; LANES], [0u32; LANES]);
        for col in 0..SIDE {
            let other = lanes(line, col);
            for l in 0..LANES {
                let difference = other[l] - centre[l];
                let away = difference.abs();
                row_darker[l] |= u32::from(difference < 0.0) << col;
                row_compared[l] |= u32::from((away < limits[l]) & (away >= least[l])) << col;
                sum[l] += difference;
            }
        }
        for l in 0..LANES {
            darker[l] |= joined(row_darker[l], row);
            compared[l] |= joined(row_compared[l], row);
        }
    }
    for l in 0..LANES {
        darker[l] |= if sum[l].is_nan() { INVALID } else { 0 };
    }
    [darker, compared]
}

/// The bits of a row of the window at their places among all comparisons, which leave out the centre.
#[inline(always)]
fn joined(bits: u32, row: usize) -> u32 {
    let start = row * SIDE;
    match row.cmp(&RADIUS) {
        Ordering::Less => bits << start,
        Ordering::Equal => {
            let (before, after) = (bits & ((1 << RADIUS) - 1), bits >> (RADIUS + 1));
            (before | (after << RADIUS)) << start
        }
        Ordering::Greater => bits << (start - 1),
    }
}

vectorised! {
    /// Adds to `sum` the weighted distance between two blocks of descriptors, in comparisons and truncated at `cut`,
    /// and to `weights` the weight, at cells that are valid in both.
    pub(super) fn compare(a: &Descriptors, b: &Descriptors, weight: u32, cut: u32, sum: &mut [u32], weights: &mut [u32]) {
        let cells = sum.len();
        let (a_darker, a_compared) = (&a.darker[..cells], &a.compared[..cells]);
        let (b_darker, b_compared) = (&b.darker[..cells], &b.compared[..cells]);
        let weights = &mut weights[..cells];
        for k in 0..cells {
            let both = a_compared[k] & b_compared[k];
            let n = number(both.count_ones());
            let differing = number(((a_darker[k] ^ b_darker[k]) & both).count_ones());
            // Laplace's rule of succession: with nothing to compare the distance is one half.
            let (_, distance) = floor(COMPARISONS as f32 * (differing + 1.0) / (n + 2.0));
            let distance = if distance < cut { distance } else { cut };
            let weight = if (a_darker[k] | b_darker[k]) & INVALID == 0 { weight } else { 0 };
            sum[k] += weight * distance;
            weights[k] += weight;
        }
    }
}

vectorised! {
    /// Writes to `out` the values of a block of `width × height` cells less `middle`, in units of `unit`; `values`
    /// reach [`RADIUS`] cells further on every side.
    pub(super) fn store_values(values: &[f32], width: usize, height: usize, middle: f32, unit: f32, out: &mut Descriptors) {
        let stride = width + 2 * RADIUS;
        let inverse = 1.0 / unit;
        for row in 0..height {
            let start = (row + RADIUS) * stride + RADIUS;
            let stored = out.value[row * width..(row + 1) * width].iter_mut();
            for (stored, value) in stored.zip(&values[start..start + width]) {
                *stored = (value - middle) * inverse;
            }
        }
    }
}

vectorised! {
    /// Adds to `sum` the weighted absolute difference between two blocks of values, scaled so that `reach` becomes
    /// `cut` and truncated there, and to `weights` the weight, at cells whose descriptors are valid in both.
    pub(super) fn compare_values(a: &Descriptors, b: &Descriptors, weight: u32, reach: f32, cut: u32, sum: &mut [u32], weights: &mut [u32]) {
        let cells = sum.len();
        let (a_darker, a_value) = (&a.darker[..cells], &a.value[..cells]);
        let (b_darker, b_value) = (&b.darker[..cells], &b.value[..cells]);
        let weights = &mut weights[..cells];
        let scale = number(cut) / reach;
        for k in 0..cells {
            let apart = (a_value[k] - b_value[k]).abs() * scale;
            let apart = if apart < number(cut) { apart } else { number(cut) };
            let weight = if (a_darker[k] | b_darker[k]) & INVALID == 0 { weight } else { 0 };
            sum[k] += weight * floor(apart).1;
            weights[k] += weight;
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
        let (mut a, mut b) = (Descriptors::new(36), Descriptors::new(36));
        describe(&ramp(stride, 1.0), width, width, &[1e3; 36], 0.0, &mut a);
        describe(&ramp(stride, 3.5), width, width, &[3.5e3; 36], 0.0, &mut b);
        assert_eq!(a, b);
        assert!(a.darker.iter().any(|&darker| darker != a.darker[0]));
    }

    #[test]
    fn a_rotated_slope_agrees_with_itself_half_of_the_time_and_four_rotations_are_none() {
        let (width, stride) = (1, 1 + 2 * RADIUS);
        // Brighter to the east, and a little to the south, so that no two neighbours are equal.
        let slope: Vec<f32> = (0..stride * stride)
            .map(|i| 10.0 * (i % stride) as f32 + (i / stride) as f32)
            .collect();
        let mut descriptors = Descriptors::new(1);
        describe(&slope, width, width, &[1e3], 0.0, &mut descriptors);
        let once = descriptors.rotated();
        assert_ne!(once, descriptors);
        assert_eq!(once.rotated().rotated().rotated(), descriptors);
        assert_eq!((once.darker[0] ^ descriptors.darker[0]).count_ones(), COMPARISONS / 2);
    }

    #[test]
    fn differences_across_an_edge_are_neither_a_match_nor_a_mismatch() {
        let (width, stride) = (6, 6 + 2 * RADIUS);
        let (mut a, mut b) = (Descriptors::new(36), Descriptors::new(36));
        let values: Vec<f32> = ramp(stride, 1.0);
        let turned: Vec<f32> = values.iter().map(|v| 10.0 - v).collect();
        // Values are whole numbers and differ by one at least: no neighbour is within the limit.
        describe(&values, width, width, &[0.5; 36], 0.0, &mut a);
        describe(&turned, width, width, &[0.5; 36], 0.0, &mut b);
        let (mut sum, mut weights) = (vec![0; 36], vec![0; 36]);
        compare(&a, &b, 1, COMPARISONS, &mut sum, &mut weights);
        assert_eq!((sum, weights), (vec![COMPARISONS / 2; 36], vec![1; 36]));
        // With every difference counted, the opposite is the worst of matches.
        describe(&values, width, width, &[1e3; 36], 0.0, &mut a);
        describe(&turned, width, width, &[1e3; 36], 0.0, &mut b);
        let mut sum = vec![0; 36];
        compare(&a, &b, 1, COMPARISONS, &mut sum, &mut [0; 36]);
        assert!(sum.iter().all(|&s| s > 20), "{sum:?}");
    }

    #[test]
    fn a_missing_neighbour_makes_the_window_invalid_and_the_comparison_weightless() {
        let (width, stride) = (6, 6 + 2 * RADIUS);
        let mut values = ramp(stride, 1.0);
        values[0] = f32::NAN;
        let mut descriptors = Descriptors::new(36);
        describe(&values, width, width, &[1e3; 36], 0.0, &mut descriptors);
        assert_ne!(
            descriptors.darker[0] & INVALID,
            0,
            "the window of the first cell holds the hole"
        );
        assert_eq!(descriptors.darker[35] & INVALID, 0);
        let (mut sum, mut weights) = (vec![0; 36], vec![0; 36]);
        compare(&descriptors, &descriptors, 3, 10, &mut sum, &mut weights);
        assert_eq!((weights[0], weights[35], sum[35]), (0, 3, 0));
    }

    #[test]
    fn values_differ_up_to_a_cut_and_holes_do_not_count() {
        let (width, stride) = (6, 6 + 2 * RADIUS);
        let (mut a, mut b) = (Descriptors::new(36), Descriptors::new(36));
        let mut values = ramp(stride, 1.0);
        store_values(&values, width, width, 5.0, 2.0, &mut a);
        values.iter_mut().for_each(|v| *v += 2.0);
        store_values(&values, width, width, 5.0, 2.0, &mut b);
        b.darker[1] = INVALID;
        let (mut sum, mut weights) = (vec![0; 36], vec![0; 36]);
        compare_values(&a, &b, 3, 4.0, 8, &mut sum, &mut weights);
        assert_eq!(
            (sum[0], weights[0]),
            (6, 3),
            "a quarter of the reach is a quarter of the cut"
        );
        assert_eq!((sum[1], weights[1]), (0, 0));
        compare_values(&a, &b, 3, 0.5, 8, &mut sum, &mut weights);
        assert_eq!(sum[0], 6 + 24, "no more than the cut");
    }

    #[test]
    fn cells_of_a_narrow_row_are_described_as_those_of_a_wide_one() {
        let values = ramp(20 + 2 * RADIUS, 1.0);
        let stride = 20 + 2 * RADIUS;
        let mut wide = Descriptors::new(20);
        describe(&values, 20, 1, &[7.0; 20], 0.3, &mut wide);
        let narrow: Vec<f32> = values
            .chunks(stride)
            .take(1 + 2 * RADIUS)
            .flat_map(|row| row[..3 + 2 * RADIUS].to_vec())
            .collect();
        let mut few = Descriptors::new(3);
        describe(&narrow, 3, 1, &[7.0; 3], 0.3, &mut few);
        assert_eq!(
            (&wide.darker[..3], &wide.compared[..3]),
            (&few.darker[..], &few.compared[..])
        );
    }
}
