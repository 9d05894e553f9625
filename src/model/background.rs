//! Background compositing, shared by the models of objects: colours over a constant background, and coverage as a
//! fourth band.
//!
//! Channels of these models are the three colours, then, where a model rasterises them, the three components of the
//! normal.

use super::NamedLoss;
use crate::camera::ProjectiveCamera;
use crate::loss::geometry::depth_normal;
use crate::raster::Raster;
use crate::splat::{MapGradients, Maps};

/// Colour channels of a pixel.
pub(super) const COLOURS: usize = 3;

/// Colour behind everything, and a flag: true if images have coverage as a fourth band.
pub type Background = ([f32; 3], bool);

/// `Σ w c + (1 - Σ w) background` per pixel, and with coverage a fourth band `Σ w`.
pub(super) fn over_background(maps: &Maps, (background, coverage): Background) -> Raster {
    let bands = COLOURS + usize::from(coverage);
    let mut out = Raster::filled(maps.width, maps.height, bands, 0.0);
    for (k, background) in background.into_iter().enumerate() {
        let sources = maps.channels[k].iter().zip(&maps.alpha);
        for (pixel, (colour, alpha)) in out.plane_mut(k).iter_mut().zip(sources) {
            *pixel = colour + (1.0 - alpha) * background;
        }
    }
    if coverage {
        out.plane_mut(COLOURS).copy_from_slice(&maps.alpha);
    }
    out
}

/// Backward of [`over_background`]: adds the gradients of the maps from that of the image.
pub(super) fn over_background_backward(
    d_image: &Raster,
    (background, coverage): Background,
    d_maps: &mut MapGradients,
) {
    for (k, background) in background.into_iter().enumerate() {
        let sinks = d_maps.channels[k].iter_mut().zip(&mut d_maps.alpha);
        for ((d_colour, d_alpha), d) in sinks.zip(d_image.plane(k)) {
            *d_colour += d;
            *d_alpha -= d * background;
        }
    }
    if coverage {
        for (d_alpha, d) in d_maps.alpha.iter_mut().zip(d_image.plane(COLOURS)) {
            *d_alpha += d;
        }
    }
}

/// The depth–normal loss of a model whose normals follow its colours, see [`depth_normal`]; empty when `weight` is
/// zero. Depths that differ by more than `edge` (scene units) are an edge.
pub(super) fn depth_normal_loss(
    camera: &ProjectiveCamera,
    maps: &Maps,
    weight: f32,
    edge: f32,
    d_maps: &mut MapGradients,
) -> Vec<NamedLoss> {
    if weight <= 0.0 {
        return Vec::new();
    }
    vec![("normals", depth_normal(camera, maps, COLOURS, edge, weight, d_maps))]
}
