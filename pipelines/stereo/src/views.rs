//! What the sweep sees of a view: one band, at the resolution of the grid.

use glam::{Vec2, Vec3};
use heliosplat::fast::floor;
use heliosplat::vectorised;
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_rpc::statistics::upper_median;

/// One image with its camera, in the frame of the request.
#[derive(Debug, Clone, Copy)]
pub struct SweepView<'a> {
    /// Where ground points fall in the image.
    pub camera: ProjectiveCamera,
    /// Linear values, any number of bands, NaN where there is nothing; their mean is what is compared.
    pub image: &'a Raster,
    /// Of the same size, one band: what tells things apart that are equally bright, such as a vegetation index. [`super::sweep`]
    /// compares it too.
    pub index: Option<&'a Raster>,
    /// Views of one date agree radiometrically: same shadows, same season.
    pub date_group: u32,
    /// Unit vector toward the sun, east-north-up.
    pub sun: Vec3,
}

impl SweepView<'_> {
    /// Ground distance between pixels at `centre`, metres.
    pub(super) fn ground_sampling_m(&self, centre: Vec3) -> f32 {
        let (col, row, denominator) = self.camera.project(centre);
        let (u, v) = self.camera.jacobian(col, row, denominator);
        let det = (u.x * v.y - u.y * v.x).abs();
        if det > 0.0 { det.sqrt().recip() } else { f32::INFINITY }
    }

    /// How far the pixel that sees `centre` moves over the ground per metre of altitude: east, north.
    pub(super) fn parallax(&self, centre: Vec3) -> Vec2 {
        let (col, row, _) = self.camera.project(centre);
        let ray = self.camera.ray_direction(col, row);
        ray.truncate() / if ray.z.abs() > 1e-3 { ray.z } else { -1e-3 }
    }

    /// Unit vector from the scene toward the camera.
    pub(super) fn toward(&self, centre: Vec3) -> Vec3 {
        let (col, row, _) = self.camera.project(centre);
        -self.camera.ray_direction(col, row)
    }
}

/// One view, averaged down to about one pixel per cell.
#[derive(Debug, Clone)]
pub(super) struct LevelView {
    pub(super) camera: ProjectiveCamera,
    pub(super) width: usize,
    pub(super) height: usize,
    /// The mean of the bands.
    pub(super) mean: Plane,
    /// The index, where it is to be compared.
    pub(super) index: Option<Plane>,
}

/// What is compared of a view.
#[derive(Debug, Clone)]
pub(super) struct Plane {
    pub(super) pixels: Vec<f32>,
    /// Typical difference between neighbouring pixels.
    pub(super) contrast: f32,
    /// Their median.
    pub(super) middle: f32,
}

impl Plane {
    fn new(image: Raster) -> Self {
        Self {
            contrast: contrast(&image),
            middle: finite_median(image.values.iter().copied()),
            pixels: image.values,
        }
    }
}

impl LevelView {
    pub(super) fn new(view: &SweepView, cell_m: f32, centre: Vec3, with_index: bool) -> Self {
        let ratio = (cell_m / view.ground_sampling_m(centre)).round();
        let largest = (view.image.width.min(view.image.height) / 8).max(1);
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
            mean: Plane::new(image),
            index: index.map(Plane::new),
        }
    }

    /// Where the points of a line of the ground fall.
    pub(super) fn find_line(&self, line: &Line, places: &mut [Place]) {
        find(line, self.width, self.height, places);
    }

    /// Bilinear values of one of the planes; NaN outside the image and beside missing pixels.
    pub(super) fn sample_places(&self, plane: &Plane, places: &[Place], out: &mut [f32]) {
        let pixels = &plane.pixels;
        for (place, value) in places.iter().zip(out) {
            let i = place.index as usize;
            // Two pixels of two rows; a place beyond the image has the index of the first and no weight.
            let (Some(&[a, b]), Some(&[c, d])) = (
                pixels[i..].first_chunk::<2>(),
                pixels[i + self.width..].first_chunk::<2>(),
            ) else {
                *value = f32::NAN;
                continue;
            };
            let top = a + (b - a) * place.fraction[0];
            let bottom = c + (d - c) * place.fraction[0];
            *value = top + (bottom - top) * place.fraction[1];
        }
    }

    /// Bilinear value at a pixel position; NaN outside the image and beside missing pixels.
    #[inline]
    pub(super) fn sample(&self, col: f32, row: f32) -> f32 {
        // Written so that a NaN position fails the test too.
        let inside = col >= 0.0 && row >= 0.0 && col < (self.width - 1) as f32 && row < (self.height - 1) as f32;
        if !inside {
            return f32::NAN;
        }
        let (c, r) = (col as usize, row as usize);
        let (fc, fr) = (col - c as f32, row - r as f32);
        let i = r * self.width + c;
        let upper = &self.mean.pixels[i..i + 2];
        let lower = &self.mean.pixels[i + self.width..i + self.width + 2];
        let top = upper[0] + (upper[1] - upper[0]) * fc;
        let bottom = lower[0] + (lower[1] - lower[0]) * fc;
        top + (bottom - top) * fr
    }

    /// Bicubic value at a pixel position; NaN outside the image, in its outermost pixels and beside missing ones.
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

/// Weights of four neighbours at a fraction of the way from the second to the third: Catmull-Rom's cubic, which keeps more of
/// the detail than lines do and treats all fractions more alike.
fn cubic_weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}

/// Points of the ground at equal distances, as a camera's three forms see them: column `(u + k du) / (w + k dw)`, row likewise.
pub(super) struct Line {
    /// The forms u, v, w at the first point.
    pub(super) start: [f32; 3],
    /// Their change from one point to the next.
    pub(super) step: [f32; 3],
}

/// Where a value is taken from an image.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Place {
    /// The upper left of four pixels.
    index: u32,
    /// Fractions of the column and of the row; NaN outside the image.
    fraction: [f32; 2],
}

impl Place {
    /// The pixel nearest to it, in an image of this width; the first one where it lies outside of the image.
    #[inline(always)]
    pub(super) fn nearest(&self, width: usize) -> usize {
        let further = |fraction: f32, step: usize| if fraction >= 0.5 { step } else { 0 };
        self.index as usize + further(self.fraction[0], 1) + further(self.fraction[1], width)
    }
}

vectorised! {
    /// Finds the places of the points of a line in an image.
    fn find(line: &Line, width: usize, height: usize, places: &mut [Place]) {
        let (columns, rows) = ((width - 1) as f32, (height - 1) as f32);
        for (number, places) in places.chunks_mut(POINTS).enumerate() {
            let first = (number * POINTS) as f32;
            let (mut index, mut across, mut down) = ([0u32; POINTS], [0.0f32; POINTS], [0.0f32; POINTS]);
            for l in 0..POINTS {
                let k = first + l as f32;
                let inverse = 1.0 / (line.start[2] + k * line.step[2]);
                let col = (line.start[0] + k * line.step[0]) * inverse;
                let row = (line.start[1] + k * line.step[1]) * inverse;
                // Written so that a NaN position is outside too.
                let inside = (col >= 0.0) & (row >= 0.0) & (col < columns) & (row < rows);
                let (col, row) = if inside { (col, row) } else { (0.0, 0.0) };
                let (c, r) = (floor(col), floor(row));
                index[l] = r.1 * width as u32 + c.1;
                across[l] = if inside { col - c.0 } else { f32::NAN };
                down[l] = row - r.0;
            }
            for (l, place) in places.iter_mut().enumerate() {
                *place = Place {
                    index: index[l],
                    fraction: [across[l], down[l]],
                };
            }
        }
    }
}

/// Points that are found together.
const POINTS: usize = 8;

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

/// Median absolute difference between neighbours along rows.
fn contrast(image: &Raster) -> f32 {
    finite_median(image.values.windows(2).map(|pair| (pair[1] - pair[0]).abs()))
}

/// Median of what is finite; zero where nothing is.
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
            mean: Plane {
                pixels,
                contrast: 1.0,
                middle: 0.0,
            },
            index: None,
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
            let (mut places, mut values) = ([Place::default(); 61], [0.0; 61]);
            view.find_line(&line, &mut places);
            view.sample_places(&view.mean, &places, &mut values);
            for (k, value) in values.iter().enumerate() {
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
}
