//! Registration of one altitude raster to another: the shift of largest normalised cross-correlation (NCC).
//!
//! Over a pyramid of halved rasters (means that ignore missing cells, until the shorter side is 100 cells or less) the
//! integer shift with the largest NCC is searched within ±5 cells of twice the shift of the level above; then the mean
//! height difference over the overlap is removed. Sat-NeRF and EOGS are evaluated this way.

use heliosplat::Raster;
use heliosplat_grid::statistics::correlation;
use heliosplat_raster::{Crs, GeoTransform};
use rayon::prelude::*;

/// Shift of a prediction: its value at a cell is taken from `(col - columns, row - rows)` and `height_m` is added.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Shift {
    /// Shift to the right, cells.
    pub columns: f64,
    /// Shift downwards, cells.
    pub rows: f64,
    /// Shift upwards, metres.
    pub height_m: f64,
}

/// Search range per pyramid level, cells.
const RANGE: i64 = 5;
/// The pyramid stops when its shorter side is this long, cells.
const SMALLEST_SIDE: usize = 100;
/// Least overlap for a shift, as a share of the truth's known cells.
const LEAST_OVERLAP: f64 = 0.25;

impl Shift {
    /// Shift to the east, north and up, metres, on a grid of `size` columns and rows.
    pub fn metres(&self, transform: &GeoTransform, size: (usize, usize), crs: Option<&Crs>) -> [f64; 3] {
        let metres = transform.metres_per_unit(size, crs);
        let [east, north] = [0, 1]
            .map(|axis| (self.columns * transform.per_col[axis] + self.rows * transform.per_row[axis]) * metres[axis]);
        [east, north, self.height_m]
    }
}

/// A raster (first band) moved by columns to the right and rows down: missing where it comes from outside or from
/// missing cells.
pub fn moved(raster: &Raster, columns: f64, rows: f64) -> Raster {
    let mut out = Raster::filled(raster.width, raster.height, 1, f32::NAN);
    let lines = out.values.par_chunks_mut(raster.width).enumerate();
    lines.for_each(|(row, line)| {
        for (col, value) in line.iter_mut().enumerate() {
            *value = super::resample::bilinear(raster, col as f64 - columns, row as f64 - rows);
        }
    });
    out
}

/// Integer shift of largest correlation, with the mean height difference after it. Both rasters are altitudes on one
/// grid.
pub fn integer(truth: &Raster, prediction: &Raster) -> Shift {
    let (columns, rows) = integer_cells(truth, prediction);
    let (columns, rows) = (columns as f64, rows as f64);
    with_height(truth, &moved(prediction, columns, rows), columns, rows)
}

/// Shift of largest correlation to 1/32 of a cell, with the mean height difference after it: the integer shift, refined
/// to the peak of the NCC on successively finer steps. `prediction` gives the prediction moved by columns and rows.
pub fn subpixel(truth: &Raster, prediction: &(impl Fn(f64, f64) -> Raster + Sync)) -> Shift {
    let (columns, rows) = integer_cells(truth, &prediction(0.0, 0.0));
    let (mut best, mut step) = ((columns as f64, rows as f64), 0.5);
    while step >= 1.0 / 32.0 {
        let steps = [-step, 0.0, step];
        let beside = |dr: f64| steps.map(|dc| (best.0 + dc, best.1 + dr));
        let around: Vec<(f64, f64)> = steps.into_iter().flat_map(beside).collect();
        let score = |(columns, rows)| overlapping(truth, &prediction(columns, rows), 0, 0);
        best = best_of(&around, score).unwrap_or(best);
        step /= 2.0;
    }
    with_height(truth, &prediction(best.0, best.1), best.0, best.1)
}

/// A shift whose prediction has been moved already, completed by the remaining mean height difference.
fn with_height(truth: &Raster, moved: &Raster, columns: f64, rows: f64) -> Shift {
    let pairs = truth.plane(0).iter().zip(moved.plane(0));
    let differences = pairs.map(|(want, got)| f64::from(want - got));
    let known = differences.filter(|difference| difference.is_finite());
    let (sum, count) = known.fold((0.0, 0usize), |(sum, count), difference| (sum + difference, count + 1));
    let height_m = if count > 0 { sum / count as f64 } else { 0.0 };
    Shift {
        columns,
        rows,
        height_m,
    }
}

fn integer_cells(truth: &Raster, prediction: &Raster) -> (i64, i64) {
    let (columns, rows) = match truth.width.min(truth.height) > SMALLEST_SIDE {
        true => integer_cells(&truth.downscaled(2), &prediction.downscaled(2)),
        false => (0, 0),
    };
    search(truth, prediction, (2 * columns, 2 * rows))
}

fn search(truth: &Raster, prediction: &Raster, around: (i64, i64)) -> (i64, i64) {
    let beside = |dr: i64| (-RANGE..=RANGE).map(move |dc| (around.0 + dc, around.1 + dr));
    let candidates: Vec<(i64, i64)> = (-RANGE..=RANGE).flat_map(beside).collect();
    let score = |(columns, rows)| overlapping(truth, prediction, columns, rows);
    best_of(&candidates, score).unwrap_or(around)
}

/// The candidate of highest score; the first of equals, so that the result does not depend on threads.
fn best_of<T: Copy + Send + Sync>(candidates: &[T], score: impl Fn(T) -> Option<f64> + Sync) -> Option<T> {
    let scores: Vec<Option<f64>> = candidates.par_iter().map(|&candidate| score(candidate)).collect();
    let mut best: Option<(f64, T)> = None;
    for (score, &candidate) in scores.into_iter().zip(candidates) {
        if let Some(score) = score
            && best.is_none_or(|(highest, _)| score > highest)
        {
            best = Some((score, candidate));
        }
    }
    best.map(|(_, candidate)| candidate)
}

/// NCC of the truth and the prediction moved by whole cells, over the cells known in both; `None` when they are too few
/// or one of the two is flat.
fn overlapping(truth: &Raster, prediction: &Raster, columns: i64, rows: i64) -> Option<f64> {
    let (width, height) = (truth.width as i64, truth.height as i64);
    let pairs = || {
        (rows.max(0)..(height + rows).min(height)).flat_map(move |row| {
            (columns.max(0)..(width + columns).min(width)).filter_map(move |col| {
                let want = truth.values[(row * width + col) as usize];
                let got = prediction.values[((row - rows) * width + col - columns) as usize];
                (want.is_finite() && got.is_finite()).then_some((f64::from(want), f64::from(got)))
            })
        })
    };
    let known = truth.plane(0).iter().filter(|value| value.is_finite()).count();
    if (pairs().count() as f64) < LEAST_OVERLAP * known as f64 {
        return None;
    }
    correlation(pairs())
}
