//! Post-processing of a matched surface: a speckle filter removes patches too small to be real, and gaps are filled
//! from their edges.

use heliosplat_grid::Grid;
use heliosplat_grid::statistics::upper_median;

/// Speckles: cells of connected patches of fewer than `fewest` cells. Neighbours belong to one patch when their
/// altitudes differ by less than `step_m` metres.
pub(super) fn speckles(grid: &Grid, altitude: &[f32], step_m: f32, fewest: usize) -> Vec<bool> {
    let mut speckle = vec![false; grid.len()];
    let together = |a: usize, b: usize| (altitude[b] - altitude[a]).abs() < step_m;
    for_each_patch(grid, vec![false; grid.len()], together, |patch| {
        if patch.len() < fewest {
            patch.iter().for_each(|&cell| speckle[cell] = true);
        }
    });
    speckle
}

/// Calls `visit` with the cells of each connected patch: neighbours that share a side belong to one patch when they are
/// `together`. Cells marked in `seen` belong to none.
fn for_each_patch(
    grid: &Grid,
    mut seen: Vec<bool>,
    together: impl Fn(usize, usize) -> bool,
    mut visit: impl FnMut(&[usize]),
) {
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
                if !seen[near] && together(cell, near) {
                    seen[near] = true;
                    patch.push(near);
                }
            }
        }
        visit(&patch);
    }
}

/// The up to four neighbours that share a side with a cell.
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

/// Replaces the `missing` cells, from their edges inward, by the median of the neighbours known so far. Without any
/// known cell nothing changes.
pub(super) fn fill(grid: &Grid, altitude: &mut [f32], missing: &[bool]) {
    let mut known: Vec<bool> = missing.iter().map(|m| !m).collect();
    let mut left: Vec<usize> = (0..grid.len()).filter(|&cell| missing[cell]).collect();
    let mut near = Vec::new();
    while !left.is_empty() {
        let mut found = Vec::new();
        left.retain(|&cell| {
            near.clear();
            near.extend(grid.around(cell, 1).filter(|&n| known[n]).map(|n| altitude[n]));
            let value = upper_median(&mut near);
            found.extend(value.map(|value| (cell, value)));
            value.is_none()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spike_is_a_speckle_and_takes_the_altitude_around_it() {
        let grid = Grid::plain(8, 8);
        let mut altitude = vec![2.0; 64];
        altitude[27] = 40.0;
        altitude[28] = 40.5;
        let speckle = speckles(&grid, &altitude, 1.0, 3);
        assert_eq!(speckle.iter().filter(|s| **s).count(), 2);
        fill(&grid, &mut altitude, &speckle);
        assert!(altitude.iter().all(|&z| z == 2.0));
    }

    #[test]
    fn a_house_is_no_speckle() {
        let grid = Grid::plain(9, 9);
        let altitude: Vec<f32> = (0..81)
            .map(|i| {
                if (3..6).contains(&(i % 9)) && (3..6).contains(&(i / 9)) {
                    9.0
                } else {
                    0.0
                }
            })
            .collect();
        assert!(speckles(&grid, &altitude, 1.0, 9).iter().all(|s| !s));
    }
}
