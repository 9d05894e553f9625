//! The plane sweep from its request to the initial surface: coarse to fine, then with hidden views left out, then
//! post-processed.

use super::edges;
use super::evidence::{Evidence, LEAST_EVIDENCE, LevelSurface, is_match};
use super::floor;
use super::level::LevelView;
use super::plane_smoothing;
use super::postprocess;
use super::pyramid::{LevelResult, Search};
use super::request::PlaneSweepRequest;
use super::seen::{AltitudeGrid, FEWEST_VIEWS, Witnesses, views_seeing};
use super::surface::Surface;
use super::views::SweepView;
use super::visibility::{FirstHits, Standing};
use super::wta::HeightChoice;
use heliosplat::ProjectiveCamera;
use heliosplat_grid::Grid;
use heliosplat_grid::smooth_by_deviation;
use heliosplat_grid::statistics::upper_median;
use rayon::prelude::*;

/// A point counts as hidden when it lies this many height steps below the surface first seen by its view, so that the
/// surface's own error of matching hides nothing.
const HIDDEN_STEPS: f32 = 2.0;
/// Least depth below the surface first seen at which a point is hidden, metres.
const HIDDEN_M: f32 = 1.0;
/// Neighbours whose altitudes differ by less than this many cells (or [`SAME_PATCH_STEPS`]) belong to one patch.
const SAME_PATCH_CELLS: f32 = 2.0;
/// Largest difference of neighbours in one patch, height steps.
const SAME_PATCH_STEPS: f32 = 2.0;
/// Smallest patch that is no mismatch, cells: 16 are two metres across at half a metre a cell.
const SPECKLE_CELLS: usize = 16;
/// Height steps from either end of the search within which the least cost is not known to be a minimum.
const END_STEPS: f32 = 0.5;
/// Probability above which an altitude is not in doubt.
const SURE_PROBABILITY: f32 = 0.8;

/// Surface on which the views agree: one altitude per cell of the request, metres in the frame of the cameras.
/// `progress` receives the share done, 0 to 1.
pub fn plane_sweep(views: &[SweepView], request: &PlaneSweepRequest, progress: &dyn Fn(f32)) -> Surface {
    let grid = request.grid();
    let search = Search::new(views, request).with_index();
    let Swept {
        found,
        as_matched,
        altitude,
        confidence,
        filled,
        same_patch_m,
    } = Swept::new(&search, progress);
    let judged = LevelSurface {
        search: &search,
        factor: 1,
        grid,
        altitude_m: &altitude,
        tolerance_m: tolerance_m(found.step_m),
    };
    let Evidence { around: evidence, near } = judged.evidence();
    // Only cells with evidence hide others: outside the common ground the search finds false towers and pits.
    let cells = altitude.iter().zip(&evidence);
    let standing: Vec<f32> = cells
        .map(|(altitude, evidence)| match *evidence >= LEAST_EVIDENCE {
            true => *altitude,
            false => f32::NAN,
        })
        .collect();
    let witnesses = seen(&search.level_views(1), &grid, &altitude, &standing, found.step_m);
    let of_pairs = judged.variance_of_pairs(&witnesses, found.step_m / request.parameters.step_cells);
    let Witnesses { views, base_to_height } = witnesses;
    let end_m = END_STEPS * found.step_m;
    let searched_m = request.volume.altitude_min_m + end_m..request.volume.altitude_max_m - end_m;
    let cells = evidence.iter().zip(&views).zip(&altitude);
    let matched: Vec<bool> = cells
        .map(|((evidence, views), altitude)| is_match(*evidence, f32::from(*views)) && searched_m.contains(altitude))
        .collect();
    let around = judged.variance_around(&near, &views);
    let variances = found.choices.iter().zip(of_pairs.iter().zip(around));
    let deviation_m = variances
        .map(|(choice, (of_pairs, around))| (choice.deviation_m.powi(2) + of_pairs + around).sqrt())
        .collect();
    Surface {
        width: grid.width,
        height: grid.height,
        west_m: grid.west_m,
        north_m: grid.north_m,
        cell_m: grid.cell_m,
        above: above(&as_matched, &altitude, &filled),
        confidence,
        deviation_m,
        probability: shared(&grid, &altitude, same_patch_m, &found.choices),
        matched,
        views,
        base_to_height,
        resolution_m: found.step_m,
        filled,
        altitude,
    }
}

/// Altitudes of the surface that [`plane_sweep()`] finds, one per cell of the request, metres, for callers that need
/// nothing else.
pub(super) fn swept_altitudes(views: &[SweepView], request: &PlaneSweepRequest) -> Vec<f32> {
    let search = Search::new(views, request).with_index();
    Swept::new(&search, &|_| {}).altitude
}

/// A surface before the test of matches.
struct Swept {
    /// Result of the last search.
    found: LevelResult,
    /// Altitudes before the floor was preferred, metres.
    as_matched: Vec<f32>,
    /// Altitudes after post-processing, metres.
    altitude: Vec<f32>,
    /// Margins over the second-best height, 0 to 1.
    confidence: Vec<f32>,
    /// Speckles that were filled.
    filled: Vec<bool>,
    /// Neighbours whose altitudes differ by less belong to one patch, metres.
    same_patch_m: f32,
}

impl Swept {
    fn new(search: &Search, progress: &dyn Fn(f32)) -> Self {
        let parameters = &search.request.parameters;
        let grid = search.request.grid();
        let mut found = search
            .descend(1, &|factor| progress(0.5 / factor as f32))
            .expect("the finest level is always searched");
        for _ in 0..parameters.visibility_rounds {
            floor::lower_for_visibility(&grid, &mut found, parameters);
            found = found.without_sums();
            let altitude = found.altitude();
            // Beside the common ground the search finds towers that would hide its rim.
            let views = seen(&search.level_views(1), &grid, &altitude, &altitude, found.step_m);
            let standing: Vec<f32> = altitude
                .iter()
                .zip(views.views)
                .map(|(altitude, views)| if views >= FEWEST_VIEWS { *altitude } else { f32::MIN })
                .collect();
            let standing = Standing::new(&grid, &standing, tolerance_m(found.step_m));
            let hits: Vec<_> = search
                .compared(1)
                .views
                .iter()
                .map(|view| FirstHits::new(&view.camera, &standing))
                .collect();
            found = search.level(1, Some(&found), Some(&hits));
        }
        let as_matched = found.altitude();
        floor::prefer(&grid, &mut found, parameters);
        let mut altitude = found.altitude();
        let same_patch_m = (SAME_PATCH_STEPS * found.step_m).max(SAME_PATCH_CELLS * grid.cell_m);
        let filled = postprocess::speckles(&grid, &altitude, same_patch_m, SPECKLE_CELLS);
        postprocess::fill(&grid, &mut altitude, &filled);
        if parameters.aggregation_radius == 0 {
            smooth_by_deviation(grid.width, grid.cell_m, &mut altitude, &doubts(&found.choices));
        }
        let confidence: Vec<f32> = found.choices.iter().map(|choice| choice.margin).collect();
        if parameters.plane_radius > 0 {
            altitude = plane_smoothing::smooth(&grid, &altitude, parameters.plane_radius, same_patch_m);
        }
        if let Some(least) = parameters.adaptive_plane_radius {
            altitude = plane_smoothing::smooth_adaptively(&grid, &altitude, &confidence, least, found.step_m);
        }
        edges::place(&grid, &search.level_views(1), &mut altitude, found.step_m);
        Self {
            found,
            as_matched,
            altitude,
            confidence,
            filled,
            same_patch_m,
        }
    }
}

/// Distance below the first surface point of a view at which a point counts as hidden, metres.
fn tolerance_m(step_m: f32) -> f32 {
    HIDDEN_M.max(HIDDEN_STEPS * step_m)
}

/// Standard deviations of the altitudes, metres, zero where one altitude is far more probable than all others: the
/// alternatives are then often far away, and a surface between them is not plausible.
fn doubts(choices: &[HeightChoice]) -> Vec<f32> {
    let doubt = |choice: &HeightChoice| match choice.probability > SURE_PROBABILITY {
        true => 0.0,
        false => choice.deviation_m,
    };
    choices.iter().map(doubt).collect()
}

/// Probabilities of the altitudes: for each cell the median of those around it at its height, or its own where it is
/// greater. A single uncertain cell on a certain roof belongs to the roof.
fn shared(grid: &Grid, altitude: &[f32], same_patch_m: f32, choices: &[HeightChoice]) -> Vec<f32> {
    let of_cell = |cell: usize| {
        let as_high = |&near: &usize| (altitude[near] - altitude[cell]).abs() < same_patch_m;
        let around = grid
            .around(cell, 1)
            .filter(as_high)
            .map(|near| choices[near].probability);
        let own = choices[cell].probability;
        upper_median(&mut around.collect::<Vec<f32>>()).map_or(own, |shared| shared.max(own))
    };
    grid.cells().map(of_cell).collect()
}

/// The matched altitude where the floor was preferred to it; else the surface itself.
fn above(matched: &[f32], altitude: &[f32], filled: &[bool]) -> Vec<f32> {
    let cells = matched.iter().zip(altitude).zip(filled);
    cells
        .map(|((matched, altitude), filled)| if *filled { *altitude } else { matched.max(*altitude) })
        .collect()
}

/// The views that see each cell of the surface, with only `standing` (metres, NaN for nothing) as an occluder.
fn seen(views: &[LevelView], grid: &Grid, altitude: &[f32], standing: &[f32], step_m: f32) -> Witnesses {
    let cameras: Vec<ProjectiveCamera> = views.iter().map(|view| view.camera).collect();
    let surface = AltitudeGrid {
        size: (grid.width, grid.height),
        west_m: grid.west_m,
        north_m: grid.north_m,
        cell_m: grid.cell_m,
        altitude_m: altitude,
        standing_m: standing,
        resolution_m: HIDDEN_STEPS * step_m,
    };
    views_seeing(&surface, &cameras, &|view, pixel| {
        views[view].mean.pixels[pixel].is_finite()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_in_doubt_on_a_sure_roof_is_as_probable_as_the_roof_and_one_at_its_foot_is_not() {
        let grid = Grid::plain(9, 9);
        let altitude: Vec<f32> = (0..81).map(|cell| if cell % 9 < 5 { 6.0 } else { 0.0 }).collect();
        let choices: Vec<HeightChoice> = (0..81)
            .map(|cell| HeightChoice {
                altitude_m: altitude[cell],
                candidates: (0.0, 6.0),
                margin: 1.0,
                deviation_m: 0.1,
                probability: if cell == 38 || cell % 9 >= 5 { 0.3 } else { 0.9 },
            })
            .collect();
        let shared = shared(&grid, &altitude, 1.0, &choices);
        assert_eq!((shared[38], shared[37]), (0.9, 0.9));
        assert!((45..81).filter(|cell| cell % 9 >= 5).all(|cell| shared[cell] == 0.3));
    }
}
