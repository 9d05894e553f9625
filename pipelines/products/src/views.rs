//! Renderings of the images of a run, and their scores.

use super::shadow_mask::Evidence;
use crate::model::{LoadedModel, ModelImage};
use heliosplat::light::Light;
use heliosplat::model::Context;
use heliosplat::render::render;
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_evaluate::image::{ImageScore, score_image};
use heliosplat_scene::{crop, saturation};

/// Camera of an image of a run: its crop, with the correction of its pointing.
pub fn camera_of(image: &ModelImage) -> ProjectiveCamera {
    crop::camera(&image.map, &image.crop, image.shift_px)
}

/// An image of a run, rendered.
pub struct RenderedView {
    /// Colours, in the model's units; NaN where the model shows nothing.
    pub image: Raster,
    /// Traced visibility of the sun from each pixel, 0 to 1; NaN where the model shows nothing, and everywhere where
    /// the sun is unknown.
    pub traced: Raster,
    /// Visibility of the sun after the image refined the borders of shadows ([`Evidence`]); as traced without the
    /// image, or without a training image of its day.
    pub visibility: Raster,
    /// Source of the colours.
    pub colour: Colouring,
}

/// Source of the colours of a rendered view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colouring {
    /// Colours trained on the image itself.
    Own,
    /// Colours of an image of the same day.
    SameDay,
    /// Colours fitted to the left half of the image: only the right one may be scored.
    LeftHalf,
    /// Colours of the model's reference image.
    Reference,
}

impl Colouring {
    /// Description of the source for reports.
    pub fn text(self) -> &'static str {
        match self {
            Self::Own => "its own",
            Self::SameDay => "of an image of the same day",
            Self::LeftHalf => "fitted on the left half, scored on the right",
            Self::Reference => "of the reference image",
        }
    }
}

/// Renders an image of a run in its own colours. An image that was not trained on takes those of an image of the same
/// day; without such an image, colours fitted to the left half of `truth` (sun, sky and offset per band); without
/// truth, those of the reference image.
pub fn render_view(model: &LoadedModel, image: &ModelImage, truth: Option<&Raster>) -> RenderedView {
    let camera = camera_of(image);
    let sun = image.sun.filter(|_| model.file.has_light());
    let light = sun.map(|sun| Light::Directional(crop::toward(&sun)));
    let appearance = image.appearance.or(image.same_day);
    let (shown, options) = (&model.parameters, model.pass_options());
    let seen = render(&model.model, shown, &camera, light, appearance, options);
    let (mut colours, maps) = (seen.image, seen.maps);
    let mut traced = Raster::of_plane(camera.width, camera.height, model.model.sunlit(&maps));
    let sunlight = model.model.visibility(&maps);
    let mut colour = Colouring::Own;
    if image.appearance.is_none() && image.same_day.is_some() {
        colour = Colouring::SameDay;
    } else if image.appearance.is_none() {
        colour = Colouring::Reference;
        if let Some(truth) = truth {
            colour = Colouring::LeftHalf;
            for band in 0..colours.bands {
                let albedo = &maps.channels[band];
                let light = fit_band(albedo, sunlight, truth.plane(band), camera.width);
                light.apply(albedo, sunlight, colours.plane_mut(band));
            }
        }
    }
    // Only colours of the image itself or of the same day are evidence of its light; those of other images are not.
    let own = truth.filter(|_| appearance.is_some() && light.is_some());
    let visibility = own.map(|image| {
        let context = Context {
            parameters: &model.parameters,
            camera: &camera,
            light,
            appearance,
        };
        let [shaded, lit] = [0.0, 1.0].map(|share| model.model.compose_in(share, &context, &maps));
        Evidence {
            traced: &traced,
            rendered: &colours,
            shaded: &shaded,
            lit: &lit,
            image,
        }
        .visibility()
    });
    colours.blank_unknown(&traced.values);
    if light.is_none() {
        // Everything was rendered as lit; that is no statement about shadows.
        traced.values.fill(f32::NAN);
    }
    RenderedView {
        image: colours,
        visibility: visibility.unwrap_or_else(|| traced.clone()),
        traced,
        colour,
    }
}

/// Light of one band on a date: `sun · F L + sky · F (1 - L) + offset`, with the albedo `F` and the sun's light `L` of
/// a pixel.
struct BandLight([f64; 3]);

impl BandLight {
    fn apply(&self, albedo: &[f32], sunlight: &[f32], out: &mut [f32]) {
        for ((o, &f), &s) in out.iter_mut().zip(albedo).zip(sunlight) {
            let [sun, sky, offset] = self.0;
            *o = (f64::from(f) * (sun * f64::from(s) + sky * f64::from(1.0 - s)) + offset) as f32;
        }
    }
}

/// Light of a band by least squares over the left half of the image.
fn fit_band(albedo: &[f32], sunlight: &[f32], truth: &[f32], width: usize) -> BandLight {
    let mut normal = nalgebra::Matrix3::<f64>::identity() * 1e-6;
    let mut right = nalgebra::Vector3::<f64>::new(1e-6, 3e-7, 0.0);
    for (i, &t) in truth.iter().enumerate() {
        if i % width < width / 2 && t.is_finite() {
            let (f, s) = (f64::from(albedo[i]), f64::from(sunlight[i]));
            let x = nalgebra::Vector3::new(f * s, f * (1.0 - s), 1.0);
            normal += x * x.transpose();
            right += x * f64::from(t);
        }
    }
    let usual = nalgebra::Vector3::new(1.0, 0.3, 0.0);
    BandLight(normal.try_inverse().map_or(usual, |inverse| inverse * right).into())
}

/// Scores of a rendered view, clipped at the saturation of `truth`, against `truth`; on the right half only where
/// colours were fitted to the left one. `rgb` as in [`score_image`]; `None` where no pixel is known in both.
pub fn score(rendered: &RenderedView, truth: &Raster, rgb: Option<[usize; 3]>) -> Option<ImageScore> {
    let mut truth = truth.clone();
    if rendered.colour == Colouring::LeftHalf {
        let (width, height) = (truth.width, truth.height);
        for band in 0..truth.bands {
            for row in 0..height {
                truth.plane_mut(band)[row * width..row * width + width / 2].fill(f32::NAN);
            }
        }
    }
    let mut image = rendered.image.clone();
    for (band, ceiling) in saturation::ceilings(&truth).into_iter().enumerate() {
        // NaN is not above the ceiling and stays.
        let above = image.plane_mut(band).iter_mut().filter(|value| **value > ceiling);
        above.for_each(|value| *value = ceiling);
    }
    score_image(&image, &truth, rgb)
}
