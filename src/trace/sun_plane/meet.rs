//! The inner loops of the plane: a ray past eight ellipses, and an ellipse past eight rays.

use super::cells::Cells;
use super::ellipse::{Block, Ellipse, LANES, Lane, Moments, pull, whitened};
use super::{CHUNK, PlaneRay, PlaneTrace};
use crate::trace::transmittance::{Shade, attenuation};
use crate::vectorised;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::ops::Range;

vectorised! {
    /// What every ray meets on the plane.
    pub(super) fn shade(rays: &[PlaneRay], plane: &PlaneTrace, out: &mut [Shade]) {
        for (ray, out) in rays.iter().zip(out) {
            let mut sums = ShadeLanes::NOTHING;
            for level in &plane.levels {
                let window = level.cells.window(ray.place - level.half, ray.place + level.half);
                for row in window.rows.clone() {
                    let run = level.cells.run(&window, row);
                    let run = level.first + run.start..level.first + run.end;
                    for number in run.start / LANES..run.end.div_ceil(LANES) {
                        sums.meet(ray, &plane.blocks[number], inside(&run, number));
                    }
                }
            }
            *out = sums.together(plane);
        }
    }
}

/// First and last lane of block `number` that lie in `run`; lanes are -1 and 8 and more where all do on that side.
#[inline(always)]
fn inside(run: &Range<usize>, number: usize) -> [i32; 2] {
    let first = (number * LANES) as i32;
    [run.start as i32 - first, run.end as i32 - 1 - first]
}

/// The numbers of the lanes.
const NUMBERS: [i32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7];

/// What a ray meets, lane by lane.
struct ShadeLanes {
    clear: Lane,
    pull: [Lane; 2],
    hits: [u32; LANES],
}

impl ShadeLanes {
    const NOTHING: Self = Self {
        clear: [1.0; LANES],
        pull: [[0.0; LANES]; 2],
        hits: [0; LANES],
    };

    /// Lets the ray pass the ellipses in `lanes` of a block.
    #[inline(always)]
    fn meet(&mut self, ray: &PlaneRay, block: &Block, lanes: [i32; 2]) {
        let (mut tx, mut ty, mut square) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        let mut met = [0u32; LANES];
        for l in 0..LANES {
            let (dx, dy) = (ray.place.x - block.x[l], ray.place.y - block.y[l]);
            let w = [block.whiten[0][l], block.whiten[1][l], block.whiten[2][l]];
            [tx[l], ty[l]] = whitened(w, dx, dy);
            square[l] = tx[l] * tx[l] + ty[l] * ty[l];
            let peak = block.depth[l] + block.slope[0][l] * dx + block.slope[1][l] * dy;
            let listed = (NUMBERS[l] >= lanes[0]) & (NUMBERS[l] <= lanes[1]);
            // Written so that a NaN counts as a miss.
            let here = (square[l] < block.reach_square[l]) & (peak > ray.depth) & listed;
            met[l] = u32::from(here);
        }
        // Most rays of the day meet nothing for a whole block, and the next.
        if met == [0; LANES] {
            return;
        }
        for l in 0..LANES {
            let met = met[l] & u32::from(block.id[l] != ray.id);
            let (alpha, weight) = attenuation(block.opacity[l], square[l], met);
            self.clear[l] *= 1.0 - alpha;
            let w = [block.whiten[0][l], block.whiten[1][l], block.whiten[2][l]];
            let [px, py] = pull(w, tx[l], ty[l]);
            self.pull[0][l] += weight * px;
            self.pull[1][l] += weight * py;
            self.hits[l] += met;
        }
    }

    #[inline(always)]
    fn together(&self, plane: &PlaneTrace) -> Shade {
        let pull = Vec2::new(self.pull[0].iter().sum(), self.pull[1].iter().sum());
        Shade {
            clear: self.clear.iter().product(),
            pull: plane.axes.in_scene(pull),
            turn: Vec3::ZERO,
            hits: self.hits.iter().sum(),
        }
    }
}

/// Eight rays, number by number.
struct RayBlock {
    x: Lane,
    y: Lane,
    depth: Lane,
    /// Gradient to the logarithm of the transmittance.
    d_log: Lane,
    id: [u32; LANES],
}

impl RayBlock {
    /// Up to eight of `rays`; what is missing says nothing.
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

/// Rays sorted by where they stand on the plane.
pub(super) struct RayGrid {
    cells: Cells,
    blocks: Vec<RayBlock>,
}

impl RayGrid {
    /// Sorts `rays`, each with the gradient to the logarithm of its transmittance.
    pub(super) fn new(rays: &[(PlaneRay, f32)], cell: Vec2) -> Self {
        let places: Vec<Vec2> = rays.par_iter().with_min_len(CHUNK).map(|(ray, _)| ray.place).collect();
        let (cells, order) = Cells::sort(&places, cell);
        let blocks = order
            .par_chunks(LANES)
            .with_min_len(CHUNK / LANES)
            .map(|order| RayBlock::new(rays, order))
            .collect();
        Self { cells, blocks }
    }
}

vectorised! {
    /// What the rays of the grid say to each ellipse; `out` is zero before.
    pub(super) fn gather(ellipses: &[Ellipse], grid: &RayGrid, out: &mut [Moments]) {
        for (ellipse, out) in ellipses.iter().zip(out) {
            let mut sums = [[0.0; LANES]; 6];
            let mut met = false;
            let window = grid.cells.window(ellipse.centre - ellipse.half, ellipse.centre + ellipse.half);
            for row in window.rows.clone() {
                let run = grid.cells.run(&window, row);
                for number in run.start / LANES..run.end.div_ceil(LANES) {
                    met |= listen(ellipse, &grid.blocks[number], inside(&run, number), &mut sums);
                }
            }
            if !met {
                continue;
            }
            let [h, tx, ty, xx, xy, yy] = sums.map(|lane| lane.iter().sum());
            *out = Moments {
                h,
                t: [tx, ty],
                tt: [xx, xy, yy],
            };
        }
    }
}

/// Adds what the rays in `lanes` of a block say to an ellipse; whether any met it.
#[inline(always)]
fn listen(ellipse: &Ellipse, block: &RayBlock, lanes: [i32; 2], sums: &mut [Lane; 6]) -> bool {
    let (mut tx, mut ty, mut square) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let mut met = [0u32; LANES];
    for l in 0..LANES {
        let (dx, dy) = (block.x[l] - ellipse.centre.x, block.y[l] - ellipse.centre.y);
        [tx[l], ty[l]] = whitened(ellipse.whiten, dx, dy);
        square[l] = tx[l] * tx[l] + ty[l] * ty[l];
        let peak = ellipse.depth + ellipse.slope.x * dx + ellipse.slope.y * dy;
        let listed = (NUMBERS[l] >= lanes[0]) & (NUMBERS[l] <= lanes[1]);
        let here = (square[l] < ellipse.reach_square) & (peak > block.depth[l]) & listed;
        met[l] = u32::from(here);
    }
    if met == [0; LANES] {
        return false;
    }
    for l in 0..LANES {
        let met = met[l] & u32::from(block.id[l] != ellipse.id);
        let (_, weight) = attenuation(ellipse.opacity, square[l], met);
        let h = -block.d_log[l] * weight;
        let (hx, hy) = (h * tx[l], h * ty[l]);
        sums[0][l] += h;
        sums[1][l] += hx;
        sums[2][l] += hy;
        sums[3][l] += hx * tx[l];
        sums[4][l] += hx * ty[l];
        sums[5][l] += hy * ty[l];
    }
    true
}
