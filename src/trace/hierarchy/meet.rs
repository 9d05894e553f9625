//! The inner loops of the hierarchy: a bundle of rays past one Gaussian after another.

use crate::simd::prefetch;
use crate::trace::bvh::Occluder;
use crate::trace::light_ray::LightRay;
use crate::trace::transmittance::{Shade, attenuation};
use crate::vectorised;
use glam::{Mat3, Vec3};

/// Rays that are worked on together.
pub(super) const LANES: usize = 8;
/// The same, in a bundle.
pub(super) const BLOCKS: usize = 1;
/// Rays that walk the hierarchy together.
pub(super) const BUNDLE: usize = BLOCKS * LANES;
/// Gaussians ahead of which the next are asked for.
const AHEAD: usize = 8;

pub(super) type Lane = [f32; LANES];

/// Eight rays, number by number.
#[derive(Clone, Copy)]
struct Block {
    origin: [Lane; 3],
    direction: [Lane; 3],
    /// Peaks count between these distances along the ray, metres.
    near: Lane,
    far: Lane,
    /// One over the distance to the light, zero where it is infinitely far.
    turning: Lane,
    id: [u32; LANES],
}

/// Neighbouring rays.
pub(super) struct Bundle {
    blocks: [Block; BLOCKS],
}

impl Bundle {
    /// Up to [`BUNDLE`] rays and the Gaussians they start from; what is missing meets nothing.
    pub(super) fn new<'r>(ray: impl Fn(usize) -> Option<(&'r LightRay, u32)>) -> Self {
        let block = |number: usize| {
            let rays: [_; LANES] = std::array::from_fn(|l| ray(number * LANES + l));
            let of = |value: fn(&LightRay) -> f32, missing: f32| rays.map(|r| r.map_or(missing, |(ray, _)| value(ray)));
            Block {
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
                turning: of(|r| 1.0 / r.length.max(1e-12), 0.0),
                id: rays.map(|r| r.map_or(u32::MAX, |(_, id)| id)),
            }
        };
        Self {
            blocks: std::array::from_fn(block),
        }
    }
}

/// Eight rays past a Gaussian: the nearest points of those that meet it, in its whitened space.
struct Pass {
    nearest: [Lane; 3],
    square: Lane,
    /// How far along the ray they are, as a share of the way to the light.
    share: Lane,
    met: [u32; LANES],
}

impl Pass {
    #[inline(always)]
    fn new(block: &Block, occluder: &Occluder, w: &Mat3, id: u32) -> Self {
        let p = occluder.position;
        let mut pass = Self {
            nearest: [[0.0; LANES]; 3],
            square: [0.0; LANES],
            share: [0.0; LANES],
            met: [0; LANES],
        };
        for l in 0..LANES {
            let offset = [
                block.origin[0][l] - p.x,
                block.origin[1][l] - p.y,
                block.origin[2][l] - p.z,
            ];
            let along = [block.direction[0][l], block.direction[1][l], block.direction[2][l]];
            let whitened = |v: [f32; 3]| {
                [
                    w.x_axis.x * v[0] + w.y_axis.x * v[1] + w.z_axis.x * v[2],
                    w.x_axis.y * v[0] + w.y_axis.y * v[1] + w.z_axis.y * v[2],
                    w.x_axis.z * v[0] + w.y_axis.z * v[1] + w.z_axis.z * v[2],
                ]
            };
            // First to where the ray passes the centre in the scene, then on from there in whitened space: a thin Gaussian far away
            // would make small differences of large numbers of the way there. Errors along the ray do no harm, they move the foot.
            let foot = -(along[0] * offset[0] + along[1] * offset[1] + along[2] * offset[2]);
            let beside = [
                offset[0] + along[0] * foot,
                offset[1] + along[1] * foot,
                offset[2] + along[2] * foot,
            ];
            let (e, d) = (whitened(beside), whitened(along));
            let dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            let further = -(e[0] * d[0] + e[1] * d[1] + e[2] * d[2]) / dd;
            let peak = foot + further;
            let n = [e[0] + d[0] * further, e[1] + d[1] * further, e[2] + d[2] * further];
            let square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
            // Written so that a NaN counts as a miss.
            let near_enough = (square < occluder.reach_square) & (peak > block.near[l]) & (peak < block.far[l]);
            pass.met[l] = u32::from(near_enough & (block.id[l] != id));
            pass.square[l] = square;
            pass.share[l] = peak * block.turning[l];
            for (axis, n) in pass.nearest.iter_mut().zip(n) {
                axis[l] = n;
            }
        }
        pass
    }

    #[inline(always)]
    fn met(&self) -> bool {
        self.met != [0; LANES]
    }
}

/// What eight rays met.
#[derive(Clone, Copy)]
struct ShadeLanes {
    clear: Lane,
    pull: [Lane; 3],
    turn: [Lane; 3],
    hits: [u32; LANES],
}

impl ShadeLanes {
    const NOTHING: Self = Self {
        clear: [1.0; LANES],
        pull: [[0.0; LANES]; 3],
        turn: [[0.0; LANES]; 3],
        hits: [0; LANES],
    };

    #[inline(always)]
    fn add(&mut self, pass: &Pass, opacity: f32, w: &Mat3) {
        for l in 0..LANES {
            let (alpha, weight) = attenuation(opacity, pass.square[l], pass.met[l]);
            self.clear[l] *= 1.0 - alpha;
            self.hits[l] += pass.met[l];
            let n = [pass.nearest[0][l], pass.nearest[1][l], pass.nearest[2][l]];
            let axes = [w.x_axis, w.y_axis, w.z_axis];
            for ((pull, turn), axis) in self.pull.iter_mut().zip(&mut self.turn).zip(axes) {
                let along = weight * (axis.x * n[0] + axis.y * n[1] + axis.z * n[2]);
                pull[l] += along;
                turn[l] += pass.share[l] * along;
            }
        }
    }
}

vectorised! {
    /// Lets a bundle pass the Gaussians `candidates` of `list`: appends those that some ray met to `met`, and fills `out`.
    pub(super) fn shade(bundle: &Bundle, candidates: &[u32], list: &[Occluder], met: &mut Vec<u32>, out: &mut [Shade]) {
        let mut sums = [ShadeLanes::NOTHING; BLOCKS];
        for (number, &id) in candidates.iter().enumerate() {
            if let Some(&next) = candidates.get(number + AHEAD) {
                prefetch(list, next as usize);
            }
            let occluder = &list[id as usize];
            let whiten = occluder.whiten();
            let mut any = false;
            for (block, sums) in bundle.blocks.iter().zip(&mut sums) {
                let pass = Pass::new(block, occluder, &whiten, id);
                if pass.met() {
                    any = true;
                    sums.add(&pass, occluder.opacity, &whiten);
                }
            }
            if any {
                met.push(id);
            }
        }
        for (place, out) in out.iter_mut().enumerate() {
            let (sums, l) = (&sums[place / LANES], place % LANES);
            *out = Shade {
                clear: sums.clear[l],
                pull: Vec3::new(sums.pull[0][l], sums.pull[1][l], sums.pull[2][l]),
                turn: Vec3::new(sums.turn[0][l], sums.turn[1][l], sums.turn[2][l]),
                hits: sums.hits[l],
            };
        }
    }
}

/// What rays say to a Gaussian they met: sums with `h = ∂L/∂(-½‖n‖²)`, `n` their nearest points in its whitened space.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    /// `Σh`.
    pub(super) h: f32,
    /// `Σ h n`: x, y, z; `Σ h n nᵀ`: xx, xy, xz, yy, yz, zz.
    pub(super) sums: [f32; 9],
}

impl Moments {
    pub(super) fn add(&mut self, other: &Self) {
        self.h += other.h;
        for (sum, value) in self.sums.iter_mut().zip(other.sums) {
            *sum += value;
        }
    }
}

vectorised! {
    /// What a bundle says to the Gaussians it met, given the gradient `d_log` to the logarithm of each ray's transmittance.
    pub(super) fn listen(
        bundle: &Bundle,
        d_log: &[Lane; BLOCKS],
        met: &[u32],
        list: &[Occluder],
        out: &mut Vec<(u32, Moments)>,
    ) {
        for (number, &id) in met.iter().enumerate() {
            if let Some(&next) = met.get(number + AHEAD) {
                prefetch(list, next as usize);
            }
            let occluder = &list[id as usize];
            let whiten = occluder.whiten();
            let mut lanes = [[0.0; LANES]; 10];
            for (block, d_log) in bundle.blocks.iter().zip(d_log) {
                let pass = Pass::new(block, occluder, &whiten, id);
                if pass.met() {
                    hear(&pass, occluder.opacity, d_log, &mut lanes);
                }
            }
            let [h, sums @ ..] = lanes.map(|lane| lane.iter().sum::<f32>());
            out.push((id, Moments { h, sums }));
        }
    }
}

#[inline(always)]
fn hear(pass: &Pass, opacity: f32, d_log: &Lane, sums: &mut [Lane; 10]) {
    let [x, y, z] = &pass.nearest;
    for l in 0..LANES {
        let (_, weight) = attenuation(opacity, pass.square[l], pass.met[l]);
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
