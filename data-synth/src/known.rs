//! Cameras of real images, through which a synthetic site has real geometry, dates and suns.

use crate::error::SynthError;
use heliosplat_grid::statistics::upper_median;
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};
use jiff::Timestamp;
use serde_json::Value;
use std::path::Path;

/// Files of cameras larger than this are not read.
const MOST_BYTES: u64 = 64 << 20;

/// The camera of a real image.
#[derive(Debug, Clone)]
pub(crate) struct KnownCamera {
    /// RPC of the image.
    pub(crate) rpc: Rpc,
    /// Acquisition time.
    pub(crate) time: Timestamp,
    /// Ground point of the middle pixel at the height offset of the RPC.
    pub(crate) centre: GeoPoint,
}

/// Reads a JSON object of images, each with `rpc` (names of VisSat, Sat-NeRF or GDAL), `width`, `height` and `capTime`,
/// as VisSat writes it; in order of time.
///
/// # Errors
/// [`SynthError::BadRequest`], naming the file and the image at fault.
pub(crate) fn read(path: &Path) -> Result<Vec<KnownCamera>, SynthError> {
    let fault = |reason: String| {
        let (path, expected) = (
            path.display(),
            "a JSON object of images, each with rpc, width, height and capTime",
        );
        SynthError::BadRequest(format!("{path}: {reason}; expected {expected}"))
    };
    let size = std::fs::metadata(path).map_err(|error| fault(error.to_string()))?.len();
    if size > MOST_BYTES {
        return Err(fault(format!("{} MiB are no list of cameras", size >> 20)));
    }
    let text = std::fs::read_to_string(path).map_err(|error| fault(error.to_string()))?;
    let document: Value = serde_json::from_str(&text).map_err(|error| fault(error.to_string()))?;
    let images = document
        .as_object()
        .ok_or_else(|| fault("expected a JSON object of images by name".into()))?;
    let mut cameras = images
        .iter()
        .map(|(name, image)| camera(image).map_err(|reason| fault(format!("{name}: {reason}"))))
        .collect::<Result<Vec<_>, _>>()?;
    if cameras.is_empty() {
        return Err(fault("it names no image".into()));
    }
    cameras.sort_by_key(|camera| camera.time);
    Ok(cameras)
}

fn camera(image: &Value) -> Result<KnownCamera, String> {
    let number = |key: &str| {
        let value = image.get(key).and_then(Value::as_f64);
        let size = value.filter(|size| (1.0..1e6).contains(size));
        size.ok_or(format!("{key} is missing or is no size in pixels"))
    };
    let time = image.get("capTime").and_then(Value::as_str);
    let time = (time.ok_or("capTime is missing")?.parse()).map_err(|error| format!("capTime is no time ({error})"))?;
    let rpc = heliosplat_rpc::read::satnerf_json(&image.to_string()).map_err(|error| error.to_string())?;
    let middle = ImagePoint::new(0.5 * (number("width")? - 1.0), 0.5 * (number("height")? - 1.0));
    let centre = rpc
        .localise(middle, rpc.height_offset_m)
        .map_err(|error| format!("its middle sees no ground ({error})"))?;
    Ok(KnownCamera { rpc, time, centre })
}

/// `count` of the cameras, evenly through time. `cameras` are in order of time.
pub(crate) fn thinned(cameras: &[KnownCamera], count: usize) -> Vec<KnownCamera> {
    let all = cameras.len();
    (0..count)
        .map(|k| cameras[(2 * k + 1) * all / (2 * count)].clone())
        .collect()
}

/// Common target of the cameras: the median of their centres, one coordinate at a time.
pub(crate) fn common_centre(cameras: &[KnownCamera]) -> GeoPoint {
    let median = |pick: fn(&GeoPoint) -> f64| {
        let mut values: Vec<f64> = cameras.iter().map(|camera| pick(&camera.centre)).collect();
        upper_median(&mut values).unwrap_or(f64::NAN)
    };
    GeoPoint::new(median(|p| p.lon_deg), median(|p| p.lat_deg), median(|p| p.height_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Collection;
    use crate::request::SatelliteRequest;
    use crate::sensor::{PushBroom, ViewGeometry};
    use heliosplat_rpc::LocalFrame;
    use serde_json::json;

    const VIEW: ViewGeometry = ViewGeometry {
        azimuth_rad: 1.1,
        off_nadir_rad: 0.4,
        orbit_m: 617e3,
        tilt_rad: 0.1,
        gsd_m: 0.4,
        full_px: 4000.0,
        seed: 3,
    };

    /// A file of three cameras that see one place in the middle of their images.
    fn file(folder: &Path) -> (std::path::PathBuf, GeoPoint) {
        let place = GeoPoint::new(-58.6, -34.45, 30.0);
        let frame = LocalFrame::new(place);
        let fit = PushBroom::new(&frame, &VIEW, [2000.0, 2000.0]).fit_rational_camera(&frame);
        let rpc = fit.expect("a camera").rpc;
        let middle = rpc.project(place);
        let rpc = rpc.cropped(middle.col - 150.0, middle.row - 150.0);
        let image = |time: &str| json!({"rpc": heliosplat_rpc::write::satnerf_json_rpc(&rpc), "width": 301, "height": 301, "capTime": time});
        let cameras = json!({
            "b": image("2015-09-01T13:57:03.5+00:00"),
            "c": image("2015-11-01T13:57:03Z"),
            "a": image("2015-09-01T13:56:03Z"),
        });
        let path = folder.join("cameras.json");
        std::fs::write(&path, cameras.to_string()).expect("written");
        (path, place)
    }

    #[test]
    fn a_collection_through_known_cameras_has_their_place_times_and_angles() {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, place) = file(folder.path());
        let request = SatelliteRequest {
            cameras: Some(path),
            ..Default::default()
        };
        let collection = Collection::new(&request).expect("a plan");
        assert!((collection.origin.lon_deg - place.lon_deg).abs() < 1e-4);
        assert!((collection.origin.lat_deg - place.lat_deg).abs() < 1e-4);
        assert_eq!((collection.views.len(), collection.dates.len()), (3, 2));
        let view = &collection.views[1];
        assert_eq!(view.time.to_string(), "2015-09-01T13:57:03.5Z");
        assert!(
            (view.geometry.off_nadir_rad - VIEW.off_nadir_rad).abs() < 0.01,
            "{:?}",
            view.geometry
        );
        assert!((view.geometry.azimuth_rad - VIEW.azimuth_rad).abs() < 0.02);
        assert!((view.geometry.gsd_m - VIEW.gsd_m).abs() < 0.02);
    }

    #[test]
    fn a_file_that_lacks_something_is_named_with_the_image() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("cameras.json");
        let fault = |text: &str| {
            std::fs::write(&path, text).expect("written");
            read(&path).expect_err("a fault").to_string()
        };
        assert!(fault("[1]").contains("cameras.json"));
        assert!(fault("{}").contains("no image"));
        assert!(fault("{\"x\": {\"width\": 3}}").contains("x: capTime"));
        let late = "{\"x\": {\"capTime\": \"yesterday\", \"width\": 3, \"height\": 3}}";
        assert!(fault(late).contains("no time"));
    }

    #[test]
    fn fewer_cameras_are_spread_over_all() {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, _) = file(folder.path());
        let cameras = read(&path).expect("cameras");
        assert_eq!(thinned(&cameras, 3).len(), 3);
        let one = thinned(&cameras, 1);
        assert_eq!(one[0].time, cameras[1].time);
    }
}
