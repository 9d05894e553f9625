//! Shadow prior from the images, without a model: dark pixels with a structure toward the sun.
//!
//! The detector is radiometric (no network): Otsu's threshold (1979) on the logarithm of brightness divides each image
//! into lit and dark. Leaves are left out (they are dark and shade themselves), and so is water; a dark pixel is a
//! shadow only where the initial surface has an occluder toward the sun, else it has no prior. ShadowGS uses the masks
//! of a trained detector in the same place.

use glam::{Vec2, Vec3};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_raster::Window;
use heliosplat_raster::file::RasterFile;
use heliosplat_scene::indices::{ExcessGreen, NormalisedDifference, VEGETATION_GREEN, VEGETATION_INDEX};
use heliosplat_scene::{BandKind, SceneImage, Values};
use heliosplat_stereo::Surface;
use rayon::prelude::*;
use std::path::Path;

/// Water index (green against near infrared, McFeeters 1996) from which on a pixel is water.
const WATER: f32 = 0.4;
/// Steps of the histogram of brightness.
const STEPS: usize = 128;
/// Half of the range around the threshold without a prior, natural logarithm of brightness.
const DOUBT: f32 = 0.25;
/// Least distance between the logarithms of lit and dark brightness: with less there is no shadow.
const LEAST_CONTRAST: f32 = 0.5;
/// Distance below the line to the sun, metres, within which an occluder still counts: edges of the initial surface are
/// rough.
const SLACK_M: f32 = 1.5;
/// Rounds in which a ray finds the surface.
const ROUNDS: usize = 8;

/// Number of views from which on the images determine the shadows and need no prior.
pub const ENOUGH_VIEWS: usize = 8;

/// Bands that separate leaves and water.
struct Bands<'a> {
    raster: &'a Raster,
    vegetation: Option<NormalisedDifference>,
    water: Option<NormalisedDifference>,
    green: Option<ExcessGreen>,
}

impl<'a> Bands<'a> {
    fn new(kinds: &[BandKind], values: &Values, raster: &'a Raster) -> Self {
        let kinds = &kinds[..kinds.len().min(raster.bands)];
        Self {
            raster,
            vegetation: values.ndvi(kinds),
            water: values.water_index(kinds),
            green: ExcessGreen::new(kinds),
        }
    }

    fn value(&self, band: usize, pixel: usize) -> f32 {
        self.raster.values[band * self.raster.plane_len() + pixel]
    }

    /// True if a pixel shows leaves; `false` where the bands do not allow an index.
    fn vegetation(&self, pixel: usize) -> bool {
        let value = |band| self.value(band, pixel);
        match (self.vegetation, self.green) {
            (Some(index), _) => index.of(value) > VEGETATION_INDEX,
            (None, Some(index)) => index.of(value) > VEGETATION_GREEN,
            _ => false,
        }
    }

    fn water(&self, pixel: usize) -> bool {
        let index = self.water.map(|index| index.of(|band| self.value(band, pixel)));
        index.is_some_and(|index| index > WATER)
    }
}

/// Radiometric class of each pixel of an image: 1 lit, 0 in shadow, NaN neither.
fn by_brightness(kinds: &[BandKind], values: &Values, raster: &Raster) -> Vec<f32> {
    let bands = Bands::new(kinds, values, raster);
    let brightness: Vec<f32> = (0..raster.plane_len())
        .map(|pixel| {
            let mean: f32 = (0..raster.bands).map(|band| raster.plane(band)[pixel]).sum::<f32>() / raster.bands as f32;
            let says = mean > 0.0 && !bands.vegetation(pixel) && !bands.water(pixel);
            if says { mean.ln() } else { f32::NAN }
        })
        .collect();
    let Some(threshold) = otsu(&brightness) else {
        return vec![f32::NAN; brightness.len()];
    };
    brightness
        .iter()
        .map(|b| match b - threshold {
            above if above > DOUBT => 1.0,
            above if above < -DOUBT => 0.0,
            _ => f32::NAN,
        })
        .collect()
}

/// Threshold that best divides `values` in two (Otsu 1979: greatest variance between the classes), NaN left out; `None`
/// where there are no two classes or they are too similar.
fn otsu(values: &[f32]) -> Option<f32> {
    let known = || values.iter().copied().filter(|v| v.is_finite());
    let (low, high) = known().fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if high - low <= LEAST_CONTRAST {
        return None;
    }
    let mut histogram = [0.0f64; STEPS];
    let scale = (STEPS as f32 - 1.0) / (high - low);
    known().for_each(|v| histogram[((v - low) * scale) as usize] += 1.0);
    let total: f64 = histogram.iter().sum();
    let sum: f64 = histogram.iter().enumerate().map(|(step, n)| step as f64 * n).sum();
    let (mut below, mut sum_below) = (0.0, 0.0);
    // The greatest variance, the first and the last step with it (no value is between them), and the distance of the
    // classes.
    let (mut most, mut steps, mut apart) = (0.0, (0, 0), 0.0);
    for (step, n) in histogram.iter().enumerate() {
        below += n;
        sum_below += step as f64 * n;
        let above = total - below;
        if below == 0.0 || above == 0.0 {
            continue;
        }
        let distance = (sum - sum_below) / above - sum_below / below;
        let between = below * above * distance * distance;
        if between > most {
            (most, steps, apart) = (between, (step, step), distance);
        } else if *n == 0.0 && steps.1 + 1 == step {
            steps.1 = step;
        }
    }
    let middle = (steps.0 + steps.1 + 1) as f32 / 2.0;
    (apart as f32 / scale > LEAST_CONTRAST).then(|| low + middle / scale)
}

/// Approximate intersection of a pixel's ray with the surface.
fn met(camera: &ProjectiveCamera, surface: &Surface, col: f32, row: f32, top_m: f32) -> Option<Vec3> {
    let mut z = top_m;
    for _ in 0..ROUNDS {
        let p = camera.point_at_altitude(col, row, z)?;
        z = surface.altitude_at(p.x, p.y)?;
    }
    camera.point_at_altitude(col, row, z)
}

/// True if the surface may have an occluder between a point of it and the sun.
fn may_be_shaded(surface: &Surface, point: Vec3, sun: Vec3, top_m: f32) -> bool {
    let flat = Vec2::new(sun.x, sun.y);
    let Some(toward) = flat.try_normalize() else {
        return false;
    };
    let rise = sun.z / flat.length();
    let mut distance = surface.cell_m;
    while point.z + distance * rise - SLACK_M < top_m {
        let at = Vec2::new(point.x, point.y) + toward * distance;
        let Some(altitude) = surface.altitude_at(at.x, at.y) else {
            return false;
        };
        if altitude > point.z + distance * rise - SLACK_M && altitude > point.z + SLACK_M {
            return true;
        }
        distance += surface.cell_m;
    }
    false
}

/// Shadow prior of each of `images`, `[row][column]` of its crop: 1 lit, 0 in shadow, NaN without a prior. `rasters`
/// are the crops, `cameras` their cameras, `surface` is the initial surface, and `suns` are unit vectors toward the
/// sun; an image without a sun has no prior.
pub fn found(
    images: &[&SceneImage],
    rasters: &[&Raster],
    surface: &Surface,
    cameras: &[ProjectiveCamera],
    suns: &[Option<Vec3>],
) -> Vec<Vec<f32>> {
    let top_m = surface.altitude.iter().copied().fold(f32::MIN, f32::max);
    let one = |(i, raster): (usize, &&Raster)| {
        let image = images[i];
        let Some(sun) = suns[i] else {
            return vec![f32::NAN; raster.plane_len()];
        };
        let mut lit = by_brightness(&image.bands, &image.values, raster);
        let width = raster.width;
        lit.par_iter_mut()
            .enumerate()
            .with_min_len(width)
            .for_each(|(pixel, lit)| {
                if *lit == 0.0 {
                    let (col, row) = ((pixel % width) as f32, (pixel / width) as f32);
                    let shaded = met(&cameras[i], surface, col, row, top_m)
                        .is_some_and(|point| may_be_shaded(surface, point, sun, top_m));
                    if !shaded {
                        *lit = f32::NAN;
                    }
                }
            });
        lit
    };
    rasters.iter().enumerate().map(one).collect()
}

/// Mask of an image from the file `NAME.tif` in a folder, cut to the crop of the image, `[row][column]`: 1 lit, 0 in
/// shadow, NaN (nodata) neither.
///
/// # Errors
/// When the file is missing, damaged, or of another size than its image.
pub fn from_folder(folder: &Path, image: &SceneImage, crop: &Window) -> Result<Vec<f32>, String> {
    let path = folder.join(format!("{}.tif", image.name));
    let unreadable = |error: heliosplat_raster::RasterError| format!("model.shadow_masks: {error}");
    let file = RasterFile::open(&path).map_err(unreadable)?;
    let image_px = (image.pixels.width, image.pixels.height);
    if file.size() != image_px {
        return Err(format!(
            "model.shadow_masks: {} has {:?} pixels and its image {image_px:?}; a mask covers its image: 1 where it is lit, 0 in shadow",
            path.display(),
            file.size()
        ));
    }
    let mask = crop.cut(&file.read(file.whole(), &[0]).map_err(unreadable)?);
    Ok(mask.values.into_iter().map(|value| value.clamp(0.0, 1.0)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const KINDS: [BandKind; 4] = [BandKind::Red, BandKind::Green, BandKind::Blue, BandKind::NearInfrared];

    fn pixels(colours: &[[f32; 4]]) -> Raster {
        let mut raster = Raster::filled(colours.len(), 1, 4, 0.0);
        for (i, colour) in colours.iter().enumerate() {
            for (band, value) in colour.iter().enumerate() {
                raster.values[band * colours.len() + i] = *value;
            }
        }
        raster
    }

    #[test]
    fn dark_places_are_shadows_unless_they_are_leaves_or_water() {
        let (lit, dark) = ([0.9, 0.9, 0.9, 0.9], [0.2, 0.2, 0.25, 0.2]);
        let (leaves, water) = ([0.05, 0.08, 0.04, 0.4], [0.1, 0.15, 0.2, 0.02]);
        let raster = pixels(&[lit, lit, lit, dark, dark, leaves, water]);
        let prior = by_brightness(&KINDS, &Values::default(), &raster);
        assert_eq!(prior[..5], [1.0, 1.0, 1.0, 0.0, 0.0]);
        assert!(prior[5].is_nan() && prior[6].is_nan());
    }

    #[test]
    fn an_even_image_says_nothing() {
        let prior = by_brightness(&KINDS, &Values::default(), &pixels(&[[0.5, 0.5, 0.5, 0.5]; 8]));
        assert!(prior.iter().all(|s| s.is_nan()));
        assert_eq!(otsu(&[f32::NAN; 4]), None);
    }

    #[test]
    fn only_what_has_something_toward_the_sun_may_be_shaded() {
        // A wall of ten metres on the eastern half of a level ground.
        let mut surface = Surface {
            width: 40,
            height: 4,
            west_m: 0.0,
            north_m: 4.0,
            cell_m: 1.0,
            views: vec![2; 160],
            probability: vec![1.0; 160],
            matched: vec![true; 160],
            ..Surface::default()
        };
        surface.altitude = (0..160).map(|i| if i % 40 >= 20 { 10.0 } else { 0.0 }).collect();
        let east = Vec3::new(1.0, 0.0, 1.0).normalize();
        let at = |x: f32, z: f32| Vec3::new(x, 2.0, z);
        assert!(may_be_shaded(&surface, at(15.0, 0.0), east, 10.0));
        assert!(
            !may_be_shaded(&surface, at(5.0, 0.0), east, 10.0),
            "the shadow is ten metres long"
        );
        assert!(!may_be_shaded(&surface, at(30.0, 10.0), east, 10.0), "roofs are lit");
        let west = Vec3::new(-1.0, 0.0, 1.0).normalize();
        assert!(!may_be_shaded(&surface, at(15.0, 0.0), west, 10.0));
    }
}
