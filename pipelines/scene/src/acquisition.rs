//! When an image was taken and where the sun stood.

use super::entry::ImageEntry;
use super::files::{file_name, read_text};
use super::sidecars::describing_texts;
use super::{ImageSun, SceneError};
use heliosplat_raster::RasterFile;
use heliosplat_rpc::GeoPoint;
use heliosplat_rpc::read::acquisition::{self, Acquisition};
use heliosplat_rpc::sun::{SunPosition, sun_position};

/// Vendors use the geocentric vertical, up to 0.4° off; more than this is a mistake somewhere, degrees.
const WORTH_A_WARNING_DEG: f64 = 0.5;
/// Below this, shadows are longer than most scenes, degrees.
const LOW_SUN_DEG: f64 = 5.0;

/// Collects what is known: `scene.toml` first, then a Sat-NeRF JSON, then texts beside the image, then GDAL's domains.
pub(super) fn find(file: &RasterFile, entry: &ImageEntry) -> Result<Acquisition, SceneError> {
    let mut known = Acquisition::default();
    if let Some(said) = &entry.said {
        known = Acquisition {
            time: said.time,
            sun_azimuth_deg: said.sun_azimuth_deg,
            sun_elevation_deg: said.sun_elevation_deg,
        };
    }
    for path in describing_texts(entry, file.path())? {
        if let Some(more) = acquisition::from_text(&file_name(&path), &read_text(&path)?) {
            known = known.merge(more);
        }
    }
    let mut items = file.domain("");
    for domain in ["IMD", "IMAGERY"] {
        items.extend(file.domain(domain));
    }
    Ok(known.merge(acquisition::gdal_domain(&items)))
}

/// The sun over the scene: computed from the time where there is one, else as the metadata say, else unknown.
pub(super) fn sun(
    file: &RasterFile,
    known: &Acquisition,
    at: GeoPoint,
    warnings: &mut Vec<String>,
) -> Result<ImageSun, SceneError> {
    let metadata = known.stated_sun();
    let found = match (known.time, metadata) {
        (Some(time), _) => ImageSun::from_time(sun_position(time, at)),
        (None, Some(sun)) => ImageSun::from_metadata(sun),
        (None, None) => ImageSun::unknown(),
    };
    let Some(position) = found.position else {
        return Ok(found);
    };
    check_height(file, known, position, warnings)?;
    if let (Some(apart_deg), Some(stated)) = (known.sun_disagreement_deg(at), metadata)
        && apart_deg > WORTH_A_WARNING_DEG
    {
        let angles = |sun: SunPosition| {
            let (azimuth, elevation) = (sun.azimuth_rad.to_degrees(), sun.elevation_rad.to_degrees());
            format!("azimuth {azimuth:.1}, elevation {elevation:.1}")
        };
        warnings.push(format!(
            "{}: the sun of its acquisition time ({}) is {apart_deg:.1} degrees off the one its metadata state ({}); the time is used",
            file.path().display(),
            angles(position),
            angles(stated),
        ));
    }
    Ok(found)
}

fn check_height(
    file: &RasterFile,
    known: &Acquisition,
    found: SunPosition,
    warnings: &mut Vec<String>,
) -> Result<(), SceneError> {
    let elevation_deg = found.elevation_rad.to_degrees();
    // Degrees become radians and degrees again.
    let is_day = elevation_deg > 0.0 && elevation_deg <= 90.0 + 1e-9;
    if !is_day {
        let stated = known.stated_sun().map(|sun| sun.elevation_rad.to_degrees());
        let (origin, remedy) = match (known.time, stated) {
            (Some(time), Some(stated)) if stated > 0.0 => (
                format!("at {time}"),
                format!("its metadata say {stated:.1}: correct the acquisition time, or remove it"),
            ),
            (Some(time), _) => (
                format!("at {time}"),
                "correct the acquisition time (UTC), or take the image out of the scene".to_owned(),
            ),
            (None, _) => (
                "as its metadata say".to_owned(),
                "correct the metadata, or take the image out of the scene".to_owned(),
            ),
        };
        return Err(SceneError::SunBelowHorizon {
            path: file.path().to_owned(),
            elevation_deg,
            origin,
            remedy,
        });
    }
    if elevation_deg < LOW_SUN_DEG {
        warnings.push(format!(
            "{}: the sun is only {elevation_deg:.1} degrees above the horizon; its shadows leave the scene",
            file.path().display()
        ));
    }
    Ok(())
}
