//! What the search leaves behind, put in order: islands too small to be anything go, and where the views stand close
//! together (a pixel of mismatch is then metres of altitude) the surface is smoothed by local planes.

use super::grid::Grid;
use rayon::prelude::*;

/// Sharpness of the comparisons above which one cell at a time tells altitudes apart well enough.
const SHARP: f32 = 0.8;
/// Cells from the centre to the edge of the widest window.
const WIDEST_RADIUS: f32 = 6.0;

/// Cells that belong to a connected patch of fewer than `fewest` cells; neighbours belong together when their altitudes
/// differ by less than `step_m`.
pub(super) fn islands(grid: &Grid, altitude: &[f32], step_m: f32, fewest: usize) -> Vec<bool> {
    let mut seen = vec![false; grid.len()];
    let mut island = vec![false; grid.len()];
    let mut patch = Vec::new();
    for start in 0..grid.len() {
        if seen[start] {
            continue;
        }
        seen[start] = true;
        patch.clear();
        patch.push(start);
        let mut next = 0;
        while next < patch.len() {
            let cell = patch[next];
            next += 1;
            for near in sides(grid, cell) {
                if !seen[near] && (altitude[near] - altitude[cell]).abs() < step_m {
                    seen[near] = true;
                    patch.push(near);
                }
            }
        }
        if patch.len() < fewest {
            for &cell in &patch {
                island[cell] = true;
            }
        }
    }
    island
}

fn sides(grid: &Grid, cell: usize) -> impl Iterator<Item = usize> {
    let (col, row, width) = (cell % grid.width, cell / grid.width, grid.width);
    [
        (col > 0).then(|| cell - 1),
        (col + 1 < width).then(|| cell + 1),
        (row > 0).then(|| cell - width),
        (row + 1 < grid.height).then(|| cell + width),
    ]
    .into_iter()
    .flatten()
}

/// Replaces the `missing` cells, from their edges inward, by the median of the neighbours that are known by then. Without
/// any known cell everything stays as it is.
pub(super) fn fill(grid: &Grid, altitude: &mut [f32], missing: &[bool]) {
    let mut known: Vec<bool> = missing.iter().map(|m| !m).collect();
    let mut left: Vec<usize> = (0..grid.len()).filter(|&cell| missing[cell]).collect();
    let mut near = Vec::new();
    while !left.is_empty() {
        let mut found = Vec::new();
        left.retain(|&cell| {
            near.clear();
            near.extend(around(grid, cell, 1).filter(|&n| known[n]).map(|n| altitude[n]));
            if near.is_empty() {
                return true;
            }
            found.push((cell, median(&mut near)));
            false
        });
        if found.is_empty() {
            return;
        }
        for (cell, value) in found {
            altitude[cell] = value;
            known[cell] = true;
        }
    }
}

/// Cells of a square window, the centre among them.
fn around(grid: &Grid, cell: usize, radius: usize) -> impl Iterator<Item = usize> {
    let (col, row, width) = (cell % grid.width, cell / grid.width, grid.width);
    let columns = col.saturating_sub(radius)..(col + radius + 1).min(width);
    let rows = row.saturating_sub(radius)..(row + radius + 1).min(grid.height);
    rows.flat_map(move |r| columns.clone().map(move |c| r * width + c))
}

fn median(values: &mut [f32]) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Radius of the window over which costs are averaged, cells, for comparisons of this sharpness (root of the sum of the squared
/// ratios of base to height): noise in altitude grows with its inverse, and so does the radius.
pub(super) fn radius_for(sharpness: f32) -> usize {
    (SHARP / sharpness.max(1e-3)).min(WIDEST_RADIUS) as usize
}

/// How many times as dear jumps are for windows of this radius: with a very short base single mismatches are as tall as houses.
pub(super) fn steadiness(radius: usize) -> u16 {
    (radius / 3).max(1) as u16
}

/// Each altitude replaced by that of the plane through its window, fitted to the cells within `tolerance_m` of the window's
/// median, so that a wall in the window does not tilt it.
pub(super) fn planes(grid: &Grid, altitude: &[f32], radius: usize, tolerance_m: f32) -> Vec<f32> {
    if radius == 0 {
        return altitude.to_vec();
    }
    (0..grid.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(|cell| plane_at(grid, altitude, cell, radius, tolerance_m))
        .collect()
}

fn plane_at(grid: &Grid, altitude: &[f32], cell: usize, radius: usize, tolerance_m: f32) -> f32 {
    let mut values: Vec<f32> = around(grid, cell, radius).map(|n| altitude[n]).collect();
    let middle = median(&mut values);
    let (col, row) = ((cell % grid.width) as f64, (cell / grid.width) as f64);
    let (mut n, mut x, mut y, mut z) = (0.0f64, 0.0, 0.0, 0.0);
    let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0f64, 0.0, 0.0, 0.0, 0.0);
    for near in around(grid, cell, radius) {
        if (altitude[near] - middle).abs() > tolerance_m {
            continue;
        }
        let (a, b) = ((near % grid.width) as f64 - col, (near / grid.width) as f64 - row);
        let c = f64::from(altitude[near] - middle);
        n += 1.0;
        (x, y, z) = (x + a, y + b, z + c);
        (xx, xy, yy) = (xx + a * a, xy + a * b, yy + b * b);
        (xz, yz) = (xz + a * c, yz + b * c);
    }
    let (mx, my, mz) = (x / n, y / n, z / n);
    let (xx, xy, yy) = (xx - n * mx * mx, xy - n * mx * my, yy - n * my * my);
    let (xz, yz) = (xz - n * mx * mz, yz - n * my * mz);
    // A little stiffness keeps the slope finite where the cells lie on one line.
    let (xx, yy) = (xx + 1e-3 * n, yy + 1e-3 * n);
    let det = xx * yy - xy * xy;
    let (slope_x, slope_y) = ((xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det);
    middle + (mz - slope_x * mx - slope_y * my) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(width: usize, height: usize) -> Grid {
        Grid {
            width,
            height,
            west_m: 0.0,
            north_m: 0.0,
            cell_m: 1.0,
        }
    }

    #[test]
    fn a_spike_is_an_island_and_takes_the_altitude_around_it() {
        let grid = grid(8, 8);
        let mut altitude = vec![2.0; 64];
        altitude[27] = 40.0;
        altitude[28] = 40.5;
        let island = islands(&grid, &altitude, 1.0, 3);
        assert_eq!(island.iter().filter(|i| **i).count(), 2);
        fill(&grid, &mut altitude, &island);
        assert!(altitude.iter().all(|&z| z == 2.0));
    }

    #[test]
    fn a_house_is_no_island() {
        let grid = grid(9, 9);
        let altitude: Vec<f32> = (0..81)
            .map(|i| {
                if (3..6).contains(&(i % 9)) && (3..6).contains(&(i / 9)) {
                    9.0
                } else {
                    0.0
                }
            })
            .collect();
        assert!(islands(&grid, &altitude, 1.0, 9).iter().all(|i| !i));
    }

    #[test]
    fn a_slope_stays_a_slope_and_a_step_a_step() {
        let grid = grid(20, 20);
        let slope: Vec<f32> = (0..400)
            .map(|i| 0.7 * (i % 20) as f32 - 0.2 * (i / 20) as f32)
            .collect();
        for (smooth, exact) in planes(&grid, &slope, 2, 10.0).iter().zip(&slope) {
            assert!((smooth - exact).abs() < 2e-2, "{smooth} against {exact}");
        }
        let step: Vec<f32> = (0..400).map(|i| if i % 20 < 10 { 0.0 } else { 8.0 }).collect();
        assert_eq!(planes(&grid, &step, 2, 2.0), step);
    }

    #[test]
    fn the_window_widens_and_jumps_get_dearer_as_the_views_tell_less() {
        assert_eq!([0.08, 0.2, 0.3, 0.5, 2.0].map(radius_for), [6, 4, 2, 1, 0]);
        assert_eq!([6, 4, 0].map(steadiness), [2, 1, 1]);
        assert!(radius_for(0.0) <= WIDEST_RADIUS as usize);
    }
}
