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
#[derive(Clone, Copy)]
pub(super) struct OnSurface<'a> {
    /// Views at the resolution of the cells.
    pub(super) views: &'a [LevelView],
    /// First surface point on the ray of each pixel, one entry per view.
    pub(super) hits: &'a [FirstHits],
    /// Cells of the surface.
    pub(super) grid: &'a Grid,
    /// Altitude of each cell, metres.
    pub(super) altitude_m: &'a [f32],
    /// Added to the altitudes that are compared, metres; what hides a cell is that of the surface itself.
    pub(super) shift_m: f32,
    /// Least difference that the census compares, as a share of the contrast limit, 0 to 1.
    pub(super) noise: f32,
}

/// Census descriptors of all views on some rows of a surface: of brightness, and of the index where a view has one.
pub(super) struct Resampled {
    views: Vec<[Option<Descriptors>; 2]>,
}

/// Weighted sums of the census distances of pairs, cell by cell.
pub(super) struct DistanceSums {
    /// Weighted sum of the distances at each cell, in comparisons.
    pub(super) distance: Vec<u32>,
    /// Sum of the weights at each cell; 0 where no two views see it.
    pub(super) weight: Vec<u32>,
}

impl DistanceSums {
    /// Zero sums for `cells` cells.
    pub(super) fn new(cells: usize) -> Self {
        Self {
            distance: vec![0; cells],
            weight: vec![0; cells],
        }
    }
}

impl OnSurface<'_> {
    /// Census descriptors of all views on `rows` of the surface; cells hidden from a view are invalid in it.
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
                let (u, v, _) = view
                    .camera
                    .project(grid.point(col, row, self.altitude_m[cell] + self.shift_m));
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
    /// The descriptors with each neighbourhood rotated by 90 degrees about its centre.
    pub(super) fn rotated(&self) -> Self {
        let rotated =
            |planes: &[Option<Descriptors>; 2]| planes.each_ref().map(|plane| Some(plane.as_ref()?.rotated()));
        Self {
            views: self.views.iter().map(rotated).collect(),
        }
    }

    /// Adds to `sums` the census distances between the first view of `pair` and the second one in `others`; `weights`
    /// are those of brightness and of the index.
    pub(super) fn add_distances(&self, others: &Self, pair: &Pair, weights: [u32; 2], sums: &mut DistanceSums) {
        let planes = self.views[pair.a].iter().zip(&others.views[pair.b]).zip(weights);
        for ((a, b), weight) in planes {
            if let (Some(a), Some(b)) = (a, b) {
                census::compare(a, b, weight, COMPARISONS, &mut sums.distance, &mut sums.weight);
            }
        }
    }

    /// Census distance of a pair at each cell: share of the comparisons that differ, 0 to 1; NaN where one of the two
    /// views does not see the cell.
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
