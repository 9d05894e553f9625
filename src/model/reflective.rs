//! Glossy surfaces in surroundings that stay: material apart from light.
//!
//! After ARS-GS (2025), with its printed errors corrected, per Gaussian and evaluated at its centre
//!
//! ```text
//! C = a (1-m) Σ Â_l c_lm Y_lm(n)  +  g L (F0 F1(n·ω, ρ) + F2(n·ω, ρ))
//! L = softplus( Σ e^(-ρ² l(l+1)) c_lm Y_lm(t) + ψ(t blurred by the lobe, n·ω, α, position, code) )
//! F0 = 0.04 (1-m) + m a        t = 2 (n·ω) n - ω        Â = 1, 2/3, 1/4, 0
//! ```
//!
//! `a` is the albedo, `m` the metallic share, `α` the lobe's two widths (GGX's, in the anisotropic spherical Gaussian of
//! [`crate::shade::ggx`]), `g` the share of gloss that is there at all, `c_lm` the surroundings' light, which all share, plus the
//! Gaussian's own departure from it, and `F1`, `F2` the split sum. ψ is a small network that all share: it adds what harmonics of
//! degree three do not know of the surroundings, as seen from everywhere. It is told `t` in waves, each times the factor by which the
//! lobe blurs it, and reads the position, through which a gradient reaches it (the skip of ARS-GS). Where `g` is next to nothing, ψ is
//! not asked. Light is linear; where images are for a display, each Gaussian's light goes through the display's curve.
//!
//! No light is known, so albedo and light share a factor that nothing in the images tells.

mod surface;

use super::network::Network;
use super::olat::Component;
use super::over::{COLOURS, normals_of_depth, over, over_backward};
use super::{Context, NamedLoss, Parameters, SceneModel, Seen};
use crate::gaussians::{FEATURES, GroupSpec, POSITION, Table, logit, sigmoid};
use crate::optim::exponential_decay;
use crate::raster::Raster;
use crate::shade::display;
use crate::shade::sh::{self, MAX_DEGREE};
use crate::splat::{MapGradients, Maps};
use glam::Vec3;
use rayon::prelude::*;
use surface::{Backward, CODE, Coefficients, INPUTS, Sight, Surface, SurfaceGradient};

/// Index of the group of albedos, before the sigmoid.
pub const ALBEDO: usize = FEATURES;
/// Index of the group of frames: quaternion `x, y, z, w` that turns the surface's own axes, z its normal.
pub const FRAME: usize = FEATURES + 1;
/// Index of the group of materials before the sigmoid: metallic share, the lobe's two widths, the share of gloss.
pub const MATERIAL: usize = FEATURES + 2;
/// Index of the group of codes that the decoder reads.
pub const CODES: usize = FEATURES + 3;
/// Index of the group of degree 0 of a Gaussian's own light; the other degrees follow.
pub const LIGHT: usize = FEATURES + 4;
/// Indices of the shared groups: the surroundings' light, `[function][colour]`, and the decoder.
pub const SURROUNDINGS: usize = 0;
/// See [`SURROUNDINGS`].
pub const DECODER: usize = 1;
/// The narrowest lobe.
const LEAST_WIDTH: f32 = 0.03;
/// Gloss below which the decoder is not asked.
const NO_GLOSS: f32 = 0.02;
/// Share of training after which the next degree of light joins.
const DEGREE_SHARE: f32 = 0.1;
/// How much the decoder says at first, relative to its layers.
const QUIET: f32 = 0.1;

/// What the model is made of.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReflectiveOptions {
    /// Whether surfaces are glossy.
    pub specular: bool,
    /// Largest degree of the harmonics of light, 0 to 3.
    pub degree: usize,
    /// Units of the decoder's hidden layers.
    pub width: usize,
    /// The decoder's hidden layers.
    pub hidden: usize,
    /// Half of the side of the cube that positions lie in.
    pub half_size: f32,
    /// Weight of the agreement of the frames' normals with those of the depth.
    pub normal_weight: f32,
    /// Depth range, in units of length, beyond which neighbouring pixels are an edge for that.
    pub normal_edge: f32,
    /// Whether images hold display values.
    pub display: bool,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Whether images have coverage as a fourth band.
    pub coverage: bool,
    /// What is shown of the light.
    pub shows: Component,
    /// Whether the light is that of the view's lamp, of strength one, instead of the surroundings; for showing only.
    pub lit: bool,
}

impl Default for ReflectiveOptions {
    fn default() -> Self {
        Self {
            specular: true,
            degree: MAX_DEGREE,
            width: 64,
            hidden: 3,
            half_size: 1.0,
            normal_weight: 0.0,
            normal_edge: 0.1,
            display: true,
            background: [1.0; 3],
            coverage: false,
            shows: Component::All,
            lit: false,
        }
    }
}

/// The model.
#[derive(Debug, Clone)]
pub struct Reflective {
    /// What it is made of.
    pub options: ReflectiveOptions,
}

/// A view's surfaces, and which of them are glossy: what of the splats the decoder is asked.
struct Looked {
    surfaces: Vec<Surface>,
    sights: Vec<Sight>,
    /// Per splat the row of the decoder; none where nothing is glossy.
    rows: Vec<Option<usize>>,
    told: Vec<f32>,
}

impl Reflective {
    /// A model of these options; degrees above 3 are 3.
    pub fn new(options: ReflectiveOptions) -> Self {
        let degree = options.degree.min(MAX_DEGREE);
        Self {
            options: ReflectiveOptions {
                degree,
                width: options.width.max(1),
                hidden: options.hidden.max(1),
                ..options
            },
        }
    }

    /// The decoder's shape.
    pub fn network(&self) -> Network {
        Network {
            inputs: INPUTS,
            width: self.options.width,
            hidden: self.options.hidden,
            outputs: COLOURS,
        }
    }

    /// Shared parameters at the start: even light of one, and a decoder that says little.
    pub fn initial_globals(&self, seed: u64) -> Table {
        let mut table = Table::zeros(self.global_groups(), 1);
        table.group_mut(SURROUNDINGS)[..COLOURS].fill(1.0 / sh::C0);
        if self.options.specular {
            let weights = self.network().initial(seed, QUIET);
            table.group_mut(DECODER).copy_from_slice(&weights);
        }
        table
    }

    /// Sets what Gaussian `g` is at the start: what it shows, as in the images, and its frame.
    pub fn paint(&self, gaussians: &mut Table, g: usize, colour: [f32; 3], frame: [f32; 4]) {
        for (k, value) in colour.into_iter().enumerate() {
            let light = if self.options.display {
                display::decode(value)
            } else {
                value
            };
            gaussians.group_mut(ALBEDO)[g * COLOURS + k] = logit(light.clamp(0.02, 0.95));
        }
        gaussians.group_mut(FRAME)[g * 4..g * 4 + 4].copy_from_slice(&frame);
        gaussians.group_mut(MATERIAL)[g * 4..g * 4 + 4].copy_from_slice(&[
            logit(0.05),
            logit(0.2),
            logit(0.2),
            logit(0.7),
        ]);
    }

    fn surface(&self, parameters: &Parameters, g: usize) -> Surface {
        let gaussians = &parameters.gaussians;
        let part = |group: usize, width: usize| &gaussians.group(group)[g * width..(g + 1) * width];
        let (material, frame) = (part(MATERIAL, 4), part(FRAME, 4));
        let width = |raw: f32| LEAST_WIDTH + (1.0 - LEAST_WIDTH) * sigmoid(raw);
        let mut light: Coefficients = Default::default();
        let shared = parameters.globals.group(SURROUNDINGS);
        for degree in 0..=self.options.degree {
            let own = part(LIGHT + degree, (2 * degree + 1) * COLOURS);
            for (n, slot) in light[degree * degree..(degree + 1) * (degree + 1)]
                .iter_mut()
                .enumerate()
            {
                for k in 0..COLOURS {
                    slot[k] = own[n * COLOURS + k] + shared[(degree * degree + n) * COLOURS + k];
                }
            }
        }
        Surface {
            position: gaussians.position(g),
            albedo: std::array::from_fn(|k| sigmoid(part(ALBEDO, COLOURS)[k])),
            metallic: sigmoid(material[0]),
            alpha: [width(material[1]), width(material[2])],
            gloss: if self.options.specular {
                sigmoid(material[3])
            } else {
                0.0
            },
            frame: [frame[0], frame[1], frame[2], frame[3]],
            light,
            code: std::array::from_fn(|k| part(CODES, CODE)[k]),
        }
    }

    fn look(&self, context: &Context, seen: &Seen) -> Looked {
        let (eye, toward) = (context.camera.eye(), -context.camera.depth_axis);
        let (surfaces, sights): (Vec<Surface>, Vec<Sight>) = seen
            .projected
            .gaussian
            .par_iter()
            .with_min_len(256)
            .map(|&g| {
                let surface = self.surface(context.parameters, g as usize);
                let sight = Sight::new(&surface, eye, toward);
                (surface, sight)
            })
            .unzip();
        let mut asked = Vec::new();
        let rows: Vec<Option<usize>> = surfaces
            .iter()
            .enumerate()
            .map(|(s, surface)| {
                let glossy = surface.gloss > NO_GLOSS && !self.options.lit;
                glossy.then(|| {
                    asked.push(s);
                    asked.len() - 1
                })
            })
            .collect();
        let mut told = vec![0.0; asked.len() * INPUTS];
        let (functions, scale) = (sh::functions(self.options.degree), 1.0 / self.options.half_size);
        told.par_chunks_mut(INPUTS)
            .with_min_len(256)
            .zip(&asked)
            .for_each(|(line, &s)| surfaces[s].tell(&sights[s], functions, scale, line));
        Looked {
            surfaces,
            sights,
            rows,
            told,
        }
    }

    fn decode(&self, context: &Context, looked: &Looked) -> Vec<f32> {
        if looked.told.is_empty() {
            return Vec::new();
        }
        self.network()
            .forward(context.parameters.globals.group(DECODER), &looked.told)
    }

    /// What a surface shows, and its slope to the light.
    fn shown(&self, light: f32) -> (f32, f32) {
        if self.options.display {
            display::encode(light)
        } else {
            (light, 1.0)
        }
    }

    /// Normals of the frames, facing the eye, one for each splat.
    pub fn normals(&self, context: &Context, seen: &Seen) -> Vec<Vec3> {
        let looked = self.look(context, seen);
        looked.sights.iter().map(Sight::normal).collect()
    }

    /// Whether normals are rasterised, behind the colours.
    fn shows_normals(&self) -> bool {
        self.options.normal_weight > 0.0 || self.options.shows == Component::Normal
    }
}

fn three(values: &[f32], row: usize) -> [f32; COLOURS] {
    std::array::from_fn(|k| values[row * COLOURS + k])
}

impl SceneModel for Reflective {
    fn name(&self) -> &'static str {
        "reflective"
    }

    fn feature_groups(&self) -> Vec<GroupSpec> {
        let mut groups = vec![
            GroupSpec::new("albedo", COLOURS),
            GroupSpec::new("frame", 4),
            GroupSpec::new("material", 4),
            GroupSpec::new("code", CODE),
        ];
        let light = |degree: usize| GroupSpec::new(&format!("light_{degree}"), (2 * degree + 1) * COLOURS);
        groups.extend((0..=self.options.degree).map(light));
        groups
    }

    fn global_groups(&self) -> Vec<GroupSpec> {
        let mut groups = vec![GroupSpec::new("surroundings", sh::MAX_FUNCTIONS * COLOURS)];
        if self.options.specular {
            groups.push(GroupSpec::new("decoder", self.network().weights()));
        }
        groups
    }

    fn learning_rate(&self, group: &str, progress: f32) -> f32 {
        let falling = |rate: f32| exponential_decay(rate, 0.1 * rate, progress);
        if let Some(degree) = group.strip_prefix("light_").and_then(|n| n.parse::<u8>().ok()) {
            return match degree {
                0 => 5e-3,
                n if progress >= f32::from(n) * DEGREE_SHARE => 1e-3,
                _ => 0.0,
            };
        }
        match group {
            "albedo" => 2e-2,
            "frame" => 5e-3,
            "material" if self.options.specular => 1e-2,
            "code" if self.options.specular => 5e-3,
            "surroundings" => falling(5e-3),
            "decoder" => falling(3e-3),
            _ => 0.0,
        }
    }

    fn channels(&self) -> usize {
        if self.shows_normals() { 2 * COLOURS } else { COLOURS }
    }

    fn needs_transmittance(&self) -> bool {
        self.options.lit
    }

    fn features(&self, context: &Context, seen: &Seen, out: &mut [f32]) {
        let looked = self.look(context, seen);
        let decoded = self.decode(context, &looked);
        let functions = sh::functions(self.options.degree);
        out.par_chunks_mut(seen.stride)
            .with_min_len(256)
            .enumerate()
            .for_each(|(s, feature)| {
                let (surface, sight) = (&looked.surfaces[s], &looked.sights[s]);
                let (diffuse, specular) = match (self.options.lit, context.light) {
                    (true, Some(light)) => {
                        let (to_light, _) = light.seen_from(surface.position);
                        let lit = seen.transmittance[s];
                        let (diffuse, specular) = surface.under(sight, to_light);
                        (diffuse.map(|c| c * lit), specular.map(|c| c * lit))
                    }
                    (true, None) => ([0.0; COLOURS], [0.0; COLOURS]),
                    _ => surface.shade(sight, functions, looked.rows[s].map(|row| three(&decoded, row))),
                };
                for k in 0..COLOURS {
                    let light = match self.options.shows {
                        Component::Diffuse => diffuse[k],
                        Component::Specular => specular[k],
                        _ => diffuse[k] + specular[k],
                    };
                    // Lamps add up before a display shows their sum.
                    feature[k] = if self.options.lit { light } else { self.shown(light).0 };
                }
                if self.shows_normals() {
                    feature[COLOURS..2 * COLOURS].copy_from_slice(&sight.normal().to_array());
                }
            });
    }

    fn features_backward(
        &self,
        context: &Context,
        seen: &Seen,
        d_features: &[f32],
        grads: &mut Parameters,
        _d_transmittance: &mut [f32],
    ) {
        let looked = self.look(context, seen);
        let asked = !looked.told.is_empty();
        let kept = asked.then(|| {
            let weights = context.parameters.globals.group(DECODER);
            self.network().keep(weights, &looked.told)
        });
        let decoded: &[f32] = kept.as_ref().map_or(&[], |kept| &kept.outputs);
        let (functions, scale) = (sh::functions(self.options.degree), 1.0 / self.options.half_size);
        let half_way: Vec<(Backward, [f32; COLOURS])> = d_features
            .par_chunks(seen.stride)
            .with_min_len(256)
            .enumerate()
            .map(|(s, d)| {
                let (surface, sight) = (&looked.surfaces[s], &looked.sights[s]);
                let of_decoder = looked.rows[s].map(|row| three(decoded, row));
                let (diffuse, specular) = surface.shade(sight, functions, of_decoder);
                let d_light = std::array::from_fn(|k| d[k] * self.shown(diffuse[k] + specular[k]).1);
                let mut back = Backward::default();
                if self.shows_normals() {
                    back.facing_normal(sight, Vec3::from_slice(&d[COLOURS..2 * COLOURS]));
                }
                let d_decoded = surface.shade_backward(sight, functions, of_decoder, d_light, &mut back);
                (back, d_decoded)
            })
            .collect();
        let mut d_decoded = vec![0.0; decoded.len()];
        for (row, (_, d)) in looked.rows.iter().zip(&half_way) {
            if let Some(row) = row {
                d_decoded[row * COLOURS..(row + 1) * COLOURS].copy_from_slice(d);
            }
        }
        let mut d_told = Vec::new();
        if let Some(kept) = &kept {
            let (to_inputs, to_weights) = kept.backward(&d_decoded);
            d_told = to_inputs;
            let slots = grads.globals.group_mut(DECODER).iter_mut();
            slots.zip(to_weights).for_each(|(slot, d)| *slot += d);
        }
        let parts: Vec<SurfaceGradient> = half_way
            .into_par_iter()
            .with_min_len(256)
            .enumerate()
            .map(|(s, (mut back, d_decoded))| {
                let (surface, sight) = (&looked.surfaces[s], &looked.sights[s]);
                if let Some(row) = looked.rows[s] {
                    let line = row * INPUTS..(row + 1) * INPUTS;
                    let lines = (&looked.told[line.clone()], &d_told[line]);
                    surface.tell_backward(sight, functions, scale, lines, d_decoded, &mut back);
                }
                back.finish(surface, sight)
            })
            .collect();
        self.add(context, &looked.surfaces, &parts, &seen.projected.gaussian, grads);
    }

    fn compose(&self, _context: &Context, maps: &Maps) -> Raster {
        over(maps, self.options.background, self.options.coverage)
    }

    fn compose_backward(
        &self,
        _context: &Context,
        _maps: &Maps,
        d_image: &Raster,
        d_maps: &mut MapGradients,
        _grads: &mut Parameters,
    ) {
        over_backward(d_image, self.options.background, self.options.coverage, d_maps);
    }

    fn map_losses(&self, context: &Context, maps: &Maps, _: &[f32], d_maps: &mut MapGradients) -> Vec<NamedLoss> {
        let (weight, edge) = (self.options.normal_weight, self.options.normal_edge);
        normals_of_depth(context.camera, maps, weight, edge, d_maps)
    }
}

impl Reflective {
    /// Adds the gradients of surfaces to those of the parameters they are made of.
    fn add(
        &self,
        context: &Context,
        surfaces: &[Surface],
        parts: &[SurfaceGradient],
        indices: &[u32],
        grads: &mut Parameters,
    ) {
        let table = &mut grads.gaussians;
        let add = |slots: &mut [f32], values: &[f32]| slots.iter_mut().zip(values).for_each(|(s, v)| *s += v);
        // Of a sigmoid.
        let slope = |p: f32| p * (1.0 - p);
        table.add_to_group(POSITION, indices, |s, slots| add(slots, &parts[s].position.to_array()));
        table.add_to_group(FRAME, indices, |s, slots| add(slots, &parts[s].frame));
        table.add_to_group(ALBEDO, indices, |s, slots| {
            let d: [f32; COLOURS] = std::array::from_fn(|k| parts[s].albedo[k] * slope(surfaces[s].albedo[k]));
            add(slots, &d);
        });
        table.add_to_group(MATERIAL, indices, |s, slots| {
            let (surface, d) = (&surfaces[s], &parts[s]);
            let width = |k: usize| {
                let share = (surface.alpha[k] - LEAST_WIDTH) / (1.0 - LEAST_WIDTH);
                d.alpha[k] * (1.0 - LEAST_WIDTH) * slope(share)
            };
            let metallic = d.metallic * slope(surface.metallic);
            add(slots, &[metallic, width(0), width(1), d.gloss * slope(surface.gloss)]);
        });
        table.add_to_group(CODES, indices, |s, slots| add(slots, &parts[s].code));
        for degree in 0..=self.options.degree {
            table.add_to_group(LIGHT + degree, indices, |s, slots| {
                let values = &parts[s].light[degree * degree..];
                slots
                    .chunks_mut(COLOURS)
                    .zip(values)
                    .for_each(|(slots, d)| add(slots, d));
            });
        }
        let mut shared = [0.0f64; sh::MAX_FUNCTIONS * COLOURS];
        for part in parts {
            for (sum, d) in shared.iter_mut().zip(part.light.iter().flatten()) {
                *sum += f64::from(*d);
            }
        }
        let functions = sh::functions(self.options.degree);
        let slots = grads.globals.group_mut(SURROUNDINGS).iter_mut();
        slots
            .zip(shared)
            .take(functions * COLOURS)
            .for_each(|(slot, d)| *slot += d as f32);
        debug_assert_eq!(context.parameters.globals.groups.len(), grads.globals.groups.len());
    }
}
