//! Height errors as a picture: blue where the prediction is too low, red where it is too high, ±5 m, with a legend.

use crate::DsmEvaluation;
use heliosplat::Raster;
use heliosplat_raster::RasterError;
use heliosplat_raster::write::{ImageSpec, SampleType, write_geotiff};
use image::{Rgb, RgbImage};
use std::path::Path;

/// Errors at and beyond this have the full colour, metres. Fixed, so that pictures of different runs compare.
pub const FULL_COLOUR_M: f32 = 5.0;

const NOT_MEASURED: Rgb<u8> = Rgb([64, 64, 64]);
const LEGEND_ROWS: u32 = 24;
const TEXT: Rgb<u8> = Rgb([0, 0, 0]);
const PAPER: Rgb<u8> = Rgb([255, 255, 255]);

/// Writes the errors of an evaluation as a GeoTIFF on the truth's grid: prediction minus truth, metres.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, evaluation: &DsmEvaluation) -> Result<(), RasterError> {
    let truth = &evaluation.truth;
    let spec = ImageSpec {
        band_descriptions: &["difference_m"],
        band_units: &["metre"],
        georeference: truth.crs.as_ref().map(|crs| (&truth.transform, crs)),
        ..ImageSpec::plain(&evaluation.errors)
    };
    write_geotiff(path, &spec, SampleType::F32)
}

/// Draws errors (prediction minus truth, metres; first band) with a legend line below.
pub fn draw(errors: &Raster) -> RgbImage {
    let (width, height) = (errors.width as u32, errors.height as u32);
    let mut picture = RgbImage::from_pixel(width.max(110), height + LEGEND_ROWS, PAPER);
    for row in 0..height {
        for col in 0..width {
            picture.put_pixel(col, row, colour(errors.at(0, col as usize, row as usize)));
        }
    }
    draw_legend(&mut picture, height);
    picture
}

/// White at zero, blue below, red above: the ends of ColorBrewer's RdBu scheme.
fn colour(error_m: f32) -> Rgb<u8> {
    if !error_m.is_finite() {
        return NOT_MEASURED;
    }
    let share = (error_m / FULL_COLOUR_M).clamp(-1.0, 1.0);
    let end = if share < 0.0 {
        [33.0, 102.0, 172.0]
    } else {
        [178.0, 24.0, 43.0]
    };
    // The square root shows small errors, which are most.
    let strength = share.abs().sqrt();
    Rgb(end.map(|value: f32| (255.0 + (value - 255.0) * strength).round() as u8))
}

fn draw_legend(picture: &mut RgbImage, top: u32) {
    let width = picture.width();
    let bar = 4..width - 4;
    let across = (bar.end - bar.start - 1).max(1) as f32;
    for col in bar.clone() {
        let error_m = ((col - bar.start) as f32 / across * 2.0 - 1.0) * FULL_COLOUR_M;
        for row in top + 4..top + 11 {
            picture.put_pixel(col, row, colour(error_m));
        }
    }
    let labels = [
        format!("-{FULL_COLOUR_M} m"),
        "0".to_owned(),
        format!("+{FULL_COLOUR_M} m"),
    ];
    let centred = (width - text_width(&labels[1])) / 2;
    let right = width - 4 - text_width(&labels[2]);
    for (text, col) in labels.iter().zip([4, centred, right]) {
        draw_text(picture, text, col, top + 14);
    }
}

const GLYPH_COLUMNS: u32 = 5;
const GLYPH_STEP: u32 = GLYPH_COLUMNS + 1;

fn text_width(text: &str) -> u32 {
    text.chars().count() as u32 * GLYPH_STEP
}

fn draw_text(picture: &mut RgbImage, text: &str, left: u32, top: u32) {
    for (index, character) in text.chars().enumerate() {
        for (row, bits) in glyph(character).into_iter().enumerate() {
            for col in 0..GLYPH_COLUMNS {
                let (x, y) = (left + index as u32 * GLYPH_STEP + col, top + row as u32);
                if bits >> (GLYPH_COLUMNS - 1 - col) & 1 == 1 && x < picture.width() && y < picture.height() {
                    picture.put_pixel(x, y, TEXT);
                }
            }
        }
    }
}

/// Rows of five bits, top to bottom, of the few characters a legend needs.
fn glyph(character: char) -> [u8; 7] {
    match character {
        '0' => [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110],
        '5' => [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110],
        '+' => [0b00000, 0b00100, 0b00100, 0b11111, 0b00100, 0b00100, 0b00000],
        '-' => [0b00000, 0b00000, 0b00000, 0b11111, 0b00000, 0b00000, 0b00000],
        'm' => [0b00000, 0b00000, 0b11010, 0b10101, 0b10101, 0b10101, 0b10101],
        _ => [0; 7],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_is_white_at_zero_blue_below_red_above_and_saturates() {
        assert_eq!(colour(0.0), Rgb([255, 255, 255]));
        assert_eq!(colour(5.0), colour(50.0));
        assert_eq!(colour(-5.0), Rgb([33, 102, 172]));
        assert!(colour(1.0).0[0] > colour(1.0).0[2]);
        assert_eq!(colour(f32::NAN), NOT_MEASURED);
    }

    #[test]
    fn the_picture_holds_the_errors_and_a_legend() {
        let picture = draw(&Raster::filled(200, 50, 1, -5.0));
        assert_eq!(picture.dimensions(), (200, 50 + LEGEND_ROWS));
        assert_eq!(*picture.get_pixel(0, 0), Rgb([33, 102, 172]));
        assert!(picture.pixels().any(|&pixel| pixel == TEXT));
    }
}
