//! Change detection: parts of a surface that exist only before or after a date.
//!
//! One surface is swept on coarse cells from the images before the first day with at least two images on either side,
//! and one from the last such day on: they have only the old and only the new state, and both are hypotheses besides
//! the surface of all images. A pair of images supports a surface when its census distance there is below that by
//! chance. With one surface all pairs count; with two, the pairs before a day support one, the pairs from it on support
//! the other, and pairs across the day are unused, so that unchanged ground keeps its single surface as long as images
//! across the day agree on it.
//!
//! Cells better explained by two surfaces are joined to segments, and each segment gets the day that explains it best.
//! The shadows around a segment show its state on each date, and the Bayesian information criterion accepts or rejects
//! it.
//!
//! Limits: a structure that exists only between two dates is found as one of its two changes. A side with fewer than
//! two images has no surface of its own, so changes before the second or after the last but one image are not found.

mod segments;

use super::agreement::OnSurface;
use super::level::LevelView;
use super::ortho::box_mean;
use super::pairs::Pair;
use super::parameters::{MatchingFacts, MatchingParameters};
use super::plane_sweep::{plane_sweep, swept_altitudes};
use super::pyramid::Search;
use super::request::PlaneSweepRequest;
use super::seen::pixel_of;
use super::surface::Surface;
use super::views::{SweepView, ViewGeometry};
use super::visibility::{FirstHits, Standing};
use super::volume::SearchVolume;
use heliosplat_grid::Grid;
use rayon::prelude::*;
pub use segments::States;
use segments::{CoarseSegment, Side};
use std::cell::LazyCell;
use std::collections::BTreeMap;

/// Cells of the request per cell on which change is searched.
const COARSE: usize = 2;
/// Images needed on either side of a day.
const FEWEST_IMAGES: usize = 2;
/// Most days on which images are divided: the memory of the search grows with their number.
const MOST_DAYS: usize = 12;
/// A point this far below the first surface point on its ray is hidden, metres.
const HIDDEN_M: f32 = 1.5;
/// Metres above the surface at which images agree by chance alone.
const CHANCE_M: f32 = 7.0;
/// Default census distance by chance, where no cell measures it.
const CHANCE: f32 = 0.4;
/// Rows whose agreement is summed at once.
const BLOCK_ROWS: usize = 32;
/// Half of the window over which agreement is averaged, coarse cells.
const WINDOW: usize = 2;
/// Ground around segments that is swept with them, metres: the reach of their occlusion and shadows.
const AROUND_M: f32 = 24.0;
/// Fine cells by which a coarse segment may be too small on each side.
const GROWN_CELLS: usize = 2;
/// Least difference of the two surfaces in a cell of a segment, metres.
const LEAST_M: f32 = 1.5;
/// Least difference next to a coarse segment, as a share of the segment's.
const LEAST_SHARE: f32 = 0.6;
/// Share of the images that must show a place for change detection.
const SHOWN: f32 = 0.8;
/// Largest distance of a fine altitude from the accepted coarse one, metres; beyond it the coarse altitude is used.
const SAME_M: f32 = 2.0;

/// One connected part of the ground that changed.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Segment {
    /// The first day that shows the new state, days since 1970.
    pub day: i32,
    /// Median of the new altitude less the old one, metres.
    pub difference_m: f32,
    /// Ground area, m².
    pub area_m2: f32,
    /// Western, southern, eastern and northern edge, metres in the frame of the surface.
    pub bounds_m: [f32; 4],
    /// Probability that two surfaces explain the images better than one, 0.5 to 1.
    pub confidence: f32,
}

/// Changes of a surface, on the surface's own cells.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Changes {
    /// Changed segments, in the order of their days.
    pub segments: Vec<Segment>,
    /// For each cell the index of its segment in `segments` plus one; 0 where nothing changed.
    pub label: Vec<u32>,
    /// Altitude of each cell before its change, metres; the current altitude where nothing changed.
    pub before_m: Vec<f32>,
    /// Days that divide the images, days since 1970; empty where changes cannot be detected.
    pub days: Vec<i32>,
}

impl Changes {
    /// Segment of a cell; `None` where nothing changed and off the surface.
    pub fn at(&self, cell: usize) -> Option<&Segment> {
        let label = *self.label.get(cell)? as usize;
        self.segments.get(label.checked_sub(1)?)
    }
}

/// Support of the hypotheses for one day, on each coarse cell.
struct Split {
    day: i32,
    /// Agreement of the best single surface, in agreeing pairs.
    one: Vec<f32>,
    /// The best surfaces before the day and from it on.
    sides: [Side; 2],
}

/// Divides `surface`, which was swept from all `views`, into the states before and after a day where the images support
/// two states. `days` are the dates of the views, days since 1970. Changed cells of `surface` get the altitude after
/// the change. The result is empty without a day that divides the images ([`dividing_days`]).
///
/// `by_shadows` receives the searched cells and the altitudes of the surface there, metres. Its result gives the
/// log-likelihood ratio of two states to one from the shadows around a segment; `None` where no date shows decisive
/// ground.
pub fn find<L: Fn(&States) -> Option<f32>>(
    views: &[SweepView],
    days: &[i32],
    request: &PlaneSweepRequest,
    surface: &mut Surface,
    by_shadows: impl FnOnce(&Grid, &[f32]) -> L,
) -> Changes {
    let candidates = dividing_days(days);
    if candidates.is_empty() {
        return Changes::default();
    }
    let mut coarse = *request;
    coarse.volume.cell_m *= COARSE as f32;
    let grid = coarse.grid();
    let splits = splits(views, days, &candidates, &coarse, surface);
    // Measured only if a candidate needs it.
    let by_shadows = LazyCell::new(|| by_shadows(&grid, &on_grid(&grid, surface)));
    let found = segments::find(&grid, &splits, &shown(views, &grid, surface), &|states: &States| {
        by_shadows(states)
    });
    let mut changes = Changes {
        segments: Vec::new(),
        label: vec![0; surface.altitude.len()],
        before_m: surface.altitude.clone(),
        days: candidates,
    };
    let mut of_days: Vec<i32> = found.iter().map(|segment| segment.day).collect();
    of_days.sort_unstable();
    of_days.dedup();
    for day in of_days {
        let of_that_day: Vec<&CoarseSegment> = found.iter().filter(|segment| segment.day == day).collect();
        let volume = around(&request.volume, &grid, &of_that_day);
        let request = PlaneSweepRequest { volume, ..*request };
        let sides = [false, true].map(|after| {
            let views = side(views, days, day, after);
            plane_sweep(
                &views,
                &matched_as(&views, &request, MatchingParameters::choose),
                &|_| {},
            )
        });
        for segment in of_that_day {
            changes.refine(segment, &grid, &sides, surface);
        }
    }
    for (before, (now, label)) in changes
        .before_m
        .iter_mut()
        .zip(surface.altitude.iter().zip(&changes.label))
    {
        if *label == 0 {
            *before = *now;
        }
    }
    changes
}

impl Changes {
    /// Adds a segment with the cells of `surface` in and next to it at which the surfaces of the two `sides` differ in
    /// the segment's direction.
    fn refine(&mut self, segment: &CoarseSegment, grid: &Grid, sides: &[Surface; 2], surface: &mut Surface) {
        let label = self.segments.len() as u32 + 1;
        let width = surface.width;
        let updates: Vec<Update> = (fine_cells(segment, grid, surface).into_iter())
            .filter(|(cell, _)| self.label[*cell] == 0)
            .collect::<Vec<_>>()
            .into_par_iter()
            .filter_map(|(cell, hypothesis_m)| Update::of(cell, hypothesis_m, segment, grid, sides, surface))
            .collect();
        let mut differences = Vec::with_capacity(updates.len());
        let mut bounds_m = [f32::MAX, f32::MAX, f32::MIN, f32::MIN];
        for Update {
            cell,
            before_m,
            after_m,
        } in updates
        {
            let p = surface.point(cell % width, cell / width);
            self.label[cell] = label;
            self.before_m[cell] = before_m;
            surface.altitude[cell] = after_m;
            surface.above[cell] = after_m;
            if let Some(at) = sides[1].cell_at(p.x, p.y) {
                surface.take_facts(cell, &sides[1], at);
            }
            differences.push(after_m - before_m);
            let half_m = 0.5 * surface.cell_m;
            for (axis, at) in [p.x, p.y].into_iter().enumerate() {
                bounds_m[axis] = bounds_m[axis].min(at - half_m);
                bounds_m[axis + 2] = bounds_m[axis + 2].max(at + half_m);
            }
        }
        if differences.is_empty() {
            return;
        }
        self.segments.push(Segment {
            bounds_m,
            day: segment.day,
            difference_m: heliosplat_grid::statistics::upper_median(&mut differences).unwrap_or(segment.difference_m),
            area_m2: differences.len() as f32 * surface.cell_m * surface.cell_m,
            confidence: segment.confidence,
        });
    }
}

/// Fine cells in and next to a coarse segment, each with the altitudes before and after of the coarse cell that it lies
/// in or next to, metres.
fn fine_cells(segment: &CoarseSegment, grid: &Grid, surface: &Surface) -> BTreeMap<usize, [f32; 2]> {
    let mut found = BTreeMap::new();
    for (&cell, &altitudes_m) in segment.cells.iter().zip(&segment.altitudes_m) {
        let (col, row) = (cell % grid.width * COARSE, cell / grid.width * COARSE);
        let span = |at: usize, count: usize| at.saturating_sub(GROWN_CELLS)..(at + COARSE + GROWN_CELLS).min(count);
        for r in span(row, surface.height) {
            for c in span(col, surface.width) {
                let own = (row..row + COARSE).contains(&r) && (col..col + COARSE).contains(&c);
                let hypothesis_m = found.entry(r * surface.width + c).or_insert(altitudes_m);
                if own {
                    *hypothesis_m = altitudes_m;
                }
            }
        }
    }
    found
}

/// The two altitudes of a cell of a segment, metres.
struct Update {
    cell: usize,
    before_m: f32,
    after_m: f32,
}

impl Update {
    /// Fine altitudes from the surfaces of the two `sides` at a cell whose coarse altitudes are `hypothesis_m`; `None`
    /// where they do not differ as the segment does.
    fn of(
        cell: usize,
        hypothesis_m: [f32; 2],
        segment: &CoarseSegment,
        grid: &Grid,
        sides: &[Surface; 2],
        surface: &Surface,
    ) -> Option<Self> {
        let p = surface.point(cell % surface.width, cell / surface.width);
        let inside = segment.cells.contains(&grid.nearest(p.x, p.y));
        let [before_m, after_m] = [0, 1].map(|side: usize| {
            let coarse_m = if inside { hypothesis_m[side] } else { p.z };
            let fine_m = sides[side].altitude_at(p.x, p.y).unwrap_or(coarse_m);
            match !inside || (fine_m - coarse_m).abs() < SAME_M {
                true => fine_m,
                false => coarse_m,
            }
        });
        let difference_m = after_m - before_m;
        let least_m = match inside {
            true => LEAST_M,
            false => LEAST_M.max(LEAST_SHARE * segment.difference_m.abs()),
        };
        let alike = difference_m * segment.difference_m > 0.0 && difference_m.abs() > least_m;
        alike.then_some(Self {
            cell,
            before_m,
            after_m,
        })
    }
}

/// Agreement of the pairs with one surface and with two, for each of the days (`candidates`, in order, at least one).
fn splits(
    views: &[SweepView],
    days: &[i32],
    candidates: &[i32],
    request: &PlaneSweepRequest,
    surface: &Surface,
) -> Vec<Split> {
    let grid = request.grid();
    let search = Search::new(views, request).with_index();
    let compared = search.compared(1);
    let (views_of_level, pairs) = (&compared.views[..views.len()], &search.pairs);
    let noise = request.parameters.noise_floor / super::cost::CONTRAST_LIMIT;
    let present = on_grid(&grid, surface);
    let lifted: Vec<f32> = present.iter().map(|z| z + CHANCE_M).collect();
    let by_chance: Vec<f32> = on_surface(views_of_level, &grid, noise, &lifted, |surface| {
        let chance = surface.resample(0..grid.height);
        let mean = |pair| mean_known(&chance.distance(pair)).unwrap_or(CHANCE);
        pairs.par_iter().map(mean).collect()
    });
    let spans: Vec<[usize; 2]> = pairs.iter().map(|pair| span(pair, days, candidates)).collect();
    let mut splits: Vec<Split> = (candidates.iter())
        .map(|&day| Split {
            day,
            one: vec![f32::MIN; grid.len()],
            sides: [(); 2].map(|()| Side::unknown(grid.len())),
        })
        .collect();
    let mut consider = |altitude: &[f32]| {
        let gains = on_surface(views_of_level, &grid, noise, altitude, |surface| {
            agreement(surface, pairs, &by_chance, &spans, candidates.len())
        });
        let splits = splits.par_iter_mut().zip(gains);
        splits.for_each(|(split, [before, after, across])| {
            for cell in 0..grid.len() {
                split.one[cell] = split.one[cell].max(before[cell] + after[cell] + across[cell]);
            }
            split.sides[0].consider(&before, altitude);
            split.sides[1].consider(&after, altitude);
        });
    };
    consider(&present);
    for (day, after) in [(candidates[0], false), (candidates[candidates.len() - 1], true)] {
        let views = side(views, days, day, after);
        let request = matched_as(&views, request, MatchingParameters::of_hypothesis);
        consider(&swept_altitudes(&views, &request));
    }
    splits
}

/// Result of `look` for views on a surface of one altitude per cell, metres, with occlusion.
fn on_surface<T>(
    views: &[LevelView],
    grid: &Grid,
    noise: f32,
    altitude_m: &[f32],
    look: impl FnOnce(&OnSurface) -> T,
) -> T {
    let standing = Standing::new(grid, altitude_m, HIDDEN_M);
    let hits = |view: &LevelView| FirstHits::new(&view.camera, &standing);
    let hits: Vec<FirstHits> = views.par_iter().map(hits).collect();
    look(&OnSurface {
        views,
        hits: &hits,
        grid,
        altitude_m,
        shift_m: 0.0,
        noise,
    })
}

/// Numbers of `candidates` (ascending days) up to the day of the earlier image of a pair, and up to that of the later
/// one.
fn span(pair: &Pair, days: &[i32], candidates: &[i32]) -> [usize; 2] {
    let [a, b] = [pair.a, pair.b].map(|view| candidates.partition_point(|day| *day <= days[view]));
    [a.min(b), a.max(b)]
}

/// For each of `days` days, the agreement beyond chance of the pairs before it, from it on, and across it: mean over
/// the window, in agreeing pairs.
fn agreement(
    surface: &OnSurface,
    pairs: &[Pair],
    by_chance: &[f32],
    spans: &[[usize; 2]],
    days: usize,
) -> Vec<[Vec<f32>; 3]> {
    let grid = surface.grid;
    let blocks: Vec<Vec<[Vec<f32>; 3]>> = (0..grid.height.div_ceil(BLOCK_ROWS))
        .into_par_iter()
        .map(|block| {
            let rows = block * BLOCK_ROWS..((block + 1) * BLOCK_ROWS).min(grid.height);
            let mut sums = SumsOfDays::new(days, rows.len() * grid.width);
            let resampled = surface.resample(rows);
            for ((pair, chance), span) in pairs.iter().zip(by_chance).zip(spans) {
                // Cells hidden from one of the two have no evidence.
                let gain = |distance: f32| match distance.is_finite() {
                    true => pair.share() * (chance - distance),
                    false => 0.0,
                };
                sums.add(*span, resampled.distance(pair).into_iter().map(gain));
            }
            sums.of_days()
        })
        .collect();
    let place = |day: usize, place: usize| {
        let sum: Vec<f32> = blocks.iter().flat_map(|block| &block[day][place]).copied().collect();
        box_mean(grid, &sum, WINDOW)
    };
    (0..days).map(|day| [0, 1, 2].map(|at| place(day, at))).collect()
}

/// Sums over pairs, cell by cell, for each day: of the pairs before it, from it on, and across it. A pair lies after
/// the first `span[0]` days, across the next ones up to `span[1]`, and before the others, so that it is added twice for
/// any number of days.
struct SumsOfDays {
    cells: usize,
    /// Sums of the pairs by the first number of their spans, and by the second.
    by: [Vec<f64>; 2],
}

impl SumsOfDays {
    fn new(days: usize, cells: usize) -> Self {
        Self {
            cells,
            by: [(); 2].map(|()| vec![0.0; (days + 1) * cells]),
        }
    }

    fn add(&mut self, span: [usize; 2], values: impl Iterator<Item = f32>) {
        let [from, across] = &mut self.by;
        let from = &mut from[span[0] * self.cells..(span[0] + 1) * self.cells];
        let across = &mut across[span[1] * self.cells..(span[1] + 1) * self.cells];
        for ((from, across), value) in from.iter_mut().zip(across).zip(values) {
            *from += f64::from(value);
            *across += f64::from(value);
        }
    }

    fn of_days(mut self) -> Vec<[Vec<f32>; 3]> {
        let cells = self.cells;
        // Cumulative sums over the days.
        for sums in &mut self.by {
            for i in cells..sums.len() {
                sums[i] += sums[i - cells];
            }
        }
        let [not_from, before] = &self.by;
        let all = not_from.len() - cells;
        let day = |first: usize| {
            let sums = |sum: &dyn Fn(usize) -> f64| (0..cells).map(|cell| sum(cell) as f32).collect();
            [
                sums(&|cell| before[first + cell]),
                sums(&|cell| not_from[all + cell] - not_from[first + cell]),
                sums(&|cell| not_from[first + cell] - before[first + cell]),
            ]
        };
        (0..all).step_by(cells.max(1)).map(day).collect()
    }
}

/// Mean of the values that are known.
fn mean_known(values: &[f32]) -> Option<f32> {
    let known = values.iter().filter(|value| value.is_finite());
    let (sum, count) = known.fold((0.0f64, 0usize), |(sum, count), &value| {
        (sum + f64::from(value), count + 1)
    });
    (count > 0).then(|| (sum / count as f64) as f32)
}

/// Cells of a grid that nearly all images show.
fn shown(views: &[SweepView], grid: &Grid, surface: &Surface) -> Vec<bool> {
    let altitude = on_grid(grid, surface);
    let shows = |view: &SweepView, cell: usize| {
        let p = grid.point(
            (cell % grid.width) as isize,
            (cell / grid.width) as isize,
            altitude[cell],
        );
        pixel_of(&view.camera, p).is_some_and(|pixel| view.image.plane(0)[pixel].is_finite())
    };
    let needed = SHOWN * views.len() as f32;
    let enough = |cell: usize| views.iter().filter(|view| shows(view, cell)).count() as f32 >= needed;
    grid.cells().map(enough).collect()
}

/// Days that divide images taken on `days` (days since 1970) into two groups of at least two, ascending: each is the
/// first day of the later group. At most `MOST_DAYS`, evenly chosen.
pub fn dividing_days(days: &[i32]) -> Vec<i32> {
    let mut all = days.to_vec();
    all.sort_unstable();
    all.dedup();
    let enough = |day: &i32| {
        let before = days.iter().filter(|of| *of < day).count();
        before >= FEWEST_IMAGES && days.len() - before >= FEWEST_IMAGES
    };
    all.retain(enough);
    let count = all.len();
    match count <= MOST_DAYS {
        true => all,
        false => (0..MOST_DAYS).map(|k| all[k * (count - 1) / (MOST_DAYS - 1)]).collect(),
    }
}

/// The views before a day, or with `after` those from it on.
fn side<'a>(views: &[SweepView<'a>], days: &[i32], day: i32, after: bool) -> Vec<SweepView<'a>> {
    let sides = views.iter().zip(days).filter(|(_, of)| (**of >= day) == after);
    sides.map(|(view, _)| *view).collect()
}

/// The request with the matching parameters that `choose` gives a subset of the views.
fn matched_as(
    views: &[SweepView],
    request: &PlaneSweepRequest,
    choose: impl FnOnce(&MatchingFacts) -> MatchingParameters,
) -> PlaneSweepRequest {
    let geometries: Vec<ViewGeometry> = views.iter().map(SweepView::geometry).collect();
    let has_index = views.iter().all(|view| view.index.is_some());
    let facts = MatchingFacts::new(&geometries, &request.volume, has_index);
    PlaneSweepRequest {
        parameters: choose(&facts),
        ..*request
    }
}

/// The part of a volume that contains some segments and their surroundings.
fn around(volume: &SearchVolume, grid: &Grid, segments: &[&CoarseSegment]) -> SearchVolume {
    let cells = || segments.iter().flat_map(|segment| &segment.cells);
    let column = |cell: &usize| cell % grid.width;
    let row = |cell: &usize| cell / grid.width;
    let margin = (AROUND_M / grid.cell_m).ceil() as usize;
    let (west, east) = (
        cells().map(column).min().unwrap_or(0),
        cells().map(column).max().unwrap_or(0) + 1,
    );
    let (north, south) = (
        cells().map(row).min().unwrap_or(0),
        cells().map(row).max().unwrap_or(0) + 1,
    );
    let at = |cells: usize| cells as f32 * grid.cell_m;
    SearchVolume {
        west_m: volume.west_m + at(west.saturating_sub(margin)),
        east_m: (volume.west_m + at(east + margin)).min(volume.east_m),
        north_m: volume.north_m - at(north.saturating_sub(margin)),
        south_m: (volume.north_m - at(south + margin)).max(volume.south_m),
        ..*volume
    }
}

/// Altitudes of a surface at the centres of a grid's cells, metres.
fn on_grid(grid: &Grid, surface: &Surface) -> Vec<f32> {
    let of_cell = |cell: usize| {
        let p = grid.point((cell % grid.width) as isize, (cell / grid.width) as isize, 0.0);
        let (x, y) = (p.x, p.y);
        let within = |at: f32, low: f32, cells: usize| at.clamp(low, low + (cells as f32 - 0.5) * surface.cell_m);
        let x = within(x, surface.west_m, surface.width);
        let y = -within(-y, -surface.north_m, surface.height);
        surface.altitude_at(x, y).unwrap_or(surface.altitude[0])
    };
    grid.cells().map(of_cell).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn level(side: usize, altitude_m: f32) -> Surface {
        let cells = side * side;
        Surface {
            width: side,
            height: side,
            north_m: side as f32,
            cell_m: 1.0,
            altitude: vec![altitude_m; cells],
            above: vec![altitude_m; cells],
            confidence: vec![1.0; cells],
            deviation_m: vec![0.1; cells],
            probability: vec![1.0; cells],
            matched: vec![true; cells],
            views: vec![2; cells],
            base_to_height: vec![0.5; cells],
            filled: vec![false; cells],
            resolution_m: 0.5,
            ..Surface::default()
        }
    }

    fn house(cells: impl IntoIterator<Item = usize>) -> CoarseSegment {
        let cells: BTreeSet<usize> = cells.into_iter().collect();
        CoarseSegment {
            day: 5,
            altitudes_m: vec![[0.0, 6.0]; cells.len()],
            cells,
            difference_m: 6.0,
            confidence: 0.9,
        }
    }

    /// Changes of a surface of `side` cells each way before any segment, its sides six metres apart, and the coarse
    /// grid.
    fn unchanged(side: usize) -> (Changes, Surface, [Surface; 2], Grid) {
        let surface = level(side, 0.0);
        let grid = Grid {
            north_m: side as f32,
            cell_m: COARSE as f32,
            ..Grid::plain(side / COARSE, side / COARSE)
        };
        let changes = Changes {
            label: vec![0; surface.altitude.len()],
            before_m: surface.altitude.clone(),
            ..Changes::default()
        };
        (changes, surface, [level(side, 0.0), level(side, 6.0)], grid)
    }

    #[test]
    fn more_segments_than_sixteen_bits_hold_keep_their_own_ground() {
        let (mut changes, mut surface, sides, grid) = unchanged(16);
        let other = Segment {
            day: 1,
            difference_m: 3.0,
            area_m2: 1.0,
            bounds_m: [0.0; 4],
            confidence: 0.5,
        };
        changes.segments = vec![other; usize::from(u16::MAX)];
        changes.refine(&house([9]), &grid, &sides, &mut surface);
        assert_eq!(changes.at(2 * 16 + 2).map(|segment| segment.day), Some(5));
    }

    #[test]
    fn a_place_where_images_of_two_states_disagree_is_known_by_those_of_the_new_one() {
        let (mut changes, mut surface, sides, grid) = unchanged(16);
        surface.matched = vec![false; surface.altitude.len()];
        changes.refine(&house([9]), &grid, &sides, &mut surface);
        let known: Vec<bool> = (0..surface.altitude.len()).map(|cell| surface.is_known(cell)).collect();
        let changed: Vec<bool> = changes.label.iter().map(|label| *label > 0).collect();
        assert!(changed[2 * 16 + 2]);
        assert_eq!(known, changed);
    }

    #[test]
    fn segments_of_a_large_surface_take_the_cells_beside_them_once() {
        const SIDE: usize = 1024;
        let (mut changes, mut surface, sides, grid) = unchanged(SIDE);
        // Houses of two coarse cells, four coarse cells from one to the next, so that each may grow by its two fine
        // cells.
        let places: Vec<usize> = (0..100 * 100)
            .map(|i| (i / 100 * 5 + 2) * grid.width + i % 100 * 5 + 2)
            .collect();
        for &place in &places {
            changes.refine(&house([place, place + 1]), &grid, &sides, &mut surface);
        }
        assert_eq!(changes.segments.len(), places.len());
        let grown = (2 * COARSE + 2 * GROWN_CELLS) * (COARSE + 2 * GROWN_CELLS);
        assert!(changes.segments.iter().all(|segment| segment.area_m2 == grown as f32));
        assert_eq!(
            changes.label.iter().filter(|label| **label > 0).count(),
            grown * places.len()
        );
        changes.refine(&house([places[0]]), &grid, &sides, &mut surface);
        assert_eq!(changes.segments.len(), places.len(), "the ground is taken");
    }

    #[test]
    fn images_are_divided_only_where_each_side_has_two() {
        assert!(dividing_days(&[5, 5, 5]).is_empty(), "one day");
        assert!(
            dividing_days(&[1, 7, 9]).is_empty(),
            "a side with one image has no surface"
        );
        assert_eq!(dividing_days(&[7, 1, 1, 7]), [7]);
        assert_eq!(dividing_days(&[1, 2, 3, 4, 5]), [3, 4]);
        let many: Vec<i32> = (0..40).collect();
        let days = dividing_days(&many);
        assert_eq!((days.len(), days[0], days[MOST_DAYS - 1]), (MOST_DAYS, 2, 38));
    }

    #[test]
    fn each_pair_counts_before_from_or_across_every_day() {
        let days = [3, 9, 4, 4, 12, 7, 20, 1];
        let candidates = [4, 7, 9, 12];
        let views = || 0..days.len();
        let pairs: Vec<(usize, usize)> = views().flat_map(|a| (0..a).map(move |b| (a, b))).collect();
        let value = |k: usize, cell: usize| ((k * 31 + cell * 17) % 23) as f32 - 11.0;
        let mut sums = SumsOfDays::new(candidates.len(), 3);
        for (k, &(a, b)) in pairs.iter().enumerate() {
            let pair = Pair {
                a,
                b,
                weight: 1,
                same_date: false,
                base_to_height: 0.5,
            };
            sums.add(span(&pair, &days, &candidates), (0..3).map(|cell| value(k, cell)));
        }
        let sums = sums.of_days();
        assert_eq!(sums.len(), candidates.len());
        for (sums, day) in sums.iter().zip(candidates) {
            let mut slow = [[0.0; 3]; 3];
            for (k, &(a, b)) in pairs.iter().enumerate() {
                let place = match (days[a] >= day, days[b] >= day) {
                    (false, false) => 0,
                    (true, true) => 1,
                    _ => 2,
                };
                (0..3).for_each(|cell| slow[place][cell] += value(k, cell));
            }
            assert_eq!(
                sums.each_ref().map(|sum| sum.as_slice()),
                slow.each_ref().map(|sum| sum.as_slice()),
                "{day}"
            );
        }
    }
}
