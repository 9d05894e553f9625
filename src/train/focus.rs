//! What a step looks at: all of a view, a coarser image of it, or a window.

use super::options::TrainOptions;
use crate::model::View;
use crate::raster::Raster;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::borrow::Cow;

/// Windows begin and end at multiples of this many pixels, and are never smaller.
const WINDOW_STEP: usize = 64;

/// The coarser images of all views, and the plan of who looks at what.
pub(super) struct Focus {
    /// `coarse[level - 1][view]`: pixels `2^level` times as wide.
    coarse: Vec<Vec<View>>,
    share: f32,
    window_share: f32,
    seed: u64,
}

/// What one step looks at.
pub(super) struct Look<'a> {
    /// A view, its coarser image or a window of either; its weights are those to train with.
    pub(super) view: Cow<'a, View>,
    /// Width of its pixels, in those of the full image.
    pub(super) pixel: f32,
    /// Whether no part of the view is left out.
    pub(super) whole: bool,
}

impl Focus {
    /// The plan of a training on `views`, whose weights are those to train with.
    pub(super) fn new(views: &[View], options: &TrainOptions) -> Self {
        let level = |n: usize| views.iter().map(|view| coarser(view, 1 << n)).collect();
        let sides = views.iter().map(|view| view.image.width.min(view.image.height));
        // The coarsest image has a pixel still.
        let levels = sides.min().map_or(0, |side| side.max(1).ilog2() as usize);
        Self {
            coarse: (1..=options.pyramid_levels.min(levels)).map(level).collect(),
            share: options.pyramid_share,
            window_share: options.window_share,
            seed: options.seed,
        }
    }

    /// What step number `step`, a `fraction` of training, looks at of view `index` of `views`.
    pub(super) fn look<'a>(&'a self, views: &'a [View], index: usize, step: usize, fraction: f32) -> Look<'a> {
        let levels = self.coarse.len();
        let left = 1.0 - fraction / self.share.max(1e-6);
        let level = ((levels as f32 * left).ceil().max(0.0) as usize).min(levels);
        let view = match level {
            0 => &views[index],
            _ => &self.coarse[level - 1][index],
        };
        let window = (self.window_share < 1.0).then(|| self.window(view, step));
        Look {
            pixel: (1 << level) as f32,
            whole: window.is_none(),
            view: window.map_or(Cow::Borrowed(view), Cow::Owned),
        }
    }

    fn window(&self, view: &View, step: usize) -> View {
        let mut random = Pcg32::seed_from_u64(self.seed ^ (step as u64) << 20);
        let mut along = |length: usize| {
            let wanted = (length as f32 * self.window_share.sqrt() / WINDOW_STEP as f32).ceil();
            let size = (wanted as usize * WINDOW_STEP).max(WINDOW_STEP).min(length);
            (random.random_range(0..=length - size), size)
        };
        let (columns, rows) = (along(view.image.width), along(view.image.height));
        let (corner, size) = ((columns.0, rows.0), (columns.1, rows.1));
        let weight = (rows.0..rows.0 + rows.1).flat_map(|row| {
            let start = row * view.image.width + columns.0;
            &view.weight[start..start + columns.1]
        });
        View {
            name: view.name.clone(),
            camera: view.camera.window(corner, size),
            image: view.image.window(corner, size),
            weight: weight.copied().collect(),
            light: view.light,
            appearance: view.appearance,
            ceiling: view.ceiling.clone(),
            lit: view
                .lit
                .as_ref()
                .map(|lit| plane(lit, view.image.width).window(corner, size).values),
        }
    }
}

/// A view with pixels averaged by `factor × factor`; one that any part of does not count does not count.
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
        lit: view
            .lit
            .as_ref()
            .map(|lit| plane(lit, view.image.width).downscaled(factor).values),
        image,
        weight,
    }
}

/// Values of pixels as an image of one band.
fn plane(values: &[f32], width: usize) -> Raster {
    Raster {
        width,
        height: values.len() / width.max(1),
        bands: 1,
        values: values.to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::ProjectiveCamera;
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
            lit: None,
            ceiling: Vec::new(),
            image,
        }
    }

    /// What an image shows where a camera says a point is.
    fn seen(view: &View, point: Vec3) -> f32 {
        let (col, row, _) = view.camera.project(point);
        view.image.at(0, col.round() as usize, row.round() as usize)
    }

    #[test]
    fn training_begins_coarse_and_ends_at_full_size() {
        let views = [view()];
        let options = TrainOptions {
            pyramid_levels: 2,
            pyramid_share: 0.5,
            ..TrainOptions::default()
        };
        let focus = Focus::new(&views, &options);
        let pixels: Vec<f32> = [0.0, 0.2, 0.3, 0.49, 0.5, 1.0]
            .map(|f| focus.look(&views, 0, 0, f).pixel)
            .to_vec();
        assert_eq!(pixels, [4.0, 4.0, 2.0, 2.0, 1.0, 1.0]);
    }

    #[test]
    fn coarser_images_and_windows_show_the_same_ground() {
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
        let options = TrainOptions {
            window_share: 0.25,
            ..TrainOptions::default()
        };
        let focus = Focus::new(&views, &options);
        let mut hits = 0;
        for step in 0..40 {
            let look = focus.look(&views, 0, step, 0.0);
            let window = &look.view;
            let (col, row, _) = window.camera.project(point);
            if col >= 0.0 && row >= 0.0 && col < window.image.width as f32 && row < window.image.height as f32 {
                hits += 1;
                assert_eq!(seen(window, point), at);
            }
        }
        assert!(hits > 0);
    }

    #[test]
    fn a_coarse_pixel_with_a_part_that_does_not_count_does_not_count() {
        let mut fine = view();
        fine.weight[5] = 0.0;
        let half = coarser(&fine, 2);
        assert_eq!((half.weight[1], half.weight[2], half.weight[3]), (1.0, 0.0, 1.0));
    }
}
