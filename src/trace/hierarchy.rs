//! Light of any kind, by the hierarchy: bundles of neighbouring rays walk it together.
//!
//! A bundle lists the Gaussians that its shaft may meet and lets its rays pass them, eight at a time; those that some ray met are
//! kept for the way back. There, what a bundle says to a Gaussian is summed to one record, and the records are joined by
//! Gaussian in the order of the bundles: no sum is shared between threads.

mod meet;

use super::bvh::{Hierarchy, Occluder, Occluders, Shaft};
use super::light_ray::LightRay;
use super::transmittance::{RaysBack, Shade};
use crate::gaussians::{CoreGradient, Table, rotation_backward};
use crate::light::Light;
use glam::{Mat3, Vec3};
use meet::{BLOCKS, BUNDLE, Bundle, LANES, Lane, Moments, listen, shade};
use rayon::prelude::*;

/// Bundles per parallel job; fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 32;
/// Occluders per parallel job of the way back.
const RANGE: usize = 2048;

/// Rays in bundles, and what each bundle met.
pub(super) struct HierarchyTrace {
    /// Places of the rays among the origins, neighbours together, [`BUNDLE`] to a bundle.
    order: Vec<u32>,
    chunks: Vec<Chunk>,
}

/// Some bundles.
struct Chunk {
    bundles: Vec<Bundle>,
    /// Where the met of each bundle end; they begin where those of the bundle before end.
    met_ends: Vec<u32>,
    met: Vec<u32>,
}

impl Chunk {
    fn met_of(&self, bundle: usize) -> &[u32] {
        let start = if bundle == 0 { 0 } else { self.met_ends[bundle - 1] };
        &self.met[start as usize..self.met_ends[bundle] as usize]
    }
}

/// Places of `origins` such that neighbours in the scene are neighbours.
fn sorted(origins: &[u32], hierarchy: &Hierarchy) -> Vec<u32> {
    let mut place_of = vec![u32::MAX; hierarchy.rank.len()];
    let mut again = Vec::new();
    for (place, &origin) in origins.iter().enumerate() {
        let slot = &mut place_of[hierarchy.rank[origin as usize] as usize];
        if *slot == u32::MAX {
            *slot = place as u32;
        } else {
            again.push(place as u32);
        }
    }
    place_of.retain(|&place| place != u32::MAX);
    place_of.extend(again);
    place_of
}

impl HierarchyTrace {
    /// Lets rays toward `light` pass the occluders; returns what each met.
    pub(super) fn new(occluders: &Occluders, light: &Light, rays: &[LightRay], origins: &[u32]) -> (Self, Vec<Shade>) {
        let hierarchy = occluders.hierarchy();
        let order = sorted(origins, hierarchy);
        let (chunks, shades): (Vec<Chunk>, Vec<Vec<Shade>>) = order
            .par_chunks(CHUNK * BUNDLE)
            .map(|places| trace_chunk(occluders, light, (rays, origins, places)))
            .unzip();
        let mut in_place = vec![Shade::default(); rays.len()];
        for (&place, shade) in order.iter().zip(shades.iter().flatten()) {
            in_place[place as usize] = *shade;
        }
        (Self { order, chunks }, in_place)
    }

    /// Adds the gradients of the occluders.
    pub(super) fn backward(&self, gaussians: &Table, occluders: &Occluders, back: &RaysBack, out: &mut Table) {
        let ranges = gaussians.count.div_ceil(RANGE);
        let records: Vec<Records> = self
            .chunks
            .par_iter()
            .zip(self.order.par_chunks(CHUNK * BUNDLE))
            .map(|(chunk, places)| {
                let d_log: Vec<f32> = places.iter().map(|&place| back.d_log[place as usize]).collect();
                Records::sorted(&said(chunk, &d_log, occluders), ranges)
            })
            .collect();
        out.add_core_by_range(RANGE, |range, add| {
            let mut sums = vec![Moments::default(); RANGE];
            for (id, moments) in records.iter().flat_map(|records| records.of(range)) {
                sums[*id as usize % RANGE].add(moments);
            }
            for (index, moments) in sums.iter().enumerate().filter(|(_, moments)| moments.h != 0.0) {
                let id = range * RANGE + index;
                add(index, &of_gaussian(gaussians, &occluders.list[id], id, moments));
            }
        });
    }
}

fn trace_chunk(
    occluders: &Occluders,
    light: &Light,
    (rays, origins, places): (&[LightRay], &[u32], &[u32]),
) -> (Chunk, Vec<Shade>) {
    let hierarchy = occluders.hierarchy();
    let mut chunk = Chunk {
        bundles: Vec::with_capacity(CHUNK),
        met_ends: Vec::with_capacity(CHUNK),
        met: Vec::new(),
    };
    let mut shades = vec![Shade::default(); places.len()];
    let (mut pending, mut candidates) = (Vec::new(), Vec::new());
    for (places, shades) in places.chunks(BUNDLE).zip(shades.chunks_mut(BUNDLE)) {
        let of = |l: usize| places.get(l).map(|&p| (&rays[p as usize], origins[p as usize]));
        let bundle = Bundle::new(of);
        hierarchy.meeting(&shaft(places, rays, light), &mut pending, &mut candidates);
        shade(&bundle, &candidates, &occluders.list, &mut chunk.met, shades);
        chunk.met_ends.push(chunk.met.len() as u32);
        chunk.bundles.push(bundle);
    }
    (chunk, shades)
}

/// What holds the rays at `places` all the way to the light.
fn shaft(places: &[u32], rays: &[LightRay], light: &Light) -> Shaft {
    // A start that is no number meets nothing itself; it must not take its neighbours along.
    let starts = places.iter().map(|&place| rays[place as usize].origin);
    let starts = starts.filter(|start| start.is_finite());
    let (low, high) = starts.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), start| {
        (low.min(start), high.max(start))
    });
    let centre = 0.5 * (low + high);
    let (direction, length) = light.seen_from(centre);
    Shaft {
        centre,
        half: 0.5 * (high - low),
        direction,
        length,
    }
}

/// What the bundles of a chunk say to the Gaussians they met.
fn said(chunk: &Chunk, d_log: &[f32], occluders: &Occluders) -> Vec<(u32, Moments)> {
    let mut records = Vec::with_capacity(chunk.met.len());
    for (number, (bundle, values)) in chunk.bundles.iter().zip(d_log.chunks(BUNDLE)).enumerate() {
        if values.iter().all(|&d| d == 0.0) {
            continue;
        }
        let mut lanes: [Lane; BLOCKS] = [[0.0; LANES]; BLOCKS];
        for (slot, value) in lanes.as_flattened_mut().iter_mut().zip(values) {
            *slot = *value;
        }
        listen(bundle, &lanes, chunk.met_of(number), &occluders.list, &mut records);
    }
    records
}

/// What was said, by ranges of occluders, in its order within each.
struct Records {
    starts: Vec<u32>,
    sorted: Vec<(u32, Moments)>,
}

impl Records {
    fn sorted(records: &[(u32, Moments)], ranges: usize) -> Self {
        let range = |id: u32| id as usize / RANGE;
        let mut starts = vec![0u32; ranges + 1];
        for (id, _) in records {
            starts[range(*id) + 1] += 1;
        }
        for number in 0..ranges {
            starts[number + 1] += starts[number];
        }
        let mut cursor = starts.clone();
        let mut sorted = vec![(0, Moments::default()); records.len()];
        for record in records {
            let place = &mut cursor[range(record.0)];
            sorted[*place as usize] = *record;
            *place += 1;
        }
        Self { starts, sorted }
    }

    fn of(&self, range: usize) -> &[(u32, Moments)] {
        &self.sorted[self.starts[range] as usize..self.starts[range + 1] as usize]
    }
}

/// With `W = S⁻¹Rᵀ` and `n` the nearest point of a ray in the whitened space: `∂/∂p = Wᵀ Σhn`, `∂/∂ ln s_k = Σ h n_k²`, and
/// `∂/∂R = Wᵀ (Σ h n nᵀ) S` up to what a rotation cannot follow.
fn of_gaussian(gaussians: &Table, occluder: &Occluder, id: usize, moments: &Moments) -> CoreGradient {
    let [nx, ny, nz, xx, xy, xz, yy, yz, zz] = moments.sums;
    let back = occluder.whiten().transpose();
    let square = Mat3::from_cols(Vec3::new(xx, xy, xz), Vec3::new(xy, yy, yz), Vec3::new(xz, yz, zz));
    let d_rotation = back * square * Mat3::from_diagonal(occluder.scale);
    CoreGradient {
        position: back * Vec3::new(nx, ny, nz),
        log_scale: Vec3::new(xx, yy, zz),
        rotation: rotation_backward(gaussians.raw_rotation(id), d_rotation),
        // h is ∂L/∂ ln α̃ = ∂L/∂ ln o, and do/dlogit = o (1 - o).
        opacity: moments.h * (1.0 - occluder.opacity),
    }
}
