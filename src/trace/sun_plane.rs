//! Transmittance toward parallel light, in the plane normal to the light, where every ray is a point.
//!
//! Seen along the light, a Gaussian is an ellipse whose squared Mahalanobis distance is exactly the `‖e×d‖²/‖d‖²` of a
//! ray (the projected covariance is the marginal one), and the peaks along the rays lie on a plane in depth
//! (`ellipse`).
//!
//! *Forward*, [`SunPlaneTrace::new`] projects all Gaussians and sorts the ellipses by their centres into the cells of a
//! few grids (`cells`), one grid, or level, for every doubling of their size. [`SunPlaneTrace::trace`] then has every
//! ray test the ellipses of the cells around it, eight at a time, contiguous in memory (`kernels`).
//!
//! *Backward* ([`SunPlaneTrace::backward`]), the rays whose gradient is not zero are sorted into cells the same way,
//! and every ellipse sums the contributions of the rays in its box to its moments, from which the gradient of its
//! Gaussian follows. No hit is ever stored, and every sum has one owner and one order, so results do not depend on the
//! number of threads.
//!
//! Limit: parallel light only; point lights take `hierarchy`.

mod cells;
mod ellipse;
mod kernels;

use super::bvh::{Occluder, Occluders};
use super::light_ray::LightRay;
use super::occlusion::{RayGradients, RayTransmittance};
use crate::gaussians::{Core, Table, rotation_backward};
use crate::light::Light;
use crate::parallel::defaults;
use cells::Cells;
use ellipse::{Axes, Ellipse, EllipseBlock, EllipseMoments, LANES};
use glam::{Vec2, Vec3};
use kernels::{RayGrid, gather_gradients, trace_rays};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Levels: grids of ellipses of one size, each up to twice that of the level before.
const LEVELS: usize = 8;
/// Largest half size of the ellipses of the first level, in mean half sizes.
const SMALLEST: f32 = 2.0;
/// Columns of cells per half size. Cells of a row are contiguous, so more columns only cut away ellipses that a ray
/// need not test.
const COLUMNS_PER_HALF_SIZE: f32 = 4.0;
/// Ellipses and rays per parallel job; fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 1024;
const _: () = assert!(CHUNK.is_multiple_of(LANES));

/// A ray in the plane normal to the light.
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
    /// Index of the level's first ellipse in the list of all.
    first: usize,
    /// Largest half sizes of the ellipses, metres.
    half_size: Vec2,
}

/// Gaussians as ellipses in the plane normal to a light, sorted into grids by size and place.
pub(super) struct SunPlaneTrace {
    axes: Axes,
    levels: Vec<Level>,
    /// Level after level, cell after cell.
    ellipses: Vec<Ellipse>,
    /// Mean half sizes of the ellipses, metres.
    half_size: Vec2,
}

/// Mean half sizes of the ellipses that exist; chunks are summed side by side, then in their order.
fn mean_half_size(all: &[Ellipse]) -> Vec2 {
    let chunk_sum = |chunk: &[Ellipse]| {
        chunk.iter().filter(|e| e.exists()).fold([0.0f64; 3], |[x, y, n], e| {
            [x + f64::from(e.half_size.x), y + f64::from(e.half_size.y), n + 1.0]
        })
    };
    let sums: Vec<[f64; 3]> = all.par_chunks(4 * CHUNK).map(chunk_sum).collect();
    let add = |a: [f64; 3], b: &[f64; 3]| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
    let [x, y, count] = sums.iter().fold([0.0; 3], add);
    Vec2::new((x / count.max(1.0)) as f32, (y / count.max(1.0)) as f32).max(Vec2::splat(1e-9))
}

/// Indices of the ellipses of every level.
fn by_level(all: &[Ellipse], mean_half_size: Vec2) -> [Vec<u32>; LEVELS] {
    let level = |ellipse: &Ellipse| {
        let size = (ellipse.half_size / mean_half_size).max_element() / SMALLEST;
        let doublings = (1..LEVELS).filter(|&level| size > (1u32 << (level - 1)) as f32).count();
        ellipse.exists().then_some(doublings as u8)
    };
    let of_chunk = |(chunk, all): (usize, &[Ellipse])| {
        let mut levels: [Vec<u32>; LEVELS] = Default::default();
        for (place, ellipse) in all.iter().enumerate() {
            if let Some(level) = level(ellipse) {
                levels[usize::from(level)].push((chunk * 4 * CHUNK + place) as u32);
            }
        }
        levels
    };
    let chunks: Vec<[Vec<u32>; LEVELS]> = all.par_chunks(4 * CHUNK).enumerate().map(of_chunk).collect();
    std::array::from_fn(|level| {
        let of_level: Vec<&[u32]> = chunks.iter().map(|levels| levels[level].as_slice()).collect();
        of_level.concat()
    })
}

/// Size of the cells for searches within `half_size`: every row of cells costs a lookup, columns cost nothing.
fn cell_size(half_size: Vec2) -> Vec2 {
    Vec2::new(half_size.x / COLUMNS_PER_HALF_SIZE, half_size.y)
}

impl SunPlaneTrace {
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
        let half_size = mean_half_size(&all);
        let mut plane = Self {
            axes,
            levels: Vec::new(),
            ellipses: Vec::with_capacity(all.len()),
            half_size,
        };
        for numbers in by_level(&all, half_size).iter().filter(|numbers| !numbers.is_empty()) {
            plane.add_level(&all, numbers);
        }
        plane
    }

    fn add_level(&mut self, all: &[Ellipse], numbers: &[u32]) {
        let of_level = |place: usize| &all[numbers[place] as usize];
        let (centres, half_sizes): (Vec<Vec2>, Vec<Vec2>) = (0..numbers.len())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|place| (of_level(place).centre, of_level(place).half_size))
            .unzip();
        let largest = half_sizes.par_chunks(CHUNK).map(|chunk| {
            let fold = |half_size: Vec2, &h: &Vec2| half_size.max(h);
            chunk.iter().fold(Vec2::ZERO, fold)
        });
        let half_size = largest.reduce(|| Vec2::ZERO, Vec2::max);
        let (cells, order) = Cells::sort(&centres, cell_size(half_size));
        self.levels.push(Level {
            cells,
            first: self.ellipses.len(),
            half_size,
        });
        let sorted = order
            .par_iter()
            .with_min_len(4096)
            .map(|&place| *of_level(place as usize));
        self.ellipses.par_extend(sorted);
    }

    /// The ray that starts from the Gaussian `origin`.
    fn ray(&self, occluders: &Occluders, origin: u32) -> PlaneRay {
        let ray = LightRay::new(&occluders.list[origin as usize], &Light::Directional(self.axes.light));
        PlaneRay {
            place: self.axes.place(ray.origin),
            depth: self.axes.light.dot(ray.origin) + ray.bias,
            id: origin,
        }
    }

    /// Traces the rays of `origins` past all ellipses.
    pub(super) fn trace(&self, occluders: &Occluders, origins: &[u32]) -> Vec<RayTransmittance> {
        let blocks = self.ellipses.par_chunks(LANES).with_min_len(256);
        let blocks: Vec<EllipseBlock> = blocks.map(EllipseBlock::new).collect();
        let mut results: Vec<RayTransmittance> = defaults(origins.len());
        let chunks = origins.par_chunks(CHUNK).zip(results.par_chunks_mut(CHUNK));
        chunks.for_each(|(origins, results)| {
            let rays: Vec<PlaneRay> = origins.iter().map(|&origin| self.ray(occluders, origin)).collect();
            trace_rays(&rays, self, &blocks, results);
        });
        results
    }

    /// Adds the gradients of the occluders to `out`.
    pub(super) fn backward(&self, gaussians: &Table, occluders: &Occluders, gradients: &RayGradients, out: &mut Table) {
        let all = gradients.origins.par_iter().zip(gradients.d_log).with_min_len(CHUNK);
        let plane_rays: Vec<(PlaneRay, f32)> = all
            .filter(|(_, d_log)| **d_log != 0.0)
            .map(|(&origin, &d_log)| (self.ray(occluders, origin), d_log))
            .collect();
        let grid = RayGrid::new(&plane_rays, cell_size(self.half_size));
        drop(plane_rays);
        let mut moments: Vec<EllipseMoments> = defaults(self.ellipses.len());
        let chunks = self.ellipses.par_chunks(CHUNK).zip(moments.par_chunks_mut(CHUNK));
        chunks.for_each(|(ellipses, moments)| gather_gradients(ellipses, &grid, moments));
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
                    let d = self.core_gradient(gaussians, &occluders.list[id], ellipse, moments);
                    add(id - first, &d);
                }
            }
        });
    }

    /// Gradient of a Gaussian from the moments of its ellipse.
    fn core_gradient(
        &self,
        gaussians: &Table,
        occluder: &Occluder,
        ellipse: &Ellipse,
        moments: &EllipseMoments,
    ) -> Core {
        let shape = moments.shape_gradient(ellipse, &self.axes, occluder);
        Core {
            position: shape.position,
            log_scale: shape.log_scale,
            rotation: rotation_backward(gaussians.raw_rotation(ellipse.id as usize), shape.rotation),
            // h is ∂L/∂ ln α̃ = ∂L/∂ ln o, and do/dlogit = o (1 - o).
            opacity: moments.h * (1.0 - occluder.opacity),
        }
    }
}
