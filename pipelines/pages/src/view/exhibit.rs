//! Content of a page, as rasters on one grid.

use super::layer::Layer;
use heliosplat::Raster;
use heliosplat_products::export::shown;
use heliosplat_products::model::ModelFile;
use heliosplat_radiometry::daylight::Daylight;
use heliosplat_raster::GridSpec;
use heliosplat_rpc::sun::SunPosition;
use serde::Serialize;
use std::borrow::Cow;

/// Largest number of cells of a page.
pub(super) const CELLS_MAX: usize = 1024 * 1024;
/// Share of skylight without a model: a clear sky gives a fifth to a third of the light of a high sun.
const SKYLIGHT: f32 = 0.25;
/// Elevations of the sun at which daylight is tabulated, degrees; denser at low suns, where air mass changes fast.
const ELEVATIONS_DEG: [f64; 12] = [1.0, 3.0, 5.0, 8.0, 12.0, 17.0, 24.0, 32.0, 42.0, 55.0, 70.0, 90.0];

/// Content of a page. All rasters have the size of the grid.
#[derive(Debug, Clone)]
pub struct Exhibit {
    /// Title of the page.
    pub title: String,
    /// Grid of the cells.
    pub grid: GridSpec,
    /// Width of a cell, metres.
    pub gsd_m: f64,
    /// Altitudes, metres; NaN where unknown.
    pub altitude: Raster,
    /// Vertical datum of the altitudes; empty if unknown.
    pub vertical_datum: String,
    /// Albedo, one band or red, green and blue, linear; NaN where unknown.
    pub albedo: Option<Raster>,
    /// Light by the elevation of the sun.
    pub light: LightTable,
    /// True if the albedo still contains the shadows of the images, because their suns were unknown.
    pub old_shadows: bool,
    /// Dates of the images.
    pub dates: Vec<TracedDate>,
    /// Further maps.
    pub layers: Vec<Layer>,
}

/// Date of a run or mosaic with its sun and traced shadows.
#[derive(Debug, Clone)]
pub struct TracedDate {
    /// Name: the day, such as `2016-05-01`, or the direction of the sun if the time is unknown.
    pub name: String,
    /// Time of an image of the date, if known.
    pub time: Option<jiff::Timestamp>,
    /// Direction of the sun.
    pub sun: SunPosition,
    /// Shadows traced through the model: 1 in shadow, 0 in the sun, NaN where unknown; `None` if not traced.
    pub shadows: Option<Raster>,
}

/// Light by the elevation of the sun. A surface has the colour `albedo * (shade + sun * visibility)`, with the visible
/// share `visibility` of the sun's disc. Light is interpolated linearly between the elevations, and constant beyond.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LightTable {
    /// Elevations of the sun, degrees, rising; at least one.
    pub elevation_deg: Vec<f64>,
    /// Light of the unoccluded sun, for each elevation and band shown.
    pub sun: Vec<[f32; 3]>,
    /// Light in shadow, for each elevation and band shown.
    pub shade: Vec<[f32; 3]>,
}

impl LightTable {
    /// Light `L = S + (1 - S) sky` of the model at every elevation, with visibility `S`; `sky` is the share of skylight
    /// in full light, per band, 0 to 1.
    pub fn of_sky(sky: [f32; 3]) -> Self {
        Self {
            elevation_deg: vec![90.0],
            sun: vec![sky.map(|share| 1.0 - share)],
            shade: vec![sky],
        }
    }

    /// Light without a model: a quarter of skylight.
    pub fn usual() -> Self {
        Self::of_sky([SKYLIGHT; 3])
    }

    /// Daylight of a model in the bands that are shown, relative to the light of its reference image.
    fn of_daylight(daylight: &Daylight, bands: [usize; 3]) -> Self {
        let elevation_deg: Vec<f64> = ELEVATIONS_DEG.to_vec();
        let at = |light: &dyn Fn(usize, f64) -> f64| {
            let of_sun = |deg: &f64| bands.map(|band| light(band, deg.to_radians()) as f32);
            elevation_deg.iter().map(of_sun).collect()
        };
        Self {
            sun: at(&|band, e| daylight.gain(band, e) * (1.0 - daylight.shade(band, e))),
            shade: at(&|band, e| daylight.gain(band, e) * daylight.shade(band, e)),
            elevation_deg,
        }
    }

    /// Light of a model: its daylight if fitted, else the light of its reference image with the skylight `sky` per
    /// band; [`Self::usual`] for a model without light.
    pub fn of_model(file: &ModelFile, sky: &[f32]) -> Self {
        if !file.has_light() {
            return Self::usual();
        }
        let bands = shown(&file.bands);
        if let Some(daylight) = &file.daylight {
            return Self::of_daylight(daylight, bands);
        }
        Self::of_sky(bands.map(|band| sky.get(band).copied().unwrap_or(SKYLIGHT)))
    }
}

/// Raster of the three bands that are shown.
pub(super) fn coloured(raster: &Raster, bands: [usize; 3]) -> Raster {
    Raster {
        width: raster.width,
        height: raster.height,
        bands: 3,
        values: bands.iter().flat_map(|&band| raster.plane(band)).copied().collect(),
    }
}

impl Exhibit {
    /// Exhibit with blocks of cells averaged, so that at most 1024² remain.
    #[must_use]
    pub fn reduced(&self) -> Cow<'_, Self> {
        let cells = self.grid.width * self.grid.height;
        let factor = ((cells as f64 / CELLS_MAX as f64).sqrt().ceil() as usize).max(1);
        if factor == 1 {
            return Cow::Borrowed(self);
        }
        let smaller = |raster: &Raster| averaged(raster, factor);
        let altitude = smaller(&self.altitude);
        let grid = self.grid.reduced(factor);
        let date = |date: &TracedDate| TracedDate {
            name: date.name.clone(),
            shadows: date.shadows.as_ref().map(smaller),
            ..*date
        };
        let layer = |layer: &Layer| Layer {
            id: layer.id.clone(),
            name: layer.name.clone(),
            values: smaller(&layer.values),
            ..*layer
        };
        Cow::Owned(Self {
            title: self.title.clone(),
            grid,
            gsd_m: self.gsd_m * factor as f64,
            altitude,
            vertical_datum: self.vertical_datum.clone(),
            albedo: self.albedo.as_ref().map(smaller),
            light: self.light.clone(),
            old_shadows: self.old_shadows,
            dates: self.dates.iter().map(date).collect(),
            layers: self.layers.iter().map(layer).collect(),
        })
    }
}

/// Means of the known values in blocks of `factor` x `factor` cells; NaN for blocks without any.
pub(super) fn averaged(raster: &Raster, factor: usize) -> Raster {
    let (width, height) = (raster.width.div_ceil(factor), raster.height.div_ceil(factor));
    Raster::from_fn(width, height, raster.bands, |band, col, row| {
        let rows = row * factor..((row + 1) * factor).min(raster.height);
        let (mut sum, mut count) = (0.0f64, 0u32);
        for r in rows {
            for c in col * factor..((col + 1) * factor).min(raster.width) {
                let value = raster.at(band, c, r);
                if value.is_finite() {
                    (sum, count) = (sum + f64::from(value), count + 1);
                }
            }
        }
        if count > 0 {
            (sum / f64::from(count)) as f32
        } else {
            f32::NAN
        }
    })
}
