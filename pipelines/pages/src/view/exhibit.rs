//! Content of a page, as rasters on one grid.

use super::layer::Layer;
use heliosplat::Raster;
use heliosplat_products::model::ModelFile;
use heliosplat_radiometry::daylight::Daylight;
use heliosplat_raster::GridSpec;
use heliosplat_rpc::sun::SunPosition;
use heliosplat_scene::BandKind;
use serde::Serialize;
use std::borrow::Cow;

/// Most cells of a page.
pub(super) const CELLS_MAX: usize = 1024 * 1024;
/// Skylight where no model says one: a clear sky gives a fifth to a third of the light of a high sun.
const SKYLIGHT: f32 = 0.25;
/// Elevations of the sun at which a page has the light of day, degrees; close together where air mass changes fast.
const ELEVATIONS_DEG: [f64; 12] = [1.0, 3.0, 5.0, 8.0, 12.0, 17.0, 24.0, 32.0, 42.0, 55.0, 70.0, 90.0];

/// Content of a page. All rasters have the size of the grid.
#[derive(Debug, Clone)]
pub struct Exhibit {
    /// Title of the page.
    pub title: String,
    /// Grid of the cells.
    pub grid: GridSpec,
    /// Metres per cell.
    pub gsd_m: f64,
    /// Altitudes, metres; NaN where unknown.
    pub altitude: Raster,
    /// Vertical datum of the altitudes; empty if unknown.
    pub vertical_datum: String,
    /// Albedo, one band or red, green and blue, linear; NaN where unknown.
    pub albedo: Option<Raster>,
    /// The light.
    pub light: LightTable,
    /// True if the albedo holds the shadows of the images, whose suns were unknown.
    pub old_shadows: bool,
    /// The dates of the images.
    pub dates: Vec<TracedDate>,
    /// Other maps.
    pub layers: Vec<Layer>,
}

/// A date of a run, its sun, and the shadows that the model has for it.
#[derive(Debug, Clone)]
pub struct TracedDate {
    /// Its name.
    pub name: String,
    /// When its image was taken, where that is known.
    pub time: Option<jiff::Timestamp>,
    /// Its sun.
    pub sun: SunPosition,
    /// Shadows traced through the model: 1 in shadow, 0 in the sun, NaN where unknown; `None` where there are none.
    pub shadows: Option<Raster>,
}

/// Light by the elevation of the sun: a surface has the colour `albedo * (shade + sun * visible)`, with the share `visible` of the sun's disc
/// that it sees. Between the elevations of the table light is linear, beyond its ends constant.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LightTable {
    /// Elevations of the sun, degrees, rising; at least one.
    pub elevation_deg: Vec<f64>,
    /// Light of the whole sun, per band shown.
    pub sun: Vec<[f32; 3]>,
    /// Light in shadow, per band shown.
    pub shade: Vec<[f32; 3]>,
}

impl LightTable {
    /// Skylight of this share of the light of the open sun, the same under every sun: `L = S + (1 - S) sky`, as the model has it.
    pub fn of_sky(sky: [f32; 3]) -> Self {
        Self {
            elevation_deg: vec![90.0],
            sun: vec![sky.map(|share| 1.0 - share)],
            shade: vec![sky],
        }
    }

    /// Light where no model says any.
    pub fn usual() -> Self {
        Self::of_sky([SKYLIGHT; 3])
    }

    /// The light of day of a model on the bands that are shown, beside that of its reference image.
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

    /// The light of a model: that of day where it knows one; else that of its reference image, whose sky per band of the reference image is `sky`.
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

/// The bands that are shown as red, green and blue: those, or the first three, or the first alone.
pub(super) fn shown(bands: &[BandKind]) -> [usize; 3] {
    let place = |kind: BandKind| bands.iter().position(|&band| band == kind);
    match (place(BandKind::Red), place(BandKind::Green), place(BandKind::Blue)) {
        (Some(red), Some(green), Some(blue)) => [red, green, blue],
        _ if bands.len() >= 3 => [0, 1, 2],
        _ => [0; 3],
    }
}

/// The bands of a raster that are shown, as three planes.
pub(super) fn coloured(raster: &Raster, bands: [usize; 3]) -> Raster {
    Raster {
        width: raster.width,
        height: raster.height,
        bands: 3,
        values: bands.iter().flat_map(|&band| raster.plane(band)).copied().collect(),
    }
}

impl Exhibit {
    /// The exhibit with cells averaged until there are at most 1024².
    #[must_use]
    pub fn reduced(&self) -> Cow<'_, Self> {
        let cells = self.grid.width * self.grid.height;
        let factor = ((cells as f64 / CELLS_MAX as f64).sqrt().ceil() as usize).max(1);
        if factor == 1 {
            return Cow::Borrowed(self);
        }
        let smaller = |raster: &Raster| averaged(raster, factor);
        let altitude = smaller(&self.altitude);
        // A coarse cell's middle lies between those of the cells that it replaces.
        let mut grid = self.grid.part((0, 0), (altitude.width, altitude.height));
        let middle = (factor - 1) as f64 / 2.0;
        grid.transform.origin = self.grid.transform.map_from_pixel(middle, middle);
        grid.transform.per_col = grid.transform.per_col.map(|step| step * factor as f64);
        grid.transform.per_row = grid.transform.per_row.map(|step| step * factor as f64);
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

/// Means of what is known in blocks of `factor` x `factor` cells; NaN where nothing is.
pub(super) fn averaged(raster: &Raster, factor: usize) -> Raster {
    let (width, height) = (raster.width.div_ceil(factor), raster.height.div_ceil(factor));
    let mut out = Raster::filled(width, height, raster.bands, f32::NAN);
    for band in 0..raster.bands {
        for row in 0..height {
            for col in 0..width {
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
                    out.values[(band * height + row) * width + col] = (sum / f64::from(count)) as f32;
                }
            }
        }
    }
    out
}
