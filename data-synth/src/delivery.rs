//! Bundles of images as vendors deliver them: a panchromatic file in full resolution and a multispectral one with
//! pixels four times as wide, each with its own camera.

use crate::crop::Canvas;
use crate::noise::hash2;
use crate::plan::ViewPlan;
use crate::render::{Exposure, Image};
use crate::request::BandSet;
use heliosplat_rpc::Rpc;

/// Panchromatic pixels along the side of a multispectral one.
const RATIO: usize = 4;
/// Salt that makes the panchromatic noise differ from the multispectral noise.
const PAN_NOISE: u64 = 0x9A;

/// The view under the name of its panchromatic file, `NAME-P1BS`.
pub(crate) fn panchromatic_view(view: &ViewPlan) -> ViewPlan {
    ViewPlan {
        name: format!("{}-P1BS", view.name),
        ..view.clone()
    }
}

/// Exposure of the panchromatic detectors at the time of `exposure`, with noise of its own.
pub(crate) fn panchromatic_exposure<'a>(exposure: &Exposure<'a>) -> Exposure<'a> {
    Exposure {
        bands: BandSet::Pan,
        seed: hash2(exposure.seed, PAN_NOISE),
        ..*exposure
    }
}

/// The multispectral image that goes with `fine` in full resolution, without masks, and its camera and canvas from
/// those of the fine one.
pub(crate) fn multispectral(
    fine: &Image,
    bands: BandSet,
    (fine_rpc, fine_canvas): (&Rpc, Option<Canvas>),
) -> (Image, Rpc, Option<Canvas>) {
    let coarse = Image {
        width: fine.width.div_ceil(RATIO),
        height: fine.height.div_ceil(RATIO),
        counts: coarse_counts(&fine.counts, (fine.width, fine.height), bands.names().len()),
        shadow: Vec::new(),
        cloud: Vec::new(),
    };
    (
        coarse,
        coarse_camera(fine_rpc),
        fine_canvas.map(|canvas| canvas.coarser(RATIO)),
    )
}

/// Counts of interleaved bands averaged to pixels [`RATIO`] times as wide, rounded. Pixels at the last column and row
/// average the part inside the image.
fn coarse_counts(fine: &[u16], (width, height): (usize, usize), bands: usize) -> Vec<u16> {
    let mut counts = Vec::with_capacity(width.div_ceil(RATIO) * height.div_ceil(RATIO) * bands);
    for row in (0..height).step_by(RATIO) {
        for col in (0..width).step_by(RATIO) {
            for band in 0..bands {
                let mut sum = 0u32;
                for pixel in 0..RATIO * RATIO {
                    let (x, y) = (col + pixel % RATIO, row + pixel / RATIO);
                    let place = y.min(height - 1) * width + x.min(width - 1);
                    sum += u32::from(fine[place * bands + band]);
                }
                let pixels = (RATIO * RATIO) as u32;
                // The mean of 16-bit counts fits in 16 bits.
                counts.push(((sum + pixels / 2) / pixels) as u16);
            }
        }
    }
    counts
}

/// The camera of the coarse image: the outer corners of its first pixel are those of [`RATIO`] x [`RATIO`] fine ones.
fn coarse_camera(fine: &Rpc) -> Rpc {
    let ratio = RATIO as f64;
    let moved = |offset: f64| (offset + 0.5) / ratio - 0.5;
    Rpc {
        sample_offset: moved(fine.sample_offset),
        line_offset: moved(fine.line_offset),
        sample_scale: fine.sample_scale / ratio,
        line_scale: fine.line_scale / ratio,
        ..fine.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarse_pixels_are_means_and_the_last_ones_repeat_the_edge() {
        // 5 x 4 pixels of two bands: the column, and ten times as much.
        let fine: Vec<u16> = (0..20).flat_map(|pixel| [pixel % 5, 10 * (pixel % 5)]).collect();
        assert_eq!(coarse_counts(&fine, (5, 4), 2), [2, 15, 4, 40]);
    }
}
