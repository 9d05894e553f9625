//! The plane sweep from its request to the initial surface: coarse to fine, then with hidden views left out, then post-processed.

use super::floor;
use super::grid::Grid;
use super::plane_smoothing;
use super::postprocess;
use super::pyramid::Search;
use super::request::PlaneSweepRequest;
use super::seen::{AltitudeGrid, views_seeing};
use super::surface::Surface;
use super::views::SweepView;
use super::visibility::FirstHits;
use heliosplat::ProjectiveCamera;

/// A point counts as hidden when it lies this many height steps below the surface that its view sees first, so that the surface's own
/// error of matching hides nothing.
const HIDDEN_STEPS: f32 = 2.0;
/// The same at least, metres.
const HIDDEN_M: f32 = 1.0;
/// Neighbours whose altitudes differ by less than this many cells (or [`SAME_PATCH_STEPS`]) belong to one patch.
const SAME_PATCH_CELLS: f32 = 2.0;
/// The same in height steps.
const SAME_PATCH_STEPS: f32 = 2.0;
/// Patches of fewer cells are taken for mismatches: 16 are two metres across at half a metre a cell.
const SPECKLE_CELLS: usize = 16;

/// Finds the surface that the views agree on. `progress` hears the share done, 0 to 1.
pub fn plane_sweep(views: &[SweepView], request: &PlaneSweepRequest, progress: &dyn Fn(f32)) -> Surface {
    let parameters = &request.parameters;
    let grid = request.grid();
    let search = Search::new(views, request).with_index();
    let mut found = search
        .descend(1, &|factor| progress(0.5 / factor as f32))
        .expect("the finest level is always searched");
    for _ in 0..parameters.visibility_rounds {
        floor::lower_for_visibility(&grid, &mut found, parameters);
        found = found.without_sums();
        let altitude = found.altitude();
        let tolerance_m = HIDDEN_M.max(HIDDEN_STEPS * found.step_m);
        let hits: Vec<_> = search
            .compared(1)
            .views
            .iter()
            .map(|view| FirstHits::new(&view.camera, &grid, &altitude, tolerance_m))
            .collect();
        found = search.level(1, Some(&found), Some(&hits));
    }
    let matched = found.altitude();
    floor::prefer(&grid, &mut found, parameters);
    let mut altitude = found.altitude();
    let same_patch_m = (SAME_PATCH_STEPS * found.step_m).max(SAME_PATCH_CELLS * grid.cell_m);
    let filled = postprocess::speckles(&grid, &altitude, same_patch_m, SPECKLE_CELLS);
    postprocess::fill(&grid, &mut altitude, &filled);
    let confidence: Vec<f32> = found.choices.iter().map(|choice| choice.margin).collect();
    if parameters.plane_radius > 0 {
        altitude = plane_smoothing::smooth(&grid, &altitude, parameters.plane_radius, same_patch_m);
    }
    if let Some(least) = parameters.adaptive_plane_radius {
        altitude = plane_smoothing::smooth_adaptively(&grid, &altitude, &confidence, least, found.step_m);
    }
    Surface {
        width: grid.width,
        height: grid.height,
        west_m: grid.west_m,
        north_m: grid.north_m,
        cell_m: grid.cell_m,
        above: above(&matched, &altitude, &filled),
        confidence,
        deviation_m: found.choices.iter().map(|choice| choice.deviation_m).collect(),
        probability: found.choices.iter().map(|choice| choice.probability).collect(),
        matched: found.evidence.matched(&grid),
        views: seen(&search, &grid, &altitude, found.step_m),
        resolution_m: found.step_m,
        filled,
        altitude,
    }
}

/// What was matched, where the floor was preferred to it; else the surface itself.
fn above(matched: &[f32], altitude: &[f32], filled: &[bool]) -> Vec<f32> {
    let cells = matched.iter().zip(altitude).zip(filled);
    cells
        .map(|((matched, altitude), filled)| if *filled { *altitude } else { matched.max(*altitude) })
        .collect()
}

/// How many views see each cell of the surface.
fn seen(search: &Search, grid: &Grid, altitude: &[f32], step_m: f32) -> Vec<u8> {
    let views = search.level_views(1);
    let cameras: Vec<ProjectiveCamera> = views.iter().map(|view| view.camera).collect();
    let surface = AltitudeGrid {
        size: (grid.width, grid.height),
        west_m: grid.west_m,
        north_m: grid.north_m,
        cell_m: grid.cell_m,
        altitude_m: altitude,
        resolution_m: HIDDEN_STEPS * step_m,
    };
    views_seeing(&surface, &cameras, &|view, pixel| {
        views[view].mean.pixels[pixel].is_finite()
    })
}
