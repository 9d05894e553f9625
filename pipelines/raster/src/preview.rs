//! Pictures to look at: hillshade, stretched colour, a mask over a picture; written as PNG.

use super::write::write_atomically;
use super::{RasterError, Result};
use heliosplat::Raster;
use heliosplat_grid::statistics::quantile;
use image::{ImageFormat, Rgb, RgbImage};
use std::io::Cursor;
use std::path::Path;

/// Colour of unknown cells in pictures.
pub const UNKNOWN: Rgb<u8> = Rgb([40, 40, 48]);

/// Writes a picture as PNG, whole or not at all.
///
/// # Errors
/// A full disk, a refused permission or another failure to write, as [`write_cog`](super::write_cog).
pub fn write_png(path: &Path, picture: &RgbImage) -> Result<()> {
    let mut bytes = Cursor::new(Vec::new());
    let written = picture.write_to(&mut bytes, ImageFormat::Png);
    written.map_err(|error| RasterError::Write(path.to_owned(), error.to_string()))?;
    write_atomically(path, bytes.get_ref())
}

/// Hillshade of the first band of an altitude raster (metres) with pixels of `gsd_m` metres, north up: light from the
/// north-west at 45°, mixed with the altitude between its 2nd and 98th percentile so that flat roofs differ from
/// ground.
pub fn hillshade(altitude: &Raster, gsd_m: f64) -> RgbImage {
    let (width, height) = (altitude.width, altitude.height);
    let plane = altitude.plane(0);
    let (low, high) = percentiles(plane, 0.02, 0.98).unwrap_or((0.0, 1.0));
    let span = (high - low).max(1e-3);
    let at = |col: usize, row: usize| plane[row * width + col];
    RgbImage::from_fn(width as u32, height as u32, |col, row| {
        let (col, row) = (col as usize, row as usize);
        let centre = at(col, row);
        if !centre.is_finite() {
            return UNKNOWN;
        }
        let known = |value: f32| if value.is_finite() { value } else { centre };
        let (west, east) = (col.saturating_sub(1), (col + 1).min(width - 1));
        let (north, south) = (row.saturating_sub(1), (row + 1).min(height - 1));
        let slope = |a: f32, b: f32, steps: usize| f64::from(b - a) / (steps.max(1) as f64 * gsd_m);
        let to_east = slope(known(at(west, row)), known(at(east, row)), east - west);
        let to_north = slope(known(at(col, south)), known(at(col, north)), south - north);
        // Unit vector to a light in the north-west, 45 degrees up, dotted with the surface normal.
        let light = [-0.5, 0.5, std::f64::consts::FRAC_1_SQRT_2];
        let length = (1.0 + to_east * to_east + to_north * to_north).sqrt();
        let shade = ((light[2] - to_east * light[0] - to_north * light[1]) / length).max(0.0);
        let tint = f64::from(((centre - low) / span).clamp(0.0, 1.0));
        let value = (shade * (0.75 + 0.35 * tint)).min(1.0);
        let warm = |gain: f64| (value * gain * 255.0).clamp(0.0, 255.0) as u8;
        Rgb([warm(0.96 + 0.04 * tint), warm(0.97), warm(1.0 - 0.06 * tint)])
    })
}

/// Picture of the first three bands (or of the first, in grey), stretched between the 1st and the 99th percentile over
/// all shown bands, with display gamma 2.2.
pub fn stretched(raster: &Raster) -> RgbImage {
    stretched_within(raster, shown_range(raster).unwrap_or((0.0, 1.0)))
}

/// The 1st and the 99th percentile of the bands that a picture shows; `None` where nothing is known.
pub fn shown_range(raster: &Raster) -> Option<(f32, f32)> {
    let distinct = if raster.bands >= 3 { 3 } else { 1 };
    percentiles(&raster.values[..raster.plane_len() * distinct], 0.01, 0.99)
}

/// Picture of the first three bands (or of the first, in grey), stretched between two given values, with display gamma
/// 2.2 as [`stretched`] has it: pictures of one range can be compared.
pub fn stretched_within(raster: &Raster, (low, high): (f32, f32)) -> RgbImage {
    let shown: [usize; 3] = if raster.bands >= 3 { [0, 1, 2] } else { [0; 3] };
    let span = (high - low).max(f32::MIN_POSITIVE);
    RgbImage::from_fn(raster.width as u32, raster.height as u32, |col, row| {
        let pixel = shown.map(|band| raster.at(band, col as usize, row as usize));
        if pixel.iter().any(|value| !value.is_finite()) {
            return UNKNOWN;
        }
        Rgb(pixel.map(|value| (((value - low) / span).clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8))
    })
}

/// Pictures of one size from left to right; an empty picture without any.
pub fn side_by_side(panels: &[RgbImage]) -> RgbImage {
    let (width, height) = panels.first().map_or((0, 0), RgbImage::dimensions);
    RgbImage::from_fn(width * panels.len() as u32, height, |col, row| {
        *panels[(col / width) as usize].get_pixel(col % width, row)
    })
}

/// Paints `mask` (first band, 0..1) over a picture of the same size: a mask of 1 mixes in half of `colour`.
pub fn overlay(picture: &mut RgbImage, mask: &Raster, colour: [u8; 3]) {
    for (col, row, pixel) in picture.enumerate_pixels_mut() {
        if (col as usize) < mask.width && (row as usize) < mask.height {
            let strength = mask.at(0, col as usize, row as usize).clamp(0.0, 1.0);
            if strength.is_finite() {
                for (value, &paint) in pixel.0.iter_mut().zip(&colour) {
                    let mixed = f32::from(*value) * (1.0 - 0.5 * strength) + f32::from(paint) * 0.5 * strength;
                    *value = mixed.round() as u8;
                }
            }
        }
    }
}

/// The quantiles `low` and `high` (0..1) of the finite values, from at most a few hundred thousand evenly spaced ones;
/// `None` without any.
pub fn percentiles(values: &[f32], low: f64, high: f64) -> Option<(f32, f32)> {
    const MOST: usize = 400_000;
    let step = (values.len() / MOST).max(1);
    let mut sample: Vec<f32> = values.iter().step_by(step).copied().filter(|v| v.is_finite()).collect();
    Some((quantile(&mut sample, low)?, quantile(&mut sample, high)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_facing_the_light_is_brighter_than_one_facing_away() {
        let mut rising_east = Raster::filled(9, 9, 1, 0.0);
        for row in 0..9 {
            for col in 0..9 {
                rising_east.values[row * 9 + col] = col as f32;
            }
        }
        let mut rising_west = rising_east.clone();
        rising_west.values.iter_mut().for_each(|value| *value = 8.0 - *value);
        // A slope that rises to the east faces west, where the light is.
        let (facing, away) = (hillshade(&rising_east, 1.0), hillshade(&rising_west, 1.0));
        assert!(facing.get_pixel(4, 4).0[1] > away.get_pixel(4, 4).0[1] + 50);
    }

    #[test]
    fn unknown_pixels_have_their_own_colour() {
        let mut raster = Raster::filled(4, 4, 1, 2.0);
        raster.values[0] = f32::NAN;
        assert_eq!(*hillshade(&raster, 0.5).get_pixel(0, 0), UNKNOWN);
        assert_eq!(*stretched(&raster).get_pixel(0, 0), UNKNOWN);
    }

    #[test]
    fn percentiles_ignore_missing_values() {
        let values = [f32::NAN, 1.0, 2.0, 3.0, f32::NAN];
        assert_eq!(percentiles(&values, 0.0, 1.0), Some((1.0, 3.0)));
        assert_eq!(percentiles(&[f32::NAN], 0.0, 1.0), None);
    }
}
