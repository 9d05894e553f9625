//! The satellite model (ShadowGS, Luo et al. 2026, eq. 13–15) with per-image colour.
//!
//! Channels: albedo `F` (one per band), visibility of the sun `S`, and, when switched on, near-surface light `L_n`. Per
//! pixel
//!
//! ```text
//! L = S + (1 - S)(L_sky + L_n)        C = F ⊙ L        C' = A C + b
//! ```
//!
//! `L_sky` is a colour per image (its haze and its sun's height differ), positive through a softplus. `A` (a matrix)
//! and `b` are per image; those of the reference image are the identity and its path radiance, which are not trained:
//! this fixes the gauge. Images without colours share that path radiance.
//!
//! The paper's albedo is by spherical harmonics of the viewing direction, and so is `L_n`. Here both are one value per
//! Gaussian and band, to which `degree` adds harmonics of degree 1 and more, one after another, as differences to
//! straight down:
//!
//! ```text
//! F_k(v) = F_k + Σ_{l≥1,m} c_lmk (Y_lm(v) - Y_lm(down))
//! ```
//!
//! with `v` from the camera to the centre. Satellites look from within some 30 degrees of the nadir, where functions of
//! low degree are nearly constant and would duplicate `F_k`. With the differences, `F_k` is the albedo seen from
//! straight above. Nothing is clamped.

mod air;
mod harmonics;
mod lighting;

pub use air::Air;

use super::{Context, NamedLoss, Parameters, SceneModel, Seen};
use crate::gaussians::FEATURES;
use crate::loss::shadow::prior;
use crate::optim::{LearningRate, ParameterGroup};
use crate::raster::Raster;
use crate::shade::sh;
use crate::splat::{MapGradients, Maps};
use harmonics::Harmonics;
use lighting::{ChunkGradients, Lighting, SharedGradients};
use rayon::prelude::*;

/// Components and settings of the satellite model.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct ShadowGsOptions {
    /// Number of image bands.
    pub bands: usize,
    /// Number of images, each with its own sky and colour.
    pub images: usize,
    /// Index of the reference image, whose colour is the model's.
    pub reference: usize,
    /// True if each image has an affine colour transform.
    pub image_colour: bool,
    /// True if Gaussians have near-surface light in shadows.
    pub near_light: bool,
    /// Weight of the shadow prior, for views that have one; 0 is off.
    pub prior_weight: f32,
    /// Largest degree of the spherical harmonics of albedo and near-surface light, 0 to 3; with 0 they do not depend on
    /// the viewing direction.
    pub degree: usize,
    /// The day of each image, days since 1970, where some Gaussians exist on some days only; else empty. Each Gaussian
    /// then has the first day of its existence and the first day after it, which are not trained.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub days: Vec<f32>,
}

/// Pixels per parallel job; fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 4096;

impl Default for ShadowGsOptions {
    fn default() -> Self {
        Self {
            bands: 3,
            images: 1,
            reference: 0,
            image_colour: true,
            near_light: false,
            prior_weight: 0.0,
            degree: 0,
            days: Vec::new(),
        }
    }
}

/// The satellite model, ShadowGS with per-image colour.
#[derive(Debug, Clone)]
pub struct ShadowGs {
    /// Components and settings.
    pub options: ShadowGsOptions,
}

/// Index of the albedo group in the Gaussian table.
pub const ALBEDO: usize = FEATURES;
const NEAR: usize = FEATURES + 1;
/// Index of the sky group in the global table, `[image][band]`, before the softplus.
pub const SKY: usize = 0;
/// Index of the colour matrices in the global table, `[image][row][column]`.
pub const COLOUR: usize = 1;
/// Index of the colour offsets in the global table, `[image][band]`.
pub const OFFSET: usize = 2;
/// Index of the path radiance in the global table, where images have no colours.
const PATH_RADIANCE: usize = 1;

/// Name of the group of days on which a Gaussian exists: from the first until before the second, days since 1970.
pub const DAYS: &str = "days";
/// Days of a permanent Gaussian, days since 1970.
pub const ALWAYS: [f32; 2] = [-1e6, 1e6];

/// Flag per Gaussian, true if it exists on `day` (days since 1970); `None` if the Gaussians have no days.
pub fn standing(gaussians: &crate::gaussians::Table, day: f32) -> Option<Vec<bool>> {
    let days = gaussians.groups.iter().find(|group| group.spec.name == DAYS)?;
    let stands = |window: &[f32]| (window[0]..window[1]).contains(&day);
    Some(days.values.chunks_exact(2).map(stands).collect())
}

/// Learning rate of albedo and near-surface light.
const ALBEDO_RATE: f32 = 5e-3;
/// Learning rate of the images' skies, before the softplus.
const SKY_RATE: f32 = 1e-2;
/// Learning rate of the images' colour matrices and offsets.
const COLOUR_RATE: f32 = 2e-3;

/// `ln(1 + e^x)` without overflow.
#[inline]
pub fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// Inverse of [`softplus`] for `y > 0`: `ln(e^y - 1)`.
#[inline]
pub fn softplus_inverse(y: f32) -> f32 {
    y + (-(-y).exp_m1()).ln()
}

impl ShadowGs {
    /// A model of these options; degrees above 3 are 3.
    pub fn new(options: ShadowGsOptions) -> Self {
        let degree = options.degree.min(sh::MAX_DEGREE);
        Self {
            options: ShadowGsOptions { degree, ..options },
        }
    }

    /// Share of the sun that reaches the surface of each pixel, 0 to 1; NaN where alpha is at most one half.
    pub fn sunlit(&self, maps: &Maps) -> Vec<f32> {
        let pixels = self.visibility(maps).iter().zip(&maps.alpha);
        pixels
            .map(|(visibility, &alpha)| match alpha > 0.5 {
                true => (visibility / alpha).clamp(0.0, 1.0),
                false => f32::NAN,
            })
            .collect()
    }

    /// The composited visibility of the sun, `Σ w S`, per pixel; divide by alpha for the surface's own.
    pub fn visibility<'m>(&self, maps: &'m Maps) -> &'m [f32] {
        &maps.channels[self.visibility_channel()]
    }

    /// The image composed of `maps` as if the share `visibility` of the sun, 0 to 1, reached every surface.
    pub fn compose_in(&self, visibility: f32, context: &Context, maps: &Maps) -> Raster {
        let mut maps = maps.clone();
        let Maps { channels, alpha, .. } = &mut maps;
        let seen = channels[self.visibility_channel()].iter_mut().zip(alpha.iter());
        seen.for_each(|(channel, alpha)| *channel = visibility * alpha);
        self.compose(context, &maps)
    }

    /// Index of the visibility's channel.
    pub fn visibility_channel(&self) -> usize {
        self.options.bands
    }

    /// Global parameters at the start: a sky of `sky` in every image and band, identity colours.
    pub fn initial_globals(&self, sky: f32) -> crate::gaussians::Table {
        let mut table = crate::gaussians::Table::zeros(self.global_groups(), 1);
        table.group_mut(SKY).fill(softplus_inverse(sky));
        if self.options.image_colour {
            let bands = self.options.bands;
            for image in 0..self.options.images {
                for k in 0..bands {
                    table.group_mut(COLOUR)[image * bands * bands + k * bands + k] = 1.0;
                }
            }
        }
        table
    }

    fn image(&self, context: &Context) -> usize {
        context.appearance.unwrap_or(self.options.reference)
    }

    /// Sky colour of an image, one value per band.
    pub fn sky(&self, parameters: &Parameters, image: usize) -> Vec<f32> {
        let bands = self.options.bands;
        parameters.globals.group(SKY)[image * bands..(image + 1) * bands]
            .iter()
            .map(|&x| softplus(x))
            .collect()
    }

    /// Colour matrix (row by row) and offset of an image. If images have no colours, these are the identity and the
    /// path radiance of all images.
    pub fn colour(&self, parameters: &Parameters, image: usize) -> (Vec<f32>, Vec<f32>) {
        let bands = self.options.bands;
        if !self.options.image_colour {
            let mut identity = vec![0.0; bands * bands];
            for k in 0..bands {
                identity[k * bands + k] = 1.0;
            }
            return (identity, parameters.globals.group(PATH_RADIANCE).to_vec());
        }
        let matrix = parameters.globals.group(COLOUR)[image * bands * bands..(image + 1) * bands * bands].to_vec();
        (
            matrix,
            parameters.globals.group(OFFSET)[image * bands..(image + 1) * bands].to_vec(),
        )
    }

    fn near_channel(&self) -> Option<usize> {
        self.options.near_light.then_some(self.options.bands + 1)
    }
}

impl SceneModel for ShadowGs {
    fn name(&self) -> &'static str {
        "shadow_gs"
    }

    fn feature_parameters(&self) -> Vec<ParameterGroup> {
        let (bands, rate) = (self.options.bands, LearningRate::constant(ALBEDO_RATE));
        let mut groups = vec![ParameterGroup::new("albedo", bands, rate)];
        if self.options.near_light {
            groups.push(ParameterGroup::new("near_light", bands, rate));
        }
        groups.extend(harmonics::groups(&self.options));
        if !self.options.days.is_empty() {
            groups.push(ParameterGroup::new(DAYS, 2, LearningRate::constant(0.0)));
        }
        groups
    }

    fn present(&self, parameters: &Parameters, appearance: Option<usize>) -> Option<Vec<bool>> {
        let day = *self.options.days.get(appearance.unwrap_or(self.options.reference))?;
        standing(&parameters.gaussians, day)
    }

    fn global_parameters(&self) -> Vec<ParameterGroup> {
        let ShadowGsOptions { bands, images, .. } = self.options;
        let colour = LearningRate::constant(COLOUR_RATE);
        let mut groups = vec![ParameterGroup::new(
            "sky",
            images * bands,
            LearningRate::constant(SKY_RATE),
        )];
        if self.options.image_colour {
            groups.push(ParameterGroup::new("image_colour", images * bands * bands, colour));
            groups.push(ParameterGroup::new("image_offset", images * bands, colour));
        } else {
            let untrained = LearningRate::constant(0.0);
            groups.push(ParameterGroup::new("path_radiance", bands, untrained));
        }
        groups
    }

    fn channels(&self) -> usize {
        let near = if self.options.near_light { self.options.bands } else { 0 };
        self.options.bands + 1 + near
    }

    fn needs_transmittance(&self) -> bool {
        true
    }

    fn features(&self, context: &Context, seen: &Seen, out: &mut [f32]) {
        let bands = self.options.bands;
        let albedo = context.parameters.gaussians.group(ALBEDO);
        let harmonics = Harmonics::new(&self.options, context);
        out.par_chunks_mut(seen.stride)
            .with_min_len(1024)
            .enumerate()
            .for_each(|(s, feature)| {
                let g = seen.projected.gaussian[s] as usize;
                feature[..bands].copy_from_slice(&albedo[g * bands..(g + 1) * bands]);
                feature[bands] = seen.transmittance[s];
                if let Some(at) = self.near_channel() {
                    let near = &context.parameters.gaussians.group(NEAR)[g * bands..(g + 1) * bands];
                    feature[at..at + bands].copy_from_slice(near);
                }
                if let Some(harmonics) = &harmonics {
                    harmonics.add(g, feature);
                }
            });
    }

    fn features_backward(
        &self,
        context: &Context,
        seen: &Seen,
        d_features: &[f32],
        grads: &mut Parameters,
        d_transmittance: &mut [f32],
    ) {
        let (bands, stride) = (self.options.bands, seen.stride);
        d_transmittance
            .par_iter_mut()
            .with_min_len(CHUNK)
            .enumerate()
            .for_each(|(s, d)| *d += d_features[s * stride + bands]);
        let mut add = |group: usize, at: usize| {
            let part = |s: usize| &d_features[s * stride + at..s * stride + at + bands];
            grads
                .gaussians
                .add_to_group(group, &seen.projected.gaussian, |s, slots| {
                    slots.iter_mut().zip(part(s)).for_each(|(slot, d)| *slot += d);
                });
        };
        add(ALBEDO, 0);
        if let Some(at) = self.near_channel() {
            add(NEAR, at);
        }
        if let Some(harmonics) = Harmonics::new(&self.options, context) {
            harmonics.backward(seen, d_features, grads);
        }
    }

    fn compose(&self, context: &Context, maps: &Maps) -> Raster {
        let bands = self.options.bands;
        let lighting = Lighting::new(self, context, maps);
        let pixels = maps.alpha.len();
        let mut out = Raster::filled(maps.width, maps.height, bands, 0.0);
        let colours: Vec<Vec<f32>> = (0..pixels.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| lighting.chunk(chunk))
            .collect();
        let planes = out.values.par_chunks_mut(pixels.max(1)).enumerate();
        planes.for_each(|(band, plane)| {
            for (part, values) in plane.chunks_mut(CHUNK).zip(&colours) {
                part.copy_from_slice(&values[band * part.len()..][..part.len()]);
            }
        });
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
        let bands = self.options.bands;
        let image = self.image(context);
        let lighting = Lighting::new(self, context, maps);
        let parts: Vec<ChunkGradients> = (0..maps.alpha.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| lighting.chunk_backward(chunk, d_image))
            .collect();
        let mut shared = SharedGradients::new(bands);
        parts.iter().for_each(|part| shared.add(&part.shared));
        let planes = d_maps.channels.par_iter_mut().enumerate();
        planes.for_each(|(channel, plane)| {
            for (into, part) in plane.chunks_mut(CHUNK).zip(&parts) {
                let slots = part.channels.iter().zip(part.values.chunks_exact(part.count));
                for (_, from) in slots.filter(|(of, _)| **of == channel) {
                    into.iter_mut().zip(from).for_each(|(d, v)| *d += v);
                }
            }
        });
        let raw = &context.parameters.globals.group(SKY)[image * bands..(image + 1) * bands];
        for k in 0..bands {
            let sigmoid = crate::gaussians::sigmoid(raw[k]);
            grads.globals.group_mut(SKY)[image * bands + k] += shared.sky[k] as f32 * sigmoid;
        }
        if self.options.image_colour && image != self.options.reference {
            let add = |group: &mut [f32], values: &[f64]| {
                for (slot, d) in group.iter_mut().zip(values) {
                    *slot += *d as f32;
                }
            };
            add(
                &mut grads.globals.group_mut(COLOUR)[image * bands * bands..],
                &shared.matrix,
            );
            add(&mut grads.globals.group_mut(OFFSET)[image * bands..], &shared.offset);
        }
    }

    fn light_prior_loss(&self, maps: &Maps, lit: &[f32], mask: &[f32], d_maps: &mut MapGradients) -> Option<NamedLoss> {
        let weight = self.options.prior_weight;
        let channel = self.visibility_channel();
        (weight > 0.0).then(|| {
            let visibility = &maps.channels[channel];
            (
                "shadow_prior",
                prior(visibility, lit, mask, weight, &mut d_maps.channels[channel]),
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn softplus_is_inverted_and_does_not_overflow() {
        for y in [1e-3f32, 0.25, 1.0, 30.0] {
            assert!((softplus(softplus_inverse(y)) - y).abs() < 1e-4 * y.max(1.0));
        }
        assert!(softplus(1e30).is_finite() && softplus(-1e30) >= 0.0);
    }

    #[test]
    fn a_house_is_seen_and_shades_on_its_days_only() {
        use crate::camera::ProjectiveCamera;
        use crate::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};
        use crate::light::Light;
        use crate::render::{PassOptions, render};
        // A permanent floor and a roof that exists from day 10 on, in images of days 5 and 15.
        let model = ShadowGs::new(ShadowGsOptions {
            images: 2,
            days: vec![5.0, 15.0],
            ..ShadowGsOptions::default()
        });
        let mut groups = core_groups();
        groups.extend(model.feature_groups());
        let mut gaussians = Table::zeros(groups, 2);
        gaussians
            .group_mut(POSITION)
            .copy_from_slice(&[0.0, 0.0, 0.0, 0.0, 0.0, 6.0]);
        gaussians
            .group_mut(LOG_SCALE)
            .copy_from_slice(&[1.0, 1.0, -3.0, 0.0, 0.0, -3.0]);
        gaussians.group_mut(OPACITY).fill(8.0);
        for rotation in gaussians.group_mut(ROTATION).chunks_mut(4) {
            rotation[3] = 1.0;
        }
        let days = gaussians.groups.len() - 1;
        gaussians
            .group_mut(days)
            .copy_from_slice(&[ALWAYS[0], ALWAYS[1], 10.0, ALWAYS[1]]);
        let parameters = Parameters {
            gaussians,
            globals: model.initial_globals(0.3),
        };
        let camera = ProjectiveCamera::nadir(-2.0, 2.0, 0.5, (9, 9));
        let sun = Some(Light::Directional(glam::Vec3::Z));
        let seen = |image: usize| {
            let maps = render(&model, &parameters, &camera, sun, Some(image), PassOptions::default()).maps;
            (maps.median_depth[40], maps.channels[model.visibility_channel()][40])
        };
        let (before, after) = (seen(0), seen(1));
        assert!((before.0 - after.0 - 6.0).abs() < 0.2, "{before:?} {after:?}");
        assert!(before.1 > 0.9, "the roof throws no shadow before it stands: {before:?}");
        assert_eq!(standing(&parameters.gaussians, 10.0), Some(vec![true, true]));
        assert_eq!(standing(&parameters.gaussians, 9.0), Some(vec![true, false]));
    }
}
