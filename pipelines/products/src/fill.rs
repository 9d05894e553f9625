//! Closing holes of a surface model.
//!
//! Most holes are ground that something tall hides from all images but one, so they are filled from low altitudes: a
//! cell takes the lower quartile of the altitudes beside it, and the lowest cells come first, so that the ground
//! spreads up to the foot of a tower before the tower's roof contributes. Unknown cells that reach the border of the
//! raster are no hole: the scene ends there.

use heliosplat_grid::around;
use heliosplat_grid::statistics::upper_quantile;
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

/// Quantile of the neighbouring altitudes that fills an unknown cell.
const QUARTILE: f64 = 0.25;

/// Fills the unknown altitudes (NaN) that known ones enclose, metres, in a raster of `width` columns; returns the
/// indices of the filled cells.
pub(super) fn close_holes(width: usize, altitude_m: &mut [f32]) -> Vec<usize> {
    let height = altitude_m.len() / width.max(1);
    let around = |cell: usize| around((width, height), cell, 1);
    let mut outside = vec![false; altitude_m.len()];
    let mut reached: Vec<usize> = (0..altitude_m.len())
        .filter(|&cell| {
            let (col, row) = (cell % width, cell / width);
            let border = col == 0 || row == 0 || col + 1 == width || row + 1 == height;
            border && altitude_m[cell].is_nan()
        })
        .collect();
    reached.iter().for_each(|&cell| outside[cell] = true);
    while let Some(cell) = reached.pop() {
        for near in around(cell) {
            if !outside[near] && altitude_m[near].is_nan() {
                outside[near] = true;
                reached.push(near);
            }
        }
    }
    let closed: Vec<usize> = (0..altitude_m.len())
        .filter(|&cell| altitude_m[cell].is_nan() && !outside[cell])
        .collect();
    let mut near = Vec::with_capacity(8);
    let mut candidate = |altitude_m: &[f32], cell: usize| {
        near.clear();
        near.extend(around(cell).map(|n| altitude_m[n]).filter(|z| z.is_finite()));
        upper_quantile(&mut near, QUARTILE).map(|altitude_m| Reverse(Candidate { altitude_m, cell }))
    };
    let mut waiting: BinaryHeap<Reverse<Candidate>> =
        closed.iter().filter_map(|&cell| candidate(altitude_m, cell)).collect();
    while let Some(Reverse(lowest)) = waiting.pop() {
        if altitude_m[lowest.cell].is_finite() {
            continue;
        }
        // A neighbour that was filled meanwhile may have changed it.
        match candidate(altitude_m, lowest.cell) {
            Some(now) if now.0 == lowest => altitude_m[lowest.cell] = lowest.altitude_m,
            now => {
                waiting.extend(now);
                continue;
            }
        }
        let beside = around(lowest.cell).filter(|&n| altitude_m[n].is_nan() && !outside[n]);
        let again: Vec<_> = beside.filter_map(|cell| candidate(altitude_m, cell)).collect();
        waiting.extend(again);
    }
    closed
}

/// An altitude for a cell; ordered by altitude, then by cell, so that the order of filling is always the same.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Candidate {
    altitude_m: f32,
    cell: usize,
}

impl Eq for Candidate {}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_altitude = self.altitude_m.total_cmp(&other.altitude_m);
        by_altitude.then(self.cell.cmp(&other.cell))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_beside_a_tower_takes_the_ground_and_what_reaches_the_border_stays_unknown() {
        const WIDTH: usize = 12;
        let mut altitude: Vec<f32> = (0..WIDTH * 8).map(|i| if i % WIDTH > 7 { 30.0 } else { 1.0 }).collect();
        let hole: Vec<usize> = (2..6)
            .flat_map(|row| (5..8).map(move |col| row * WIDTH + col))
            .collect();
        hole.iter().for_each(|&cell| altitude[cell] = f32::NAN);
        altitude[0] = f32::NAN;
        altitude[1] = f32::NAN;
        let closed = close_holes(WIDTH, &mut altitude);
        assert_eq!(closed, hole);
        assert!(hole.iter().all(|&cell| altitude[cell] == 1.0), "{altitude:?}");
        assert!(altitude[0].is_nan() && altitude[1].is_nan());
    }
}
