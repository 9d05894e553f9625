//! Transmittance from Gaussians to a light, and its gradients.
//!
//! Toward the light, in the direction `r` from the centre of Gaussian 0, every Gaussian `i` whose 1-D density along the
//! ray peaks beyond the self-shadow bias absorbs `α̃_i = o_i exp(-½ ‖e×d‖²/‖d‖²)` (whitened offset `e` and direction
//! `d`), and `S = Π (1 - α̃_i)`. The product has no order, so nothing is sorted (ShadowGS, Luo et al. 2026, eq. 10–12).
//! A ray with less than a millionth left counts as dark, with value zero and no gradients.
//!
//! `light_ray` defines the start of a ray and the self-shadow bias. `hierarchy` finds the Gaussians on a ray for any
//! light, `sun_plane` for parallel light in two thirds of the time. Both agree to 0.002 in transmittance.

use super::bvh::{Occluders, SunVisibility};
use super::hierarchy::HierarchyTrace;
use super::light_ray::LightRay;
use super::occlusion::{RayGradients, RayTransmittance};
use super::sun_plane::SunPlaneTrace;
use crate::gaussians::{Core, Table};
use crate::light::Light;
use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use rayon::prelude::*;

/// Transmittance below which a ray is dark: its value is zero, and it has no gradients. They would be below
/// `TRANSMITTANCE_MIN / (1 - ALPHA_MAX)`, a ten-thousandth.
const TRANSMITTANCE_MIN: f32 = 1e-6;
/// Rays per parallel job; fixed, because each job draws its own sample.
const CHUNK: usize = 1024;
/// Gradients from this share of the mean one on are always in a sample. With the whole mean the backward pass takes a
/// sixth less time, and cityB errs by half a per cent more (docs/lab/speed.md).
const SURE_FROM: f32 = 0.5;

/// Transmittances of some Gaussians toward one light, and the inputs of the backward pass.
#[derive(Default)]
pub struct Transmittance {
    /// Transmittance of each origin, 0 to 1.
    pub values: Vec<f32>,
    /// The light that was traced; `None` where none was. Rays are not kept: they are made anew where gradients go back
    /// along them.
    light: Option<Light>,
    /// Gradient of the logarithm of each value to the ray's origin, 1/m.
    d_origin: Vec<Vec3>,
    /// Gradient of the origin through the change in ray direction, see
    /// [`RayTransmittance`](super::occlusion::RayTransmittance); empty for parallel light.
    d_turn: Vec<Vec3>,
    /// Gaussians hit by all rays together; without any the backward pass has no work.
    hits: u64,
    finder: Finder,
}

/// Rays that carry gradients to the occluders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OccluderGradients {
    /// None: gradients reach only the origins of the rays.
    None,
    /// All rays.
    All,
    /// A sample with the gradients of all rays as its expectation (Russian roulette, Arvo and Kirk 1990). A ray whose
    /// gradient, to the logarithm of its transmittance, is smaller than half of the mean one is kept with the
    /// probability of their ratio, and then counts as that half. Many rays have such small gradients, among them nearly
    /// all in deep shade, which meet the most Gaussians. Only parallel light is sampled; point lights take all rays.
    Sampled {
        /// Seed of the sample.
        seed: u64,
    },
}

/// The tracer that found the Gaussians on the rays, for the backward pass.
#[derive(Default)]
enum Finder {
    #[default]
    Nothing,
    SunPlane(SunPlaneTrace),
    Hierarchy(HierarchyTrace),
}

impl Transmittance {
    /// Transmittances from the results of all rays.
    fn of(traced_rays: &[RayTransmittance], light: Light, finder: Finder) -> Self {
        let all = || traced_rays.par_iter().with_min_len(CHUNK);
        let dark = RayTransmittance::default();
        let seen = |ray: &'_ RayTransmittance| if ray.value >= TRANSMITTANCE_MIN { *ray } else { dark };
        let (values, d_origin) = all().map(seen).map(|ray| (ray.value, ray.d_origin)).unzip();
        let d_turn = match light {
            Light::Directional(_) => Vec::new(),
            Light::Point(_) => all().map(seen).map(|ray| ray.d_turn).collect(),
        };
        Self {
            values,
            light: Some(light),
            d_origin,
            d_turn,
            hits: all().map(|ray| u64::from(ray.hits)).sum(),
            finder,
        }
    }
}

/// Transmittance of the Gaussians `origins` toward `light` through all of `occluders`: parallel light by their
/// [`SunVisibility`], point lights by the bounding volume hierarchy.
pub fn transmittance(occluders: &Occluders, origins: &[u32], light: &Light) -> Transmittance {
    if let (Light::Directional(direction), SunVisibility::Plane) = (light, occluders.sun_visibility) {
        let trace = SunPlaneTrace::new(occluders, *direction);
        let traced_rays = trace.trace(occluders, origins);
        return Transmittance::of(&traced_rays, *light, Finder::SunPlane(trace));
    }
    let rays = origins.par_iter().with_min_len(CHUNK);
    let rays: Vec<LightRay> = rays
        .map(|&origin| LightRay::new(&occluders.list[origin as usize], light))
        .collect();
    let (trace, traced_rays) = HierarchyTrace::new(occluders, light, &rays, origins);
    Transmittance::of(&traced_rays, *light, Finder::Hierarchy(trace))
}

impl Transmittance {
    /// Adds the gradients of the parameters of origins, and of the occluders selected by `which`, from those of the
    /// transmittances (`grads`, one per origin). `occluders` and `origins` are those of the forward pass, `gaussians`
    /// the Gaussians that the occluders were made of.
    pub fn backward(
        &self,
        gaussians: &Table,
        (occluders, which): (&Occluders, OccluderGradients),
        origins: &[u32],
        grads: &[f32],
        out: &mut Table,
    ) {
        let Some(light) = self.light.filter(|_| self.hits > 0) else {
            return;
        };
        let d_log = self.to_logarithms(grads);
        self.origins_backward(gaussians, (occluders, &light), origins, &d_log, out);
        let d_log = match (which, light) {
            (OccluderGradients::None, _) => return,
            (OccluderGradients::Sampled { seed }, Light::Directional(_)) => sampled(&d_log, seed),
            _ => d_log,
        };
        let gradients_back = RayGradients { origins, d_log: &d_log };
        match &self.finder {
            Finder::Nothing => {}
            Finder::SunPlane(trace) => trace.backward(gaussians, occluders, &gradients_back, out),
            Finder::Hierarchy(trace) => trace.backward(gaussians, occluders, &gradients_back, out),
        }
    }

    /// Gradients to the logarithms of the values from those to the values; none for rays that met nothing.
    fn to_logarithms(&self, grads: &[f32]) -> Vec<f32> {
        let numbers = grads.par_iter().with_min_len(CHUNK).zip(&self.values);
        let d_log = |(g, &value): (&f32, &f32)| if value < 1.0 { g * value } else { 0.0 };
        numbers.map(d_log).collect()
    }

    fn origins_backward(
        &self,
        gaussians: &Table,
        (occluders, light): (&Occluders, &Light),
        origins: &[u32],
        d_log: &[f32],
        out: &mut Table,
    ) {
        let origin_gradient = |place: usize| {
            let origin = origins[place] as usize;
            let d_turn = self.d_turn.get(place).copied().unwrap_or_default();
            let (d_start, d_turning) = (self.d_origin[place] * d_log[place], d_turn * d_log[place]);
            if d_start == Vec3::ZERO {
                return Core::default();
            }
            LightRay::new(&occluders.list[origin], light).backward(d_start, d_turning, gaussians.raw_rotation(origin))
        };
        if origins.is_sorted_by(|a, b| a < b) {
            out.add_core(origins, origin_gradient);
        } else {
            // Origins in another order, or more than once: one after another.
            for (place, &origin) in origins.iter().enumerate() {
                out.add_core_to(origin as usize, &origin_gradient(place));
            }
        }
    }
}

/// Mean size of the gradients that are not zero; chunks are summed side by side, then in their order.
fn mean_size(gradients: &[f32]) -> f32 {
    let chunk_sum = |chunk: &[f32]| {
        chunk
            .iter()
            .filter(|d| **d != 0.0)
            .fold((0.0f64, 0u32), |(sum, n), d| (sum + f64::from(d.abs()), n + 1))
    };
    let sums: Vec<(f64, u32)> = gradients.par_chunks(CHUNK).map(chunk_sum).collect();
    let (sum, count) = sums.iter().fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    (sum / f64::from(count.max(1))) as f32
}

/// `gradient` where it is at least as large as `least`; else that size or zero, with `gradient` as the expectation.
fn russian_roulette(gradient: f32, least: f32, random: &mut Pcg32) -> f32 {
    let size = gradient.abs();
    if size >= least || size == 0.0 {
        gradient
    } else if random.random::<f32>() * least < size {
        least.copysign(gradient)
    } else {
        0.0
    }
}

/// A sample of gradients: large ones are kept, small ones drawn by Russian roulette.
fn sampled(gradients: &[f32], seed: u64) -> Vec<f32> {
    let least = SURE_FROM * mean_size(gradients);
    let mut sample = gradients.to_vec();
    sample.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, gradients)| {
        let mut random = Pcg32::seed_from_u64(seed.wrapping_mul(1_000_003) ^ chunk as u64);
        gradients
            .iter_mut()
            .for_each(|d| *d = russian_roulette(*d, least, &mut random));
    });
    sample
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, core_groups, logit};

    /// The two ways to trace parallel light.
    const WAYS: [SunVisibility; 2] = [SunVisibility::Plane, SunVisibility::Bvh];

    /// A horizontal sheet of overlapping flat discs, one metre apart, plus optional further discs.
    fn sheet(side: i32, spacing: f32, sigma: f32, thickness: f32) -> Table {
        let count = (side * side) as usize;
        let mut table = Table::zeros(core_groups(), count);
        for i in 0..count {
            let (x, y) = ((i as i32 % side - side / 2) as f32, (i as i32 / side - side / 2) as f32);
            table.group_mut(POSITION)[i * 3] = x * spacing;
            table.group_mut(POSITION)[i * 3 + 1] = y * spacing;
            table.group_mut(LOG_SCALE)[i * 3..i * 3 + 3].copy_from_slice(&[sigma.ln(), sigma.ln(), thickness.ln()]);
            table.group_mut(ROTATION)[i * 4 + 3] = 1.0;
            table.group_mut(OPACITY)[i] = logit(0.95);
        }
        table
    }

    fn sun(elevation_deg: f32) -> Light {
        let (s, c) = elevation_deg.to_radians().sin_cos();
        Light::Directional(Vec3::new(0.6 * c, 0.8 * c, s))
    }

    #[test]
    fn a_lit_plane_is_lit_at_every_elevation_and_size() {
        for (spacing, sigma, thickness) in [
            (0.5, 0.4, 0.05),
            (0.01, 0.01, 0.001),
            (30.0, 25.0, 2.0),
            (0.5, 0.6, 0.2),
        ] {
            let table = sheet(41, spacing, sigma, thickness);
            let occluders = Occluders::new(&table);
            let origins: Vec<u32> = (0..table.count as u32).collect();
            for elevation in [1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 35.0, 50.0, 70.0, 85.0, 90.0] {
                let traced = transmittance(&occluders, &origins, &sun(elevation));
                let least = traced.values.iter().copied().fold(1.0, f32::min);
                assert!(least >= 0.99, "elevation {elevation}, sigma {sigma}: {least}");
            }
        }
    }

    /// Discs scattered over a slab and turned every way.
    fn slab() -> Table {
        let mut table = sheet(25, 0.5, 0.4, 0.05);
        for i in 0..table.count {
            let h = |k: usize| ((i * 7919 + k * 104_729) % 1000) as f32 / 1000.0;
            table.group_mut(POSITION)[i * 3 + 2] = 12.0 * h(1);
            for k in 0..4 {
                table.group_mut(ROTATION)[i * 4 + k] = h(k + 2) - 0.5;
            }
            table.group_mut(OPACITY)[i] = 6.0 * h(7) - 3.0;
        }
        table
    }

    #[test]
    fn the_two_routes_meet_the_same_occluders() {
        let table = slab();
        let ways = WAYS.map(|way| Occluders::tracing_by(way, &table));
        let origins: Vec<u32> = (0..table.count as u32).collect();
        for elevation in [2.0, 35.0, 90.0] {
            let [plane, tree] = ways
                .each_ref()
                .map(|ways| transmittance(ways, &origins, &sun(elevation)));
            assert!(plane.hits > 1000);
            for (a, b) in plane.values.iter().zip(&tree.values) {
                assert!((a - b).abs() < 2e-3, "elevation {elevation}: {a} against {b}");
            }
        }
    }

    #[test]
    fn the_two_routes_give_the_same_gradients() {
        let table = slab();
        let origins: Vec<u32> = (0..table.count as u32).collect();
        let grads: Vec<f32> = origins.iter().map(|&o| ((o * 37) % 11) as f32 - 5.0).collect();
        let [plane, tree] = WAYS.map(|way| {
            let occluders = Occluders::tracing_by(way, &table);
            let traced = transmittance(&occluders, &origins, &sun(35.0));
            let mut out = table.zeros_like();
            traced.backward(&table, (&occluders, OccluderGradients::All), &origins, &grads, &mut out);
            out
        });
        for (a, b) in plane.groups.iter().zip(&tree.groups) {
            let size = a.values.iter().map(|v| v.abs()).fold(0.0, f32::max);
            let apart = a.values.iter().zip(&b.values).map(|(a, b)| (a - b).abs());
            let mean = apart.sum::<f32>() / a.values.len() as f32;
            assert!(size > 0.0 && mean < 1e-4 * size, "{}: {mean} of {size}", a.spec.name);
        }
    }

    #[test]
    fn sampled_rays_give_the_gradients_of_all_in_the_mean() {
        for way in WAYS {
            sampled_rays_give_the_gradients_of_all(way);
        }
    }

    fn sampled_rays_give_the_gradients_of_all(way: SunVisibility) {
        let table = slab();
        let occluders = Occluders::tracing_by(way, &table);
        let origins: Vec<u32> = (0..table.count as u32).collect();
        let grads: Vec<f32> = origins.iter().map(|&o| ((o * 37) % 11) as f32 - 3.0).collect();
        let traced = transmittance(&occluders, &origins, &sun(35.0));
        let opacities = |which: OccluderGradients| {
            let mut out = table.zeros_like();
            traced.backward(&table, (&occluders, which), &origins, &grads, &mut out);
            out.group(OPACITY).to_vec()
        };
        let all = opacities(OccluderGradients::All);
        let samples = 400;
        let mut mean = vec![0.0; all.len()];
        for seed in 0..samples {
            for (mean, d) in mean.iter_mut().zip(opacities(OccluderGradients::Sampled { seed })) {
                *mean += d / samples as f32;
            }
        }
        let apart = |other: &[f32]| all.iter().zip(other).map(|(a, b)| (a - b).abs()).sum::<f32>();
        let one = opacities(OccluderGradients::Sampled { seed: 7 });
        assert_ne!(one, all);
        assert_eq!(one, opacities(OccluderGradients::Sampled { seed: 7 }));
        // The error of a mean of n samples is that of one over the root of n.
        assert!(apart(&mean) < 0.1 * apart(&one), "{} and {}", apart(&mean), apart(&one));
        let size: f32 = all.iter().map(|d| d.abs()).sum();
        assert!(apart(&mean) < 0.04 * size, "{} of {size}", apart(&mean));
        assert!(opacities(OccluderGradients::None).iter().all(|&d| d == 0.0));
    }

    #[test]
    fn a_disc_overhead_casts_its_shadow_where_the_sun_says() {
        let mut table = sheet(21, 0.5, 0.4, 0.05);
        // Element 0 becomes an opaque disc of one metre, ten metres up over the origin.
        table.group_mut(POSITION)[..3].copy_from_slice(&[0.0, 0.0, 10.0]);
        table.group_mut(LOG_SCALE)[..3].copy_from_slice(&[0.0, 0.0, 0.05f32.ln()]);
        table.group_mut(OPACITY)[0] = logit(0.999);
        let occluders = Occluders::new(&table);
        let origins: Vec<u32> = (1..table.count as u32).collect();
        let light = Light::Directional(Vec3::new(0.0, 0.2, 1.0).normalize());
        let traced = transmittance(&occluders, &origins, &light);
        let value_at = |x: f32, y: f32| {
            let place = origins.iter().position(|&o| {
                let p = table.position(o as usize);
                (p.x - x).abs() < 0.01 && (p.y - y).abs() < 0.01
            });
            traced.values[place.expect("a disc of the sheet stands there")]
        };
        // The sun stands to the north, so the shadow falls two metres to the south.
        assert!(value_at(0.0, -2.0) < 0.05);
        assert!(value_at(0.0, 2.0) > 0.95);
    }

    #[test]
    fn a_ray_under_many_roofs_is_dark_and_has_no_gradients() {
        let mut table = sheet(1, 1.0, 5.0, 0.05).gather(&[0; 200]);
        for i in 0..table.count {
            table.group_mut(POSITION)[i * 3 + 2] = 5.0 * i as f32;
        }
        for way in WAYS {
            let occluders = Occluders::tracing_by(way, &table);
            let traced = transmittance(&occluders, &[0, 198], &sun(90.0));
            assert!(traced.values[0] == 0.0, "{:?}", traced.values);
            assert!((traced.values[1] - 0.05).abs() < 1e-4);
            let mut gradients = table.zeros_like();
            let all = (&occluders, OccluderGradients::All);
            traced.backward(&table, all, &[0, 198], &[1.0, 0.0], &mut gradients);
            assert!(
                gradients
                    .groups
                    .iter()
                    .all(|group| group.values.iter().all(|&d| d == 0.0))
            );
        }
    }

    fn traced_by(way: SunVisibility, table: &Table) -> Vec<f32> {
        let origins: Vec<u32> = (0..table.count as u32).collect();
        transmittance(&Occluders::tracing_by(way, table), &origins, &sun(35.0)).values
    }

    #[test]
    fn gaussians_that_are_no_numbers_change_nothing_for_their_neighbours() {
        let mut table = slab();
        // Occluding nothing before, and no numbers then.
        let broken_ones: Vec<usize> = (0..table.count).step_by(7).collect();
        for &index in &broken_ones {
            table.group_mut(OPACITY)[index] = -20.0;
        }
        let mut broken = table.clone();
        for &index in &broken_ones {
            broken.group_mut(POSITION)[3 * index + index % 3] = f32::NAN;
        }
        for (number, way) in WAYS.into_iter().enumerate() {
            let (before, after) = (traced_by(way, &table), traced_by(way, &broken));
            for place in (0..before.len()).filter(|place| place % 7 != 0) {
                assert!((before[place] - after[place]).abs() < 1e-6, "way {number}, {place}");
            }
        }
    }

    #[test]
    fn none_and_one_gaussian_are_lit() {
        for way in WAYS {
            assert!(traced_by(way, &Table::zeros(core_groups(), 0)).is_empty());
            assert_eq!(traced_by(way, &sheet(1, 1.0, 0.5, 0.05)), [1.0]);
        }
    }

    #[test]
    fn a_point_light_is_not_blocked_by_what_lies_behind_it() {
        let mut table = sheet(3, 1.0, 0.5, 0.05);
        table.group_mut(POSITION)[..3].copy_from_slice(&[0.0, 0.0, 10.0]);
        let occluders = Occluders::new(&table);
        let near = transmittance(&occluders, &[4], &Light::Point(Vec3::new(0.0, 0.0, 5.0)));
        let far = transmittance(&occluders, &[4], &Light::Point(Vec3::new(0.0, 0.0, 15.0)));
        assert!(near.values[0] > 0.99 && far.values[0] < 0.1);
    }
}
