//! Shadows of a surface model on itself, by one sweep of lines away from the sun.
//!
//! From one row to the next (or one column, whichever is nearer to the sun's azimuth) a ray moves aside by less than a
//! cell. It carries the altitude below which it is dark and the distance of the caster of that shadow, and is never
//! resampled: shadows do not blur with their length. A cell lies between two rays, and its visibility is interpolated
//! between theirs. The sun is a disc. Finally visibility is averaged over neighbouring cells, since altitudes place an
//! edge to about half a cell.
//!
//! The page of `view` casts its shadows by the same sweep (`pipelines/pages/src/view/page/sweep.js`) with the same
//! numbers ([`CASTER`]). Limits: each cell has one altitude, so the space under crowns and bridges is missing; unknown
//! cells cast no shadow.

use crate::dsm::altitudes;
use crate::model::LoadedModel;
use crate::nadir::{CellVectors, NadirGrid};
use heliosplat_rpc::sun::SunPosition;
use std::f32::consts::PI;

/// Numbers of the sweep, shared with the page of `view`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Caster {
    /// Mean radius of the sun's disc as seen from the Earth, radians.
    pub sun_radius_rad: f64,
    /// Rise over run between two cells above which a wall stands between them: altitudes are not interpolated over it.
    pub steep: f32,
    /// Distance of a wall's upper edge beyond the middle of the last high cell, cells.
    pub edge_cells: f32,
    /// Height above the surface at which visibility is computed, metres: less than the error of altitudes, and enough
    /// that level roofs do not speckle themselves.
    pub lift_m: f32,
    /// Least height above a far shadow, metres, at which a cell in its half-shade hides the caster of that shadow.
    pub low_m: f32,
}

/// Numbers of shadow masks and of the page.
pub const CASTER: Caster = Caster {
    sun_radius_rad: 0.2666 * std::f64::consts::PI / 180.0,
    steep: 1.0,
    edge_cells: 0.75,
    lift_m: 0.05,
    low_m: 1.0,
};

/// Surface that casts shadows on itself.
pub struct SurfaceShadows {
    width: usize,
    /// Altitudes above the local frame's origin, metres; NaN where unknown.
    up_m: Vec<f32>,
    cells: CellVectors,
}

/// Direction and steps of a sweep over the grid.
struct Sweep {
    /// True if its lines are rows.
    by_row: bool,
    /// True if it begins with the last line.
    from_last: bool,
    /// Lines, and cells of a line.
    lines: usize,
    across: usize,
    /// Cells that a ray moves aside from line to line.
    aside: f64,
    /// Metres from line to line along a ray's way over the ground.
    step_m: f32,
    /// Drop of the sun's rays from line to line, metres.
    drop_m: f32,
    /// Height that the sun's radius spans per line between a cell and the caster of its shadow, metres.
    blur_m: f32,
}

/// State of a ray, carried from line to line.
#[derive(Clone, Copy)]
struct Ray {
    /// Altitude below which it is dark, metres.
    dark_m: f32,
    /// Lines since the caster of the shadow.
    behind: f32,
}

impl SurfaceShadows {
    /// Surface of these altitudes, metres above the frame's origin, NaN where unknown, in rows of `width` cells.
    pub fn of_heights(width: usize, up_m: Vec<f32>, cells: CellVectors) -> Self {
        Self { width, up_m, cells }
    }

    /// Surface of `model` on the grid of `nadir`, unknown where the Gaussians do not cover a cell.
    pub(crate) fn new(model: &LoadedModel, nadir: &NadirGrid) -> Self {
        Self {
            width: nadir.grid.width,
            up_m: altitudes(&nadir.camera, &model.into(), nadir.cell_m()),
            cells: nadir.cell_vectors_m(model.frame.origin.height_m),
        }
    }

    /// Visibility of the sun's disc from each cell, 0 to 1; NaN where the altitude is unknown.
    pub fn lit(&self, sun: &SunPosition) -> Vec<f32> {
        let mut lit: Vec<f32> = self.up_m.iter().map(|up_m| up_m * 0.0 + 1.0).collect();
        if let Some(sweep) = self.sweep(sun) {
            self.cast(&sweep, &mut lit);
        }
        self.averaged(&lit)
    }

    /// Sweep of the surface under a sun; `None` where the sun stands in the zenith and nothing casts a shadow.
    fn sweep(&self, sun: &SunPosition) -> Option<Sweep> {
        let (sin, cos) = sun.elevation_rad.sin_cos();
        if self.up_m.is_empty() || cos < 1e-4 {
            return None;
        }
        let [cols, rows] = self.cells.toward(sun.azimuth_rad.sin_cos().into());
        let by_row = rows.abs() >= cols.abs();
        let (along, aside) = if by_row { (rows, cols) } else { (cols, rows) };
        let height = self.up_m.len() / self.width;
        let (lines, across) = match by_row {
            true => (height, self.width),
            false => (self.width, height),
        };
        let step_m = 1.0 / along.abs();
        Some(Sweep {
            by_row,
            from_last: along > 0.0,
            lines,
            across,
            aside: -aside / along.abs(),
            step_m: step_m as f32,
            drop_m: (step_m * sin / cos) as f32,
            blur_m: (step_m * CASTER.sun_radius_rad / (cos * cos)) as f32,
        })
    }

    /// Writes the visibility of the known cells to `lit`.
    fn cast(&self, sweep: &Sweep, lit: &mut [f32]) {
        let moved = sweep.aside.abs() * sweep.lines as f64;
        // Ray r is at cell r + base + line * aside.
        let base = if sweep.aside >= 0.0 { -moved.ceil() - 1.0 } else { -1.0 };
        let (dark_m, behind) = (f32::NEG_INFINITY, 1.0);
        let nothing = Ray { dark_m, behind };
        let mut rays = vec![nothing; sweep.across + moved.ceil() as usize + 3];
        for number in 0..sweep.lines {
            let line = match sweep.from_last {
                true => sweep.lines - 1 - number,
                false => number,
            };
            let place = |k: usize| match sweep.by_row {
                true => line * self.width + k,
                false => k * self.width + line,
            };
            let at = base + number as f64 * sweep.aside;
            let (whole, part) = (at.floor() as i64, (at - at.floor()) as f32);
            for k in 0..sweep.across {
                let up_m = self.up_m[place(k)];
                if up_m.is_finite() {
                    // The cell lies between the rays k - whole - 1 and k - whole.
                    let first = (k as i64 - whole - 1) as usize;
                    let [a, b] =
                        [rays[first], rays[first + 1]].map(|ray| sweep.seen(up_m + CASTER.lift_m - ray.dark_m, &ray));
                    lit[place(k)] = b + (a - b) * part;
                }
            }
            let altitude = |k: i64| match usize::try_from(k) {
                Ok(k) if k < sweep.across => self.up_m[place(k)],
                _ => f32::NAN,
            };
            for r in (-whole - 1).max(0)..(sweep.across as i64 - whole).min(rays.len() as i64) {
                let between = sweep.between(altitude(r + whole), altitude(r + whole + 1), part);
                sweep.pass(&mut rays[r as usize], between);
            }
        }
    }

    /// Visibility averaged over neighbours, weights 1, 2, 1 along rows and columns; the cell itself takes the place of
    /// an unknown neighbour.
    fn averaged(&self, lit: &[f32]) -> Vec<f32> {
        let (width, count) = (self.width, lit.len());
        let along = |of: &[f32], stride: usize, has: &dyn Fn(usize) -> [bool; 2]| -> Vec<f32> {
            let value = |i: usize, own: f32| if of[i].is_nan() { own } else { of[i] };
            let mean = |i: usize| {
                let own = of[i];
                let [before, after] = has(i);
                let before = if before { value(i - stride, own) } else { own };
                let after = if after { value(i + stride, own) } else { own };
                0.25 * (before + after) + 0.5 * own
            };
            (0..count).map(mean).collect()
        };
        let rows = along(lit, 1, &|i| [i % width > 0, i % width + 1 < width]);
        along(&rows, width, &|i| [i >= width, i + width < count])
    }
}

impl Sweep {
    /// Visible share of the sun at a height above a ray's shadow, metres.
    fn seen(&self, above_m: f32, ray: &Ray) -> f32 {
        let half_m = self.blur_m * ray.behind;
        if above_m >= half_m {
            return 1.0;
        }
        if above_m <= -half_m {
            return 0.0;
        }
        let u = above_m / half_m;
        0.5 + (u * (1.0 - u * u).sqrt() + u.asin()) / PI
    }

    /// Altitude at a share of the way from one cell to the next: linear, but not over walls; beside an unknown cell the
    /// altitude of the known one.
    fn between(&self, a: f32, b: f32, part: f32) -> f32 {
        match (a.is_nan(), b.is_nan()) {
            (true, _) => b,
            (_, true) => a,
            _ if (a - b).abs() <= CASTER.steep * self.step_m => a - (a - b) * part,
            _ if part < 0.5 => a,
            _ => b,
        }
    }

    /// Moves a ray over a line of altitude `up_m` (metres, NaN: unknown) to the next one.
    fn pass(&self, ray: &mut Ray, up_m: f32) {
        let clear_m = up_m - ray.dark_m;
        if clear_m >= CASTER.low_m || clear_m >= self.blur_m * ray.behind {
            (ray.dark_m, ray.behind) = (up_m, 0.0);
        } else if ray.behind == 1.0 && ray.dark_m + self.drop_m - up_m > CASTER.steep * self.step_m {
            // A wall: its edge stands beyond the middle of the cell before.
            ray.dark_m += CASTER.edge_cells * self.drop_m;
            ray.behind -= CASTER.edge_cells;
        }
        ray.dark_m -= self.drop_m;
        ray.behind += 1.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CELL_M: f64 = 0.5;

    fn surface(width: usize, up_m: Vec<f32>) -> SurfaceShadows {
        let cells = CellVectors {
            per_col: [CELL_M, 0.0],
            per_row: [0.0, -CELL_M],
        };
        SurfaceShadows::of_heights(width, up_m, cells)
    }

    /// A tower of 5 x 5 cells, 10 m high, in the middle of level ground.
    fn tower() -> Vec<f32> {
        let high = |i: usize| (48..53).contains(&(i % 101)) && (48..53).contains(&(i / 101));
        (0..101 * 101).map(|i| if high(i) { 10.0 } else { 0.0 }).collect()
    }

    #[test]
    fn a_tower_s_shadow_is_as_long_as_its_height_over_the_tangent() {
        let surface = surface(101, tower());
        for (azimuth_deg, [east, north]) in [(0.0, [0, -1]), (90.0, [-1, 0]), (180.0, [0, 1]), (270.0, [1, 0])] {
            for elevation_deg in [35.0, 50.0, 65.0f64] {
                let lit = surface.lit(&SunPosition::from_degrees(azimuth_deg, elevation_deg));
                let at = |cells: i32| lit[((50 - cells * north) * 101 + 50 + cells * east) as usize];
                let length = 10.0 / elevation_deg.to_radians().tan() / CELL_M;
                let dark = (3..50).filter(|&cells| at(cells) < 0.5).count() as f64;
                assert!(
                    (dark - length).abs() <= 1.0,
                    "{azimuth_deg}, {elevation_deg}: {dark} of {length}"
                );
                assert!(
                    (3..50).all(|cells| at(-cells) == 1.0),
                    "{azimuth_deg}: lit toward the sun"
                );
            }
        }
    }

    #[test]
    fn a_shadow_falls_away_from_a_sun_that_stands_askew() {
        let surface = surface(101, tower());
        // From the south-west at 45 degrees: ten metres to the north-east are 14 cells east and 14 north.
        let lit = surface.lit(&SunPosition::from_degrees(225.0, 45.0));
        let at = |east: usize, north: usize| lit[(50 - north) * 101 + 50 + east];
        assert!(at(10, 10) == 0.0 && at(20, 20) == 1.0 && at(10, 0) == 1.0);
        assert!(lit[(50 + 10) * 101 + 40] == 1.0);
    }

    #[test]
    fn ground_that_is_rough_by_centimetres_is_lit_under_a_low_sun() {
        let rough = (0..101 * 101).map(|i| 0.02 * ((i * 7919) % 13) as f32 / 13.0).collect();
        let lit = surface(101, rough).lit(&SunPosition::from_degrees(140.0, 10.0));
        assert!(lit.iter().all(|lit| *lit == 1.0));
    }

    #[test]
    fn unknown_cells_see_nothing_and_hide_nothing() {
        let mut up_m = tower();
        up_m.iter_mut().filter(|z| **z > 0.0).for_each(|z| *z = f32::NAN);
        let lit = surface(101, up_m).lit(&SunPosition::from_degrees(30.0, 20.0));
        assert_eq!(lit.iter().filter(|lit| lit.is_nan()).count(), 25);
        assert!(lit.iter().all(|lit| lit.is_nan() || *lit == 1.0));
    }
}
