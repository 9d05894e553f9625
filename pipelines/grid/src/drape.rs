//! The ground below a surface model, as a cloth draped over the surface from below.
//!
//! The cloth is stiff and is lifted step by step until it meets the surface: it lies on the ground, and spans buildings
//! from one side to the other. It starts on a coarse grid, on which the widest building is about a cell wide, and
//! continues on ever finer ones. On coarse grids it resists bending away from its shape on the next coarser one, so
//! slopes and valleys stay; on fine ones away from level, so it does not rise onto wide roofs. The idea is that of the
//! cloth simulation filter (Zhang et al., "An easy-to-use airborne LiDAR data filtering method based on cloth
//! simulation", Remote Sensing 8, 2016) on a pyramid of grids, as in Lallement et al., "Bulldozer, a free open source
//! scalable software for DTM extraction", ISPRS Archives XLIII-B4, 2022. The implementation is our own.
//!
//! Limits: objects wider than `WIDEST_M` count as ground; steep hills and ground above cliffs are too low; below
//! buildings on a slope the ground is a smooth span.

use crate::in_parallel;
use rayon::prelude::*;

/// Width of the widest building, metres; wider objects count as ground.
const WIDEST_M: f32 = 64.0;
/// Steepest slope that the cloth follows from one grid to the next, rise over run, on cells of [`COARSE_M`] and wider, on
/// which it has begun at the lowest cells around, and on narrower ones.
const SLOPES: [f32; 2] = [2.0, 0.5];
const COARSE_M: f32 = 0.5 * WIDEST_M;
/// Width of the cells from which on the cloth keeps the shape of the coarser grid, metres (docs/lab/terrain.md).
const SHAPED_M: f32 = 8.0;
/// Lifts on each grid, and rounds of smoothing after each lift.
const LIFTS: usize = 10;
const ROUNDS: usize = 5;
/// Largest height of a ground cell above the cloth, metres: the noise of surface models, and less than the height of
/// objects on the ground.
const GROUND_M: f32 = 0.5;
/// Distance to objects within which cells are spanned instead of taken as ground, cells and metres, the larger counts:
/// the windows of the matching, up to seven pixels wide, raise the ground beside walls there (docs/lab/terrain.md).
const RIM_CELLS: usize = 4;
const RIM_M: f32 = 2.0;
/// Cells that one thread works on at a time, at least.
const CHUNK: usize = 1024;

/// Altitudes of the ground below a surface, metres. `altitude_m` is the surface on a grid of `(width, height)` cells of
/// `cell_m` metres, row by row; NaN where it is unknown, in the result too.
pub fn ground((width, height): (usize, usize), cell_m: f32, altitude_m: &[f32]) -> Vec<f32> {
    if altitude_m.is_empty() {
        return Vec::new();
    }
    let mut levels = vec![Level {
        width,
        height,
        cell_m,
        surface: altitude_m.to_vec(),
    }];
    while let Some(coarser) = levels.last().and_then(Level::coarser) {
        levels.push(coarser);
    }
    let mut cloth: Option<(Level, Vec<f32>)> = None;
    for level in levels.into_iter().rev() {
        let begun = match &cloth {
            None => level.lowest_around(),
            Some((coarse, cloth)) => level.finer_of(coarse, cloth),
        };
        let draped = level.draped(&begun);
        cloth = Some((level, draped));
    }
    let Some((level, cloth)) = cloth else {
        return Vec::new();
    };
    level.ground_below(&cloth)
}

/// A grid of the pyramid.
struct Level {
    width: usize,
    height: usize,
    cell_m: f32,
    surface: Vec<f32>,
}

impl Level {
    /// Next coarser grid of the pyramid, with cells twice as wide; `None` beyond the width of the widest building. Each
    /// cell gets the second lowest of its four altitudes, which one low outlier does not change.
    fn coarser(&self) -> Option<Self> {
        let is_wide = 2.0 * self.cell_m > WIDEST_M || self.width.max(self.height) < 4;
        let second_lowest = |known: &mut [f32]| {
            known.sort_by(f32::total_cmp);
            known[1.min(known.len() - 1)]
        };
        (!is_wide).then(|| self.halved(second_lowest))
    }

    /// Grid of cells twice as wide; `of` reduces the known ones of four values to one, NaN where none is known.
    fn halved(&self, of: impl Fn(&mut [f32]) -> f32 + Sync) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let cells = in_parallel(width * height);
        let surface = cells.map(|cell| {
            let (col, row) = (2 * (cell % width), 2 * (cell / width));
            let mut known = [0.0; 4];
            let mut count = 0;
            for (c, r) in [(col, row), (col + 1, row), (col, row + 1), (col + 1, row + 1)] {
                if c < self.width && r < self.height && self.surface[r * self.width + c].is_finite() {
                    known[count] = self.surface[r * self.width + c];
                    count += 1;
                }
            }
            match count {
                0 => f32::NAN,
                _ => of(&mut known[..count]),
            }
        });
        Self {
            width,
            height,
            cell_m: 2.0 * self.cell_m,
            surface: surface.collect(),
        }
    }

    /// Initial cloth on the coarsest grid, metres: for each cell the lowest altitude of the cells around.
    fn lowest_around(&self) -> Vec<f32> {
        let known: Vec<f32> = self
            .surface
            .iter()
            .map(|z| if z.is_nan() { f32::MAX } else { *z })
            .collect();
        let lowest = known.iter().copied().fold(f32::MAX, f32::min);
        let around = super::lowest_within((self.width, self.height), &known, [1, 1]);
        around
            .into_iter()
            .map(|z| if z == f32::MAX { lowest } else { z })
            .collect()
    }

    /// Cloth of the next coarser grid, interpolated to this one.
    fn finer_of(&self, coarse: &Level, cloth: &[f32]) -> Vec<f32> {
        let at = |cell: usize| {
            let [col, row] = [cell % self.width, cell / self.width].map(|place| (place as f64 - 0.5) / 2.0);
            super::bilinear_to_the_edge(cloth, (coarse.width, coarse.height), col, row)
        };
        let cells = in_parallel(self.width * self.height);
        cells.map(at).collect()
    }

    /// Cloth after all lifts on this grid, which it comes to in the shape `begun`.
    fn draped(&self, begun: &[f32]) -> Vec<f32> {
        // All lifts together equal the rise of the steepest ground over a cell of the coarser grid.
        let slope = SLOPES[usize::from(self.cell_m < COARSE_M)];
        let lift_m = 2.0 * slope * self.cell_m / LIFTS as f32;
        // Unknown cells do not hold the cloth, nor do cells deeper below it than ground falls within a cell.
        let deepest_m = SLOPES[1] * self.cell_m + 2.0 * GROUND_M;
        let cells = self.surface.iter().zip(begun);
        let held = cells.map(|(z, begun)| if z - begun < -deepest_m { f32::NAN } else { *z });
        // Bending is that of the difference to this shape.
        let shape = if self.cell_m < SHAPED_M {
            vec![0.0; begun.len()]
        } else {
            begun.to_vec()
        };
        let room: Vec<f32> = held.zip(&shape).map(|(z, shape)| z - shape).collect();
        let hold = |rise: &mut [f32]| {
            let cells = rise.par_iter_mut().with_min_len(CHUNK).zip(&room);
            // `min` ignores NaN.
            cells.for_each(|(rise, room)| *rise = rise.min(*room));
        };
        let mut rise: Vec<f32> = begun.iter().zip(&shape).map(|(begun, shape)| begun - shape).collect();
        for _ in 0..LIFTS {
            rise.par_iter_mut().with_min_len(CHUNK).for_each(|z| *z += lift_m);
            for _ in 0..ROUNDS {
                hold(&mut rise);
                rise = self.smoothed(&rise);
            }
        }
        hold(&mut rise);
        shape.iter().zip(&rise).map(|(shape, rise)| shape + rise).collect()
    }

    /// The mean of each cell and its eight neighbours.
    fn smoothed(&self, values: &[f32]) -> Vec<f32> {
        let mean = |a: f32, b: f32, c: f32| (a + b + c) / 3.0;
        let (width, last) = (self.width, self.height - 1);
        let mut across = vec![0.0; values.len()];
        let rows = across.par_chunks_mut(width).zip(values.par_chunks(width));
        rows.for_each(|(out, row)| {
            for (col, out) in out.iter_mut().enumerate() {
                *out = mean(row[col.saturating_sub(1)], row[col], row[(col + 1).min(width - 1)]);
            }
        });
        let mut both = vec![0.0; values.len()];
        both.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
            let line = |row: usize| &across[row * width..(row + 1) * width];
            let lines = [line(row.saturating_sub(1)), line(row), line((row + 1).min(last))];
            for (col, out) in out.iter_mut().enumerate() {
                *out = mean(lines[0][col], lines[1][col], lines[2][col]);
            }
        });
        both
    }

    /// Ground from the cloth: the surface where it lies on the cloth and no object is near, elsewhere a smooth span
    /// between such cells. Cells twice [`GROUND_M`] above the cloth are objects, those far below it outliers.
    fn ground_below(&self, cloth: &[f32]) -> Vec<f32> {
        let above_m = || self.surface.iter().zip(cloth).map(|(surface, cloth)| surface - cloth);
        let free: Vec<f32> = above_m().map(|z| if z > 2.0 * GROUND_M { 0.0 } else { 1.0 }).collect();
        let rim = RIM_CELLS.max((RIM_M / self.cell_m).round() as usize);
        let free = super::lowest_within((self.width, self.height), &free, [rim, rim]);
        let ground = above_m().zip(&self.surface).zip(free);
        let is_ground = |((above, z), free): ((f32, &f32), f32)| (above.abs() <= GROUND_M && free > 0.0).then_some(*z);
        let ground: Vec<f32> = ground.map(|cell| is_ground(cell).unwrap_or(f32::NAN)).collect();
        let mut spanned = Self {
            surface: ground,
            ..*self
        }
        .spanned();
        for ((z, surface), cloth) in spanned.iter_mut().zip(&self.surface).zip(cloth) {
            *z = match surface.is_nan() {
                true => f32::NAN,
                // Without ground nearby the cloth is the only estimate.
                false if z.is_nan() => *cloth,
                false => z.min(*surface),
            };
        }
        spanned
    }

    /// Values of the grid; unknown ones come from the grid of cells twice as wide, and are smoothed.
    fn spanned(&self) -> Vec<f32> {
        let is_known: Vec<bool> = self.surface.iter().map(|z| z.is_finite()).collect();
        if self.width.max(self.height) < 2 || !is_known.contains(&false) || !is_known.contains(&true) {
            return self.surface.clone();
        }
        let coarse = self.halved(|known| known.iter().sum::<f32>() / known.len() as f32);
        let mut values = self.finer_of(&coarse, &coarse.spanned());
        let keep = |values: &mut Vec<f32>| {
            let cells = values.par_iter_mut().with_min_len(CHUNK).zip(&self.surface);
            cells.filter(|(_, z)| z.is_finite()).for_each(|(value, z)| *value = *z);
        };
        keep(&mut values);
        for _ in 0..LIFTS {
            values = self.smoothed(&values);
            keep(&mut values);
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 200 × 160 cells of half a metre on ground of the given altitudes, with a house of 20 m × 15 m, 9 m high, whose
    /// foot is raised as matching windows do, and unknown cells. The surface and its ground.
    fn site(altitude: impl Fn(f32) -> f32) -> (Vec<f32>, Vec<f32>) {
        let (mut surface, mut ground) = (Vec::new(), Vec::new());
        for row in 0..160usize {
            for col in 0..200usize {
                let z = 100.0 + altitude(0.5 * col as f32) + 0.05 * ((col * 7 + row * 13) % 5) as f32;
                let is_house = (60..100).contains(&col) && (50..80).contains(&row);
                ground.push(z);
                surface.push(match (col, row) {
                    _ if is_house => z + 9.0,
                    (58..102, 48..82) => z + 0.4,
                    (150..160, 20..30) => f32::NAN,
                    _ => z,
                });
            }
        }
        (surface, ground)
    }

    /// Mean and largest error of the ground below the surface of [`site`], metres, without the cells `left_out`.
    fn errors(surface: &[f32], truth: &[f32], left_out: impl Fn(usize) -> bool) -> [f32; 2] {
        let found = ground((200, 160), 0.5, surface);
        assert!(found.iter().zip(surface).all(|(found, z)| found.is_nan() == z.is_nan()));
        let known = (0..found.len()).filter(|&cell| !found[cell].is_nan() && !left_out(cell));
        let errors: Vec<f32> = known.map(|cell| (found[cell] - truth[cell]).abs()).collect();
        let mean = errors.iter().sum::<f32>() / errors.len() as f32;
        [mean, errors.into_iter().fold(0.0, f32::max)]
    }

    #[test]
    fn the_ground_of_a_slope_is_found_and_spans_below_a_house() {
        for (slope, bounds) in [(0.0, [0.1, 0.3]), (0.2, [0.1, 0.3]), (-0.4, [0.5, 6.0])] {
            let (surface, truth) = site(|x| slope * x);
            let found = errors(&surface, &truth, |_| false);
            assert!(found[0] < bounds[0] && found[1] < bounds[1], "slope {slope}: {found:?}");
        }
    }

    #[test]
    fn a_valley_below_the_sides_of_the_site_is_ground() {
        let (surface, truth) = site(|x| -20.0 * (-(x - 70.0).powi(2) / 800.0).exp());
        let [mean, largest] = errors(&surface, &truth, |_| false);
        assert!(mean < 1.5, "{mean} {largest}");
    }

    #[test]
    fn wide_roofs_are_no_ground_at_the_rim_either() {
        let (mut surface, truth) = site(|_| 0.0);
        // 80 m x 25 m, 9 m high, at the southern rim.
        let is_roof = |cell: usize| (30..190).contains(&(cell % 200)) && cell / 200 >= 110;
        (0..surface.len())
            .filter(|&cell| is_roof(cell))
            .for_each(|cell| surface[cell] += 9.0);
        let [mean, largest] = errors(&surface, &truth, |cell| !is_roof(cell));
        assert!(mean < 0.5 && largest < 2.0, "{mean} {largest}");
    }

    #[test]
    fn patches_far_below_the_ground_do_not_pull_it_down() {
        let (mut surface, truth) = site(|x| 0.2 * x);
        let is_wrong = |cell: usize| ((cell % 200) / 3).is_multiple_of(4) && (140..146).contains(&(cell / 200));
        (0..surface.len())
            .filter(|&cell| is_wrong(cell))
            .for_each(|cell| surface[cell] -= 25.0);
        let [mean, largest] = errors(&surface, &truth, is_wrong);
        assert!(mean < 0.1 && largest < 0.3, "{mean} {largest}");
    }

    #[test]
    fn what_is_empty_or_unknown_has_no_ground() {
        assert!(ground((0, 0), 0.5, &[]).is_empty());
        assert!(ground((3, 2), 0.5, &[f32::NAN; 6]).iter().all(|z| z.is_nan()));
    }
}
