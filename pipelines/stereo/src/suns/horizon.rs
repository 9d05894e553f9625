//! How high the surface stands against the sky, seen from its cells.

use super::super::surface::Surface;

/// What stands less than this above a cell does not shade it, metres: the surface is rough.
const LEAST_RISE_M: f32 = 1.0;

/// A surface to walk over; cells that are not known are bottomless.
pub(super) struct Relief {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) cell_m: f32,
    altitude: Vec<f32>,
    top_m: f32,
}

/// A direction over the ground, in steps of one column or one row.
pub(super) struct Toward {
    step: [f32; 2],
    /// Length of a step, cells.
    length: f32,
    /// Tangent of the lowest elevation that matters.
    least: f32,
}

impl Toward {
    pub(super) fn new(azimuth_deg: f64, lowest_deg: f64) -> Self {
        let (east, north) = azimuth_deg.to_radians().sin_cos();
        let longer = east.abs().max(north.abs());
        Self {
            step: [(east / longer) as f32, (-north / longer) as f32],
            length: (1.0 / longer) as f32,
            least: lowest_deg.to_radians().tan() as f32,
        }
    }
}

impl Relief {
    pub(super) fn new(surface: &Surface, covered: &[bool]) -> Self {
        let known = surface.altitude.iter().zip(covered);
        let altitude: Vec<f32> = known
            .map(|(&z, &known)| if known { z } else { f32::NEG_INFINITY })
            .collect();
        Self {
            width: surface.width,
            height: surface.height,
            cell_m: surface.cell_m,
            top_m: altitude.iter().copied().fold(f32::NEG_INFINITY, f32::max),
            altitude,
        }
    }

    /// Known cells on a regular grid, at most about so many.
    pub(super) fn sample(&self, most: usize) -> Vec<usize> {
        let stride = ((self.altitude.len() as f64 / most as f64).sqrt().ceil() as usize).max(1);
        let rows = (stride / 2..self.height).step_by(stride);
        rows.flat_map(|row| {
            (stride / 2..self.width)
                .step_by(stride)
                .map(move |col| row * self.width + col)
        })
        .filter(|&cell| self.altitude[cell].is_finite())
        .collect()
    }

    /// The horizons of some cells.
    pub(super) fn horizons(&self, cells: &[usize], toward: &Toward) -> Vec<f32> {
        cells.iter().map(|&cell| self.horizon(cell, toward)).collect()
    }

    /// Tangent of the highest elevation at which the surface stands against the sky in a direction; at least that of the lowest
    /// elevation that matters.
    pub(super) fn horizon(&self, cell: usize, toward: &Toward) -> f32 {
        let (col, row) = ((cell % self.width) as f32, (cell / self.width) as f32);
        let here = self.altitude[cell];
        let [along, down] = toward.step;
        let mut highest = toward.least;
        let mut step = 1.0f32;
        let unit_m = toward.length * self.cell_m;
        loop {
            let distance_m = step * unit_m;
            if self.top_m - here <= highest * distance_m {
                return highest;
            }
            let Some(altitude) = self.between(col + step * along, row + step * down) else {
                return highest;
            };
            let rise = altitude - here;
            if rise > LEAST_RISE_M && rise > highest * distance_m {
                highest = rise / distance_m;
            }
            step += 1.0;
        }
    }

    /// Altitude at a position of which one coordinate is whole, linear in the other one; `None` off the grid.
    fn between(&self, col: f32, row: f32) -> Option<f32> {
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
        // Nothing is known to stand where one of the two is unknown.
        let other = self.altitude[next];
        Some(if share == 0.0 {
            first
        } else {
            first + (other - first) * share
        })
        .map(|z| if z.is_nan() { f32::NEG_INFINITY } else { z })
    }
}
