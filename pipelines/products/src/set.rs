//! All products of a run: cloud-optimised GeoTIFFs on one grid, a point cloud, and a STAC item that describes them.

use super::dsm::{maps, of_model};
use super::nadir::NadirGrid;
use super::relight::{RelightError, Viewpoint};
use super::stac::ItemMetadata;
use super::sunshine::{Period, sunshine};
use super::writer::{Set, Surroundings, Writer};
use super::{ortho, points};
use crate::change::ChangeMap;
use crate::model::{LoadedModel, ModelImage};
use heliosplat_fitting::run_folder::inputs;
use heliosplat_raster::{Geoid, RasterError};
use heliosplat_rpc::sun::SunPosition;
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::SystemTime;

/// Settings of the products of a run.
#[derive(Debug, Clone, Default)]
pub struct Request {
    /// Ground sampling distance, metres; that of the images by default.
    pub gsd_m: Option<f64>,
    /// Coordinate system; the local UTM zone by default.
    pub crs: Option<String>,
    /// Geoid that heights refer to; the ellipsoid by default.
    pub geoid: Option<Geoid>,
    /// Sun of the relit ortho image; `None`: no relit image.
    pub sun: Option<SunPosition>,
    /// Days whose sunshine is computed; `None`: no sunshine.
    pub sun_hours: Option<Period>,
}

/// Name of the date of an image: its day (UTC), or without a time the position of its sun; `undated` where neither is
/// known.
pub fn date_of(image: &ModelImage) -> String {
    match (image.time, image.sun) {
        (Some(time), _) => time.strftime("%Y-%m-%d").to_string(),
        (None, Some(sun)) => {
            let [azimuth, elevation] = sun.degrees();
            format!("sun_{azimuth:03.0}_{elevation:02.0}")
        }
        (None, None) => "undated".into(),
    }
}

/// Largest angle between the suns of images of one day that have one light, degrees: five minutes of a pass.
const ONE_SUN_DEG: f64 = 1.25;

/// Dates of a run whose sun is known, by name, each with the sun of its first image. A further pass of a day, under
/// another sun, has its time (UTC) in its name, such as `2026-06-21_1500`.
pub fn dates(images: &[ModelImage]) -> Vec<(String, SunPosition)> {
    let mut known: BTreeMap<String, SunPosition> = BTreeMap::new();
    for (image, sun) in images.iter().filter_map(|image| Some((image, image.sun?))) {
        let day = date_of(image);
        let mut of_day = known.iter().filter(|(name, _)| name.starts_with(&day));
        let name = match (of_day.clone().next(), image.time) {
            _ if of_day.any(|(_, other)| is_one_light(other, &sun)) => continue,
            (Some(_), Some(time)) => time.strftime("%Y-%m-%d_%H%M").to_string(),
            _ => day,
        };
        known.entry(name).or_insert(sun);
    }
    known.into_iter().collect()
}

fn is_one_light(a: &SunPosition, b: &SunPosition) -> bool {
    let cosine = a.direction_enu().dot(&b.direction_enu());
    cosine.clamp(-1.0, 1.0).acos().to_degrees() <= ONE_SUN_DEG
}

/// Name that a run with these dates gives to a date of several runs of a site, with its sun; `None` where its images
/// do not show that date. Runs name passes in their own order: the only pass of a run has no time in its name.
pub fn own_name<'a>((date, sun): (&str, &SunPosition), own: &'a [(String, SunPosition)]) -> Option<&'a str> {
    // A name begins with ten characters of the day, or of the sun where there is no day.
    let day = |name: &str| name.chars().take(10).collect::<String>();
    let mut alike = own.iter().filter(|(_, other)| is_one_light(other, sun));
    let same = alike.find(|(name, _)| day(name) == day(date));
    same.map(|(name, _)| name.as_str())
}

/// Sun of a run with a single date and a known sun for each image; otherwise `None`.
pub fn only_sun<'a>(images: &[ModelImage], dates: &'a [(String, SunPosition)]) -> Option<&'a SunPosition> {
    match dates {
        [(_, sun)] if images.iter().all(|image| image.sun.is_some()) => Some(sun),
        _ => None,
    }
}

/// Dates that get a shadow mask: none for a model without light.
fn shaded_dates(model: &LoadedModel) -> Vec<(String, SunPosition)> {
    match model.file.has_light() {
        true => dates(&model.file.images),
        false => Vec::new(),
    }
}

/// Number of steps that [`write()`] reports.
pub fn steps(model: &LoadedModel) -> u64 {
    4 + shaded_dates(model).len() as u64
}

/// Writes all products into the folder `out`, `item.json` last. They show a `whole` model on the day of its last image.
/// The item has the name `id`, and belongs to a collection (its name and its location) if there is one. `done` is
/// called with the number of finished steps.
///
/// # Errors
/// When the grid cannot be made or nothing falls on it, a geoid is missing, the requested sun is too low (before
/// anything is written), or a file cannot be written.
pub fn write(
    whole: &LoadedModel,
    out: &Path,
    request: &Request,
    (id, collection): (&str, Option<(&str, &str)>),
    done: &dyn Fn(u64),
) -> Result<Set, RelightError> {
    let model = &whole.on_last();
    let gsd_m = request.gsd_m.unwrap_or(model.file.gsd_m);
    let nadir = NadirGrid::new(&model.into(), gsd_m, request.crs.as_deref())?;
    let seen = maps(model, &nadir);
    let mut surface = of_model(&nadir, model)?;
    let changes = ChangeMap::of(whole, &nadir, &surface);
    if let Some(geoid) = request.geoid {
        surface = surface.above(geoid)?;
    }
    if surface.completeness() == 0.0 {
        let (name, reason) = (nadir.grid.crs.name(), "nothing of the run falls on its grid");
        return Err(RasterError::Transform(name.to_owned(), reason.into()).into());
    }
    let above = Viewpoint::above(model, &nadir);
    let sun = request.sun.filter(|_| model.file.has_light());
    if request.sun.is_some() && sun.is_none() {
        tracing::warn!(
            "No image of this run had a known sun, so the relit image and the shadow masks are left out. To get them, train again with \
             acquisition times: .IMD, DIM_*.XML or .json files beside the images, or time = \"2016-04-23T08:34:00Z\" in scene.toml"
        );
    }
    let relit = sun.map(|sun| Ok::<_, RelightError>((sun, above.relit(&sun)?)));
    let relit = relit.transpose()?;
    done(1);
    let bands = &model.file.bands;
    let mut writer = Writer::new(&nadir.grid, gsd_m, out)?;
    let ground = writer.surface(&surface, &Surroundings::none(&surface))?;
    if let Some(changes) = changes {
        writer.changes(&changes)?;
    }
    let mut albedo = ortho::albedo(model, &seen);
    surface.blank_unknown(&mut albedo);
    writer.colours(&albedo, bands, model.file.ndvi())?;
    done(2);
    if let Some((sun, relit)) = relit {
        let (mut shadows, mut image) = (relit.shadows(), relit.image);
        surface.blank_unknown(&mut image);
        surface.blank_unknown(&mut shadows);
        writer.relit(&image, &shadows, bands, &sun)?;
    }
    if let Some(period) = &request.sun_hours {
        let shone = sunshine(&nadir, &surface.altitude(), model.frame.origin, period);
        writer.sunshine(&shone, period)?;
    }
    done(3);
    let dates = shaded_dates(model);
    for (place, (date, sun)) in dates.iter().enumerate() {
        let mut shadows = above.shadows(sun)?;
        surface.blank_unknown(&mut shadows);
        writer.shadows(date, &shadows, sun)?;
        done(4 + place as u64);
    }
    let count = points::write(&out.join("points.laz"), model, (&nadir.grid, &ground), request.geoid)?;
    writer.points("points.laz", count);
    let set = writer.finish(&ItemMetadata {
        id,
        times: &times(&model.file.images, &[&model.folder]),
        sun: only_sun(&model.file.images, &dates),
        collection,
    })?;
    done(steps(model));
    Ok(set)
}

/// Acquisition times of the images. Without any, the time at which the newest input file of the runs was written, or
/// the newest model where the inputs are gone.
pub fn times(images: &[ModelImage], runs: &[&Path]) -> Vec<Timestamp> {
    let times: Vec<Timestamp> = images.iter().filter_map(|image| image.time).collect();
    if !times.is_empty() {
        return times;
    }
    let written = |path: &Path| std::fs::metadata(path).and_then(|data| data.modified()).ok();
    let inputs = runs.iter().filter_map(|run| inputs(run).ok());
    let of_files: Option<SystemTime> = inputs.flatten().filter_map(|input| written(&input.path)).max();
    let newest = of_files.or_else(|| runs.iter().filter_map(|run| written(&run.join("model.json"))).max());
    let newest = newest.and_then(|time| Timestamp::try_from(time).ok());
    vec![newest.unwrap_or_default()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_shows_one_pass_of_a_day_names_it_without_its_time() {
        let [morning, noon] = [(110.0, 40.0), (200.0, 55.0)].map(|(az, el)| SunPosition::from_degrees(az, el));
        let dates = |names: &[(&str, SunPosition)]| -> Vec<(String, SunPosition)> {
            names.iter().map(|&(name, sun)| (name.to_owned(), sun)).collect()
        };
        let both = dates(&[("2026-06-21", morning), ("2026-06-21_1500", noon)]);
        let later = dates(&[("2026-06-20", noon), ("2026-06-21", noon)]);
        assert_eq!(own_name(("2026-06-21_1500", &noon), &both), Some("2026-06-21_1500"));
        assert_eq!(own_name(("2026-06-21_1500", &noon), &later), Some("2026-06-21"));
        assert_eq!(own_name(("2026-06-21", &morning), &later), None);
    }
}
