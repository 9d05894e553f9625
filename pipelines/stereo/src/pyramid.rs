//! From coarse to fine: the pyramid of volumes that both the sweep and the alignment descend.

use super::bands::Bands;
use super::cost::Matching;
use super::grid::{Grid, Ladder};
use super::ortho;
use super::pairs::{self, Pair};
use super::pick::{self, Choice};
use super::sgm::{Penalties, Volume};
use super::smooth;
use super::sweep::SweepRequest;
use super::views::{LevelView, SweepView};
use super::visibility::FirstHits;
use glam::Vec3;
use rayon::prelude::*;

/// How boldly a surface is sought: what many views agree on is less often chance.
#[derive(Debug, Clone, Copy)]
struct Manner {
    /// Summed cost above the best within which another level stays possible at the next, finer round.
    tolerance: u16,
    /// Weight, as a share of all pairs, of the assumption that nothing matches: altitudes that few views see must not win
    /// by chance.
    doubt: f32,
    /// Whether views of one date are compared pixel by pixel too: the same sun makes them alike, and a single pixel does not reach
    /// over edges as a window does.
    same_date_values: bool,
    /// Thirds of the penalty for jumps that are asked: a whole number, like the penalty.
    jump_thirds: u16,
    /// Whether differences that may be noise are left out of the comparison: few views, unless they stand so close that noise is
    /// most of what they show, have nothing to spare.
    without_noise: bool,
}

/// Views from which on they are many: the search is bolder then, and takes longer.
pub const MANY_VIEWS: usize = 8;
const OF_FEW: Manner = Manner {
    tolerance: 80,
    doubt: 0.08,
    same_date_values: false,
    jump_thirds: 3,
    without_noise: false,
};
const OF_MANY: Manner = Manner {
    tolerance: 200,
    doubt: 0.03,
    same_date_values: true,
    jump_thirds: 2,
    without_noise: true,
};
/// Tolerance at most with cells of twice the size asked for; wider ones take time and find nothing more.
const TOLERANCE_AT_TWO: u16 = 120;
/// Coarse cells around a fine one whose altitudes stay possible for it.
const REACH_CELLS: usize = 2;

/// Coarsest cells of the pyramid, in cells of the request.
const COARSEST: usize = 8;
/// A level needs this many cells each way to be worth its own search.
const FEWEST_CELLS: usize = 16;

/// What is searched and with which views; the same on every level.
pub(super) struct Search<'a> {
    pub(super) views: &'a [SweepView<'a>],
    pub(super) request: &'a SweepRequest,
    pub(super) grid: Grid,
    pub(super) centre: Vec3,
    pub(super) pairs: Vec<Pair>,
    /// Whether the views' indices are compared too.
    with_index: bool,
}

/// What a level found.
pub(super) struct Found {
    pub(super) grid: Grid,
    /// Cells of the request per cell of this level.
    pub(super) factor: usize,
    /// Step of this level's ladder.
    pub(super) step_m: f32,
    pub(super) choices: Vec<Choice>,
}

impl Found {
    pub(super) fn altitude(&self) -> Vec<f32> {
        self.choices.iter().map(|choice| choice.altitude_m).collect()
    }
}

impl<'a> Search<'a> {
    pub(super) fn new(views: &'a [SweepView<'a>], request: &'a SweepRequest) -> Self {
        let centre = request.centre();
        Self {
            views,
            request,
            grid: request.grid(),
            centre,
            pairs: pairs::choose(views, centre),
            with_index: false,
        }
    }

    /// The same, which compares the views' indices too.
    pub(super) fn with_index(self) -> Self {
        Self {
            with_index: true,
            ..self
        }
    }

    /// Factors from the coarsest useful level down to `finest`.
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

    /// Searches all levels down to `finest`; `None` when there is nothing to search.
    pub(super) fn descend(&self, finest: usize, heard: &dyn Fn(usize)) -> Option<Found> {
        let mut found = None;
        for factor in self.factors(finest) {
            found = Some(self.level(factor, found.as_ref(), None));
            heard(factor);
        }
        found
    }

    /// The views averaged down for a level.
    pub(super) fn level_views(&self, factor: usize) -> Vec<LevelView> {
        let cell_m = self.grid.cell_m * factor as f32;
        let one = |view: &SweepView| LevelView::new(view, cell_m, self.centre, self.with_index);
        self.views.par_iter().map(one).collect()
    }

    /// Searches one level: everywhere, or around what a coarser (or equal) level found; with `hits`, hidden views are
    /// left out.
    pub(super) fn level(&self, factor: usize, before: Option<&Found>, hits: Option<&[FirstHits]>) -> Found {
        let grid = self.grid.coarser(factor);
        let views = self.level_views(factor);
        let ladder = self.ladder(grid.cell_m);
        let (bands, guide) = match before {
            None => (Bands::full(grid.len(), &ladder), None),
            Some(found) => self.narrowed(&grid, &ladder, &views, factor, found),
        };
        let options = &self.request.options;
        let manner = if self.views.len() < MANY_VIEWS { OF_FEW } else { OF_MANY };
        let radius = smooth::radius_for(self.sharpness());
        let matching = Matching {
            grid,
            ladder,
            views: &views,
            pairs: &self.pairs,
            hits,
            compared: if manner.without_noise || smooth::is_widest(radius) {
                options.compared
            } else {
                [0.0, options.compared[1]]
            },
            doubt: manner.doubt,
            same_date_values: manner.same_date_values,
            radius,
        };
        let costs = matching.costs(&bands);
        let volume = Volume {
            width: grid.width,
            height: grid.height,
            bands: &bands,
            costs: &costs,
            guide: guide.as_deref(),
            penalties: Penalties {
                one_level: options.one_level_penalty,
                jump: options.jump_penalty * manner.jump_thirds / 3 * smooth::steadiness(radius),
                edge: options.edge,
            },
        };
        let sums = volume.aggregate();
        // Finer levels have less left to decide.
        let tolerance = manner.tolerance.min(match factor {
            1 => OF_FEW.tolerance,
            2 => TOLERANCE_AT_TWO,
            _ => u16::MAX,
        });
        let choices = pick::choose(&bands, &ladder, &sums, tolerance);
        Found {
            grid,
            factor,
            step_m: ladder.step_m,
            choices,
        }
    }

    /// How sharply all comparisons together tell altitudes apart: the root of the sum of squared ratios of base to height.
    pub(super) fn sharpness(&self) -> f32 {
        self.pairs
            .iter()
            .map(|pair| pair.base_to_height.powi(2))
            .sum::<f32>()
            .sqrt()
    }

    /// Largest ratio of base to height among the pairs that are compared.
    fn widest_base(&self) -> f32 {
        self.pairs.iter().map(|pair| pair.base_to_height).fold(0.0, f32::max)
    }

    fn ladder(&self, cell_m: f32) -> Ladder {
        let step_m = self.request.options.step_cells * cell_m / self.widest_base().max(1e-3);
        Ladder::new(self.request.altitude_min_m, self.request.altitude_max_m, step_m)
    }

    fn narrowed(
        &self,
        grid: &Grid,
        ladder: &Ladder,
        views: &[LevelView],
        factor: usize,
        found: &Found,
    ) -> (Bands, Option<Vec<f32>>) {
        let finer = found.factor / factor;
        let possible: Vec<_> = found.choices.iter().map(|choice| choice.possible).collect();
        let bands = Bands::around(
            grid,
            ladder,
            &found.grid,
            finer,
            &possible,
            REACH_CELLS,
            3.0 * found.step_m,
        );
        let altitude = ortho::repeated(grid, &found.grid, finer, &found.altitude());
        (bands, Some(ortho::guide(grid, views, &altitude)))
    }
}
