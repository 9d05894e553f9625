//! Glossy surfaces under a fixed, unknown environment light: material separated from light.
//!
//! After ARS-GS (2025), with its printed errors corrected:
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
//! skip of ARS-GS). Light is linear; where images hold display values, the light of a pixel goes through the display's
//! curve.
//!
//! The sums of harmonics are evaluated per Gaussian, at its centre. They, the normal and the material are composited,
//! and the second term is shaded once per pixel (`reflection`), with α the mean of both widths. Where `g` is next to
//! nothing, ψ is not evaluated. Under a lamp (`lit`) Gaussians are shaded one by one.
//!
//! Limits: the light is unknown, so the images determine albedo and light only up to a common factor; no shadows and no
//! interreflection within the object.

mod parameters;
mod reflection;
mod surface;

use super::background::{COLOURS, depth_normal_loss, over_background};
use super::network::Network;
use super::olat::Component;
use super::view_direction::rate_of_degree;
use super::{Background, Context, NamedLoss, Parameters, SceneModel, Seen};
use crate::gaussians::{FEATURES, Table, logit};
use crate::optim::{LearningRate, ParameterGroup};
use crate::raster::Raster;
use crate::shade::display;
use crate::shade::sh::{self, MAX_DEGREE};
use crate::splat::{MapGradients, Maps};
use rayon::prelude::*;
use reflection::{CHANNELS, DIFFUSE, GLOSS, INPUTS, NORMAL, PixelGradient, PixelSurface};
use surface::{EMBEDDING_WIDTH, PartialGradient, ReflectiveSurface, SurfaceGradient, ViewGeometry};

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
/// Alpha below which a pixel shows no surface.
const ALPHA_MIN: f32 = 1e-3;
/// Weight of the specular term below which the decoder is not evaluated.
const GLOSS_MIN: f32 = 0.02;
/// Learning rate of the harmonics of light (docs/lab/objects.md).
const LIGHT_RATE: f32 = 1.5e-2;
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

/// The surfaces of a view and their viewing geometry.
struct PreparedView {
    surfaces: Vec<ReflectiveSurface>,
    views: Vec<ViewGeometry>,
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

    /// Surfaces and view geometry of all splats.
    fn prepare(&self, context: &Context, seen: &Seen) -> PreparedView {
        let (eye, toward) = (context.camera.eye(), -context.camera.depth_axis);
        let (surfaces, views) = seen
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
        PreparedView { surfaces, views }
    }

    /// True if pixels reflect the environment.
    fn reflects(&self) -> bool {
        self.options.specular && !self.options.lit
    }

    /// The glossy pixels, and the decoder's inputs.
    fn glossy(&self, context: &Context, maps: &Maps) -> (Vec<PixelSurface>, Vec<f32>) {
        if !self.reflects() {
            return (Vec::new(), Vec::new());
        }
        let pixels: Vec<PixelSurface> = (0..maps.alpha.len())
            .into_par_iter()
            .with_min_len(256)
            .filter(|&i| maps.alpha[i] > ALPHA_MIN && maps.channels[GLOSS][i] > GLOSS_MIN * maps.alpha[i])
            .map(|i| PixelSurface::new(context.camera, maps, i))
            .collect();
        let mut inputs = vec![0.0; pixels.len() * INPUTS];
        let rows = inputs.par_chunks_mut(INPUTS).with_min_len(256).zip(&pixels);
        rows.for_each(|(row, pixel)| pixel.encode(self.scale(), row));
        (pixels, inputs)
    }

    /// One over half the side of the cube that contains the positions.
    fn scale(&self) -> f32 {
        1.0 / self.options.half_size
    }

    /// Specular light of all pixels, zero where one is not glossy.
    fn specular(pixels: &[PixelSurface], decoded: &[f32], count: usize) -> Vec<[f32; COLOURS]> {
        let mut specular = vec![[0.0; COLOURS]; count];
        for (row, pixel) in pixels.iter().enumerate() {
            specular[pixel.pixel] = pixel.specular(three(decoded, row));
        }
        specular
    }

    /// Pixel value of a surface's light, and its slope to the light.
    fn shown(&self, light: f32) -> (f32, f32) {
        if self.options.display {
            display::encode(light)
        } else {
            (light, 1.0)
        }
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
            let rate = rate_of_degree(LIGHT_RATE, degree);
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
        if self.reflects() { CHANNELS } else { NORMAL.end }
    }

    fn needs_transmittance(&self) -> bool {
        self.options.lit
    }

    fn features(&self, context: &Context, seen: &Seen, out: &mut [f32]) {
        let prepared = self.prepare(context, seen);
        let functions = sh::functions(self.options.degree);
        let channels = self.channels();
        out.par_chunks_mut(seen.stride)
            .with_min_len(256)
            .enumerate()
            .for_each(|(s, feature)| {
                let (surface, view) = (&prepared.surfaces[s], &prepared.views[s]);
                if !self.options.lit {
                    surface.channels(view, functions, &mut feature[..channels]);
                    return;
                }
                let Some(light) = context.light else { return };
                let (to_light, _) = light.seen_from(surface.position);
                let (diffuse, specular) = surface.shade_under_light(view, to_light);
                for k in 0..COLOURS {
                    let light = match self.options.shows {
                        Component::Diffuse => diffuse[k],
                        Component::Specular => specular[k],
                        _ => diffuse[k] + specular[k],
                    };
                    feature[k] = light * seen.transmittance[s];
                }
                feature[NORMAL].copy_from_slice(&view.normal().to_array());
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
        let functions = sh::functions(self.options.degree);
        let channels = self.channels();
        let parts: Vec<SurfaceGradient> = d_features
            .par_chunks(seen.stride)
            .with_min_len(256)
            .enumerate()
            .map(|(s, d)| {
                let (surface, view) = (&prepared.surfaces[s], &prepared.views[s]);
                let mut gradient = PartialGradient::default();
                surface.channels_backward(view, functions, &d[..channels], &mut gradient);
                gradient.finish(surface, view)
            })
            .collect();
        self.add_gradients(context, &prepared.surfaces, &parts, &seen.projected.gaussian, grads);
    }

    fn compose(&self, context: &Context, maps: &Maps) -> Raster {
        let mut out = over_background(maps, self.background());
        if self.options.lit {
            return out;
        }
        let (pixels, inputs) = self.glossy(context, maps);
        let decoded = match pixels.is_empty() {
            true => Vec::new(),
            false => self
                .network()
                .forward(context.parameters.globals.group(DECODER), &inputs),
        };
        let specular = Self::specular(&pixels, &decoded, maps.alpha.len());
        for (k, background) in self.options.background.into_iter().enumerate() {
            let (light, values) = (&maps.channels[DIFFUSE.start + k], out.plane_mut(k));
            for (i, value) in values.iter_mut().enumerate() {
                let alpha = maps.alpha[i];
                let share = 1.0 / alpha.max(ALPHA_MIN);
                let light = match self.options.shows {
                    Component::Diffuse => light[i] * share,
                    Component::Specular => specular[i][k],
                    _ => light[i] * share + specular[i][k],
                };
                *value = alpha * self.shown(light).0 + (1.0 - alpha) * background;
            }
        }
        out
    }

    fn compose_backward(
        &self,
        context: &Context,
        maps: &Maps,
        d_image: &Raster,
        d_maps: &mut MapGradients,
        grads: &mut Parameters,
    ) {
        let (pixels, inputs) = self.glossy(context, maps);
        let kept = (!pixels.is_empty()).then(|| {
            let weights = context.parameters.globals.group(DECODER);
            self.network().forward_kept(weights, &inputs)
        });
        let decoded: &[f32] = kept.as_ref().map_or(&[], |kept| &kept.outputs);
        let specular = Self::specular(&pixels, decoded, maps.alpha.len());
        let mut d_specular = vec![[0.0; COLOURS]; maps.alpha.len()];
        for (k, background) in self.options.background.into_iter().enumerate() {
            for (i, d) in d_image.plane(k).iter().enumerate() {
                let alpha = maps.alpha[i];
                let share = 1.0 / alpha.max(ALPHA_MIN);
                let diffuse = maps.channels[DIFFUSE.start + k][i] * share;
                let (value, slope) = self.shown(diffuse + specular[i][k]);
                let d_light = d * slope * alpha;
                d_specular[i][k] = d_light;
                d_maps.channels[DIFFUSE.start + k][i] += d_light * share;
                d_maps.alpha[i] += d * (value - background);
                if alpha > ALPHA_MIN {
                    d_maps.alpha[i] -= d_light * diffuse * share;
                }
            }
        }
        if self.options.coverage {
            let slots = d_maps.alpha.iter_mut().zip(d_image.plane(COLOURS));
            slots.for_each(|(slot, d)| *slot += d);
        }
        let Some(kept) = &kept else { return };
        let (mut parts, mut d_decoded) = (Vec::with_capacity(pixels.len()), Vec::with_capacity(decoded.len()));
        for (row, pixel) in pixels.iter().enumerate() {
            let mut part = PixelGradient::default();
            d_decoded.extend(pixel.specular_backward(three(decoded, row), d_specular[pixel.pixel], &mut part));
            parts.push(part);
        }
        let (d_inputs, to_weights) = kept.backward(&d_decoded);
        let slots = grads.globals.group_mut(DECODER).iter_mut();
        slots.zip(to_weights).for_each(|(slot, d)| *slot += d);
        let rows = parts.par_iter_mut().zip(&pixels).with_min_len(256);
        let rows = rows.zip(inputs.par_chunks(INPUTS).zip(d_inputs.par_chunks(INPUTS)));
        rows.for_each(|((part, pixel), row)| pixel.encode_backward(self.scale(), row, part));
        let rows = pixels.iter().zip(&parts);
        rows.for_each(|(pixel, part)| pixel.add_to(part, maps, d_maps));
    }

    fn background(&self) -> Background {
        (self.options.background, self.options.coverage)
    }

    fn map_losses(&self, context: &Context, maps: &Maps, d_maps: &mut MapGradients) -> Vec<NamedLoss> {
        let (weight, edge) = (self.options.normal_weight, self.options.normal_edge);
        depth_normal_loss(context.camera, maps, weight, edge, d_maps)
    }
}
