//! A view at one level of the pyramid: the mean of its bands and its index, averaged down to about one pixel per cell.
//!
//! Matching works on one plane of brightness (and one of an index where there is one), so bands are averaged first;
//! pixels much smaller than a cell would alias. The factor is the nearest whole number to cell size over pixel size, so
//! a level's pixels are only about as large as its cells.

use super::contrast;
use super::sampling::{self, Line, Places, cubic_weights};
use super::views::SweepView;
use glam::Vec3;
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_grid::statistics::upper_median;

/// Least number of pixels of the smaller side of a level, for cells of any size: fewer contain no window of the census.
const FEWEST_PIXELS: usize = 8;

/// One view, averaged down to about one pixel per cell.
#[derive(Debug, Clone)]
pub(super) struct LevelView {
    /// Camera of the averaged image.
    pub(super) camera: ProjectiveCamera,
    /// Columns of the averaged image, pixels.
    pub(super) width: usize,
    /// Rows of the averaged image, pixels.
    pub(super) height: usize,
    /// The mean of the bands.
    pub(super) mean: PixelPlane,
    /// The index, where it is to be compared.
    pub(super) index: Option<PixelPlane>,
    /// Pixels of the image averaged into one, each way.
    pub(super) factor: usize,
    /// Ground distance between the pixels of the image, metres.
    pub(super) image_pixel_m: f32,
}

/// One plane of values that is compared.
#[derive(Debug, Clone)]
pub(super) struct PixelPlane {
    /// Values, `[row][column]`; NaN where missing.
    pub(super) pixels: Vec<f32>,
    /// Median difference between neighbouring pixels of the whole image.
    pub(super) contrast: f32,
    /// Median difference between neighbouring pixels around each pixel: the unit of differences there.
    pub(super) local_contrast: Vec<f32>,
    /// Median of the pixels.
    pub(super) middle: f32,
}

impl PixelPlane {
    fn new(image: Raster) -> Self {
        Self {
            contrast: contrast::whole(&image),
            local_contrast: contrast::local(&image),
            middle: finite_median(image.values.iter().copied()),
            pixels: image.values,
        }
    }
}

impl LevelView {
    /// Averages a view down to about one pixel per cell of `cell_m` metres at `centre` (metres); `with_index` includes
    /// its index.
    pub(super) fn new(view: &SweepView, cell_m: f32, centre: Vec3, with_index: bool) -> Self {
        let image_pixel_m = view.geometry().ground_sampling_m(centre);
        let ratio = (cell_m / image_pixel_m).round();
        let largest = (view.image.width.min(view.image.height) / FEWEST_PIXELS).max(1);
        let factor = (ratio as usize).clamp(1, largest);
        let mean = mean_of_bands(view.image);
        let index = view.index.filter(|_| with_index);
        let smaller = |image: &Raster| image.downscaled(factor);
        let (image, index, camera) = if factor > 1 {
            (smaller(&mean), index.map(smaller), view.camera.downscaled(factor))
        } else {
            (mean, index.cloned(), view.camera)
        };
        Self {
            camera,
            width: image.width,
            height: image.height,
            mean: PixelPlane::new(image),
            index: index.map(PixelPlane::new),
            factor,
            image_pixel_m,
        }
    }

    /// Ground distance between the averaged pixels, metres.
    pub(super) fn pixel_m(&self) -> f32 {
        self.image_pixel_m * self.factor as f32
    }

    /// Projects `count` points of a line of the ground into the image and writes them to `places` from index `start`
    /// on. Lines must be processed in the order of their places.
    pub(super) fn find_line(&self, line: &Line, start: usize, count: usize, places: &mut Places) {
        sampling::find(line, self.width, self.height, start, count, places);
    }

    /// Bilinear values of one of the planes at the first `count` places; NaN outside the image and next to missing
    /// pixels. `out` has room for [`sampling::POINTS`] more.
    pub(super) fn sample_places(&self, plane: &PixelPlane, places: &Places, count: usize, out: &mut [f32]) {
        sampling::bilinear(&plane.pixels, self.width, places, count, out);
    }

    /// Bilinear brightness at a pixel position; NaN outside the image and next to missing pixels.
    #[inline]
    pub(super) fn sample(&self, col: f32, row: f32) -> f32 {
        self.sample_of(&self.mean, col, row)
    }

    /// Bilinear value of one of the planes at a pixel position; NaN outside the image and next to missing pixels.
    #[inline]
    pub(super) fn sample_of(&self, plane: &PixelPlane, col: f32, row: f32) -> f32 {
        heliosplat_grid::bilinear(&plane.pixels, (self.width, self.height), col, row)
    }

    /// Bicubic brightness at a pixel position; NaN outside the image, in its outermost pixels and next to missing ones.
    #[inline]
    pub(super) fn sample_cubic(&self, col: f32, row: f32) -> f32 {
        // Written so that a NaN position fails the test too.
        let inside = col >= 1.0 && row >= 1.0 && col < (self.width as f32 - 2.0) && row < (self.height as f32 - 2.0);
        if !inside {
            return f32::NAN;
        }
        let (c, r) = (col as usize, row as usize);
        let (across, down) = (cubic_weights(col - c as f32), cubic_weights(row - r as f32));
        let mut value = 0.0;
        for (weight, line) in down.into_iter().zip(0..4) {
            let start = (r + line - 1) * self.width + c - 1;
            let p = &self.mean.pixels[start..start + 4];
            value += weight * (across[0] * p[0] + across[1] * p[1] + across[2] * p[2] + across[3] * p[3]);
        }
        value
    }
}

fn mean_of_bands(image: &Raster) -> Raster {
    let mut mean = Raster::filled(image.width, image.height, 1, 0.0);
    let scale = 1.0 / image.bands.max(1) as f32;
    for band in 0..image.bands {
        for (sum, value) in mean.values.iter_mut().zip(image.plane(band)) {
            *sum += value * scale;
        }
    }
    mean
}

/// Median of the finite values; zero where there are none.
fn finite_median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    upper_median(&mut values).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_values_of_a_line_are_those_of_its_points() {
        let (width, height) = (40, 30);
        let mut pixels: Vec<f32> = (0..width * height).map(|i| ((i * 7919) % 101) as f32).collect();
        pixels[15 * width + 20] = f32::NAN;
        let camera = ProjectiveCamera::new(
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0; 3],
            (width, height),
            glam::DVec3::NEG_Z,
        );
        let view = LevelView {
            camera,
            width,
            height,
            mean: PixelPlane {
                pixels,
                contrast: 1.0,
                local_contrast: Vec::new(),
                middle: 0.0,
            },
            index: None,
            factor: 1,
            image_pixel_m: 1.0,
        };
        for start in [
            [-3.2, 4.7, 1.0],
            [0.0, 0.0, 1.0],
            [3.0, 28.9, 1.0],
            [5.5, 14.5, 1.01],
            [f32::NAN, 1.0, 1.0],
        ] {
            let line = Line {
                start,
                step: [0.83, 0.21, 1e-4],
            };
            let (mut places, mut values) = (Places::new(61), [0.0; 61 + sampling::POINTS]);
            view.find_line(&line, 0, 61, &mut places);
            view.sample_places(&view.mean, &places, 61, &mut values);
            for (k, value) in values[..61].iter().enumerate() {
                let k = k as f32;
                let inverse = 1.0 / (start[2] + k * line.step[2]);
                let expected = view.sample(
                    (start[0] + k * line.step[0]) * inverse,
                    (start[1] + k * line.step[1]) * inverse,
                );
                assert_eq!(
                    value.to_bits(),
                    expected.to_bits(),
                    "{start:?}, {k}: {value} against {expected}"
                );
            }
        }
    }

    #[test]
    fn an_image_of_one_row_has_no_values() {
        let plane = vec![1.0; 5];
        let mut places = Places::new(9);
        let line = Line {
            start: [0.5, 0.0, 1.0],
            step: [0.5, 0.0, 0.0],
        };
        sampling::find(&line, 5, 1, 0, 9, &mut places);
        let mut values = [0.0; 9 + sampling::POINTS];
        sampling::bilinear(&plane, 5, &places, 9, &mut values);
        assert!(values[..9].iter().all(|value| value.is_nan()), "{values:?}");
    }
}
