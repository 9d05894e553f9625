//! A match refined below the cell: least squares on the shift, brightness and contrast left free.

use super::HALF;
use super::patch::{CELLS, Match, Region, Template, normalise};
use glam::{DMat2, DVec2};

const MAX_ROUNDS: usize = 8;
/// A step below this ends the refinement, cells.
const LAST_STEP: f64 = 5e-3;
/// A refined shift may not leave the cell it started from.
const FARTHEST: f64 = 1.0;

/// Gauss-Newton on the shift of the sampled patch against the template. Both are normalised, so the slopes that count are those
/// perpendicular to the template itself: what brightness and contrast could do as well tells nothing of the shift.
pub(super) fn refine(
    reference: &Region,
    template: &Template,
    start: Match,
    sample: &dyn Fn(f32, f32) -> f32,
) -> Option<Match> {
    let slopes = Slopes::of(reference, template)?;
    let first = DVec2::new(start.shift[0].into(), start.shift[1].into());
    let mut shift = first;
    for _ in 0..MAX_ROUNDS {
        let patch = sampled(shift, sample)?;
        let step = slopes.step(template, &patch);
        shift += step;
        if (shift - first).length() > FARTHEST || !shift.is_finite() {
            return None;
        }
        if step.length() < LAST_STEP {
            break;
        }
    }
    let patch = sampled(shift, sample)?;
    let score = template.values.iter().zip(&patch).map(|(a, b)| a * b).sum();
    Some(Match {
        shift: [shift.x as f32, shift.y as f32],
        score,
    })
}

fn sampled(shift: DVec2, sample: &dyn Fn(f32, f32) -> f32) -> Option<[f32; CELLS]> {
    let mut patch = [0.0; CELLS];
    for (row, line) in (-HALF..=HALF).zip(patch.chunks_exact_mut(2 * HALF as usize + 1)) {
        for (col, value) in (-HALF..=HALF).zip(line) {
            *value = sample(col as f32 + shift.x as f32, row as f32 + shift.y as f32);
        }
    }
    normalise(&mut patch).then_some(patch)
}

/// How the template changes with columns and rows, and the inverse of their products.
struct Slopes {
    cols: [f32; CELLS],
    rows: [f32; CELLS],
    inverse: DMat2,
}

impl Slopes {
    fn of(reference: &Region, template: &Template) -> Option<Self> {
        let (mut cols, mut rows) = ([0.0; CELLS], [0.0; CELLS]);
        let cells = (-HALF..=HALF).flat_map(|row| (-HALF..=HALF).map(move |col| (col, row)));
        for ((col, row), (by_col, by_row)) in cells.zip(cols.iter_mut().zip(&mut rows)) {
            *by_col = 0.5 * (reference.at(col + 1, row) - reference.at(col - 1, row));
            *by_row = 0.5 * (reference.at(col, row + 1) - reference.at(col, row - 1));
        }
        // In the template's unit: the length that its values were divided by.
        let length = length_of(reference);
        for slopes in [&mut cols, &mut rows] {
            slopes.iter_mut().for_each(|s| *s /= length);
            let mean = slopes.iter().sum::<f32>() / CELLS as f32;
            let along: f32 = slopes.iter().zip(&template.values).map(|(s, t)| s * t).sum();
            for (slope, value) in slopes.iter_mut().zip(&template.values) {
                *slope -= mean + along * value;
            }
        }
        let dot = |a: &[f32; CELLS], b: &[f32; CELLS]| -> f64 { a.iter().zip(b).map(|(x, y)| f64::from(x * y)).sum() };
        let normal = DMat2::from_cols_array(&[
            dot(&cols, &cols),
            dot(&cols, &rows),
            dot(&cols, &rows),
            dot(&rows, &rows),
        ]);
        let inverse = normal.inverse();
        inverse.is_finite().then_some(Self { cols, rows, inverse })
    }

    /// The step of the shift that brings the patch nearer to the template.
    fn step(&self, template: &Template, patch: &[f32; CELLS]) -> DVec2 {
        let mut right = DVec2::ZERO;
        for i in 0..CELLS {
            let off = f64::from(template.values[i] - patch[i]);
            right += DVec2::new(f64::from(self.cols[i]), f64::from(self.rows[i])) * off;
        }
        self.inverse * right
    }
}

/// Length of the patch around the point before it was normalised.
fn length_of(reference: &Region) -> f32 {
    let cells = || (-HALF..=HALF).flat_map(|row| (-HALF..=HALF).map(move |col| reference.at(col, row)));
    let mean = cells().sum::<f32>() / CELLS as f32;
    cells().map(|value| (value - mean).powi(2)).sum::<f32>().sqrt()
}
