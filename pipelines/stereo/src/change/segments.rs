//! Connected segments of cells that two surfaces explain better than one.

use super::Split;
use heliosplat_grid::Grid;
use heliosplat_grid::statistics::upper_quantile;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Least difference of the two surfaces, metres.
const LEAST_M: f32 = 2.5;
/// Least gain of a cell that a segment grows from, agreeing pairs.
const SEED_GAIN: f32 = 0.03;
/// Least ground of a segment, m².
const LEAST_M2: f32 = 16.0;
/// Number of cells whose census distances amount to one independent observation: windows overlap, and objects span
/// several cells.
const CELLS_OF_ONE: f32 = 5.0;
/// Log-likelihood gained per unit by which a pair's census distance is less: the difference between agreement and
/// chance over the variance of distances, 0.12 / 0.15².
const LIKELIHOOD_PER_DISTANCE: f32 = 5.3;
/// Least log-likelihood ratio by matching: shadows identify the state of an image, not the existence of two states.
const LEAST_MATCHED: f32 = 5.0;
/// Parameters that a segment adds: an altitude and a day.
const PARAMETERS: f32 = 2.0;
/// Parameters of a change without shadow evidence: one more, the place. Without it weak evidence at the rim of
/// the images is nearly accepted (docs/lab/change.md).
const PARAMETERS_WITHOUT_SHADOWS: f32 = 3.0;
/// Least `criterion`, half of the difference of two Bayesian information criteria. A difference of 2 and less is "not
/// worth more than a bare mention" (R. E. Kass, A. E. Raftery, Bayes factors, Journal of the American Statistical
/// Association 90, 1995).
const LEAST_CRITERION: f32 = 1.0;
/// Least gain of a cell, as a share of its segment's upper quartile of gains: where half of the window is outside the
/// segment, about half of the gain remains.
const LEAST_SHARE: f32 = 0.45;

/// Two states of some cells.
#[derive(Debug, Clone, Copy)]
pub struct States<'a> {
    /// Indices of the cells on the searched grid.
    pub cells: &'a BTreeSet<usize>,
    /// Altitudes of each cell in the old state and in the new one, metres, in ascending order of the cells.
    pub altitudes_m: &'a [[f32; 2]],
    /// First day of the new state, days since 1970.
    pub day: i32,
}

/// The best surface before a day, or from it on: agreement, in agreeing pairs, and altitude of each cell.
pub(super) struct Side {
    gain: Vec<f32>,
    altitude_m: Vec<f32>,
}

impl Side {
    /// No surface on `cells` cells.
    pub(super) fn unknown(cells: usize) -> Self {
        Self {
            gain: vec![f32::MIN; cells],
            altitude_m: vec![f32::NAN; cells],
        }
    }

    /// Takes `altitude_m` (metres) at the cells where its `gain` (agreeing pairs) exceeds that of the surface so far.
    pub(super) fn consider(&mut self, gain: &[f32], altitude_m: &[f32]) {
        for cell in 0..gain.len() {
            if gain[cell] > self.gain[cell] {
                self.gain[cell] = gain[cell];
                self.altitude_m[cell] = altitude_m[cell];
            }
        }
    }
}

impl Split {
    /// Gain of two surfaces over one at a cell, in agreeing pairs.
    fn gain(&self, cell: usize) -> f32 {
        let gain = self.sides[0].gain[cell] + self.sides[1].gain[cell] - self.one[cell];
        // Nothing is known at the corners of the grid.
        if gain.is_finite() && self.one[cell] > f32::MIN {
            gain
        } else {
            f32::MIN
        }
    }

    fn difference_m(&self, cell: usize) -> f32 {
        self.sides[1].altitude_m[cell] - self.sides[0].altitude_m[cell]
    }

    fn differs(&self, cell: usize, up: bool) -> bool {
        let difference_m = self.difference_m(cell);
        difference_m.abs() > LEAST_M && (difference_m > 0.0) == up
    }
}

/// A segment on the cells on which change is searched.
pub(super) struct CoarseSegment {
    /// First day of the new state, days since 1970.
    pub(super) day: i32,
    /// Indices of the cells on the searched grid.
    pub(super) cells: BTreeSet<usize>,
    /// Altitudes of each cell before and after, metres, in ascending order of the cells.
    pub(super) altitudes_m: Vec<[f32; 2]>,
    /// Mean of the new altitudes less the old ones, metres.
    pub(super) difference_m: f32,
    /// Probability that two surfaces explain the images better than one, 0.5 to 1.
    pub(super) confidence: f32,
}

/// The segments that the Bayesian information criterion accepts. Cells visible in few images (`shown` is false) are
/// excluded: surfaces differ there by the selection of images. `by_shadows` is the log-likelihood ratio of two states
/// to one from the shadows around a segment; `None` without evidence.
pub(super) fn find(
    grid: &Grid,
    splits: &[Split],
    shown: &[bool],
    by_shadows: &dyn Fn(&States) -> Option<f32>,
) -> Vec<CoarseSegment> {
    let mut found = Vec::new();
    let mut taken = vec![false; grid.len()];
    for up in [false, true] {
        let best = |cell: usize| {
            let differing = splits.iter().filter(|split| split.differs(cell, up));
            differing.map(|split| split.gain(cell)).fold(f32::MIN, f32::max)
        };
        let seeds: Vec<bool> = (grid.cells())
            .map(|cell| shown[cell] && best(cell) > SEED_GAIN)
            .collect();
        for cells in grid.connected(&seeds) {
            let Some(segment) = accepted(grid, splits, &cells, up, &mut taken, by_shadows) else {
                continue;
            };
            found.push(segment);
        }
    }
    found
}

/// The segment around some connected cells, with the day that explains it best.
fn accepted(
    grid: &Grid,
    splits: &[Split],
    seeds: &[usize],
    up: bool,
    taken: &mut [bool],
    by_shadows: &dyn Fn(&States) -> Option<f32>,
) -> Option<CoarseSegment> {
    let total = |split: &Split| -> f32 {
        let cells = seeds.iter().filter(|&&cell| split.differs(cell, up));
        cells.map(|&cell| split.gain(cell)).sum()
    };
    let split = splits.iter().max_by(|a, b| total(a).total_cmp(&total(b)))?;
    let mut cells = BTreeSet::new();
    for &seed in seeds {
        let near = grid
            .around(seed, 1)
            .filter(|&cell| !taken[cell] && split.differs(cell, up));
        cells.extend(near.filter(|&cell| split.gain(cell) > 0.0));
    }
    let mut gains: Vec<f32> = cells.iter().map(|&cell| split.gain(cell)).collect();
    let least = LEAST_SHARE * upper_quantile(&mut gains, 0.75)?;
    cells.retain(|&cell| split.gain(cell) >= least);
    let area_m2 = cells.len() as f32 * grid.cell_m * grid.cell_m;
    let gain: f32 = cells.iter().map(|&cell| split.gain(cell)).sum();
    let matched = LIKELIHOOD_PER_DISTANCE * gain / CELLS_OF_ONE;
    if area_m2 < LEAST_M2 || matched < LEAST_MATCHED {
        return None;
    }
    let altitudes_m: Vec<[f32; 2]> = (cells.iter())
        .map(|&cell| [0, 1].map(|side: usize| split.sides[side].altitude_m[cell]))
        .collect();
    let shaded = by_shadows(&States {
        cells: &cells,
        altitudes_m: &altitudes_m,
        day: split.day,
    });
    let observations = grid.len() as f32 / CELLS_OF_ONE;
    let parameters = match shaded {
        Some(_) => PARAMETERS,
        None => PARAMETERS_WITHOUT_SHADOWS,
    };
    let criterion = matched + shaded.unwrap_or(0.0) - 0.5 * parameters * observations.ln();
    let first = cells.first().copied().unwrap_or(0);
    let (col, row) = (first % grid.width, first / grid.width);
    tracing::debug!(
        col,
        row,
        day = split.day,
        area_m2,
        matched,
        ?shaded,
        criterion,
        "segment"
    );
    if criterion <= LEAST_CRITERION {
        return None;
    }
    for &cell in &cells {
        taken[cell] = true;
    }
    let difference_m = altitudes_m.iter().map(|[old, new]| new - old).sum::<f32>() / cells.len() as f32;
    Some(CoarseSegment {
        day: split.day,
        cells,
        altitudes_m,
        difference_m,
        confidence: 1.0 / (1.0 + (-criterion).exp()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of ten metres in the middle of thirty, where two surfaces explain `gain` more pairs than one.
    fn split(day: i32, gain: f32) -> Split {
        let inside = |cell: usize| (10..20).contains(&(cell % 30)) && (10..20).contains(&(cell / 30));
        let side = |top_m: f32| Side {
            gain: vec![1.0; 900],
            altitude_m: (0..900).map(|cell| if inside(cell) { top_m } else { 0.0 }).collect(),
        };
        Split {
            day,
            one: (0..900)
                .map(|cell| if inside(cell) { 2.0 - gain } else { 2.5 })
                .collect(),
            sides: [side(0.0), side(6.0)],
        }
    }

    #[test]
    fn a_house_is_one_segment_with_the_day_that_explains_it_best() {
        let grid = Grid::plain(30, 30);
        let splits = [split(3, 0.1), split(7, 0.4), split(9, -0.2)];
        let found = find(&grid, &splits, &[true; 900], &|_| None);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].day, found[0].cells.len()), (7, 100));
        assert!((found[0].difference_m - 6.0).abs() < 1e-6 && found[0].confidence > 0.9);
    }

    #[test]
    fn two_surfaces_that_explain_hardly_more_are_not_accepted() {
        let grid = Grid::plain(30, 30);
        let count = |gain: f32, shown: bool| find(&grid, &[split(3, gain)], &[shown; 900], &|_| None).len();
        assert_eq!((count(0.04, true), count(-0.5, true)), (0, 0));
        assert_eq!((count(0.4, true), count(0.4, false)), (1, 0), "few images show it");
    }

    #[test]
    fn shadows_confirm_and_refute_what_matching_finds_but_find_nothing_alone() {
        let grid = Grid::plain(30, 30);
        let count = |gain: f32, shaded: Option<f32>| {
            let found = find(&grid, &[split(7, gain)], &[true; 900], &|_| shaded);
            found.len()
        };
        assert_eq!((count(0.055, Some(0.0)), count(0.055, Some(8.0))), (0, 1));
        assert_eq!((count(0.4, None), count(0.4, Some(-40.0))), (1, 0));
        assert_eq!(count(0.04, Some(100.0)), 0);
        assert_eq!(
            (count(0.07, Some(0.0)), count(0.07, None)),
            (1, 0),
            "what no shadow confirms has to match better"
        );
    }
}
