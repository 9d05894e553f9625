//! Parallel light, answered on a plane: all its rays are points in the plane normal to it.
//!
//! Seen along the light, a Gaussian is an ellipse whose squared Mahalanobis distance is exactly the `‖e×d‖²/‖d‖²` of a ray
//! (the projected covariance is the marginal one), and its peaks lie on a plane in depth. The ellipses are sorted by their
//! centres into the cells of a few grids, one for every doubling of their size, so that a ray looks at some whole rows of
//! cells around it, eight ellipses at a time, one after another in memory. Backward, the rays are sorted the same way and
//! every ellipse looks at the rays in its box: no hit is ever stored, and every sum has one owner and one order.

mod cells;
mod ellipse;
mod meet;

use super::bvh::{Occluder, Occluders};
use super::light_ray::LightRay;
use super::transmittance::{RaysBack, Shade};
use crate::gaussians::{CoreGradient, Table, rotation_backward};
use cells::Cells;
use ellipse::{Axes, Block, Ellipse, LANES, Moments};
use glam::{Vec2, Vec3};
use meet::{RayGrid, gather, shade};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Sizes that have a grid of their own, each up to twice the one before.
const LEVELS: usize = 8;
/// Half sizes of the smallest grid's ellipses at most, in mean half sizes.
const SMALLEST: f32 = 2.0;
/// Columns of cells in half a size: they only cut what a ray looks at, whose cells lie one after another in memory.
const COLUMNS_PER_HALF: f32 = 4.0;
/// Ellipses and rays per parallel job; fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 1024;
const _: () = assert!(CHUNK.is_multiple_of(LANES));

/// A ray on the plane.
#[derive(Debug, Clone, Copy)]
struct PlaneRay {
    place: Vec2,
    /// Depth beyond which peaks count, metres.
    depth: f32,
    /// The Gaussian it starts from.
    id: u32,
}

/// Ellipses of about one size.
struct Level {
    cells: Cells,
    /// Where they begin in the list of all.
    first: usize,
    /// The largest half sizes.
    half: Vec2,
}

/// Gaussians listed by where they stand in the plane normal to a light.
pub(super) struct PlaneTrace {
    axes: Axes,
    levels: Vec<Level>,
    /// Level after level, cell after cell.
    ellipses: Vec<Ellipse>,
    /// The same, eight at a time.
    blocks: Vec<Block>,
    /// Mean half sizes.
    half: Vec2,
}

/// Mean half sizes of the ellipses that exist; chunks are summed side by side, then in their order.
fn mean_half(all: &[Ellipse]) -> Vec2 {
    let chunk_sum = |chunk: &[Ellipse]| {
        chunk.iter().filter(|e| e.exists()).fold([0.0f64; 3], |[x, y, n], e| {
            [x + f64::from(e.half.x), y + f64::from(e.half.y), n + 1.0]
        })
    };
    let sums: Vec<[f64; 3]> = all.par_chunks(4 * CHUNK).map(chunk_sum).collect();
    let add = |a: [f64; 3], b: &[f64; 3]| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
    let [x, y, count] = sums.iter().fold([0.0; 3], add);
    Vec2::new((x / count.max(1.0)) as f32, (y / count.max(1.0)) as f32).max(Vec2::splat(1e-9))
}

/// The numbers of the ellipses of every level.
fn by_size(all: &[Ellipse], mean_half: Vec2) -> [Vec<u32>; LEVELS] {
    let level = |ellipse: &Ellipse| {
        let size = (ellipse.half / mean_half).max_element() / SMALLEST;
        let doublings = (1..LEVELS).filter(|&level| size > (1u32 << (level - 1)) as f32).count();
        ellipse.exists().then_some(doublings as u8)
    };
    let found: Vec<Option<u8>> = all.par_iter().with_min_len(CHUNK).map(level).collect();
    let mut levels: [Vec<u32>; LEVELS] = Default::default();
    for (number, level) in found.iter().enumerate() {
        if let Some(level) = level {
            levels[usize::from(*level)].push(number as u32);
        }
    }
    levels
}

/// Cells for what is looked for within `half`: whole rows of cells cost a look each, columns cost nothing.
fn cell(half: Vec2) -> Vec2 {
    Vec2::new(half.x / COLUMNS_PER_HALF, half.y)
}

impl PlaneTrace {
    /// Lists `occluders` for light from `direction` (unit, toward the light).
    pub(super) fn new(occluders: &Occluders, direction: Vec3) -> Self {
        let axes = Axes::new(direction);
        let all: Vec<Ellipse> = occluders
            .list
            .par_iter()
            .with_min_len(512)
            .enumerate()
            .map(|(id, occluder)| Ellipse::new(occluder, id, &axes))
            .collect();
        let half = mean_half(&all);
        let mut plane = Self {
            axes,
            levels: Vec::new(),
            ellipses: Vec::with_capacity(all.len()),
            blocks: Vec::new(),
            half,
        };
        for numbers in by_size(&all, half).iter().filter(|numbers| !numbers.is_empty()) {
            plane.add_level(&all, numbers);
        }
        plane.blocks = plane
            .ellipses
            .par_chunks(LANES)
            .with_min_len(256)
            .map(Block::new)
            .collect();
        plane
    }

    fn add_level(&mut self, all: &[Ellipse], numbers: &[u32]) {
        let of_level = |place: usize| &all[numbers[place] as usize];
        let (centres, halves): (Vec<Vec2>, Vec<Vec2>) = (0..numbers.len())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|place| (of_level(place).centre, of_level(place).half))
            .unzip();
        let half = halves.iter().fold(Vec2::ZERO, |half, &h| half.max(h));
        let (cells, order) = Cells::sort(&centres, cell(half));
        self.levels.push(Level {
            cells,
            first: self.ellipses.len(),
            half,
        });
        let sorted = order
            .par_iter()
            .with_min_len(4096)
            .map(|&place| *of_level(place as usize));
        self.ellipses.par_extend(sorted);
    }

    fn on_plane(&self, ray: &LightRay, origin: u32) -> PlaneRay {
        PlaneRay {
            place: self.axes.place(ray.origin),
            depth: self.axes.light.dot(ray.origin) + ray.bias,
            id: origin,
        }
    }

    /// What every ray meets; `rays` start from `origins`.
    pub(super) fn shades(&self, rays: &[LightRay], origins: &[u32]) -> Vec<Shade> {
        let mut shades = vec![Shade::default(); rays.len()];
        let chunks = rays.par_chunks(CHUNK).zip(origins.par_chunks(CHUNK));
        chunks
            .zip(shades.par_chunks_mut(CHUNK))
            .for_each(|((rays, origins), shades)| {
                let rays = rays
                    .iter()
                    .zip(origins)
                    .map(|(ray, &origin)| self.on_plane(ray, origin));
                shade(&rays.collect::<Vec<_>>(), self, shades);
            });
        shades
    }

    /// Adds the gradients of the occluders.
    pub(super) fn backward(&self, gaussians: &Table, occluders: &Occluders, back: &RaysBack, out: &mut Table) {
        let telling: Vec<u32> = (0..back.d_log.len() as u32)
            .filter(|&place| back.d_log[place as usize] != 0.0)
            .collect();
        let places: Vec<(PlaneRay, f32)> = telling
            .par_iter()
            .with_min_len(CHUNK)
            .map(|&place| {
                let place = place as usize;
                (self.on_plane(&back.rays[place], back.origins[place]), back.d_log[place])
            })
            .collect();
        let grid = RayGrid::new(&places, cell(self.half));
        let mut moments = vec![Moments::default(); self.ellipses.len()];
        let chunks = self.ellipses.par_chunks(CHUNK).zip(moments.par_chunks_mut(CHUNK));
        chunks.for_each(|(ellipses, moments)| gather(ellipses, &grid, moments));
        // Every Gaussian has one place at most, so the order of threads does not matter.
        let place_of: Vec<AtomicU32> = (0..gaussians.count).map(|_| AtomicU32::new(u32::MAX)).collect();
        let numbered = self.ellipses.par_iter().with_min_len(CHUNK).enumerate();
        numbered.for_each(|(place, e)| place_of[e.id as usize].store(place as u32, Ordering::Relaxed));
        out.add_core_by_range(CHUNK, |range, add| {
            let first = range * CHUNK;
            for id in first..(first + CHUNK).min(gaussians.count) {
                let place = place_of[id].load(Ordering::Relaxed) as usize;
                if moments.get(place).is_some_and(|m| m.h != 0.0) {
                    let (ellipse, moments) = (&self.ellipses[place], &moments[place]);
                    let d = self.of_gaussian(gaussians, &occluders.list[id], ellipse, moments);
                    add(id - first, &d);
                }
            }
        });
    }

    fn of_gaussian(
        &self,
        gaussians: &Table,
        occluder: &Occluder,
        ellipse: &Ellipse,
        moments: &Moments,
    ) -> CoreGradient {
        let shape = moments.back(ellipse, &self.axes, occluder);
        CoreGradient {
            position: shape.position,
            log_scale: shape.log_scale,
            rotation: rotation_backward(gaussians.raw_rotation(ellipse.id as usize), shape.rotation),
            // h is ∂L/∂ ln α̃ = ∂L/∂ ln o, and do/dlogit = o (1 - o).
            opacity: moments.h * (1.0 - occluder.opacity),
        }
    }
}
