//! Scenes whose suns are unknown, all of them or some: everything that needs no sun works, and everything else is
//! refused with a message.

use heliosplat_tests::program::{fault, json};
use heliosplat_tests::scenes::{View, write_scene};
use serde_json::{Value, json as value};
use std::path::Path;
use tempfile::{TempDir, tempdir};

fn text(path: &Path) -> &str {
    path.to_str().expect("an UTF-8 path")
}

/// A scene of four views, those of `dates` with an acquisition time.
fn scene(dates: [Option<&'static str>; 4]) -> TempDir {
    let folder = tempdir().expect("a temporary folder");
    let views: Vec<View> = (0..4)
        .map(|number| View {
            date: dates[number],
            ..View::new(number)
        })
        .collect();
    write_scene(folder.path(), &views);
    folder
}

fn trained(scene: &Path, run: &Path) -> Value {
    json(&[
        "train",
        text(scene),
        "--out",
        text(run),
        "--preset",
        "fast",
        "--altitude",
        "690,710",
        "--set",
        "train.iterations=12",
    ])
}

fn item<'a>(plan: &'a Value, component: &str) -> &'a Value {
    let items = plan.as_array().expect("a plan");
    let found = items.iter().find(|item| item["component"] == component);
    found.unwrap_or_else(|| panic!("no {component} in the plan"))
}

#[test]
fn a_scene_without_any_sun_is_inspected_swept_and_adjusted() {
    let folder = scene([None; 4]);
    let seen = json(&["inspect", text(folder.path())]);
    for image in seen["images"].as_array().expect("images") {
        let expected = value!({"azimuth_deg": null, "elevation_deg": null, "source": "none"});
        assert_eq!(image["sun"], expected);
    }
    let home = tempdir().expect("a temporary folder");
    let dsm = home.path().join("dsm.tif");
    let range = ["--altitude", "690,710"];
    json(
        &[
            &["dsm", text(folder.path()), "--from", "sweep", "--out", text(&dsm)],
            &range[..],
        ]
        .concat(),
    );
    assert!(dsm.is_file());
    let adjusted = home.path().join("adjusted");
    json(&[&["adjust", text(folder.path()), "--out", text(&adjusted)], &range[..]].concat());
    let description = std::fs::read_to_string(adjusted.join("view_0.json")).expect("written");
    assert!(!description.contains("sun_azimuth"), "no sun is made up: {description}");
}

#[test]
fn a_model_of_unknown_suns_has_no_light_and_cannot_be_relit() {
    let folder = scene([None; 4]);
    let home = tempdir().expect("a temporary folder");
    let (run, out) = (home.path().join("run"), home.path().join("out"));
    let metrics = trained(folder.path(), &run);
    let suns = metrics["suns"].as_array().expect("suns");
    assert_eq!(suns.len(), 4);
    assert!(
        suns.iter()
            .all(|sun| sun["source"] == "none" && sun["azimuth_deg"].is_null())
    );
    assert!(metrics.get("lowered").is_none(), "nothing could be tested by its light");
    let relit = home.path().join("relit.tif");
    let line = fault(&["relight", text(&run), "--out", text(&relit), "--sun", "150,40"], 2);
    assert!(line.contains("no sun was known") && !relit.exists(), "{line}");
    json(&["products", text(&run), "--out", text(&out), "--sun", "150,40"]);
    let files = std::fs::read_dir(&out)
        .expect("listable")
        .map(|entry| entry.expect("readable").file_name());
    let names: Vec<String> = files.map(|name| name.to_string_lossy().into_owned()).collect();
    assert!(names.iter().any(|name| name == "dsm.tif"), "{names:?}");
    let of_light = |name: &String| name.starts_with("shadow_") || name.starts_with("relit");
    assert!(!names.iter().any(of_light), "{names:?}");
    let views = home.path().join("views");
    let rendered = json(&["render", text(&run), "--out", text(&views), "--split", "train"]);
    assert!(rendered["views"][0]["shadow"].is_null());
    json(&["evaluate", text(&run)]);
}

#[test]
fn images_with_a_sun_are_lit_and_the_others_are_counted() {
    let folder = scene([Some("20160423083400"), Some("20160423083400"), None, None]);
    let seen = json(&["inspect", text(folder.path())]);
    assert_eq!(seen["decisions"]["light"], "from_shadows");
    let reason = item(&seen["plan"], "sun")["reason"].as_str().expect("a reason");
    assert!(reason.contains("2 of 4 images"), "{reason}");
    let home = tempdir().expect("a temporary folder");
    let (run, picture) = (home.path().join("run"), home.path().join("lit.tif"));
    let metrics = trained(folder.path(), &run);
    let sources: Vec<&str> = metrics["suns"]
        .as_array()
        .expect("suns")
        .iter()
        .map(|sun| sun["source"].as_str().expect("a source"))
        .collect();
    assert_eq!(sources, ["time", "time", "none", "none"]);
    assert!(metrics["lowered"]["parts"].is_u64(), "two suns are enough to test");
    assert_eq!(metrics["rejected_steps"], 0);
    json(&["relight", text(&run), "--out", text(&picture), "--sun", "150,40"]);
    assert!(picture.is_file());
}
