//! Ingest of real images, where they are present.

use heliosplat_tests::program::json;
use heliosplat_tests::shared::shared;
use serde_json::Value;

fn inspect(scene: &str) -> Option<Value> {
    let path = shared(scene)?;
    Some(json(&["inspect".as_ref(), path.as_os_str()]))
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

#[test]
fn kahramanmaras_fits_pinhole_cameras_within_a_twentieth_of_a_pixel() {
    let Some(scene) = inspect("data/kahramanmaras") else {
        return;
    };
    let images = scene["images"].as_array().expect("images");
    assert_eq!(images.len(), 4);
    for image in images {
        assert!(number(&image["pinhole_rms_px"]) <= 0.02, "{image}");
        assert!(number(&image["pinhole_max_px"]) <= 0.05, "{image}");
        assert_eq!(image["bands"], serde_json::json!(["pan"]));
        assert_eq!(image["sun_source"], "time");
        // The JSONs carry suns computed by NREL's SPA.
        for angle in ["azimuth_deg", "elevation_deg"] {
            let apart = number(&image["sun"][angle]) - number(&image["metadata_sun"][angle]);
            assert!(apart.abs() < 0.02, "{angle} {apart}");
        }
    }
    assert_eq!(scene["altitude_range_m"], serde_json::json!([640.0, 780.0]));
    assert!(number(&scene["covered_by_at_least"][1]) > 0.9);
    assert_eq!(
        scene["warnings"].as_array().map(Vec::len),
        Some(0),
        "{}",
        scene["warnings"]
    );
}

#[test]
fn giza_and_ventoux_are_scenes_of_two_overlapping_views() {
    for (name, ground_m, centre) in [
        ("data/giza", 75.9, [31.135, 29.979]),
        ("data/ventoux", 540.0, [5.195, 44.206]),
    ] {
        let Some(scene) = inspect(name) else {
            return;
        };
        assert_eq!(scene["images"].as_array().map(Vec::len), Some(2));
        let origin = &scene["origin"];
        assert!((number(&origin["lon_deg"]) - centre[0]).abs() < 0.002, "{origin}");
        assert!((number(&origin["lat_deg"]) - centre[1]).abs() < 0.002, "{origin}");
        let range = &scene["altitude_range_m"];
        assert!(number(&range[0]) < ground_m && ground_m < number(&range[1]));
        assert!(number(&scene["covered_by_at_least"][1]) > 0.6, "{scene}");
        assert_eq!(
            scene["warnings"].as_array().map(Vec::len),
            Some(0),
            "{}",
            scene["warnings"]
        );
    }
}
