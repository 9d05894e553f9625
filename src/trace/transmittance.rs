//! Transmittance from Gaussians to a light, and its gradients.
//!
//! From the centre of Gaussian 0 toward the light `r`, every Gaussian `i` whose 1-D density along the ray peaks beyond
//! the self-shadow bias takes `α̃_i = o_i exp(-½ ‖e×d‖²/‖d‖²)` (whitened offset `e` and direction `d`), and
//! `S = Π (1 - α̃_i) = exp(Σ ln1p(-α̃_i))`. The product has no order, so nothing is sorted (ShadowGS, Luo et al. 2026, eq. 10–12).
//!
//! Self-shadow. A surface is a sheet of overlapping flat Gaussians; a ray that starts inside the sheet meets its own
//! neighbours. Two rules keep a lit plane lit at every elevation without moving the feet of shadows at ordinary suns:
//! the ray starts above the sheet, lifted along the origin's own thinnest axis (turned to the light) by
//! `LIFT · σ_min · (1 - cos θ)`, `θ` the angle between that axis and the light, so that a grazing ray clears the
//! neighbours' whole reach and a steep one hardly moves; and only peaks further along the ray than the origin's own
//! extent `sqrt(rᵀΣr)` count.

use super::bvh::{Occluder, Occluders};
use super::sun_plane::SunPlane;
use crate::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, Table, rotation_backward};
use crate::light::Light;
use crate::splat::project::{ALPHA_MAX, add3};
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Standard deviations that a grazing ray is lifted off its own sheet: the reach of an opaque Gaussian, `sqrt(2 ln 1000)`.
const LIFT: f32 = 3.717;
/// Rays per parallel job; fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 1024;

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
    /// `hit_starts[i]..hit_starts[i + 1]`: the hits of origin `i`.
    hit_starts: Vec<u32>,
    hits: Vec<Hit>,
    rays: Vec<LightRay>,
    occluder_gradients: bool,
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
        self.hits.len()
    }
}

/// A ray from a Gaussian toward the light.
#[derive(Debug, Clone)]
struct LightRay {
    origin: Vec3,
    direction: Vec3,
    length: f32,
    bias: f32,
    lift: Lift,
}

/// How far and along which own axis a ray was lifted off its sheet.
#[derive(Debug, Clone)]
struct Lift {
    thin: usize,
    /// The axis, turned to the light.
    axis: Vec3,
    /// 1 or -1: whether it was turned.
    sign: f32,
    height: f32,
    /// Lift of a ray at right angles to the axis.
    full: f32,
}

fn light_ray(gaussians: &Table, index: usize, light: &Light, options: &TraceOptions) -> LightRay {
    let position = gaussians.position(index);
    let (direction, distance) = light.seen_from(position);
    let scale = gaussians.scale(index);
    let rotation = gaussians.rotation(index);
    let thin = if scale.x <= scale.y && scale.x <= scale.z {
        0
    } else if scale.y <= scale.z {
        1
    } else {
        2
    };
    let sign = if rotation.col(thin).dot(direction) < 0.0 {
        -1.0
    } else {
        1.0
    };
    let axis = rotation.col(thin) * sign;
    let full = options.lift * LIFT * scale[thin];
    let height = full * (1.0 - axis.dot(direction));
    let extent = ((rotation.transpose() * direction) * scale).length();
    let lift = Lift {
        thin,
        axis,
        sign,
        height,
        full,
    };
    LightRay {
        origin: position + axis * height,
        direction,
        length: distance,
        bias: options.bias_sigmas * extent,
        lift,
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
    let chunks: Vec<Transmittance> = origins
        .par_chunks(CHUNK)
        .map(|chunk| {
            let mut out = Transmittance::default();
            for &origin in chunk {
                let ray = light_ray(gaussians, origin as usize, light, options);
                let mut optical_depth = 0.0f32;
                let mut meet = |id: u32, alpha: f32| {
                    if id != origin {
                        let alpha = alpha.min(ALPHA_MAX);
                        optical_depth -= (-alpha).ln_1p();
                        out.hits.push(Hit { occluder: id, alpha });
                    }
                };
                match &plane {
                    Some(plane) => plane.visit(ray.origin, ray.bias, meet),
                    None => occluders.visit(ray.origin, ray.direction, ray.length, |id| {
                        if let Some(alpha) = peak_alpha(&occluders.list[id as usize], &ray) {
                            meet(id, alpha);
                        }
                    }),
                }
                out.values.push((-optical_depth).exp());
                out.rays.push(ray);
                out.hit_starts.push(out.hits.len() as u32);
            }
            out
        })
        .collect();
    let mut all = Transmittance {
        hit_starts: vec![0],
        occluder_gradients: options.occluder_gradients,
        ..Transmittance::default()
    };
    for chunk in chunks {
        let base = all.hits.len() as u32;
        all.values.extend(chunk.values);
        all.hit_starts
            .extend(chunk.hit_starts.into_iter().map(|end| base + end));
        all.hits.extend(chunk.hits);
        all.rays.extend(chunk.rays);
    }
    all
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
        if self.hits.is_empty() {
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
        let starts: Vec<Vec3> = self
            .rays
            .par_iter()
            .with_min_len(256)
            .enumerate()
            .map(|(i, ray)| {
                let mut total = Vec3::ZERO;
                for hit in &self.hits[self.hit_starts[i] as usize..self.hit_starts[i + 1] as usize] {
                    let occluder = &occluders.list[hit.occluder as usize];
                    let e = occluder.whiten * (ray.origin - occluder.position);
                    let d = occluder.whiten * ray.direction;
                    let h = exponent_gradient(self.values[i], grads[i], hit.alpha);
                    // exponent = -½‖n‖², n the nearest point; ∂/∂e = -n because n is normal to d.
                    total -= occluder.whiten.transpose() * nearest(e, d) * h;
                }
                total
            })
            .collect();
        for ((&origin, &d_start), ray) in origins.iter().zip(&starts).zip(&self.rays) {
            if d_start == Vec3::ZERO {
                continue;
            }
            let (i, lift) = (origin as usize, &ray.lift);
            add3(&mut out.groups[POSITION].values, i, d_start);
            // start = position + axis · full · (1 - axis·r), full proportional to the thinnest scale.
            let d_height = d_start.dot(lift.axis);
            out.groups[LOG_SCALE].values[i * 3 + lift.thin] += d_height * lift.height;
            let d_axis = (d_start * lift.height - ray.direction * (d_height * lift.full)) * lift.sign;
            let mut d_rotation = Mat3::ZERO;
            *d_rotation.col_mut(lift.thin) = d_axis;
            let d_quaternion = rotation_backward(gaussians.raw_rotation(i), d_rotation);
            for (slot, v) in out.groups[ROTATION].values[i * 4..i * 4 + 4]
                .iter_mut()
                .zip(d_quaternion)
            {
                *slot += v;
            }
        }
    }

    /// The hits by occluder: starts per occluder, and for each hit its origin's place and `α̃`.
    fn by_occluder(&self, count: usize) -> (Vec<u32>, Vec<(u32, f32)>) {
        let mut starts = vec![0u32; count + 1];
        for hit in &self.hits {
            starts[hit.occluder as usize + 1] += 1;
        }
        for i in 0..count {
            starts[i + 1] += starts[i];
        }
        let mut cursor = starts.clone();
        let mut sorted = vec![(0, 0.0); self.hits.len()];
        for (i, span) in self.hit_starts.windows(2).enumerate() {
            for hit in &self.hits[span[0] as usize..span[1] as usize] {
                let place = &mut cursor[hit.occluder as usize];
                sorted[*place as usize] = (i as u32, hit.alpha);
                *place += 1;
            }
        }
        (starts, sorted)
    }

    fn occluders_backward(&self, gaussians: &Table, occluders: &Occluders, grads: &[f32], out: &mut Table) {
        let (starts, sorted) = self.by_occluder(gaussians.count);
        let touched: Vec<u32> = (0..gaussians.count as u32)
            .filter(|&g| starts[g as usize] < starts[g as usize + 1])
            .collect();
        let gradients: Vec<OccluderGradient> = touched
            .par_iter()
            .with_min_len(256)
            .map(|&g| {
                let hits = &sorted[starts[g as usize] as usize..starts[g as usize + 1] as usize];
                self.one_occluder(gaussians, &occluders.list[g as usize], g as usize, hits, grads)
            })
            .collect();
        for (&g, d) in touched.iter().zip(&gradients) {
            let i = g as usize;
            add3(&mut out.groups[POSITION].values, i, d.position);
            add3(&mut out.groups[LOG_SCALE].values, i, d.log_scale);
            for (slot, v) in out.groups[ROTATION].values[i * 4..i * 4 + 4].iter_mut().zip(d.rotation) {
                *slot += v;
            }
            out.groups[OPACITY].values[i] += d.opacity;
        }
    }

    fn one_occluder(
        &self,
        gaussians: &Table,
        occluder: &Occluder,
        index: usize,
        hits: &[(u32, f32)],
        grads: &[f32],
    ) -> OccluderGradient {
        let scale = gaussians.scale(index);
        let (mut position, mut log_scale, mut opacity) = (Vec3::ZERO, Vec3::ZERO, 0.0);
        let mut d_rotation = Mat3::ZERO;
        for &(origin, alpha) in hits {
            let (ray, h) = (
                &self.rays[origin as usize],
                exponent_gradient(self.values[origin as usize], grads[origin as usize], alpha),
            );
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
        OccluderGradient {
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

struct OccluderGradient {
    position: Vec3,
    log_scale: Vec3,
    rotation: [f32; 4],
    opacity: f32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::{core_groups, logit};

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
