//! How badly the views agree on each cell at each altitude.

use super::bands::Bands;
use super::census::{self, COMPARISONS, INVALID, RADIUS, Words};
use super::grid::{Grid, Ladder};
use super::pairs::Pair;
use super::views::{LevelView, Line, Place};
use super::visibility::FirstHits;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Cells of a block: rows × columns small enough for the cache, large enough that the window's margin stays cheap.
const BLOCK: (usize, usize) = (16, 64);
/// Distances beyond this share of the comparisons say only "no match": a hidden or changed view is no worse than that.
const CUT: f32 = 0.36;
/// Differences of brightness within a date, in typical differences between neighbours, beyond which they say only "no match".
const VALUE_REACH: f32 = 4.0;
/// What a comparison of indices is worth beside one of brightness.
const INDEX_WORTH: f32 = 0.5;

/// What the search compares, and where.
pub(super) struct Matching<'a> {
    pub(super) grid: Grid,
    pub(super) ladder: Ladder,
    pub(super) views: &'a [LevelView],
    pub(super) pairs: &'a [Pair],
    pub(super) compared: [f32; 2],
    /// Weight, as a share of all pairs, of the assumption that nothing matches.
    pub(super) doubt: f32,
    /// Whether the brightness itself of views of one date is compared.
    pub(super) same_date_values: bool,
    /// Costs are averaged over windows of this radius, cells: where the base is short, a wider look tells altitudes apart.
    pub(super) radius: usize,
    /// What each view sees first, where a surface is known already.
    pub(super) hits: Option<&'a [FirstHits]>,
}

impl Matching<'_> {
    /// Costs 0 (all agree) to 255 of all levels of all cells, in the order of `bands`.
    pub(super) fn costs(&self, bands: &Bands) -> Vec<u8> {
        let mut costs = vec![0; bands.total()];
        let mut strips = Vec::new();
        let mut rest = costs.as_mut_slice();
        for row0 in (0..self.grid.height).step_by(BLOCK.0) {
            let row1 = (row0 + BLOCK.0).min(self.grid.height);
            let values = bands.start[row1 * self.grid.width] - bands.start[row0 * self.grid.width];
            let (strip, tail) = rest.split_at_mut(values);
            strips.push((row0, row1, strip));
            rest = tail;
        }
        strips.into_par_iter().for_each(|(row0, row1, strip)| {
            let mut scratch = Scratch::new(self.views.len(), self.radius);
            for col0 in (0..self.grid.width).step_by(BLOCK.1) {
                let col1 = (col0 + BLOCK.1).min(self.grid.width);
                let block = Block { row0, row1, col0, col1 };
                self.fill_block(&block, bands, &mut scratch, strip);
            }
        });
        costs
    }

    fn fill_block(&self, block: &Block, bands: &Bands, scratch: &mut Scratch, strip: &mut [u8]) {
        let strip_start = bands.start[block.row0 * self.grid.width];
        for (level, part) in self.parts(block, bands) {
            self.block_costs(&part.wider(self.radius), self.ladder.altitude(level as f32), scratch);
            scratch.average(&part, self.radius);
            part.cells(&self.grid, |k, cell| {
                let low = usize::from(bands.low[cell]);
                if level >= low && level < low + bands.count(cell) {
                    strip[bands.start[cell] - strip_start + level - low] = scratch.cost[k];
                }
            });
        }
    }

    /// The levels that some cell of a block considers, each with the least part of the block that holds those cells: between the
    /// ground and the roofs there is often none, and then nothing need be compared.
    fn parts(&self, block: &Block, bands: &Bands) -> impl Iterator<Item = (usize, Block)> {
        let mut parts: BTreeMap<usize, Block> = BTreeMap::new();
        for row in block.row0..block.row1 {
            for col in block.col0..block.col1 {
                let cell = row * self.grid.width + col;
                let low = usize::from(bands.low[cell]);
                for level in low..low + bands.count(cell) {
                    let this = Block::of_cell(row, col);
                    parts.entry(level).and_modify(|part| part.grow(&this)).or_insert(this);
                }
            }
        }
        parts.into_iter()
    }

    /// Costs of a block at one altitude, into `scratch.cost`.
    fn block_costs(&self, block: &WideBlock, altitude_m: f32, scratch: &mut Scratch) {
        let cells = block.width * block.height;
        scratch.sum[..cells].fill(0);
        scratch.weights[..cells].fill(0);
        for (index, view) in self.views.iter().enumerate() {
            self.describe_view(index, view, block, altitude_m, scratch);
        }
        let cut = (CUT * COMPARISONS as f32) as u32;
        let Scratch {
            words,
            index_words,
            sum,
            weights,
            cost,
            ..
        } = scratch;
        let (sum, weights) = (&mut sum[..cells], &mut weights[..cells]);
        let mut full = self.compare(words, 1.0, cut, sum, weights);
        if self.same_date_values {
            full += self.compare_values(words, cut, sum, weights);
        }
        if self.with_index() {
            full += self.compare(index_words, INDEX_WORTH, cut, sum, weights);
        }
        let doubt = ((full as f32 * self.doubt) as u32).max(1);
        for (cost, (sum, weights)) in cost.iter_mut().zip(sum.iter().zip(weights)) {
            *cost = (255 * (*sum + doubt * cut) / ((*weights + doubt) * cut)) as u8;
        }
    }

    /// What differences are compared in a plane whose neighbours differ by `contrast` in the median.
    fn range(&self, contrast: f32) -> [f32; 2] {
        self.compared.map(|differences| differences * contrast)
    }

    /// Whether the views' indices are compared too.
    fn with_index(&self) -> bool {
        self.views.iter().all(|view| view.index.is_some())
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
        self.find_block(view, block, altitude_m, &mut scratch.places[..columns * rows]);
        let (places, values) = (&scratch.places[..columns * rows], &mut scratch.values[..columns * rows]);
        let words = &mut scratch.words[number];
        view.sample_places(&view.mean, places, values);
        census::describe(values, width, height, self.range(view.mean.contrast), words);
        if self.same_date_values {
            census::keep(values, width, height, view.mean.middle, view.mean.contrast, words);
        }
        if let Some(hits) = self.hits {
            drop_hidden(
                &hits[number],
                places,
                block,
                altitude_m,
                &mut words.darker[..width * height],
            );
        }
        if let Some(index) = view.index.as_ref().filter(|_| self.with_index()) {
            let index_words = &mut scratch.index_words[number];
            view.sample_places(index, places, values);
            census::describe(values, width, height, self.range(index.contrast), index_words);
            for (of_index, of_mean) in index_words.darker.iter_mut().zip(&words.darker[..width * height]) {
                *of_index |= of_mean & INVALID;
            }
        }
    }

    /// Adds the comparisons of one plane's descriptors, each worth `worth` of its pair's weight; returns the weight of them all.
    fn compare(&self, words: &[Words], worth: f32, cut: u32, sum: &mut [u32], weights: &mut [u32]) -> u32 {
        let mut full = 0;
        for pair in self.pairs {
            let weight = ((pair.weight as f32 * worth) as u32).max(1);
            census::compare(&words[pair.a], &words[pair.b], weight, cut, sum, weights);
            full += weight;
        }
        full
    }

    /// Adds the differences of brightness of the views of one date; returns the weight of them all.
    fn compare_values(&self, words: &[Words], cut: u32, sum: &mut [u32], weights: &mut [u32]) -> u32 {
        let mut full = 0;
        for pair in self.pairs.iter().filter(|pair| pair.same) {
            let (a, b) = (&words[pair.a], &words[pair.b]);
            census::differ(a, b, pair.weight, VALUE_REACH, cut, sum, weights);
            full += pair.weight;
        }
        full
    }

    /// Where a view shows a block and its margin at one altitude.
    fn find_block(&self, view: &LevelView, block: &WideBlock, altitude_m: f32, places: &mut [Place]) {
        let columns = block.width + 2 * RADIUS;
        let camera = &view.camera;
        let step = self.grid.cell_m;
        let (du, dv, dw) = (camera.u.x * step, camera.v.x * step, camera.w.x * step);
        let (col0, row0) = (block.col0 - RADIUS as isize, block.row0 - RADIUS as isize);
        for (row, places) in places.chunks_mut(columns).enumerate() {
            let p = self.grid.point(col0, row0 + row as isize, altitude_m);
            let (u, v) = (camera.u.dot(p) + camera.u0, camera.v.dot(p) + camera.v0);
            let w = 1.0 + camera.w.dot(p);
            let line = Line {
                start: [u, v, w],
                step: [du, dv, dw],
            };
            view.find_line(&line, places);
        }
    }
}

/// Leaves out the cells of a block that a view does not see.
fn drop_hidden(hits: &FirstHits, places: &[Place], block: &WideBlock, altitude_m: f32, words: &mut [u32]) {
    let columns = block.width + 2 * RADIUS;
    for (row, words) in words.chunks_mut(block.width).enumerate() {
        let start = (row + RADIUS) * columns + RADIUS;
        for (place, word) in places[start..start + block.width].iter().zip(words) {
            // A place beyond the image is invalid already.
            if hits.hides(place.nearest(hits.width()), altitude_m) {
                *word |= INVALID;
            }
        }
    }
}

/// A rectangle of cells.
struct Block {
    row0: usize,
    row1: usize,
    col0: usize,
    col1: usize,
}

impl Block {
    fn of_cell(row: usize, col: usize) -> Self {
        Self {
            row0: row,
            row1: row + 1,
            col0: col,
            col1: col + 1,
        }
    }

    /// Becomes the least block that holds another too.
    fn grow(&mut self, other: &Self) {
        self.row0 = self.row0.min(other.row0);
        self.row1 = self.row1.max(other.row1);
        self.col0 = self.col0.min(other.col0);
        self.col1 = self.col1.max(other.col1);
    }

    /// Calls with the index inside the block and the index on the grid of each cell.
    fn cells(&self, grid: &Grid, mut each: impl FnMut(usize, usize)) {
        let mut k = 0;
        for row in self.row0..self.row1 {
            for col in self.col0..self.col1 {
                each(k, row * grid.width + col);
                k += 1;
            }
        }
    }
}

/// A block with a margin, which may reach beyond the grid.
struct WideBlock {
    row0: isize,
    col0: isize,
    width: usize,
    height: usize,
}

impl Block {
    fn wider(&self, margin: usize) -> WideBlock {
        WideBlock {
            row0: self.row0 as isize - margin as isize,
            col0: self.col0 as isize - margin as isize,
            width: self.col1 - self.col0 + 2 * margin,
            height: self.row1 - self.row0 + 2 * margin,
        }
    }
}

struct Scratch {
    values: Vec<f32>,
    places: Vec<Place>,
    words: Vec<Words>,
    index_words: Vec<Words>,
    sum: Vec<u32>,
    weights: Vec<u32>,
    cost: Vec<u8>,
    across: Vec<u32>,
}

impl Scratch {
    fn new(views: usize, radius: usize) -> Self {
        let cells = (BLOCK.0 + 2 * radius) * (BLOCK.1 + 2 * radius);
        let margin = 2 * (RADIUS + radius);
        Self {
            values: vec![0.0; (BLOCK.0 + margin) * (BLOCK.1 + margin)],
            places: vec![Place::default(); (BLOCK.0 + margin) * (BLOCK.1 + margin)],
            across: vec![0; cells],
            words: vec![Words::new(cells); views],
            index_words: vec![Words::new(cells); views],
            sum: vec![0; cells],
            weights: vec![0; cells],
            cost: vec![0; cells],
        }
    }

    /// Means over windows of the costs of a block with its margin; those of the block itself come first then.
    fn average(&mut self, block: &Block, radius: usize) {
        if radius == 0 {
            return;
        }
        let (width, height) = (block.col1 - block.col0, block.row1 - block.row0);
        let (stride, side) = (width + 2 * radius, 2 * radius + 1);
        for row in 0..height + 2 * radius {
            for col in 0..width {
                let window = &self.cost[row * stride + col..row * stride + col + side];
                self.across[row * width + col] = window.iter().map(|&c| u32::from(c)).sum();
            }
        }
        for row in 0..height {
            for col in 0..width {
                let sum: u32 = (row..row + side).map(|r| self.across[r * width + col]).sum();
                self.cost[row * width + col] = (sum / (side * side) as u32) as u8;
            }
        }
    }
}
