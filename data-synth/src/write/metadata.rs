//! Metadata of an image as vendors deliver it: acquisition time, sun, footprint, camera.

use crate::crop::{Canvas, Crop};
use crate::plan::ViewPlan;
use crate::request::{Fault, SatelliteRequest};
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc, RpcError};
use serde_json::{Value, json};

/// Items (name, value) for GDAL's default metadata domain. `cloud_share` is 0 to 1.
pub(crate) fn image_items(
    view: &ViewPlan,
    request: &SatelliteRequest,
    cloud_share: f64,
) -> Vec<(&'static str, String)> {
    let display = request.bits == 8;
    let radiometry = if display {
        "display, sRGB"
    } else {
        "linear counts, 11 bits"
    };
    let [azimuth_deg, elevation_deg] = [view.sun.azimuth_rad, view.sun.elevation_rad].map(f64::to_degrees);
    let mut items = vec![
        (
            "ACQUISITIONDATETIME",
            view.time.strftime("%Y-%m-%dT%H:%M:%SZ").to_string(),
        ),
        ("NITF_USE00A_SUN_AZ", format!("{azimuth_deg:.1}")),
        ("NITF_USE00A_SUN_EL", format!("{elevation_deg:.1}")),
        ("SATELLITEID", "HELIOSPLAT-SYNTH".to_string()),
        ("CLOUDCOVER", format!("{:.0}", 100.0 * cloud_share)),
    ];
    // Vendors do not document the stretch of display images.
    if !request.has(Fault::Stretch) {
        items.push(("RADIOMETRY", radiometry.to_string()));
    }
    items
}

/// The items as a raster refers to them.
pub(crate) fn borrowed<'a>(items: &'a [(&'a str, String)]) -> Vec<(&'a str, &'a str)> {
    items.iter().map(|(name, value)| (*name, value.as_str())).collect()
}

/// Altitude bounds, metres, as a public elevation model would give: 10 to 25 m wider than the truth on either side.
pub(crate) fn loose_altitudes_m([low_m, high_m]: [f64; 2], seed: u64) -> [f64; 2] {
    let slack_m = |salt: u64| 10.0 + 10.0 * crate::noise::unit(crate::noise::hash2(seed, salt));
    [
        ((low_m - slack_m(0xA1)) / 5.0).floor() * 5.0,
        ((high_m + slack_m(0xA2)) / 5.0).ceil() * 5.0,
    ]
}

/// JSON metadata of an image as in Sat-NeRF's data sets. `altitudes_m` are the lowest and the highest altitude, metres.
/// The size is that of the file; the outline is that of the image, on a canvas too.
///
/// # Errors
/// When the RPC cannot be localised at a corner or the centre of the image.
pub(crate) fn satnerf_json(
    view: &ViewPlan,
    (crop, canvas): (&Crop, Option<Canvas>),
    rpc: &Rpc,
    altitudes_m: [f64; 2],
) -> Result<Value, RpcError> {
    let middle_m = 0.5 * (altitudes_m[0] + altitudes_m[1]);
    let place = |col: f64, row: f64| {
        rpc.localise(ImagePoint { col, row }, middle_m)
            .map(|GeoPoint { lon_deg, lat_deg, .. }| json!([lon_deg, lat_deg]))
    };
    // Edges of the image lie half a pixel outside the centres of its outermost pixels.
    let [col, row] = canvas.map_or([0, 0], |canvas| [canvas.col, canvas.row]);
    let (left, top) = (col as f64 - 0.5, row as f64 - 0.5);
    let (right, bottom) = (left + crop.width as f64, top + crop.height as f64);
    let ring = [(left, top), (left, bottom), (right, bottom), (right, top), (left, top)];
    let ring: Vec<Value> = (ring.into_iter())
        .map(|(col, row)| place(col, row))
        .collect::<Result<_, _>>()?;
    Ok(json!({
        "img": format!("{}.tif", view.name),
        "height": canvas.map_or(crop.height, |canvas| canvas.size),
        "width": canvas.map_or(crop.width, |canvas| canvas.size),
        "sun_elevation": format!("{:+.1}", view.sun.elevation_rad.to_degrees()),
        "sun_azimuth": format!("{:.1}", view.sun.azimuth_rad.to_degrees()),
        "acquisition_date": view.time.strftime("%Y%m%d%H%M%S").to_string(),
        "geojson": {
            "coordinates": [ring],
            "type": "Polygon",
            "center": place(0.5 * (left + right), 0.5 * (top + bottom))?,
        },
        "min_alt": altitudes_m[0],
        "max_alt": altitudes_m[1],
        "rpc": heliosplat_rpc::write::satnerf_json_rpc(rpc),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn altitude_bounds_do_not_leak_the_truth() {
        for seed in 0..50 {
            let [low, high] = loose_altitudes_m([101.3, 140.9], seed);
            assert!((75.0..=91.3).contains(&low), "{low}");
            assert!((150.9..=167.0).contains(&high), "{high}");
            assert_eq!((low % 5.0, high % 5.0), (0.0, 0.0));
        }
    }
}
