//! Orthorectified views on the cells of a surface, and small filters on such grids.

use super::level::LevelView;
use heliosplat_grid::Grid;
use heliosplat_grid::statistics::upper_median;
use rayon::prelude::*;

/// Bilinear brightness of a view at each cell of a surface with the altitudes `altitude` (metres); NaN outside the
/// image and next to missing pixels.
pub(super) fn ortho(grid: &Grid, view: &LevelView, altitude: &[f32]) -> Vec<f32> {
    grid.cells().map(|cell| shown(grid, view, altitude, cell)).collect()
}

/// Bilinear brightness of a view at one cell of a surface; NaN where there is none.
fn shown(grid: &Grid, view: &LevelView, altitude: &[f32], cell: usize) -> f32 {
    let (col, row) = (cell % grid.width, cell / grid.width);
    let at = grid.point(col as isize, row as isize, altitude[cell]);
    let (image_col, image_row, _) = view.camera.project(at);
    view.sample(image_col, image_row)
}

/// The guide image of the smoothness penalties: mean of the views on a surface, each in units of its own typical
/// difference between neighbours; NaN where no view shows the cell.
pub(super) fn guide(grid: &Grid, views: &[LevelView], altitude: &[f32]) -> Vec<f32> {
    let scale = |view: &LevelView| 1.0 / view.mean.contrast.max(f32::MIN_POSITIVE);
    let of_cell = |cell: usize| {
        let seen = views
            .iter()
            .map(|view| (shown(grid, view, altitude, cell), scale(view)));
        let known = seen.filter(|(value, _)| value.is_finite());
        let (sum, count) = known.fold((0.0, 0.0), |(sum, count), (value, scale)| {
            (sum + value * scale, count + 1.0)
        });
        sum / count
    };
    grid.cells().map(of_cell).collect()
}

/// Values of the grid `coarse`, whose cells are `factor` times as wide, repeated on the cells of `grid`.
pub(super) fn repeated(grid: &Grid, coarse: &Grid, factor: usize, values: &[f32]) -> Vec<f32> {
    grid.cells()
        .map(|i| values[i / grid.width / factor * coarse.width + i % grid.width / factor])
        .collect()
}

/// Median of the values within `radius` cells each way of each cell.
pub(super) fn median(grid: &Grid, values: &[f32], radius: usize) -> Vec<f32> {
    let mut out = vec![0.0; grid.len()];
    out.par_chunks_mut(grid.width.max(1))
        .enumerate()
        .for_each(|(row, line)| {
            let rows = row.saturating_sub(radius)..(row + radius + 1).min(grid.height);
            let mut near = Vec::new();
            for (col, value) in line.iter_mut().enumerate() {
                let cols = col.saturating_sub(radius)..(col + radius + 1).min(grid.width);
                near.clear();
                for r in rows.clone() {
                    near.extend_from_slice(&values[r * grid.width + cols.start..r * grid.width + cols.end]);
                }
                // The cell itself is always among them.
                *value = upper_median(&mut near).unwrap_or(f32::NAN);
            }
        });
    out
}

/// Mean of the finite values within `radius` cells each way of each cell; NaN where less than half of the window is
/// finite.
pub(super) fn box_mean(grid: &Grid, values: &[f32], radius: usize) -> Vec<f32> {
    let whole = (2 * radius + 1).pow(2);
    let width = grid.width;
    let mut out = vec![f32::NAN; grid.len()];
    out.par_chunks_mut(width.max(1))
        .with_min_len(8)
        .enumerate()
        .for_each(|(row, means)| {
            let (mut sums, mut counts) = (vec![0.0f32; width], vec![0u32; width]);
            for r in row.saturating_sub(radius)..(row + radius + 1).min(grid.height) {
                let line = &values[r * width..(r + 1) * width];
                // All cells of the row at once, neighbour by neighbour: every cell sums its neighbours in the same
                // order.
                for aside in 0..=2 * radius {
                    let (first, skipped) = (radius.saturating_sub(aside), aside.saturating_sub(radius));
                    let near = line.get(skipped..).unwrap_or_default();
                    let cells = sums.iter_mut().zip(&mut counts).skip(first);
                    for ((sum, count), value) in cells.zip(near) {
                        *sum += if value.is_finite() { *value } else { 0.0 };
                        *count += u32::from(value.is_finite());
                    }
                }
            }
            for ((mean, sum), count) in means.iter_mut().zip(sums).zip(counts) {
                if 2 * count as usize >= whole {
                    *mean = sum / count as f32;
                }
            }
        });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_mean_is_that_of_what_is_known_in_the_window() {
        for (width, height, radius) in [(7, 5, 2), (1, 9, 2), (2, 2, 3), (6, 1, 1)] {
            let grid = Grid::plain(width, height);
            let value = |i: usize| match i % 5 {
                3 => f32::NAN,
                _ => 0.1 * (i * 37 % 11) as f32,
            };
            let values: Vec<f32> = (0..grid.len()).map(value).collect();
            let slow = |cell: usize| {
                let known = || {
                    grid.around(cell, radius)
                        .map(|near| values[near])
                        .filter(|v| v.is_finite())
                };
                match 2 * known().count() >= (2 * radius + 1).pow(2) {
                    true => known().fold(0.0, |sum, v| sum + v) / known().count() as f32,
                    false => f32::NAN,
                }
            };
            let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
            let slow: Vec<f32> = (0..grid.len()).map(slow).collect();
            assert_eq!(bits(box_mean(&grid, &values, radius)), bits(slow), "{width} x {height}");
        }
    }
}
