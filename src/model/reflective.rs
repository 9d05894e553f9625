//! Glossy surfaces under a fixed, unknown environment light: material separated from light.
//!
//! After ARS-GS (2025), with its printed errors corrected, per Gaussian and evaluated at its centre
//!
//! ```text
//! C = a (1-m) Σ Â_l c_lm Y_lm(n)  +  g L (F0 F1(n·ω, ρ) + F2(n·ω, ρ))
//! L = softplus( Σ e^(-ρ² l(l+1)) c_lm Y_lm(t) + ψ(t blurred by the lobe, n·ω, α, position, embedding) )
//! F0 = 0.04 (1-m) + m a        t = 2 (n·ω) n - ω        Â = 1, 2/3, 1/4, 0
//! ```
//!
//! `a` is the albedo, `m` the metallic share, `α` the lobe's two widths (GGX's, in the anisotropic spherical Gaussian
//! of [`crate::shade::ggx`]), `g` the weight of the specular term, `c_lm` the environment light, shared by all
//! Gaussians, plus the Gaussian's own deviation from it, and `F1`, `F2` the split sum. ψ, the decoder, is a small
//! shared network: it adds the detail of the environment that harmonics of degree three cannot hold. It reads `t`
//! encoded in waves, each times the factor by which the lobe blurs it, and the position, which so gets a gradient (the
//! skip of ARS-GS). Where `g` is next to nothing, ψ is not evaluated. Light is linear; where images hold display
//! values, each Gaussian's light goes through the display's curve.
//!
//! Limits: the light is unknown, so the images determine albedo and light only up to a common factor; no shadows and no
//! interreflection within the object.

mod parameters;
mod surface;

use super::background::{COLOURS, depth_normal_loss};
use super::network::Network;
use super::olat::Component;
use super::{Background, Context, NamedLoss, Parameters, SceneModel, Seen};
use crate::gaussians::{FEATURES, Table, logit};
use crate::optim::{LearningRate, ParameterGroup};
use crate::shade::display;
use crate::shade::sh::{self, MAX_DEGREE};
use crate::splat::{MapGradients, Maps};
use glam::Vec3;
use rayon::prelude::*;
use surface::{EMBEDDING_WIDTH, INPUTS, PartialGradient, ReflectiveSurface, SurfaceGradient, ViewGeometry};

/// Index of the group of albedos, before the sigmoid.
pub const ALBEDO: usize = FEATURES;
/// Index of the group of frames: quaternion `x, y, z, w` that turns the surface's own axes, z its normal.
pub const FRAME: usize = FEATURES + 1;
/// Index of the group of materials before the sigmoid: metallic share, the lobe's two widths, weight of the specular
/// term.
pub const MATERIAL: usize = FEATURES + 2;
/// Index of the group of material embeddings, which the decoder reads.
pub const EMBEDDING: usize = FEATURES + 3;
/// Index of the group of degree 0 of a Gaussian's deviation from the environment light; the other degrees follow.
pub const LIGHT: usize = FEATURES + 4;
/// Index of the shared group of the environment light, `[function][colour]`.
pub const ENVIRONMENT: usize = 0;
/// Index of the shared group of the decoder's weights, where the model is glossy.
pub const DECODER: usize = 1;
/// Smallest width of a lobe, GGX's α.
const WIDTH_MIN: f32 = 0.03;
/// Weight of the specular term below which the decoder is not evaluated.
const GLOSS_MIN: f32 = 0.02;
/// Share of training after which the next degree of light joins.
const DEGREE_SHARE: f32 = 0.1;
/// Share of the learning rates of environment and decoder that is left at the end of training.
const SHARED_RATE_AT_END: f32 = 0.1;
/// Initial scale of the decoder's last layer, relative to its others: it starts with little effect.
const NETWORK_OUTPUT_SCALE: f32 = 0.1;

/// Options of the reflective model.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReflectiveOptions {
    /// True if surfaces are glossy.
    pub specular: bool,
    /// Largest degree of the harmonics of light, 0 to 3.
    pub degree: usize,
    /// Number of units in each of the decoder's hidden layers.
    pub width: usize,
    /// Number of the decoder's hidden layers.
    pub hidden: usize,
    /// Half the side of the cube that contains the positions, scene units.
    pub half_size: f32,
    /// Weight of the depth–normal loss on the frames' normals; 0 is off.
    pub normal_weight: f32,
    /// Range of depths, scene units, beyond which neighbouring pixels are an edge, not a slope.
    pub normal_edge: f32,
    /// True if images hold display values (sRGB), false if linear light.
    pub display: bool,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// True if images have coverage as a fourth band.
    pub coverage: bool,
    /// The rendered component.
    pub shows: Component,
    /// True if the view's light, of strength one, replaces the environment. For relighting only: there are no
    /// gradients.
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

/// The reflective model.
#[derive(Debug, Clone)]
pub struct Reflective {
    /// Options of the model.
    pub options: ReflectiveOptions,
}

/// The surfaces of a view, their viewing geometry, and the decoder's inputs of the glossy ones.
struct PreparedView {
    surfaces: Vec<ReflectiveSurface>,
    views: Vec<ViewGeometry>,
    /// Row of each splat among the decoder's inputs; `None` where it is not glossy.
    rows: Vec<Option<usize>>,
    inputs: Vec<f32>,
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

    /// Shape of the decoder.
    pub fn network(&self) -> Network {
        Network {
            inputs: INPUTS,
            width: self.options.width,
            hidden: self.options.hidden,
            outputs: COLOURS,
        }
    }

    /// Shared parameters at the start: uniform light of one, and a decoder with little effect.
    pub fn initial_globals(&self, seed: u64) -> Table {
        let mut table = Table::zeros(self.global_groups(), 1);
        table.group_mut(ENVIRONMENT)[..COLOURS].fill(1.0 / sh::C0);
        if self.options.specular {
            let weights = self.network().initial(seed, NETWORK_OUTPUT_SCALE);
            table.group_mut(DECODER).copy_from_slice(&weights);
        }
        table
    }

    /// Sets the initial colour (in the units of the images) and frame (quaternion `x, y, z, w`) of Gaussian `g`.
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

    /// Surfaces, view geometry and decoder inputs of all splats.
    fn prepare(&self, context: &Context, seen: &Seen) -> PreparedView {
        let (eye, toward) = (context.camera.eye(), -context.camera.depth_axis);
        let (surfaces, views): (Vec<ReflectiveSurface>, Vec<ViewGeometry>) = seen
            .projected
            .gaussian
            .par_iter()
            .with_min_len(256)
            .map(|&g| {
                let surface = self.surface(context.parameters, g as usize);
                let view = ViewGeometry::new(&surface, eye, toward);
                (surface, view)
            })
            .unzip();
        let mut glossy_splats = Vec::new();
        let rows: Vec<Option<usize>> = surfaces
            .iter()
            .enumerate()
            .map(|(s, surface)| {
                let glossy = surface.gloss > GLOSS_MIN && !self.options.lit;
                glossy.then(|| {
                    glossy_splats.push(s);
                    glossy_splats.len() - 1
                })
            })
            .collect();
        let mut inputs = vec![0.0; glossy_splats.len() * INPUTS];
        let (functions, scale) = (sh::functions(self.options.degree), 1.0 / self.options.half_size);
        inputs
            .par_chunks_mut(INPUTS)
            .with_min_len(256)
            .zip(&glossy_splats)
            .for_each(|(row, &s)| surfaces[s].encode(&views[s], functions, scale, row));
        PreparedView {
            surfaces,
            views,
            rows,
            inputs,
        }
    }

    /// Outputs of the decoder, row by row.
    fn decode(&self, context: &Context, prepared: &PreparedView) -> Vec<f32> {
        if prepared.inputs.is_empty() {
            return Vec::new();
        }
        self.network()
            .forward(context.parameters.globals.group(DECODER), &prepared.inputs)
    }

    /// Pixel value of a surface's light, and its slope to the light.
    fn shown(&self, light: f32) -> (f32, f32) {
        if self.options.display {
            display::encode(light)
        } else {
            (light, 1.0)
        }
    }

    /// Unit normals of the frames, facing the eye, one per splat.
    pub fn normals(&self, context: &Context, seen: &Seen) -> Vec<Vec3> {
        let prepared = self.prepare(context, seen);
        prepared.views.iter().map(ViewGeometry::normal).collect()
    }

    /// True if normals are rasterised, behind the colours.
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

    fn feature_parameters(&self) -> Vec<ParameterGroup> {
        let constant = LearningRate::constant;
        // A matte model does not train the specular groups.
        let glossy = |rate: f32| {
            if self.options.specular {
                constant(rate)
            } else {
                LearningRate::FROZEN
            }
        };
        let mut groups = vec![
            ParameterGroup::new("albedo", COLOURS, constant(2e-2)),
            ParameterGroup::new("frame", 4, constant(5e-3)),
            ParameterGroup::new("material", 4, glossy(1e-2)),
            ParameterGroup::new("embedding", EMBEDDING_WIDTH, glossy(5e-3)),
        ];
        let light = |degree: usize| {
            let rate = match degree {
                0 => constant(5e-3),
                n => constant(1e-3).starting_at(n as f32 * DEGREE_SHARE),
            };
            ParameterGroup::new(&format!("light_{degree}"), (2 * degree + 1) * COLOURS, rate)
        };
        groups.extend((0..=self.options.degree).map(light));
        groups
    }

    fn global_parameters(&self) -> Vec<ParameterGroup> {
        let decaying = |rate: f32| LearningRate::constant(rate).decaying_to(SHARED_RATE_AT_END);
        let width = sh::MAX_FUNCTIONS * COLOURS;
        let mut groups = vec![ParameterGroup::new("environment", width, decaying(5e-3))];
        if self.options.specular {
            groups.push(ParameterGroup::new("decoder", self.network().weights(), decaying(3e-3)));
        }
        groups
    }

    fn channels(&self) -> usize {
        if self.shows_normals() { 2 * COLOURS } else { COLOURS }
    }

    fn needs_transmittance(&self) -> bool {
        self.options.lit
    }

    fn features(&self, context: &Context, seen: &Seen, out: &mut [f32]) {
        let prepared = self.prepare(context, seen);
        let decoded = self.decode(context, &prepared);
        let functions = sh::functions(self.options.degree);
        out.par_chunks_mut(seen.stride)
            .with_min_len(256)
            .enumerate()
            .for_each(|(s, feature)| {
                let (surface, view) = (&prepared.surfaces[s], &prepared.views[s]);
                let (diffuse, specular) = match (self.options.lit, context.light) {
                    (true, Some(light)) => {
                        let (to_light, _) = light.seen_from(surface.position);
                        let lit = seen.transmittance[s];
                        let (diffuse, specular) = surface.shade_under_light(view, to_light);
                        (diffuse.map(|c| c * lit), specular.map(|c| c * lit))
                    }
                    (true, None) => ([0.0; COLOURS], [0.0; COLOURS]),
                    _ => surface.shade(view, functions, prepared.rows[s].map(|row| three(&decoded, row))),
                };
                for k in 0..COLOURS {
                    let light = match self.options.shows {
                        Component::Diffuse => diffuse[k],
                        Component::Specular => specular[k],
                        _ => diffuse[k] + specular[k],
                    };
                    // Lights add up linearly; the display curve is applied to their sum.
                    feature[k] = if self.options.lit { light } else { self.shown(light).0 };
                }
                if self.shows_normals() {
                    feature[COLOURS..2 * COLOURS].copy_from_slice(&view.normal().to_array());
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
        let prepared = self.prepare(context, seen);
        let kept = (!prepared.inputs.is_empty()).then(|| {
            let weights = context.parameters.globals.group(DECODER);
            self.network().forward_kept(weights, &prepared.inputs)
        });
        let decoded: &[f32] = kept.as_ref().map_or(&[], |kept| &kept.outputs);
        let (functions, scale) = (sh::functions(self.options.degree), 1.0 / self.options.half_size);
        let partial: Vec<(PartialGradient, [f32; COLOURS])> = d_features
            .par_chunks(seen.stride)
            .with_min_len(256)
            .enumerate()
            .map(|(s, d)| {
                let (surface, view) = (&prepared.surfaces[s], &prepared.views[s]);
                let of_decoder = prepared.rows[s].map(|row| three(decoded, row));
                let (diffuse, specular) = surface.shade(view, functions, of_decoder);
                let d_light = std::array::from_fn(|k| d[k] * self.shown(diffuse[k] + specular[k]).1);
                let mut gradient = PartialGradient::default();
                if self.shows_normals() {
                    gradient.add_facing_normal(view, Vec3::from_slice(&d[COLOURS..2 * COLOURS]));
                }
                let d_decoded = surface.shade_backward(view, functions, of_decoder, d_light, &mut gradient);
                (gradient, d_decoded)
            })
            .collect();
        let mut d_decoded = vec![0.0; decoded.len()];
        for (row, (_, d)) in prepared.rows.iter().zip(&partial) {
            if let Some(row) = row {
                d_decoded[row * COLOURS..(row + 1) * COLOURS].copy_from_slice(d);
            }
        }
        let mut d_inputs = Vec::new();
        if let Some(kept) = &kept {
            let (to_inputs, to_weights) = kept.backward(&d_decoded);
            d_inputs = to_inputs;
            let slots = grads.globals.group_mut(DECODER).iter_mut();
            slots.zip(to_weights).for_each(|(slot, d)| *slot += d);
        }
        let parts: Vec<SurfaceGradient> = partial
            .into_par_iter()
            .with_min_len(256)
            .enumerate()
            .map(|(s, (mut gradient, d_decoded))| {
                let (surface, view) = (&prepared.surfaces[s], &prepared.views[s]);
                if let Some(row) = prepared.rows[s] {
                    let row = row * INPUTS..(row + 1) * INPUTS;
                    let inputs = (&prepared.inputs[row.clone()], &d_inputs[row]);
                    surface.encode_backward(view, functions, scale, inputs, d_decoded, &mut gradient);
                }
                gradient.finish(surface, view)
            })
            .collect();
        self.add_gradients(context, &prepared.surfaces, &parts, &seen.projected.gaussian, grads);
    }

    fn background(&self) -> Background {
        (self.options.background, self.options.coverage)
    }

    fn map_losses(&self, context: &Context, maps: &Maps, d_maps: &mut MapGradients) -> Vec<NamedLoss> {
        let (weight, edge) = (self.options.normal_weight, self.options.normal_edge);
        depth_normal_loss(context.camera, maps, weight, edge, d_maps)
    }
}
