//! Altitudes of a scene that states none.

use heliosplat_tests::program::{json, tiny_scene};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Takes the altitudes out of the JSONs of a scene: what is left allows half a kilometre up and down.
fn forget_altitudes(scene: &Path) {
    for entry in fs::read_dir(scene).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|extension| extension == "json") {
            let mut said: Value = serde_json::from_slice(&fs::read(&path).expect("readable")).expect("JSON");
            let said_of_image = said.as_object_mut().expect("an object");
            said_of_image.remove("min_alt");
            said_of_image.remove("max_alt");
            fs::write(&path, said.to_string()).expect("written");
        }
    }
}

#[test]
fn a_scene_without_altitudes_is_searched_where_its_tie_points_lie() {
    let home = tempfile::tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    let word = scene.display().to_string();
    tiny_scene(&scene);
    let stated = json(&["inspect", &word]);
    assert_eq!(stated["altitude_m"]["source"], "given");
    forget_altitudes(&scene);
    let found = json(&["inspect", &word]);
    assert_eq!(found["altitude_m"]["source"], "ties", "{}", found["altitude_m"]);
    let limit = |scene: &Value, end: &str| scene["altitude_m"][end].as_f64().expect("a number");
    let (low_m, high_m) = (limit(&found, "low"), limit(&found, "high"));
    // The site's ground and roofs lie between those stated, well inside.
    let middle_m = 0.5 * (limit(&stated, "low") + limit(&stated, "high"));
    assert!(low_m < middle_m && middle_m < high_m, "{low_m} to {high_m}");
    assert!(high_m - low_m < 150.0, "{low_m} to {high_m} of a kilometre");
    assert!(
        found["warnings"].to_string().find("--altitude").is_none(),
        "{}",
        found["warnings"]
    );
    // What is said on the command line counts.
    let given = json(&["inspect", &word, "--altitude", "650,750"]);
    assert_eq!(
        given["altitude_m"],
        serde_json::json!({"low": 650.0, "high": 750.0, "source": "given"})
    );
    // Every verb that reads a scene finds them.
    let dsm = home.path().join("dsm.tif").display().to_string();
    let swept = json(&["dsm", &word, "--from", "sweep", "--out", &dsm]);
    assert!(swept["completeness"].as_f64().expect("a number") > 0.9, "{swept}");
}
