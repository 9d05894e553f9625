//! Pixel values: missing ones marked, display values made linear, all images of a scene on one scale.

use super::bands::BandPlan;
use super::draft::Draft;
use super::manifest::Counts;
use super::{BandKind, SceneError, Values, saturation};
use heliosplat::Raster;
use heliosplat::shade::display;
use heliosplat_grid::statistics::quantile;
use heliosplat_raster::{RasterFile, Window};
use rayon::prelude::*;

/// The share of values below the scene's unit: the brightest glints lie above 1.
const UNIT_QUANTILE: f64 = 0.999;

/// Reads the planned bands of a window of a file; transparent pixels and black borders become `NaN`, display values linear.
///
/// Satellite counts are proportional to radiance, with 8 bits too, unless `declared` or the file (item `RADIOMETRY`)
/// says that they are encoded for display.
pub(super) fn read(
    file: &RasterFile,
    plan: &BandPlan,
    window: Window,
    declared: Option<Counts>,
    warnings: &mut Vec<String>,
) -> Result<Raster, SceneError> {
    let mut raster = file.read(window, &plan.file_bands)?;
    if let Some(alpha) = plan.alpha {
        let opacity = file.read(window, &[alpha])?;
        blank(&mut raster, |index| opacity.values[index] == 0.0);
    }
    blank_black_border(&mut raster, file, warnings);
    let known_and_lit = raster.values.iter().any(|&value| value.is_finite() && value > 0.0);
    if !known_and_lit {
        return Err(SceneError::NoPixels(file.path().to_owned()));
    }
    if declared.unwrap_or_else(|| stated_counts(file)) == Counts::Display {
        for value in &mut raster.values {
            *value = display::decode(*value / 255.0);
        }
    }
    Ok(raster)
}

fn stated_counts(file: &RasterFile) -> Counts {
    match file.domain("").get("RADIOMETRY") {
        Some(radiometry) if radiometry.to_lowercase().contains("srgb") => Counts::Display,
        _ => Counts::Linear,
    }
}

/// Whether nobody says what the eight bits of an image mean.
fn is_unsaid(draft: &Draft) -> bool {
    let eight = draft.file.bands.first().is_some_and(|band| band.data_type == "Byte");
    eight && draft.radiometry.is_none() && !draft.file.domain("").contains_key("RADIOMETRY")
}

/// Who says that the values of an image are for display: `scene.toml`, the file, or, with eight bits of which nobody says anything, the
/// values themselves, clipped at what eight bits hold. `raster` is what was read of it.
pub(super) fn for_display(draft: &Draft, raster: &Raster, declared: Option<Counts>) -> Option<Values> {
    match declared {
        Some(Counts::Display) => return Some(Values::for_display(Some("scene.toml"))),
        Some(Counts::Linear) => return None,
        None => {}
    }
    if stated_counts(&draft.file) == Counts::Display {
        return Some(Values::for_display(Some("image")));
    }
    (is_unsaid(draft) && saturation::at_limits_of_eight_bits(raster)).then(|| Values::for_display(None))
}

/// The line that says that images stretched for display have no index, where their bands would make one.
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

/// The line that says how eight-bit values are taken, of which nobody says what they mean.
pub(super) fn eight_bits(drafts: &[Draft], declared: Option<Counts>) -> Option<String> {
    let unsaid = |draft: &&Draft| is_unsaid(draft);
    if declared.is_some() {
        return None;
    }
    let count = drafts.iter().filter(unsaid).count();
    let first = drafts.iter().find(unsaid)?;
    Some(format!(
        "{}: 8-bit values ({count} images) are taken as linear, and their greatest as clipped where many pixels have it; say \
         counts = \"display\" in a scene.toml where a display curve was applied",
        first.file.path().display()
    ))
}

/// Divides all images by the 99.9 % quantile of all their values; returns that quantile.
pub(super) fn scale_together(images: &mut [Raster]) -> f64 {
    const SAMPLES: usize = 4_000_000;
    let total: usize = images.iter().map(|image| image.values.len()).sum();
    let step = (total / SAMPLES).max(1);
    let mut sample: Vec<f32> = Vec::with_capacity(total / step + images.len());
    for image in images.iter() {
        let finite = image
            .values
            .iter()
            .step_by(step)
            .copied()
            .filter(|value| value.is_finite());
        sample.extend(finite);
    }
    let Some(unit) = quantile(&mut sample, UNIT_QUANTILE) else {
        return 1.0;
    };
    // An image that is dark almost everywhere still needs a unit.
    let unit = if unit > 0.0 {
        unit
    } else {
        sample.iter().copied().fold(f32::MIN_POSITIVE, f32::max)
    };
    (images.par_iter_mut().flat_map(|image| &mut image.values)).for_each(|value| *value /= unit);
    f64::from(unit)
}

fn blank(raster: &mut Raster, is_missing: impl Fn(usize) -> bool) {
    let plane = raster.plane_len();
    for index in (0..plane).filter(|&index| is_missing(index)) {
        for band in 0..raster.bands {
            raster.values[band * plane + index] = f32::NAN;
        }
    }
}

/// Crops of rotated or orthorectified images have borders of zeros that no nodata value declares: zeros in all bands
/// that hang together with the image's edge and are too many to be shadow.
fn blank_black_border(raster: &mut Raster, file: &RasterFile, warnings: &mut Vec<String>) {
    const LEAST_SHARE: f64 = 0.005;
    let border = black_border(raster);
    let count = border.iter().filter(|&&black| black).count();
    if (count as f64) < LEAST_SHARE * raster.plane_len() as f64 {
        return;
    }
    warnings.push(format!(
        "{}: a black border of {:.1} % of its pixels is taken as missing",
        file.path().display(),
        100.0 * count as f64 / raster.plane_len() as f64
    ));
    blank(raster, |index| border[index]);
}

fn black_border(raster: &Raster) -> Vec<bool> {
    let (width, height, plane) = (raster.width, raster.height, raster.plane_len());
    let is_black = |index: usize| (0..raster.bands).all(|band| raster.values[band * plane + index] == 0.0);
    let mut border = vec![false; plane];
    let mut open: Vec<usize> = Vec::new();
    let visit = |index: usize, border: &mut Vec<bool>, open: &mut Vec<usize>| {
        if !border[index] && is_black(index) {
            border[index] = true;
            open.push(index);
        }
    };
    for col in 0..width {
        visit(col, &mut border, &mut open);
        visit((height - 1) * width + col, &mut border, &mut open);
    }
    for row in 0..height {
        visit(row * width, &mut border, &mut open);
        visit(row * width + width - 1, &mut border, &mut open);
    }
    while let Some(index) = open.pop() {
        let (col, row) = (index % width, index / width);
        if col > 0 {
            visit(index - 1, &mut border, &mut open);
        }
        if col + 1 < width {
            visit(index + 1, &mut border, &mut open);
        }
        if row > 0 {
            visit(index - width, &mut border, &mut open);
        }
        if row + 1 < height {
            visit(index + width, &mut border, &mut open);
        }
    }
    border
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_is_one_quantile_over_all_images_and_ignores_missing_values() {
        let mut bright = Raster::filled(100, 10, 1, 1000.0);
        bright.values[0] = 60_000.0;
        bright.values[1] = f32::NAN;
        let dark = Raster::filled(100, 10, 1, 500.0);
        let mut images = [bright, dark];
        let unit = scale_together(&mut images);
        assert_eq!(unit, 1000.0);
        assert_eq!(images[1].values[7], 0.5);
        assert!(images[0].values[1].is_nan());
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
