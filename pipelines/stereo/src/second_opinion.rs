//! Second opinions on the altitudes of a surface, which widen their standard deviations.
//!
//! The spread of summed costs contains the noise of matching, but neither the errors of the cameras nor those of the
//! aggregation. Two other estimates contain them:
//!
//! - **Pairs.** Each pair of views has an altitude of its own, the one of least census distance near the surface.
//!   Pointing errors, another image's camera and a wrong height offset move the pairs apart. The variance of their
//!   weighted mean, which grows with the square of the base, is that of the altitude.
//! - **Surroundings.** Beside water and ground without texture, and in streets, the aggregation continues the altitudes
//!   of its neighbours. Cells whose own surroundings show no evidence have the variance of the altitudes in a wider
//!   window.
//!
//! Limits: one pair has no second opinion, and errors that all pairs share remain.

use super::agreement::OnSurface;
use super::evidence::{LevelSurface, NEAR_CELLS, WINDOW_CELLS, least_evidence};
use super::ortho::box_mean;
use super::pyramid::Compared;
use super::seen::Witnesses;
use heliosplat::timeline::stage;
use heliosplat_grid::{Grid, parabola_top};
use heliosplat_rpc::parallax::{LEAST_BASE_TO_HEIGHT, MATCHING_PX};
use rayon::prelude::*;

/// Altitudes that each pair is compared at, in shifts by one cell of the pair with the widest base.
const SHIFTS: [f32; 5] = [-2.0, -1.0, 0.0, 1.0, 2.0];
/// Half of the window over which the distances of a pair are averaged, cells.
const PAIR_CELLS: usize = 2;
/// Half of the window whose altitudes a cell without evidence of its own may have, cells: it reaches across a street
/// and the house beside it to the next ground (docs/lab/known.md).
const SURROUNDINGS_CELLS: usize = 24;
/// Rows that are resampled together at all shifts.
const STRIP_ROWS: usize = 16;

impl LevelSurface<'_> {
    /// Variance of the altitudes by the pairs of the `seen` views of each cell, metres², as far as it exceeds the error
    /// of matching over the base, which every deviation contains; 0 for one pair. `shift_m` is the height by which the
    /// pair with the widest base shifts by one cell.
    pub(super) fn variance_of_pairs(&self, seen: &Witnesses, shift_m: f32) -> Vec<f32> {
        let _part = stage("evidence");
        let Compared { views: levels, pairs } = self.search.compared(self.factor);
        let hits = self.hits(&levels);
        let surface = self.on(&levels, &hits);
        let grid = &self.grid;
        let mut variance = vec![0.0; grid.len()];
        let strips = variance.par_chunks_mut(STRIP_ROWS * grid.width.max(1)).enumerate();
        strips.for_each(|(strip, variance)| {
            let first = strip * STRIP_ROWS;
            let rows = first.saturating_sub(PAIR_CELLS)..(first + STRIP_ROWS + PAIR_CELLS).min(grid.height);
            let window = Grid {
                height: rows.len(),
                ..*grid
            };
            let resampled = SHIFTS.map(|shift| {
                let shift_m = shift * shift_m;
                OnSurface { shift_m, ..surface }.resample(rows.clone())
            });
            let before = (first - rows.start) * grid.width;
            let mut sums = vec![[0.0f32; 3]; variance.len()];
            for pair in &pairs {
                let distances = resampled
                    .each_ref()
                    .map(|at| box_mean(&window, &at.distance(pair), PAIR_CELLS));
                let weight = pair.base_to_height.powi(2) * pair.share();
                for (cell, sums) in sums.iter_mut().enumerate() {
                    let Some(shift) = least(distances.each_ref().map(|distances| distances[before + cell])) else {
                        continue;
                    };
                    for (sum, value) in sums.iter_mut().zip([1.0, shift, shift * shift]) {
                        *sum += weight * value;
                    }
                }
            }
            let cells = variance.iter_mut().zip(sums).enumerate();
            for (cell, (variance, [weights, sum, squares])) in cells.filter(|(_, (_, sums))| sums[0] > 0.0) {
                let cell = first * grid.width + cell;
                let mean = sum / weights;
                let spread = (squares / weights - mean * mean).max(0.0) * shift_m * shift_m;
                let ratio = seen.base_to_height[cell].max(LEAST_BASE_TO_HEIGHT as f32);
                let of_matching = (MATCHING_PX as f32 * grid.cell_m / ratio).powi(2);
                // Of the pairs of n views, n - 1 are independent.
                let degrees_of_freedom = f32::from(seen.views[cell].saturating_sub(2).max(1));
                *variance = (spread / degrees_of_freedom - of_matching).max(0.0);
            }
        });
        variance
    }

    /// Variance of the altitudes around the cells whose own surroundings, by `near`, do not show the evidence that
    /// `views` views need, metres²; 0 elsewhere.
    pub(super) fn variance_around(&self, near: &[f32], views: &[u8]) -> Vec<f32> {
        // Chance evens out with the root of the number of cells.
        let factor = (2 * WINDOW_CELLS + 1) as f32 / (2 * NEAR_CELLS + 1) as f32;
        let of_cell = |cell: usize| {
            if near[cell] >= factor * least_evidence(f32::from(views[cell])) {
                return 0.0;
            }
            let above = self
                .grid
                .around(cell, SURROUNDINGS_CELLS)
                .map(|near| self.altitude_m[near] - self.altitude_m[cell]);
            let (count, sum, squares) = above.fold((0.0f32, 0.0f32, 0.0f32), |(count, sum, squares), above| {
                (count + 1.0, sum + above, squares + above * above)
            });
            (squares / count - (sum / count).powi(2)).max(0.0)
        };
        (0..self.grid.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(of_cell)
            .collect()
    }
}

/// The shift of least distance, in the unit of [`SHIFTS`]; `None` where one of the distances is not known.
fn least(distances: [f32; SHIFTS.len()]) -> Option<f32> {
    if distances.iter().any(|distance| distance.is_nan()) {
        return None;
    }
    let best = (0..SHIFTS.len()).min_by(|&a, &b| distances[a].total_cmp(&distances[b]))?;
    let fraction = match best > 0 && best + 1 < SHIFTS.len() {
        true => parabola_top([best - 1, best, best + 1].map(|shift| -distances[shift])).unwrap_or(0.0),
        false => 0.0,
    };
    Some(SHIFTS[best] + fraction)
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{leaning, noise, request};
    use super::super::pyramid::Search;
    use super::*;

    const SIDE: usize = 48;

    #[test]
    fn the_least_distance_lies_between_the_shifts_or_at_an_end() {
        let parabola = SHIFTS.map(|shift| (shift - 0.3).powi(2));
        assert!(least(parabola).is_some_and(|shift| (shift - 0.3).abs() < 1e-5));
        assert_eq!(least([5.0, 4.0, 3.0, 2.0, 1.0]), Some(2.0));
        assert_eq!(least([5.0, 4.0, f32::NAN, 2.0, 1.0]), None);
    }

    /// Passes a level surface, a metre to a cell and a pixel, in three views to `look`; the last camera is
    /// `off_px` columns off.
    fn with_surface<T>(off_px: f64, altitude_m: &[f32], look: impl FnOnce(&LevelSurface) -> T) -> T {
        let image = noise(SIDE, |_| 0);
        let views = [(0.0, 0.0), (0.5, 0.0), (1.0, off_px)].map(|(lean, off_px)| leaning(&image, lean, off_px, 0));
        let request = request(SIDE, views.len());
        look(&LevelSurface {
            search: &Search::new(&views, &request),
            factor: 1,
            grid: request.grid(),
            altitude_m,
            tolerance_m: 10.0,
        })
    }

    const MIDDLE: usize = SIDE / 2 * SIDE + SIDE / 2;

    #[test]
    fn a_camera_that_is_off_along_the_lines_of_its_pairs_widens_the_deviations() {
        let level = vec![0.0; SIDE * SIDE];
        let variance = |off_px| {
            with_surface(off_px, &level, |surface| {
                let seen = Witnesses {
                    views: vec![3; SIDE * SIDE],
                    base_to_height: vec![1.0; SIDE * SIDE],
                };
                surface.variance_of_pairs(&seen, 1.0)[MIDDLE]
            })
        };
        assert!(variance(0.0) < 0.01, "{}", variance(0.0));
        assert!(variance(1.0) > 0.1, "{}", variance(1.0));
    }

    #[test]
    fn ground_without_evidence_of_its_own_has_the_spread_of_the_heights_around() {
        let step: Vec<f32> = (0..SIDE * SIDE)
            .map(|cell| if cell % SIDE < SIDE / 2 { 0.0 } else { 4.0 })
            .collect();
        let variance = |near: f32| {
            with_surface(0.0, &step, |surface| {
                surface.variance_around(&vec![near; SIDE * SIDE], &vec![3; SIDE * SIDE])[MIDDLE]
            })
        };
        assert_eq!(variance(0.5), 0.0);
        assert!((variance(0.1) - 4.0).abs() < 0.1);
    }
}
