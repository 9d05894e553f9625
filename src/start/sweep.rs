//! The sweep itself: from coarse to fine, then with what the surface hides taken out.

use super::bands::Bands;
use super::cost::Matching;
use super::grid::{Grid, Ladder};
use super::pairs::{self, Pair};
use super::pick::{self, Choice};
use super::sgm::{Penalties, Volume};
use super::surface::Surface;
use super::views::{LevelView, SweepView};
use super::visibility::FirstHits;
use glam::Vec3;
use rayon::prelude::*;

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
    /// Cost of a jump between neighbours, in the same units.
    pub jump_penalty: u16,
    /// lab
    pub edge: f32,
}

impl Default for SweepOptions {
    fn default() -> Self {
        Self {
            step_cells: 0.5,
            visibility_rounds: 1,
            one_level_penalty: 12,
            jump_penalty: 60,
            edge: 1.0,
        }
    }
}

impl SweepRequest {
    fn grid(&self) -> Grid {
        let cells = |from: f32, to: f32| (((to - from) / self.cell_m).round().max(0.0)) as usize;
        Grid {
            width: cells(self.west_m, self.east_m),
            height: cells(self.south_m, self.north_m),
            west_m: self.west_m,
            north_m: self.north_m,
            cell_m: self.cell_m,
        }
    }

    fn centre(&self) -> Vec3 {
        Vec3::new(
            0.5 * (self.west_m + self.east_m),
            0.5 * (self.south_m + self.north_m),
            0.5 * (self.altitude_min_m + self.altitude_max_m),
        )
    }
}

/// Finds the surface that the views agree on. `progress` hears the share done, 0 to 1.
pub fn sweep(views: &[SweepView], request: &SweepRequest, progress: &dyn Fn(f32)) -> Surface {
    let grid = request.grid();
    let centre = request.centre();
    let pairs = pairs::choose(views, centre);
    let search = Search { views, request, grid, centre, pairs };
    let mut level: Option<Found> = None;
    for factor in [8, 4, 2, 1] {
        if factor > 1 && grid.width.min(grid.height) < 16 * factor { continue; }
        let t = std::time::Instant::now();
        level = Some(search.level(factor, level.as_ref(), None));
        if std::env::var("VERBOSE").is_ok() { eprintln!("factor {factor}: {:?}", t.elapsed()); }
        progress(0.5 / factor as f32);
    }
    let mut found = level.unwrap();
    for _ in 0..request.options.visibility_rounds {
        let t = std::time::Instant::now();
        let mut altitude: Vec<f32> = found.choices.iter().map(|c| c.altitude_m).collect();
        if let Some(o) = ORACLE.get() { altitude = o.clone(); }
        let lv = search.level_views(1);
        let hits: Vec<_> = lv.iter().map(|v| FirstHits::new(v, &grid, &altitude, std::env::var("TOL").map_or(1.0, |v| v.parse().unwrap()) * 1.0f32.max(2.0 * found.step_m))).collect();
        if std::env::var("VERBOSE").is_ok() { eprintln!("hits: {:?}", t.elapsed()); }
        found = search.level(1, Some(&found), Some(&hits));
        if std::env::var("VERBOSE").is_ok() { eprintln!("visibility: {:?}", t.elapsed()); }
    }
    Surface {
        width: grid.width,
        height: grid.height,
        west_m: grid.west_m,
        north_m: grid.north_m,
        cell_m: grid.cell_m,
        confidence: found.choices.iter().map(|c| c.margin).collect(),
        views: vec![0; grid.len()],
        filled: vec![false; grid.len()],
        altitude: found.choices.iter().map(|c| c.altitude_m).collect(),
    }
}

struct Search<'a> {
    views: &'a [SweepView<'a>],
    request: &'a SweepRequest,
    grid: Grid,
    centre: Vec3,
    pairs: Vec<Pair>,
}

struct Found {
    grid: Grid,
    factor: usize,
    step_m: f32,
    choices: Vec<Choice>,
}

impl Search<'_> {
    fn level_views(&self, factor: usize) -> Vec<LevelView> {
        self.views.par_iter().map(|v| LevelView::new(v, self.grid.cell_m * factor as f32, self.centre)).collect()
    }
    fn level(&self, factor: usize, before: Option<&Found>, hits: Option<&[FirstHits]>) -> Found {
        let options = &self.request.options;
        let grid = self.grid.coarser(factor);
        let views = self.level_views(factor);
        let base = self.pairs.iter().map(|p| p.base_to_height).fold(0.0, f32::max).max(1e-3);
        let step_m = options.step_cells * grid.cell_m / base;
        let ladder = Ladder::new(self.request.altitude_min_m, self.request.altitude_max_m, step_m);
        let mut guide = None;
        let bands = match before {
            None => Bands::full(grid.len(), &ladder),
            Some(found) => {
                let possible: Vec<_> = found.choices.iter().map(|c| c.possible).collect();
                let alt: Vec<f32> = found.choices.iter().map(|c| c.altitude_m).collect();
                let f = found.factor / factor;
                guide = Some(guide_image(&grid, &views, &found.grid, f, &alt));
                Bands::around(&grid, &ladder, &found.grid, f, &possible, 2, 3.0 * found.step_m)
            }
        };
        if std::env::var("VERBOSE").is_ok() { eprintln!("  cells {} levels {} total {} ({} per cell) step {step_m}", grid.len(), ladder.levels, bands.total(), bands.total() / grid.len()); }
        let matching = Matching { grid, ladder, views: &views, pairs: &self.pairs, hits, alike: if hits.is_some() { std::env::var("ALIKE").map_or(1e9, |v| v.parse().unwrap()) } else { std::env::var("ALIKE0").map_or(1e9, |v| v.parse().unwrap()) } };
        let t = std::time::Instant::now();
        let costs = matching.costs(&bands);
        if std::env::var("VERBOSE").is_ok() { eprintln!("  cost {:?}", t.elapsed()); }
        let t = std::time::Instant::now();
        let penalties = Penalties { one_level: options.one_level_penalty, jump: options.jump_penalty, edge: options.edge };
        let volume = Volume { width: grid.width, height: grid.height, bands: &bands, costs: &costs, guide: guide.as_deref(), penalties };
        let sums = volume.aggregate();
        if std::env::var("VERBOSE").is_ok() { eprintln!("  sgm {:?}", t.elapsed()); }
        let choices = pick::choose(&bands, &ladder, &sums, 8 * 10);
        Found { grid, factor, step_m, choices }
    }
}

/// Mean over the views of what they show on a surface, each view scaled to unit spread.
fn guide_image(grid: &Grid, views: &[LevelView], coarse: &Grid, factor: usize, altitude: &[f32]) -> Vec<f32> {
    let mut sum = vec![0.0f32; grid.len()];
    let mut n = vec![0.0f32; grid.len()];
    for view in views {
        let mut v = vec![f32::NAN; grid.len()];
        v.par_chunks_mut(grid.width).enumerate().for_each(|(row, line)| {
            for (col, o) in line.iter_mut().enumerate() {
                let z = altitude[row / factor * coarse.width + col / factor];
                let (c, r, _) = view.camera.project(grid.point(col as isize, row as isize, z));
                *o = view.sample(c, r);
            }
        });
        // typical gradient
        let mut g: Vec<f32> = (1..v.len()).map(|i| (v[i] - v[i - 1]).abs()).filter(|x| x.is_finite()).collect();
        if g.is_empty() { continue; }
        let m = g.len() / 2;
        let s = *g.select_nth_unstable_by(m, f32::total_cmp).1;
        for i in 0..v.len() { if v[i].is_finite() { sum[i] += v[i] / s.max(1e-9); n[i] += 1.0; } }
    }
    for i in 0..sum.len() { sum[i] /= n[i]; }
    sum
}

pub static ORACLE: std::sync::OnceLock<Vec<f32>> = std::sync::OnceLock::new();
