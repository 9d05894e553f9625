//! Scene models: the trait through which a kind of scene plugs into the shared engine, and its implementations.
//!
//! A [`SceneModel`] defines the parameters that it adds to each Gaussian and those that all share, with their learning
//! rates; the rasterised channels for a view and a light; the composition of channels to pixels; and the gradients of
//! both. The rasteriser, the tracer, the losses, the optimiser and the trainer depend on no particular model.

mod background;
pub mod network;
pub mod olat;
pub mod radiance;
pub mod reflective;
pub mod shadow_gs;
mod view_direction;

pub use background::Background;

use crate::camera::ProjectiveCamera;
use crate::gaussians::{GroupSpec, Table};
use crate::light::Light;
use crate::optim::ParameterGroup;
use crate::raster::Raster;
use crate::splat::{MapGradients, Maps, Projected};
use background::{over_background, over_background_backward};
use std::borrow::Cow;
use std::sync::Arc;

/// The trained parameters: those of each Gaussian, and those that all share.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Parameters {
    /// Per Gaussian: the core groups, then the model's.
    pub gaussians: Table,
    /// Shared by all Gaussians: one element with the model's global groups.
    pub globals: Table,
}

impl Parameters {
    /// Parameters of the same shape, all zero.
    pub fn zeros_like(&self) -> Self {
        Self {
            gaussians: self.gaussians.zeros_like(),
            globals: self.globals.zeros_like(),
        }
    }

    /// True if every number is finite.
    pub fn is_finite(&self) -> bool {
        self.gaussians.is_finite() && self.globals.is_finite()
    }
}

/// One training image.
#[derive(Debug, Clone)]
pub struct View {
    /// Name in reports.
    pub name: String,
    /// Camera of the image.
    pub camera: ProjectiveCamera,
    /// Pixels, in the model's units, NaN where missing; shared with the scene that they were read from.
    pub image: Arc<Raster>,
    /// Light on the scene, if known.
    pub light: Option<Light>,
    /// Index of the per-image parameters.
    pub appearance: usize,
    /// Weight of each pixel in the losses, 0 to 1, `[row][column]`.
    pub weight: Vec<f32>,
    /// Prior of the sun's visibility: 1 where a pixel is probably lit, 0 in shadow, NaN where unknown; `[row][column]`.
    pub visibility_prior: Option<Vec<f32>>,
    /// Saturation value of each band: the true brightness of a pixel at this value is that or more. Empty when no value
    /// is clipped.
    pub ceiling: Vec<f32>,
}

impl View {
    /// Pixels to compare a rendered `image` with: those of this view, but the rendered value where a pixel is saturated
    /// and `image` is brighter, because the true value above saturation is unknown.
    pub fn truth(&self, image: &Raster) -> Cow<'_, Raster> {
        let mut truth = Cow::Borrowed(&*self.image);
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

/// The state and the view that a model computes features and pixels from.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    /// Parameters of the model.
    pub parameters: &'a Parameters,
    /// Camera of the view.
    pub camera: &'a ProjectiveCamera,
    /// Light of the view, if any.
    pub light: Option<Light>,
    /// Index of the view's per-image parameters; `None` renders with those of the reference image.
    pub appearance: Option<usize>,
}

/// The splats of a view, for which a model computes features.
#[derive(Clone, Copy)]
pub struct Seen<'a> {
    /// Splats and their Gaussians.
    pub projected: &'a Projected,
    /// Transmittance toward the light, 0 to 1, one per splat; ones if the model does not need it.
    pub transmittance: &'a [f32],
    /// Numbers per splat in the feature array.
    pub stride: usize,
}

/// A loss, by name and unweighted value, for the log.
pub type NamedLoss = (&'static str, f64);

/// A kind of scene: its parameters, rasterised channels and pixels, and their gradients.
pub trait SceneModel: Send + Sync {
    /// Name, as in configurations and files.
    fn name(&self) -> &'static str;

    /// The groups of parameters added to every Gaussian, in the order of the table from
    /// [`FEATURES`](crate::gaussians::FEATURES) on.
    fn feature_parameters(&self) -> Vec<ParameterGroup>;

    /// The groups of parameters shared by all Gaussians (a table of one element).
    fn global_parameters(&self) -> Vec<ParameterGroup>;

    /// Flag per Gaussian, true if it is present in a view; `None`: all are. Light passes through the others.
    fn present(&self, _parameters: &Parameters, _appearance: Option<usize>) -> Option<Vec<bool>> {
        None
    }

    /// Names and widths of [`Self::feature_parameters`].
    fn feature_groups(&self) -> Vec<GroupSpec> {
        self.feature_parameters().into_iter().map(|group| group.spec).collect()
    }

    /// Names and widths of [`Self::global_parameters`].
    fn global_groups(&self) -> Vec<GroupSpec> {
        self.global_parameters().into_iter().map(|group| group.spec).collect()
    }

    /// Number of rasterised channels that the model writes into the features.
    fn channels(&self) -> usize;

    /// True if features need the transmittance toward the light.
    fn needs_transmittance(&self) -> bool;

    /// Writes the channels of every splat: `out[splat * stride + channel]`.
    fn features(&self, context: &Context, seen: &Seen, out: &mut [f32]);

    /// Adds the gradients of the parameters to `grads`, and of the transmittance to `d_transmittance`, from those of
    /// the features, `d_features`, `[splat][stride]`.
    fn features_backward(
        &self,
        context: &Context,
        seen: &Seen,
        d_features: &[f32],
        grads: &mut Parameters,
        d_transmittance: &mut [f32],
    );

    /// Background behind the Gaussians, for [`Self::compose`].
    fn background(&self) -> Background {
        ([0.0; 3], false)
    }

    /// The image that the composited channels make: the first three over the background, unless a model does otherwise.
    fn compose(&self, _context: &Context, maps: &Maps) -> Raster {
        over_background(maps, self.background())
    }

    /// Adds the gradients of the maps to `d_maps`, and of the shared parameters to `grads`, from that of the image.
    fn compose_backward(
        &self,
        _context: &Context,
        _maps: &Maps,
        d_image: &Raster,
        d_maps: &mut MapGradients,
        _grads: &mut Parameters,
    ) {
        over_background_backward(d_image, self.background(), d_maps);
    }

    /// Losses of the model's own on the maps; adds their gradients.
    fn map_losses(&self, _context: &Context, _maps: &Maps, _d_maps: &mut MapGradients) -> Vec<NamedLoss> {
        Vec::new()
    }

    /// The loss between the rendered visibility of the sun and its prior (see [`View::visibility_prior`]); adds its
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
        let seen = |values: &[f32]| Raster::of_plane(values.len(), 1, values.to_vec());
        let view = View {
            name: "a".into(),
            camera: ProjectiveCamera::nadir(0.0, 0.0, 1.0, (4, 1)),
            image: seen(&[0.2, 0.9, 0.9, f32::NAN]).into(),
            light: None,
            appearance: 0,
            weight: vec![1.0; 4],
            visibility_prior: None,
            ceiling: vec![0.9],
        };
        let truth = view.truth(&seen(&[0.5, 1.3, 0.4, 2.0]));
        assert_eq!(truth.values[..3], [0.2, 1.3, 0.9]);
        assert!(truth.values[3].is_nan());
    }
}
