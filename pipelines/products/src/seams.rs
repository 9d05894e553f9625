//! Seams of a mosaic: height steps across tile borders beside steps elsewhere, and differences between overlapping
//! tiles.

use super::blend::Piece;
use heliosplat::Raster;
use heliosplat_grid::statistics::{SIGMA_PER_MAD, quantile, upper_median};
use serde::Serialize;
use std::collections::BTreeSet;

/// Statistics of height steps between neighbouring cells.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Steps {
    /// Number of steps.
    pub count: usize,
    /// Mean step, metres.
    pub mean_m: f64,
    /// Median step, metres.
    pub median_m: f64,
    /// Quantile 0.95 of the steps, metres.
    pub p95_m: f64,
    /// Share of steps above 1 m, 0 to 1.
    pub above_1m: f64,
}

/// Altitude difference of two tiles in their overlap.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Names of the two tiles.
    pub tiles: [String; 2],
    /// Number of cells known in both tiles.
    pub cells: usize,
    /// Median of the second minus the first, metres.
    pub median_m: f64,
    /// Normalised median absolute deviation of the differences (1.4826 times the median distance from the median),
    /// metres.
    pub nmad_m: f64,
    /// Mean absolute difference, metres.
    pub mean_abs_m: f64,
}

/// Steps and differences at the borders of a mosaic's tiles.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Seams {
    /// Steps across the lines between cores; `None` where there are none.
    pub border: Option<Steps>,
    /// Steps across the lines where tiles begin and end; `None` where there are none.
    pub edge: Option<Steps>,
    /// All other steps; `None` where there are none.
    pub interior: Option<Steps>,
    /// Steps across the lines between cores within single tiles, which have no border there.
    pub border_within_tiles: Option<Steps>,
    /// Share of the interior lines whose mean step is at least the border's, 0 to 1; `None` without borders.
    pub interior_lines_above_border: Option<f64>,
    /// Differences of each two tiles in their overlap.
    pub overlaps: Vec<Difference>,
}

fn steps(mut all: Vec<f32>) -> Option<Steps> {
    if all.is_empty() {
        return None;
    }
    // In order, so that the sum does not depend on where the steps come from.
    all.sort_by(f32::total_cmp);
    let count = all.len();
    Some(Steps {
        count,
        mean_m: all.iter().copied().map(f64::from).sum::<f64>() / count as f64,
        above_1m: all.iter().filter(|&&step| step > 1.0).count() as f64 / count as f64,
        median_m: quantile(&mut all, 0.5)?.into(),
        p95_m: quantile(&mut all, 0.95)?.into(),
    })
}

/// A pair of neighbouring cells across a line: `axis` 0 is a line between columns `at - 1` and `at`, 1 between rows.
#[derive(Clone, Copy)]
struct Line {
    axis: usize,
    at: isize,
}

impl Line {
    fn cells(self, along: isize) -> [[isize; 2]; 2] {
        match self.axis {
            0 => [[self.at - 1, along], [self.at, along]],
            _ => [[along, self.at - 1], [along, self.at]],
        }
    }
}

/// Measures the seams of a mosaic of `pieces`; the first band of `altitude` is its altitude, metres.
pub fn measure(altitude: &Raster, pieces: &[Piece]) -> Seams {
    let size = [altitude.width as isize, altitude.height as isize];
    let inner = |axis: usize, at: isize| at > 0 && at < size[axis];
    let mut cores = [BTreeSet::new(), BTreeSet::new()];
    let mut edges = [BTreeSet::new(), BTreeSet::new()];
    for piece in pieces {
        for axis in 0..2 {
            cores[axis].extend(piece.core[axis].into_iter().filter(|&at| inner(axis, at)));
            edges[axis].extend(piece.bounds[axis].into_iter().filter(|&at| inner(axis, at)));
        }
    }
    let mosaic = |[col, row]: [isize; 2]| altitude.at(0, col as usize, row as usize);
    let (mut border, mut edge, mut interior, mut within) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut line_means, mut border_means) = (Vec::new(), Vec::new());
    for axis in 0..2 {
        for at in 1..size[axis] {
            let line = Line { axis, at };
            let found: Vec<f32> = steps_along(line, size[1 - axis], &mosaic).collect();
            let mean = found.iter().map(|&s| f64::from(s)).sum::<f64>() / found.len().max(1) as f64;
            if cores[axis].contains(&at) {
                border_means.push(mean);
                border.extend(found);
                within.extend(own_steps(line, size[1 - axis], pieces));
            } else if edges[axis].contains(&at) {
                edge.extend(found);
            } else {
                line_means.push(mean);
                interior.extend(found);
            }
        }
    }
    let border_mean = border_means.iter().sum::<f64>() / border_means.len().max(1) as f64;
    let above = line_means.iter().filter(|&&mean| mean >= border_mean).count();
    Seams {
        interior_lines_above_border: (!border.is_empty()).then(|| above as f64 / line_means.len().max(1) as f64),
        border: steps(border),
        edge: steps(edge),
        interior: steps(interior),
        border_within_tiles: steps(within),
        overlaps: differences(pieces),
    }
}

fn steps_along(line: Line, length: isize, value: &impl Fn([isize; 2]) -> f32) -> impl Iterator<Item = f32> {
    let steps = (0..length).map(move |along| line.cells(along));
    let heights = steps.map(|[a, b]| (value(a) - value(b)).abs());
    heights.filter(|step| step.is_finite())
}

/// Steps across a line in every tile that has values on both sides.
fn own_steps(line: Line, length: isize, pieces: &[Piece]) -> Vec<f32> {
    let of =
        |piece: &Piece| -> Vec<f32> { steps_along(line, length, &|[col, row]| piece.value(0, col, row)).collect() };
    pieces.iter().flat_map(of).collect()
}

fn differences(pieces: &[Piece]) -> Vec<Difference> {
    let later = |(index, first)| {
        let others = pieces[index + 1..].iter();
        others.filter_map(move |second| difference(first, second))
    };
    pieces.iter().enumerate().flat_map(later).collect()
}

fn difference(first: &Piece, second: &Piece) -> Option<Difference> {
    let shared = |axis: usize| {
        let ([a0, a1], [b0, b1]) = (first.bounds[axis], second.bounds[axis]);
        a0.max(b0)..a1.min(b1)
    };
    let cells = shared(1).flat_map(|row| shared(0).map(move |col| (col, row)));
    let apart = cells.map(|(col, row)| second.value(0, col, row) - first.value(0, col, row));
    let mut apart: Vec<f32> = apart.filter(|d| d.is_finite()).collect();
    if apart.is_empty() {
        return None;
    }
    let mean_abs_m = apart.iter().map(|d| f64::from(d.abs())).sum::<f64>() / apart.len() as f64;
    let middle = upper_median(&mut apart)?;
    let mut spread: Vec<f32> = apart.iter().map(|d| (d - middle).abs()).collect();
    Some(Difference {
        tiles: [first.unit.clone(), second.unit.clone()],
        cells: apart.len(),
        median_m: middle.into(),
        nmad_m: SIGMA_PER_MAD * f64::from(upper_median(&mut spread)?),
        mean_abs_m,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blend::blend;

    /// Two tiles side by side that share nothing or ten cells on each side; the right one lies `rise` higher.
    fn pieces(shared: isize, rise: f32) -> Vec<Piece> {
        let piece = |unit: &str, first: isize, core: [isize; 2], rise: f32| {
            let width = (20 + shared) as usize;
            let mut raster = Raster::filled(width, 16, 4, 0.2);
            for i in 0..width * 16 {
                let (col, row) = (first as usize + i % width, i / width);
                // Rough ground: steps of up to a tenth of a metre everywhere.
                raster.values[i] = 50.0 + rise + 0.1 * ((col * 7 + row * 3) % 5) as f32 / 4.0;
            }
            Piece {
                unit: unit.into(),
                raster,
                at: [first, 0],
                core: [core, [0, 16]],
                bounds: [[first, first + width as isize], [0, 16]],
            }
        };
        vec![piece("a", 0, [0, 20], 0.0), piece("b", 20 - shared, [20, 40], rise)]
    }

    #[test]
    fn a_step_between_tiles_is_seen_and_blending_takes_it_away() {
        let measured = |shared: isize| {
            let pieces = pieces(shared, 0.8);
            measure(&blend(&pieces, (40, 16), 0.5), &pieces)
        };
        let abrupt = measured(0);
        let (border, interior) = (abrupt.border.expect("a border"), abrupt.interior.expect("an interior"));
        assert!(border.mean_m > 0.6 && interior.mean_m < 0.1, "{border:?} {interior:?}");
        assert_eq!(abrupt.interior_lines_above_border, Some(0.0));
        let blended = measured(10);
        let border = blended.border.expect("a border");
        assert!(border.mean_m < 0.15, "{border:?}");
        let own = blended.border_within_tiles.expect("tiles know both sides");
        assert!(own.mean_m < 0.1, "{own:?}");
        let apart = &blended.overlaps[0];
        assert!(
            (apart.median_m - 0.8).abs() < 1e-4 && apart.nmad_m < 1e-4 && apart.cells == 320,
            "{apart:?}"
        );
    }
}
