//! How well pairs of views agree on a given surface: census distances on images that are resampled to it.

use super::super::census::{self, COMPARISONS, Descriptors, RADIUS};
use super::super::cost::CONTRAST_LIMIT;
use super::super::grid::Grid;
use super::super::level::{LevelView, PixelPlane};
use super::super::pairs::Pair;
use super::super::visibility::FirstHits;
use rayon::prelude::*;

/// A point this far below what its view sees first is hidden, metres.
const HIDDEN_M: f32 = 1.5;

/// The descriptors of all views on one surface: of brightness and, where views have one, of the index.
pub(super) struct Resampled {
    views: Vec<[Option<Descriptors>; 2]>,
}

impl Resampled {
    /// Resamples `views` to a surface (metres, one altitude per cell of `grid`), which hides what lies behind it.
    pub(super) fn new(views: &[LevelView], grid: &Grid, altitude_m: &[f32], noise: f32) -> Self {
        let of_view = |view: &LevelView| {
            let hits = FirstHits::new(&view.camera, grid, altitude_m, HIDDEN_M);
            let place = |col: isize, row: isize| {
                let near = |at: isize, count: usize| (at.max(0) as usize).min(count - 1);
                let cell = near(row, grid.height) * grid.width + near(col, grid.width);
                let (u, v, _) = view.camera.project(grid.point(col, row, altitude_m[cell]));
                (u, v)
            };
            let (columns, rows) = (grid.width + 2 * RADIUS, grid.height + 2 * RADIUS);
            let places: Vec<(f32, f32)> = (0..columns * rows)
                .map(|i| {
                    let at = |i: usize| i as isize - RADIUS as isize;
                    place(at(i % columns), at(i / columns))
                })
                .collect();
            let describe = |plane: &PixelPlane| {
                let values: Vec<f32> = places.iter().map(|&(u, v)| view.sample_of(plane, u, v)).collect();
                let mut limits = vec![0.0; grid.len()];
                let mut out = Descriptors::new(grid.len());
                let mut hidden = vec![false; grid.len()];
                for cell in 0..grid.len() {
                    let (u, v) = places[(cell / grid.width + RADIUS) * columns + cell % grid.width + RADIUS];
                    let (col, row) = (u.round(), v.round());
                    let inside = col >= 0.0 && row >= 0.0 && col < view.width as f32 && row < view.height as f32;
                    let pixel = if inside {
                        row as usize * view.width + col as usize
                    } else {
                        0
                    };
                    limits[cell] = CONTRAST_LIMIT * plane.local_contrast[pixel];
                    hidden[cell] = !inside || hits.hides(pixel, altitude_m[cell]);
                }
                census::describe(&values, grid.width, grid.height, &limits, noise, &mut out);
                for (darker, hidden) in out.darker.iter_mut().zip(hidden) {
                    *darker |= if hidden { census::INVALID } else { 0 };
                }
                out
            };
            [Some(describe(&view.mean)), view.index.as_ref().map(describe)]
        };
        Self {
            views: views.par_iter().map(of_view).collect(),
        }
    }

    /// Census distance of a pair at each cell, shares of the comparisons that differ; NaN where one of the two does not see it.
    pub(super) fn distance(&self, pair: &Pair) -> Vec<f32> {
        let (a, b) = (&self.views[pair.a], &self.views[pair.b]);
        let planes = a.iter().zip(b).filter_map(|(a, b)| Some((a.as_ref()?, b.as_ref()?)));
        let mut distance: Vec<f32> = Vec::new();
        let mut count = 0.0f32;
        for (a, b) in planes {
            let cells = a.darker.len();
            let (mut sum, mut weights) = (vec![0; cells], vec![0; cells]);
            census::compare(a, b, 1, COMPARISONS, &mut sum, &mut weights);
            let shares = sum.iter().zip(&weights).map(|(&sum, &weight)| {
                if weight == 0 {
                    f32::NAN
                } else {
                    sum as f32 / COMPARISONS as f32
                }
            });
            if distance.is_empty() {
                distance = shares.collect();
            } else {
                distance
                    .iter_mut()
                    .zip(shares)
                    .for_each(|(total, share)| *total += share);
            }
            count += 1.0;
        }
        distance.iter_mut().for_each(|value| *value /= count);
        distance
    }
}

/// Mean of the values that are known.
pub(super) fn mean_known(values: &[f32]) -> Option<f32> {
    let known = values.iter().filter(|value| value.is_finite());
    let (sum, count) = known.fold((0.0f64, 0usize), |(sum, count), &value| {
        (sum + f64::from(value), count + 1)
    });
    (count > 0).then(|| (sum / count as f64) as f32)
}
