//! Height errors as a picture: blue where the prediction is too low, red where it is too high, full colour at ±5 m.

use crate::DsmEvaluation;
use heliosplat::Raster;
use heliosplat_raster::RasterError;
use heliosplat_raster::write::{ImageSpec, SampleType, write_geotiff};
use image::{Rgb, RgbImage};
use std::path::Path;

/// Errors at and beyond this have the full colour, metres. Fixed, so that pictures of different runs compare.
pub const FULL_COLOUR_M: f32 = 5.0;

const NOT_MEASURED: Rgb<u8> = Rgb([64, 64, 64]);

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

/// Draws errors (prediction minus truth, metres; first band), one pixel for each cell; cells without an error are grey.
pub fn draw(errors: &Raster) -> RgbImage {
    let (width, height) = (errors.width as u32, errors.height as u32);
    let pixel = |col, row| colour(errors.at(0, col as usize, row as usize));
    RgbImage::from_fn(width, height, pixel)
}

/// White at zero, blue below, red above: the ends of ColorBrewer's RdBu scheme.
fn colour(error_m: f32) -> Rgb<u8> {
    if !error_m.is_finite() {
        return NOT_MEASURED;
    }
    let share = (error_m / FULL_COLOUR_M).clamp(-1.0, 1.0);
    let end = match share < 0.0 {
        true => [33.0, 102.0, 172.0],
        false => [178.0, 24.0, 43.0],
    };
    // The square root shows small errors, which are most.
    let strength = share.abs().sqrt();
    Rgb(end.map(|value: f32| (255.0 + (value - 255.0) * strength).round() as u8))
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
    fn the_picture_holds_the_errors() {
        let picture = draw(&Raster::filled(200, 50, 1, -5.0));
        assert_eq!(picture.dimensions(), (200, 50));
        assert_eq!(*picture.get_pixel(0, 0), Rgb([33, 102, 172]));
    }
}
