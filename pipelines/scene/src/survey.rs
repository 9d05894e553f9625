//! Size of a cut without its pixels, to divide it into tiles and to estimate memory.

use super::area::window_over;
use super::cut::{footprint_of, gsd_m, localise, nominal_gsd_m, pixels_of};
use super::footprint::Footprint;
use super::read::fit;
use super::{Area, AreaRequest, Cut, CutImage, IngestOptions, Result, SceneError, Split, Truth, truth};
use heliosplat_delivery::{Index, IndexImage};
use heliosplat_raster::Window;
use heliosplat_rpc::LocalFrame;
use rayon::prelude::*;

/// Pinhole cameras fitted in parallel before their residuals are looked at.
const FITS_AT_ONCE: usize = 8;

/// Size of a cut, without its pixels.
pub struct Survey<'a> {
    /// Index of the delivery.
    pub index: &'a Index,
    /// The cut of the index.
    pub cut: Cut,
    /// Corners of the training images on the ground, metres of the cut's frame.
    footprints: Vec<Footprint>,
    /// Lowest and highest altitude of the surface, metres above the ellipsoid.
    pub altitude_range_m: (f64, f64),
    /// Largest base-to-height ratio of two training images at their centres, metres of relative parallax per metre of
    /// altitude.
    pub widest_base_to_height: f64,
    /// Nominal ground sampling distance, metres, as that of [`super::Scene`].
    pub gsd_m: f64,
    /// Number of bands of every image.
    pub bands: usize,
    /// Truth, where the scene contains it.
    pub truth: Truth,
    /// Warnings about the scene's files, one line each.
    pub warnings: Vec<String>,
}

/// Number of pixels that a part of a cut reads ([`Cut::part`]).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PartSurvey {
    /// Training images that show the part.
    pub images: usize,
    /// Pixels of their windows, in total.
    pub pixels: f64,
    /// Pixels of the largest window.
    pub largest: f64,
}

/// Size and content of a tile of a scene.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TileSurvey {
    /// Ground of the tile, metres of a local frame at its centre.
    pub area: Area,
    /// Images that show the tile.
    pub images: usize,
    /// Number of training images among them.
    pub training: usize,
    /// Share of the tile that at least two training images show, 0..1.
    pub covered: f64,
    /// Pixels of all windows, in total.
    pub pixels: f64,
    /// Pixels of the largest window.
    pub largest: f64,
}

impl<'a> Survey<'a> {
    /// Survey of an index, cut by `options`.
    ///
    /// # Errors
    /// Those of [`Cut::of`].
    pub fn of(index: &'a Index, options: &IngestOptions) -> Result<Self> {
        let mut warnings = index.warnings.clone();
        let cut = Cut::of(index, options, &mut warnings)?;
        let mut truth = index.truth.clone();
        truth::keep_if_here(&mut truth, &cut.frame, &cut.area, &mut Vec::new());
        let height_m = cut.frame.origin.height_m;
        let altitude_range_m = cut.altitude.limits_m();
        let (mut footprints, mut gsds, mut parallaxes) = (Vec::new(), Vec::new(), Vec::new());
        for (image, part) in placed(index, &cut).filter(|(_, part)| part.split == Split::Train) {
            footprints.push(footprint_of(image, &cut.frame, height_m)?);
            gsds.push(gsd_m(image, &part.window, &cut.frame, height_m)?);
            parallaxes.push(parallax(image, &cut.frame, altitude_range_m)?);
        }
        Ok(Self {
            footprints,
            altitude_range_m,
            widest_base_to_height: widest_base_to_height(&parallaxes),
            gsd_m: nominal_gsd_m(gsds),
            bands: index.images.first().map_or(0, |image| image.bands.kinds.len()),
            truth,
            warnings,
            index,
            cut,
        })
    }

    /// Pixels of all windows of the cut.
    pub fn pixels(&self) -> f64 {
        self.cut.images.iter().map(|part| pixels_of(&part.window)).sum()
    }

    /// Number of images, and of training images.
    pub fn images(&self) -> (usize, usize) {
        (self.cut.images.len(), self.cut.training().count())
    }

    /// Pixels of the training images that show a part of the ground, metres of the survey's frame.
    pub fn part(&self, part: &Area) -> PartSurvey {
        let mut found = PartSurvey::default();
        let training = placed(self.index, &self.cut).filter(|(_, cut)| cut.split == Split::Train);
        let windows = training.filter_map(|(image, _)| window_over(image, self.frame(), part, self.altitude_range_m));
        for pixels in windows.map(|window| pixels_of(&window)) {
            found.images += 1;
            found.pixels += pixels;
            found.largest = found.largest.max(pixels);
        }
        found
    }

    /// Pixels of the cut's largest window.
    pub fn largest_image(&self) -> f64 {
        let pixels = self.cut.images.iter().map(|part| pixels_of(&part.window));
        pixels.fold(0.0, f64::max)
    }

    /// ENU frame of the cut.
    pub fn frame(&self) -> &LocalFrame {
        &self.cut.frame
    }

    /// Ground of the cut, metres of its frame.
    pub fn area(&self) -> &Area {
        &self.cut.area
    }

    /// Local frame at the centre of a tile, the tile's ground in it, and the images that show the tile.
    fn shown(&self, wanted: &AreaRequest) -> Result<(LocalFrame, Area, Vec<Shown<'_>>)> {
        let frame = LocalFrame::new(wanted.place(self.frame().origin.height_m)?);
        let area = wanted.area(&frame)?;
        let shown = placed(self.index, &self.cut).filter_map(|(image, part)| {
            let window = window_over(image, &frame, &area, self.altitude_range_m)?;
            Some((image, part.split, window))
        });
        let shown = shown.collect();
        Ok((frame, area, shown))
    }

    /// Size and content of a tile; `None` where fewer than two training images show it.
    ///
    /// # Errors
    /// When the coordinates of the tile cannot be transformed.
    pub fn tile(&self, wanted: &AreaRequest) -> Result<Option<TileSurvey>> {
        let (_, area, seen) = self.shown(wanted)?;
        let covered = self.covered(&wanted.area(self.frame())?);
        let training = seen.iter().filter(|(_, split, _)| *split == Split::Train).count();
        if training < 2 || covered <= 0.0 {
            return Ok(None);
        }
        let pixels = || seen.iter().map(|(_, _, window)| pixels_of(window));
        Ok(Some(TileSurvey {
            area,
            images: seen.len(),
            training,
            covered,
            pixels: pixels().sum(),
            largest: pixels().fold(0.0, f64::max),
        }))
    }

    /// Residual of the pinhole cameras fitted to a tile, pixels: the largest of all images, or one beyond `most_px`, at
    /// which the search ends.
    ///
    /// # Errors
    /// When the coordinates of the tile cannot be transformed, or a camera does not see it.
    pub fn residual_px(&self, wanted: &AreaRequest, most_px: f64) -> Result<f64> {
        let (frame, _, shown) = self.shown(wanted)?;
        let mut largest_px = 0.0;
        for some in shown.chunks(FITS_AT_ONCE) {
            let fits = some.par_iter();
            let fits = fits.map(|(image, _, window)| fit(image, window, &frame, self.altitude_range_m));
            for fit in fits.collect::<Vec<_>>() {
                largest_px = f64::max(largest_px, fit?.max_px);
            }
            if largest_px > most_px {
                break;
            }
        }
        Ok(largest_px)
    }

    /// Share of an area that at least two training images show, from a grid of sample points.
    fn covered(&self, area: &Area) -> f64 {
        const STEPS: usize = 24;
        let mut count = 0;
        for i in 0..STEPS * STEPS {
            let along = |low: f64, high: f64, index: usize| low + (high - low) * (index as f64 + 0.5) / STEPS as f64;
            let x = along(area.west_m, area.east_m, i % STEPS);
            let y = along(area.south_m, area.north_m, i / STEPS);
            let showing = self.footprints.iter().filter(|footprint| footprint.contains([x, y]));
            count += usize::from(showing.take(2).count() == 2);
        }
        count as f64 / (STEPS * STEPS) as f64
    }
}

/// Image that shows a tile, its split, and its window.
type Shown<'a> = (&'a IndexImage, Split, Window);

/// Images of a cut, each with its part of the cut.
fn placed<'a>(index: &'a Index, cut: &Cut) -> impl Iterator<Item = (&'a IndexImage, CutImage)> {
    let parts = cut.images.iter().copied();
    parts.filter_map(|part| Some((index.images.get(part.image)?, part)))
}

/// Displacement of the ground point of an image's centre per metre of altitude, metres east and north.
fn parallax(image: &IndexImage, frame: &LocalFrame, (low_m, high_m): (f64, f64)) -> Result<[f64; 2]> {
    let (width, height) = image.size;
    let at = |height_m| {
        let place = localise(image, width as f64 / 2.0, height as f64 / 2.0, height_m)?;
        Ok::<_, SceneError>(frame.enu_from_geo(place))
    };
    let apart = at(high_m)? - at(low_m)?;
    Ok([apart.x / apart.z, apart.y / apart.z])
}

fn widest_base_to_height(parallaxes: &[[f64; 2]]) -> f64 {
    let bases = |[x, y]: [f64; 2]| {
        let others = parallaxes.iter();
        others.map(move |[other_x, other_y]| (x - other_x).hypot(y - other_y))
    };
    parallaxes.iter().copied().flat_map(bases).fold(0.0, f64::max)
}
