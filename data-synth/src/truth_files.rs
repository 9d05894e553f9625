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

/// NaN would do, but not every tool reads it.
const NODATA: f32 = -9999.0;
/// Description of the masks of shadows.
pub(crate) const SHADOW_MEANS: &str =
    "1 where the sun reaches less than half of the pixel: cast shadow, and surfaces that face away from it";

/// The metadata item that describes a raster.
fn about(text: &str) -> (String, String) {
    ("DESCRIPTION".to_string(), text.to_string())
}

fn on_grid<'a>(
    grid: &'a TruthGrid,
    samples: Samples<'a>,
    bands: &'a [&'a str],
    items: &'a [(String, String)],
    nodata: Option<f32>,
) -> Raster<'a> {
    Raster {
        width: grid.size,
        height: grid.size,
        samples,
        bands,
        items,
        rpc: None,
        grid: Some(grid),
        nodata,
    }
}

/// Altitude, classes and albedo from straight above, and on request cover and gloss.
pub(crate) fn write_truth(
    staging: &Staging,
    request: &SatelliteRequest,
    grid: &TruthGrid,
    truth: &Truth,
) -> Result<(), SynthError> {
    let datum = ("VERTICAL_DATUM".to_string(), "WGS84 ellipsoid, metres".to_string());
    let write_grid = |name: &str, samples: Samples, bands: &[&str], items: &[(String, String)], nodata| {
        write(&staging.path(name)?, &on_grid(grid, samples, bands, items, nodata))
    };
    let altitudes_m: Vec<f32> = truth
        .altitude_m
        .iter()
        .map(|m| if m.is_nan() { NODATA } else { *m })
        .collect();
    let dsm = [
        about("highest surface at the centre of each cell, without cars"),
        datum.clone(),
    ];
    write_grid(
        "truth/dsm.tif",
        Samples::F32(&altitudes_m),
        &["altitude"],
        &dsm,
        Some(NODATA),
    )?;
    let ground = [
        about("ground at the centre of each cell, without all that stands on it"),
        datum.clone(),
    ];
    write_grid(
        "truth/dtm.tif",
        Samples::F32(&truth.ground_m),
        &["altitude"],
        &ground,
        Some(NODATA),
    )?;
    let classes: Vec<_> = (Class::NAMES.iter())
        .map(|(class, name)| ((*class as u8).to_string(), name.to_string()))
        .collect();
    write_grid(
        "truth/classes.tif",
        Samples::U8(&truth.class),
        &["class"],
        &classes,
        None,
    )?;
    let albedo = [about(
        "mean albedo of the highest surface in each cell, in the reference season, without cars",
    )];
    write_grid(
        "truth/albedo.tif",
        Samples::F32(&truth.albedo),
        request.bands.names(),
        &albedo,
        None,
    )?;
    if request.cover.is_some() {
        let what = [about("1 under sea or snow")];
        write_grid("truth/cover.tif", Samples::U8(&truth.cover), &["cover"], &what, None)?;
        let bare: Vec<f32> = (altitudes_m.iter().zip(&truth.bare))
            .map(|(&altitude_m, &bare)| if bare { altitude_m } else { NODATA })
            .collect();
        let what = [
            about("dsm.tif more than 4 m outside of sea and snow, nodata elsewhere"),
            datum,
        ];
        let name = "truth/dsm_uncovered.tif";
        write_grid(name, Samples::F32(&bare), &["altitude"], &what, Some(NODATA))?;
    }
    if request.has(Fault::Glossy) {
        let what = [about(
            "1 where the highest surface is not Lambertian: metal, membranes, solar panels",
        )];
        write_grid("truth/glossy.tif", Samples::U8(&truth.glossy), &["glossy"], &what, None)?;
    }
    let [south_m, cell_m] = [grid.north_m - grid.size as f64 * grid.cell_m, grid.cell_m];
    let text = format!("{}\n{}\n{}\n{}\n", grid.west_m, south_m, grid.size, cell_m);
    staging.text("truth/dsm.txt", &text)
}

/// The surface at the first image, and its changes until the last: metres (last minus first), and the day (YYYYMMDD) of
/// the first image of the new state, 0 where nothing is built or torn down.
pub(crate) fn write_change(
    staging: &Staging,
    grid: &TruthGrid,
    [before, after]: [&Truth; 2],
    changed_at: &[f64],
) -> Result<(), SynthError> {
    let known = |m: f32| if m.is_nan() { NODATA } else { m };
    let altitudes_m: Vec<f32> = before.altitude_m.iter().map(|&m| known(m)).collect();
    let said = [
        about(
            "highest surface at the centre of each cell at the time of the first image, without cars; dsm.tif is that of the last",
        ),
        ("VERTICAL_DATUM".to_string(), "WGS84 ellipsoid, metres".to_string()),
    ];
    let dsm = on_grid(grid, Samples::F32(&altitudes_m), &["altitude"], &said, Some(NODATA));
    write(&staging.path("truth/dsm_before.tif")?, &dsm)?;
    let cells = after.altitude_m.iter().zip(&before.altitude_m).zip(changed_at);
    // A day as YYYYMMDD has more digits than 32 bits hold.
    let values: Vec<f64> = cells
        .flat_map(|((after, before), day)| {
            let difference_m = f64::from(after - before);
            let known_m = if difference_m.is_nan() {
                f64::from(NODATA)
            } else {
                difference_m
            };
            [known_m, *day]
        })
        .collect();
    let metadata = [about(
        "what was built or torn down between the first and the last image: difference_m, last minus first; changed_at, the day of the first image that shows the new state (YYYYMMDD), 0 where nothing changed",
    )];
    let bands = ["difference_m", "changed_at"];
    let change = on_grid(grid, Samples::F64(&values), &bands, &metadata, Some(NODATA));
    write(&staging.path("truth/change.tif")?, &change)
}

/// The site from straight above under some suns (azimuth and elevation, degrees), their shadows, and the hours of sun
/// of a day.
pub(crate) fn write_relit(
    staging: &Staging,
    request: &SatelliteRequest,
    (scene, sensor): (&LitScene, &NadirSensor),
    studio: &Studio,
    suns_deg: &[[f64; 2]],
    rows_done: &mut dyn FnMut(usize),
) -> Result<(), SynthError> {
    let grid = &sensor.grid;
    for (number, &sun_deg) in suns_deg.iter().enumerate() {
        let image = relit::relit(request, scene, sensor, studio, sun_deg, rows_done);
        let sun = [("SUN_AZIMUTH", sun_deg[0]), ("SUN_ELEVATION", sun_deg[1])];
        let items = |what: &str| {
            let sun = sun.iter().map(|(key, value)| ((*key).to_string(), value.to_string()));
            std::iter::once(about(what)).chain(sun).collect::<Vec<_>>()
        };
        let said = items(
            "the site from straight above under a sun of no image: linear counts at the gain of the image with the highest sun, no cars, no noise",
        );
        let counts = on_grid(grid, Samples::U16(&image.counts), request.bands.names(), &said, None);
        write(&staging.path(&format!("truth/relit_{number}.tif"))?, &counts)?;
        let said = items(SHADOW_MEANS);
        let mask = on_grid(grid, Samples::U8(&image.shadow), &["shadow"], &said, None);
        write(&staging.path(&format!("truth/relit_{number}_shadow.tif"))?, &mask)?;
    }
    let list: Vec<_> = (suns_deg.iter())
        .map(|sun| serde_json::json!({"sun_azimuth_deg": sun[0], "sun_elevation_deg": sun[1]}))
        .collect();
    let list = serde_json::Value::from(list);
    staging.text("truth/relit.json", &format!("{list:#}\n"))?;
    let hours = relit::sun_hours(scene, &sensor.frame, grid);
    let hours: Vec<f32> = hours.into_iter().map(|h| if h.is_nan() { NODATA } else { h }).collect();
    let said = [
        about(
            "hours of direct sun on the highest surface at the centre of each cell, without cars, between two midnights of mean solar time",
        ),
        ("DATE".to_string(), relit::DAY.to_string()),
    ];
    let hours = on_grid(grid, Samples::F32(&hours), &["sun_hours"], &said, Some(NODATA));
    write(&staging.path("truth/sun_hours.tif")?, &hours)
}
