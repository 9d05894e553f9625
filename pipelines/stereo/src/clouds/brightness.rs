//! Excess brightness of each view over the sunlit ground in the other views.
//!
//! Haze and exposure differ between images, so each is first brought to the scale of the median of all by a robust
//! line.

use super::super::level::LevelView;
use super::super::ortho;
use super::super::pyramid::Search;
use super::super::views::SweepView;
use super::super::visibility::{FirstHits, Standing};
use super::{FACTOR, FEWEST_VIEWS};
use heliosplat_grid::Grid;
use heliosplat_grid::statistics::upper_median;
use rayon::prelude::*;

/// The estimate of the sunlit ground allows for one clouded view in so many others.
const VIEWS_PER_CLOUD: usize = 8;
/// Standard deviations beyond which a value has no weight in the robust line (Beaton and Tukey 1974: 95 % efficient for
/// normal errors).
const BIWEIGHT: f64 = 4.7;
/// Standard deviation of normal errors in units of their median absolute deviation.
const DEVIATION_OF_MEDIAN: f64 = 1.48;
/// Rounds of the robust line.
const ROUNDS: usize = 8;
/// Least scale of the residuals, in units of the view's median: keeps weights finite where all values lie on the line.
const LEAST_SCALE: f64 = 1e-6;
/// Range to which gains of the line are clamped: beyond it the fit has followed a few extreme values.
const GAINS: [f64; 2] = [0.2, 5.0];
/// Variance below which values do not determine a gain, in units of the view's median, squared.
const LEAST_VARIANCE: f64 = 1e-9;
/// Least distance below the first hit at which a point is hidden, metres.
const HIDDEN_M: f32 = 1.0;

/// Excess brightness over the sunlit ground, `[view][cell]`, relative to the mean of that ground and the view's median,
/// in the band where it is least; NaN where the cell is hidden from the view or visible in too few others. Points more
/// than `tolerance_m` below the first surface point of a view are hidden.
pub(super) fn excess(
    views: &[SweepView],
    search: &Search,
    grid: &Grid,
    altitude: &[f32],
    tolerance_m: f32,
) -> Vec<Vec<f32>> {
    let bands = views.iter().map(|view| view.image.bands).min().unwrap_or(0);
    let standing = Standing::new(grid, altitude, tolerance_m.max(HIDDEN_M));
    let hits: Vec<FirstHits> = search
        .level_views(FACTOR)
        .iter()
        .map(|level| FirstHits::new(&level.camera, &standing))
        .collect();
    let mut least = vec![vec![f32::INFINITY; grid.len()]; views.len()];
    for band in 0..bands {
        let orthos: Vec<Vec<f32>> = views
            .iter()
            .zip(&hits)
            .map(|(view, hits)| ortho_of_band(view, band, search, grid, altitude, hits))
            .collect();
        let scaled = on_one_scale(&orthos);
        let in_the_sun: Vec<InTheSun> = (0..grid.len())
            .into_par_iter()
            .with_min_len(256)
            .map_init(Vec::new, |known, cell| {
                known.clear();
                known.extend(scaled.iter().map(|view| view[cell]).filter(|v| v.is_finite()));
                InTheSun::of(known)
            })
            .collect();
        least.par_iter_mut().zip(&scaled).for_each(|(least, scaled)| {
            for (least, (&value, sun)) in least.iter_mut().zip(scaled.iter().zip(&in_the_sun)) {
                let sun = sun.relative_to(value);
                let above = 2.0 * (value - sun) / (1.0 + sun.max(0.0));
                // A value missing in one band stays missing.
                *least = if least.is_nan() || *least < above {
                    *least
                } else {
                    above
                };
            }
        });
    }
    least
}

/// The brightness of the sunlit ground at a cell, for each view that sees it: the brightest of the other views after
/// those that may be clouded.
struct InTheSun {
    /// The value of that rank among the other views where the view itself is brighter, NaN where the cell is visible in
    /// too few.
    for_brighter: f32,
    /// Brightness if the view itself is one of the darker ones.
    for_darker: f32,
}

impl InTheSun {
    /// Sunlit brightness from the values of all views that see the cell, which are sorted.
    fn of(known: &mut [f32]) -> Self {
        let others = known.len().saturating_sub(1);
        if others + 2 < FEWEST_VIEWS {
            return Self {
                for_brighter: f32::NAN,
                for_darker: f32::NAN,
            };
        }
        known.sort_unstable_by(f32::total_cmp);
        let at = others - 2 - others / VIEWS_PER_CLOUD;
        Self {
            for_brighter: known[at],
            for_darker: known[at + 1],
        }
    }

    /// The sunlit value to compare with a view that shows `value`.
    fn relative_to(&self, value: f32) -> f32 {
        if value > self.for_brighter {
            self.for_brighter
        } else {
            self.for_darker
        }
    }
}

/// One band of a view on the surface, NaN where the cell is hidden or outside of the image.
fn ortho_of_band(
    view: &SweepView,
    band: usize,
    search: &Search,
    grid: &Grid,
    altitude: &[f32],
    hits: &FirstHits,
) -> Vec<f32> {
    let plane = view.image.band(band);
    let of_band = SweepView { image: &plane, ..*view };
    let level = LevelView::new(&of_band, grid.cell_m, search.centre, false);
    let mut values = ortho::ortho(grid, &level, altitude);
    values.par_iter_mut().enumerate().for_each(|(cell, value)| {
        let p = grid.point(
            (cell % grid.width) as isize,
            (cell / grid.width) as isize,
            altitude[cell],
        );
        let (col, row, _) = level.camera.project(p);
        // Outside of the image the value is NaN already.
        if value.is_finite() && hits.hides(row.round() as usize * level.width + col.round() as usize, p.z) {
            *value = f32::NAN;
        }
    });
    values
}

/// The views' values on the scale of their common median: gain and offset of haze and exposure are removed.
fn on_one_scale(orthos: &[Vec<f32>]) -> Vec<Vec<f32>> {
    let relative: Vec<Vec<f32>> = orthos
        .par_iter()
        .map(|values| {
            let mut known: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
            let unit = upper_median(&mut known).filter(|&m| m > 0.0).unwrap_or(1.0);
            values.iter().map(|v| v / unit).collect()
        })
        .collect();
    let cells = orthos.first().map_or(0, Vec::len);
    let common: Vec<f32> = (0..cells)
        .into_par_iter()
        .map(|cell| {
            let mut known: Vec<f32> = relative.iter().map(|v| v[cell]).filter(|v| v.is_finite()).collect();
            upper_median(&mut known).unwrap_or(f32::NAN)
        })
        .collect();
    relative
        .into_par_iter()
        .map(|values| {
            let (gain, offset) = line(&common, &values);
            values.iter().map(|v| (v - offset) / gain).collect()
        })
        .collect()
}

/// Gain and offset of the line `to = gain · from + offset` by iteratively reweighted least squares with Tukey's
/// biweight.
fn line(from: &[f32], to: &[f32]) -> (f32, f32) {
    let pairs: Vec<(f64, f64)> = from
        .iter()
        .zip(to)
        .filter(|(x, y)| x.is_finite() && y.is_finite())
        .map(|(&x, &y)| (f64::from(x), f64::from(y)))
        .collect();
    let (mut gain, mut offset) = (1.0, 0.0);
    for _ in 0..ROUNDS {
        let mut off: Vec<f32> = pairs
            .iter()
            .map(|(x, y)| (y - gain * x - offset).abs() as f32)
            .collect();
        let Some(scale) =
            upper_median(&mut off).map(|m| BIWEIGHT * DEVIATION_OF_MEDIAN * f64::from(m).max(LEAST_SCALE))
        else {
            break;
        };
        let [mut n, mut sx, mut sy, mut sxx, mut sxy] = [0.0; 5];
        for (x, y) in &pairs {
            let t = (y - gain * x - offset) / scale;
            let w = (1.0 - t * t).max(0.0).powi(2);
            n += w;
            sx += w * x;
            sy += w * y;
            sxx += w * x * x;
            sxy += w * x * y;
        }
        let spread = n * sxx - sx * sx;
        if spread <= LEAST_VARIANCE * n * n {
            break;
        }
        gain = ((n * sxy - sx * sy) / spread).clamp(GAINS[0], GAINS[1]);
        offset = (sy - gain * sx) / n;
    }
    (gain as f32, offset as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_through_most_values_leaves_out_what_lies_far_off() {
        let from: Vec<f32> = (0..200).map(|i| i as f32 / 100.0).collect();
        let to: Vec<f32> = (0..200)
            .map(|i| if i % 5 == 0 { 9.0 } else { 1.3 * from[i] + 0.2 })
            .collect();
        let (gain, offset) = line(&from, &to);
        assert!(
            (gain - 1.3).abs() < 1e-3 && (offset - 0.2).abs() < 1e-3,
            "{gain} {offset}"
        );
    }

    #[test]
    fn the_ground_in_the_sun_beside_a_view_is_that_of_the_other_views_alone() {
        let values = [0.7f32, 0.2, 0.9, 0.9, 0.3, 0.5, 0.1, 0.9, 0.4, 0.8, 0.2, 0.6];
        for count in FEWEST_VIEWS - 1..values.len() {
            let found = InTheSun::of(&mut values[..count].to_vec());
            for view in 0..count {
                let mut others: Vec<f32> = (0..count)
                    .filter(|&other| other != view)
                    .map(|other| values[other])
                    .collect();
                others.sort_by(f32::total_cmp);
                let clouded = 1 + others.len() / VIEWS_PER_CLOUD;
                assert_eq!(
                    found.relative_to(values[view]),
                    others[others.len() - 1 - clouded],
                    "{view} of {count}"
                );
            }
        }
        let few = InTheSun::of(&mut [0.5; FEWEST_VIEWS - 2]);
        assert!(few.relative_to(0.5).is_nan());
    }
}
