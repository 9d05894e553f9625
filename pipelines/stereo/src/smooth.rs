//! How far a surface is smoothed: the closer together the views stand, the more metres of altitude a pixel of mismatch is, and the
//! wider the windows whose local planes the surface takes.

use super::grid::Grid;
use heliosplat_rpc::statistics::upper_median;
use rayon::prelude::*;

/// Sharpness of the comparisons above which one cell at a time tells altitudes apart well enough.
const SHARP: f32 = 0.8;
/// Cells from the centre to the edge of the widest window.
const WIDEST_RADIUS: f32 = 6.0;
/// Sum of squared trust that makes a window wide enough: 16 x 16 cells without doubt.
const ENOUGH_TRUST: f64 = 256.0;
/// Radius of the widest window, in least radii.
const WIDEST_GROWTH: f32 = 6.0;
/// Windows tried up to there, each wider by the same share.
const GROWTHS: usize = 12;
/// Places of a wide window looked at, from its centre to its edge.
const PLACES: usize = 7;
/// Rounds of weighing a window's places by their distance from its plane.
const ROUNDS: usize = 3;

/// Radius of the window over which costs are averaged, cells, for comparisons of this sharpness (root of the sum of the squared
/// ratios of base to height): noise in altitude grows with its inverse, and so does the radius.
pub(super) fn radius_for(sharpness: f32) -> usize {
    (SHARP / sharpness.max(1e-3)).min(WIDEST_RADIUS) as usize
}

/// Whether windows of this radius are as wide as they get: the base is very short.
pub(super) fn is_widest(radius: usize) -> bool {
    radius >= WIDEST_RADIUS as usize
}

/// How many times as dear jumps are for windows of this radius: with a very short base single mismatches are as tall as houses.
pub(super) fn steadiness(radius: usize) -> u16 {
    (radius / 3).max(1) as u16
}

/// Each altitude replaced by that of the plane through its window, fitted to the cells within `tolerance_m` of the window's
/// median, so that a wall in the window does not tilt it.
pub(super) fn planes(grid: &Grid, altitude: &[f32], radius: usize, tolerance_m: f32) -> Vec<f32> {
    if radius == 0 {
        return altitude.to_vec();
    }
    (0..grid.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(|cell| plane_at(grid, altitude, cell, radius, tolerance_m))
        .collect()
}

fn plane_at(grid: &Grid, altitude: &[f32], cell: usize, radius: usize, tolerance_m: f32) -> f32 {
    let mut values: Vec<f32> = grid.around(cell, radius).map(|n| altitude[n]).collect();
    let Some(middle) = upper_median(&mut values) else {
        return altitude[cell];
    };
    let (col, row) = ((cell % grid.width) as f64, (cell / grid.width) as f64);
    let mut fit = PlaneFit::default();
    for near in grid.around(cell, radius) {
        if (altitude[near] - middle).abs() <= tolerance_m {
            let (a, b) = ((near % grid.width) as f64 - col, (near / grid.width) as f64 - row);
            fit.add([a, b], f64::from(altitude[near] - middle), 1.0);
        }
    }
    middle + fit.plane()[0] as f32
}

/// Weighted sums of a plane `z = p + q a + r b` by least squares.
#[derive(Default)]
struct PlaneFit {
    weight: f64,
    first: [f64; 3],
    second: [f64; 5],
}

impl PlaneFit {
    fn add(&mut self, [a, b]: [f64; 2], z: f64, weight: f64) {
        self.weight += weight;
        for (sum, value) in self.first.iter_mut().zip([a, b, z]) {
            *sum += weight * value;
        }
        for (sum, value) in self.second.iter_mut().zip([a * a, a * b, b * b, a * z, b * z]) {
            *sum += weight * value;
        }
    }

    /// `[p, q, r]`.
    fn plane(&self) -> [f64; 3] {
        let [a, b, z] = self.first.map(|sum| sum / self.weight);
        let [aa, ab, bb, az, bz] = self.second.map(|sum| sum / self.weight);
        // A little stiffness keeps the slope finite where the cells lie on one line.
        let (aa, ab, bb) = (aa - a * a + 1e-3, ab - a * b, bb - b * b + 1e-3);
        let (az, bz) = (az - a * z, bz - b * z);
        let det = aa * bb - ab * ab;
        let (q, r) = ((az * bb - bz * ab) / det, (bz * aa - az * ab) / det);
        [z - q * a - r * b, q, r]
    }
}

/// Where the base is so short that windows are as wide as they get (`radius`), what little a faint place tells does not fill
/// them: there each altitude is replaced by that of a plane through as wide a window as holds [`ENOUGH_TRUST`] (of `trust`, 0 to
/// 1). Places further than about `tolerance_m` from the plane count less (Cauchy's weights, Holland and Welsch 1977), so that it stays a
/// face's own.
pub(super) fn faint_planes(grid: &Grid, altitude: &[f32], trust: &[f32], radius: usize, tolerance_m: f32) -> Vec<f32> {
    if !is_widest(radius) {
        return altitude.to_vec();
    }
    let sums = Sums::new(grid, trust);
    let grown = |step: usize| (radius as f32 * WIDEST_GROWTH.powf(step as f32 / GROWTHS as f32)) as usize;
    (0..grid.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(|cell| {
            let enough = |step: &usize| sums.within(cell, grown(*step)) >= ENOUGH_TRUST;
            let step = (0..GROWTHS).find(enough).unwrap_or(GROWTHS);
            wide_plane_at(grid, altitude, cell, grown(step), tolerance_m)
        })
        .collect()
}

fn wide_plane_at(grid: &Grid, altitude: &[f32], cell: usize, radius: usize, tolerance_m: f32) -> f32 {
    let (col, row) = ((cell % grid.width) as isize, (cell / grid.width) as isize);
    let here = f64::from(altitude[cell]);
    let places = PLACES as isize;
    let mut points = Vec::with_capacity((2 * PLACES + 1).pow(2));
    for down in -places..=places {
        for right in -places..=places {
            let [a, b] = [right, down].map(|k| k * radius as isize / places);
            let (c, r) = (col + a, row + b);
            if c >= 0 && r >= 0 && c < grid.width as isize && r < grid.height as isize {
                let z = f64::from(altitude[r as usize * grid.width + c as usize]);
                points.push(([a as f64, b as f64], z - here));
            }
        }
    }
    let mut plane: Option<[f64; 3]> = None;
    for _ in 0..ROUNDS {
        let mut fit = PlaneFit::default();
        for &([a, b], z) in &points {
            let off = plane.map_or(0.0, |[p, q, r]| (z - p - q * a - r * b) / f64::from(tolerance_m));
            fit.add([a, b], z, 1.0 / (1.0 + off * off));
        }
        plane = Some(fit.plane());
    }
    plane.map_or(altitude[cell], |[p, ..]| (here + p) as f32)
}

/// Sums of squared trust over windows (a summed-area table, Crow 1984).
struct Sums {
    width: usize,
    height: usize,
    /// `(width + 1) × (height + 1)`: the sum of all cells above and to the left.
    table: Vec<f64>,
}

impl Sums {
    fn new(grid: &Grid, trust: &[f32]) -> Self {
        let (width, height) = (grid.width, grid.height);
        let mut table = vec![0.0; (width + 1) * (height + 1)];
        for row in 0..height {
            let mut line = 0.0;
            for col in 0..width {
                line += f64::from(trust[row * width + col]).powi(2);
                table[(row + 1) * (width + 1) + col + 1] = table[row * (width + 1) + col + 1] + line;
            }
        }
        Self { width, height, table }
    }

    /// The sum within `radius` cells of a cell.
    fn within(&self, cell: usize, radius: usize) -> f64 {
        let (col, row) = (cell % self.width, cell / self.width);
        let (left, top) = (col.saturating_sub(radius), row.saturating_sub(radius));
        let (right, bottom) = ((col + radius + 1).min(self.width), (row + radius + 1).min(self.height));
        let at = |c: usize, r: usize| self.table[r * (self.width + 1) + c];
        at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_stays_a_slope_and_a_step_a_step() {
        let grid = Grid::plain(20, 20);
        let slope: Vec<f32> = (0..400)
            .map(|i| 0.7 * (i % 20) as f32 - 0.2 * (i / 20) as f32)
            .collect();
        for (smooth, exact) in planes(&grid, &slope, 2, 10.0).iter().zip(&slope) {
            assert!((smooth - exact).abs() < 2e-2, "{smooth} against {exact}");
        }
        let step: Vec<f32> = (0..400).map(|i| if i % 20 < 10 { 0.0 } else { 8.0 }).collect();
        assert_eq!(planes(&grid, &step, 2, 2.0), step);
    }

    #[test]
    fn a_faint_slope_is_told_from_more_cells_than_a_clear_one() {
        const SIDE: usize = 160;
        let grid = Grid::plain(SIDE, SIDE);
        // Two faces of a roof with waves of forty cells; the western one is faint.
        let face = |i: usize| 1.2 * (80.0 - ((i % SIDE) as f32 - 79.5).abs());
        let cells = SIDE * SIDE;
        let altitude: Vec<f32> = (0..cells)
            .map(|i| face(i) + 2.0 * ((i / SIDE) as f32 * 0.157).sin())
            .collect();
        let trust: Vec<f32> = (0..cells).map(|i| if i % SIDE < 80 { 0.2 } else { 1.0 }).collect();
        let smooth = faint_planes(&grid, &altitude, &trust, 6, 3.0);
        let wave = |columns: std::ops::Range<usize>| {
            let all = (40..120).flat_map(|row| columns.clone().map(move |col| row * SIDE + col));
            all.map(|i| (smooth[i] - face(i)).abs()).fold(0.0, f32::max)
        };
        let (faint, clear) = (wave(10..42), wave(100..150));
        assert!(faint < 0.6 && (1.2..2.0).contains(&clear), "{faint} and {clear}");
        assert_eq!(
            faint_planes(&grid, &altitude, &trust, 5, 3.0),
            altitude,
            "a longer base needs none of it"
        );
    }

    #[test]
    fn the_window_widens_and_jumps_get_dearer_as_the_views_tell_less() {
        assert_eq!([0.08, 0.2, 0.3, 0.5, 2.0].map(radius_for), [6, 4, 2, 1, 0]);
        assert_eq!([6, 4, 0].map(steadiness), [2, 1, 1]);
        assert!(radius_for(0.0) <= WIDEST_RADIUS as usize);
    }
}
