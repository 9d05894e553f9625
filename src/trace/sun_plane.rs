//! Parallel light, answered on a plane: all its rays are points in the plane normal to it.
//!
//! Seen along the light, a Gaussian is an ellipse whose squared Mahalanobis distance is exactly the `‖e×d‖²/‖d‖²` of a ray
//! (the projected covariance is the marginal one), and its peaks lie on a plane in depth. A uniform grid of cells over the
//! plane lists the ellipses that touch each cell, so a ray is one lookup and a walk over a short list: the same hits as a
//! hierarchy finds, many times cheaper, because rays start inside a sheet of overlapping boxes that a hierarchy must visit.

use super::bvh::Occluder;
use crate::deal::{Rows, Span, cell_starts, cut_rows};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Cells across the plane in either direction, at most.
const CELLS_MAX: usize = 4096;
/// Width of a cell in mean half sizes of an ellipse: each is then listed about nine times.
const CELL_HALVES: f32 = 1.0;

/// One Gaussian on the plane.
#[derive(Debug, Clone, Copy)]
struct Ellipse {
    centre: Vec2,
    conic: [f32; 3],
    /// Squared distance beyond which it ends.
    reach_square: f32,
    /// Depth of the peak toward the light at the centre, metres, and its change over the plane.
    depth: f32,
    slope: Vec2,
    opacity: f32,
    id: u32,
}

/// Gaussians listed by where they stand in the plane normal to a light.
pub(super) struct SunPlane {
    right: Vec3,
    up: Vec3,
    direction: Vec3,
    corner: Vec2,
    inverse_cell: f32,
    columns: usize,
    rows: usize,
    starts: Vec<u32>,
    /// Places in `ellipses`, cell after cell.
    list: Vec<u32>,
    ellipses: Vec<Ellipse>,
}

fn ellipse(occluder: &Occluder, id: usize, axes: (Vec3, Vec3, Vec3)) -> Option<(Ellipse, Vec2)> {
    if occluder.reach_square <= 0.0 {
        return None;
    }
    let whitened = |axis: Vec3| occluder.spread.transpose() * axis;
    let (a, b, c) = (whitened(axes.0), whitened(axes.1), whitened(axes.2));
    let (xx, xy, yy) = (a.dot(a), a.dot(b), b.dot(b));
    // The determinant as the squared area of the two whitened axes: never negative, no cancellation for a thin disc.
    let det = a.cross(b).length_squared();
    if !(det > 0.0 && det.is_finite()) {
        return None;
    }
    let conic = [yy / det, -xy / det, xx / det];
    let (cx, cy) = (c.dot(a), c.dot(b));
    let slope = Vec2::new(conic[0] * cx + conic[1] * cy, conic[1] * cx + conic[2] * cy);
    let centre = Vec2::new(axes.0.dot(occluder.position), axes.1.dot(occluder.position));
    let depth = axes.2.dot(occluder.position);
    let half = Vec2::new((xx * occluder.reach_square).sqrt(), (yy * occluder.reach_square).sqrt());
    let shape = Ellipse {
        centre,
        conic,
        reach_square: occluder.reach_square,
        depth,
        slope,
        opacity: occluder.opacity,
        id: id as u32,
    };
    (centre.is_finite() && half.is_finite()).then_some((shape, half))
}

impl SunPlane {
    /// Lists `occluders` for light from `direction` (unit, toward the light).
    pub(super) fn new(occluders: &[Occluder], direction: Vec3) -> Self {
        // Duff et al. 2017: no direction is special.
        let (right, up) = direction.any_orthonormal_pair();
        let found: Vec<Option<(Ellipse, Vec2)>> = occluders
            .par_iter()
            .with_min_len(512)
            .enumerate()
            .map(|(id, occluder)| ellipse(occluder, id, (right, up, direction)))
            .collect();
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        let mut count = 0usize;
        let mut halves = 0.0f64;
        for (shape, half) in found.iter().flatten() {
            halves += f64::from((half.x * half.y).sqrt());
            low = low.min(shape.centre);
            high = high.max(shape.centre);
            count += 1;
        }
        if count == 0 {
            (low, high) = (Vec2::ZERO, Vec2::ZERO);
        }
        let extent = (high - low).max(Vec2::splat(1e-6));
        let half = (halves / count.max(1) as f64) as f32;
        let cell = (CELL_HALVES * half).max(extent.max_element() / CELLS_MAX as f32);
        let cells = |length: f32| ((length / cell) as usize + 1).min(CELLS_MAX + 1);
        let mut plane = Self {
            right,
            up,
            direction,
            corner: low,
            inverse_cell: 1.0 / cell,
            columns: cells(extent.x),
            rows: cells(extent.y),
            starts: Vec::new(),
            list: Vec::new(),
            ellipses: Vec::new(),
        };
        plane.deal(found.into_iter().flatten().collect());
        plane
    }

    fn cell(&self, place: Vec2) -> (usize, usize) {
        let at = (place - self.corner) * self.inverse_cell;
        (
            (at.x.max(0.0) as usize).min(self.columns - 1),
            (at.y.max(0.0) as usize).min(self.rows - 1),
        )
    }

    /// Deals the ellipses to the cells they touch, in order of their Gaussians.
    fn deal(&mut self, found: Vec<(Ellipse, Vec2)>) {
        let spans: Vec<Span> = found
            .par_iter()
            .with_min_len(4096)
            .map(|(shape, half)| {
                let ((c0, r0), (c1, r1)) = (self.cell(shape.centre - *half), self.cell(shape.centre + *half));
                Span {
                    columns: (c0 as u16, c1 as u16 + 1),
                    rows: (r0 as u16, r1 as u16 + 1),
                }
            })
            .collect();
        let places = Rows::new(&spans, self.rows, |place| place as u32);
        let span = |place: u32| spans[place as usize];
        let row_starts = (0..self.rows)
            .into_par_iter()
            .map(|row| cell_starts(places.row(row), span, self.columns))
            .collect();
        let mut list = Vec::new();
        let (starts, row_lists) = cut_rows(row_starts, &mut list);
        row_lists.into_par_iter().for_each(|mut cells| {
            for &place in places.row(cells.row).flatten() {
                for next in &mut cells.starts[span(place).columns()] {
                    cells.list[*next as usize] = place;
                    *next += 1;
                }
            }
        });
        self.starts = starts;
        self.list = list;
        self.ellipses = found.into_iter().map(|(shape, _)| shape).collect();
    }

    /// Calls `visit` with every Gaussian that a ray from `origin` meets beyond `bias` metres, and its `α̃` before saturation, until it
    /// says that it has seen enough.
    #[inline]
    pub(super) fn visit(&self, origin: Vec3, bias: f32, mut visit: impl FnMut(u32, f32) -> bool) {
        let place = Vec2::new(self.right.dot(origin), self.up.dot(origin));
        let depth = self.direction.dot(origin) + bias;
        let (column, row) = self.cell(place);
        let cell = row * self.columns + column;
        for &listed in &self.list[self.starts[cell] as usize..self.starts[cell + 1] as usize] {
            let e = &self.ellipses[listed as usize];
            let d = place - e.centre;
            let q = (e.conic[0] * d.x + 2.0 * e.conic[1] * d.y) * d.x + e.conic[2] * d.y * d.y;
            let peak = e.depth + e.slope.dot(d);
            // Both at once: either alone is a coin toss, both together are rare and foreseen.
            if (q < e.reach_square) & (peak > depth) {
                let more = visit(e.id, e.opacity * (-0.5 * q.max(0.0)).exp());
                if !more {
                    return;
                }
            }
        }
    }
}
