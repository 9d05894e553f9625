//! `heliosplat adjust`: the biases of a synthetic scene are recovered, and real cameras agree afterwards.

use heliosplat_tests::program::{heliosplat, json};
use heliosplat_tests::shared::shared;
use serde_json::Value;
use std::path::Path;

fn text(path: &Path) -> String {
    path.to_str().expect("an UTF-8 path").to_owned()
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// A tiny site whose images point wrong by `bias_px` pixels.
fn synthesise(scene: &str, seed: &str, bias_px: &str) {
    let site = ["synth", "satellite", "--site", "tiny", "--seed", seed];
    json(&[&site[..], &["--pointing-bias", bias_px, "--out", scene]].concat());
}

fn adjusted(scene: &str) -> Option<Value> {
    let scene = shared(scene)?;
    let folder = tempfile::tempdir().expect("a temporary folder");
    Some(json(&["adjust", &text(&scene), "--out", &text(folder.path())]))
}

fn shift(adjustment: &Value, image: usize) -> [f64; 2] {
    let shift = &adjustment["images"][image]["correction"]["shift_px"];
    [number(&shift[0]), number(&shift[1])]
}

#[test]
fn biases_of_three_pixels_are_found_to_a_tenth_and_the_cameras_written_agree() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (scene, out, again) = (
        text(&folder.path().join("scene")),
        folder.path().join("adjusted"),
        text(&folder.path().join("again")),
    );
    synthesise(&scene, "3", "3");
    let first = json(&["adjust", &scene, "--out", &text(&out), "--images"]);
    let error = &first["camera_error"];
    assert!(number(&error["before_rms_px"]) > 2.0, "{error}");
    assert!(number(&error["after_rms_px"]) < 0.1, "{error}");
    for pair in first["pairs"].as_array().expect("pairs") {
        let after = &pair["across_epipolar_after"];
        assert!(number(&after["median_px"]) < 0.3, "{pair}");
    }
    for name in [
        "adjustment.json",
        "adjustment.svg",
        "tiny_003_01_RPC.TXT",
        "tiny_003_01.json",
        "tiny_003_01.tif",
    ] {
        assert!(out.join(name).is_file(), "{name}");
    }
    // The folder written is a scene whose cameras need no more.
    let second = json(&["adjust", &text(&out), "--out", &again]);
    for image in 0..second["images"].as_array().expect("images").len() {
        let [col, row] = shift(&second, image);
        assert!(col.hypot(row) < 0.15, "{}", second["images"][image]);
    }
}

#[test]
fn the_adjustment_does_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = text(&folder.path().join("scene"));
    synthesise(&scene, "2", "1");
    let with = |threads: &str| {
        let out = text(&folder.path().join(threads));
        json(&["adjust", &scene, "--out", &out, "--threads", threads])["images"].clone()
    };
    assert_eq!(with("1"), with("3"));
}

#[test]
fn a_folder_without_a_scene_is_bad_input() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = text(&folder.path().join("out"));
    heliosplat(&["adjust", &text(folder.path()), "--out", &out])
        .assert()
        .code(2);
}

#[test]
fn ventoux_agrees_within_a_quarter_of_a_pixel() {
    let Some(adjustment) = adjusted("data/ventoux") else {
        return;
    };
    let pair = &adjustment["pairs"][0];
    assert!(number(&pair["ties"]) > 500.0, "{pair}");
    assert!(number(&pair["across_epipolar_before"]["rms_px"]) > 3.0, "{pair}");
    assert!(number(&pair["across_epipolar_after"]["rms_px"]) < 0.25, "{pair}");
}

#[test]
fn kahramanmaras_agrees_within_its_dates_and_image_four_is_half_a_pixel_off_its_mate() {
    let Some(adjustment) = adjusted("data/kahramanmaras") else {
        return;
    };
    for pair in adjustment["pairs"].as_array().expect("pairs") {
        let names: Vec<&str> = pair["images"]
            .as_array()
            .expect("names")
            .iter()
            .filter_map(Value::as_str)
            .collect();
        let limit_px = match names[..] {
            ["kahramanmaras_01", "kahramanmaras_02"] | ["kahramanmaras_03", "kahramanmaras_04"] => 0.3,
            _ => 0.5,
        };
        assert!(number(&pair["across_epipolar_after"]["rms_px"]) < limit_px, "{pair}");
    }
    let (third, fourth) = (shift(&adjustment, 2), shift(&adjustment, 3));
    for axis in 0..2 {
        let apart = fourth[axis] - third[axis];
        assert!((apart + 0.5).abs() < 0.15, "{third:?} {fourth:?}");
    }
}
