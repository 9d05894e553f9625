//! Conversion of a scene's images to views of the engine.

use crate::clouds;
use heliosplat::light::Light;
use heliosplat::model::View;
use heliosplat_raster::Window;
use heliosplat_scene::crop::{camera, direction};
use heliosplat_scene::{ImageSun, SceneImage, saturation};
use std::sync::Arc;

/// View of an image under `sun` without its `clouds`, for the engine. Under an unknown sun everything counts as lit.
/// `shift_px` moves the camera (columns, rows); `appearance` is the index among the images with colours. Every known
/// pixel has weight one.
pub(crate) fn view(
    image: &SceneImage,
    sun: &ImageSun,
    crop: &Window,
    clouds: &[bool],
    shift_px: [f32; 2],
    appearance: usize,
) -> View {
    let mut pixels = crop.shared(&image.pixels);
    if !clouds.is_empty() {
        clouds::blank(Arc::make_mut(&mut pixels), clouds);
    }
    let weight = (0..pixels.plane_len())
        .map(|i| {
            if (0..pixels.bands).all(|b| pixels.plane(b)[i].is_finite()) {
                1.0
            } else {
                0.0
            }
        })
        .collect();
    View {
        name: image.name.clone(),
        camera: camera(&image.pinhole.map, crop, shift_px),
        image: pixels,
        light: direction(sun).map(Light::Directional),
        appearance,
        weight,
        visibility_prior: None,
        ceiling: saturation::ceilings(&image.pixels),
    }
}
