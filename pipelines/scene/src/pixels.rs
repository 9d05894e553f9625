//! Pixel values: missing ones marked, display values made linear, all images of a scene in one unit.

use super::{BandKind, Result, SceneError, Values, saturation};
use heliosplat::Raster;
use heliosplat::shade::display;
use heliosplat_delivery::{Counts, IndexImage};
use heliosplat_grid::statistics::quantile;
use heliosplat_raster::{RasterFile, Window};
use rayon::prelude::*;
use std::path::Path;

/// Share of values below the scene's unit: only the brightest glints are above 1.
const UNIT_QUANTILE: f64 = 0.999;

/// Reads the planned bands of a window of an image; transparent pixels and black borders become `NaN`, display values
/// linear.
///
/// Satellite counts are proportional to radiance, with 8 bits too, unless `scene.toml` or the file (item `RADIOMETRY`)
/// states that they are encoded for display.
pub(super) fn read(image: &IndexImage, window: Window, warnings: &mut Vec<String>) -> Result<Raster> {
    let file = image.file();
    let mut raster = file.read(window, &image.bands.file_bands)?;
    drop(file);
    blank_unusable(&mut raster, image, (window, 1), warnings)?;
    blank_black_border(&mut raster, &image.path, warnings);
    let known_and_lit = raster.values.iter().any(|&value| value.is_finite() && value > 0.0);
    if !known_and_lit {
        return Err(SceneError::NoPixels(image.path.clone()));
    }
    if image.counts == Counts::Display {
        let white = white_of(&image.data_type, &raster);
        let values = raster.values.iter_mut();
        values.for_each(|value| *value = display::decode(*value / white));
    }
    Ok(raster)
}

/// White of an image encoded for display: the greatest integer of the data type; for floating point, 1, or 255 where
/// values exceed 1.
fn white_of(data_type: &str, raster: &Raster) -> f32 {
    match data_type {
        "UInt16" => f32::from(u16::MAX),
        "Int16" => f32::from(i16::MAX),
        "Float32" | "Float64" if raster.values.iter().all(|&value| value.is_nan() || value <= 1.0) => 1.0,
        _ => 255.0,
    }
}

/// Display values of an image: as stated by `scene.toml` or the file; or, for eight bits without metadata, where the
/// pixels `raster` are clipped at the limits of eight bits. `None` for other images.
pub(super) fn for_display(image: &IndexImage, raster: &Raster) -> Option<Values> {
    if image.counts == Counts::Display {
        return Some(Values::for_display(image.counts_source.as_deref()));
    }
    (image.has_unstated_bytes() && saturation::at_limits_of_eight_bits(raster)).then(|| Values::for_display(None))
}

/// Warning that stretched images have no index, where their bands would allow one.
pub(super) fn stretched(images: &[(String, Values)], bands: &[BandKind]) -> Option<String> {
    let found = images.iter().filter(|(_, values)| *values == Values::for_display(None));
    let first = found
        .clone()
        .next()
        .filter(|_| Values::default().ndvi(bands).is_some())?;
    Some(format!(
        "{}: 8-bit values clipped at 0 or 255 ({} images) were stretched for display: no vegetation or water index; say counts = \
         \"linear\" in a scene.toml where they were not",
        first.0,
        found.count(),
    ))
}

/// Divides all images by `known`, or else by the 99.9 % quantile of all their values; returns the divisor.
pub(super) fn scale_together(images: &mut [&mut Raster], known: Option<f64>) -> f64 {
    let unit = known.map_or_else(|| unit_of(images), |known| known as f32);
    (images.par_iter_mut().flat_map(|image| &mut image.values)).for_each(|value| *value /= unit);
    f64::from(unit)
}

fn unit_of(images: &[&mut Raster]) -> f32 {
    const SAMPLES: usize = 4_000_000;
    let total: usize = images.iter().map(|image| image.values.len()).sum();
    let step = (total / SAMPLES).max(1);
    let mut sample: Vec<f32> = Vec::with_capacity(total / step + images.len());
    for image in images.iter() {
        let values = image.values.iter().step_by(step).copied();
        sample.extend(values.filter(|value| value.is_finite()));
    }
    let Some(unit) = quantile(&mut sample, UNIT_QUANTILE) else {
        return 1.0;
    };
    // An image that is dark almost everywhere needs a unit greater than zero.
    match unit > 0.0 {
        true => unit,
        false => sample.iter().copied().fold(f32::MIN_POSITIVE, f32::max),
    }
}

fn blank(raster: &mut Raster, is_missing: impl Fn(usize) -> bool) {
    let plane = raster.plane_len();
    for index in (0..plane).filter(|&index| is_missing(index)) {
        for band in 0..raster.bands {
            raster.values[band * plane + index] = f32::NAN;
        }
    }
}

/// Marks pixels as missing that Planet's mask states to be unusable: all except 0 in the first version (`udm`, bits),
/// all except clear (band 1) and snow (band 2) in the second (`udm2`).
///
/// Source: Planet, "Usable Data Masks (UDM2)", <https://docs.planet.com/data/imagery/udm/>.
///
/// A pixel that was averaged down by `factor` is missing where any of its parts is.
pub(super) fn blank_unusable(
    raster: &mut Raster,
    image: &IndexImage,
    (window, factor): (Window, usize),
    warnings: &mut Vec<String>,
) -> Result<()> {
    let Some(path) = &image.usable_mask else {
        return Ok(());
    };
    let file = RasterFile::open(path)?;
    if file.size() != image.size {
        let (path, image) = (path.display(), image.path.display());
        warnings.push(format!("{path}: not of the size of {image}; this mask is not applied"));
        return Ok(());
    }
    let is_second = file.bands.len() > 1;
    let mask = file.read_reduced(window, factor, if is_second { &[0, 1] } else { &[0] })?;
    let plane = mask.plane_len();
    let unusable = |index: usize| match is_second {
        // Means of clear and snow parts sum to one, except for rounding.
        true => mask.values[index] + mask.values[plane + index] < 0.999,
        false => mask.values[index] != 0.0,
    };
    let count = (0..plane).filter(|&index| unusable(index)).count();
    if count > 0 {
        let share = 100.0 * count as f64 / plane as f64;
        let (path, image) = (path.display(), image.path.display());
        warnings.push(format!("{image}: {share:.1} % of the pixels are unusable by {path}"));
    }
    blank(raster, unusable);
    Ok(())
}

/// Marks black borders as missing: zeros in all bands, connected to the image's edge, and too many to be shadow. Crops
/// of rotated or orthorectified images have such borders without a declared nodata value.
fn blank_black_border(raster: &mut Raster, path: &Path, warnings: &mut Vec<String>) {
    const LEAST_SHARE: f64 = 0.005;
    let border = black_border(raster);
    let count = border.iter().filter(|&&black| black).count();
    if (count as f64) < LEAST_SHARE * raster.plane_len() as f64 {
        return;
    }
    let (path, share) = (path.display(), 100.0 * count as f64 / raster.plane_len() as f64);
    warnings.push(format!(
        "{path}: a black border of {share:.1} % of its pixels is taken as missing"
    ));
    blank(raster, |index| border[index]);
}

fn black_border(raster: &Raster) -> Vec<bool> {
    let (width, height, plane) = (raster.width, raster.height, raster.plane_len());
    let is_black = |index: usize| (0..raster.bands).all(|band| raster.values[band * plane + index] == 0.0);
    let mut border = vec![false; plane];
    let columns = (0..width).flat_map(|col| [col, (height - 1) * width + col]);
    let rows = (0..height).flat_map(|row| [row * width, row * width + width - 1]);
    let mut open: Vec<usize> = columns.chain(rows).collect();
    while let Some(index) = open.pop() {
        if border[index] || !is_black(index) {
            continue;
        }
        border[index] = true;
        let (col, row) = (index % width, index / width);
        open.extend((col > 0).then(|| index - 1));
        open.extend((col + 1 < width).then_some(index + 1));
        open.extend((row > 0).then(|| index - width));
        open.extend((row + 1 < height).then_some(index + width));
    }
    border
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_is_the_largest_value_of_a_display_image() {
        let raster = |value| Raster::filled(2, 2, 1, value);
        assert_eq!(white_of("Byte", &raster(9.0)), 255.0);
        assert_eq!(white_of("UInt16", &raster(9.0)), 65_535.0);
        assert_eq!(white_of("Float32", &raster(0.5)), 1.0);
        assert_eq!(white_of("Float32", &raster(200.0)), 255.0);
    }

    #[test]
    fn the_unit_is_one_quantile_over_all_images_and_ignores_missing_values() {
        let mut bright = Raster::filled(100, 10, 1, 1000.0);
        bright.values[0] = 60_000.0;
        bright.values[1] = f32::NAN;
        let mut dark = Raster::filled(100, 10, 1, 500.0);
        let unit = scale_together(&mut [&mut bright, &mut dark], None);
        assert_eq!(unit, 1000.0);
        assert_eq!(dark.values[7], 0.5);
        assert!(bright.values[1].is_nan());
    }

    #[test]
    fn zeros_at_the_edge_are_border_and_zeros_inside_are_shadow() {
        let mut image = Raster::filled(6, 6, 1, 9.0);
        for row in 0..6 {
            image.values[row * 6] = 0.0;
        }
        image.values[2 * 6 + 3] = 0.0;
        let border = black_border(&image);
        assert_eq!(border.iter().filter(|&&black| black).count(), 6);
        assert!(!border[2 * 6 + 3]);
    }
}
