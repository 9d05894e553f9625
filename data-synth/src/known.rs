//! Cameras of real images, so that a made-up site is seen through real geometry, on real dates, under real suns.

use crate::SynthError;
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};
use jiff::Timestamp;
use serde_json::Value;
use std::path::Path;

/// Files of cameras larger than this are not read.
const MOST_BYTES: u64 = 64 << 20;

/// The camera of a real image.
#[derive(Debug, Clone)]
pub(crate) struct KnownCamera {
    pub(crate) rpc: Rpc,
    pub(crate) time: Timestamp,
    /// What its middle pixel sees at the height its RPC is centred on.
    pub(crate) centre: GeoPoint,
}

/// Reads a JSON object of images, each with `rpc` (names of VisSat, Sat-NeRF or GDAL), `width`, `height` and `capTime`, as
/// VisSat writes it; in order of time.
///
/// # Errors
/// [`SynthError::Cameras`], naming the file and the image at fault.
pub(crate) fn read(path: &Path) -> Result<Vec<KnownCamera>, SynthError> {
    let fault = |reason: String| SynthError::Cameras {
        path: path.to_owned(),
        reason,
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
    let text = |key: &str| {
        image
            .get(key)
            .and_then(Value::as_str)
            .ok_or(format!("{key} is missing"))
    };
    let number = |key: &str| {
        let value = image
            .get(key)
            .and_then(Value::as_f64)
            .filter(|v| (1.0..1e6).contains(v));
        value.ok_or(format!("{key} is missing or is no size in pixels"))
    };
    let time = text("capTime")?
        .parse()
        .map_err(|error| format!("capTime is no time ({error})"))?;
    let rpc = heliosplat_rpc::read::satnerf_json(&image.to_string()).map_err(|error| error.to_string())?;
    let middle = ImagePoint {
        col: 0.5 * (number("width")? - 1.0),
        row: 0.5 * (number("height")? - 1.0),
    };
    let centre = rpc
        .localise(middle, rpc.height_offset_m)
        .map_err(|error| format!("its middle sees no ground ({error})"))?;
    Ok(KnownCamera { rpc, time, centre })
}

/// `count` of the cameras, evenly through time.
pub(crate) fn thinned(cameras: Vec<KnownCamera>, count: usize) -> Vec<KnownCamera> {
    let all = cameras.len();
    let kept: Vec<usize> = (0..count).map(|k| (2 * k + 1) * all / (2 * count)).collect();
    let numbered = cameras.into_iter().enumerate();
    numbered
        .filter(|(k, _)| kept.contains(k))
        .map(|(_, camera)| camera)
        .collect()
}

/// Where all of them look: the median of their centres, one coordinate at a time.
pub(crate) fn common_centre(cameras: &[KnownCamera]) -> GeoPoint {
    let median = |pick: fn(&GeoPoint) -> f64| {
        let mut values: Vec<f64> = cameras.iter().map(|camera| pick(&camera.centre)).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    GeoPoint {
        lon_deg: median(|p| p.lon_deg),
        lat_deg: median(|p| p.lat_deg),
        height_m: median(|p| p.height_m),
    }
}
