//! A moving picture of a scene under a series of suns, as a GIF.

use heliosplat::Raster;
use heliosplat_raster::{RasterError, preview, write_atomically};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, DynamicImage, Frame, ImageError};
use std::path::Path;

/// How long a frame is shown, milliseconds.
const FRAME_MS: u32 = 200;
/// Effort of the choice of a frame's 256 colours, from 1 (best) to 30.
const EFFORT: i32 = 10;

/// A GIF in the making; all frames share one stretch, so that the scene gets as dark as its sun sinks.
pub struct Animation {
    range: (f32, f32),
    frames: Vec<Frame>,
}

impl Animation {
    /// Nothing yet; `lowest` and `highest` are the images under the lowest and the highest sun: black is the 1st percentile of the former,
    /// white the 99th of the latter.
    pub fn new(lowest: &Raster, highest: &Raster) -> Self {
        let end = |raster: &Raster| preview::shown_range(raster).unwrap_or((0.0, 1.0));
        Self {
            range: (end(lowest).0.min(end(highest).0), end(highest).1),
            frames: Vec::new(),
        }
    }

    /// Adds a frame.
    pub fn push(&mut self, image: &Raster) {
        let picture = preview::stretched_within(image, self.range);
        let picture = DynamicImage::ImageRgb8(picture).into_rgba8();
        let delay = Delay::from_numer_denom_ms(FRAME_MS, 1);
        self.frames.push(Frame::from_parts(picture, 0, 0, delay));
    }

    /// Writes the GIF, which begins again when it has ended.
    ///
    /// # Errors
    /// When a side has more than 65535 pixels, or the file cannot be written.
    pub fn write(self, path: &Path) -> Result<(), RasterError> {
        let bytes = self.encode().map_err(|error| RasterError::Write {
            path: path.to_owned(),
            reason: error.to_string(),
        })?;
        write_atomically(path, &bytes)
    }

    fn encode(self) -> Result<Vec<u8>, ImageError> {
        let mut bytes = Vec::new();
        let mut encoder = GifEncoder::new_with_speed(&mut bytes, EFFORT);
        encoder.set_repeat(Repeat::Infinite)?;
        encoder.encode_frames(self.frames)?;
        drop(encoder);
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::AnimationDecoder;
    use image::codecs::gif::GifDecoder;

    #[test]
    fn frames_share_one_stretch_and_stay_in_order() {
        let bright: Vec<f32> = (0..400).map(|v| v as f32).collect();
        let of = |gain: f32| Raster {
            width: 20,
            height: 20,
            bands: 1,
            values: bright.iter().map(|v| gain * v).collect(),
        };
        let mut animation = Animation::new(&of(0.2), &of(1.0));
        [0.2, 1.0, 0.5].into_iter().for_each(|gain| animation.push(&of(gain)));
        let bytes = animation.encode().expect("a GIF");
        let decoder = GifDecoder::new(std::io::Cursor::new(bytes)).expect("a GIF");
        let frames = decoder.into_frames().collect_frames().expect("frames");
        assert_eq!(frames.len(), 3);
        let brightness = |frame: &Frame| frame.buffer().pixels().map(|p| f64::from(p.0[1])).sum::<f64>() / 400.0;
        let [low, high, middle] = [0, 1, 2].map(|place| brightness(&frames[place]));
        assert!(
            low < 0.7 * high && low < middle && middle < high,
            "{low} {middle} {high}"
        );
    }
}
