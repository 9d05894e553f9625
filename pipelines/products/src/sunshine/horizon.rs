//! Horizon elevation of all cells of a surface in one direction.
//!
//! Lines run over the grid away from the sun; each cell lies on one of them, at most half a cell aside. Only the upper
//! convex hull of the passed cells can be the horizon of later ones, so a sweep takes time proportional to the number
//! of cells, however far shadows reach (V. Timonen and J. Westerholm, "Scalable height field self-shadowing", Computer
//! Graphics Forum 29(2), 2010).

use super::facets::Facets;
use crate::nadir::CellVectors;

/// Height of the viewpoint of a cell above its plane, metres; lower relief is treated as roughness.
const LIFT_M: f64 = 0.1;

/// Surface whose horizons are computed.
pub(super) struct Horizons<'a> {
    facets: &'a Facets,
    cells: &'a CellVectors,
}

/// Direction and steps of the lines over the grid.
struct Lines {
    /// Direction toward the sun: east, north.
    sun: [f64; 2],
    /// True if steps go along columns.
    by_col: bool,
    /// True if the sun stands on the side of the last column or row.
    from_last: bool,
    /// Steps of a line.
    steps: usize,
    /// Cells across.
    across: usize,
    /// Cells that a line moves across with each step.
    drift: f64,
    /// Metres of a step.
    step_m: f64,
    /// Metres east and north of one cell across.
    across_m: [f64; 2],
}

impl<'a> Horizons<'a> {
    /// Horizons of a surface whose cells are spaced by `cells`.
    pub(super) fn new(facets: &'a Facets, cells: &'a CellVectors) -> Self {
        Self { facets, cells }
    }

    /// Tangents of the elevation of all cells' horizons in a direction, at least 0; `NaN` where the surface is unknown.
    /// The horizon includes neighbouring cells, and the slope of the cell itself.
    pub(super) fn toward(&self, azimuth_rad: f64) -> Vec<f32> {
        let lines = self.lines(azimuth_rad);
        let mut out = vec![f32::NAN; self.facets.up_m.len()];
        let drift = ((lines.steps as f64 - 1.0) * lines.drift).round() as i64;
        let mut hull = Vec::new();
        for first in -drift.max(0)..lines.across as i64 - drift.min(0) {
            hull.clear();
            self.walk(&lines, first, &mut hull, &mut out);
        }
        out
    }

    fn lines(&self, azimuth_rad: f64) -> Lines {
        let sun: [f64; 2] = azimuth_rad.sin_cos().into();
        let [cols, rows] = self.cells.toward(sun);
        let by_col = cols.abs() >= rows.abs();
        let (along, aside) = if by_col { (cols, rows) } else { (rows, cols) };
        let (width, height) = (self.facets.width, self.facets.height);
        Lines {
            sun,
            by_col,
            from_last: along > 0.0,
            steps: if by_col { width } else { height },
            across: if by_col { height } else { width },
            drift: -aside / along.abs(),
            step_m: 1.0 / along.abs(),
            across_m: if by_col { self.cells.per_row } else { self.cells.per_col },
        }
    }

    /// Walks one line away from the sun; `hull` holds distance and altitude of passed cells, metres.
    fn walk(&self, lines: &Lines, first: i64, hull: &mut Vec<[f64; 2]>, out: &mut [f32]) {
        for step in 0..lines.steps {
            let moved = step as f64 * lines.drift;
            let across = first + moved.round() as i64;
            if !(0..lines.across as i64).contains(&across) {
                continue;
            }
            let along = if lines.from_last { lines.steps - 1 - step } else { step };
            let across = across as usize;
            let (col, row) = if lines.by_col { (along, across) } else { (across, along) };
            let cell = row * self.facets.width + col;
            if !self.facets.is_known(cell) {
                continue;
            }
            // The line passes beside the cell's centre; the altitude there is that of the cell's plane.
            let aside = moved - moved.round();
            let [to_east, to_north] = self.facets.slope[cell].map(f64::from);
            let rise = |[east, north]: [f64; 2]| to_east * east + to_north * north;
            let here = [
                step as f64 * lines.step_m,
                f64::from(self.facets.up_m[cell]) + aside * rise(lines.across_m),
            ];
            let horizon = highest(hull, [here[0], here[1] + LIFT_M]).max(rise(lines.sun)).max(0.0);
            out[cell] = horizon as f32;
            push(hull, here);
        }
    }
}

/// Rise per metre from a point back to another.
fn rise_to(point: [f64; 2], from: [f64; 2]) -> f64 {
    (point[1] - from[1]) / (from[0] - point[0])
}

/// The steepest rise to a hull from a point beyond it. From the nearest vertex on the rise grows, then falls.
fn highest(hull: &[[f64; 2]], from: [f64; 2]) -> f64 {
    let mut best = f64::NEG_INFINITY;
    for &point in hull.iter().rev() {
        let rise = rise_to(point, from);
        if rise < best {
            break;
        }
        best = rise;
    }
    best
}

/// Adds a point; those below the line from it to earlier ones will never be a horizon again.
fn push(hull: &mut Vec<[f64; 2]>, point: [f64; 2]) {
    while let [.., second, last] = hull[..] {
        if rise_to(last, point) > rise_to(second, point) {
            break;
        }
        hull.pop();
    }
    hull.push(point);
}
