//! The images of a run as the model sees them, and how well.

use crate::evaluate::image::{ImageScore, score_image};
use crate::run::{LoadedModel, ModelImage};
use crate::satellite::views;
use glam::Vec3;
use heliosplat::light::Light;
use heliosplat::render::{Rendering, render};
use heliosplat::{ProjectiveCamera, Raster};

/// The engine's camera of an image of a run.
pub fn camera_of(image: &ModelImage) -> ProjectiveCamera {
    views::camera(&image.map, &image.crop, image.shift_px)
}

/// An image of a run, rendered.
pub struct RenderedView {
    /// Its colours, in the model's units; NaN where the model shows nothing.
    pub image: Raster,
    /// Share of the sun that reaches each pixel; NaN where the model shows nothing.
    pub visibility: Raster,
    /// How held-out colours came about, if they did.
    pub colour: &'static str,
}

/// Renders an image of a run in its own colours, or, for one that was not trained on, in colours fitted to the left half of
/// `truth` (sun, sky and offset per band); without truth, in those of the reference image.
pub fn render_view(model: &LoadedModel, image: &ModelImage, truth: Option<&Raster>) -> RenderedView {
    let camera = camera_of(image);
    let direction = image.sun.direction_enu();
    let light = Light::Directional(Vec3::new(direction.x as f32, direction.y as f32, direction.z as f32));
    let options = model.pass_options();
    let Rendering {
        image: mut colours,
        maps,
    } = render(
        &model.model,
        &model.parameters,
        &camera,
        Some(light),
        image.appearance,
        options,
    );
    let channel = model.model.visibility_channel();
    let mut visibility = Raster::filled(camera.width, camera.height, 1, f32::NAN);
    for (i, value) in visibility.values.iter_mut().enumerate() {
        if maps.alpha[i] > 0.5 {
            *value = (maps.channels[channel][i] / maps.alpha[i]).clamp(0.0, 1.0);
        }
    }
    let mut colour = "its own";
    if image.appearance.is_none() {
        colour = "of the reference image";
        if let Some(truth) = truth {
            colour = "fitted on the left half, scored on the right";
            for band in 0..colours.bands {
                fit_band(
                    &maps.channels[band],
                    &maps.channels[channel],
                    truth.plane(band),
                    camera.width,
                )
                .apply(&maps.channels[band], &maps.channels[channel], colours.plane_mut(band));
            }
        }
    }
    for (i, v) in visibility.values.iter().enumerate() {
        if v.is_nan() {
            for band in 0..colours.bands {
                colours.plane_mut(band)[i] = f32::NAN;
            }
        }
    }
    RenderedView {
        image: colours,
        visibility,
        colour,
    }
}

/// One band of a date's light: `sun · F S + sky · F (1 - S) + offset`.
struct BandLight([f64; 3]);

impl BandLight {
    fn apply(&self, albedo: &[f32], visibility: &[f32], out: &mut [f32]) {
        for ((o, &f), &s) in out.iter_mut().zip(albedo).zip(visibility) {
            let [sun, sky, offset] = self.0;
            *o = (f64::from(f) * (sun * f64::from(s) + sky * f64::from(1.0 - s)) + offset) as f32;
        }
    }
}

/// Least squares over the left half of the image.
fn fit_band(albedo: &[f32], visibility: &[f32], truth: &[f32], width: usize) -> BandLight {
    let mut normal = nalgebra::Matrix3::<f64>::identity() * 1e-6;
    let mut right = nalgebra::Vector3::<f64>::new(1e-6, 3e-7, 0.0);
    for (i, &t) in truth.iter().enumerate() {
        if i % width < width / 2 && t.is_finite() {
            let (f, s) = (f64::from(albedo[i]), f64::from(visibility[i]));
            let x = nalgebra::Vector3::new(f * s, f * (1.0 - s), 1.0);
            normal += x * x.transpose();
            right += x * f64::from(t);
        }
    }
    let solution = normal
        .try_inverse()
        .map_or(nalgebra::Vector3::new(1.0, 0.3, 0.0), |inverse| inverse * right);
    BandLight([solution.x, solution.y, solution.z])
}

/// Scores of a rendered view against its pixels; a held-out one on its right half only.
pub fn score(rendered: &RenderedView, truth: &Raster, held_out: bool) -> Option<ImageScore> {
    let mut truth = truth.clone();
    if held_out {
        let (width, height) = (truth.width, truth.height);
        for band in 0..truth.bands {
            for row in 0..height {
                truth.plane_mut(band)[row * width..row * width + width / 2].fill(f32::NAN);
            }
        }
    }
    score_image(&rendered.image, &truth)
}
