//! Images: the sensor's rays, a point spread wider than a pixel, noise, and numbers of 8 or 16 bits.

use crate::noise::{hash2, normal};
use crate::radiometry::{Encoding, Light, LitScene, Sample, bands_of};
use crate::raytrace::{Ray, Tracer};
use crate::request::BandSet;
use crate::sensor::PushBroom;
use rayon::prelude::*;

/// Sub-pixel samples along each axis.
const FINE: usize = 3;
/// Optical blur beside the pixel's own size, pixels (standard deviation).
const BLUR_PX: f64 = 0.45;
/// Samples by which the point spread reaches beyond a pixel.
const REACH: usize = 5;
/// Rows rendered at a time.
const ROWS_AT_ONCE: usize = 48;

/// Which part of the sensor's full scene an image is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Crop {
    pub(crate) col0: f64,
    pub(crate) row0: f64,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

/// How to turn light into an image.
pub(crate) struct Exposure<'a> {
    pub(crate) sensor: &'a PushBroom,
    pub(crate) crop: Crop,
    pub(crate) light: &'a Light,
    pub(crate) bands: BandSet,
    pub(crate) encoding: Encoding,
    pub(crate) seed: u64,
}

/// An image and its shadow mask.
pub(crate) struct Image {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Bands interleaved by pixel.
    pub(crate) counts: Vec<u16>,
    /// 1 where the sun reaches less than half of the pixel.
    pub(crate) shadow: Vec<u8>,
}

/// One fine row, already blurred along the row and reduced to pixels.
struct FineRow {
    radiance: Vec<[f32; 4]>,
    /// Lit samples of each pixel.
    lit: Vec<u8>,
}

/// Renders an image; `rows_done` is told of each batch of rows.
pub(crate) fn render(scene: &LitScene, exposure: &Exposure, rows_done: &mut dyn FnMut(usize)) -> Image {
    let Crop { width, height, .. } = exposure.crop;
    let mut image = Image {
        width,
        height,
        counts: Vec::with_capacity(width * height * exposure.bands.names().len()),
        shadow: Vec::with_capacity(width * height),
    };
    let kernel = point_spread();
    let mut row = 0;
    while row < height {
        let rows = ROWS_AT_ONCE.min(height - row);
        let first = (row * FINE) as i64 - REACH as i64;
        let fine: Vec<FineRow> = (first..first + (rows * FINE + 2 * REACH) as i64)
            .into_par_iter()
            .map(|fine_row| fine_row_of(scene, exposure, &kernel, fine_row))
            .collect();
        for k in 0..rows {
            // A pixel's middle sample is one after its first.
            let middle = k * FINE + FINE / 2 + REACH;
            finish_row(exposure, &kernel, row + k, &fine[middle - REACH..=middle + REACH], &mut image);
        }
        row += rows;
        rows_done(rows);
    }
    image
}

/// The share of each fine sample in a pixel: the pixel's own square blurred by the optics. Sums to 1.
fn point_spread() -> [f32; 2 * REACH + 1] {
    let sigma = BLUR_PX * FINE as f64;
    let half = (FINE / 2) as i32;
    let weight = |k: i32| -> f64 {
        (-half..=half).map(|shift| (-0.5 * (f64::from(k + shift) / sigma).powi(2)).exp()).sum()
    };
    let total: f64 = (-(REACH as i32)..=REACH as i32).map(weight).sum();
    std::array::from_fn(|k| (weight(k as i32 - REACH as i32) / total) as f32)
}

fn fine_row_of(scene: &LitScene, exposure: &Exposure, kernel: &[f32], fine_row: i64) -> FineRow {
    let Crop { col0, row0, width, .. } = exposure.crop;
    let centre = (FINE / 2) as f64;
    let position = |fine: i64, jitter: f64| (fine as f64 - centre + jitter) / FINE as f64;
    let state = exposure.sensor.at_line(row0 + position(fine_row, 0.0));
    let samples: Vec<Sample> = (-(REACH as i64)..(width * FINE + REACH) as i64)
        .map(|fine_col| {
            let draw = hash2(hash2(exposure.seed, fine_row as u64), fine_col as u64);
            let jitter = crate::noise::unit(hash2(draw, 1)) - 0.5;
            let ray = exposure.sensor.ray(&state, col0 + position(fine_col, jitter));
            exposure.light.sample(scene, &lowered(&ray, scene.tracer), draw)
        })
        .collect();
    let radiance = (0..width)
        .map(|col| {
            let first = col * FINE + FINE / 2;
            let mut sum = [0f32; 4];
            for (sample, weight) in samples[first..].iter().zip(kernel) {
                let (bands, count) = bands_of(&sample.radiance, exposure.bands);
                for band in 0..count {
                    sum[band] += weight * bands[band];
                }
            }
            sum
        })
        .collect();
    let lit = (0..width)
        .map(|col| {
            let first = col * FINE + REACH;
            samples[first..first + FINE].iter().map(|sample| u8::from(sample.lit)).sum()
        })
        .collect();
    FineRow { radiance, lit }
}

/// The same ray, started just above the scene: 600 km of the way would cost digits in every intersection.
pub(crate) fn lowered(ray: &Ray, tracer: &Tracer) -> Ray {
    let t = (tracer.top_m() - ray.origin.z) / ray.direction.z;
    Ray {
        origin: ray.at(t),
        direction: ray.direction,
    }
}

fn finish_row(exposure: &Exposure, kernel: &[f32], row: usize, fine: &[FineRow], image: &mut Image) {
    let bands = exposure.bands.names().len();
    let own = &fine[REACH - FINE / 2..=REACH + FINE / 2];
    for col in 0..exposure.crop.width {
        for band in 0..bands {
            let radiance: f32 = fine.iter().zip(kernel).map(|(line, weight)| weight * line.radiance[col][band]).sum();
            let place = ((row * exposure.crop.width + col) * bands + band) as u64;
            let draw = normal(hash2(exposure.seed ^ 0x4015E, place));
            image.counts.push(exposure.encoding.count(f64::from(radiance), draw));
        }
        let lit: u32 = own.iter().map(|line| u32::from(line.lit[col])).sum();
        image.shadow.push(u8::from(2 * lit < (FINE * FINE) as u32));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn point_spread_is_symmetric_and_keeps_the_light() {
        let kernel = point_spread();
        assert!((kernel.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        for k in 0..REACH {
            assert!((kernel[k] - kernel[2 * REACH - k]).abs() < 1e-9);
        }
        assert!(kernel[0] < 0.01 && kernel[REACH] > 0.15);
    }
}
