//! Pointing bias between the images: one shift per image, estimated by orthorectifying all images on a common surface.
//!
//! Raw vendor cameras disagree by up to several pixels. Across the epipolar lines that spoils every match; along them
//! it is a change of altitude. Both are estimated from coarse to fine: sweep, orthorectify the views, correlate each
//! pair of them, distribute the pairwise offsets over the views, repeat.

use crate::ortho;
use crate::pairs::Pair;
use crate::pyramid::Search;
use crate::request::PlaneSweepRequest;
use crate::views::SweepView;
use glam::{DMat2, DVec2, DVec3, Vec3};
use heliosplat::ProjectiveCamera;
use heliosplat_grid::{Grid, parabola_top};
use heliosplat_rpc::adjust::smallest_shifts;
use nalgebra::{Matrix2x3, Vector2};
use rayon::prelude::*;

/// Searched offsets, cells of the level each way.
const REACH: isize = 3;
/// Rounds on each level: the second starts from a surface that the first has sharpened.
const ROUNDS: usize = 2;
/// Radius of the window in which values are made zero mean and unit spread, cells.
const WINDOW: usize = 4;
/// Cells of the request per cell on which [`coarse_shifts`] stops.
const COARSE_FACTOR: usize = 4;

/// Shift of each view (columns, rows; pixels) under which the views agree to a pixel or two, a start for
/// [`super::ties`]: `camera.shifted(shift[0], shift[1])` is the corrected camera.
///
/// The images do not determine a common translation of the scene in three dimensions, so the result is the smallest of
/// all equivalent sets of shifts. With two views only the shift across their epipolar lines remains.
pub fn coarse_shifts(views: &[SweepView], request: &PlaneSweepRequest) -> Vec<[f32; 2]> {
    let mut moved = views.to_vec();
    let mut shifts = vec![DVec2::ZERO; views.len()];
    for factor in Search::new(views, request).factors(COARSE_FACTOR) {
        for _ in 0..ROUNDS {
            for (view, (original, shift)) in moved.iter_mut().zip(views.iter().zip(&shifts)) {
                view.camera = original.camera.shifted(shift.x as f32, shift.y as f32);
            }
            let Some(steps) = residual_shifts(&Search::new(&moved, request), factor) else {
                return vec![[0.0; 2]; views.len()];
            };
            for (shift, step) in shifts.iter_mut().zip(steps) {
                *shift += step;
            }
            remove_translation(views, request.centre, &mut shifts);
        }
    }
    shifts.iter().map(|shift| [shift.x as f32, shift.y as f32]).collect()
}

/// The shifts still missing at one level, pixels.
fn residual_shifts(search: &Search, factor: usize) -> Option<Vec<DVec2>> {
    let found = search.descend(factor, &|_| {})?;
    let altitude = ortho::median(&found.grid, &found.altitude(), 2);
    let views = search.level_views(factor);
    let normalised: Vec<_> = views
        .iter()
        .map(|view| normalise(&found.grid, &ortho::ortho(&found.grid, view, &altitude)))
        .collect();
    let offsets: Vec<_> = search
        .pairs
        .par_iter()
        .filter_map(|pair| {
            let offset = offset(&found.grid, &normalised[pair.a], &normalised[pair.b])?;
            Some((*pair, offset))
        })
        .collect();
    let ground = spread_over_views(search.views.len(), &offsets);
    let cell_m = f64::from(found.grid.cell_m);
    Some(
        search
            .views
            .iter()
            .zip(ground)
            .map(|(view, cells)| ground_jacobian(&view.camera, search.centre) * (cells * cell_m))
            .collect(),
    )
}

/// Values minus the mean of their window, divided by its spread, clamped to ±2; 0 where the window has holes.
fn normalise(grid: &Grid, values: &[f32]) -> Vec<f32> {
    let mut out = vec![0.0; grid.len()];
    out.par_chunks_mut(grid.width).enumerate().for_each(|(row, line)| {
        if row < WINDOW || row + WINDOW >= grid.height {
            return;
        }
        for col in WINDOW..grid.width.saturating_sub(WINDOW) {
            let (mut sum, mut squares) = (0.0f64, 0.0f64);
            for r in row - WINDOW..=row + WINDOW {
                for value in &values[r * grid.width + col - WINDOW..=r * grid.width + col + WINDOW] {
                    sum += f64::from(*value);
                    squares += f64::from(*value).powi(2);
                }
            }
            let n = ((2 * WINDOW + 1) as f64).powi(2);
            let mean = sum / n;
            let spread = (squares / n - mean * mean).max(0.0).sqrt();
            let z = (f64::from(values[row * grid.width + col]) - mean) / spread;
            line[col] = if z.is_finite() { z.clamp(-2.0, 2.0) as f32 } else { 0.0 };
        }
    });
    out
}

/// Offset (cells east, north) of the content of `b` relative to `a`, `a(p) ≈ b(p + offset)`, and the correlation there.
fn offset(grid: &Grid, a: &[f32], b: &[f32]) -> Option<(DVec2, f64)> {
    const SIDE: usize = 2 * REACH as usize + 1;
    let mut scores = [[0.0f64; SIDE]; SIDE];
    for (dr, line) in (-REACH..=REACH).zip(&mut scores) {
        for (dc, score) in (-REACH..=REACH).zip(line) {
            *score = correlation(grid, a, b, dc, dr);
        }
    }
    let (mut row, mut col) = (0, 0);
    for r in 0..SIDE {
        for c in 0..SIDE {
            if scores[r][c] > scores[row][col] {
                (row, col) = (r, c);
            }
        }
    }
    let peak = scores[row][col];
    if peak.is_nan() || peak <= 0.0 {
        return None;
    }
    let fraction = |at: usize, score: &dyn Fn(usize) -> f64| match at > 0 && at + 1 < SIDE {
        true => parabola_top([at - 1, at, at + 1].map(score)).unwrap_or(0.0),
        false => 0.0,
    };
    let dc = fraction(col, &|c| scores[row][c]);
    let dr = fraction(row, &|r| scores[r][col]);
    let cells = DVec2::new(col as f64 + dc - REACH as f64, row as f64 + dr - REACH as f64);
    // Rows run south.
    Some((DVec2::new(cells.x, -cells.y), peak))
}

/// Mean product of `a` at a cell and `b` at the cell (`dc`, `dr`) further.
fn correlation(grid: &Grid, a: &[f32], b: &[f32], dc: isize, dr: isize) -> f64 {
    let reach = REACH as usize;
    let (mut sum, mut count) = (0.0f64, 0.0f64);
    for row in reach..grid.height.saturating_sub(reach) {
        let other = (row as isize + dr) as usize;
        let line_a = &a[row * grid.width + reach..(row + 1) * grid.width - reach];
        let start = (other * grid.width) as isize + REACH + dc;
        let line_b = &b[start as usize..start as usize + line_a.len()];
        let (mut line_sum, mut line_count) = (0.0f32, 0.0f32);
        for (x, y) in line_a.iter().zip(line_b) {
            line_sum += x * y;
            line_count += if *x != 0.0 && *y != 0.0 { 1.0 } else { 0.0 };
        }
        sum += f64::from(line_sum);
        count += f64::from(line_count);
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

/// Per-view shifts whose differences fit the pairwise offsets (weighted least squares by Gauss–Seidel, mean zero).
fn spread_over_views(views: usize, offsets: &[(Pair, (DVec2, f64))]) -> Vec<DVec2> {
    let mut moves = vec![DVec2::ZERO; views];
    for _ in 0..200 {
        for view in 0..views {
            let (mut sum, mut weights) = (DVec2::ZERO, 0.0);
            for (pair, (offset, peak)) in offsets {
                let weight = peak.powi(2);
                if pair.a == view {
                    sum += (moves[pair.b] - *offset) * weight;
                    weights += weight;
                } else if pair.b == view {
                    sum += (moves[pair.a] + *offset) * weight;
                    weights += weight;
                }
            }
            if weights > 0.0 {
                moves[view] = sum / weights;
            }
        }
        let mean = moves.iter().sum::<DVec2>() / views.max(1) as f64;
        moves.iter_mut().for_each(|m| *m -= mean);
    }
    moves
}

/// Pixels per metre east and north at `centre`.
fn ground_jacobian(camera: &ProjectiveCamera, centre: Vec3) -> DMat2 {
    let (u, v) = jacobian(camera, centre);
    DMat2::from_cols(DVec2::new(u.x, v.x), DVec2::new(u.y, v.y))
}

fn jacobian(camera: &ProjectiveCamera, centre: Vec3) -> (DVec3, DVec3) {
    let (col, row, denominator) = camera.project(centre);
    let (u, v) = camera.jacobian(col, row, denominator);
    (u.as_dvec3(), v.as_dvec3())
}

/// Removes from the shifts the common translation of the scene, which the images do not determine.
fn remove_translation(views: &[SweepView], centre: Vec3, shifts: &mut [DVec2]) {
    let slope = |view: &SweepView| {
        let (u, v) = jacobian(&view.camera, centre);
        Matrix2x3::new(u.x, u.y, u.z, v.x, v.y, v.z)
    };
    let slopes: Vec<_> = views.iter().map(slope).collect();
    let given: Vec<_> = shifts.iter().map(|shift| Vector2::new(shift.x, shift.y)).collect();
    for (shift, smallest) in shifts.iter_mut().zip(smallest_shifts(&given, &slopes).0) {
        *shift = DVec2::new(smallest.x, smallest.y);
    }
}
