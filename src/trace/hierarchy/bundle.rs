//! The inner loops of the hierarchy: a bundle of rays against one Gaussian after another, forward and backward.

use crate::simd::prefetch;
use crate::trace::bvh::Occluder;
use crate::trace::light_ray::LightRay;
use crate::trace::occlusion::{RayTransmittance, attenuation};
use crate::vectorised;
use glam::{Mat3, Vec3};

/// Number of rays of a bundle, which traverse the hierarchy together.
pub(super) const BUNDLE: usize = 8;
/// Distance of prefetching, in Gaussians.
const AHEAD: usize = 8;

/// One number for each ray of a bundle.
pub(super) type Lane = [f32; BUNDLE];

/// Neighbouring rays, as a structure of arrays.
#[derive(Clone, Copy)]
pub(super) struct Bundle {
    origin: [Lane; 3],
    direction: [Lane; 3],
    /// Peaks count between these distances along the ray, metres.
    near: Lane,
    far: Lane,
    /// One over the distance to the light, 1/m; zero where it is infinitely far.
    inverse_length: Lane,
    /// The Gaussian that each ray starts from.
    id: [u32; BUNDLE],
}

impl Bundle {
    /// Up to [`BUNDLE`] rays and the Gaussians they start from; missing rays hit nothing.
    pub(super) fn new<'r>(ray: impl Fn(usize) -> Option<(&'r LightRay, u32)>) -> Self {
        let rays: [_; BUNDLE] = std::array::from_fn(ray);
        let of = |value: fn(&LightRay) -> f32, missing: f32| rays.map(|r| r.map_or(missing, |(ray, _)| value(ray)));
        Self {
            origin: [
                of(|r| r.origin.x, 0.0),
                of(|r| r.origin.y, 0.0),
                of(|r| r.origin.z, 0.0),
            ],
            direction: [
                of(|r| r.direction.x, 0.0),
                of(|r| r.direction.y, 0.0),
                of(|r| r.direction.z, 1.0),
            ],
            near: of(|r| r.bias, f32::INFINITY),
            far: of(|r| r.length, 0.0),
            inverse_length: of(|r| 1.0 / r.length.max(1e-12), 0.0),
            id: rays.map(|r| r.map_or(u32::MAX, |(_, id)| id)),
        }
    }
}

/// The points of the rays of a bundle that are closest to a Gaussian, in its whitened space, and which of the rays hit
/// it.
struct ClosestPoints {
    nearest: [Lane; 3],
    square: Lane,
    /// Distances of the points along their rays, as shares of the way to the light.
    share: Lane,
    hit: [u32; BUNDLE],
}

impl ClosestPoints {
    #[inline(always)]
    fn new(bundle: &Bundle, occluder: &Occluder, w: &Mat3, id: u32) -> Self {
        let p = occluder.position;
        let mut closest = Self {
            nearest: [[0.0; BUNDLE]; 3],
            square: [0.0; BUNDLE],
            share: [0.0; BUNDLE],
            hit: [0; BUNDLE],
        };
        for l in 0..BUNDLE {
            let offset = [
                bundle.origin[0][l] - p.x,
                bundle.origin[1][l] - p.y,
                bundle.origin[2][l] - p.z,
            ];
            let along = [bundle.direction[0][l], bundle.direction[1][l], bundle.direction[2][l]];
            let whitened = |v: [f32; 3]| {
                [
                    w.x_axis.x * v[0] + w.y_axis.x * v[1] + w.z_axis.x * v[2],
                    w.x_axis.y * v[0] + w.y_axis.y * v[1] + w.z_axis.y * v[2],
                    w.x_axis.z * v[0] + w.y_axis.z * v[1] + w.z_axis.z * v[2],
                ]
            };
            // First to the point of the ray nearest the centre in the scene, then on from there in whitened space: for
            // a thin Gaussian far away, a single step would lose the small differences of large numbers. Errors along
            // the ray are harmless, they move the foot.
            let foot = -(along[0] * offset[0] + along[1] * offset[1] + along[2] * offset[2]);
            let nearest = [
                offset[0] + along[0] * foot,
                offset[1] + along[1] * foot,
                offset[2] + along[2] * foot,
            ];
            let (e, d) = (whitened(nearest), whitened(along));
            let dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            let further = -(e[0] * d[0] + e[1] * d[1] + e[2] * d[2]) / dd;
            let peak = foot + further;
            let n = [e[0] + d[0] * further, e[1] + d[1] * further, e[2] + d[2] * further];
            let square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
            // Written so that NaN counts as a miss.
            let near_enough = (square < occluder.reach_square) & (peak > bundle.near[l]) & (peak < bundle.far[l]);
            closest.hit[l] = u32::from(near_enough & (bundle.id[l] != id));
            closest.square[l] = square;
            closest.share[l] = peak * bundle.inverse_length[l];
            for (axis, n) in closest.nearest.iter_mut().zip(n) {
                axis[l] = n;
            }
        }
        closest
    }

    #[inline(always)]
    fn any_hit(&self) -> bool {
        self.hit != [0; BUNDLE]
    }
}

/// Results of the rays of a bundle so far.
#[derive(Clone, Copy)]
struct RayLanes {
    value: Lane,
    d_origin: [Lane; 3],
    d_turn: [Lane; 3],
    hits: [u32; BUNDLE],
}

impl RayLanes {
    const EMPTY: Self = Self {
        value: [1.0; BUNDLE],
        d_origin: [[0.0; BUNDLE]; 3],
        d_turn: [[0.0; BUNDLE]; 3],
        hits: [0; BUNDLE],
    };

    #[inline(always)]
    fn add(&mut self, closest: &ClosestPoints, opacity: f32, w: &Mat3) {
        for l in 0..BUNDLE {
            let (alpha, weight) = attenuation(opacity, closest.square[l], closest.hit[l]);
            self.value[l] *= 1.0 - alpha;
            self.hits[l] += closest.hit[l];
            let n = [closest.nearest[0][l], closest.nearest[1][l], closest.nearest[2][l]];
            let axes = [w.x_axis, w.y_axis, w.z_axis];
            for ((d_origin, d_turn), axis) in self.d_origin.iter_mut().zip(&mut self.d_turn).zip(axes) {
                let along = weight * (axis.x * n[0] + axis.y * n[1] + axis.z * n[2]);
                d_origin[l] += along;
                d_turn[l] += closest.share[l] * along;
            }
        }
    }
}

vectorised! {
    /// Traces a bundle past the Gaussians `candidates` of `list`: fills `out`, and appends the Gaussians that some ray
    /// hit to `hit`.
    pub(super) fn trace_bundle(bundle: &Bundle, candidates: &[u32], list: &[Occluder], hit: &mut Vec<u32>, out: &mut [RayTransmittance]) {
        let mut sums = RayLanes::EMPTY;
        for (number, &id) in candidates.iter().enumerate() {
            if let Some(&next) = candidates.get(number + AHEAD) {
                prefetch(list, next as usize);
            }
            let occluder = &list[id as usize];
            let whiten = occluder.whiten();
            let closest = ClosestPoints::new(bundle, occluder, &whiten, id);
            if closest.any_hit() {
                sums.add(&closest, occluder.opacity, &whiten);
                hit.push(id);
            }
        }
        for (l, out) in out.iter_mut().enumerate() {
            *out = RayTransmittance {
                value: sums.value[l],
                d_origin: Vec3::new(sums.d_origin[0][l], sums.d_origin[1][l], sums.d_origin[2][l]),
                d_turn: Vec3::new(sums.d_turn[0][l], sums.d_turn[1][l], sums.d_turn[2][l]),
                hits: sums.hits[l],
            };
        }
    }
}

/// Contributions of rays to the gradient of a Gaussian they hit: sums with `h = ∂L/∂(-½‖n‖²)`, `n` their nearest points
/// in its whitened space.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    /// Sum `Σh`.
    pub(super) h: f32,
    /// Sums `Σ h n`: x, y, z; `Σ h n nᵀ`: xx, xy, xz, yy, yz, zz.
    pub(super) sums: [f32; 9],
}

impl Moments {
    /// Adds the contributions of other rays.
    pub(super) fn add(&mut self, other: &Self) {
        self.h += other.h;
        for (sum, value) in self.sums.iter_mut().zip(other.sums) {
            *sum += value;
        }
    }
}

vectorised! {
    /// Backward of [`trace_bundle`]: appends the contributions to each of the Gaussians `hit`, given the gradient
    /// `d_log` to the logarithm of each ray's transmittance.
    pub(super) fn gather_gradients(
        bundle: &Bundle,
        d_log: &Lane,
        hit: &[u32],
        list: &[Occluder],
        out: &mut Vec<(u32, Moments)>,
    ) {
        for (number, &id) in hit.iter().enumerate() {
            if let Some(&next) = hit.get(number + AHEAD) {
                prefetch(list, next as usize);
            }
            let occluder = &list[id as usize];
            let whiten = occluder.whiten();
            let mut lanes = [[0.0; BUNDLE]; 10];
            let closest = ClosestPoints::new(bundle, occluder, &whiten, id);
            if closest.any_hit() {
                add_contributions(&closest, occluder.opacity, d_log, &mut lanes);
            }
            let [h, sums @ ..] = lanes.map(|lane| lane.iter().sum::<f32>());
            out.push((id, Moments { h, sums }));
        }
    }
}

/// Adds the contributions of the rays of a bundle to one Gaussian, lane by lane.
#[inline(always)]
fn add_contributions(closest: &ClosestPoints, opacity: f32, d_log: &Lane, sums: &mut [Lane; 10]) {
    let [x, y, z] = &closest.nearest;
    for l in 0..BUNDLE {
        let (_, weight) = attenuation(opacity, closest.square[l], closest.hit[l]);
        let h = -d_log[l] * weight;
        let (hx, hy, hz) = (h * x[l], h * y[l], h * z[l]);
        sums[0][l] += h;
        sums[1][l] += hx;
        sums[2][l] += hy;
        sums[3][l] += hz;
        sums[4][l] += hx * x[l];
        sums[5][l] += hx * y[l];
        sums[6][l] += hx * z[l];
        sums[7][l] += hy * y[l];
        sums[8][l] += hy * z[l];
        sums[9][l] += hz * z[l];
    }
}
