//! A rendering pass: project, trace, compute features, rasterise, compose, and its backward pass.
//!
//! Training and products render through the same [`Pass`]; training keeps it for the backward pass. Nothing is stored per pixel and
//! splat: backward repeats the forward arithmetic.

use crate::camera::ProjectiveCamera;
use crate::gaussians::Table;
use crate::light::Light;
use crate::model::{Context, Parameters, SceneModel, Seen};
use crate::raster::Raster;
use crate::splat::rasterise::padded_channels;
use crate::splat::{
    Bins, Depths, MapGradients, Maps, Projected, ProjectionOptions, Rasteriser, SplatGradient, project::project,
    project::project_backward,
};
use crate::timeline::stage;
use crate::trace::{OccluderGradients, Occluders, Transmittance, transmittance};

/// Options of a pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassOptions {
    /// Gaussians to splats.
    pub projection: ProjectionOptions,
    /// Which gradients of light reach what stands in its way.
    pub occluder_gradients: OccluderGradients,
    /// Whether three channels with the splats' normals follow the model's.
    pub normals: bool,
    /// What is composited of depths along rays besides their mean.
    pub depths: Depths,
}

impl Default for PassOptions {
    fn default() -> Self {
        Self {
            projection: ProjectionOptions::default(),
            occluder_gradients: OccluderGradients::All,
            normals: false,
            depths: Depths::default(),
        }
    }
}

/// Visibility of the light from the Gaussians: how a pass gets it.
#[derive(Clone, Copy)]
pub enum Lit<'a> {
    /// Every Gaussian is fully lit.
    Everywhere,
    /// Traced through these occluders; gradients go back along the rays.
    Traced(&'a Occluders),
    /// Cached transmittances, one per Gaussian, of an earlier trace; no gradients go back.
    Known(&'a [f32]),
}

/// A rendered view, with what its backward pass needs.
pub struct Pass<'a> {
    model: &'a dyn SceneModel,
    context: Context<'a>,
    light: Lit<'a>,
    options: PassOptions,
    /// The splats.
    pub projected: Projected,
    bins: Bins,
    traced: Transmittance,
    features: Vec<f32>,
    stride: usize,
    /// The composited maps.
    pub maps: Maps,
}

impl<'a> Pass<'a> {
    /// Renders the model of `context` through its camera; `light` is how the transmittance toward the context's light is found.
    pub fn new(model: &'a dyn SceneModel, context: Context<'a>, light: Lit<'a>, options: PassOptions) -> Self {
        let gaussians = &context.parameters.gaussians;
        let part = stage("project");
        let mut projected = project(gaussians, context.camera, &options.projection);
        if let Some(present) = model.present(context.parameters, context.appearance) {
            projected.keep(&present);
        }
        drop(part);
        let part = stage("light");
        let traced = match (light, &context.light) {
            (Lit::Traced(occluders), Some(source)) if model.needs_transmittance() => {
                transmittance(occluders, &projected.gaussian, source)
            }
            (Lit::Known(values), _) => {
                Transmittance::known(projected.gaussian.iter().map(|&g| values[g as usize]).collect())
            }
            _ => Transmittance::known(vec![1.0; projected.splats.len()]),
        };
        drop(part);
        let part = stage("features");
        let channels = model.channels() + if options.normals { 3 } else { 0 };
        let stride = padded_channels(channels);
        let mut features = vec![0.0; projected.splats.len() * stride];
        let seen = Seen {
            projected: &projected,
            transmittance: &traced.values,
            stride,
        };
        model.features(&context, &seen, &mut features);
        if options.normals {
            let at = model.channels();
            for (feature, splat) in features.chunks_mut(stride).zip(&projected.splats) {
                feature[at..at + 3].copy_from_slice(&splat.normal);
            }
        }
        drop(part);
        let _part = stage("rasterise");
        let rasteriser =
            Rasteriser::new(&projected, context.camera.width, context.camera.height).with_depths(options.depths);
        let maps = rasteriser.forward(&features, stride);
        let bins = rasteriser.into_bins();
        Self {
            bins,
            model,
            context,
            light,
            options,
            traced,
            features,
            stride,
            maps,
            projected,
        }
    }

    /// The camera.
    pub fn camera(&self) -> &ProjectiveCamera {
        self.context.camera
    }

    /// The transmittances of the splats toward the light.
    pub fn transmittances(&self) -> &[f32] {
        &self.traced.values
    }

    /// The image that the model composes of the maps.
    pub fn image(&self) -> Raster {
        self.model.compose(&self.context, &self.maps)
    }

    /// Channel of the first component of the normals.
    pub fn normal_channel(&self) -> usize {
        self.model.channels()
    }

    /// Zero gradients for the maps.
    pub fn zero_gradients(&self) -> MapGradients {
        let channels = self.model.channels() + if self.options.normals { 3 } else { 0 };
        MapGradients::zeros(channels, self.maps.alpha.len())
    }

    /// Backward pass: adds to the gradients of all parameters from those of the maps; returns those of the splats, for density control.
    pub fn backward(&self, d_maps: &MapGradients, grads: &mut Parameters) -> Vec<SplatGradient> {
        let camera = self.context.camera;
        let gaussians = &self.context.parameters.gaussians;
        let part = stage("rasterise, backward");
        let rasteriser = Rasteriser::with_bins(&self.projected, &self.bins, camera.width, camera.height);
        let mut splat_gradients = rasteriser.backward(&self.features, self.stride, &self.maps, d_maps);
        drop(part);
        let part = stage("features, backward");
        if self.options.normals {
            let at = self.model.channels();
            for (splat, feature) in splat_gradients
                .splats
                .iter_mut()
                .zip(splat_gradients.features.chunks(self.stride))
            {
                splat.normal.copy_from_slice(&feature[at..at + 3]);
            }
        }
        let seen = Seen {
            projected: &self.projected,
            transmittance: &self.traced.values,
            stride: self.stride,
        };
        let mut d_transmittance = vec![0.0; self.projected.splats.len()];
        self.model.features_backward(
            &self.context,
            &seen,
            &splat_gradients.features,
            grads,
            &mut d_transmittance,
        );
        drop(part);
        let part = stage("project, backward");
        project_backward(
            gaussians,
            camera,
            &self.options.projection,
            &self.projected,
            &splat_gradients.splats,
            &mut grads.gaussians,
        );
        drop(part);
        if let Lit::Traced(occluders) = self.light {
            let _part = stage("light, backward");
            self.traced.backward(
                gaussians,
                (occluders, self.options.occluder_gradients),
                &self.projected.gaussian,
                &d_transmittance,
                &mut grads.gaussians,
            );
        }
        splat_gradients.splats
    }
}

/// A rendered view for products.
pub struct Rendering {
    /// The image.
    pub image: Raster,
    /// The maps, the model's channels first, then the normals.
    pub maps: Maps,
}

/// Composites alpha and depths (mean, squares and median, metres) of a view and nothing else: no model, no light.
pub fn depths(gaussians: &Table, camera: &ProjectiveCamera, projection: &ProjectionOptions) -> Maps {
    let projected = project(gaussians, camera, projection);
    let stride = padded_channels(1);
    let features = vec![0.0; projected.splats.len() * stride];
    let rasteriser = Rasteriser::new(&projected, camera.width, camera.height).with_depths(Depths::Median);
    rasteriser.forward(&features, stride)
}

/// Renders a model once, with normals and all depths whatever `options` say, and keeps nothing for a backward pass.
pub fn render(
    model: &dyn SceneModel,
    parameters: &Parameters,
    camera: &ProjectiveCamera,
    light: Option<Light>,
    appearance: Option<usize>,
    options: PassOptions,
) -> Rendering {
    let mut occluders = (model.needs_transmittance() && light.is_some()).then(|| Occluders::new(&parameters.gaussians));
    if let (Some(occluders), Some(present)) = (&mut occluders, model.present(parameters, appearance)) {
        occluders.hide(&present);
    }
    let context = Context {
        parameters,
        camera,
        light,
        appearance,
    };
    let lit = occluders.as_ref().map_or(Lit::Everywhere, Lit::Traced);
    let options = PassOptions {
        normals: true,
        depths: Depths::Median,
        ..options
    };
    let pass = Pass::new(model, context, lit, options);
    Rendering {
        image: pass.image(),
        maps: pass.maps,
    }
}
