//! The truth rasters as files.

use crate::error::SynthError;
use crate::materials::Class;
use crate::nadir::NadirSensor;
use crate::radiometry::LitScene;
use crate::relit::{self, Studio};
use crate::request::{Fault, SatelliteRequest};
use crate::truth::Truth;
use crate::truth_grid::TruthGrid;
use crate::write::Staging;
use crate::write::geotiff::{Raster, Samples, write};

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
    /// Grid of the rasters.
    pub(crate) grid: &'a TruthGrid,
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
        let owned = items
            .iter()
            .map(|(key, value)| ((*key).to_string(), (*value).to_string()));
        let raster = Raster {
            width: self.grid.size,
            height: self.grid.size,
            samples,
            bands,
            items: &owned.collect::<Vec<_>>(),
            rpc: None,
            grid: Some(self.grid),
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
    pub(crate) fn write(&self, request: &SatelliteRequest, truth: &Truth) -> Result<(), SynthError> {
        let altitudes_m = marked(&truth.altitude_m);
        let about = "highest surface at the centre of each cell, without cars";
        self.put_altitudes("dsm", &altitudes_m, about)?;
        let about = "ground at the centre of each cell, without all that stands on it";
        self.put_altitudes("dtm", &truth.ground_m, about)?;
        let codes = Class::NAMES
            .iter()
            .map(|(class, name)| ((*class as u8).to_string(), *name));
        let codes: Vec<(String, &str)> = codes.collect();
        let items: Vec<(&str, &str)> = codes.iter().map(|(code, name)| (code.as_str(), *name)).collect();
        self.put("classes", Samples::U8(&truth.class), &["class"], &items, None)?;
        let about = "mean albedo of the highest surface in each cell, in the reference season, without cars";
        let items = [("DESCRIPTION", about)];
        self.put(
            "albedo",
            Samples::F32(&truth.albedo),
            request.bands.names(),
            &items,
            None,
        )?;
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
        let (west_m, size, cell_m) = (self.grid.west_m, self.grid.size, self.grid.cell_m);
        let south_m = self.grid.north_m - size as f64 * cell_m;
        self.staging
            .text("truth/dsm.txt", &format!("{west_m}\n{south_m}\n{size}\n{cell_m}\n"))
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
                [
                    f64::from(if difference_m.is_nan() { NODATA } else { difference_m }),
                    *day,
                ]
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
        request: &SatelliteRequest,
        (scene, sensor): (&LitScene, &NadirSensor),
        studio: &Studio,
        suns_deg: &[[f64; 2]],
        rows_done: &mut dyn FnMut(usize),
    ) -> Result<(), SynthError> {
        for (number, &sun_deg) in suns_deg.iter().enumerate() {
            let image = relit::relit(request, scene, sensor, studio, sun_deg, rows_done);
            let [azimuth, elevation] = sun_deg.map(|angle| angle.to_string());
            let sun = [("SUN_AZIMUTH", azimuth.as_str()), ("SUN_ELEVATION", elevation.as_str())];
            let about = "the site from straight above under a sun of no image: linear counts at the gain of the image with the highest sun, no cars, no noise";
            let (bands, items) = (request.bands.names(), [("DESCRIPTION", about), sun[0], sun[1]]);
            self.put(
                &format!("relit_{number}"),
                Samples::U16(&image.counts),
                bands,
                &items,
                None,
            )?;
            let (name, items) = (
                format!("relit_{number}_shadow"),
                [("DESCRIPTION", SHADOW_MEANS), sun[0], sun[1]],
            );
            self.put(&name, Samples::U8(&image.shadow), &["shadow"], &items, None)?;
        }
        let list = suns_deg
            .iter()
            .map(|sun| serde_json::json!({"sun_azimuth_deg": sun[0], "sun_elevation_deg": sun[1]}));
        let list = serde_json::Value::from(list.collect::<Vec<_>>());
        self.staging.text("truth/relit.json", &format!("{list:#}\n"))?;
        let hours = marked(&relit::sun_hours(scene, &sensor.frame, self.grid));
        let about = "hours of direct sun on the highest surface at the centre of each cell, without cars, between two midnights of mean solar time";
        let items = [("DESCRIPTION", about), ("DATE", relit::DAY)];
        self.put("sun_hours", Samples::F32(&hours), &["sun_hours"], &items, Some(NODATA))
    }
}
