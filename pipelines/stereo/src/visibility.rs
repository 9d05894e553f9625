//! What each view sees first of a surface: a point below that is hidden.

use super::grid::{Grid, lowest_within};
use super::views::LevelView;
use rayon::prelude::*;

/// Altitude at which the ray of each pixel meets the surface first; below it nothing is seen.
pub(super) struct FirstHits {
    altitude: Vec<f32>,
    width: usize,
    /// A point this far below the first hit may still be the surface itself.
    tolerance_m: f32,
}

/// Cells of a tile whose highest altitude bounds where a ray can start.
const TILE: usize = 16;

/// Highest altitude of tiles of a surface.
struct Roof {
    grid: Grid,
    highest: Vec<f32>,
    top_m: f32,
    bottom_m: f32,
}

impl Roof {
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
            bottom_m: altitude.iter().copied().fold(f32::MAX, f32::min),
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
    pub(super) fn new(view: &LevelView, grid: &Grid, altitude: &[f32], tolerance_m: f32) -> Self {
        let altitude = &lowest_within((grid.width, grid.height), altitude, 1);
        let roof = Roof::new(grid, altitude);
        let mut hits = vec![f32::MIN; view.width * view.height];
        hits.par_chunks_mut(view.width.max(1))
            .enumerate()
            .for_each(|(row, line)| {
                for (col, hit) in line.iter_mut().enumerate() {
                    *hit = first_hit(view, (col as f32, row as f32), grid, altitude, &roof);
                }
            });
        Self {
            altitude: hits,
            width: view.width,
            tolerance_m,
        }
    }

    /// Columns of the view.
    pub(super) fn width(&self) -> usize {
        self.width
    }

    /// Whether a point that projects into a pixel lies behind the surface.
    #[inline]
    pub(super) fn hides(&self, pixel: usize, altitude_m: f32) -> bool {
        altitude_m + self.tolerance_m < self.altitude[pixel]
    }
}

/// Walks down the ray of a pixel until it is below the surface; `f32::MIN` where it never is.
fn first_hit(view: &LevelView, (col, row): (f32, f32), grid: &Grid, altitude: &[f32], roof: &Roof) -> f32 {
    let at = |z: f32| view.camera.point_at_altitude(col, row, z);
    let (Some(mut start), Some(end)) = (at(roof.top_m), at(roof.bottom_m)) else {
        return f32::MIN;
    };
    for _ in 0..2 {
        // The higher the surface under the ray can be, the earlier the walk must begin; and the other way round.
        let top = roof.over(start, end).min(start.z);
        start = at(top).unwrap_or(start);
    }
    let steps = ((end - start).truncate().length() / (0.7 * grid.cell_m))
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
