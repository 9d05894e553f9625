//! The ground as a height field: square cells of two triangles each, so that every ray meets it exactly.

use crate::noise::{hash2, noise, smoothstep, stream};
use crate::ray::Ray;
use nalgebra::Vector3;
use rand::RngExt;
use rayon::prelude::*;

/// Altitudes on a square lattice centred on the origin; each cell is cut along its rising diagonal.
pub(crate) struct HeightField {
    /// Cells along one side.
    pub(crate) cells: usize,
    /// Side of a cell, metres.
    pub(crate) cell_m: f64,
    /// Half the side of the whole field, metres.
    pub(crate) half_extent_m: f64,
    heights_m: Vec<f64>,
}

impl HeightField {
    /// Samples `height_m(x, y)`, metres, on a lattice of `cell_m` that reaches at least `half_extent_m` from the
    /// origin.
    pub(crate) fn sample(half_extent_m: f64, cell_m: f64, height_m: impl Fn(f64, f64) -> f64 + Sync) -> Self {
        let half_cells = (half_extent_m / cell_m).ceil() as usize;
        let (cells, half_extent_m) = (2 * half_cells, half_cells as f64 * cell_m);
        let heights_m = (0..(cells + 1) * (cells + 1))
            .into_par_iter()
            .map(|k| {
                let (i, j) = (k % (cells + 1), k / (cells + 1));
                height_m(i as f64 * cell_m - half_extent_m, j as f64 * cell_m - half_extent_m)
            })
            .collect();
        Self {
            cells,
            cell_m,
            half_extent_m,
            heights_m,
        }
    }

    /// Lowest altitude, metres.
    pub(crate) fn bottom_m(&self) -> f64 {
        self.heights_m.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Altitude of the highest corner of a cell, metres.
    pub(crate) fn cell_top_m(&self, cell: usize) -> f64 {
        self.corners_m(cell).into_iter().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Altitude at a place, metres; beyond the edge it is that of the nearest place on the edge.
    pub(crate) fn height_m(&self, x: f64, y: f64) -> f64 {
        let (cell, fx, fy) = self.locate(x, y);
        let (along_x, along_y, base) = self.plane(cell, fx >= fy);
        base + along_x * fx + along_y * fy
    }

    /// Unit upward normal at a place.
    pub(crate) fn normal_at(&self, x: f64, y: f64) -> Vector3<f64> {
        let (cell, fx, fy) = self.locate(x, y);
        let (along_x, along_y, _) = self.plane(cell, fx >= fy);
        Vector3::new(-along_x / self.cell_m, -along_y / self.cell_m, 1.0).normalize()
    }

    /// Calls `visit` with the index of each cell that the box touches in plan.
    pub(crate) fn for_cells_within(&self, low: &Vector3<f64>, high: &Vector3<f64>, mut visit: impl FnMut(usize)) {
        let half = self.half_extent_m;
        if high.x < -half || high.y < -half || low.x > half || low.y > half {
            return;
        }
        let index = |v: f64| (((v + half) / self.cell_m).floor().max(0.0) as usize).min(self.cells - 1);
        // A primitive that ends exactly on the wall between two columns belongs to both.
        let hair = 1e-7;
        for j in index(low.y - hair)..=index(high.y + hair) {
            for i in index(low.x - hair)..=index(high.x + hair) {
                visit(j * self.cells + i);
            }
        }
    }

    /// Distance at which a ray goes under the ground between `t_in` and `t_out`, both inside `cell` in plan.
    ///
    /// Height above ground is linear along the ray within each of the two triangles, so a change of sign between their
    /// ends is a crossing; heights agree on shared edges, so no ray slips through.
    pub(crate) fn intersect_cell(&self, cell: usize, ray: &Ray, t_in: f64, t_out: f64) -> Option<f64> {
        let x0 = (cell % self.cells) as f64 * self.cell_m - self.half_extent_m;
        let y0 = (cell / self.cells) as f64 * self.cell_m - self.half_extent_m;
        let (ox, oy) = ((ray.origin.x - x0) / self.cell_m, (ray.origin.y - y0) / self.cell_m);
        let (dx, dy) = (ray.direction.x / self.cell_m, ray.direction.y / self.cell_m);
        let t_diagonal = (oy - ox) / (dx - dy);
        let crosses = t_diagonal > t_in && t_diagonal < t_out;
        let split = if crosses { t_diagonal } else { t_out };
        for (from, to) in [(t_in, split), (split, t_out)] {
            if from >= to {
                continue;
            }
            let middle = 0.5 * (from + to);
            let (along_x, along_y, base) = self.plane(cell, ox + dx * middle >= oy + dy * middle);
            let above =
                |t: f64| ray.origin.z + ray.direction.z * t - base - along_x * (ox + dx * t) - along_y * (oy + dy * t);
            let (start, end) = (above(from), above(to));
            if end <= 0.0 && end < start {
                let crossing = from + (to - from) * start / (start - end);
                return Some(if start <= 0.0 { from } else { crossing });
            }
        }
        None
    }

    /// Corners of a cell: at (0,0), (1,0), (0,1), (1,1).
    fn corners_m(&self, cell: usize) -> [f64; 4] {
        let row = self.cells + 1;
        let first = (cell / self.cells) * row + cell % self.cells;
        [first, first + 1, first + row, first + row + 1].map(|k| self.heights_m[k])
    }

    /// Rise per cell along x and y, and altitude at the cell's origin, of the lower-right or upper-left triangle.
    fn plane(&self, cell: usize, lower_right: bool) -> (f64, f64, f64) {
        let [a, b, c, d] = self.corners_m(cell);
        if lower_right {
            (b - a, d - b, a)
        } else {
            (d - c, c - a, a)
        }
    }

    fn locate(&self, x: f64, y: f64) -> (usize, f64, f64) {
        let place = |v: f64| {
            let position = ((v + self.half_extent_m) / self.cell_m).clamp(0.0, self.cells as f64);
            let index = (position as usize).min(self.cells - 1);
            (index, position - index as f64)
        };
        let ((i, fx), (j, fy)) = (place(x), place(y));
        (j * self.cells + i, fx, fy)
    }
}

/// Rolling ground: a slope and three broad waves of noise.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Relief {
    seed: u32,
    slope: [f64; 2],
    amplitude_m: f64,
    hill: Option<Hill>,
}

/// A slope on one side of a site, up to a plateau.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hill {
    /// Unit vector (east, north) uphill.
    pub(crate) towards: [f64; 2],
    /// Distance of the foot from the site's centre, metres.
    pub(crate) foot_m: f64,
    /// Horizontal length of the slope, metres.
    pub(crate) length_m: f64,
    /// Altitude of the plateau above the foot, metres.
    pub(crate) rise_m: f64,
}

impl Hill {
    /// Altitude above the foot at a place (metres east and north of the site's centre), metres.
    pub(crate) fn height_m(&self, x: f64, y: f64) -> f64 {
        let along_m = x * self.towards[0] + y * self.towards[1];
        self.rise_m * smoothstep(self.foot_m, self.foot_m + self.length_m, along_m)
    }
}

impl Relief {
    /// Random relief with a slope of 0.8 to 3 %, swells of a few metres, and `hill` on top.
    pub(crate) fn new(seed: u64, hill: Option<Hill>) -> Self {
        let mut random = stream(seed, 0x7E11);
        let direction: f64 = random.random_range(0.0..std::f64::consts::TAU);
        let slope: f64 = random.random_range(0.008..0.03);
        Self {
            seed: hash2(seed, 0x7E12) as u32,
            slope: [slope * direction.cos(), slope * direction.sin()],
            amplitude_m: random.random_range(1.0..2.2),
            hill,
        }
    }

    /// Altitude above the site's centre at a place (metres east and north of it), metres.
    pub(crate) fn height_m(&self, x: f64, y: f64) -> f64 {
        let swell = noise(self.seed, x / 130.0, y / 130.0) * 1.4
            + noise(self.seed ^ 0x55, x / 57.0, y / 57.0) * 0.5
            + noise(self.seed ^ 0xAA, x / 23.0, y / 23.0) * 0.12;
        let hill_m = self.hill.map_or(0.0, |hill| hill.height_m(x, y));
        self.slope[0] * x + self.slope[1] * y + self.amplitude_m * swell + hill_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_meets_the_ground_where_the_ground_is() {
        let relief = Relief::new(3, None);
        let field = HeightField::sample(40.0, 1.0, |x, y| relief.height_m(x, y));
        let tracer = crate::raytrace::Tracer::new(&field, Default::default());
        for k in 0..400 {
            let azimuth = f64::from(k) * 0.37;
            let target = Vector3::new(f64::from(k % 20) * 3.0 - 30.1, f64::from(k / 20) * 3.0 - 30.3, 0.0);
            let direction = Vector3::new(0.5 * azimuth.cos(), 0.5 * azimuth.sin(), -1.0).normalize();
            let ray = Ray::new(target - direction * 500.0, direction);
            let Some(hit) = tracer.trace(&ray) else {
                panic!("ray {k} fell through the ground");
            };
            assert!((hit.point.z - field.height_m(hit.point.x, hit.point.y)).abs() < 1e-9);
        }
    }

    #[test]
    fn a_ray_along_lattice_lines_and_diagonals_does_not_slip_through() {
        let field = HeightField::sample(10.0, 1.0, |x, y| 0.1 * x - 0.2 * y);
        let tracer = crate::raytrace::Tracer::new(&field, Default::default());
        for (x, y, dx, dy) in [
            (0.0, 0.0, 0.0, 0.0),
            (2.0, 3.0, 0.3, 0.3),
            (1.0, -4.0, 0.4, 0.0),
            (0.5, 0.5, -0.2, -0.2),
        ] {
            let direction = Vector3::new(dx, dy, -1.0).normalize();
            let target = Vector3::new(x, y, 0.1 * x - 0.2 * y);
            let ray = Ray::new(target - direction * 9.0, direction);
            let error_m = tracer.trace(&ray).map_or(f64::NAN, |hit| (hit.point - target).norm());
            assert!(error_m < 1e-9, "{x} {y}: {error_m}");
        }
    }
}
