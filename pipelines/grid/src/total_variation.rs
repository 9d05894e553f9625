//! Total-variation smoothing of heights weighted by their standard deviations.
//!
//! Altitudes are noise and their deviations large where matching fails, on a lawn or between crowns. The most probable
//! surface under independent errors and a prior of few and small steps minimises
//!
//! ```text
//! Σ (x - z)² / (2 σ²)  +  λ Σ |x - x'|      (x' to the east and to the south of x)
//! ```
//!
//! (total variation: Rudin, Osher and Fatemi 1992, here with a deviation for each cell). Cells with small deviations
//! stay, roofs keep their edges, and uncertain cells take the altitude of adjacent certain ones. Solved by the
//! primal-dual iteration of Chambolle and Pock 2011.

use crate::statistics::upper_median;
use rayon::prelude::*;

/// Weight of a step between neighbours (λ), per cell of height, since the errors of matching grow with the cells:
/// chosen on three scenes with cells of 0.3 to 0.5 m, tested on cells of up to 2.4 m (docs/lab/surface.md).
const STEP_WEIGHT_PER_CELL: f32 = 0.25;
/// Least deviation of an altitude, cells: smaller ones are within the noise of level ground.
const LEAST_DEVIATION_CELLS: f32 = 0.8;
/// Rows that one thread works on at a time, at least.
const ROWS_PER_JOB: usize = 8;
/// Iterations: twice as many change the mean error by less than a millimetre.
const ITERATIONS: usize = 150;
/// Step of the altitudes in the unit of a variance, cells²; that of the dual variables follows, since the norm of the
/// differences is 8.
const PRIMAL_STEP_CELLS2: f32 = 4.0;

/// Replaces altitudes, metres, by the most probable surface. The grid has rows of `width` cells of `cell_m` metres;
/// `deviation_m` are the standard deviations of the altitudes, metres. Cells whose altitude is NaN stay unknown and
/// have no effect.
pub fn smooth_by_deviation(width: usize, cell_m: f32, altitude_m: &mut [f32], deviation_m: &[f32]) {
    let mut known: Vec<f32> = altitude_m.iter().copied().filter(|z| z.is_finite()).collect();
    // Differences to a middle keep their digits where altitudes are in thousands.
    let Some(middle) = upper_median(&mut known) else {
        return;
    };
    let step_weight_per_m = STEP_WEIGHT_PER_CELL / cell_m;
    let primal_step = PRIMAL_STEP_CELLS2 * cell_m * cell_m;
    let dual_step = 1.0 / (8.0 * primal_step);
    let least_m2 = (LEAST_DEVIATION_CELLS * cell_m).powi(2);
    let given: Vec<f32> = altitude_m.iter().map(|z| z - middle).collect();
    let weight: Vec<f32> = (given.iter().zip(deviation_m))
        .map(|(z, deviation)| {
            if z.is_finite() {
                1.0 / (deviation * deviation + least_m2)
            } else {
                0.0
            }
        })
        .collect();
    let height = given.len() / width;
    let mut found = given.clone();
    let mut ahead = given.clone();
    // Dual variables of the differences to the east and to the south; those to unknown cells stay zero.
    let (mut east, mut south) = (vec![0.0f32; given.len()], vec![0.0f32; given.len()]);
    let pulled = |dual: f32, difference: f32| match difference.is_finite() {
        true => (dual + dual_step * difference).clamp(-step_weight_per_m, step_weight_per_m),
        false => 0.0,
    };
    for _ in 0..ITERATIONS {
        let rows = east.par_chunks_mut(width).zip(south.par_chunks_mut(width));
        let rows = rows.enumerate().with_min_len(ROWS_PER_JOB);
        rows.for_each(|(row, (east, south))| {
            let own = &ahead[row * width..(row + 1) * width];
            for col in 0..width - 1 {
                east[col] = pulled(east[col], own[col + 1] - own[col]);
            }
            if row + 1 < height {
                let below = &ahead[(row + 1) * width..(row + 2) * width];
                for col in 0..width {
                    south[col] = pulled(south[col], below[col] - own[col]);
                }
            }
        });
        let rows = found.par_chunks_mut(width).zip(ahead.par_chunks_mut(width));
        let rows = rows.enumerate().with_min_len(ROWS_PER_JOB);
        rows.for_each(|(row, (found, ahead))| {
            for col in 0..width {
                let i = row * width + col;
                let west = if col > 0 { east[i - 1] } else { 0.0 };
                let north = if row > 0 { south[i - width] } else { 0.0 };
                let pull = east[i] - west + south[i] - north;
                let next = (found[col] + primal_step * (pull + weight[i] * given[i])) / (1.0 + primal_step * weight[i]);
                ahead[col] = 2.0 * next - found[col];
                found[col] = next;
            }
        });
    }
    for (altitude, found) in altitude_m.iter_mut().zip(found) {
        *altitude = found + middle;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 40;

    /// Level ground at 100 m with a roof of 20 x 20 cells 6 m above it.
    fn house() -> Vec<f32> {
        let roof = |i: usize| (10..30).contains(&(i % WIDTH)) && (10..30).contains(&(i / WIDTH));
        (0..WIDTH * WIDTH)
            .map(|i| if roof(i) { 106.0 } else { 100.0 })
            .collect()
    }

    #[test]
    fn what_is_in_doubt_takes_the_altitude_of_the_sure_cells_around() {
        let (mut altitude, mut deviation) = (house(), vec![0.1; WIDTH * WIDTH]);
        for i in (0..WIDTH * WIDTH).filter(|i| (2..6).contains(&(i % WIDTH)) && (15..25).contains(&(i / WIDTH))) {
            (altitude[i], deviation[i]) = (102.5, 3.0);
        }
        smooth_by_deviation(WIDTH, 0.5, &mut altitude, &deviation);
        assert!(
            (altitude[20 * WIDTH + 4] - 100.0).abs() < 0.3,
            "{}",
            altitude[20 * WIDTH + 4]
        );
        assert!(
            (altitude[20 * WIDTH + 20] - 106.0).abs() < 0.2,
            "{}",
            altitude[20 * WIDTH + 20]
        );
    }

    #[test]
    fn edges_stay_and_so_does_a_sure_surface() {
        let (mut altitude, given) = (house(), house());
        smooth_by_deviation(WIDTH, 0.5, &mut altitude, &vec![0.1; WIDTH * WIDTH]);
        let worst = altitude
            .iter()
            .zip(&given)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(worst < 0.3, "{worst}");
    }

    #[test]
    fn the_energy_falls_and_further_iterations_would_change_little() {
        let noise = |i: usize| ((i * 7919) % 101) as f32 / 50.0 - 1.0;
        let given: Vec<f32> = house().iter().enumerate().map(|(i, z)| z + noise(i)).collect();
        let mut found = given.clone();
        smooth_by_deviation(WIDTH, 0.5, &mut found, &vec![1.0; WIDTH * WIDTH]);
        let energy = |x: &[f32]| {
            let data: f32 = x.iter().zip(&given).map(|(x, z)| (x - z).powi(2) / (2.0 * 1.16)).sum();
            let steps = |from: usize, to: usize| (x[from] - x[to]).abs();
            let east: f32 = (0..x.len()).filter(|i| i % WIDTH > 0).map(|i| steps(i, i - 1)).sum();
            let south: f32 = (WIDTH..x.len()).map(|i| steps(i, i - WIDTH)).sum();
            data + STEP_WEIGHT_PER_CELL / 0.5 * (east + south)
        };
        let least = energy(&found);
        assert!(least < 0.5 * energy(&given), "{least} of {}", energy(&given));
        // A minimum: moving a single cell lowers the energy by no more than rounding and the remaining iterations.
        for i in [5 * WIDTH + 5, 9 * WIDTH + 20, 20 * WIDTH + 20] {
            for by in [-0.2, 0.2] {
                let mut moved = found.clone();
                moved[i] += by;
                assert!(energy(&moved) > least - 1e-2, "{i}, {by}");
            }
        }
    }

    #[test]
    fn a_scene_of_coarse_cells_is_smoothed_as_its_miniature() {
        let noise = |i: usize| ((i * 7919) % 101) as f32 / 50.0 - 1.0;
        let given: Vec<f32> = house().iter().enumerate().map(|(i, z)| z - 100.0 + noise(i)).collect();
        let mut fine = given.clone();
        smooth_by_deviation(WIDTH, 0.5, &mut fine, &vec![1.0; WIDTH * WIDTH]);
        let mut coarse: Vec<f32> = given.iter().map(|z| 4.0 * z).collect();
        smooth_by_deviation(WIDTH, 2.0, &mut coarse, &vec![4.0; WIDTH * WIDTH]);
        let pairs = fine.iter().zip(&coarse);
        assert!(pairs.clone().all(|(fine, coarse)| (4.0 * fine - coarse).abs() < 1e-3));
        assert!(pairs.zip(given).any(|((fine, _), given)| (fine - given).abs() > 0.5));
    }

    #[test]
    fn unknown_cells_stay_unknown_and_pull_at_nothing() {
        let mut altitude = house();
        for i in 0..WIDTH {
            altitude[5 * WIDTH + i] = f32::NAN;
        }
        smooth_by_deviation(WIDTH, 0.5, &mut altitude, &vec![1.0; WIDTH * WIDTH]);
        assert!(altitude[5 * WIDTH..6 * WIDTH].iter().all(|z| z.is_nan()));
        assert!((altitude[2 * WIDTH + 3] - 100.0).abs() < 1e-3);
        let mut nothing = vec![f32::NAN; 16];
        smooth_by_deviation(4, 0.5, &mut nothing, &[1.0; 16]);
        assert!(nothing.iter().all(|z| z.is_nan()));
    }
}
