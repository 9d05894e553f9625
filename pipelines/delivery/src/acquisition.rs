//! Acquisition time of an image, and position of the sun.

use super::entry::ImageEntry;
use super::files::Folders;
use super::names::file_name;
use super::sidecars::describing_texts;
use super::{ImageSun, Result};
use heliosplat_raster::RasterFile;
use heliosplat_rpc::GeoPoint;
use heliosplat_rpc::read::acquisition::{self, Acquisition};
use heliosplat_rpc::sun::{SunPosition, sun_position};
use std::path::Path;

/// Least difference between computed and stated sun with a warning, degrees: vendors use the geocentric vertical, up to
/// 0.4° off; a larger difference is an error in the metadata.
const WORTH_A_WARNING_DEG: f64 = 0.5;
/// Sun elevation below which a warning is given, degrees: shadows are then longer than most scenes.
const LOW_SUN_DEG: f64 = 5.0;

/// Acquisition time and sun angles of an image; precedence: `scene.toml`, a Sat-NeRF JSON, texts beside the image,
/// GDAL's metadata domains.
pub(super) fn find(file: &RasterFile, entry: &ImageEntry, folders: &Folders) -> Result<Acquisition> {
    let stated = entry.said.as_ref().map(|said| Acquisition {
        time: said.time,
        sun_azimuth_deg: said.sun_azimuth_deg,
        sun_elevation_deg: said.sun_elevation_deg,
    });
    let mut known = stated.unwrap_or_default();
    for path in describing_texts(entry, file.path(), folders)? {
        if let Some(more) = acquisition::from_text(&file_name(&path), &folders.text(&path)?) {
            known = known.merge(more);
        }
    }
    let mut items = file.domain("");
    for domain in ["IMD", "IMAGERY"] {
        items.extend(file.domain(domain));
    }
    Ok(known.merge(acquisition::gdal_domain(&items)))
}

/// Sun over the scene: computed from the acquisition time, else from the angles in the metadata, else unknown. Suns
/// below the horizon or beyond the zenith ([`night`]) are discarded.
pub(super) fn sun(image: &Path, known: &Acquisition, at: GeoPoint, warnings: &mut Vec<String>) -> ImageSun {
    let metadata = known.stated_sun().filter(is_day);
    let computed = known.time.map(|time| sun_position(time, at)).filter(is_day);
    let (found, position) = match (computed, metadata) {
        (Some(sun), _) => (ImageSun::from_time(sun), sun),
        (None, Some(sun)) => (ImageSun::from_metadata(sun), sun),
        (None, None) => return ImageSun::unknown(),
    };
    let [_, elevation_deg] = position.degrees();
    if elevation_deg < LOW_SUN_DEG {
        warnings.push(format!(
            "{}: the sun is only {elevation_deg:.1} degrees above the horizon; its shadows leave the scene",
            image.display()
        ));
    }
    if let (Some(apart_deg), Some(stated), Some(_)) = (known.sun_disagreement_deg(at), metadata, computed)
        && apart_deg > WORTH_A_WARNING_DEG
    {
        let angles = |sun: SunPosition| {
            let [azimuth, elevation] = sun.degrees();
            format!("azimuth {azimuth:.1}, elevation {elevation:.1}")
        };
        warnings.push(format!(
            "{}: the sun of its acquisition time ({}) is {apart_deg:.1} degrees off the one its metadata state ({}); the time is used",
            image.display(),
            angles(position),
            angles(stated),
        ));
    }
    found
}

/// True if a sun stands between horizon and zenith, with a tolerance for rounding between degrees and radians.
fn is_day(sun: &SunPosition) -> bool {
    let elevation_deg = sun.elevation_rad.to_degrees();
    elevation_deg > 0.0 && elevation_deg <= 90.0 + 1e-9
}

/// Source and elevation (degrees) of a sun below the horizon or beyond the zenith; `None` where there is no such sun.
pub(super) fn night(known: &Acquisition, at: GeoPoint) -> Option<(String, f64)> {
    let computed = known.time.map(|time| (format!("at {time}"), sun_position(time, at)));
    let stated = known.stated_sun().map(|sun| ("as its metadata say".to_owned(), sun));
    let (origin, sun) = computed.into_iter().chain(stated).find(|(_, sun)| !is_day(sun))?;
    Some((origin, sun.elevation_rad.to_degrees()))
}
