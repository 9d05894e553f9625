//! The part of a delivery that is used: ground, altitudes, and the window of each image. No pixels are read.

use super::area::{AreaRequest, window_over};
use super::footprint::{self, Footprint};
use super::{AltitudeRange, Area, IngestOptions, Result, SceneError, Split};
use heliosplat::splat::rasterise::MOST_CHANNELS;
use heliosplat_delivery::{Index, IndexImage, bands_in_words};
use heliosplat_grid::statistics::upper_median;
use heliosplat_raster::Window;
use heliosplat_rpc::{GeoPoint, LocalFrame};
use nalgebra::Vector3;
use std::path::Path;

/// Share of an image's pixels below which only a window of it is read, where no area is requested.
const WORTH_READING_LESS: f64 = 0.75;
/// Least overlap, pixels along each side.
const LEAST_OVERLAP_PX: f64 = 16.0;
/// Largest number of bands of an image: the rasteriser also renders the sun visibility and a normal.
const MOST_BANDS: usize = MOST_CHANNELS - 1 - 3;

/// The part of an [`Index`] that is used.
#[derive(Debug, Clone, PartialEq)]
pub struct Cut {
    /// ENU frame. Its origin is the centre of the requested area, else of the ground that all training images show, at
    /// the middle of the altitude range.
    pub frame: LocalFrame,
    /// Altitudes that the surface may have, metres above the ellipsoid.
    pub altitude: AltitudeRange,
    /// Ground of the cut, metres of the frame.
    pub area: Area,
    /// Images of the cut, in the order of the index.
    pub images: Vec<CutImage>,
    /// True if the cut is a part of another cut; its images may then lack pixels.
    pub is_part: bool,
    /// Counts per unit of the pixels; `None` where it follows from the pixels.
    pub counts_per_unit: Option<f64>,
}

/// The part of one image that is used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutImage {
    /// Index of the image in `Index::images`.
    pub image: usize,
    /// Window that is read, pixels.
    pub window: Window,
    /// Train or test.
    pub split: Split,
}

/// Candidate image of a cut.
#[derive(Clone, Copy)]
struct Placed<'a> {
    at: usize,
    image: &'a IndexImage,
    window: Window,
}

impl Cut {
    /// Cuts an index to the altitudes and the area of `options`, or else to the altitudes and the common ground of the
    /// index.
    ///
    /// # Errors
    /// [`SceneError`] where bands differ, fewer than two images overlap or show the area, or the altitude range is
    /// empty.
    pub fn of(index: &Index, options: &IngestOptions, warnings: &mut Vec<String>) -> Result<Self> {
        check_bands(&index.images)?;
        let altitude = index.altitudes(options.altitude_range_m, options.altitude_from_ties_m, warnings)?;
        let limits_m = altitude.limits_m();
        let count = index.training().count();
        let placed = |(at, image)| Placed {
            at,
            image,
            window: whole(image),
        };
        let all: Vec<Placed> = index.images.iter().enumerate().map(placed).collect();
        let Some(first) = all.first().filter(|_| count >= 2) else {
            return Err(SceneError::TooFewViews(index.source.clone(), count));
        };
        let altitude_m = (limits_m.0 + limits_m.1) / 2.0;
        // Any frame near the scene suffices to find the centre.
        let (width, height) = first.image.size;
        let near = localise(first.image, width as f64 / 2.0, height as f64 / 2.0, altitude_m)?;
        let near = LocalFrame::new(near);
        let wanted = options.area.as_ref();
        let mut images = overlapping(all, &near, altitude_m, warnings)?;
        if wanted.is_none() {
            one_place(&images, &near, altitude_m)?;
        }
        let mut origin = match wanted {
            Some(wanted) => wanted.place(near.origin.height_m)?,
            None => middle_of(&training_footprints(&images, &near, altitude_m)?, &near),
        };
        origin.height_m = altitude_m;
        let frame = LocalFrame::new(origin);
        let footprints = training_footprints(&images, &frame, altitude_m)?;
        let least_m2 = least_overlap_m2(&images, &frame, altitude_m)?;
        let Some(mut area) = footprint::covered_twice(&footprints, least_m2) else {
            return Err(no_overlap(&images, altitude_m));
        };
        match wanted {
            Some(wanted) => {
                let Some(shared) = wanted.area(&frame)?.intersection(&area) else {
                    return Err(not_covered(&index.source, &wanted.to_string()));
                };
                area = shared;
                images.retain_mut(|placed| match window_over(placed.image, &frame, &area, limits_m) {
                    Some(window) => {
                        placed.window = window;
                        true
                    }
                    None => {
                        let path = placed.image.path.display();
                        warnings.push(format!("{path}: does not show the area, left out"));
                        false
                    }
                });
            }
            // Pixels outside of the ground are left out where they are a large part of an image.
            None => images.iter_mut().for_each(|placed| {
                if let Some(window) = window_over(placed.image, &frame, &area, limits_m)
                    && pixels_of(&window) < WORTH_READING_LESS * pixels_of(&placed.window)
                {
                    placed.window = window;
                }
            }),
        }
        let images = images.iter().map(|placed| CutImage {
            image: placed.at,
            window: placed.window,
            split: placed.image.split,
        });
        let cut = Self {
            frame,
            altitude,
            area,
            images: images.collect(),
            is_part: false,
            counts_per_unit: None,
        };
        let area = || wanted.map_or_else(|| cut.area.to_string(), AreaRequest::to_string);
        cut.must_be_shown_twice(&index.source, area)?;
        Ok(cut)
    }

    /// Part of the training images that shows a rectangle of the ground, metres of the frame.
    ///
    /// # Errors
    /// [`SceneError::NotCovered`] where fewer than two training images show it.
    pub fn part(&self, index: &Index, part: &Area) -> Result<Self> {
        let shown = self.training().filter_map(|placed| {
            let image = index.images.get(placed.image)?;
            let window = window_over(image, &self.frame, part, self.altitude.limits_m())?;
            Some(CutImage { window, ..*placed })
        });
        let cut = Self {
            area: *part,
            images: shown.collect(),
            is_part: true,
            ..self.clone()
        };
        cut.must_be_shown_twice(&index.source, || part.to_string())?;
        Ok(cut)
    }

    /// Images of the training split.
    pub fn training(&self) -> impl Iterator<Item = &CutImage> {
        self.images.iter().filter(|image| image.split == Split::Train)
    }

    /// Fails with [`SceneError::NotCovered`] for fewer than two training images.
    pub(super) fn must_be_shown_twice(&self, source: &Path, area: impl Fn() -> String) -> Result<()> {
        match self.training().count() {
            0 | 1 => Err(not_covered(source, &area())),
            _ => Ok(()),
        }
    }
}

/// Window of a whole image.
pub(super) fn whole(image: &IndexImage) -> Window {
    Window::whole(image.size)
}

/// Number of pixels of a window.
pub(super) fn pixels_of(window: &Window) -> f64 {
    window.width as f64 * window.height as f64
}

/// Ground point of a pixel at a height above the ellipsoid, metres.
pub(super) fn localise(image: &IndexImage, col: f64, row: f64, height_m: f64) -> Result<GeoPoint> {
    let ground = image.rpc.localise(heliosplat_rpc::ImagePoint { col, row }, height_m);
    ground.map_err(|source| camera_fault(image, height_m, source))
}

/// Error for a camera that does not work over its image.
pub(super) fn camera_fault(image: &IndexImage, height_m: f64, source: heliosplat_rpc::RpcError) -> SceneError {
    SceneError::Camera(image.path.clone(), height_m, source)
}

/// Outer corners of an image on the ground, metres of a local frame.
pub(super) fn footprint_of(image: &IndexImage, frame: &LocalFrame, height_m: f64) -> Result<Footprint> {
    let (width, height) = image.size;
    let (right, bottom) = (width as f64 - 0.5, height as f64 - 0.5);
    let corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)];
    let on_ground = |&(col, row): &(f64, f64)| {
        let enu = frame.enu_from_geo(localise(image, col, row, height_m)?);
        Ok([enu.x, enu.y])
    };
    let corners = corners.iter().map(on_ground).collect::<Result<_>>()?;
    Ok(Footprint::new(corners))
}

/// Ground sampling distance at the centre of a window: square root of the pixel's ground area, metres.
pub(super) fn gsd_m(image: &IndexImage, window: &Window, frame: &LocalFrame, height_m: f64) -> Result<f64> {
    let middle = |first: usize, count: usize| first as f64 + (count as f64 - 1.0) / 2.0;
    let (col, row) = (middle(window.col0, window.width), middle(window.row0, window.height));
    let ground = |col, row| Ok::<_, SceneError>(frame.enu_from_geo(localise(image, col, row, height_m)?));
    let centre = ground(col, row)?;
    let (along, down) = (ground(col + 1.0, row)? - centre, ground(col, row + 1.0)? - centre);
    Ok((along.x * down.y - along.y * down.x).abs().sqrt())
}

/// Refuses images of different bands, and more bands than a model renders.
fn check_bands(images: &[IndexImage]) -> Result<()> {
    let Some(first) = images.first() else {
        return Ok(());
    };
    let bands = first.bands.kinds.len();
    if bands > MOST_BANDS {
        return Err(SceneError::TooManyBands(first.path.clone(), bands, MOST_BANDS));
    }
    let Some(other) = images.iter().find(|image| image.bands.kinds != first.bands.kinds) else {
        return Ok(());
    };
    let [found, expected] = [other, first].map(|image| bands_in_words(&image.bands.kinds));
    let (other, first) = (other.path.clone(), first.path.clone());
    Err(SceneError::MixedBands(other, found, first, expected))
}

fn not_covered(source: &Path, area: &str) -> SceneError {
    SceneError::NotCovered(source.to_owned(), area.to_owned())
}

/// Error for images that share no ground; names the first and the last training image.
fn no_overlap(images: &[Placed], altitude_m: f64) -> SceneError {
    let training = images.iter().filter(|placed| placed.image.split == Split::Train);
    let mut paths = training.map(|placed| placed.image.path.clone());
    let first = paths.next().unwrap_or_default();
    let second = paths.next().unwrap_or_else(|| first.clone());
    SceneError::NoOverlap(first, second, altitude_m)
}

/// Least overlap of two footprints, square metres.
fn least_overlap_m2(images: &[Placed], frame: &LocalFrame, altitude_m: f64) -> Result<f64> {
    let gsd_m = |first: &Placed| gsd_m(first.image, &whole(first.image), frame, altitude_m);
    let first = images.first().map(gsd_m).transpose()?;
    Ok(LEAST_OVERLAP_PX.powi(2) * first.unwrap_or(0.0).powi(2))
}

/// Largest ratio of ground sampling distances within one kind of images.
const UNLIKE: f64 = 1.5;

/// Largest relative change of a ground sampling distance when it is rounded to one significant digit.
const ROUNDED: f64 = 0.05;

/// Median of `gsds` (metres, at least one), rounded to one significant digit where that changes it by little, else to
/// two: cells of 0.5 m coincide with those of other data, cells of 0.51 m do not.
///
/// A surface is matched from pairs, and a pair has the resolution of its coarser image: cells of a few finer images
/// would add no detail, and cells of the coarsest image would lose detail of most images. If the two middle values
/// differ, the finer one is used where at least two images have it.
pub(super) fn nominal_gsd_m(mut gsds: Vec<f64>) -> f64 {
    let upper = upper_median(&mut gsds).unwrap_or(f64::NAN);
    gsds.sort_by(f64::total_cmp);
    let lower = gsds.get(gsds.len().saturating_sub(1) / 2).copied().unwrap_or(upper);
    let median = match gsds.len() > 3 && upper > UNLIKE * lower {
        true => lower,
        false => upper,
    };
    // Multiples of an integer divisor are nearer to decimal numbers than multiples of a fraction.
    let in_digits = |digits: i32| {
        let per_unit = 10f64.powi(digits - 1 - median.log10().floor() as i32);
        (median * per_unit).round() / per_unit
    };
    let round = in_digits(1);
    match (round - median).abs() <= ROUNDED * median {
        true => round,
        false => in_digits(2),
    }
}

/// Corners of the training images on the ground.
fn training_footprints(images: &[Placed], frame: &LocalFrame, altitude_m: f64) -> Result<Vec<Footprint>> {
    let training = images.iter().filter(|placed| placed.image.split == Split::Train);
    let footprints = training.map(|placed| footprint_of(placed.image, frame, altitude_m));
    footprints.collect()
}

/// Middle of the ground that all training images show, or else of the ground that two show.
fn middle_of(footprints: &[Footprint], near: &LocalFrame) -> GeoPoint {
    let of_all = footprint::common(footprints).centre();
    let twice = footprint::covered_twice(footprints, 0.0);
    let of_two = twice.map(|area| [(area.west_m + area.east_m) / 2.0, (area.south_m + area.north_m) / 2.0]);
    let centre = of_all.or(of_two).unwrap_or_default();
    near.geo_from_enu(Vector3::new(centre[0], centre[1], 0.0))
}

/// Leaves out images that share no ground with a training image; fails for fewer than two remaining training images.
fn overlapping<'a>(
    images: Vec<Placed<'a>>,
    frame: &LocalFrame,
    altitude_m: f64,
    warnings: &mut Vec<String>,
) -> Result<Vec<Placed<'a>>> {
    let all = images.iter();
    let footprints = all.map(|placed| footprint_of(placed.image, frame, altitude_m));
    let footprints = footprints.collect::<Result<Vec<_>, _>>()?;
    let least_m2 = least_overlap_m2(&images, frame, altitude_m)?;
    let is_training = |index: usize| images[index].image.split == Split::Train;
    let overlaps: Vec<bool> = (0..images.len())
        .map(|index| {
            (0..images.len()).any(|other| {
                let shared = || footprints[index].intersection(&footprints[other]).area_m2();
                other != index && is_training(other) && shared() >= least_m2
            })
        })
        .collect();
    let remaining = (0..images.len()).filter(|&index| is_training(index) && overlaps[index]);
    if remaining.count() < 2 {
        return Err(no_overlap(&images, altitude_m));
    }
    let mut kept = Vec::with_capacity(images.len());
    for (placed, overlaps) in images.into_iter().zip(overlaps) {
        if overlaps {
            kept.push(placed);
        } else {
            let path = placed.image.path.display();
            warnings.push(format!("{path}: overlaps no other training image, left out"));
        }
    }
    Ok(kept)
}

/// Distance between two images beside which their own ground is small, in sides of an image.
const ANOTHER_PLACE: f64 = 3.0;

/// Refuses images of two places: those of the first image, and others far from all of them. The ground of all images
/// would be empty but for a small part.
fn one_place(images: &[Placed], frame: &LocalFrame, altitude_m: f64) -> Result<()> {
    let mut others = Vec::with_capacity(images.len());
    for placed in images {
        let footprint = footprint_of(placed.image, frame, altitude_m)?;
        others.push((
            placed,
            footprint.centre().unwrap_or_default(),
            footprint.area_m2().sqrt(),
        ));
    }
    let mut reached = Vec::from_iter((!others.is_empty()).then(|| others.remove(0)));
    let mut next = 0;
    while let Some(&(_, at, side_m)) = reached.get(next) {
        let is_near = |other: &(_, [f64; 2], f64)| {
            (other.1[0] - at[0]).hypot(other.1[1] - at[1]) < ANOTHER_PLACE * side_m.max(other.2)
        };
        let (near, far) = others.into_iter().partition(is_near);
        reached.extend::<Vec<_>>(near);
        others = far;
        next += 1;
    }
    let (Some(&(first, at, _)), Some(&(second, other, _))) = (reached.first(), others.first()) else {
        return Ok(());
    };
    let apart_km = (other[0] - at[0]).hypot(other[1] - at[1]) / 1000.0;
    let [first, second] = [first, second].map(|placed| placed.image.path.clone());
    Err(SceneError::OtherPlace(second, first, apart_km))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_as_wide_as_people_say() {
        assert_eq!(nominal_gsd_m(vec![0.62, 0.504_142, 0.49]), 0.5);
        assert_eq!(nominal_gsd_m(vec![0.509]), 0.5);
        assert_eq!(nominal_gsd_m(vec![0.309]), 0.3);
        assert_eq!(nominal_gsd_m(vec![0.332]), 0.33);
        assert_eq!(nominal_gsd_m(vec![0.0996]), 0.1);
        assert_eq!(nominal_gsd_m(vec![1.94, 2.06]), 2.0);
        assert_eq!(nominal_gsd_m(vec![12.4]), 12.0);
    }

    #[test]
    fn cells_are_what_half_of_the_images_resolve() {
        assert_eq!(nominal_gsd_m(vec![0.5, 1.0, 0.5, 1.0]), 0.5);
        assert_eq!(nominal_gsd_m(vec![0.3, 2.0, 2.0]), 2.0);
        assert_eq!(nominal_gsd_m(vec![0.3, 2.0, 0.3]), 0.3);
        // A single fine image does not determine a surface.
        assert_eq!(nominal_gsd_m(vec![0.3, 2.0]), 2.0);
        // An oblique image is of the same kind as the others.
        assert_eq!(nominal_gsd_m(vec![0.5, 0.5, 0.6, 0.6]), 0.6);
    }
}
