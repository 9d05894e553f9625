//! Values between the centres of cells.

/// Weights below this share are rounding, not a neighbour.
const NEGLIGIBLE: f64 = 1e-6;

/// Bilinear value of a grid of `(width, height)` cells at a fractional column and row; NaN outside the outermost
/// centres and next to missing cells (NaN).
#[inline]
pub fn bilinear(values: &[f32], (width, height): (usize, usize), col: impl Into<f64>, row: impl Into<f64>) -> f32 {
    let (col, row): (f64, f64) = (col.into(), row.into());
    // Written so that a NaN position fails the test too.
    let inside = col >= 0.0 && row >= 0.0 && col < width as f64 - 1.0 && row < height as f64 - 1.0;
    if !inside {
        return f32::NAN;
    }
    let (c, r) = (col as usize, row as usize);
    let (fc, fr) = ((col - c as f64) as f32, (row - r as f64) as f32);
    let i = r * width + c;
    let (upper, lower) = (&values[i..i + 2], &values[i + width..i + width + 2]);
    let top = upper[0] + (upper[1] - upper[0]) * fc;
    let bottom = lower[0] + (lower[1] - lower[0]) * fc;
    top + (bottom - top) * fr
}

/// Bilinear value of a grid of `(width, height)` cells at a fractional column and row. Between the outermost centres
/// and the grid's outer edge, half a cell beyond, it is the value at the edge; NaN outside and next to missing cells
/// (NaN). Missing neighbours with a weight within rounding are ignored, so that grids that agree up to rounding lose no
/// cells.
pub fn bilinear_to_the_edge(values: &[f32], (width, height): (usize, usize), col: f64, row: f64) -> f32 {
    let (last_col, last_row) = (width as f64 - 1.0, height as f64 - 1.0);
    let inside = !values.is_empty() && col >= -0.5 && row >= -0.5 && col <= last_col + 0.5 && row <= last_row + 0.5;
    if !inside {
        return f32::NAN;
    }
    let (col, row) = (col.clamp(0.0, last_col), row.clamp(0.0, last_row));
    let (c, r) = (col as usize, row as usize);
    let (fc, fr) = (col - c as f64, row - r as f64);
    let mut sum = 0.0;
    for (dc, dr, weight) in [
        (0, 0, (1.0 - fc) * (1.0 - fr)),
        (1, 0, fc * (1.0 - fr)),
        (0, 1, (1.0 - fc) * fr),
        (1, 1, fc * fr),
    ] {
        if weight > NEGLIGIBLE {
            sum += weight * f64::from(values[(r + dr) * width + c + dc]);
        }
    }
    sum as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (4, 3);

    fn plane() -> Vec<f32> {
        (0..12).map(|i| (i % 4) as f32 + 10.0 * (i / 4) as f32).collect()
    }

    #[test]
    fn a_plane_is_met_exactly_between_the_centres() {
        assert_eq!(bilinear(&plane(), SIZE, 1.25f32, 0.5f32), 6.25);
        assert_eq!(bilinear_to_the_edge(&plane(), SIZE, 1.25, 0.5), 6.25);
    }

    #[test]
    fn values_end_at_the_centres_or_at_the_edge() {
        assert!(bilinear(&plane(), SIZE, -0.1, 0.0).is_nan() && bilinear(&plane(), SIZE, 3.0, 0.0).is_nan());
        assert!(bilinear(&plane(), SIZE, f64::NAN, 0.0).is_nan());
        assert_eq!(bilinear_to_the_edge(&plane(), SIZE, 3.5, 2.5), 23.0);
        assert!(bilinear_to_the_edge(&plane(), SIZE, 3.6, 0.0).is_nan());
        assert!(bilinear_to_the_edge(&plane(), SIZE, f64::NAN, 0.0).is_nan());
        assert!(bilinear(&[], (0, 0), 0.0, 0.0).is_nan() && bilinear_to_the_edge(&[], (0, 0), 0.0, 0.0).is_nan());
    }

    #[test]
    fn a_missing_cell_counts_only_with_more_weight_than_rounding() {
        let mut values = plane();
        values[1] = f32::NAN;
        assert!(bilinear(&values, SIZE, 0.5, 0.5).is_nan() && bilinear_to_the_edge(&values, SIZE, 0.5, 0.5).is_nan());
        assert!((bilinear_to_the_edge(&values, SIZE, 1e-9, 0.5) - 5.0).abs() < 1e-6);
    }
}
