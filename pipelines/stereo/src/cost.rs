//! The matching cost of each cell at each height: the disagreement of the views.
//!
//! All views are sampled on a plane at the altitude of a hypothesis; pairs of them are compared by the census transform
//! of brightness (and of the index), views of one date by brightness itself. Each comparison is truncated, so that a
//! hidden or changed view costs no more than no match; the no-match cost keeps heights visible in few views from
//! winning by chance. The weighted mean is then averaged over the aggregation window.
//!
//! Cells are processed in blocks that fit the cache, blocks in parallel; integer sums keep the result independent of
//! threads.

mod block;
mod no_match;

use super::census::{self, COMPARISONS, Descriptors, INVALID, RADIUS};
use super::heights::HeightHypotheses;
use super::level::{LevelView, PixelPlane};
use super::pairs::Pair;
use super::parameters::MatchingParameters;
use super::ranges::SearchRanges;
use super::sampling::{Line, Places};
use super::visibility::FirstHits;
use block::{BLOCK, Block, Scratch, WideBlock};
use heliosplat_grid::Grid;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Census distances are truncated at this share of the comparisons: beyond it there is no match.
const TRUNCATION: f32 = 0.36;
/// Difference of brightness within a date at which its cost is truncated, in median differences between neighbours
/// (docs/lab/plane-sweep.md).
const VALUE_TRUNCATION: f32 = 4.0;

/// Contrast limit of the census, in median differences between the neighbours around: larger differences are across the
/// edge of a shadow or of another surface (docs/lab/plane-sweep.md).
pub(super) const CONTRAST_LIMIT: f32 = 8.0;

/// Input of the matching cost on one level.
pub(super) struct MatchingCost<'a> {
    /// Cells of the level.
    pub(super) grid: Grid,
    /// Height hypotheses of the level.
    pub(super) heights: HeightHypotheses,
    /// Views at the resolution of the level.
    pub(super) views: &'a [LevelView],
    /// Pairs of `views` to compare.
    pub(super) pairs: &'a [Pair],
    /// Matching parameters of the request.
    pub(super) parameters: &'a MatchingParameters,
    /// Weight of a comparison of index planes relative to one of brightness; `None` where they are not compared.
    pub(super) index_weight: Option<f32>,
    /// First surface points of each view; `None` before a surface is known.
    pub(super) hits: Option<&'a [FirstHits]>,
}

impl MatchingCost<'_> {
    /// Matching costs of all levels of all cells, 0 (all agree) to 255, in the order of `ranges`.
    pub(super) fn costs(&self, ranges: &SearchRanges) -> Vec<u8> {
        let mut costs = vec![0; ranges.total()];
        let no_match = self.no_match_weights();
        let room = || Scratch::new(self.views.len(), self.parameters.aggregation_radius);
        self.blocks(ranges, &mut costs)
            .into_par_iter()
            .for_each_init(room, |scratch, (block, rows)| {
                self.fill_block(&block, ranges, &no_match, scratch, rows);
            });
        costs
    }

    /// All blocks, each with the part of `costs` that belongs to each of its rows.
    fn blocks<'c>(&self, ranges: &SearchRanges, costs: &'c mut [u8]) -> Vec<(Block, Vec<&'c mut [u8]>)> {
        let Grid { width, height, .. } = self.grid;
        let mut all = Vec::new();
        let mut rest = costs;
        for row0 in (0..height).step_by(BLOCK.0) {
            let row1 = (row0 + BLOCK.0).min(height);
            let first = all.len();
            for col0 in (0..width).step_by(BLOCK.1) {
                let col1 = (col0 + BLOCK.1).min(width);
                all.push((Block { row0, row1, col0, col1 }, Vec::with_capacity(BLOCK.0)));
            }
            for row in row0..row1 {
                for (block, rows) in &mut all[first..] {
                    let values = ranges.start[row * width + block.col1] - ranges.start[row * width + block.col0];
                    let (own, tail) = rest.split_at_mut(values);
                    rows.push(own);
                    rest = tail;
                }
            }
        }
        all
    }

    fn fill_block(
        &self,
        block: &Block,
        ranges: &SearchRanges,
        no_match: &[u32],
        scratch: &mut Scratch,
        mut rows: Vec<&mut [u8]>,
    ) {
        let radius = self.parameters.aggregation_radius;
        let width = self.grid.width;
        for (level, part) in self.parts(block, ranges) {
            let altitude_m = self.heights.altitude(level as f32);
            self.block_costs(&part.wider(radius), altitude_m, no_match, scratch);
            scratch.average(&part, radius);
            part.cells(&self.grid, |k, cell| {
                let low = usize::from(ranges.low[cell]);
                if level >= low && level < low + ranges.count(cell) {
                    let row = cell / width;
                    let start = ranges.start[cell] - ranges.start[row * width + block.col0];
                    rows[row - block.row0][start + level - low] = scratch.cost[k];
                }
            });
        }
    }

    /// The levels searched by some cell of a block, each with the smallest part of the block that contains those cells.
    /// Levels between ground and roofs, which no cell searches, cost no time.
    fn parts(&self, block: &Block, ranges: &SearchRanges) -> impl Iterator<Item = (usize, Block)> {
        let mut parts: BTreeMap<usize, Block> = BTreeMap::new();
        for row in block.row0..block.row1 {
            for col in block.col0..block.col1 {
                let cell = row * self.grid.width + col;
                let low = usize::from(ranges.low[cell]);
                for level in low..low + ranges.count(cell) {
                    let this = Block::of_cell(row, col);
                    parts.entry(level).and_modify(|part| part.grow(&this)).or_insert(this);
                }
            }
        }
        parts.into_iter()
    }

    /// Costs of a block at one altitude, into `scratch.cost`.
    fn block_costs(&self, block: &WideBlock, altitude_m: f32, no_match: &[u32], scratch: &mut Scratch) {
        let cells = block.width * block.height;
        scratch.sum[..cells].fill(0);
        scratch.weights[..cells].fill(0);
        for (index, view) in self.views.iter().enumerate() {
            self.describe_view(index, view, block, altitude_m, scratch);
        }
        let cut = (TRUNCATION * COMPARISONS as f32) as u32;
        let Scratch {
            descriptors,
            index_descriptors,
            sum,
            weights,
            cost,
            ..
        } = scratch;
        let (sum, weights) = (&mut sum[..cells], &mut weights[..cells]);
        self.compare(descriptors, 1.0, cut, sum, weights);
        if let Some(share) = self.parameters.same_date_weight {
            self.compare_values(descriptors, share, cut, sum, weights);
        }
        if let Some(share) = self.index_weight {
            self.compare(index_descriptors, share, cut, sum, weights);
        }
        let rows = cost[..cells].chunks_mut(block.width);
        let compared = sum.chunks(block.width).zip(weights.chunks(block.width));
        for (row, (costs, (sums, weights))) in rows.zip(compared).enumerate() {
            for (col, (cost, (sum, weights))) in costs.iter_mut().zip(sums.iter().zip(weights)).enumerate() {
                let no_match = no_match[block.nearest(col, row, &self.grid)];
                *cost = (255 * (*sum + no_match * cut) / ((*weights + no_match) * cut)) as u8;
            }
        }
    }

    /// Descriptors of a view's planes on a block at one altitude.
    fn describe_view(
        &self,
        number: usize,
        view: &LevelView,
        block: &WideBlock,
        altitude_m: f32,
        scratch: &mut Scratch,
    ) {
        let WideBlock { width, height, .. } = *block;
        let (columns, rows) = (width + 2 * RADIUS, height + 2 * RADIUS);
        self.find_block(view, block, altitude_m, &mut scratch.places);
        let (places, values) = (&scratch.places, &mut scratch.values[..]);
        let descriptors = &mut scratch.descriptors[number];
        view.sample_places(&view.mean, places, columns * rows, values);
        let limits = &mut scratch.limits[..width * height];
        contrast_limits(&view.mean, places, block, limits);
        let noise = self.parameters.noise_floor / CONTRAST_LIMIT;
        census::describe(values, width, height, limits, noise, descriptors);
        if self.parameters.same_date_weight.is_some() {
            census::store_values(values, width, height, view.mean.middle, view.mean.contrast, descriptors);
        }
        if let Some(hits) = self.hits {
            drop_hidden(
                &hits[number],
                places,
                block,
                altitude_m,
                &mut descriptors.darker[..width * height],
            );
        }
        if let Some(index) = view.index.as_ref().filter(|_| self.index_weight.is_some()) {
            let of_index = &mut scratch.index_descriptors[number];
            view.sample_places(index, places, columns * rows, values);
            contrast_limits(index, places, block, limits);
            census::describe(values, width, height, limits, noise, of_index);
            for (of_index, of_mean) in of_index.darker.iter_mut().zip(&descriptors.darker[..width * height]) {
                *of_index |= of_mean & INVALID;
            }
        }
    }

    /// Adds the comparisons of one plane's descriptors, each with `share` of its pair's weight.
    fn compare(&self, descriptors: &[Descriptors], share: f32, cut: u32, sum: &mut [u32], weights: &mut [u32]) {
        for pair in self.pairs {
            let weight = pair.weight_of(share);
            census::compare(&descriptors[pair.a], &descriptors[pair.b], weight, cut, sum, weights);
        }
    }

    /// Adds the differences of brightness of the views of one date, each with `share` of its pair's weight.
    fn compare_values(&self, descriptors: &[Descriptors], share: f32, cut: u32, sum: &mut [u32], weights: &mut [u32]) {
        for pair in self.pairs.iter().filter(|pair| pair.same_date) {
            let (a, b) = (&descriptors[pair.a], &descriptors[pair.b]);
            census::compare_values(a, b, pair.weight_of(share), VALUE_TRUNCATION, cut, sum, weights);
        }
    }

    /// The weight of all comparisons between two views.
    fn total_weight(&self, pair: &Pair) -> u32 {
        let values = self.parameters.same_date_weight.filter(|_| pair.same_date);
        let others = [values, self.index_weight].into_iter().flatten();
        pair.weight + others.map(|share| pair.weight_of(share)).sum::<u32>()
    }

    /// Projects a block and its margin, at one altitude, into a view.
    fn find_block(&self, view: &LevelView, block: &WideBlock, altitude_m: f32, places: &mut Places) {
        let columns = block.width + 2 * RADIUS;
        let camera = &view.camera;
        let step = self.grid.cell_m;
        let (du, dv, dw) = (camera.u.x * step, camera.v.x * step, camera.w.x * step);
        let (col0, row0) = (block.col0 - RADIUS as isize, block.row0 - RADIUS as isize);
        for row in 0..block.height + 2 * RADIUS {
            let p = self.grid.point(col0, row0 + row as isize, altitude_m);
            let (u, v) = (camera.u.dot(p) + camera.u0, camera.v.dot(p) + camera.v0);
            let w = 1.0 + camera.w.dot(p);
            let line = Line {
                start: [u, v, w],
                step: [du, dv, dw],
            };
            view.find_line(&line, row * columns, columns, places);
        }
    }
}

/// The largest differences that the census compares at the cells of a block: multiples of the contrast around each
/// cell.
fn contrast_limits(plane: &PixelPlane, places: &Places, block: &WideBlock, limits: &mut [f32]) {
    let columns = block.width + 2 * RADIUS;
    for (row, limits) in limits.chunks_mut(block.width).enumerate() {
        let start = (row + RADIUS) * columns + RADIUS;
        for (pixel, limit) in places.nearest[start..start + block.width].iter().zip(limits) {
            *limit = CONTRAST_LIMIT * plane.local_contrast[*pixel as usize];
        }
    }
}

/// Marks the cells of a block that a view does not see as invalid.
fn drop_hidden(hits: &FirstHits, places: &Places, block: &WideBlock, altitude_m: f32, darker: &mut [u32]) {
    let columns = block.width + 2 * RADIUS;
    for (row, darker) in darker.chunks_mut(block.width).enumerate() {
        let start = (row + RADIUS) * columns + RADIUS;
        for (pixel, word) in places.nearest[start..start + block.width].iter().zip(darker) {
            // A place beyond the image is invalid already.
            if hits.hides(*pixel as usize, altitude_m) {
                *word |= INVALID;
            }
        }
    }
}
