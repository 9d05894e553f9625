//! The image pyramid of training: the first steps see every view at half its width, the others at full size.

use super::options::TrainOptions;
use crate::camera::ProjectiveCamera;
use crate::model::View;
use crate::raster::Raster;
use rayon::prelude::*;

/// Pixel size at the beginning of training, as a multiple of the view's.
const COARSE_FACTOR: usize = 2;

/// The coarser images of all views, and the share of training that uses them.
pub(super) struct Pyramid {
    /// By view; empty while training is at full size.
    coarse: Vec<View>,
    share: f32,
}

/// The level of a view that one step trains on.
pub(super) struct PyramidLevel<'a> {
    /// A view or its coarser image; its weights are those to train with.
    pub(super) view: &'a View,
    /// True if the view has its full size.
    pub(super) full_size: bool,
}

impl Pyramid {
    /// The pyramid of `views`.
    pub(super) fn new(views: &[View], options: &TrainOptions) -> Self {
        // The coarser image must have a pixel left.
        let wide_enough = |view: &View| view.image.width.min(view.image.height) >= COARSE_FACTOR;
        Self {
            coarse: Vec::new(),
            share: if views.iter().all(wide_enough) {
                options.pyramid_share
            } else {
                0.0
            },
        }
    }

    /// Makes the coarser images of `views`, which have their training weights, or drops them, depending on `fraction`,
    /// the share of training done, 0 to 1.
    pub(super) fn follow(&mut self, views: &[View], fraction: f32) {
        if fraction >= self.share {
            self.coarse = Vec::new();
        } else if self.coarse.is_empty() {
            self.coarse = views.par_iter().map(|view| coarser(view, COARSE_FACTOR)).collect();
        }
    }

    /// Puts the camera of view `index` where that of its full size is now.
    pub(super) fn place_camera(&mut self, index: usize, camera: &ProjectiveCamera) {
        if let Some(view) = self.coarse.get_mut(index) {
            view.camera = camera.downscaled(COARSE_FACTOR);
        }
    }

    /// The level of view `index` of `views` to train on now.
    pub(super) fn level<'a>(&'a self, views: &'a [View], index: usize) -> PyramidLevel<'a> {
        let coarse = self.coarse.get(index);
        PyramidLevel {
            view: coarse.unwrap_or(&views[index]),
            full_size: coarse.is_none(),
        }
    }
}

/// A view whose pixels are means of `factor × factor` ones; a coarse pixel has the least weight of its parts.
fn coarser(view: &View, factor: usize) -> View {
    let image = view.image.downscaled(factor);
    let mut weight = vec![1.0f32; image.plane_len()];
    for (i, weight) in weight.iter_mut().enumerate() {
        let (col, row) = (i % image.width * factor, i / image.width * factor);
        for r in row..row + factor {
            for c in col..col + factor {
                *weight = weight.min(view.weight[r * view.image.width + c]);
            }
        }
    }
    View {
        name: view.name.clone(),
        camera: view.camera.downscaled(factor),
        light: view.light,
        appearance: view.appearance,
        ceiling: view.ceiling.clone(),
        visibility_prior: view
            .visibility_prior
            .as_ref()
            .map(|prior| plane(prior, view.image.width).downscaled(factor).values),
        image: image.into(),
        weight,
    }
}

/// Values of pixels as an image of one band.
fn plane(values: &[f32], width: usize) -> Raster {
    Raster::of_plane(width, values.len() / width.max(1), values.to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Raster;
    use glam::Vec3;

    fn view() -> View {
        let mut image = Raster::filled(200, 160, 1, 0.0);
        for (i, v) in image.values.iter_mut().enumerate() {
            *v = (i % 200) as f32 + 1000.0 * (i / 200) as f32;
        }
        View {
            name: "a".into(),
            camera: ProjectiveCamera::nadir(-50.0, 40.0, 0.5, (200, 160)),
            weight: vec![1.0; 200 * 160],
            light: None,
            appearance: 0,
            visibility_prior: None,
            ceiling: Vec::new(),
            image: image.into(),
        }
    }

    /// Value of an image at the projection of a point.
    fn seen(view: &View, point: Vec3) -> f32 {
        let (col, row, _) = view.camera.project(point);
        view.image.at(0, col.round() as usize, row.round() as usize)
    }

    #[test]
    fn training_begins_coarse_and_ends_at_full_size() {
        let views = [view()];
        let widths = |pyramid_share| {
            let options = TrainOptions {
                pyramid_share,
                ..TrainOptions::default()
            };
            let mut pyramid = Pyramid::new(&views, &options);
            [0.0, 0.49, 0.5, 1.0, 0.3].map(|fraction| {
                pyramid.follow(&views, fraction);
                pyramid.level(&views, 0).view.image.width
            })
        };
        // A later increase of the number of steps may make training less far than it was.
        assert_eq!(widths(0.5), [100, 100, 200, 200, 100]);
        assert_eq!(widths(0.0), [200; 5]);
    }

    #[test]
    fn coarser_images_show_the_same_ground() {
        let views = [view()];
        let point = Vec3::new(-12.25, 10.25, 0.0);
        let at = seen(&views[0], point);
        let half = coarser(&views[0], 2);
        // A coarser pixel is centred between the four it is made of.
        let (col, row, _) = half.camera.project(point);
        assert!(
            (half.image.at(0, col.round() as usize, row.round() as usize) - at).abs() <= 502.0,
            "{col} {row}"
        );
        assert!(half.camera.project(Vec3::new(-50.0 + 0.25, 40.0 - 0.25, 0.0)).0.abs() < 1e-4);
    }

    #[test]
    fn a_coarse_pixel_with_a_part_that_does_not_count_does_not_count() {
        let mut fine = view();
        fine.weight[5] = 0.0;
        let half = coarser(&fine, 2);
        assert_eq!((half.weight[1], half.weight[2], half.weight[3]), (1.0, 0.0, 1.0));
    }
}
