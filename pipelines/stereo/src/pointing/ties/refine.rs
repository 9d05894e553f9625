//! A match refined below the cell: least squares on the shift, brightness and contrast left free.

use super::HALF;
use super::patch::{CELLS, Match, Region, Template, normalise};
use glam::{DMat2, DVec2};

/// Most rounds of Gauss-Newton.
const MAX_ROUNDS: usize = 8;
/// A step below this ends the refinement, cells.
const LAST_STEP: f64 = 5e-3;
/// A refined shift may not leave the cell it started from.
const FARTHEST: f64 = 1.0;

/// Match refined by Gauss-Newton on the shift of the sampled patch against the template; `sample` takes columns east
/// and rows south of the point, cells. `None` where values are missing or have no texture, or the shift moves by more
/// than `FARTHEST`. Patch and template are normalised, so the slopes are projected perpendicular to the template:
/// changes of brightness and contrast carry no information about the shift.
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

/// Derivatives of the template along columns and rows, and the inverse of their products.
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

#[cfg(test)]
mod tests {
    use super::super::patch::find;
    use super::*;

    fn texture(col: f32, row: f32) -> f32 {
        5.0 + (0.7 * col).sin() + (0.5 * row + 0.2 * col).cos() + (0.31 * col - 0.43 * row).sin()
    }

    #[test]
    fn a_shift_is_found_to_hundredths_whatever_brightness_and_contrast() {
        for [by_col, by_row] in [[0.0, 0.0], [2.3, -1.6], [-3.2, 0.5]] {
            let moved = |col: f32, row: f32| 2.0 + 3.0 * texture(col - by_col, row - by_row);
            let reference = Region::new(|col, row| texture(col as f32, row as f32));
            let region = Region::new(|col, row| moved(col as f32, row as f32));
            let template = reference.template(0, 0).expect("a texture");
            let coarse = find(&reference, &template, &region).expect("a match");
            let Match { shift, score } = refine(&reference, &template, coarse, &moved).expect("a finer match");
            let off = (shift[0] - by_col).hypot(shift[1] - by_row);
            assert!(off < 0.01 && score > 0.999, "{shift:?} for {by_col} {by_row}, {score}");
        }
    }

    #[test]
    fn stripes_and_plain_patches_match_nowhere() {
        let stripes = Region::new(|col, _| (0.9 * col as f32).sin());
        let template = stripes.template(0, 0).expect("a texture");
        assert!(find(&stripes, &template, &stripes).is_none());
        assert!(Region::new(|_, _| 0.4).template(0, 0).is_none());
    }
}
