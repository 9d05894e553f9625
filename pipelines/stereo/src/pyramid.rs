//! The coarse-to-fine search of the plane sweep: each level of the pyramid matches, aggregates and chooses heights
//! around the candidates of the coarser level.
//!
//! Tie points, clouds and pointing shifts use the same search down to a coarser level, as an approximate surface. All
//! choices of matching are in the request's [`MatchingParameters`](super::parameters::MatchingParameters).

use super::cost::MatchingCost;
use super::heights::HeightHypotheses;
use super::level::LevelView;
use super::ortho;
use super::pairs::{self, Pair};
use super::ranges::SearchRanges;
use super::request::PlaneSweepRequest;
use super::sgm::{Penalties, Volume};
use super::views::{SweepView, ViewGeometry};
use super::visibility::FirstHits;
use super::wta::{self, HeightChoice};
use glam::Vec3;
use heliosplat::timeline::stage;
use heliosplat_grid::Grid;
use heliosplat_rpc::parallax::LEAST_BASE_TO_HEIGHT;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Coarse cells on each side of a fine one whose candidates it searches too.
const REACH_CELLS: usize = 2;
/// Height steps of the coarser level added above and below the candidates.
const MARGIN_STEPS: f32 = 3.0;
/// Coarsest cells of the pyramid, in cells of the request.
const COARSEST: usize = 8;
/// Fewest cells each way of a level with a search of its own.
const FEWEST_CELLS: usize = 16;

/// Pixels of two views that differ by more than this factor are of unlike resolution: oblique views of one camera
/// differ by up to some 1.4.
const UNLIKE: f32 = 1.5;

/// The views that a level compares.
pub(super) struct Compared {
    /// The views of the search, followed by finer ones reduced to the resolution of their partners.
    pub(super) views: Vec<LevelView>,
    /// Pairs of `views` to compare.
    pub(super) pairs: Vec<Pair>,
}

/// Search volume, views and pairs, which all levels share.
pub(super) struct Search<'a> {
    /// Views of the search.
    pub(super) views: &'a [SweepView<'a>],
    /// Volume and parameters of the search.
    pub(super) request: &'a PlaneSweepRequest,
    /// Cells of the request.
    pub(super) grid: Grid,
    /// Point at which viewing directions are taken, metres.
    pub(super) centre: Vec3,
    /// Pairs of `views` to compare.
    pub(super) pairs: Vec<Pair>,
    /// Weight of a comparison of index planes relative to one of brightness, where they are compared.
    pub(super) index_weight: Option<f32>,
}

/// The heights chosen at one level.
pub(super) struct LevelResult {
    /// Cells of this level.
    pub(super) grid: Grid,
    /// Cells of the request per cell of this level.
    pub(super) factor: usize,
    /// Height step of this level, metres.
    pub(super) step_m: f32,
    /// Chosen height of each cell.
    pub(super) choices: Vec<HeightChoice>,
    /// Height hypotheses of this level.
    pub(super) heights: HeightHypotheses,
    /// Search ranges of the cells.
    pub(super) ranges: SearchRanges,
    /// Summed costs of all height levels of all cells, in the order of `ranges`; empty where no new choice follows.
    pub(super) sums: Vec<u16>,
}

impl LevelResult {
    /// The level without the summed costs, which only a new choice of heights needs.
    pub(super) fn without_sums(self) -> Self {
        Self {
            sums: Vec::new(),
            ..self
        }
    }

    /// Altitude of each cell, metres.
    pub(super) fn altitude(&self) -> Vec<f32> {
        self.choices.iter().map(|choice| choice.altitude_m).collect()
    }
}

impl<'a> Search<'a> {
    /// A search that compares brightness alone.
    pub(super) fn new(views: &'a [SweepView<'a>], request: &'a PlaneSweepRequest) -> Self {
        let centre = request.centre;
        let geometries: Vec<ViewGeometry> = views.iter().map(SweepView::geometry).collect();
        Self {
            views,
            request,
            grid: request.grid(),
            centre,
            pairs: pairs::choose(&geometries, centre),
            index_weight: None,
        }
    }

    /// The search, also comparing index planes where the request includes them and every view has one.
    pub(super) fn with_index(self) -> Self {
        let all_have_one = self.views.iter().all(|view| view.index.is_some());
        Self {
            index_weight: self.request.parameters.index_weight.filter(|_| all_have_one),
            ..self
        }
    }

    /// Cells of the request per cell of each level, from the coarsest useful one down to `finest`.
    pub(super) fn factors(&self, finest: usize) -> Vec<usize> {
        let side = self.grid.width.min(self.grid.height);
        let mut factors = Vec::new();
        let mut factor = COARSEST.max(finest);
        while factor >= finest {
            if factor == finest || side >= FEWEST_CELLS * factor {
                factors.push(factor);
            }
            factor /= 2;
        }
        factors
    }

    /// Searches all levels down to `finest`; `progress` receives the factor of each finished level. `None` without a
    /// level to search.
    pub(super) fn descend(&self, finest: usize, progress: &dyn Fn(usize)) -> Option<LevelResult> {
        let mut found = None;
        for factor in self.factors(finest) {
            let level = self.level(factor, found.as_ref(), None);
            found = Some(if factor == finest { level } else { level.without_sums() });
            progress(factor);
        }
        found
    }

    /// The views averaged down to the level whose cells are `factor` times as wide as requested.
    pub(super) fn level_views(&self, factor: usize) -> Vec<LevelView> {
        let cell_m = self.grid.cell_m * factor as f32;
        let with_index = self.index_weight.is_some();
        let one = |view: &SweepView| LevelView::new(view, cell_m, self.centre, with_index);
        self.views.par_iter().map(one).collect()
    }

    /// The views for comparison on the level whose cells are `factor` times as wide as requested. In a pair of unequal
    /// resolution the finer view is reduced to that of the coarser one, whose census has no finer detail.
    pub(super) fn compared(&self, factor: usize) -> Compared {
        let mut views = self.level_views(factor);
        let with_index = self.index_weight.is_some();
        let mut averaged: BTreeMap<(usize, usize), usize> = BTreeMap::new();
        let mut pairs = self.pairs.clone();
        for pair in &mut pairs {
            let coarser = |a: usize, b: usize| {
                let (a, b) = (&views[a], &views[b]);
                a.image_pixel_m > UNLIKE * b.image_pixel_m && a.pixel_m() > UNLIKE * b.pixel_m()
            };
            let (coarse, fine) = match (coarser(pair.a, pair.b), coarser(pair.b, pair.a)) {
                (true, _) => (pair.a, &mut pair.b),
                (_, true) => (pair.b, &mut pair.a),
                _ => continue,
            };
            let cell_m = views[coarse].pixel_m();
            let of = (*fine, (cell_m / views[*fine].image_pixel_m).round() as usize);
            *fine = *averaged.entry(of).or_insert_with(|| {
                views.push(LevelView::new(&self.views[of.0], cell_m, self.centre, with_index));
                views.len() - 1
            });
        }
        Compared { views, pairs }
    }

    /// Searches the level whose cells are `factor` times as wide as requested: all heights, or with `before` those
    /// around the candidates of that coarser (or equal) level. With `hits`, one for each compared view, cells hidden
    /// from a view are left out.
    pub(super) fn level(&self, factor: usize, before: Option<&LevelResult>, hits: Option<&[FirstHits]>) -> LevelResult {
        let grid = self.grid.coarser(factor);
        let part = stage("views");
        let Compared { views, pairs } = self.compared(factor);
        let heights = self.heights(grid.cell_m);
        let (ranges, guide) = match before {
            None => (SearchRanges::full(grid.len(), &heights), None),
            Some(found) => self.narrowed(&grid, &heights, &views[..self.views.len()], factor, found),
        };
        drop(part);
        let part = stage("costs");
        let parameters = &self.request.parameters;
        let matching = MatchingCost {
            grid,
            heights,
            views: &views,
            pairs: &pairs,
            hits,
            parameters,
            index_weight: self.index_weight,
        };
        let costs = matching.costs(&ranges);
        drop(part);
        let part = stage("aggregate");
        let volume = Volume {
            width: grid.width,
            height: grid.height,
            ranges: &ranges,
            costs: &costs,
            guide: guide.as_deref(),
            penalties: Penalties {
                one_step: parameters.one_step_penalty,
                jump: parameters.jump_penalty,
                edge: parameters.guide_edge,
            },
        };
        let sums = volume.aggregate();
        drop(part);
        let _part = stage("choose");
        let tolerance = parameters.candidate_tolerance.at(factor);
        let choices = wta::winner_takes_all(&ranges, &heights, &sums, tolerance, parameters.alternative_cost);
        LevelResult {
            grid,
            factor,
            step_m: heights.step_m,
            choices,
            heights,
            ranges,
            sums,
        }
    }

    /// The height hypotheses of a level whose cells are `cell_m` wide: the pair with the widest base shifts by
    /// `step_cells` from one to the next.
    fn heights(&self, cell_m: f32) -> HeightHypotheses {
        let PlaneSweepRequest { volume, parameters, .. } = self.request;
        let widest = pairs::widest_base_to_height(&self.pairs).max(LEAST_BASE_TO_HEIGHT as f32);
        let step_m = parameters.step_cells * cell_m / widest;
        HeightHypotheses::new(volume.altitude_min_m, volume.altitude_max_m, step_m)
    }

    /// The search ranges around the candidates of a coarser (or equal) level, and the guide image on its surface.
    fn narrowed(
        &self,
        grid: &Grid,
        heights: &HeightHypotheses,
        views: &[LevelView],
        factor: usize,
        found: &LevelResult,
    ) -> (SearchRanges, Option<Vec<f32>>) {
        let finer = found.factor / factor;
        let candidates: Vec<_> = found.choices.iter().map(|choice| choice.candidates).collect();
        let ranges = SearchRanges::around(
            grid,
            heights,
            &found.grid,
            finer,
            &candidates,
            REACH_CELLS,
            MARGIN_STEPS * found.step_m,
        );
        let altitude = ortho::repeated(grid, &found.grid, finer, &found.altitude());
        (ranges, Some(ortho::guide(grid, views, &altitude)))
    }
}
