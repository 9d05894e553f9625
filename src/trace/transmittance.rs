//! Transmittance from Gaussians to a light, and its gradients.
//!
//! From the centre of Gaussian 0 toward the light `r`, every Gaussian `i` whose 1-D density along the ray peaks beyond
//! the self-shadow bias takes `α̃_i = o_i exp(-½ ‖e×d‖²/‖d‖²)` (whitened offset `e` and direction `d`), and
//! `S = Π (1 - α̃_i)`. The product has no order, so nothing is sorted (ShadowGS, Luo et al. 2026, eq. 10–12). A ray that has lost
//! all but a millionth is dark: nothing that it would meet further on could be seen, nor light it again.
//!
//! Where rays start, and which peaks are too near to count: `light_ray`.

use super::bvh::{Occluder, Occluders};
use super::light_ray::LightRay;
use super::sun_plane::SunPlane;
use crate::gaussians::{CoreGradient, Table, rotation_backward};
use crate::light::Light;
use crate::splat::project::ALPHA_MAX;
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Rays per parallel job; fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 1024;
/// Transmittance below which a ray is dark: its value is zero, and it has no gradients. They would be below `DARK / (1 - ALPHA_MAX)`,
/// a ten-thousandth.
const DARK: f32 = 1e-6;
/// Occluders per parallel job of the backward pass.
const RANGE: usize = 2048;

/// How the Gaussians on a ray of parallel light are found; the answers are the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Route {
    /// A grid in the plane normal to the light: cheapest, parallel light only.
    SunPlane,
    /// The bounding volume hierarchy that also answers point lights.
    Hierarchy,
}

/// How light is traced.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TraceOptions {
    /// Peaks nearer than this many standard deviations of the origin (along the ray) do not count.
    pub bias_sigmas: f32,
    /// Fraction of the full lift off the own sheet.
    pub lift: f32,
    /// How parallel light is answered.
    pub route: Route,
    /// Whether gradients reach the occluders; without them only the origins move.
    pub occluder_gradients: bool,
}

impl Default for TraceOptions {
    fn default() -> Self {
        Self {
            bias_sigmas: 1.0,
            lift: 1.0,
            route: Route::SunPlane,
            occluder_gradients: true,
        }
    }
}

/// One occluder on one ray.
#[derive(Debug, Clone, Copy)]
struct Hit {
    occluder: u32,
    /// `α̃`, below [`ALPHA_MAX`].
    alpha: f32,
}

/// Transmittances of some Gaussians toward one light, with the hits that made them.
#[derive(Debug, Clone, Default)]
pub struct Transmittance {
    /// Transmittance of each origin, 0 to 1.
    pub values: Vec<f32>,
    /// The rays, [`CHUNK`] to a bundle.
    bundles: Vec<Bundle>,
    occluder_gradients: bool,
}

/// The rays of some neighbouring origins, and what they met.
#[derive(Debug, Clone, Default)]
struct Bundle {
    rays: Vec<LightRay>,
    /// Where the hits of each ray end; they begin where those of the ray before end.
    hit_ends: Vec<u32>,
    hits: Vec<Hit>,
}

impl Bundle {
    /// The hits of one ray.
    fn hits_of(&self, ray: usize) -> &[Hit] {
        let start = if ray == 0 { 0 } else { self.hit_ends[ray - 1] };
        &self.hits[start as usize..self.hit_ends[ray] as usize]
    }

    /// Adds a ray with the hits that came since the last.
    fn close(&mut self, ray: LightRay) {
        self.rays.push(ray);
        self.hit_ends.push(self.hits.len() as u32);
    }
}

impl Transmittance {
    /// Values known from elsewhere, without the hits that made them: no gradients go back.
    pub fn known(values: Vec<f32>) -> Self {
        Self {
            values,
            ..Self::default()
        }
    }

    /// Number of occluders met by all rays together.
    pub fn hit_count(&self) -> usize {
        self.bundles.iter().map(|bundle| bundle.hits.len()).sum()
    }
}

/// Transmittance of the Gaussians `origins` toward `light` through all of `occluders`.
pub fn transmittance(
    gaussians: &Table,
    occluders: &Occluders,
    origins: &[u32],
    light: &Light,
    options: &TraceOptions,
) -> Transmittance {
    let plane = match (light, options.route) {
        (Light::Directional(direction), Route::SunPlane) => Some(SunPlane::new(&occluders.list, *direction)),
        _ => None,
    };
    let mut values = vec![0.0; origins.len()];
    let bundles = origins
        .par_chunks(CHUNK)
        .zip(values.par_chunks_mut(CHUNK))
        .map(|(origins, values)| {
            let mut out = Bundle {
                rays: Vec::with_capacity(origins.len()),
                hit_ends: Vec::with_capacity(origins.len()),
                hits: Vec::with_capacity(4 * origins.len()),
            };
            for (&origin, value) in origins.iter().zip(values) {
                let ray = LightRay::new(gaussians, origin as usize, light, options);
                let (mut clear, lit) = (1.0f32, out.hits.len());
                let mut meet = |id: u32, alpha: f32| {
                    if id != origin && clear >= DARK {
                        let alpha = alpha.min(ALPHA_MAX);
                        clear *= 1.0 - alpha;
                        out.hits.push(Hit { occluder: id, alpha });
                    }
                    clear >= DARK
                };
                match &plane {
                    Some(plane) => plane.visit(ray.origin, ray.bias, meet),
                    None => occluders.visit(ray.origin, ray.direction, ray.length, |id| {
                        if let Some(alpha) = peak_alpha(&occluders.list[id as usize], &ray) {
                            meet(id, alpha);
                        }
                    }),
                }
                if clear < DARK {
                    clear = 0.0;
                    out.hits.truncate(lit);
                }
                *value = clear;
                out.close(ray);
            }
            out
        })
        .collect();
    Transmittance {
        values,
        bundles,
        occluder_gradients: options.occluder_gradients,
    }
}

/// `α̃` (before saturation) of a Gaussian on a ray, when it counts.
#[inline]
fn peak_alpha(occluder: &Occluder, ray: &LightRay) -> Option<f32> {
    let e = occluder.whiten * (ray.origin - occluder.position);
    let d = occluder.whiten * ray.direction;
    let dd = d.length_squared();
    let peak = -e.dot(d) / dd;
    let miss_square = e.cross(d).length_squared() / dd;
    // Written so that a NaN counts as a miss.
    let met = miss_square < occluder.reach_square && peak > ray.bias && peak < ray.length;
    met.then(|| occluder.opacity * (-0.5 * miss_square).exp())
}

impl Transmittance {
    /// Adds the gradients that `grads` (to each origin's transmittance) gives the parameters of occluders and origins.
    /// `gaussians`, `occluders` and `origins` are those the transmittance was traced with.
    pub fn backward(&self, gaussians: &Table, occluders: &Occluders, origins: &[u32], grads: &[f32], out: &mut Table) {
        if self.bundles.iter().all(|bundle| bundle.hits.is_empty()) {
            return;
        }
        self.origins_backward(gaussians, occluders, origins, grads, out);
        if self.occluder_gradients {
            self.occluders_backward(gaussians, occluders, grads, out);
        }
    }

    fn origins_backward(
        &self,
        gaussians: &Table,
        occluders: &Occluders,
        origins: &[u32],
        grads: &[f32],
        out: &mut Table,
    ) {
        let of_origin = |place: usize| {
            let (bundle, ray) = (&self.bundles[place / CHUNK], place % CHUNK);
            let start = |hit: &Hit| {
                let h = exponent_gradient(self.values[place], grads[place], hit.alpha);
                start_gradient(&occluders.list[hit.occluder as usize], &bundle.rays[ray]) * h
            };
            let d_start: Vec3 = bundle.hits_of(ray).iter().map(start).sum();
            bundle.rays[ray].backward(d_start, gaussians.raw_rotation(origins[place] as usize))
        };
        if origins.is_sorted_by(|a, b| a < b) {
            out.add_core(origins, of_origin);
        } else {
            // Origins in another order, or more than once: one after another.
            for (place, &origin) in origins.iter().enumerate() {
                out.add_core_to(origin as usize, &of_origin(place));
            }
        }
    }

    /// Every bundle sorts its hits by ranges of occluders; every range then gathers its own from all bundles, in their order.
    fn occluders_backward(&self, gaussians: &Table, occluders: &Occluders, grads: &[f32], out: &mut Table) {
        let ranges = gaussians.count.div_ceil(RANGE);
        let sorted: Vec<SortedHits> = self
            .bundles
            .par_iter()
            .enumerate()
            .map(|(number, bundle)| SortedHits::by_range(bundle, number * CHUNK, ranges))
            .collect();
        out.add_core_by_range(RANGE, |range, add| {
            let parts: Vec<&[Shade]> = sorted.iter().map(|hits| hits.of(range)).collect();
            let shades = SortedHits::by(
                RANGE,
                |shade| shade.occluder as usize % RANGE,
                || parts.iter().copied().flatten().copied(),
            );
            for index in 0..RANGE.min(gaussians.count - range * RANGE) {
                let shades = shades.of(index);
                if !shades.is_empty() {
                    let id = range * RANGE + index;
                    add(
                        index,
                        &self.one_occluder(gaussians, &occluders.list[id], id, shades, grads),
                    );
                }
            }
        });
    }

    fn one_occluder(
        &self,
        gaussians: &Table,
        occluder: &Occluder,
        index: usize,
        shades: &[Shade],
        grads: &[f32],
    ) -> CoreGradient {
        let scale = gaussians.scale(index);
        let (mut position, mut log_scale, mut opacity) = (Vec3::ZERO, Vec3::ZERO, 0.0);
        let mut d_rotation = Mat3::ZERO;
        for &Shade { origin, alpha, .. } in shades {
            let place = origin as usize;
            let ray = &self.bundles[place / CHUNK].rays[place % CHUNK];
            let h = exponent_gradient(self.values[place], grads[place], alpha);
            let offset = ray.origin - occluder.position;
            let e = occluder.whiten * offset;
            let d = occluder.whiten * ray.direction;
            let n = nearest(e, d);
            // n = e + t d with t the peak, so with X = offset + t r: n = S⁻¹Rᵀ X and ∂(-½‖n‖²) = -n · ∂(S⁻¹Rᵀ) X at fixed t.
            let t = -e.dot(d) / d.length_squared();
            let through = offset + ray.direction * t;
            position += occluder.whiten.transpose() * n * h;
            log_scale += n * n * h;
            let scaled = n / scale * -h;
            d_rotation += Mat3::from_cols(through * scaled.x, through * scaled.y, through * scaled.z);
            opacity += h;
        }
        CoreGradient {
            position,
            log_scale,
            rotation: rotation_backward(gaussians.raw_rotation(index), d_rotation),
            // h is ∂L/∂ ln α̃ = ∂L/∂ ln o, and do/dlogit = o (1 - o).
            opacity: opacity * (1.0 - gaussians.opacity(index)),
        }
    }
}

/// `∂L/∂(-½‖e×d‖²/‖d‖²)` of one hit: `S = Π(1-α̃)`, so `∂S/∂α̃ = -S/(1-α̃)`; zero where `α̃` is saturated.
#[inline]
fn exponent_gradient(value: f32, gradient: f32, alpha: f32) -> f32 {
    if alpha >= ALPHA_MAX {
        0.0
    } else {
        -gradient * value / (1.0 - alpha) * alpha
    }
}

/// The closest point of the ray in the occluder's whitened space: `e - d (e·d)/(d·d)`, whose square is `‖e×d‖²/‖d‖²`.
#[inline]
fn nearest(e: Vec3, d: Vec3) -> Vec3 {
    e - d * (e.dot(d) / d.length_squared())
}

/// Gradient of `-½‖n‖²`, `n` the ray's nearest point to the occluder, to the ray's start: `∂/∂e = -n` because `n` is normal
/// to `d`.
#[inline]
fn start_gradient(occluder: &Occluder, ray: &LightRay) -> Vec3 {
    let e = occluder.whiten * (ray.origin - occluder.position);
    let d = occluder.whiten * ray.direction;
    -(occluder.whiten.transpose() * nearest(e, d))
}

/// A hit as its occluder sees it.
#[derive(Debug, Clone, Copy, Default)]
struct Shade {
    occluder: u32,
    /// Place of the ray's origin.
    origin: u32,
    alpha: f32,
}

/// Hits sorted into buckets, in their order within each.
struct SortedHits {
    starts: Vec<u32>,
    shades: Vec<Shade>,
}

impl SortedHits {
    /// Sorts what `shades` gives (twice the same) into `buckets` by `bucket`.
    fn by<I: Iterator<Item = Shade>>(buckets: usize, bucket: impl Fn(&Shade) -> usize, shades: impl Fn() -> I) -> Self {
        let mut starts = vec![0u32; buckets + 1];
        for shade in shades() {
            starts[bucket(&shade) + 1] += 1;
        }
        for i in 0..buckets {
            starts[i + 1] += starts[i];
        }
        let mut cursor = starts.clone();
        let mut sorted = vec![Shade::default(); starts[buckets] as usize];
        for shade in shades() {
            let place = &mut cursor[bucket(&shade)];
            sorted[*place as usize] = shade;
            *place += 1;
        }
        Self { starts, shades: sorted }
    }

    /// The hits of a bundle, whose first ray is that of origin `first`, by ranges of occluders.
    fn by_range(bundle: &Bundle, first: usize, ranges: usize) -> Self {
        let shades = || {
            (0..bundle.rays.len()).flat_map(move |ray| {
                bundle.hits_of(ray).iter().map(move |hit| Shade {
                    occluder: hit.occluder,
                    origin: (first + ray) as u32,
                    alpha: hit.alpha,
                })
            })
        };
        Self::by(ranges, |shade| shade.occluder as usize / RANGE, shades)
    }

    fn of(&self, bucket: usize) -> &[Shade] {
        &self.shades[self.starts[bucket] as usize..self.starts[bucket + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, core_groups, logit};

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
                let traced = transmittance(&table, &occluders, &origins, &sun(elevation), &TraceOptions::default());
                let least = traced.values.iter().copied().fold(1.0, f32::min);
                assert!(least >= 0.99, "elevation {elevation}, sigma {sigma}: {least}");
            }
        }
    }

    #[test]
    fn the_two_routes_meet_the_same_occluders() {
        let mut table = sheet(25, 0.5, 0.4, 0.05);
        for i in 0..table.count {
            // Scattered over a slab and turned every way.
            let h = |k: usize| ((i * 7919 + k * 104_729) % 1000) as f32 / 1000.0;
            table.group_mut(POSITION)[i * 3 + 2] = 12.0 * h(1);
            for k in 0..4 {
                table.group_mut(ROTATION)[i * 4 + k] = h(k + 2) - 0.5;
            }
            table.group_mut(OPACITY)[i] = 6.0 * h(7) - 3.0;
        }
        let occluders = Occluders::new(&table);
        let origins: Vec<u32> = (0..table.count as u32).collect();
        for elevation in [2.0, 35.0, 90.0] {
            let trace = |route| {
                let options = TraceOptions {
                    route,
                    ..TraceOptions::default()
                };
                transmittance(&table, &occluders, &origins, &sun(elevation), &options)
            };
            let (plane, tree) = (trace(Route::SunPlane), trace(Route::Hierarchy));
            assert!(plane.hit_count() > 1000);
            for (a, b) in plane.values.iter().zip(&tree.values) {
                assert!((a - b).abs() < 2e-3, "elevation {elevation}: {a} against {b}");
            }
        }
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
        let traced = transmittance(&table, &occluders, &origins, &light, &TraceOptions::default());
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
    fn a_ray_under_many_roofs_is_dark_and_keeps_no_hits() {
        let mut table = sheet(1, 1.0, 5.0, 0.05).gather(&[0; 200]);
        for i in 0..table.count {
            table.group_mut(POSITION)[i * 3 + 2] = 5.0 * i as f32;
        }
        let occluders = Occluders::new(&table);
        for route in [Route::SunPlane, Route::Hierarchy] {
            let options = TraceOptions {
                route,
                ..TraceOptions::default()
            };
            let traced = transmittance(&table, &occluders, &[0, 198], &sun(90.0), &options);
            assert!(
                traced.values[0] == 0.0 && traced.hit_count() == 1,
                "{:?}",
                traced.values
            );
            assert!((traced.values[1] - 0.05).abs() < 1e-4);
        }
    }

    #[test]
    fn a_point_light_is_not_blocked_by_what_lies_behind_it() {
        let mut table = sheet(3, 1.0, 0.5, 0.05);
        table.group_mut(POSITION)[..3].copy_from_slice(&[0.0, 0.0, 10.0]);
        let occluders = Occluders::new(&table);
        let near = transmittance(
            &table,
            &occluders,
            &[4],
            &Light::Point(Vec3::new(0.0, 0.0, 5.0)),
            &TraceOptions::default(),
        );
        let far = transmittance(
            &table,
            &occluders,
            &[4],
            &Light::Point(Vec3::new(0.0, 0.0, 15.0)),
            &TraceOptions::default(),
        );
        assert!(near.values[0] > 0.99 && far.values[0] < 0.1);
    }
}
