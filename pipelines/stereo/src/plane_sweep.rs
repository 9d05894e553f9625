//! The sweep itself: from coarse to fine, then with what the surface hides taken out.

use super::grid::Grid;
use super::search::Search;
use super::settle;
use super::smooth;
use super::surface::Surface;
use super::views::SweepView;
use super::visibility::FirstHits;
use glam::Vec3;

/// Where and how to look for the surface. Distances are metres in the frame of the cameras, up is +z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepRequest {
    /// Western edge of the grid.
    pub west_m: f32,
    /// Southern edge.
    pub south_m: f32,
    /// Eastern edge.
    pub east_m: f32,
    /// Northern edge.
    pub north_m: f32,
    /// Width of a cell; about the ground distance between pixels is best.
    pub cell_m: f32,
    /// Lowest altitude looked at.
    pub altitude_min_m: f32,
    /// Highest altitude looked at.
    pub altitude_max_m: f32,
    /// How to look.
    pub options: SweepOptions,
}

/// How to look for the surface; the default serves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepOptions {
    /// Altitude step: the relative shift, in cells, of the pair of views with the widest base.
    pub step_cells: f32,
    /// Rounds in which views hidden by the surface found so far are left out.
    pub visibility_rounds: usize,
    /// Cost of one level up or down between neighbours, in units of a full mismatch / 255.
    pub one_level_penalty: u16,
    /// Cost of a jump between neighbours, in the same units; two thirds of it where the views are many.
    pub jump_penalty: u16,
    /// Image difference between neighbours, in units of the guide image, that makes a jump between them half as dear.
    pub edge: f32,
    /// Differences from the centre that the census compares, in median differences between neighbours: smaller ones are noise (shaded
    /// and even ground then matches with anything alike, and what is around decides; few views compare them all the same), larger
    /// ones the edge of a shadow or of another surface.
    pub compared: [f32; 2],
}

impl Default for SweepOptions {
    fn default() -> Self {
        Self {
            step_cells: 0.5,
            visibility_rounds: 1,
            one_level_penalty: 30,
            jump_penalty: 90,
            edge: 30.0,
            compared: [0.16, 8.0],
        }
    }
}

impl SweepRequest {
    pub(super) fn grid(&self) -> Grid {
        let cells = |from: f32, to: f32| (((to - from) / self.cell_m).round().max(0.0)) as usize;
        Grid {
            width: cells(self.west_m, self.east_m),
            height: cells(self.south_m, self.north_m),
            west_m: self.west_m,
            north_m: self.north_m,
            cell_m: self.cell_m,
        }
    }

    pub(super) fn centre(&self) -> Vec3 {
        Vec3::new(
            0.5 * (self.west_m + self.east_m),
            0.5 * (self.south_m + self.north_m),
            0.5 * (self.altitude_min_m + self.altitude_max_m),
        )
    }
}

/// Neighbours whose altitudes differ by less than this many cells (or two steps of the ladder) belong to one patch.
const SAME_PATCH_CELLS: f32 = 2.0;
/// Smaller patches are mistakes: two metres across at half a metre.
const ISLAND_CELLS: usize = 16;

/// Finds the surface that the views agree on. `progress` hears the share done, 0 to 1.
pub fn sweep(views: &[SweepView], request: &SweepRequest, progress: &dyn Fn(f32)) -> Surface {
    let grid = request.grid();
    let search = Search::new(views, request).with_index();
    let mut found = search
        .descend(1, &|factor| progress(0.5 / factor as f32))
        .expect("the finest level is always searched");
    for _ in 0..request.options.visibility_rounds {
        let altitude = found.altitude();
        let lv = search.level_views(1);
        let hits: Vec<_> = lv
            .iter()
            .map(|v| FirstHits::new(v, &grid, &altitude, 1.0f32.max(2.0 * found.step_m)))
            .collect();
        found = search.level(1, Some(&found), Some(&hits));
    }
    let mut altitude = found.altitude();
    let step_m = (2.0 * found.step_m).max(SAME_PATCH_CELLS * grid.cell_m);
    let filled = settle::islands(&grid, &altitude, step_m, ISLAND_CELLS);
    settle::fill(&grid, &mut altitude, &filled);
    let confidence: Vec<f32> = found.choices.iter().map(|c| c.margin).collect();
    let radius = smooth::radius_for(search.sharpness());
    if radius > 0 {
        altitude = smooth::planes(&grid, &altitude, radius + 1, step_m);
        altitude = smooth::faint_planes(&grid, &altitude, &confidence, radius, found.step_m);
    }
    Surface {
        width: grid.width,
        height: grid.height,
        west_m: grid.west_m,
        north_m: grid.north_m,
        cell_m: grid.cell_m,
        confidence,
        resolution_m: found.step_m,
        filled,
        altitude,
    }
}
