//! Prior for the ground: where the images hardly separate a surface from the ground around it, the ground is chosen.
//!
//! A sweep has a bias. Ground next to a wall is in shade on many dates, hidden from many views, and in windows that
//! include the edge of the roof; its costs are noise, and the smoothness extends the roof's altitude across it. Errors
//! next to walls are therefore mostly ground that is too high, four times as often as roofs that are too low
//! (docs/lab/edges.md). So before heights are chosen, the cost at the altitude of the floor is reduced by a constant,
//! the log-odds of the ground.
//!
//! The floor is the lowest certain altitude within some cells. Surfaces less than [`STEP_M`] above it do not change.

use super::parameters::MatchingParameters;
use super::pyramid::LevelResult;
use super::wta;
use heliosplat_grid::{Grid, lowest_within};
use rayon::prelude::*;

/// Cells around a cell whose lowest certain one is its floor: the shade of a house of two storeys.
const REACH_CELLS: usize = 16;
/// Least margin of a certain altitude.
const SURE_MARGIN: f32 = 0.15;
/// Cells each way around a certain cell, and the number of them that have to be as high: a floor is an area, no pit.
const PLACE: (usize, usize) = (2, 18);
/// Difference within which they are as high, metres.
const ALIKE_M: f32 = 1.0;
/// Least height above the floor of a cell that may change, metres: less may be a slope.
const STEP_M: f32 = 1.0;
/// Height hypotheses on both sides of the floor that belong to it: it slopes, and certain cells have errors.
const SAME_LEVELS: usize = 3;

/// Bonus before hidden views are left out, as a multiple of the final one: a roof over ground hides the ground from all
/// views, so an occluder must be more certain than the final choice.
const HIDING_BONUS: f32 = 1.5;

/// Lowers uncertain surfaces, so that they do not hide the ground with which they are compared; the matched altitude
/// stays a candidate.
pub(super) fn lower_for_visibility(grid: &Grid, found: &mut LevelResult, parameters: &MatchingParameters) {
    let bonus = (HIDING_BONUS * f32::from(parameters.floor_bonus)) as u16;
    let matched: Vec<(f32, f32)> = found.choices.iter().map(|choice| choice.candidates).collect();
    choose_again(grid, found, bonus, parameters);
    for (choice, (lowest, highest)) in found.choices.iter_mut().zip(matched) {
        choice.candidates.0 = choice.candidates.0.min(lowest);
        choice.candidates.1 = choice.candidates.1.max(highest);
    }
}

/// Chooses the floor where its summed cost less the floor bonus of `parameters` is the least.
pub(super) fn prefer(grid: &Grid, found: &mut LevelResult, parameters: &MatchingParameters) {
    choose_again(grid, found, parameters.floor_bonus, parameters);
}

/// Chooses the heights again with the floor cheaper by `bonus`, in summed cost.
fn choose_again(grid: &Grid, found: &mut LevelResult, bonus: u16, parameters: &MatchingParameters) {
    if bonus == 0 {
        return;
    }
    let tolerance = parameters.candidate_tolerance.full_resolution;
    let floor_m = floor(grid, found);
    let (ranges, heights) = (&found.ranges, &found.heights);
    let mut rest = found.sums.as_mut_slice();
    let mut rows = Vec::with_capacity(grid.height);
    for (row, choices) in found.choices.chunks_mut(grid.width).enumerate() {
        let cell0 = row * grid.width;
        let (sums, tail) = rest.split_at_mut(ranges.start[cell0 + choices.len()] - ranges.start[cell0]);
        rows.push((cell0, choices, sums));
        rest = tail;
    }
    rows.into_par_iter().for_each(|(cell0, choices, sums)| {
        for (choice, cell) in choices.iter_mut().zip(cell0..) {
            let floor_m = floor_m[cell];
            if choice.altitude_m - floor_m < STEP_M {
                continue;
            }
            let first = usize::from(ranges.low[cell]);
            let sums = &mut sums[ranges.start[cell] - ranges.start[cell0]..][..ranges.count(cell)];
            let middle = heights.level(floor_m).round() as usize;
            let levels = middle.saturating_sub(SAME_LEVELS)..=middle + SAME_LEVELS;
            for (_, sum) in sums
                .iter_mut()
                .enumerate()
                .filter(|(k, _)| levels.contains(&(first + k)))
            {
                *sum = sum.saturating_sub(bonus);
            }
            *choice = wta::winner(sums, first, heights, tolerance, parameters.alternative_cost);
        }
    });
}

/// The lowest certain altitude around each cell, metres, and at most its own.
fn floor(grid: &Grid, found: &LevelResult) -> Vec<f32> {
    let own = found.altitude();
    let sure = |cell: usize| {
        let as_high = |&near: &usize| (own[near] - own[cell]).abs() < ALIKE_M;
        found.choices[cell].margin >= SURE_MARGIN && grid.around(cell, PLACE.0).filter(as_high).count() >= PLACE.1
    };
    let places: Vec<f32> = grid
        .cells()
        .map(|cell| if sure(cell) { own[cell] } else { f32::MAX })
        .collect();
    let lowest = lowest_within((grid.width, grid.height), &places, [REACH_CELLS; 2]);
    lowest.iter().zip(own).map(|(lowest, own)| lowest.min(own)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::heights::HeightHypotheses;
    use super::super::parameters::MatchingFacts;
    use super::super::ranges::SearchRanges;
    use super::*;

    /// Level ground with a strip two cells wide that matches best 6 m above it, with a summed cost lower by `gap` than
    /// at the ground.
    fn beside_a_wall(gap: u16) -> (Grid, LevelResult, MatchingParameters) {
        let grid = Grid::plain(24, 24);
        let heights = HeightHypotheses::new(0.0, 10.0, 0.5);
        let ranges = SearchRanges::full(grid.len(), &heights);
        let mut sums = vec![1900u16; ranges.total()];
        for cell in 0..grid.len() {
            let of_cell = &mut sums[ranges.range(cell)];
            if cell % 24 < 2 {
                (of_cell[2], of_cell[14]) = (1200 + gap, 1200);
            } else {
                of_cell[2] = 400;
            }
        }
        let parameters = MatchingParameters::choose(&MatchingFacts {
            views: 12.0,
            combined_base_to_height: 3.0,
            has_index: false,
        });
        let found = LevelResult {
            grid,
            factor: 1,
            step_m: heights.step_m,
            choices: wta::winner_takes_all(&ranges, &heights, &sums, 80, parameters.alternative_cost),
            heights,
            ranges,
            sums,
        };
        (grid, found, parameters)
    }

    #[test]
    fn what_hardly_matches_better_than_the_ground_is_the_ground_and_what_clearly_does_stays() {
        let strip = |gap: u16| {
            let (grid, mut found, parameters) = beside_a_wall(gap);
            assert_eq!(found.choices[24].altitude_m, 7.0);
            prefer(&grid, &mut found, &parameters);
            assert!(found.choices[5].altitude_m < 1.5, "the ground stays");
            found.choices[24]
        };
        let doubtful = strip(100);
        assert!(doubtful.altitude_m < 1.5, "{doubtful:?}");
        assert!(doubtful.deviation_m > 1.0, "it could be a roof: {doubtful:?}");
        assert_eq!(strip(400).altitude_m, 7.0);
    }

    #[test]
    fn what_is_lowered_for_the_views_stays_a_candidate() {
        let (grid, mut found, parameters) = beside_a_wall(200);
        lower_for_visibility(&grid, &mut found, &parameters);
        let choice = found.choices[24];
        assert!(choice.altitude_m < 1.5 && choice.candidates.1 >= 7.0, "{choice:?}");
    }
}
