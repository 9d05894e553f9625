//! Patches of views on a tangent plane, and the search for one in another by normalised cross-correlation.

use super::{HALF, REACH};
use heliosplat_grid::parabola_top;

/// Half a region, cells: half a patch and twice the farthest shift, for the search and the search back.
const EXTENT: isize = HALF + 2 * REACH;
const SIDE: usize = 2 * EXTENT as usize + 1;
/// Number of cells of a patch.
pub(super) const CELLS: usize = ((2 * HALF + 1) * (2 * HALF + 1)) as usize;
/// Least correlation at whole cells for a match to be refined.
const LEAST_SCORE: f32 = 0.6;
/// Share of the best correlation that another peak may reach: beyond it the match is ambiguous.
const MOST_RIVAL: f32 = 0.95;
/// Shifts this close to the best belong to its own peak, cells.
const SAME_PEAK: isize = 2;
/// Largest offset of the search back, cells.
const CLOSURE: isize = 1;
/// Standard deviation below which a patch has no texture, as a share of its mean.
pub(super) const LEAST_SPREAD: f32 = 5e-3;

/// Samples of a view around a point of a tangent plane, `[row][column]`; NaN where missing.
pub(super) struct Region {
    values: Vec<f32>,
}

/// A patch with zero mean and unit length.
pub(super) struct Template {
    /// Values, `[row][column]`.
    pub(super) values: [f32; CELLS],
}

/// Match of a patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Match {
    /// Shift, cells: columns east, rows south.
    pub(super) shift: [f32; 2],
    /// Normalised cross-correlation, -1 to 1.
    pub(super) score: f32,
}

impl Region {
    /// Samples a view at whole cells around the point; `sample` takes columns east and rows south of it.
    pub(super) fn new(sample: impl Fn(isize, isize) -> f32) -> Self {
        let mut values = Vec::with_capacity(SIDE * SIDE);
        for row in -EXTENT..=EXTENT {
            for col in -EXTENT..=EXTENT {
                values.push(sample(col, row));
            }
        }
        Self { values }
    }

    /// Value `col` cells east and `row` cells south of the point.
    pub(super) fn at(&self, col: isize, row: isize) -> f32 {
        self.values[((row + EXTENT) * SIDE as isize + col + EXTENT) as usize]
    }

    fn line(&self, col: isize, row: isize) -> &[f32] {
        let start = ((row + EXTENT) * SIDE as isize + col - HALF + EXTENT) as usize;
        &self.values[start..start + 2 * HALF as usize + 1]
    }

    /// The patch around a cell; `None` where values are missing or have no texture.
    pub(super) fn template(&self, col: isize, row: isize) -> Option<Template> {
        let mut values = [0.0; CELLS];
        for (r, line) in (-HALF..=HALF).zip(values.chunks_exact_mut(2 * HALF as usize + 1)) {
            line.copy_from_slice(self.line(col, row + r));
        }
        normalise(&mut values).then_some(Template { values })
    }

    /// Correlation of a template with the patch around a cell; NaN where values are missing.
    fn correlation(&self, template: &Template, col: isize, row: isize) -> f32 {
        let (mut product, mut sum, mut squares) = (0.0f32, 0.0f32, 0.0f32);
        let centre = self.at(col, row);
        for (r, line) in (-HALF..=HALF).zip(template.values.chunks_exact(2 * HALF as usize + 1)) {
            for (a, b) in line.iter().zip(self.line(col, row + r)) {
                // From the centre's value, so that squares do not drown in f32.
                let b = b - centre;
                product += a * b;
                sum += b;
                squares += b * b;
            }
        }
        let spread = squares - sum * sum / CELLS as f32;
        // The template's mean is zero, so the mean of the other patch does not count.
        if spread > 0.0 {
            product / spread.sqrt()
        } else {
            f32::NAN
        }
    }

    /// The best shift around a cell, whole cells, with all correlations around it.
    fn best(&self, template: &Template, col: isize, row: isize) -> Option<Peak> {
        let mut peak = Peak::default();
        let mut best = f32::NEG_INFINITY;
        for (dr, line) in (-REACH..=REACH).zip(&mut peak.scores) {
            for (dc, score) in (-REACH..=REACH).zip(line) {
                *score = self.correlation(template, col + dc, row + dr);
                if *score > best {
                    best = *score;
                    (peak.col, peak.row) = (dc, dr);
                }
            }
        }
        (best > LEAST_SCORE).then_some(peak)
    }
}

const SHIFTS: usize = 2 * REACH as usize + 1;

/// The correlations of a search and the position of the best.
#[derive(Default)]
struct Peak {
    scores: [[f32; SHIFTS]; SHIFTS],
    col: isize,
    row: isize,
}

impl Peak {
    fn score(&self, col: isize, row: isize) -> f32 {
        self.scores[(row + REACH) as usize][(col + REACH) as usize]
    }

    /// Inside the searched shifts, and no other place nearly as good.
    fn is_distinct(&self) -> bool {
        let best = self.score(self.col, self.row);
        let rival = (-REACH..=REACH).any(|row| {
            (-REACH..=REACH).any(|col| {
                let apart = (row - self.row).abs().max((col - self.col).abs()) > SAME_PEAK;
                apart && self.score(col, row) > MOST_RIVAL * best
            })
        });
        self.col.abs() < REACH && self.row.abs() < REACH && !rival
    }

    /// The top of the parabolas through the best and its neighbours.
    fn top(&self) -> [f32; 2] {
        let (c, r) = (self.col, self.row);
        let here = self.score(c, r);
        let offset = |scores| parabola_top(scores).unwrap_or(0.0);
        [
            c as f32 + offset([self.score(c - 1, r), here, self.score(c + 1, r)]),
            r as f32 + offset([self.score(c, r - 1), here, self.score(c, r + 1)]),
        ]
    }
}

/// Match of the reference's patch in a region; `None` unless it is distinct and the search back from it ends within
/// `CLOSURE` cells of the point.
pub(super) fn find(reference: &Region, template: &Template, region: &Region) -> Option<Match> {
    let peak = region.best(template, 0, 0)?;
    if !peak.is_distinct() {
        return None;
    }
    let seen = region.template(peak.col, peak.row)?;
    let back = reference.best(&seen, 0, 0)?;
    let closed = back.col.abs() <= CLOSURE && back.row.abs() <= CLOSURE;
    closed.then(|| Match {
        shift: peak.top(),
        score: peak.score(peak.col, peak.row),
    })
}

/// Scales `values` to zero mean and unit length; `false` where values are missing or have no texture (a spread of at
/// most `LEAST_SPREAD` of the mean).
pub(super) fn normalise(values: &mut [f32]) -> bool {
    let count = values.len() as f32;
    let mean = values.iter().sum::<f32>() / count;
    values.iter_mut().for_each(|v| *v -= mean);
    let length = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    values.iter_mut().for_each(|v| *v /= length);
    length > LEAST_SPREAD * mean.abs() * count.sqrt()
}
