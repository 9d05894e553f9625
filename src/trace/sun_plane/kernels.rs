//! The inner loops of the sun plane: forward, a ray against eight ellipses at a time; backward, an ellipse against
//! eight rays at a time.

use super::cells::Cells;
use super::ellipse::{Ellipse, EllipseBlock, EllipseMoments, LANES, Lane, transposed_whitening, whitened};
use super::{CHUNK, PlaneRay, SunPlaneTrace};
use crate::trace::occlusion::{RayTransmittance, attenuation};
use crate::vectorised;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::ops::Range;

vectorised! {
    /// Traces every ray past the ellipses around it, level by level; `blocks` are those of the plane, eight at a time.
    pub(super) fn trace_rays(rays: &[PlaneRay], plane: &SunPlaneTrace, blocks: &[EllipseBlock], out: &mut [RayTransmittance]) {
        for (ray, out) in rays.iter().zip(out) {
            let mut sums = RayLanes::EMPTY;
            for level in &plane.levels {
                let window = level.cells.window(ray.place - level.half_size, ray.place + level.half_size);
                for row in window.rows.clone() {
                    let run = level.cells.run(&window, row);
                    let run = level.first + run.start..level.first + run.end;
                    for number in run.start / LANES..run.end.div_ceil(LANES) {
                        sums.add(ray, &blocks[number], inside(&run, number));
                    }
                }
            }
            *out = sums.reduce(plane);
        }
    }
}

/// First and last lane of block `number` in `run`; below 0 or above 7 where `run` begins before or ends behind the
/// block.
#[inline(always)]
fn inside(run: &Range<usize>, number: usize) -> [i32; 2] {
    let first = (number * LANES) as i32;
    [run.start as i32 - first, run.end as i32 - 1 - first]
}

/// The numbers of the lanes.
const NUMBERS: [i32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7];

/// Result of a ray so far, lane by lane.
struct RayLanes {
    value: Lane,
    d_origin: [Lane; 2],
    hits: [u32; LANES],
}

impl RayLanes {
    const EMPTY: Self = Self {
        value: [1.0; LANES],
        d_origin: [[0.0; LANES]; 2],
        hits: [0; LANES],
    };

    /// Adds the attenuations of the ellipses in `lanes` of a block.
    #[inline(always)]
    fn add(&mut self, ray: &PlaneRay, block: &EllipseBlock, lanes: [i32; 2]) {
        let (mut tx, mut ty, mut square) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        let mut hit = [0u32; LANES];
        for l in 0..LANES {
            let (dx, dy) = (ray.place.x - block.x[l], ray.place.y - block.y[l]);
            let w = [block.whiten[0][l], block.whiten[1][l], block.whiten[2][l]];
            [tx[l], ty[l]] = whitened(w, dx, dy);
            square[l] = tx[l] * tx[l] + ty[l] * ty[l];
            let peak = block.depth[l] + block.slope[0][l] * dx + block.slope[1][l] * dy;
            let listed = (NUMBERS[l] >= lanes[0]) & (NUMBERS[l] <= lanes[1]);
            // Written so that NaN counts as a miss.
            let hits_here = (square[l] < block.reach_square[l]) & (peak > ray.depth) & listed;
            hit[l] = u32::from(hits_here);
        }
        // Most blocks hold no ellipse that the ray hits.
        if hit == [0; LANES] {
            return;
        }
        for l in 0..LANES {
            let hit = hit[l] & u32::from(block.id[l] != ray.id);
            let (alpha, weight) = attenuation(block.opacity[l], square[l], hit);
            self.value[l] *= 1.0 - alpha;
            let w = [block.whiten[0][l], block.whiten[1][l], block.whiten[2][l]];
            let [px, py] = transposed_whitening(w, tx[l], ty[l]);
            self.d_origin[0][l] += weight * px;
            self.d_origin[1][l] += weight * py;
            self.hits[l] += hit;
        }
    }

    /// Joins the lanes.
    #[inline(always)]
    fn reduce(&self, plane: &SunPlaneTrace) -> RayTransmittance {
        let d_origin = Vec2::new(self.d_origin[0].iter().sum(), self.d_origin[1].iter().sum());
        RayTransmittance {
            value: self.value.iter().product(),
            d_origin: plane.axes.in_scene(d_origin),
            d_turn: Vec3::ZERO,
            hits: self.hits.iter().sum(),
        }
    }
}

/// Eight rays as a structure of arrays.
struct RayBlock {
    x: Lane,
    y: Lane,
    depth: Lane,
    /// Gradient to the logarithm of the transmittance.
    d_log: Lane,
    id: [u32; LANES],
}

impl RayBlock {
    /// Up to eight of `rays`; missing ones contribute nothing.
    fn new(rays: &[(PlaneRay, f32)], order: &[u32]) -> Self {
        let of = |number: fn(&(PlaneRay, f32)) -> f32| {
            std::array::from_fn(|l| order.get(l).map_or(0.0, |&place| number(&rays[place as usize])))
        };
        Self {
            x: of(|(ray, _)| ray.place.x),
            y: of(|(ray, _)| ray.place.y),
            depth: of(|(ray, _)| ray.depth),
            d_log: of(|&(_, d_log)| d_log),
            id: std::array::from_fn(|l| order.get(l).map_or(u32::MAX, |&place| rays[place as usize].0.id)),
        }
    }
}

/// Rays sorted by their position on the plane.
pub(super) struct RayGrid {
    cells: Cells,
    blocks: Vec<RayBlock>,
}

impl RayGrid {
    /// Sorts `rays`, each with the gradient to the logarithm of its transmittance.
    pub(super) fn new(rays: &[(PlaneRay, f32)], cell_size: Vec2) -> Self {
        let places: Vec<Vec2> = rays.par_iter().with_min_len(CHUNK).map(|(ray, _)| ray.place).collect();
        let (cells, order) = Cells::sort(&places, cell_size);
        let blocks = order
            .par_chunks(LANES)
            .with_min_len(CHUNK / LANES)
            .map(|order| RayBlock::new(rays, order))
            .collect();
        Self { cells, blocks }
    }
}

vectorised! {
    /// Sums the contributions of the rays of the grid to each ellipse; `out` is zero before.
    pub(super) fn gather_gradients(ellipses: &[Ellipse], grid: &RayGrid, out: &mut [EllipseMoments]) {
        for (ellipse, out) in ellipses.iter().zip(out) {
            let mut sums = [[0.0; LANES]; 6];
            let mut hit = false;
            let window = grid.cells.window(ellipse.centre - ellipse.half_size, ellipse.centre + ellipse.half_size);
            for row in window.rows.clone() {
                let run = grid.cells.run(&window, row);
                for number in run.start / LANES..run.end.div_ceil(LANES) {
                    hit |= add_contributions(ellipse, &grid.blocks[number], inside(&run, number), &mut sums);
                }
            }
            if !hit {
                continue;
            }
            let [h, tx, ty, xx, xy, yy] = sums.map(|lane| lane.iter().sum());
            *out = EllipseMoments {
                h,
                t: [tx, ty],
                tt: [xx, xy, yy],
            };
        }
    }
}

/// Adds the contributions of the rays in `lanes` of a block to an ellipse; returns true if any of them hit it.
#[inline(always)]
fn add_contributions(ellipse: &Ellipse, block: &RayBlock, lanes: [i32; 2], sums: &mut [Lane; 6]) -> bool {
    let (mut tx, mut ty, mut square) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let mut hit = [0u32; LANES];
    for l in 0..LANES {
        let (dx, dy) = (block.x[l] - ellipse.centre.x, block.y[l] - ellipse.centre.y);
        [tx[l], ty[l]] = whitened(ellipse.whiten, dx, dy);
        square[l] = tx[l] * tx[l] + ty[l] * ty[l];
        let peak = ellipse.depth + ellipse.slope.x * dx + ellipse.slope.y * dy;
        let listed = (NUMBERS[l] >= lanes[0]) & (NUMBERS[l] <= lanes[1]);
        let hits_here = (square[l] < ellipse.reach_square) & (peak > block.depth[l]) & listed;
        hit[l] = u32::from(hits_here);
    }
    if hit == [0; LANES] {
        return false;
    }
    // Sums in local lanes stay in registers; through the reference the compiler makes this loop scalar.
    let [mut h_sum, mut x_sum, mut y_sum, mut xx_sum, mut xy_sum, mut yy_sum] = *sums;
    for l in 0..LANES {
        let hit = hit[l] & u32::from(block.id[l] != ellipse.id);
        let (_, weight) = attenuation(ellipse.opacity, square[l], hit);
        let h = -block.d_log[l] * weight;
        let (hx, hy) = (h * tx[l], h * ty[l]);
        h_sum[l] += h;
        x_sum[l] += hx;
        y_sum[l] += hy;
        xx_sum[l] += hx * tx[l];
        xy_sum[l] += hx * ty[l];
        yy_sum[l] += hy * ty[l];
    }
    *sums = [h_sum, x_sum, y_sum, xx_sum, xy_sum, yy_sum];
    true
}
