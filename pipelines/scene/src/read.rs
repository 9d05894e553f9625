//! The only reader of pixels: the images of a [`Cut`] become a [`Scene`].

use super::cut::{camera_fault, gsd_m, nominal_gsd_m};
use super::kept::KeptCut;
use super::{Cut, CutImage, ImageSun, Result, Scene, SceneError, SceneImage, Split, Values, pixels, truth, values};
use heliosplat::Raster;
use heliosplat_delivery::{Index, IndexImage};
use heliosplat_raster::Window;
use heliosplat_rpc::{ImageWindow, LocalFrame, PinholeFit};
use rayon::prelude::*;

/// Image of the index, its part of a cut, and its pixels.
struct Read<'a> {
    image: &'a IndexImage,
    part: CutImage,
    pixels: Raster,
}

impl Scene {
    /// Reads the pixels of a cut. `warnings` are those of `Cut::of`; the scene's warnings are those of the index,
    /// then these.
    ///
    /// # Errors
    /// [`SceneError`] when pixels cannot be read or a camera cannot be used.
    pub fn read(index: &Index, cut: &Cut, mut warnings: Vec<String>) -> Result<Self> {
        warnings.splice(0..0, index.warnings.iter().cloned());
        let mut found_truth = index.truth.clone();
        truth::keep_if_here(&mut found_truth, &cut.frame, &cut.area, &mut warnings);
        let mut cut = cut.clone();
        let mut images = read_all(index, &cut, &mut warnings)?;
        cut.images = images.iter().map(|read| read.part).collect();
        cut.must_be_shown_twice(&index.source, || cut.area.to_string())?;
        let frame = cut.frame;
        let suns = images.iter().map(|read| read.image.sun(frame.origin, &mut warnings));
        let suns: Vec<ImageSun> = suns.collect();
        let shown = images.iter().map(|read| pixels::for_display(read.image, &read.pixels));
        let shown: Vec<_> = shown.collect();
        let mut rasters: Vec<&mut Raster> = images.iter_mut().map(|read| &mut read.pixels).collect();
        let counts_per_unit = pixels::scale_together(&mut rasters, cut.counts_per_unit);
        cut.counts_per_unit = Some(counts_per_unit);
        let mut values = Vec::with_capacity(images.len());
        for ((read, sun), shown) in images.iter().zip(&suns).zip(shown) {
            let path = read.image.path.display().to_string();
            values.push((
                path,
                shown.unwrap_or_else(|| values_of(read.image, sun, counts_per_unit)),
            ));
        }
        let kinds = images.first().map_or(&[][..], |read| &read.image.bands.kinds);
        warnings.extend(pixels::stretched(&values, kinds));
        if Values::default().ndvi(kinds).is_some() {
            warnings.extend(values::same_for_all(&mut values));
        }
        let fits = fit_pinholes(&images, &cut, &mut warnings)?;
        let kept = KeptCut::of(index, &cut, counts_per_unit);
        let mut out = Vec::with_capacity(images.len());
        let read = images.into_iter().zip(suns).zip(values).zip(fits);
        for (((Read { image, part, pixels }, sun), (_, values)), pinhole) in read {
            out.push(SceneImage {
                name: image.name.clone(),
                path: image.path.clone(),
                split: part.split,
                window: part.window,
                pixels: pixels.into(),
                values,
                data_type: image.data_type.clone(),
                bands: image.bands.kinds.clone(),
                rpc: image.rpc.clone(),
                rpc_source: image.rpc_source.clone(),
                pinhole,
                time: image.acquisition.time,
                sun,
                metadata_sun: image.acquisition.stated_sun(),
                gsd_m: gsd_m(image, &part.window, &frame, frame.origin.height_m)?,
            });
        }
        out.sort_by_key(|image| image.split == Split::Test);
        let training = out.iter().filter(|image| image.split == Split::Train);
        let mut scene = Self {
            source: index.source.clone(),
            gsd_m: nominal_gsd_m(training.map(|image| image.gsd_m).collect()),
            images: out,
            frame,
            altitude_range_m: cut.altitude.limits_m(),
            altitude_known_from: cut.altitude.source,
            altitude_source: cut.altitude.words,
            area: cut.area,
            counts_per_unit,
            truth: found_truth,
            findings: index.findings.clone(),
            cut: kept,
            warnings,
        };
        scene.warn_of_copies();
        scene.warn_of_clipped();
        Ok(scene)
    }
}

/// Pixels of all images of a cut. An image without any pixel is left out where the cut is a part, and an error
/// otherwise.
fn read_all<'a>(index: &'a Index, cut: &Cut, warnings: &mut Vec<String>) -> Result<Vec<Read<'a>>> {
    let parts = cut.images.iter();
    let placed: Vec<(&IndexImage, CutImage)> = parts
        .filter_map(|part| Some((index.images.get(part.image)?, *part)))
        .collect();
    let read: Vec<(Result<Raster>, Vec<String>)> = placed
        .par_iter()
        .map(|(image, part)| {
            let mut warnings = Vec::new();
            (pixels::read(image, part.window, &mut warnings), warnings)
        })
        .collect();
    let mut images = Vec::with_capacity(placed.len());
    for ((image, part), (read, more)) in placed.into_iter().zip(read) {
        warnings.extend(more);
        match read {
            Err(SceneError::NoPixels(_)) if cut.is_part => {}
            read => images.push(Read {
                image,
                part,
                pixels: read?,
            }),
        }
    }
    Ok(images)
}

/// Meaning of an image's values, from its metadata.
fn values_of(image: &IndexImage, sun: &ImageSun, counts_per_unit: f64) -> Values {
    let (kinds, places) = (&image.bands.kinds, &image.bands.file_bands);
    let bands = values::FileBands { kinds, places };
    let light = values::Illumination {
        sun: sun.position,
        time: image.acquisition.time,
    };
    let stated = image.radiometry.as_ref();
    let values = |found| Values::of_metadata(found, &bands, &light, counts_per_unit);
    stated.map_or_else(Values::default, values)
}

fn fit_pinholes(images: &[Read], cut: &Cut, warnings: &mut Vec<String>) -> Result<Vec<PinholeFit>> {
    /// Residual with a warning, pixels: a larger one is visible as blur in the model.
    const WORTH_A_WARNING_PX: f64 = 0.25;
    let fit_of = |read: &Read| fit(read.image, &read.part.window, &cut.frame, cut.altitude.limits_m());
    let fits: Vec<_> = images.par_iter().map(fit_of).collect();
    let mut good = Vec::with_capacity(fits.len());
    for (read, fit) in images.iter().zip(fits) {
        let fit = fit?;
        if fit.max_px > WORTH_A_WARNING_PX {
            warnings.push(format!(
                "{}: a pinhole camera stands for its RPC only to {:.2} px (rms {:.2}); give smaller crops or a narrower altitude \
                 range",
                read.image.path.display(),
                fit.max_px,
                fit.rms_px
            ));
        }
        good.push(fit);
    }
    Ok(good)
}

/// Fits the pinhole camera of a window over a range of altitudes (metres above the ellipsoid).
pub(super) fn fit(
    image: &IndexImage,
    window: &Window,
    frame: &LocalFrame,
    altitude_range_m: (f64, f64),
) -> Result<PinholeFit> {
    let window = ImageWindow {
        col0: window.col0 as f64,
        row0: window.row0 as f64,
        width: window.width,
        height: window.height,
    };
    PinholeFit::fit(&image.rpc, frame, window, altitude_range_m)
        .map_err(|source| camera_fault(image, frame.origin.height_m, source))
}
