//! Visibility: for each pixel of a view, the altitude at which its ray meets the surface first; a point below that is
//! hidden.
//!
//! Rays are walked down over the grid in steps of less than a cell, from an altitude that is bounded by the highest
//! cells under them.

use heliosplat::ProjectiveCamera;
use heliosplat_grid::{Grid, lowest_within};
use rayon::prelude::*;

/// Altitude at which the ray of each pixel meets the surface first, metres; points below it are hidden.
pub(super) struct FirstHits {
    altitude: Vec<f32>,
    /// A point this far below the first hit may still be the surface itself.
    tolerance_m: f32,
}

/// Side of a tile whose highest altitude bounds where a ray can start, cells.
const TILE: usize = 16;
/// Length of a step along a ray over the ground, cells: shorter than a cell, so that no cell is stepped over along an
/// axis.
const STEP_CELLS: f32 = 0.7;
/// Rounds of lowering the start of a ray by the tiles under it.
const BOUND_ROUNDS: usize = 2;
/// Cells each way to whose lowest altitude an occluder is lowered, so that a surface one cell too wide hides nothing.
const EDGE_CELLS: usize = 1;

/// A surface as an occluder.
pub(super) struct Standing {
    grid: Grid,
    altitude: Vec<f32>,
    highest: HighestTiles,
    tolerance_m: f32,
}

impl Standing {
    /// The occluder from the altitudes of a grid's cells (metres; `f32::MIN` where there is no surface). A point hides
    /// others that are more than `tolerance_m` below it.
    pub(super) fn new(grid: &Grid, altitude: &[f32], tolerance_m: f32) -> Self {
        let altitude = lowest_within((grid.width, grid.height), altitude, [EDGE_CELLS; 2]);
        Self {
            grid: *grid,
            highest: HighestTiles::new(grid, &altitude),
            altitude,
            tolerance_m,
        }
    }
}

/// Highest altitude of tiles of a surface.
struct HighestTiles {
    grid: Grid,
    highest: Vec<f32>,
    top_m: f32,
    bottom_m: f32,
}

impl HighestTiles {
    fn new(grid: &Grid, altitude: &[f32]) -> Self {
        let coarse = grid.coarser(TILE);
        let mut highest = vec![f32::MIN; coarse.len()];
        for row in 0..grid.height {
            for col in 0..grid.width {
                let tile = &mut highest[row / TILE * coarse.width + col / TILE];
                *tile = tile.max(altitude[row * grid.width + col]);
            }
        }
        Self {
            grid: coarse,
            top_m: highest.iter().copied().fold(f32::MIN, f32::max),
            bottom_m: altitude
                .iter()
                .copied()
                .filter(|z| *z > f32::MIN)
                .fold(f32::MAX, f32::min),
            highest,
        }
    }

    /// The highest altitude of the tiles under the box of two positions.
    fn over(&self, a: glam::Vec3, b: glam::Vec3) -> f32 {
        let (low, high) = (a.min(b), a.max(b));
        let (north_west, south_east) = (self.grid.nearest(low.x, high.y), self.grid.nearest(high.x, low.y));
        let (row0, row1) = (north_west / self.grid.width, south_east / self.grid.width);
        let (col0, col1) = (north_west % self.grid.width, south_east % self.grid.width);
        let mut highest = f32::MIN;
        for row in row0..=row1 {
            let line = &self.highest[row * self.grid.width..(row + 1) * self.grid.width];
            highest = line[col0..=col1].iter().copied().fold(highest, f32::max);
        }
        highest
    }
}

impl FirstHits {
    /// First hits of the rays of all pixels of `camera` on a surface.
    pub(super) fn new(camera: &ProjectiveCamera, surface: &Standing) -> Self {
        let (highest, tolerance_m) = (&surface.highest, surface.tolerance_m);
        let mut altitude = vec![f32::MIN; camera.width * camera.height];
        // Without a top there is no surface to hit.
        if highest.top_m != f32::MIN {
            let lines = altitude.par_chunks_mut(camera.width.max(1)).enumerate();
            lines.for_each(|(row, line)| {
                for (col, hit) in line.iter_mut().enumerate() {
                    let at = (col as f32, row as f32);
                    *hit = first_hit(camera, at, &surface.grid, &surface.altitude, highest);
                }
            });
        }
        Self { altitude, tolerance_m }
    }

    /// True if the surface hides a point at an altitude, metres, that projects into a pixel (index in row order).
    #[inline]
    pub(super) fn hides(&self, pixel: usize, altitude_m: f32) -> bool {
        altitude_m + self.tolerance_m < self.altitude[pixel]
    }
}

/// Walks down the ray of a pixel until it is below the surface; `f32::MIN` where it never is.
fn first_hit(
    camera: &ProjectiveCamera,
    (col, row): (f32, f32),
    grid: &Grid,
    altitude: &[f32],
    highest: &HighestTiles,
) -> f32 {
    let at = |z: f32| camera.point_at_altitude(col, row, z);
    let (Some(mut start), Some(end)) = (at(highest.top_m), at(highest.bottom_m)) else {
        return f32::MIN;
    };
    // For a small ground grid most rays of an image miss it.
    if grid.is_outside(start, end) {
        return f32::MIN;
    }
    for _ in 0..BOUND_ROUNDS {
        // The higher the surface under the ray can be, the earlier the walk must begin; and the other way round. Where
        // nothing under it is known, the lowest known altitude is the bound.
        let top = highest.over(start, end).max(highest.bottom_m).min(start.z);
        start = at(top).unwrap_or(start);
    }
    let steps = ((end - start).truncate().length() / (STEP_CELLS * grid.cell_m))
        .ceil()
        .max(1.0);
    let mut above = start.z;
    for step in 0..=steps as usize {
        let p = start + (end - start) * (step as f32 / steps);
        if grid.contains(p.x, p.y) {
            let surface = altitude[grid.nearest(p.x, p.y)];
            if surface >= p.z {
                return surface.min(above);
            }
        }
        above = p.z;
    }
    f32::MIN
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_that_pass_beside_the_ground_meet_nothing_and_others_meet_what_they_met_on_wider_ground() {
        let camera = ProjectiveCamera::new(
            [1.0, 0.0, 0.6, 60.0],
            [0.0, -1.0, 0.4, 60.0],
            [0.0; 3],
            (120, 120),
            glam::DVec3::new(0.6, -0.4, -1.0).normalize(),
        );
        let grid = |cells: usize| Grid {
            width: cells,
            height: cells,
            west_m: -0.5 * cells as f32,
            north_m: 0.5 * cells as f32,
            cell_m: 1.0,
        };
        // A house on small ground in the middle, and the same with nothing around it.
        let (small, wide) = (grid(20), grid(100));
        let is_house = |at: usize, cells: usize| (cells / 2 - 5..cells / 2 + 5).contains(&at);
        let altitude = |grid: &Grid| -> Vec<f32> {
            let cells = grid.width;
            let of_cell = |cell: usize| {
                let (col, row) = (cell % cells, cell / cells);
                let within = |at: usize| (cells / 2 - 10..cells / 2 + 10).contains(&at);
                match (is_house(col, cells) && is_house(row, cells), within(col) && within(row)) {
                    (true, _) => 9.0,
                    (false, true) => 0.0,
                    (false, false) => f32::MIN,
                }
            };
            (0..grid.len()).map(of_cell).collect()
        };
        let hits = |grid: &Grid| {
            let standing = Standing {
                grid: *grid,
                altitude: altitude(grid),
                highest: HighestTiles::new(grid, &altitude(grid)),
                tolerance_m: 1.0,
            };
            FirstHits::new(&camera, &standing).altitude
        };
        let (of_small, of_wide) = (hits(&small), hits(&wide));
        let outside = |pixel: usize| {
            let at = |z: f32| camera.point_at_altitude((pixel % 120) as f32, (pixel / 120) as f32, z);
            at(9.0).zip(at(0.0)).is_some_and(|(a, b)| small.is_outside(a, b))
        };
        let passing = (0..120 * 120).filter(|&pixel| outside(pixel)).count();
        assert!(passing > 120 * 120 / 2, "{passing}");
        for pixel in 0..120 * 120 {
            assert_eq!(of_small[pixel] > f32::MIN, of_wide[pixel] > f32::MIN, "{pixel}");
            assert!(!outside(pixel) || of_small[pixel] == f32::MIN, "{pixel}");
        }
        assert!(of_small.iter().filter(|hit| **hit == 9.0).count() > 80);
    }
}
