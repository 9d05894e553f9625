//! Closing holes of a surface model.
//!
//! Most holes are ground that something tall hides from all images but one, so they are closed with the lower of what is around them: a
//! cell has the lower quartile of the altitudes beside it, from the hole's edges inward. Unknown cells that reach the border of the
//! raster are no hole: the scene ends there.

use heliosplat_rpc::statistics::upper_quantile;

/// Which of the altitudes around a cell it takes.
const QUARTILE: f64 = 0.25;

/// Gives altitudes to the unknown cells (NaN) of a raster of `width` columns that known ones enclose; returns which.
pub(super) fn close_holes(width: usize, altitude_m: &mut [f32]) -> Vec<usize> {
    let height = altitude_m.len() / width.max(1);
    let around = |cell: usize| {
        let (col, row) = (cell % width, cell / width);
        let rows = row.saturating_sub(1)..(row + 2).min(height);
        rows.flat_map(move |r| (col.saturating_sub(1)..(col + 2).min(width)).map(move |c| r * width + c))
    };
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
    let mut left = closed.clone();
    let mut near = Vec::with_capacity(8);
    while !left.is_empty() {
        let mut found = Vec::new();
        left.retain(|&cell| {
            near.clear();
            near.extend(around(cell).map(|n| altitude_m[n]).filter(|z| z.is_finite()));
            let value = upper_quantile(&mut near, QUARTILE);
            found.extend(value.map(|value| (cell, value)));
            value.is_none()
        });
        // All of a hole's cells at one distance from its edge take theirs at once, whatever the order of cells.
        for (cell, value) in found {
            altitude_m[cell] = value;
        }
    }
    closed
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
