//! Transmittance toward any light, by the bounding volume hierarchy: bundles of neighbouring rays traverse it together.
//!
//! Forward, a bundle of eight rays lists the Gaussians whose bounds its shaft intersects, tests all its rays against
//! each of them (`bundle`), and keeps those that some ray hit. Backward, every bundle visits the Gaussians it hit again
//! and sums the contributions of its rays to one record per Gaussian; the records are sorted by ranges of Gaussians and
//! added in the order of the bundles. No sum is shared between threads, so results do not depend on their number.

mod bundle;

use super::bvh::{Hierarchy, Occluder, Occluders, Shaft};
use super::light_ray::LightRay;
use super::occlusion::{RayGradients, RayTransmittance};
use crate::gaussians::{Core, Table, rotation_backward};
use crate::light::Light;
use bundle::{BUNDLE, Bundle, Lane, Moments, gather_gradients, trace_bundle};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Bundles per parallel job; fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 32;
/// Occluders per parallel job of the backward pass.
const RANGE: usize = 2048;

/// Rays in bundles, and the Gaussians each bundle hit.
pub(super) struct HierarchyTrace {
    /// Places of the rays among the origins, neighbours together, [`BUNDLE`] to a bundle.
    order: Vec<u32>,
    chunks: Vec<Chunk>,
}

/// Consecutive bundles and their hits.
struct Chunk {
    bundles: Vec<Bundle>,
    /// End of each bundle's hits in `hits`; they begin at the end of the previous bundle's.
    hit_ends: Vec<u32>,
    hits: Vec<u32>,
}

impl Chunk {
    fn hits_of(&self, bundle: usize) -> &[u32] {
        let start = if bundle == 0 { 0 } else { self.hit_ends[bundle - 1] };
        &self.hits[start as usize..self.hit_ends[bundle] as usize]
    }
}

/// Places of `origins` such that neighbours in the scene are neighbours.
fn by_neighbourhood(origins: &[u32], hierarchy: &Hierarchy) -> Vec<u32> {
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
    /// Traces `rays`, which start from the Gaussians `origins`, toward `light` past all occluders; also returns the
    /// result of each ray.
    pub(super) fn new(
        occluders: &Occluders,
        light: &Light,
        rays: &[LightRay],
        origins: &[u32],
    ) -> (Self, Vec<RayTransmittance>) {
        let hierarchy = occluders.hierarchy();
        let order = by_neighbourhood(origins, hierarchy);
        let (chunks, results): (Vec<Chunk>, Vec<Vec<RayTransmittance>>) = order
            .par_chunks(CHUNK * BUNDLE)
            .map(|places| trace_chunk(occluders, light, (rays, origins, places)))
            .unzip();
        let mut in_place = vec![RayTransmittance::default(); rays.len()];
        for (&place, result) in order.iter().zip(results.iter().flatten()) {
            in_place[place as usize] = *result;
        }
        (Self { order, chunks }, in_place)
    }

    /// Adds the gradients of the occluders to `out`.
    pub(super) fn backward(&self, gaussians: &Table, occluders: &Occluders, gradients: &RayGradients, out: &mut Table) {
        let ranges = gaussians.count.div_ceil(RANGE);
        let records: Vec<ContributionsByRange> = self
            .chunks
            .par_iter()
            .zip(self.order.par_chunks(CHUNK * BUNDLE))
            .map(|(chunk, places)| {
                let d_log: Vec<f32> = places.iter().map(|&place| gradients.d_log[place as usize]).collect();
                ContributionsByRange::new(&contributions(chunk, &d_log, occluders), ranges)
            })
            .collect();
        out.add_core_by_range(RANGE, |range, add| {
            let mut sums = vec![Moments::default(); RANGE];
            for (id, moments) in records.iter().flat_map(|records| records.of(range)) {
                sums[*id as usize % RANGE].add(moments);
            }
            for (index, moments) in sums.iter().enumerate().filter(|(_, moments)| moments.h != 0.0) {
                let id = range * RANGE + index;
                add(index, &core_gradient(gaussians, &occluders.list[id], id, moments));
            }
        });
    }
}

fn trace_chunk(
    occluders: &Occluders,
    light: &Light,
    (rays, origins, places): (&[LightRay], &[u32], &[u32]),
) -> (Chunk, Vec<RayTransmittance>) {
    let hierarchy = occluders.hierarchy();
    let mut chunk = Chunk {
        bundles: Vec::with_capacity(CHUNK),
        hit_ends: Vec::with_capacity(CHUNK),
        hits: Vec::new(),
    };
    let mut results = vec![RayTransmittance::default(); places.len()];
    let (mut stack, mut candidates) = (Vec::new(), Vec::new());
    for (places, results) in places.chunks(BUNDLE).zip(results.chunks_mut(BUNDLE)) {
        let of = |l: usize| places.get(l).map(|&p| (&rays[p as usize], origins[p as usize]));
        let bundle = Bundle::new(of);
        hierarchy.intersecting(&shaft(places, rays, light), &mut stack, &mut candidates);
        trace_bundle(&bundle, &candidates, &occluders.list, &mut chunk.hits, results);
        chunk.hit_ends.push(chunk.hits.len() as u32);
        chunk.bundles.push(bundle);
    }
    (chunk, results)
}

/// The shaft around the rays at `places`, all the way to the light.
fn shaft(places: &[u32], rays: &[LightRay], light: &Light) -> Shaft {
    // An origin that is not finite hits nothing itself; it must not widen the shaft of its neighbours.
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

/// Contributions of the bundles of a chunk to the gradients of the Gaussians they hit, bundle after bundle.
fn contributions(chunk: &Chunk, d_log: &[f32], occluders: &Occluders) -> Vec<(u32, Moments)> {
    let mut records = Vec::with_capacity(chunk.hits.len());
    for (number, (bundle, values)) in chunk.bundles.iter().zip(d_log.chunks(BUNDLE)).enumerate() {
        if values.iter().all(|&d| d == 0.0) {
            continue;
        }
        let mut lanes: Lane = [0.0; BUNDLE];
        lanes[..values.len()].copy_from_slice(values);
        gather_gradients(bundle, &lanes, chunk.hits_of(number), &occluders.list, &mut records);
    }
    records
}

/// Contributions sorted by ranges of occluders, within each in the order in which they were made.
struct ContributionsByRange {
    starts: Vec<u32>,
    records: Vec<(u32, Moments)>,
}

impl ContributionsByRange {
    fn new(records: &[(u32, Moments)], ranges: usize) -> Self {
        let range = |id: u32| id as usize / RANGE;
        let mut starts = vec![0u32; ranges + 1];
        for (id, _) in records {
            starts[range(*id) + 1] += 1;
        }
        for number in 0..ranges {
            starts[number + 1] += starts[number];
        }
        let mut cursor = starts.clone();
        let mut ordered = vec![(0, Moments::default()); records.len()];
        for record in records {
            let place = &mut cursor[range(record.0)];
            ordered[*place as usize] = *record;
            *place += 1;
        }
        Self {
            starts,
            records: ordered,
        }
    }

    fn of(&self, range: usize) -> &[(u32, Moments)] {
        &self.records[self.starts[range] as usize..self.starts[range + 1] as usize]
    }
}

/// Gradient of a Gaussian from its moments: with `W = S⁻¹Rᵀ` and `n` the nearest point of a ray in the whitened space:
/// `∂/∂p = Wᵀ Σhn`, `∂/∂ ln s_k = Σ h n_k²`, and `∂/∂R = Wᵀ (Σ h n nᵀ) S` up to components normal to the rotations.
fn core_gradient(gaussians: &Table, occluder: &Occluder, id: usize, moments: &Moments) -> Core {
    let [nx, ny, nz, xx, xy, xz, yy, yz, zz] = moments.sums;
    let gradients = occluder.whiten().transpose();
    let square = Mat3::from_cols(Vec3::new(xx, xy, xz), Vec3::new(xy, yy, yz), Vec3::new(xz, yz, zz));
    let d_rotation = gradients * square * Mat3::from_diagonal(occluder.scale);
    Core {
        position: gradients * Vec3::new(nx, ny, nz),
        log_scale: Vec3::new(xx, yy, zz),
        rotation: rotation_backward(gaussians.raw_rotation(id), d_rotation),
        // h is ∂L/∂ ln α̃ = ∂L/∂ ln o, and do/dlogit = o (1 - o).
        opacity: moments.h * (1.0 - occluder.opacity),
    }
}
