//! Training images of a scene with unknown altitude range: their cameras, the ground that two of them may share, and
//! downscaled pixels, which suffice to estimate the altitudes of the surface.

use super::area::{READ_PX, window_around};
use super::cut::{footprint_of, gsd_m, localise, whole};
use super::footprint::Footprint;
use super::{AltitudeRange, IngestOptions, Result, SceneError};
use heliosplat::Raster;
use heliosplat_delivery::{Index, IndexImage};
use heliosplat_raster::Window;
use heliosplat_rpc::{LocalFrame, Rpc};
use nalgebra::{Vector2, Vector3};

/// Number of altitudes at which the shared ground of two images is computed.
const ALTITUDES: usize = 33;

/// Training images of an index, with their cameras.
pub struct SceneCameras<'a> {
    images: Vec<&'a IndexImage>,
    /// A frame near the scene.
    frame: LocalFrame,
    /// Corners of the requested area in that frame, metres.
    wanted: Option<Footprint>,
    /// Range of altitudes used without tie points, metres above the ellipsoid.
    pub range: AltitudeRange,
}

impl<'a> SceneCameras<'a> {
    /// The cameras of an index.
    ///
    /// # Errors
    /// Those of [`super::Cut::of`].
    pub fn new(index: &'a Index, options: &IngestOptions) -> Result<Self> {
        let range = index.altitudes(options.altitude_range_m, None, &mut Vec::new())?;
        let images: Vec<&IndexImage> = index.training().collect();
        let Some(first) = images.first() else {
            return Err(SceneError::TooFewViews(index.source.clone(), 0));
        };
        let middle_m = 0.5 * (range.low_m + range.high_m);
        let (width, height) = first.size;
        let origin = match &options.area {
            Some(wanted) => wanted.place(middle_m)?,
            None => localise(first, width as f64 / 2.0, height as f64 / 2.0, middle_m)?,
        };
        let frame = LocalFrame::new(origin);
        let wanted = options.area.as_ref().map(|wanted| wanted.area(&frame)).transpose()?;
        let wanted = wanted.map(|a| {
            Footprint::new(vec![
                [a.west_m, a.south_m],
                [a.east_m, a.south_m],
                [a.east_m, a.north_m],
                [a.west_m, a.north_m],
            ])
        });
        Ok(Self {
            images,
            frame,
            wanted,
            range,
        })
    }

    /// Number of images.
    pub fn count(&self) -> usize {
        self.images.len()
    }

    /// Rational camera of an image, in pixels of its file.
    pub fn rpc(&self, image: usize) -> &Rpc {
        &self.images[image].rpc
    }

    /// True if both images have a time, on one UTC day.
    pub fn same_day(&self, first: usize, second: usize) -> bool {
        let day = |image: usize| {
            let time = self.images[image].acquisition.time;
            time.map(|time| time.as_second().div_euclid(86_400))
        };
        day(first).is_some() && day(first) == day(second)
    }

    /// Ground sampling distance at an image's centre and an altitude (metres above the ellipsoid), metres.
    ///
    /// # Errors
    /// When the camera does not see that altitude.
    pub fn gsd_m(&self, image: usize, altitude_m: f64) -> Result<f64> {
        let image = self.images[image];
        gsd_m(image, &whole(image), &self.frame, altitude_m)
    }

    /// Displacement of the ground point of an image's centre per metre of altitude, metres east and north, between two
    /// altitudes (metres above the ellipsoid).
    ///
    /// # Errors
    /// When the camera does not reach one of the altitudes.
    pub fn parallax(&self, image: usize, (low_m, high_m): (f64, f64)) -> Result<[f64; 2]> {
        let image = self.images[image];
        let (width, height) = image.size;
        let at = |height_m| {
            let place = localise(image, width as f64 / 2.0, height as f64 / 2.0, height_m)?;
            Ok::<_, SceneError>(self.frame.enu_from_geo(place))
        };
        let moved: Vector2<f64> = (at(high_m)? - at(low_m)?).xy() / (high_m - low_m);
        Ok(moved.into())
    }

    /// Windows of two images that show common ground at some altitude of a range (metres above the ellipsoid), with a
    /// margin; `None` where there is none.
    ///
    /// # Errors
    /// When a camera does not reach one of the altitudes.
    pub fn shared_windows(
        &self,
        first: usize,
        second: usize,
        (low_m, high_m): (f64, f64),
    ) -> Result<Option<[Window; 2]>> {
        let pair = [self.images[first], self.images[second]];
        let mut places = [Vec::new(), Vec::new()];
        for step in 0..ALTITUDES {
            let altitude_m = low_m + (high_m - low_m) * step as f64 / (ALTITUDES - 1) as f64;
            let footprint = |image: &IndexImage| footprint_of(image, &self.frame, altitude_m);
            let mut shared = footprint(pair[0])?.intersection(&footprint(pair[1])?);
            if let Some(wanted) = &self.wanted {
                shared = shared.intersection(wanted);
            }
            for &[east_m, north_m] in shared.corners() {
                let up_m = altitude_m - self.frame.origin.height_m;
                let place = self.frame.geo_from_enu(Vector3::new(east_m, north_m, up_m));
                for (image, places) in pair.iter().zip(&mut places) {
                    let at = image.rpc.project(place);
                    places.push([at.col, at.row]);
                }
            }
        }
        let [first_places, second_places] = places;
        let window = window_around(first_places, pair[0].size, READ_PX);
        let windows = window.zip(window_around(second_places, pair[1].size, READ_PX));
        Ok(windows.map(|(a, b)| [a, b]))
    }

    /// Mean of the bands of a window of an image, averaged down by `factor` along each axis; `NaN` for pixels without
    /// data and those that a mask beside the image states to be unusable.
    ///
    /// # Errors
    /// When the pixels or the mask cannot be read.
    pub fn read_reduced(&self, image: usize, window: Window, factor: usize) -> Result<Raster> {
        let image = self.images[image];
        let raster = image.file().read_reduced(window, factor, &image.bands.file_bands)?;
        let plane = raster.plane_len();
        let mut mean = Raster::filled(raster.width, raster.height, 1, 0.0);
        for values in raster.values.chunks_exact(plane.max(1)) {
            for (sum, value) in mean.values.iter_mut().zip(values) {
                *sum += value / raster.bands as f32;
            }
        }
        super::pixels::blank_unusable(&mut mean, image, (window, factor), &mut Vec::new())?;
        Ok(mean)
    }
}
