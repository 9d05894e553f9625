//! The satellite model (ShadowGS, Luo et al. 2026, eq. 13–15) with per-image colour.
//!
//! Channels: albedo `F` (one per band), visibility of the sun `S`, and, when switched on, near-surface light `L_n`. Per pixel
//!
//! ```text
//! L = S + (1 - S)(L_sky + L_n)        C = F ⊙ L        C' = A C + b
//! ```
//!
//! `L_sky` is a colour per image (its haze and its sun's height differ), positive through a softplus. `A` (a matrix) and `b`
//! are per image; those of the reference image stay the identity and zero, which fixes the gauge.

use super::{Context, NamedLoss, Parameters, SceneModel, Seen};
use crate::gaussians::{FEATURES, GroupSpec};
use crate::loss::shadow::opaqueness;
use crate::raster::Raster;
use crate::splat::{MapGradients, Maps};
use rayon::prelude::*;

/// What the satellite model is made of.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ShadowGsOptions {
    /// Image bands.
    pub bands: usize,
    /// Images, each with its own sky and colour.
    pub images: usize,
    /// The image whose colour is the model's.
    pub reference: usize,
    /// Per-image affine colour.
    pub image_colour: bool,
    /// Near-surface light in shadows, per Gaussian.
    pub near_light: bool,
    /// Weight of the shadow opaqueness loss.
    pub opaqueness_weight: f32,
}

impl Default for ShadowGsOptions {
    fn default() -> Self {
        Self {
            bands: 3,
            images: 1,
            reference: 0,
            image_colour: true,
            near_light: false,
            opaqueness_weight: 0.3,
        }
    }
}

/// The satellite model.
#[derive(Debug, Clone)]
pub struct ShadowGs {
    /// What it is made of.
    pub options: ShadowGsOptions,
}

/// Index of the albedo group in the Gaussian table.
pub const ALBEDO: usize = FEATURES;
const NEAR: usize = FEATURES + 1;
/// Index of the sky group in the global table.
pub const SKY: usize = 0;
/// Index of the colour matrices in the global table.
pub const COLOUR: usize = 1;
/// Index of the colour offsets in the global table.
pub const OFFSET: usize = 2;

/// `ln(1 + e^x)` without overflow.
#[inline]
pub fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// The `x` whose softplus is `y > 0`.
#[inline]
pub fn softplus_inverse(y: f32) -> f32 {
    y + (-(-y).exp_m1()).ln()
}

impl ShadowGs {
    /// A model of these options.
    pub fn new(options: ShadowGsOptions) -> Self {
        Self { options }
    }

    /// Channel of the visibility.
    pub fn visibility_channel(&self) -> usize {
        self.options.bands
    }

    /// Global parameters at the start: a sky of `sky` everywhere, identity colours.
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

    /// Sky colour of an image.
    pub fn sky(&self, parameters: &Parameters, image: usize) -> Vec<f32> {
        let bands = self.options.bands;
        parameters.globals.group(SKY)[image * bands..(image + 1) * bands]
            .iter()
            .map(|&x| softplus(x))
            .collect()
    }

    /// Colour matrix (row by row) and offset of an image.
    pub fn colour(&self, parameters: &Parameters, image: usize) -> (Vec<f32>, Vec<f32>) {
        let bands = self.options.bands;
        if !self.options.image_colour {
            let mut identity = vec![0.0; bands * bands];
            for k in 0..bands {
                identity[k * bands + k] = 1.0;
            }
            return (identity, vec![0.0; bands]);
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

    fn feature_groups(&self) -> Vec<GroupSpec> {
        let mut groups = vec![GroupSpec::new("albedo", self.options.bands)];
        if self.options.near_light {
            groups.push(GroupSpec::new("near_light", self.options.bands));
        }
        groups
    }

    fn global_groups(&self) -> Vec<GroupSpec> {
        let ShadowGsOptions { bands, images, .. } = self.options;
        let mut groups = vec![GroupSpec::new("sky", images * bands)];
        if self.options.image_colour {
            groups.push(GroupSpec::new("image_colour", images * bands * bands));
            groups.push(GroupSpec::new("image_offset", images * bands));
        }
        groups
    }

    fn learning_rate(&self, group: &str) -> f32 {
        match group {
            "albedo" | "near_light" => 5e-3,
            "sky" => 1e-2,
            _ => 2e-3,
        }
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
            });
    }

    fn features_backward(
        &self,
        _context: &Context,
        seen: &Seen,
        d_features: &[f32],
        grads: &mut Parameters,
        d_transmittance: &mut [f32],
    ) {
        let bands = self.options.bands;
        for (s, feature) in d_features.chunks(seen.stride).enumerate() {
            let g = seen.projected.gaussian[s] as usize;
            d_transmittance[s] += feature[bands];
            let albedo = &mut grads.gaussians.groups[ALBEDO].values[g * bands..(g + 1) * bands];
            for (slot, d) in albedo.iter_mut().zip(&feature[..bands]) {
                *slot += d;
            }
            if let Some(at) = self.near_channel() {
                let near = &mut grads.gaussians.groups[NEAR].values[g * bands..(g + 1) * bands];
                for (slot, d) in near.iter_mut().zip(&feature[at..at + bands]) {
                    *slot += d;
                }
            }
        }
    }

    fn compose(&self, context: &Context, maps: &Maps) -> Raster {
        let bands = self.options.bands;
        let image = self.image(context);
        let sky = self.sky(context.parameters, image);
        let (matrix, offset) = self.colour(context.parameters, image);
        let visibility = &maps.channels[bands];
        let mut out = Raster::filled(maps.width, maps.height, bands, 0.0);
        let mut colour = vec![0.0; bands];
        for i in 0..maps.alpha.len() {
            let s = visibility[i];
            for k in 0..bands {
                let near = self.near_channel().map_or(0.0, |at| maps.channels[at + k][i]);
                colour[k] = maps.channels[k][i] * (s + (1.0 - s) * (sky[k] + near));
            }
            for row in 0..bands {
                let mixed: f32 = (0..bands).map(|k| matrix[row * bands + k] * colour[k]).sum();
                out.values[row * maps.alpha.len() + i] = mixed + offset[row];
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
        let bands = self.options.bands;
        let image = self.image(context);
        let sky = self.sky(context.parameters, image);
        let (matrix, _) = self.colour(context.parameters, image);
        let pixels = maps.alpha.len();
        let mut d_sky = vec![0.0f64; bands];
        let mut d_matrix = vec![0.0f64; bands * bands];
        let mut d_offset = vec![0.0f64; bands];
        let mut light = vec![0.0; bands];
        for i in 0..pixels {
            let s = maps.channels[bands][i];
            let mut d_visibility = 0.0;
            for k in 0..bands {
                let near = self.near_channel().map_or(0.0, |at| maps.channels[at + k][i]);
                light[k] = s + (1.0 - s) * (sky[k] + near);
            }
            for k in 0..bands {
                let albedo = maps.channels[k][i];
                let mut d_colour = 0.0;
                for row in 0..bands {
                    let d = d_image.values[row * pixels + i];
                    d_colour += matrix[row * bands + k] * d;
                    d_matrix[row * bands + k] += f64::from(d * albedo * light[k]);
                }
                d_offset[k] += f64::from(d_image.values[k * pixels + i]);
                d_maps.channels[k][i] += d_colour * light[k];
                let d_light = d_colour * albedo;
                let near = self.near_channel().map_or(0.0, |at| maps.channels[at + k][i]);
                d_visibility += d_light * (1.0 - sky[k] - near);
                d_sky[k] += f64::from(d_light * (1.0 - s));
                if let Some(at) = self.near_channel() {
                    d_maps.channels[at + k][i] += d_light * (1.0 - s);
                }
            }
            d_maps.channels[bands][i] += d_visibility;
        }
        let raw = &context.parameters.globals.group(SKY)[image * bands..(image + 1) * bands];
        for k in 0..bands {
            let sigmoid = crate::gaussians::sigmoid(raw[k]);
            grads.globals.group_mut(SKY)[image * bands + k] += d_sky[k] as f32 * sigmoid;
        }
        if self.options.image_colour && image != self.options.reference {
            for (slot, d) in grads.globals.group_mut(COLOUR)[image * bands * bands..]
                .iter_mut()
                .zip(&d_matrix)
            {
                *slot += *d as f32;
            }
            for (slot, d) in grads.globals.group_mut(OFFSET)[image * bands..]
                .iter_mut()
                .zip(&d_offset)
            {
                *slot += *d as f32;
            }
        }
    }

    fn map_losses(&self, _context: &Context, maps: &Maps, mask: &[f32], d_maps: &mut MapGradients) -> Vec<NamedLoss> {
        if self.options.opaqueness_weight == 0.0 {
            return Vec::new();
        }
        let channel = self.visibility_channel();
        let weight = self.options.opaqueness_weight;
        vec![(
            "opaqueness",
            opaqueness(&maps.channels[channel], mask, weight, &mut d_maps.channels[channel]),
        )]
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
}
