//! Smoothness of a feature between neighbours on one surface: total variation (Rudin, Osher and Fatemi 1992) over a
//! graph of Gaussians.
//!
//! Albedo mostly changes where the surface does. Images alone hardly separate a roof from a narrower one next to ground
//! of the same colour: both fit equally well (docs/lab/start.md). Only neighbours at one altitude are compared, so that
//! a change of colour costs something within a surface and nothing between a roof and the ground.

use crate::gaussians::Table;
use rayon::prelude::*;

/// Horizontal distance within which Gaussians are neighbours, ground sampling distances: the four around each on a
/// grid.
const REACH_GSD: f32 = 1.25;
/// Largest difference of altitude between neighbours, ground sampling distances: surfaces as steep as that are walls.
const SAME_SURFACE_GSD: f32 = 1.5;
/// Differences much smaller than this have a quadratic penalty, in units of the feature, so that the gradient has no
/// jump at zero.
const ROUNDED: f32 = 0.02;
/// Values per parallel job; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;

/// Neighbouring Gaussians on one surface; each pair is listed from both sides.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Neighbours {
    /// Start of each Gaussian's neighbours, and the end of the last ones.
    starts: Vec<u32>,
    of: Vec<u32>,
}

impl Neighbours {
    /// The neighbours among Gaussians at their current positions; `gsd_m` is the ground sampling distance, metres.
    pub fn new(gaussians: &Table, gsd_m: f32) -> Self {
        let reach_m = REACH_GSD * gsd_m;
        // Row and column of a square as wide as the distance of neighbours, rows first, so that adjacent squares are
        // adjacent in order.
        let square = |index: usize| {
            let p = gaussians.position(index);
            ((p.y / reach_m).floor() as i32, (p.x / reach_m).floor() as i32)
        };
        let mut sorted: Vec<((i32, i32), u32)> = (0..gaussians.count)
            .map(|index| (square(index), index as u32))
            .collect();
        sorted.par_sort_unstable();
        let add_near = |index: usize, of: &mut Vec<u32>| {
            let here = gaussians.position(index);
            let (row, col) = square(index);
            let first = of.len();
            for row in row.saturating_sub(1)..=row.saturating_add(1) {
                let west = sorted.partition_point(|(at, _)| *at < (row, col.saturating_sub(1)));
                let east = (row, col.saturating_add(1));
                let squares = sorted[west..].iter().take_while(|(at, _)| *at <= east);
                of.extend(squares.map(|(_, other)| *other).filter(|other| {
                    let away = gaussians.position(*other as usize) - here;
                    *other as usize != index
                        && away.truncate().length_squared() < reach_m * reach_m
                        && away.z.abs() < SAME_SURFACE_GSD * gsd_m
                }));
            }
            of[first..].sort_unstable();
        };
        let of_chunk = |chunk: usize| {
            let (mut counts, mut of) = (Vec::new(), Vec::new());
            for index in chunk * CHUNK..((chunk + 1) * CHUNK).min(gaussians.count) {
                let first = of.len();
                add_near(index, &mut of);
                counts.push((of.len() - first) as u32);
            }
            (counts, of)
        };
        let chunks = (0..gaussians.count.div_ceil(CHUNK)).into_par_iter();
        let chunks: Vec<(Vec<u32>, Vec<u32>)> = chunks.map(of_chunk).collect();
        let mut found = Self {
            starts: vec![0],
            of: Vec::with_capacity(chunks.iter().map(|(_, of)| of.len()).sum()),
        };
        let mut end = 0;
        for (counts, of) in chunks {
            found.starts.extend(counts.into_iter().map(|count| {
                end += count;
                end
            }));
            found.of.extend(of);
        }
        found
    }

    /// Number of Gaussians.
    pub fn count(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// True if all starts ascend and all neighbours exist; checked after a checkpoint is read.
    pub fn is_whole(&self) -> bool {
        let count = self.count() as u32;
        self.starts.first().is_none_or(|first| *first == 0)
            && self.starts.is_sorted()
            && self.starts.last().is_none_or(|end| *end as usize == self.of.len())
            && self.of.iter().all(|other| *other < count)
    }

    fn around(&self, index: usize) -> &[u32] {
        &self.of[self.starts[index] as usize..self.starts[index + 1] as usize]
    }
}

/// Total variation of `values`, `width` of them for each Gaussian:
///
/// ```text
/// V = 1 / (pixels width) Σ_{pairs (i, j)} Σ_k (sqrt((f_ik - f_jk)² + ε²) - ε)        ε = 0.02
/// ```
///
/// Division by `pixels` puts it on the scale of the photometric loss, a mean over pixels. Adds `weight` times its
/// gradient to `gradient`, which has the length of `values`; `neighbours` has an entry for every Gaussian. Returns `V`
/// without `weight`.
pub fn total_variation(
    neighbours: &Neighbours,
    (values, width): (&[f32], usize),
    pixels: usize,
    weight: f32,
    gradient: &mut [f32],
) -> f64 {
    if width == 0 || pixels == 0 {
        return 0.0;
    }
    let unit = 1.0 / (pixels * width) as f32;
    let jobs = gradient.par_chunks_mut(CHUNK * width).enumerate();
    let sums: Vec<f64> = jobs
        .map(|(chunk, gradient)| {
            let mut sum = 0.0;
            for (place, gradient) in gradient.chunks_exact_mut(width).enumerate() {
                let index = chunk * CHUNK + place;
                let own = &values[index * width..][..width];
                for other in neighbours.around(index) {
                    let others = &values[*other as usize * width..][..width];
                    for ((gradient, own), other) in gradient.iter_mut().zip(own).zip(others) {
                        let difference = own - other;
                        let size = (difference * difference + ROUNDED * ROUNDED).sqrt();
                        *gradient += weight * unit * (difference / size);
                        sum += f64::from(size - ROUNDED);
                    }
                }
            }
            sum
        })
        .collect();
    // Each pair was met twice.
    0.5 * f64::from(unit) * sums.iter().sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::{POSITION, core_groups};

    /// Gaussians a metre apart in a row; the fourth and later ones are on a roof.
    fn row() -> Table {
        let mut table = Table::zeros(core_groups(), 6);
        for (i, p) in table.group_mut(POSITION).chunks_exact_mut(3).enumerate() {
            p.copy_from_slice(&[i as f32 - 2.5, 0.3, if i < 3 { 0.1 * i as f32 } else { 8.0 }]);
        }
        table
    }

    #[test]
    fn neighbours_are_those_on_one_surface() {
        let found = Neighbours::new(&row(), 1.0);
        let lists: Vec<&[u32]> = (0..6).map(|index| found.around(index)).collect();
        assert_eq!(lists, [&[1][..], &[0, 2], &[1], &[4], &[3, 5], &[4]]);
        assert!(found.is_whole() && found.count() == 6);
    }

    #[test]
    fn a_change_of_colour_costs_on_a_surface_and_not_between_two() {
        let neighbours = Neighbours::new(&row(), 1.0);
        let cost = |values: [f32; 6]| total_variation(&neighbours, (&values, 1), 6, 1.0, &mut [0.0; 6]);
        assert_eq!(cost([0.2, 0.2, 0.2, 0.9, 0.9, 0.9]), 0.0);
        let within = cost([0.2, 0.2, 0.9, 0.9, 0.9, 0.9]);
        // One pair of a difference of 0.7, over six pixels, less the rounding.
        assert!((within - (0.7 - 0.02) / 6.0).abs() < 1e-3, "{within}");
    }

    #[test]
    fn the_gradient_matches_central_differences() {
        let neighbours = Neighbours::new(&row(), 1.0);
        let values: Vec<f32> = (0..12).map(|i| 0.3 + 0.04 * ((i * 5) % 7) as f32).collect();
        let (weight, step) = (3.0, 1e-3);
        let loss =
            |values: &[f32], gradient: &mut [f32]| total_variation(&neighbours, (values, 2), 6, weight, gradient);
        let mut gradient = [0.0; 12];
        loss(&values, &mut gradient);
        for i in 0..12 {
            let moved = |by: f32| {
                let mut values = values.clone();
                values[i] += by;
                f64::from(weight) * loss(&values, &mut [0.0; 12])
            };
            let numeric = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
            let got = f64::from(gradient[i]);
            assert!(
                (numeric - got).abs() < 1e-2 * got.abs() + 1e-3,
                "{i}: {numeric} against {got}"
            );
        }
    }
}
