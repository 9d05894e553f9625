//! Agreement of pairs of views on a given surface: census distances on images that are resampled to it.

use super::census::{self, COMPARISONS, Descriptors, RADIUS};
use super::cost::CONTRAST_LIMIT;
use super::level::{LevelView, PixelPlane};
use super::pairs::Pair;
use super::visibility::FirstHits;
use heliosplat_grid::Grid;
use rayon::prelude::*;
use std::ops::Range;

/// Views and the surface that they are resampled to.
pub(super) struct OnSurface<'a> {
    pub(super) views: &'a [LevelView],
    /// First surface point that each of them sees.
    pub(super) hits: &'a [FirstHits],
    pub(super) grid: &'a Grid,
    /// One altitude per cell, metres.
    pub(super) altitude_m: &'a [f32],
    /// Least difference that is compared, as a share of the largest.
    pub(super) noise: f32,
}

/// The descriptors of all views on some rows of one surface: of brightness and, where views have one, of the index.
pub(super) struct Resampled {
    views: Vec<[Option<Descriptors>; 2]>,
}

/// Weighted sums of the census distances of pairs, cell by cell.
pub(super) struct DistanceSums {
    /// Distances in comparisons, times their weights.
    pub(super) distance: Vec<u32>,
    /// The weights; zero where no two views see a cell.
    pub(super) weight: Vec<u32>,
}

impl DistanceSums {
    pub(super) fn new(cells: usize) -> Self {
        Self {
            distance: vec![0; cells],
            weight: vec![0; cells],
        }
    }
}

impl OnSurface<'_> {
    /// Resamples the views to some rows of the surface, with occlusion.
    pub(super) fn resample(&self, rows: Range<usize>) -> Resampled {
        let views = self.views.par_iter().zip(self.hits);
        Resampled {
            views: views
                .map(|(view, hits)| self.describe_view(view, hits, &rows))
                .collect(),
        }
    }

    fn describe_view(&self, view: &LevelView, hits: &FirstHits, rows: &Range<usize>) -> [Option<Descriptors>; 2] {
        let grid = self.grid;
        let near = |at: isize, count: usize| (at.max(0) as usize).min(count - 1);
        let columns = grid.width + 2 * RADIUS;
        let places: Vec<(f32, f32)> = (0..columns * (rows.len() + 2 * RADIUS))
            .map(|i| {
                let col = (i % columns) as isize - RADIUS as isize;
                let row = (rows.start + i / columns) as isize - RADIUS as isize;
                let cell = near(row, grid.height) * grid.width + near(col, grid.width);
                let (u, v, _) = view.camera.project(grid.point(col, row, self.altitude_m[cell]));
                (u, v)
            })
            .collect();
        let describe = |plane: &PixelPlane| {
            let values: Vec<f32> = places.iter().map(|&(u, v)| view.sample_of(plane, u, v)).collect();
            let cells = grid.width * rows.len();
            let mut limits = vec![0.0; cells];
            let mut hidden = vec![false; cells];
            for cell in 0..cells {
                let (u, v) = places[(cell / grid.width + RADIUS) * columns + cell % grid.width + RADIUS];
                let (col, row) = (u.round(), v.round());
                let inside = col >= 0.0 && row >= 0.0 && col < view.width as f32 && row < view.height as f32;
                let pixel = if inside {
                    row as usize * view.width + col as usize
                } else {
                    0
                };
                limits[cell] = CONTRAST_LIMIT * plane.local_contrast[pixel];
                hidden[cell] = !inside || hits.hides(pixel, self.altitude_m[rows.start * grid.width + cell]);
            }
            let mut out = Descriptors::new(cells);
            census::describe(&values, grid.width, rows.len(), &limits, self.noise, &mut out);
            for (darker, hidden) in out.darker.iter_mut().zip(hidden) {
                *darker |= if hidden { census::INVALID } else { 0 };
            }
            out
        };
        [Some(describe(&view.mean)), view.index.as_ref().map(describe)]
    }
}

impl Resampled {
    /// The same with each neighbourhood rotated by 90 degrees about its centre.
    pub(super) fn rotated(&self) -> Self {
        let rotated =
            |planes: &[Option<Descriptors>; 2]| planes.each_ref().map(|plane| Some(plane.as_ref()?.rotated()));
        Self {
            views: self.views.iter().map(rotated).collect(),
        }
    }

    /// Adds the distances between the first view of a pair and the second one of `others`, planes of `weights`.
    pub(super) fn add_distances(&self, others: &Self, pair: &Pair, weights: [u32; 2], sums: &mut DistanceSums) {
        let planes = self.views[pair.a].iter().zip(&others.views[pair.b]).zip(weights);
        for ((a, b), weight) in planes {
            if let (Some(a), Some(b)) = (a, b) {
                census::compare(a, b, weight, COMPARISONS, &mut sums.distance, &mut sums.weight);
            }
        }
    }

    /// Census distance of a pair at each cell, shares of the comparisons that differ; NaN where one of the two does not
    /// see it.
    pub(super) fn distance(&self, pair: &Pair) -> Vec<f32> {
        let cells = self.views[pair.a][0].as_ref().map_or(0, |plane| plane.darker.len());
        let mut sums = DistanceSums::new(cells);
        self.add_distances(self, pair, [1, 1], &mut sums);
        let shares = sums.distance.iter().zip(&sums.weight);
        shares
            .map(|(&distance, &weight)| match weight {
                0 => f32::NAN,
                _ => distance as f32 / (weight * COMPARISONS) as f32,
            })
            .collect()
    }
}
