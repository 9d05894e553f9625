//! The truth rasters as files.

use crate::error::SynthError;
use crate::materials::Class;
use crate::nadir::NadirSensor;
use crate::radiometry::LitScene;
use crate::relit;
use crate::request::{Fault, SatelliteRequest};
use crate::studio::Studio;
use crate::truth::Truth;
use crate::write::Staging;
use crate::write::geotiff::{Raster, Samples, write};
use serde_json::{Value, json};

/// Value of unknown samples. Not every tool reads NaN.
const NODATA: f32 = -9999.0;
/// Description in the files of shadow masks.
pub(crate) const SHADOW_MEANS: &str =
    "1 where the sun reaches less than half of the pixel: cast shadow, and surfaces that face away from it";
/// Metadata item of altitudes.
const DATUM: (&str, &str) = ("VERTICAL_DATUM", "WGS84 ellipsoid, metres");

/// The folder of the truth, whose rasters lie on one grid.
pub(crate) struct TruthFolder<'a> {
    /// Folder of the scene.
    pub(crate) staging: &'a Staging,
    /// Request of the scene.
    pub(crate) request: &'a SatelliteRequest,
    /// Camera over the grid of the rasters.
    pub(crate) nadir: &'a NadirSensor,
}

/// Copy of the values with NaN replaced by [`NODATA`].
fn marked<'a>(values: impl IntoIterator<Item = &'a f32>) -> Vec<f32> {
    let mark = |value: &f32| if value.is_nan() { NODATA } else { *value };
    values.into_iter().map(mark).collect()
}

impl TruthFolder<'_> {
    /// Writes a raster with its metadata items.
    fn put(
        &self,
        name: &str,
        samples: Samples,
        bands: &[&str],
        items: &[(&str, &str)],
        nodata: Option<f32>,
    ) -> Result<(), SynthError> {
        let grid = &self.nadir.grid;
        let raster = Raster {
            width: grid.size,
            height: grid.size,
            samples,
            bands,
            items,
            rpc: None,
            grid: Some(grid),
            nodata,
            canvas: None,
        };
        write(&self.staging.path(&format!("truth/{name}.tif"))?, &raster)
    }

    /// Writes altitudes, metres above the ellipsoid.
    fn put_altitudes(&self, name: &str, altitudes_m: &[f32], about: &str) -> Result<(), SynthError> {
        let items = [("DESCRIPTION", about), DATUM];
        self.put(name, Samples::F32(altitudes_m), &["altitude"], &items, Some(NODATA))
    }

    /// Writes a mask.
    fn put_mask(&self, name: &str, mask: &[u8], about: &str) -> Result<(), SynthError> {
        self.put(name, Samples::U8(mask), &[name], &[("DESCRIPTION", about)], None)
    }

    /// Writes altitudes, classes and albedo, and on request cover and gloss.
    ///
    /// # Errors
    /// `SynthError::Failed` when a file cannot be written.
    pub(crate) fn write(&self, truth: &Truth) -> Result<(), SynthError> {
        let request = self.request;
        let altitudes_m = marked(&truth.altitude_m);
        let about = "highest surface at the centre of each cell, without cars";
        self.put_altitudes("dsm", &altitudes_m, about)?;
        let about = "ground at the centre of each cell, without all that stands on it";
        self.put_altitudes("dtm", &truth.ground_m, about)?;
        let codes = Class::NAMES.map(|(class, _)| (class as u8).to_string());
        let names = Class::NAMES.iter().map(|(_, name)| *name);
        let items: Vec<(&str, &str)> = codes.iter().map(String::as_str).zip(names).collect();
        self.put("classes", Samples::U8(&truth.class), &["class"], &items, None)?;
        let about = "mean albedo of the highest surface in each cell, in the reference season, without cars";
        let (bands, items) = (request.bands.names(), [("DESCRIPTION", about)]);
        self.put("albedo", Samples::F32(&truth.albedo), bands, &items, None)?;
        if request.cover.is_some() {
            self.put_mask("cover", &truth.cover, "1 under sea or snow")?;
            let bare = altitudes_m.iter().zip(&truth.bare);
            let bare: Vec<f32> = bare.map(|(&m, &bare)| if bare { m } else { NODATA }).collect();
            let about = "dsm.tif more than 4 m outside of sea and snow, nodata elsewhere";
            self.put_altitudes("dsm_uncovered", &bare, about)?;
        }
        if request.has(Fault::Glossy) {
            let about = "1 where the highest surface is not Lambertian: metal, membranes, solar panels";
            self.put_mask("glossy", &truth.glossy, about)?;
        }
        let grid = &self.nadir.grid;
        let (west_m, size, cell_m) = (grid.west_m, grid.size, grid.cell_m);
        let south_m = grid.north_m - size as f64 * cell_m;
        let text = format!("{west_m}\n{south_m}\n{size}\n{cell_m}\n");
        self.staging.text("truth/dsm.txt", &text)
    }

    /// Writes the altitudes before the first change, their change until after the last, and for each cell the day from
    /// which the change shows (YYYYMMDD, 0 for none).
    ///
    /// # Errors
    /// `SynthError::Failed` when a file cannot be written.
    pub(crate) fn write_change(&self, [before, after]: [&Truth; 2], changed_at: &[f64]) -> Result<(), SynthError> {
        let about = "highest surface at the centre of each cell at the time of the first image, without cars; dsm.tif is that of the last";
        self.put_altitudes("dsm_before", &marked(&before.altitude_m), about)?;
        let cells = after.altitude_m.iter().zip(&before.altitude_m).zip(changed_at);
        let values: Vec<f64> = cells
            .flat_map(|((after, before), day)| {
                let difference_m = after - before;
                let known = !difference_m.is_nan();
                [f64::from(if known { difference_m } else { NODATA }), *day]
            })
            .collect();
        let about = "what was built or torn down between the first and the last image: difference_m, last minus first; changed_at, the day of the first image that shows the new state (YYYYMMDD), 0 where nothing changed";
        let (bands, items) = (["difference_m", "changed_at"], [("DESCRIPTION", about)]);
        self.put("change", Samples::F64(&values), &bands, &items, Some(NODATA))
    }

    /// Writes images from straight above under the suns `suns_deg` (azimuth, elevation), their shadows, and the hours
    /// of sun of one day. `rows_done` receives the number of rows of each finished batch.
    ///
    /// # Errors
    /// `SynthError::Failed` when a file cannot be written.
    pub(crate) fn write_relit(
        &self,
        scene: &LitScene,
        studio: &Studio,
        suns_deg: &[[f64; 2]],
        rows_done: &mut dyn FnMut(usize),
    ) -> Result<(), SynthError> {
        let bands = self.request.bands.names();
        for (number, &sun_deg) in suns_deg.iter().enumerate() {
            let image = relit::relit(self.request, scene, self.nadir, studio, sun_deg, rows_done);
            let [azimuth, elevation] = sun_deg.map(|angle| angle.to_string());
            let items = |about| {
                [
                    ("DESCRIPTION", about),
                    ("SUN_AZIMUTH", &*azimuth),
                    ("SUN_ELEVATION", &*elevation),
                ]
            };
            let about = "the site from straight above under a sun of no image: linear counts at the gain of the image with the highest sun, no cars, no noise";
            let name = format!("relit_{number}");
            self.put(&name, Samples::U16(&image.counts), bands, &items(about), None)?;
            let (name, items) = (format!("relit_{number}_shadow"), items(SHADOW_MEANS));
            self.put(&name, Samples::U8(&image.shadow), &["shadow"], &items, None)?;
        }
        let sun = |[azimuth, elevation]: &[f64; 2]| json!({"sun_azimuth_deg": azimuth, "sun_elevation_deg": elevation});
        let list: Value = suns_deg.iter().map(sun).collect();
        self.staging.text("truth/relit.json", &format!("{list:#}\n"))?;
        let hours = marked(&relit::sun_hours(scene, self.nadir));
        let about = "hours of direct sun on the highest surface at the centre of each cell, without cars, between two midnights of mean solar time";
        let items = [("DESCRIPTION", about), ("DATE", relit::DAY)];
        self.put("sun_hours", Samples::F32(&hours), &["sun_hours"], &items, Some(NODATA))
    }
}
