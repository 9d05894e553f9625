//! Rasters as compact text in a page, read by `page/field.js`.
//!
//! * Heights: whole steps above the lowest (a centimetre, more if the relief would not fit into 16 bits). Each is
//!   predicted from its left, upper and upper-left neighbours (median edge detector of JPEG-LS, ISO 14495-1). The
//!   residuals are mapped to unsigned numbers (0, -1, 1, -2 ...); all low bytes, then all high bytes are deflated
//!   (zlib).
//! * Masks: a bit per cell, most significant bit first, deflated.
//! * Maps: a byte per cell, 0 unknown, 1 to 255 over the range, deflated.
//! * Pictures: JPEG; the albedo with gamma 2.2.
//!
//! Deflated data are written in base64.

use crate::page::jpeg_address;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use heliosplat::Raster;
use heliosplat_raster::preview::percentiles;
use image::{Rgb, RgbImage};
use serde_json::{Value, json};
use std::io::Write;

/// Finest step of heights, metres.
const STEP_M: f32 = 0.01;
/// JPEG quality of the albedo, and of other pictures, which are viewed less often.
const QUALITY: u8 = 86;
const PLAIN_QUALITY: u8 = 70;
/// Number of shade steps of a map: finer steps are not distinguishable, and fewer compress better.
const SHADES: f32 = 50.0;
/// Gamma of the albedo's picture.
pub(super) const GAMMA: f32 = 2.2;

fn deflated(bytes: &[u8]) -> String {
    // Writing to a Vec cannot fail.
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    let _ = encoder.write_all(bytes);
    STANDARD.encode(encoder.finish().unwrap_or_default())
}

/// Packs the heights of a raster's first band, metres; `None` if none is known. The altitude of step 0, and for the
/// page the metres per step, the steps of all cells, row by row, and the mask of the known cells.
pub(super) fn heights(altitude: &Raster) -> Option<(f32, Value)> {
    let plane = altitude.plane(0);
    let known = || plane.iter().copied().filter(|z| z.is_finite());
    let low_m = known().reduce(f32::min)?;
    let high_m = known().reduce(f32::max)?;
    let step_m = STEP_M.max((high_m - low_m) / f32::from(u16::MAX));
    let steps = steps(altitude, low_m, step_m);
    let width = altitude.width;
    let fold = |i: usize| {
        let difference = steps[i].wrapping_sub(predicted(&steps, width, i)) as i16;
        ((difference << 1) ^ (difference >> 15)) as u16
    };
    let folded: Vec<u16> = (0..steps.len()).map(fold).collect();
    let low = folded.iter().map(|value| *value as u8);
    let bytes: Vec<u8> = low.chain(folded.iter().map(|value| (value >> 8) as u8)).collect();
    let known = mask(plane.iter().map(|z| z.is_finite()));
    let packed = json!({"low_m": low_m, "step_m": step_m, "data": deflated(&bytes), "known": known});
    Some((low_m, packed))
}

/// Heights in whole steps; an unknown cell repeats the cell before it, which compresses well.
fn steps(altitude: &Raster, low_m: f32, step_m: f32) -> Vec<u16> {
    let mut before = 0;
    let step = |z: &f32| {
        if z.is_finite() {
            before = ((z - low_m) / step_m).round().clamp(0.0, f32::from(u16::MAX)) as u16;
        }
        before
    };
    altitude.plane(0).iter().map(step).collect()
}

/// Prediction of cell `i` from its left, upper and upper-left neighbours (median edge detector).
fn predicted(steps: &[u16], width: usize, i: usize) -> u16 {
    match (i % width, i / width) {
        (0, 0) => 0,
        (_, 0) => steps[i - 1],
        (0, _) => steps[i - width],
        _ => {
            let (left, above, corner) = (steps[i - 1], steps[i - width], steps[i - width - 1]);
            let (low, high) = (left.min(above), left.max(above));
            if corner >= high {
                low
            } else if corner <= low {
                high
            } else {
                // The corner lies between the two, and so does the sum.
                (i32::from(left) + i32::from(above) - i32::from(corner)) as u16
            }
        }
    }
}

/// Packs a mask with a bit per cell.
pub(super) fn mask(cells: impl Iterator<Item = bool>) -> String {
    let mut bytes = Vec::new();
    for (i, set) in cells.enumerate() {
        if i % 8 == 0 {
            bytes.push(0u8);
        }
        if let Some(last) = bytes.last_mut() {
            *last |= u8::from(set) << (7 - i % 8);
        }
    }
    deflated(&bytes)
}

/// Packs a raster's first band over a range, with a byte per cell; values beyond the range are clamped.
pub(super) fn map(values: &Raster, [low, high]: [f32; 2]) -> String {
    let span = (high - low).max(f32::MIN_POSITIVE);
    let byte = |value: &f32| match value.is_finite() {
        true => {
            let shade = (SHADES * ((value - low) / span).clamp(0.0, 1.0)).round() / SHADES;
            1 + (254.0 * shade).round() as u8
        }
        false => 0,
    };
    deflated(&values.plane(0).iter().map(byte).collect::<Vec<u8>>())
}

/// Packs a raster with red, green and blue as an albedo; `None` if nothing is known. The black point is 0.7 of the 1st
/// percentile of the albedo under the darkest light, `shade`. For the page the JPEG of `(albedo / white)^(1 / 2.2)`,
/// the albedo of its brightest value and the largest brightness that is shown black, as a share of that, 0 to 0.5.
pub(super) fn albedo(raster: &Raster, shade: f32) -> Option<Value> {
    let (low, white) = percentiles(&raster.values, 0.01, 0.995)?;
    if white <= 0.0 {
        return None;
    }
    let shown = |value: f32| 255.0 * (value / white).clamp(0.0, 1.0).powf(1.0 / GAMMA);
    let picture = picture(raster, QUALITY, shown)?;
    let black = (0.7 * low * shade / white).clamp(0.0, 0.5);
    Some(json!({"picture": picture, "white": white, "black": black}))
}

/// Encodes a raster with red, green and blue, 0 to 255, as a JPEG in a `data:` address.
pub(super) fn plain_picture(raster: &Raster) -> Option<String> {
    picture(raster, PLAIN_QUALITY, |value| value)
}

/// Encodes a raster as a JPEG in a `data:` address; `shade` maps values to 0..255. Unknown pixels repeat the pixel
/// before them.
fn picture(raster: &Raster, quality: u8, shade: impl Fn(f32) -> f32) -> Option<String> {
    let mut before = Rgb([0; 3]);
    let picture = RgbImage::from_fn(raster.width as u32, raster.height as u32, |col, row| {
        let at = |band: usize| raster.at(band.min(raster.bands - 1), col as usize, row as usize);
        let pixel = [0, 1, 2].map(at);
        if pixel.iter().all(|value| value.is_finite()) {
            before = Rgb(pixel.map(|value| shade(value).round().clamp(0.0, 255.0) as u8));
        }
        before
    });
    jpeg_address(&picture, quality)
}
