//! Smoothing by local planes: each altitude becomes that of the plane fitted to the window around it.
//!
//! The shorter the base, the more metres of altitude a pixel of mismatch is; planes average that noise out and keep
//! slopes. Windows have one radius in [`smooth`]; in [`smooth_adaptively`] they grow until they have enough confidence,
//! for bases so short that large parts of the surface are hardly matched at all. Both keep walls: cells far from the
//! window's median or plane have little or no weight. Limit: structures smaller than a window and lower than the
//! tolerance are smoothed away.

use heliosplat_grid::statistics::upper_median;
use heliosplat_grid::{Grid, PlaneFit};
use rayon::prelude::*;

/// Sum of squared confidence at which an adaptive window is wide enough: that of 16 × 16 cells of full confidence.
const ENOUGH_CONFIDENCE: f64 = 256.0;
/// Radius of the widest adaptive window, in least radii.
const WIDEST_GROWTH: f32 = 6.0;
/// Number of steps in which a window grows to its widest, each by the same factor.
const GROWTH_STEPS: usize = 12;
/// Samples of an adaptive window from its centre to its edge: 15 × 15 in all, for windows of any width.
const SAMPLES: usize = 7;
/// Rounds of iteratively reweighted least squares.
const ROUNDS: usize = 3;
/// Added to the variances of the columns and rows of a window, cells²: keeps slopes finite where all cells lie on one
/// line.
const STIFFNESS: f64 = 1e-3;
/// Cells that one task smooths at least: smaller tasks cost more to share out than to compute.
const CELLS_PER_TASK: usize = 1024;

/// Altitudes (metres), each replaced by that of a plane fitted to the window within `radius` cells. Only cells within
/// `tolerance_m` of the window's median count, so that a wall in the window does not tilt the plane.
pub(super) fn smooth(grid: &Grid, altitude: &[f32], radius: usize, tolerance_m: f32) -> Vec<f32> {
    (0..grid.len())
        .into_par_iter()
        .with_min_len(CELLS_PER_TASK)
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
    middle + fit.plane(STIFFNESS)[0] as f32
}

/// Altitudes (metres), each replaced by that of a plane fitted to a window that grows from `least_radius` cells until
/// it contains [`ENOUGH_CONFIDENCE`] (`confidence` is 0 to 1 per cell). Samples further than about `tolerance_m` from
/// the plane count less (Cauchy's weights, Holland and Welsch 1977), so that the plane stays that of one face.
pub(super) fn smooth_adaptively(
    grid: &Grid,
    altitude: &[f32],
    confidence: &[f32],
    least_radius: usize,
    tolerance_m: f32,
) -> Vec<f32> {
    let sums = ConfidenceSums::new(grid, confidence);
    let grown = |step: usize| (least_radius as f32 * WIDEST_GROWTH.powf(step as f32 / GROWTH_STEPS as f32)) as usize;
    (0..grid.len())
        .into_par_iter()
        .with_min_len(CELLS_PER_TASK)
        .map(|cell| {
            let enough = |step: &usize| sums.within(cell, grown(*step)) >= ENOUGH_CONFIDENCE;
            let step = (0..GROWTH_STEPS).find(enough).unwrap_or(GROWTH_STEPS);
            robust_plane_at(grid, altitude, cell, grown(step), tolerance_m)
        })
        .collect()
}

/// The altitude at a cell of the plane through evenly spread samples of its window, by iteratively reweighted least
/// squares.
fn robust_plane_at(grid: &Grid, altitude: &[f32], cell: usize, radius: usize, tolerance_m: f32) -> f32 {
    let (col, row) = ((cell % grid.width) as isize, (cell / grid.width) as isize);
    let here = f64::from(altitude[cell]);
    let samples = SAMPLES as isize;
    let mut points = Vec::with_capacity((2 * SAMPLES + 1).pow(2));
    for down in -samples..=samples {
        for right in -samples..=samples {
            let [a, b] = [right, down].map(|k| k * radius as isize / samples);
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
        plane = Some(fit.plane(STIFFNESS));
    }
    plane.map_or(altitude[cell], |[p, ..]| (here + p) as f32)
}

/// Sums of squared confidence over windows (a summed-area table, Crow 1984).
struct ConfidenceSums {
    width: usize,
    height: usize,
    /// `(width + 1) × (height + 1)`: the sum of all cells above and to the left.
    table: Vec<f64>,
}

impl ConfidenceSums {
    fn new(grid: &Grid, confidence: &[f32]) -> Self {
        let (width, height) = (grid.width, grid.height);
        let mut table = vec![0.0; (width + 1) * (height + 1)];
        for row in 0..height {
            let mut line = 0.0;
            for col in 0..width {
                line += f64::from(confidence[row * width + col]).powi(2);
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
        for (fitted, exact) in smooth(&grid, &slope, 2, 10.0).iter().zip(&slope) {
            assert!((fitted - exact).abs() < 2e-2, "{fitted} against {exact}");
        }
        let step: Vec<f32> = (0..400).map(|i| if i % 20 < 10 { 0.0 } else { 8.0 }).collect();
        assert_eq!(smooth(&grid, &step, 2, 2.0), step);
    }

    #[test]
    fn a_slope_of_little_confidence_is_smoothed_over_more_cells_than_a_clear_one() {
        const SIDE: usize = 160;
        let grid = Grid::plain(SIDE, SIDE);
        // Two faces of a roof with waves of forty cells; the western one is faint.
        let face = |i: usize| 1.2 * (80.0 - ((i % SIDE) as f32 - 79.5).abs());
        let cells = SIDE * SIDE;
        let altitude: Vec<f32> = (0..cells)
            .map(|i| face(i) + 2.0 * ((i / SIDE) as f32 * 0.157).sin())
            .collect();
        let confidence: Vec<f32> = (0..cells).map(|i| if i % SIDE < 80 { 0.2 } else { 1.0 }).collect();
        let smooth = smooth_adaptively(&grid, &altitude, &confidence, 6, 3.0);
        let wave = |columns: std::ops::Range<usize>| {
            let all = (40..120).flat_map(|row| columns.clone().map(move |col| row * SIDE + col));
            all.map(|i| (smooth[i] - face(i)).abs()).fold(0.0, f32::max)
        };
        let (faint, clear) = (wave(10..42), wave(100..150));
        assert!(faint < 0.6 && (1.2..2.0).contains(&clear), "{faint} and {clear}");
    }
}
