//! A rendering pass: project, trace, compute features, rasterise, compose, and its backward pass.
//!
//! Training and products render through the same [`Pass`]; training keeps it for the backward pass. Nothing is stored
//! per pixel and splat: backward repeats the forward arithmetic.

use crate::camera::ProjectiveCamera;
use crate::gaussians::Table;
use crate::light::Light;
use crate::model::{Context, Parameters, SceneModel, Seen};
use crate::parallel::defaults;
use crate::raster::Raster;
use crate::splat::rasterise::{MOST_CHANNELS, padded_channels};
use crate::splat::{
    Bins, Depths, MapGradients, Maps, Projected, ProjectionOptions, Rasteriser, SplatGradient, project::project,
    project::project_backward,
};
use crate::timeline::stage;
use crate::trace::{OccluderGradients, Occluders, Transmittance, transmittance};
use rayon::prelude::*;

/// Least number of splats per parallel job.
const CHUNK: usize = 4096;

/// Options of a pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassOptions {
    /// Options of the projection of Gaussians to splats.
    pub projection: ProjectionOptions,
    /// Gradients of light that reach the occluders.
    pub occluder_gradients: OccluderGradients,
    /// True if three channels with the splats' normals follow the model's.
    pub normals: bool,
    /// Composited depths along rays besides their mean.
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

/// Source of the transmittances from the Gaussians to the light in a pass.
#[derive(Clone, Copy)]
pub enum Lit<'a> {
    /// Every Gaussian is fully lit.
    Everywhere,
    /// Traced through these occluders; gradients go back along the rays.
    Traced(&'a Occluders),
    /// Cached transmittances, one per Gaussian, of an earlier trace; no gradients go back.
    Given(&'a [f32]),
    /// Traced, except for Gaussians that keep the transmittance of an earlier trace; these get no gradients along their
    /// light.
    TracedExcept {
        /// The occluders.
        occluders: &'a Occluders,
        /// Transmittances of an earlier trace, one per Gaussian.
        known: &'a [f32],
        /// Flag per Gaussian, true if it keeps the transmittance in `known`.
        kept: &'a [bool],
    },
}

impl<'a> Lit<'a> {
    fn occluders(&self) -> Option<&'a Occluders> {
        match *self {
            Lit::Traced(occluders) | Lit::TracedExcept { occluders, .. } => Some(occluders),
            Lit::Everywhere | Lit::Given(_) => None,
        }
    }
}

/// The light of a pass: the transmittance of every splat, and the trace of those that were traced.
struct PassLight {
    transmittances: Vec<f32>,
    traced: Transmittance,
    /// The Gaussians that were traced, and their places among the splats.
    origins: Vec<u32>,
    places: Vec<u32>,
}

impl PassLight {
    fn known(transmittances: Vec<f32>) -> Self {
        Self {
            transmittances,
            traced: Transmittance::default(),
            origins: Vec::new(),
            places: Vec::new(),
        }
    }

    /// Traces the splats whose Gaussian has no transmittance in `known`.
    fn trace(
        splats: &[u32],
        (occluders, light): (&Occluders, &Light),
        known: impl Fn(u32) -> Option<f32> + Sync,
    ) -> Self {
        let all = || splats.par_iter().with_min_len(CHUNK);
        let mut transmittances: Vec<f32> = all().map(|&gaussian| known(gaussian).unwrap_or_default()).collect();
        let (origins, places): (Vec<u32>, Vec<u32>) = all()
            .enumerate()
            .filter(|(_, gaussian)| known(**gaussian).is_none())
            .map(|(place, &gaussian)| (gaussian, place as u32))
            .unzip();
        let traced = transmittance(occluders, &origins, light);
        for (&place, &value) in places.iter().zip(&traced.values) {
            transmittances[place as usize] = value;
        }
        Self {
            transmittances,
            traced,
            origins,
            places,
        }
    }

    /// Selects the gradients of the traced splats from those of all splats.
    fn of_traced(&self, gradients: &[f32]) -> Vec<f32> {
        let places = self.places.par_iter().with_min_len(CHUNK);
        places.map(|&place| gradients[place as usize]).collect()
    }
}

/// Results of a backward pass besides the gradients of parameters.
pub struct PassGradients {
    /// Splats of the pass.
    pub projected: Projected,
    /// Gradients to the positions and shapes of the splats in the image, for density control.
    pub splats: Vec<SplatGradient>,
    /// Transmittance of each splat toward the light, 0 to 1.
    pub transmittances: Vec<f32>,
    /// Gradient to the transmittance of each splat.
    pub d_transmittances: Vec<f32>,
}

/// A rendered view, with the inputs of its backward pass.
pub struct Pass<'a> {
    model: &'a dyn SceneModel,
    context: Context<'a>,
    light: Lit<'a>,
    options: PassOptions,
    /// Splats of the view.
    pub projected: Projected,
    bins: Bins,
    lit: PassLight,
    features: Vec<f32>,
    stride: usize,
    /// Composited maps of the view.
    pub maps: Maps,
}

impl<'a> Pass<'a> {
    /// Renders the model of `context` through its camera; `light` is the source of the transmittances toward the
    /// context's light.
    pub fn new(model: &'a dyn SceneModel, context: Context<'a>, light: Lit<'a>, options: PassOptions) -> Self {
        let gaussians = &context.parameters.gaussians;
        let part = stage("project");
        let mut projected = project(gaussians, context.camera, &options.projection);
        if let Some(present) = model.present(context.parameters, context.appearance) {
            projected.keep(&present);
        }
        drop(part);
        let part = stage("light");
        let lit = match (light, &context.light) {
            (Lit::Traced(occluders), Some(source)) if model.needs_transmittance() => {
                PassLight::trace(&projected.gaussian, (occluders, source), |_| None)
            }
            (Lit::TracedExcept { occluders, known, kept }, Some(source)) if model.needs_transmittance() => {
                let known = |g: u32| kept[g as usize].then(|| known[g as usize]);
                PassLight::trace(&projected.gaussian, (occluders, source), known)
            }
            (Lit::Given(values), _) => {
                let splats = projected.gaussian.par_iter().with_min_len(CHUNK);
                PassLight::known(splats.map(|&g| values[g as usize]).collect())
            }
            _ => PassLight::known(vec![1.0; projected.splats.len()]),
        };
        drop(part);
        let part = stage("features");
        let channels = model.channels() + if options.normals { 3 } else { 0 };
        let stride = padded_channels(channels);
        let mut features = defaults(projected.splats.len() * stride);
        let seen = Seen {
            projected: &projected,
            transmittance: &lit.transmittances,
            stride,
        };
        model.features(&context, &seen, &mut features);
        if options.normals {
            let at = model.channels();
            let splats = features
                .par_chunks_mut(stride)
                .zip(&projected.splats)
                .with_min_len(CHUNK);
            splats.for_each(|(feature, splat)| feature[at..at + 3].copy_from_slice(&splat.normal));
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
            lit,
            features,
            stride,
            maps,
            projected,
        }
    }

    /// Camera of the view.
    pub fn camera(&self) -> &ProjectiveCamera {
        self.context.camera
    }

    /// Transmittances of the splats toward the light, 0 to 1.
    pub fn transmittances(&self) -> &[f32] {
        &self.lit.transmittances
    }

    /// The image that the model composes of the maps.
    pub fn image(&self) -> Raster {
        self.model.compose(&self.context, &self.maps)
    }

    /// Index of the channel of the normals' first component.
    pub fn normal_channel(&self) -> usize {
        self.model.channels()
    }

    /// Zero gradients for the maps.
    pub fn zero_gradients(&self) -> MapGradients {
        let channels = self.model.channels() + if self.options.normals { 3 } else { 0 };
        MapGradients::zeros(channels, self.maps.alpha.len())
    }

    /// Sums of per-pixel `planes` at each splat, with the weights of its compositing: `[splat][plane]`.
    pub fn spread(&self, planes: &[Vec<f32>]) -> Vec<f32> {
        let _part = stage("rasterise, backward");
        let camera = self.context.camera;
        let (splats, pixels) = (self.projected.splats.len(), self.maps.alpha.len());
        let rasteriser = Rasteriser::with_bins(&self.projected, &self.bins, camera.width, camera.height);
        let mut all = defaults(splats * planes.len());
        for (number, some) in planes.chunks(MOST_CHANNELS).enumerate() {
            // These sums are the gradients of composited features. The features' values and the gradients of the splats
            // are not used.
            let stride = padded_channels(some.len());
            let (features, zero) = (defaults(splats * stride), MapGradients::zeros(some.len(), pixels));
            let maps = Maps {
                channels: zero.channels,
                alpha: zero.alpha.clone(),
                depth: zero.depth.clone(),
                ..Maps::default()
            };
            let gradients = MapGradients {
                channels: some.par_iter().cloned().collect(),
                ..zero
            };
            let found = rasteriser.backward(&features, stride, &maps, &gradients);
            let rows = all.par_chunks_mut(planes.len()).zip(found.features.par_chunks(stride));
            rows.for_each(|(row, found)| {
                let row = &mut row[number * MOST_CHANNELS..][..some.len()];
                row.copy_from_slice(&found[..some.len()]);
            });
        }
        all
    }

    /// Backward pass: adds the gradients of all parameters to `grads`, from the gradients of the maps. Frees the memory
    /// of each stage after its use.
    pub fn backward(self, d_maps: MapGradients, grads: &mut Parameters) -> PassGradients {
        let camera = self.context.camera;
        let gaussians = &self.context.parameters.gaussians;
        let part = stage("rasterise, backward");
        let rasteriser = Rasteriser::with_bins(&self.projected, &self.bins, camera.width, camera.height);
        let mut splat_gradients = rasteriser.backward(&self.features, self.stride, &self.maps, &d_maps);
        drop((d_maps, self.maps, self.bins, self.features));
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
            transmittance: &self.lit.transmittances,
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
        drop(splat_gradients.features);
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
        if let Some(occluders) = self.light.occluders() {
            let _part = stage("light, backward");
            let lit = &self.lit;
            let d_traced = lit.of_traced(&d_transmittance);
            let occluders = (occluders, self.options.occluder_gradients);
            lit.traced
                .backward(gaussians, occluders, &lit.origins, &d_traced, &mut grads.gaussians);
        }
        PassGradients {
            projected: self.projected,
            splats: splat_gradients.splats,
            transmittances: self.lit.transmittances,
            d_transmittances: d_transmittance,
        }
    }
}

/// A rendered view for products.
pub struct Rendering {
    /// Image that the model composes of the maps.
    pub image: Raster,
    /// The maps, the model's channels first, then the normals.
    pub maps: Maps,
}

/// Composites alpha and depths (mean, squares and median, metres) of a view and nothing else: no model, no light.
pub fn depths(gaussians: &Table, camera: &ProjectiveCamera, projection: &ProjectionOptions) -> Maps {
    depths_and(gaussians, camera, projection, |_| 0.0)
}

/// Composites alpha and depths as [`depths`] does, and `value` of each Gaussian as the only channel.
pub fn depths_and(
    gaussians: &Table,
    camera: &ProjectiveCamera,
    projection: &ProjectionOptions,
    value: impl Fn(usize) -> f32,
) -> Maps {
    let projected = project(gaussians, camera, projection);
    let stride = padded_channels(1);
    let mut features = vec![0.0; projected.splats.len() * stride];
    for (feature, &gaussian) in features.chunks_exact_mut(stride).zip(&projected.gaussian) {
        feature[0] = value(gaussian as usize);
    }
    let rasteriser = Rasteriser::new(&projected, camera.width, camera.height).with_depths(Depths::Median);
    rasteriser.forward(&features, stride)
}

/// Renders a model once, always with normals and all depths, and without the state for a backward pass. `appearance` is
/// the index of per-image parameters; `None` takes those of the reference image.
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
