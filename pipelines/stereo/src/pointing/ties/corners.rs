//! Candidates of tie points: corners of the views' texture (Shi and Tomasi 1994), spread over the ground.

use heliosplat_grid::Grid;
use rayon::prelude::*;

/// Radius over which the structure tensor is summed, cells.
const RADIUS: usize = 3;
/// Least side of a tile, cells: smaller ones hold no corner of their own, since the structure tensor is summed over
/// seven.
const LEAST_TILE: usize = 4;
/// Change of the first reference view from one row of tiles to the next: it shares no factor with most numbers of
/// views, so one view's tiles do not form columns.
const ROW_STEP: usize = 5;

/// A corner, and the view that shows it best.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Corner {
    /// Index of the reference view.
    pub(super) view: usize,
    /// Column of the corner's cell on the grid.
    pub(super) col: usize,
    /// Row of the corner's cell on the grid.
    pub(super) row: usize,
}

/// The sharpest corner of each of about `tiles` tiles; `orthos` are the views on the cells of `grid`, NaN where
/// missing. Views take turns as the reference, so that each has ties all over the ground; a view that does not show a
/// tile is replaced by the next.
pub(super) fn choose(grid: &Grid, orthos: &[Vec<f32>], tiles: usize) -> Vec<Corner> {
    let strengths: Vec<Vec<f32>> = orthos.par_iter().map(|values| strength(grid, values)).collect();
    let side = ((grid.len() as f64 / tiles.max(1) as f64).sqrt().round() as usize).max(LEAST_TILE);
    let (across, down) = (grid.width.div_ceil(side), grid.height.div_ceil(side));
    let mut corners = Vec::new();
    for tile in 0..across * down {
        let (tile_col, tile_row) = (tile % across, tile / across);
        let first = tile_col + ROW_STEP * tile_row;
        let best = (0..orthos.len()).find_map(|turn| {
            let view = (first + turn) % orthos.len();
            sharpest(grid, &strengths[view], (tile_col * side, tile_row * side), side).map(|(col, row)| Corner {
                view,
                col,
                row,
            })
        });
        corners.extend(best);
    }
    corners
}

fn sharpest(grid: &Grid, strength: &[f32], (col0, row0): (usize, usize), side: usize) -> Option<(usize, usize)> {
    let mut best = (0.0, None);
    for row in row0..(row0 + side).min(grid.height) {
        for col in col0..(col0 + side).min(grid.width) {
            let here = strength[row * grid.width + col];
            if here > best.0 {
                best = (here, Some((col, row)));
            }
        }
    }
    best.1
}

/// The smaller eigenvalue of the structure tensor (J. Shi, C. Tomasi, *Good features to track*, 1994): the precision of
/// a shift in the worst direction. 0 where values are missing.
fn strength(grid: &Grid, values: &[f32]) -> Vec<f32> {
    let (width, height) = (grid.width, grid.height);
    let mut out = vec![0.0; grid.len()];
    let slope = |col: usize, row: usize| {
        let i = row * width + col;
        (
            0.5 * (values[i + 1] - values[i - 1]),
            0.5 * (values[i + width] - values[i - width]),
        )
    };
    for row in RADIUS + 1..height.saturating_sub(RADIUS + 1) {
        for col in RADIUS + 1..width.saturating_sub(RADIUS + 1) {
            let (mut xx, mut xy, mut yy) = (0.0f32, 0.0, 0.0);
            for r in row - RADIUS..=row + RADIUS {
                for c in col - RADIUS..=col + RADIUS {
                    let (x, y) = slope(c, r);
                    xx += x * x;
                    xy += x * y;
                    yy += y * y;
                }
            }
            let least = 0.5 * (xx + yy - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt());
            out[row * width + col] = if least.is_finite() { least } else { 0.0 };
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corner_of_a_square_is_chosen_and_its_edges_are_not() {
        let grid = Grid {
            width: 40,
            height: 40,
            west_m: 0.0,
            north_m: 0.0,
            cell_m: 1.0,
        };
        let image: Vec<f32> = (0..1600)
            .map(|i| if i % 40 >= 20 && i / 40 >= 20 { 1.0 } else { 0.0 })
            .collect();
        let corners = choose(&grid, &[image], 1);
        assert_eq!(corners.len(), 1);
        assert!(
            corners[0].col.abs_diff(20) <= 2 && corners[0].row.abs_diff(20) <= 2,
            "{corners:?}"
        );
    }
}
