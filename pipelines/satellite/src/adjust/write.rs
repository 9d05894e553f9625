//! Corrected cameras as files: `_RPC.TXT` for most programs, a Sat-NeRF JSON, and copies of the images with the camera
//! in them.

use super::AdjustRequest;
use crate::error::SatelliteError;
use crate::ground::GroundViews;
use heliosplat_raster::{RasterFile, copy_with_rpc, write_atomically};
use heliosplat_rpc::Rpc;
use heliosplat_rpc::adjust::{Adjustment, corrected_rpc};
use heliosplat_rpc::write::{gdal_domain, rpc_txt, satnerf_json_rpc};
use heliosplat_scene::{Scene, SceneImage};
use serde_json::{Value, json};

/// Margin of heights below and above the scene's range where a camera is fitted anew, metres.
const HEIGHT_MARGIN_M: f64 = 100.0;

/// Writes the corrected camera of each image; returns the largest error of each fit as an RPC, pixels (0 for shifts).
pub(super) fn cameras(
    scene: &Scene,
    ground: &GroundViews,
    adjustment: &Adjustment,
    request: &AdjustRequest,
) -> Result<Vec<f64>, SatelliteError> {
    let (low_m, high_m) = scene.altitude_range_m;
    let heights_m = (low_m - HEIGHT_MARGIN_M, high_m + HEIGHT_MARGIN_M);
    let mut refit_px = Vec::with_capacity(ground.images.len());
    for (image, correction) in ground.images.iter().zip(&adjustment.corrections) {
        let size = (image.pixels.width, image.pixels.height);
        let mut corrected = corrected_rpc(&image.window_rpc(), correction, size, heights_m).map_err(|error| {
            SatelliteError::Unwritable(format!("{}: its corrected camera: {error}", image.path.display()))
        })?;
        // Camera in pixels of the file.
        let (col0, row0) = (image.window.col0 as f64, image.window.row0 as f64);
        corrected.rpc = corrected.rpc.cropped(-col0, -row0);
        let text = rpc_txt(&corrected.rpc);
        write_atomically(&request.out.join(format!("{}_RPC.TXT", image.name)), text.as_bytes())?;
        let text = serde_json::to_string_pretty(&description(scene, image, &corrected.rpc)).unwrap_or_default() + "\n";
        write_atomically(&request.out.join(format!("{}.json", image.name)), text.as_bytes())?;
        if request.images {
            let items: Vec<(String, String)> = gdal_domain(&corrected.rpc).into_iter().collect();
            copy_with_rpc(&image.path, &request.out.join(format!("{}.tif", image.name)), &items)?;
        }
        refit_px.push(corrected.max_px);
    }
    Ok(refit_px)
}

/// Metadata of an image as a Sat-NeRF JSON: the image's JSON with the corrected camera, or else values of the scene.
fn description(scene: &Scene, image: &SceneImage, rpc: &Rpc) -> Value {
    let own = heliosplat_raster::bounded::read_text(&image.path.with_extension("json")).ok();
    let own = own.and_then(|text| serde_json::from_str::<Value>(&text).ok());
    // The pixels that were read may be a window of the file.
    let file = RasterFile::open(&image.path).map(|file| file.size());
    let (width, height) = file.unwrap_or((image.pixels.width, image.pixels.height));
    let mut json = own.filter(|own| own.get("rpc").is_some()).unwrap_or_else(|| {
        let mut known = json!({
            "width": width,
            "height": height,
            "min_alt": scene.altitude_range_m.0,
            "max_alt": scene.altitude_range_m.1,
        });
        if let Some(sun) = image.sun.position {
            known["sun_azimuth"] = json!(format!("{}", sun.azimuth_rad.to_degrees()));
            known["sun_elevation"] = json!(format!("{:+}", sun.elevation_rad.to_degrees()));
        }
        known
    });
    if json.get("acquisition_date").is_none()
        && json.get("acquisition_utc").is_none()
        && let Some(time) = image.time
    {
        json["acquisition_date"] = json!(time.strftime("%Y%m%d%H%M%S").to_string());
    }
    json["img"] = json!(format!("{}.tif", image.name));
    json["rpc"] = satnerf_json_rpc(rpc);
    json
}
