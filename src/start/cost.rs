//! How badly the views agree on each cell at each altitude.

use super::bands::Bands;
use super::census::{self, COMPARISONS, INVALID};
const RADIUS: usize = 5;
use super::grid::{Grid, Ladder};
use super::pairs::Pair;
use super::views::LevelView;
use super::visibility::FirstHits;
use rayon::prelude::*;

/// Cells of a block: rows × columns small enough for the cache, large enough that the window's margin stays cheap.
const BLOCK: (usize, usize) = (16, 64);
/// Distances beyond this share of the comparisons say only "no match": a hidden or changed view is no worse than that.
static ENV: std::sync::OnceLock<std::collections::HashMap<String, f32>> = std::sync::OnceLock::new();
pub(super) fn env(k: &str, d: f32) -> f32 { ENV.get_or_init(|| std::env::vars().filter_map(|(k, v)| Some((k, v.parse().ok()?))).collect()).get(k).copied().unwrap_or(d) }
use multiversion::multiversion;
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2"))]
fn accumulate(s: f32, sig: f32, m: &[f32], o: &[f32], w: &mut [f32], sw: &mut [f32]) {
    for (((m, o), w), sw) in m.iter().zip(o).zip(w).zip(sw) { let d = (m - o) * sig; let q = 1.0 / (1.0 + d * d); let q = q * q; *w = s * q * q; *sw += *w; }
}
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2"))]
fn acc_view(w: &[f32], a: &[f32], s1: &mut [f32], s2: &mut [f32]) {
    for (((w, a), s1), s2) in w.iter().zip(a).zip(s1).zip(s2) { let t = w * a; *s1 += t; *s2 += t * a; }
}
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512bw+avx512dq", "x86_64+avx2"))]
fn acc_pair(w: &[f32], a: &[f32], b: &[f32], s: &mut [f32]) {
    for (((w, a), b), s) in w.iter().zip(a).zip(b).zip(s) { *s += w * a * b; }
}
/// Weight, as a share of all pairs, of the assumption that nothing matches: altitudes that few views see must not win
/// by chance.


/// What the search compares, and where.
pub(super) struct Matching<'a> {
    pub(super) grid: Grid,
    pub(super) ladder: Ladder,
    pub(super) views: &'a [LevelView],
    pub(super) pairs: &'a [Pair],
    pub(super) alike: f32,
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
            let mut scratch = Scratch::new(self.views.len());
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
        let (mut first, mut last) = (usize::MAX, 0);
        block.cells(&self.grid, |_, cell| {
            first = first.min(usize::from(bands.low[cell]));
            last = last.max(usize::from(bands.low[cell]) + bands.count(cell));
        });
        for level in first..last {
            self.block_costs(block, self.ladder.altitude(level as f32), scratch);
            block.cells(&self.grid, |k, cell| {
                let low = usize::from(bands.low[cell]);
                if level >= low && level < low + bands.count(cell) {
                    strip[bands.start[cell] - strip_start + level - low] = scratch.cost[k];
                }
            });
        }
    }

    /// Costs of a block at one altitude, into `scratch.cost`.
    fn block_costs(&self, block: &Block, altitude_m: f32, scratch: &mut Scratch) {
        let (width, height) = (block.col1 - block.col0, block.row1 - block.row0);
        let cells = width * height;
        for (view, index) in self.views.iter().zip(0..) {
            self.sample_block(view, block, altitude_m, &mut scratch.values);
            let words = &mut scratch.words[index][..cells];
            {
                let st = width + 2 * RADIUS; let m = RADIUS - census::RADIUS; let cw = width + 2 * census::RADIUS; let ch = height + 2 * census::RADIUS;
                for r in 0..ch { for c in 0..cw { scratch.small[r * cw + c] = scratch.values[(r + m) * st + c + m]; } }
            }
            census::describe(&scratch.small, width, height, self.alike * view.contrast, words);
            scratch.raw[index].clear(); scratch.raw[index].extend_from_slice(&scratch.values[..(width + 2 * RADIUS) * (height + 2 * RADIUS)]);
            let st = width + 2 * RADIUS;
            let base = view.middle;
            let ic = 1.0 / view.contrast;
            for v in scratch.raw[index].iter_mut() { *v = (*v - base) * ic; }
            if let Some(hits) = self.hits {
                self.drop_hidden(index, &hits[index], block, altitude_m, &mut scratch.words[index][..cells]);
            }
        }
        if (if self.hits.is_some() { env("NCC2", 0.0) } else { env("NCC", 0.0) }) > 0.0 { self.wncc(width, height, scratch); }
        let (sum, weights) = (&mut scratch.sum[..cells], &mut scratch.weights[..cells]);
        sum.fill(0);
        weights.fill(0);
        let cut = (env("CUT",0.36) * COMPARISONS as f32) as u32;
        let mut full = 0;
        for pair in self.pairs {
            let (a, b) = (&scratch.words[pair.a][..cells], &scratch.words[pair.b][..cells]);
            census::compare(a, b, pair.weight, cut, sum, weights);
            full += pair.weight;
        }
        let lam = (if self.hits.is_some() { env("NCC2", 0.0) } else { env("NCC", 0.0) });
        let fdoubt = full as f32 * env("DOUBT", 0.08);
        let doubt = ((full as f32 * env("DOUBT",0.08)) as u32).max(1);
        for (k, ((cost, sum), weights)) in scratch.cost.iter_mut().zip(sum).zip(weights).enumerate() {
            let c = (255 * (*sum + doubt * cut) / ((*weights + doubt) * cut)) as f32;
            let c2 = 255.0 * (scratch.nsum[k] + fdoubt) / (scratch.nw[k] + fdoubt);
            *cost = ((1.0 - lam) * c + lam * c2) as u8;
            scratch.nsum[k] = 0.0; scratch.nw[k] = 0.0;
        }
    }

    fn wncc(&self, width: usize, height: usize, scratch: &mut Scratch) {
        let st = width + 2 * RADIUS; let len = st * (height + 2 * RADIUS); let cells = width * height;
        let nv = self.views.len(); let np = self.pairs.len();
        let nr = if self.hits.is_some() { env("NCCR2", 3.0) } else { env("NCCR", 3.0) } as isize; let sig = 1.0 / if self.hits.is_some() { env("SIG2", 1e6) } else { env("SIG", 1e6) }; let spat = env("SPAT", 1e6); let floor = env("NCCF", 0.1).powi(2); let cc = 1.0 / env("NCCC", 1.0);
        let mut m = vec![0.0f32; len]; let mut n = vec![0.0f32; len];
        for v in &scratch.raw { for k in 0..len { if v[k] == v[k] { m[k] += v[k]; n[k] += 1.0; } } }
        for k in 0..len { m[k] /= n[k].max(1.0); }
        // clean NaN
        for v in scratch.raw.iter_mut() { for x in v.iter_mut() { if *x != *x { *x = 0.0; } } }
        let _ = cells;
        let mut s1 = vec![0.0f32; nv * width]; let mut s2 = vec![0.0f32; nv * width]; let mut sp = vec![0.0f32; np * width]; let mut sw = vec![0.0f32; width]; let mut w = vec![0.0f32; width];
        for r in 0..height {
            s1.fill(0.0); s2.fill(0.0); sp.fill(0.0); sw.fill(0.0);
            let c0 = (r + RADIUS) * st + RADIUS;
            for dr in -nr..=nr { for dc in -nr..=nr {
                let o = (c0 as isize + dr * st as isize + dc) as usize;
                let sw0 = (-((dr * dr + dc * dc) as f32) / (2.0 * spat * spat)).exp();
                accumulate(sw0, sig, &m[c0..c0 + width], &m[o..o + width], &mut w, &mut sw);
                for v in 0..nv { acc_view(&w, &scratch.raw[v][o..o + width], &mut s1[v * width..(v + 1) * width], &mut s2[v * width..(v + 1) * width]); }
                for (k, p) in self.pairs.iter().enumerate() { acc_pair(&w, &scratch.raw[p.a][o..o + width], &scratch.raw[p.b][o..o + width], &mut sp[k * width..(k + 1) * width]); }
            } }
            for v in 0..nv { for c in 0..width { let i = 1.0 / sw[c]; let mm = s1[v * width + c] * i; let var = (s2[v * width + c] * i - mm * mm).max(0.0) + floor; s1[v * width + c] = mm; s2[v * width + c] = 1.0 / var.sqrt(); } }
            for (k, p) in self.pairs.iter().enumerate() { for c in 0..width {
                let cell = r * width + c;
                let rho = (sp[k * width + c] / sw[c] - s1[p.a * width + c] * s1[p.b * width + c]) * s2[p.a * width + c] * s2[p.b * width + c];
                let ok = (scratch.words[p.a][cell] | scratch.words[p.b][cell]) & INVALID == 0;
                let mut x = ((1.0 - rho) * cc).min(1.0);
                let ad = env("AD", 0.0);
                if ad > 0.0 && p.same { 
                    let ar = env("ADR", 1.0) as isize; let mut t = 0.0; let mut nn = 0.0;
                    for dr in -ar..=ar { for dc in -ar..=ar { let o = ((c0 + c) as isize + dr * st as isize + dc) as usize; t += ((scratch.raw[p.a][o] - scratch.raw[p.b][o]).abs() / env("ADT", 6.0)).min(1.0); nn += 1.0; } }
                    x = (1.0 - ad) * x + ad * t / nn;
                }
                if ok { scratch.nsum[cell] += p.weight as f32 * x; scratch.nw[cell] += p.weight as f32; }
            } }
        }
    }

    /// Values of a view on the block and its margin at one altitude.
    fn sample_block(&self, view: &LevelView, block: &Block, altitude_m: f32, out: &mut [f32]) {
        let columns = block.col1 - block.col0 + 2 * RADIUS;
        let rows = block.row1 - block.row0 + 2 * RADIUS;
        let camera = &view.camera;
        let step = self.grid.cell_m;
        let (du, dv, dw) = (camera.u.x * step, camera.v.x * step, camera.w.x * step);
        let (col0, row0) = (block.col0 as isize - RADIUS as isize, block.row0 as isize - RADIUS as isize);
        for row in 0..rows {
            let p = self.grid.point(col0, row0 + row as isize, altitude_m);
            let (u, v) = (camera.u.dot(p) + camera.u0, camera.v.dot(p) + camera.v0);
            let w = 1.0 + camera.w.dot(p);
            for (k, value) in out[row * columns..(row + 1) * columns].iter_mut().enumerate() {
                let k = k as f32;
                let inverse = 1.0 / (w + k * dw);
                *value = view.sample((u + k * du) * inverse, (v + k * dv) * inverse);
            }
        }
    }

    fn drop_hidden(&self, index: usize, hits: &FirstHits, block: &Block, altitude_m: f32, words: &mut [u64]) {
        let camera = &self.views[index].camera;
        for (k, word) in words.iter_mut().enumerate() {
            let width = block.col1 - block.col0;
            let (col, row) = ((block.col0 + k % width) as isize, (block.row0 + k / width) as isize);
            let (image_col, image_row, _) = camera.project(self.grid.point(col, row, altitude_m));
            if hits.hides(image_col, image_row, altitude_m) {
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

struct Scratch {
    values: Vec<f32>, small: Vec<f32>, raw: Vec<Vec<f32>>, nsum: Vec<f32>, nw: Vec<f32>,
    words: Vec<Vec<u64>>,
    sum: Vec<u32>,
    weights: Vec<u32>,
    cost: Vec<u8>,
}

impl Scratch {
    fn new(views: usize) -> Self {
        let cells = BLOCK.0 * BLOCK.1;
        Self {
            values: vec![0.0; (BLOCK.0 + 2 * RADIUS) * (BLOCK.1 + 2 * RADIUS)],
            small: vec![0.0; (BLOCK.0 + 2 * RADIUS) * (BLOCK.1 + 2 * RADIUS)], raw: vec![vec![]; views], nsum: vec![0.0; cells], nw: vec![0.0; cells],
            words: vec![vec![0; cells]; views],
            sum: vec![0; cells],
            weights: vec![0; cells],
            cost: vec![0; cells],
        }
    }
}
