//! A surface of heights under the sun: the horizon of a cell in a direction, and cast shadows.
//!
//! A ray from a cell crosses the grid one row or column at a time; the height is linear between the two cells that it
//! passes there. The horizon is the largest rise over distance on the way. Blocks of cells too low to matter are
//! skipped, which changes no result. A cell is in shadow when its horizon is above the sun.
//!
//! Limits: a surface has one height for each cell, so space under trees and bridges is missing; the Earth is flat (over
//! 5 km it falls by 2 m); the sun is a point. A cell of unknown height casts no shadow and has no horizon.

use rayon::prelude::*;

/// Side of the blocks of cells that rays step over, cells.
const SQUARE: usize = 16;

/// Heights on a grid that rays are walked over; unknown cells never block a ray.
pub struct Relief {
    /// Number of columns.
    pub width: usize,
    /// Number of rows, the first in the north.
    pub height: usize,
    /// Side of a cell, metres.
    pub cell_m: f32,
    altitude: Vec<f32>,
    top_m: f32,
    /// Highest altitude of each block and of the cells around it, metres.
    squares: Vec<f32>,
}

/// Direction over the ground, in steps of one column or one row, with the lowest elevation that matters.
pub struct Toward {
    step: [f32; 2],
    /// Length of a step, cells.
    length: f32,
    /// Tangent of the lowest elevation that matters.
    least: f32,
    /// Heights less than this above a cell do not shade it, metres.
    least_rise_m: f32,
    /// Offset of walls toward the cell from the first row or column at their height, steps.
    nearer: f32,
}

impl Toward {
    /// Direction of an azimuth, degrees clockwise from the grid's north (its rows' upward direction). Horizons below
    /// the elevation `lowest_deg`, degrees, do not matter.
    pub fn new(azimuth_deg: f64, lowest_deg: f64) -> Self {
        let (east, north) = azimuth_deg.to_radians().sin_cos();
        let longer = east.abs().max(north.abs());
        // Directions along the grid stay exactly on it: the rounding of an angle must not leave the first row or
        // column.
        let step = |along: f64| match (along / longer).abs() < 1e-9 {
            true => 0.0,
            false => (along / longer) as f32,
        };
        Self {
            step: [step(east), step(-north)],
            length: (1.0 / longer) as f32,
            least: lowest_deg.to_radians().tan() as f32,
            least_rise_m: 0.0,
            nearer: 0.0,
        }
    }

    /// Direction for a rough surface: heights less than `rise_m` metres above a cell do not shade it.
    pub fn above(self, rise_m: f32) -> Self {
        Self {
            least_rise_m: rise_m,
            ..self
        }
    }

    /// Direction for a surface with walls, each of which is `steps` (less than one) nearer than the first row or column
    /// at its height.
    pub fn nearer(self, steps: f32) -> Self {
        Self { nearer: steps, ..self }
    }
}

impl Relief {
    /// A surface of `height_m` (`[row][column]`, metres; not finite where unknown) with square cells of `cell_m`
    /// metres.
    ///
    /// # Panics
    /// When there is not one height for each cell.
    pub fn new((width, height): (usize, usize), cell_m: f32, mut height_m: Vec<f32>) -> Self {
        assert_eq!(height_m.len(), width * height, "one height for each cell");
        height_m
            .iter_mut()
            .filter(|z| !z.is_finite())
            .for_each(|z| *z = f32::NEG_INFINITY);
        let mut relief = Self {
            width,
            height,
            cell_m,
            top_m: height_m.iter().copied().fold(f32::NEG_INFINITY, f32::max),
            altitude: height_m,
            squares: Vec::new(),
        };
        relief.squares = relief.highest_of_squares();
        relief
    }

    fn highest_of_squares(&self) -> Vec<f32> {
        let (across, down) = (self.width.div_ceil(SQUARE), self.height.div_ceil(SQUARE));
        let around = |at: usize, most: usize| (at * SQUARE).saturating_sub(1)..((at + 1) * SQUARE + 1).min(most);
        let highest = |square: usize| {
            let cols = around(square % across, self.width);
            around(square / across, self.height)
                .flat_map(|row| &self.altitude[row * self.width..][cols.clone()])
                .copied()
                .fold(f32::NEG_INFINITY, f32::max)
        };
        (0..across * down).into_par_iter().map(highest).collect()
    }

    /// True if the height of a cell is known.
    pub fn is_known(&self, cell: usize) -> bool {
        self.altitude[cell].is_finite()
    }

    /// Horizons of some cells in a direction, as tangents of their elevations ([`Relief::horizon`]).
    pub fn horizons(&self, cells: &[usize], toward: &Toward) -> Vec<f32> {
        cells.iter().map(|&cell| self.horizon(cell, toward)).collect()
    }

    /// Tangent of the elevation of a cell's horizon in a direction; at least the tangent of the lowest elevation that
    /// matters. The height of the cell must be known.
    pub fn horizon(&self, cell: usize, toward: &Toward) -> f32 {
        self.walk(cell, toward, false)
    }

    /// True if a cell is in the shadow of a sun that stands in a direction at its lowest elevation that matters;
    /// `false` where the height of the cell is unknown.
    pub fn is_shaded(&self, cell: usize, toward: &Toward) -> bool {
        self.is_known(cell) && self.walk(cell, toward, true) > toward.least
    }

    /// Shadow mask of all cells under a sun, azimuth as in [`Toward::new`] and elevation in degrees; `false` where the
    /// height is unknown.
    pub fn shadows(&self, azimuth_deg: f64, elevation_deg: f64) -> Vec<bool> {
        let toward = Toward::new(azimuth_deg, elevation_deg);
        let cells = (0..self.altitude.len()).into_par_iter().with_min_len(self.width.max(1));
        cells.map(|cell| self.is_shaded(cell, &toward)).collect()
    }

    /// Horizon of a cell, or with `first` the first tangent above the lowest elevation.
    fn walk(&self, cell: usize, toward: &Toward, first: bool) -> f32 {
        let (col, row) = ((cell % self.width) as f32, (cell / self.width) as f32);
        let here = self.altitude[cell];
        let [along, down] = toward.step;
        let mut highest = toward.least;
        let mut step = 1.0f32;
        let unit_m = toward.length * self.cell_m;
        loop {
            let distance_m = (step - toward.nearer) * unit_m;
            if self.top_m - here <= highest * distance_m {
                return highest;
            }
            let (x, y) = (col + step * along, row + step * down);
            let Some((altitude, square)) = self.between(x, y) else {
                return highest;
            };
            if self.squares[square] - here <= highest * distance_m {
                step += steps_inside(x, along).min(steps_inside(y, down));
                continue;
            }
            let rise = altitude - here;
            if rise > toward.least_rise_m && rise > highest * distance_m {
                highest = rise / distance_m;
                if first {
                    return highest;
                }
            }
            step += 1.0;
        }
    }

    /// Altitude at a position with one integer coordinate, linear in the other one, and its block; `None` off the grid.
    fn between(&self, col: f32, row: f32) -> Option<(f32, usize)> {
        let (c0, r0) = (col.floor(), row.floor());
        if !(c0 >= 0.0 && r0 >= 0.0 && c0 < self.width as f32 && r0 < self.height as f32) {
            return None;
        }
        let (fc, fr) = (col - c0, row - r0);
        let (c0, r0) = (c0 as usize, r0 as usize);
        let first = self.altitude[r0 * self.width + c0];
        let (next, share) = if fc > fr {
            ((c0 + 1).min(self.width - 1) + r0 * self.width, fc)
        } else {
            (c0 + (r0 + 1).min(self.height - 1) * self.width, fr)
        };
        // Unknown cells do not block the ray.
        let other = self.altitude[next];
        let altitude = if share == 0.0 {
            first
        } else {
            first + (other - first) * share
        };
        let square = r0 / SQUARE * self.width.div_ceil(SQUARE) + c0 / SQUARE;
        Some((if altitude.is_nan() { f32::NEG_INFINITY } else { altitude }, square))
    }
}

/// Steps from a coordinate to the last one inside the square that it is in, at least one.
fn steps_inside(at: f32, step: f32) -> f32 {
    if step == 0.0 {
        return f32::INFINITY;
    }
    let side = SQUARE as f32;
    let begin = (at / side).floor() * side;
    let rest = if step > 0.0 { begin + side - at } else { at - begin };
    (rest / step.abs()).floor().max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Hills, a few towers, and holes.
    fn rough(width: usize, height: usize) -> Vec<f32> {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(7);
        let mut z: Vec<f32> = (0..width * height)
            .map(|cell| 3.0 * ((cell % width) as f32 * 0.1).sin() + random.random::<f32>())
            .collect();
        for _ in 0..12 {
            z[random.random_range(0..width * height)] = 40.0;
            z[random.random_range(0..width * height)] = f32::NAN;
        }
        z
    }

    /// The horizon by its definition: every row or column on the way, nothing left out.
    fn plain_horizon(relief: &Relief, cell: usize, toward: &Toward) -> f32 {
        let (col, row) = ((cell % relief.width) as f32, (cell / relief.width) as f32);
        let here = relief.altitude[cell];
        let mut highest = toward.least;
        for step in 1.. {
            let step = step as f32;
            let Some((z, _)) = relief.between(col + step * toward.step[0], row + step * toward.step[1]) else {
                break;
            };
            let distance_m = (step - toward.nearer) * (toward.length * relief.cell_m);
            if z - here > toward.least_rise_m && z - here > highest * distance_m {
                highest = (z - here) / distance_m;
            }
        }
        highest
    }

    #[test]
    fn stepping_over_low_squares_changes_no_horizon_and_no_shadow() {
        let (width, height) = (83, 70);
        let relief = Relief::new((width, height), 0.5, rough(width, height));
        for azimuth_deg in [0.0, 17.0, 45.0, 90.0, 133.3, 180.0, 225.0, 270.0, 301.0] {
            let toward = Toward::new(azimuth_deg, 8.0).above(0.2).nearer(0.5);
            let low = Toward::new(azimuth_deg, 8.0);
            let shadows = relief.shadows(azimuth_deg, 8.0);
            for cell in (0..width * height).filter(|&cell| relief.is_known(cell)) {
                let horizon = relief.horizon(cell, &toward);
                assert_eq!(horizon, plain_horizon(&relief, cell, &toward), "{azimuth_deg} {cell}");
                assert_eq!(shadows[cell], plain_horizon(&relief, cell, &low) > low.least);
            }
        }
    }

    #[test]
    fn a_wall_between_two_cells_stands_where_it_is_said_to() {
        // A step of 6 m north of row 10 of cells of 1 m; the first cell on top is 5 rows from row 15, the wall itself
        // 4.5.
        let (width, height) = (21, 31);
        let step = |cell: usize| if cell / width <= 10 { 6.0 } else { 0.0 };
        let relief = Relief::new((width, height), 1.0, (0..width * height).map(step).collect());
        let cell = 15 * width + 10;
        let horizon = |nearer: f32| relief.horizon(cell, &Toward::new(0.0, 1.0).nearer(nearer));
        assert!((horizon(0.0) - 6.0 / 5.0).abs() < 1e-5 && (horizon(0.5) - 6.0 / 4.5).abs() < 1e-5);
    }

    #[test]
    fn the_horizon_of_a_ridge_is_its_height_over_its_distance_from_every_side() {
        // A ridge along the north, 10 m high, 20 rows from the cell; oblique directions are longer.
        let (width, height) = (101, 41);
        let mut z = vec![0.0; width * height];
        z[..width].fill(10.0);
        let relief = Relief::new((width, height), 2.0, z);
        let cell = 20 * width + 50;
        for azimuth_deg in [0.0, 20.0, -30.0, 44.0] {
            let distance_m = 40.0 / f64::cos(f64::to_radians(azimuth_deg));
            let found = f64::from(relief.horizon(cell, &Toward::new(azimuth_deg, 1.0)));
            assert!((found - 10.0 / distance_m).abs() < 1e-5, "{azimuth_deg}: {found}");
        }
        // Away from it there is nothing.
        assert_eq!(
            relief.horizon(cell, &Toward::new(180.0, 1.0)),
            1f64.to_radians().tan() as f32
        );
    }

    #[test]
    fn unknown_cells_hide_nothing_and_are_in_no_shadow() {
        let mut z = vec![0.0; 30];
        z[10] = f32::NAN;
        z[20] = 5.0;
        let relief = Relief::new((30, 1), 1.0, z);
        let shadows = relief.shadows(90.0, 20.0);
        let dark: Vec<usize> = (0..30).filter(|&cell| shadows[cell]).collect();
        // 5 m at 20 degrees are 13.7 cells; the unknown one among them is none.
        assert_eq!(dark, [7, 8, 9, 11, 12, 13, 14, 15, 16, 17, 18, 19]);
    }
}
