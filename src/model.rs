//! The seam: what a kind of scene adds to the shared engine.
//!
//! A scene model says which parameters it adds to each Gaussian and which it shares between all, how those become
//! rasterised channels for a view and a light, how composited channels become a pixel, and the gradients of both. The
//! rasteriser, the tracer, the losses, the optimiser and the trainer name no model.

pub mod network;
pub mod olat;
mod over;
pub mod radiance;
pub mod reflective;
pub mod shadow_gs;
mod sight;

use crate::camera::ProjectiveCamera;
use crate::gaussians::{GroupSpec, Table};
use crate::light::Light;
use crate::raster::Raster;
use crate::splat::{MapGradients, Maps, Projected};
use std::borrow::Cow;

/// Everything that is trained.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Parameters {
    /// Per Gaussian: the core groups, then the model's.
    pub gaussians: Table,
    /// Shared by all Gaussians: one element with the model's global groups.
    pub globals: Table,
}

impl Parameters {
    /// Zeros of the same shape.
    pub fn zeros_like(&self) -> Self {
        Self {
            gaussians: self.gaussians.zeros_like(),
            globals: self.globals.zeros_like(),
        }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.gaussians.is_finite() && self.globals.is_finite()
    }
}

/// One image to learn from.
#[derive(Debug, Clone)]
pub struct View {
    /// Its name in reports.
    pub name: String,
    /// Where it was seen from.
    pub camera: ProjectiveCamera,
    /// What was seen; NaN where missing.
    pub image: Raster,
    /// What lit it.
    pub light: Option<Light>,
    /// Which set of per-image parameters is its own.
    pub appearance: usize,
    /// How much each pixel counts, 0 to 1, `[row][column]`.
    pub weight: Vec<f32>,
    /// What is thought beforehand to be lit, 0 to 1, NaN where nothing is; `[row][column]`.
    pub lit: Option<Vec<f32>>,
    /// The most that each band can say: such a value, or a greater one, was seen. Empty where no value is clipped.
    pub ceiling: Vec<f32>,
}

impl View {
    /// What was seen, as far as it contradicts `image`: a clipped value does not say how much brighter it was.
    pub fn truth(&self, image: &Raster) -> Cow<'_, Raster> {
        let mut truth = Cow::Borrowed(&self.image);
        for (band, &ceiling) in self.ceiling.iter().enumerate().filter(|(_, c)| c.is_finite()) {
            // The mean of equal values may differ from them in the last digit.
            let clipped = ceiling * (1.0 - 1e-5);
            let plane = truth.to_mut().plane_mut(band);
            for (seen, shown) in plane.iter_mut().zip(image.plane(band)) {
                if *seen >= clipped && *shown > *seen {
                    *seen = *shown;
                }
            }
        }
        truth
    }
}

/// What a model may look at when it makes features or pixels.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// The state of training.
    pub parameters: &'a Parameters,
    /// The camera of the view.
    pub camera: &'a ProjectiveCamera,
    /// Its light.
    pub light: Option<Light>,
    /// Its set of per-image parameters; `None` renders with those of the reference image.
    pub appearance: Option<usize>,
}

/// The splats a model makes features for.
#[derive(Clone, Copy)]
pub struct Seen<'a> {
    /// The projected Gaussians.
    pub projected: &'a Projected,
    /// Transmittance toward the light, one per splat, when the model asked for it.
    pub transmittance: &'a [f32],
    /// Numbers per splat in the feature array.
    pub stride: usize,
}

/// A named value for the log.
pub type NamedLoss = (&'static str, f64);

/// A kind of scene.
pub trait SceneModel: Send + Sync {
    /// Name, as in configurations and files.
    fn name(&self) -> &'static str;

    /// Groups added to every Gaussian.
    fn feature_groups(&self) -> Vec<GroupSpec>;

    /// Groups shared by all Gaussians (a table of one element).
    fn global_groups(&self) -> Vec<GroupSpec>;

    /// Learning rate of a model group, by name, when `progress` (0 to 1) of training is done; what is not yet to learn has zero.
    fn learning_rate(&self, group: &str, progress: f32) -> f32;

    /// Rasterised channels the model writes into the features.
    fn channels(&self) -> usize;

    /// Whether features need the transmittance toward the light.
    fn needs_transmittance(&self) -> bool;

    /// Whether composing needs the composited normals, which then follow the model's channels.
    fn needs_normals(&self) -> bool {
        false
    }

    /// Writes the channels of every splat: `out[splat * stride + channel]`.
    fn features(&self, context: &Context, seen: &Seen, out: &mut [f32]);

    /// From gradients of the features, adds those of the parameters, and of the transmittance to `d_transmittance`.
    fn features_backward(
        &self,
        context: &Context,
        seen: &Seen,
        d_features: &[f32],
        grads: &mut Parameters,
        d_transmittance: &mut [f32],
    );

    /// The image that the composited channels make.
    fn compose(&self, context: &Context, maps: &Maps) -> Raster;

    /// From the gradient of the image, adds those of the maps and of the shared parameters.
    fn compose_backward(
        &self,
        context: &Context,
        maps: &Maps,
        d_image: &Raster,
        d_maps: &mut MapGradients,
        grads: &mut Parameters,
    );

    /// Losses of the model's own on the maps; adds their gradients. `mask` is per pixel.
    fn map_losses(&self, context: &Context, maps: &Maps, mask: &[f32], d_maps: &mut MapGradients) -> Vec<NamedLoss>;

    /// The loss between the light on the maps and what a view's pixels are thought to be lit by (see [`View::lit`]); adds its
    /// gradients.
    fn light_prior_loss(
        &self,
        _maps: &Maps,
        _lit: &[f32],
        _mask: &[f32],
        _d_maps: &mut MapGradients,
    ) -> Option<NamedLoss> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clipped_value_contradicts_only_what_is_darker() {
        let seen = |values: &[f32]| Raster {
            width: values.len(),
            height: 1,
            bands: 1,
            values: values.to_vec(),
        };
        let view = View {
            name: "a".into(),
            camera: ProjectiveCamera::nadir(0.0, 0.0, 1.0, (4, 1)),
            image: seen(&[0.2, 0.9, 0.9, f32::NAN]),
            light: None,
            appearance: 0,
            weight: vec![1.0; 4],
            lit: None,
            ceiling: vec![0.9],
        };
        let truth = view.truth(&seen(&[0.5, 1.3, 0.4, 2.0]));
        assert_eq!(truth.values[..3], [0.2, 1.3, 0.9]);
        assert!(truth.values[3].is_nan());
    }
}
