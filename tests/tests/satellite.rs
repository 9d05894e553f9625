//! The main job end to end on a tiny synthetic site: images in, a DSM near the truth out, and its other products.

use heliosplat_raster::RasterFile;
use heliosplat_tests::program::{fault, json};
use std::path::Path;

/// Mean absolute error that the tiny site must stay below, metres: two ground sampling distances.
const MAE_LIMIT_M: f64 = 1.0;

fn metrics(run: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(run.join("metrics.json")).expect("the run has metrics");
    serde_json::from_str(&text).expect("metrics are JSON")
}

/// Every stage of a run is in its timeline, and together they take no longer than the run.
fn the_timeline_accounts_for_the_time(metrics: &serde_json::Value) {
    let stages = metrics["timeline"].as_array().expect("a timeline");
    let number = |stage: &serde_json::Value, key: &str| stage[key].as_f64().expect("seconds");
    for name in [
        "read", "ties", "sweep", "colours", "train", "products", "evaluate", "report",
    ] {
        let stage = stages.iter().find(|stage| stage["stage"] == name).expect(name);
        assert!(number(stage, "wall_s") > 0.0, "{name}");
        assert!(
            number(stage, "one_core_s") <= number(stage, "processor_s") + 1e-3,
            "{name}"
        );
    }
    let training = stages.iter().find(|stage| stage["stage"] == "train").expect("training");
    let parts = training["parts"].as_array().expect("training has parts");
    assert!(parts.iter().any(|part| part["stage"] == "light, backward"));
    let all_s: f64 = stages.iter().map(|stage| number(stage, "wall_s")).sum();
    let run_s = metrics["seconds"].as_f64().expect("seconds");
    assert!(all_s <= run_s && all_s > 0.8 * run_s, "{all_s} of {run_s} s");
}

#[test]
fn a_tiny_site_becomes_a_surface_model_near_the_truth() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (scene, run) = (folder.path().join("scene"), folder.path().join("run"));
    let arg = |path: &Path| path.to_str().expect("an UTF-8 path").to_owned();
    let (scene, run_arg) = (arg(&scene), arg(&run));
    json(&["synth", "satellite", "--site", "tiny", "--seed", "3", "--out", &scene]);
    json(&[
        "train",
        &scene,
        "--out",
        &run_arg,
        "--preset",
        "fast",
        "--set",
        "train.iterations=40",
        "--threads",
        "2",
    ]);

    let metrics = metrics(&run);
    let mae = metrics["dsm"]["mae_m"]
        .as_f64()
        .expect("there is truth to measure against");
    assert!(mae < MAE_LIMIT_M, "mean absolute error {mae} m");
    assert!(metrics["dsm"]["completeness"].as_f64().expect("completeness") > 0.95);
    assert!(metrics["shadow"]["accuracy"].as_f64().expect("shadows have truth") > 0.7);
    let error = |mask: &serde_json::Value| mask["ber"].as_f64().expect("shadows have truth");
    let (asked, traced) = (error(&metrics["shadow"]), error(&metrics["shadow"]["traced"]));
    assert!(
        asked < traced,
        "{asked} after images say where shadows end, {traced} before"
    );
    assert_eq!(metrics["rejected_steps"].as_u64(), Some(0));
    the_timeline_accounts_for_the_time(&metrics);

    let (dsm, picture) = (folder.path().join("dsm.tif"), folder.path().join("evening.tif"));
    fault(
        &["dsm", &run_arg, "--out", &arg(&dsm), "--gsd", "1", "--crs", "EPSG:4978"],
        2,
    );
    assert!(!dsm.exists(), "a refused surface model leaves nothing behind");
    json(&["dsm", &run_arg, "--out", &arg(&dsm), "--gsd", "1"]);
    json(&["relight", &run_arg, "--out", &arg(&picture), "--sun", "250,25"]);
    assert!(dsm.is_file() && picture.is_file() && picture.with_file_name("evening_shadow.tif").is_file());
    fault(&["relight", &run_arg, "--out", &arg(&picture), "--sun", "250,-3"], 2);
    // Brightness follows the sun: the sine of 25 degrees is 0.49 of that of 60; air and long shadows take some more,
    // and the path radiance of the reference image, which is kept, adds to both.
    let high = folder.path().join("high.tif");
    let relit = json(&["relight", &run_arg, "--out", &arg(&high), "--sun", "250,60"]);
    assert!(
        relit["exposure"]
            .as_str()
            .is_some_and(|text| text.contains("path radiance"))
    );
    let brightness = |path: &Path| {
        let image = RasterFile::open(path)
            .and_then(|file| file.read_all())
            .expect("a relit image");
        let known: Vec<f32> = image.values.iter().copied().filter(|v| v.is_finite()).collect();
        known.iter().map(|&v| f64::from(v)).sum::<f64>() / known.len() as f64
    };
    let ratio = brightness(&picture) / brightness(&high);
    assert!((0.2..0.7).contains(&ratio), "{ratio} as bright");
    json(&["evaluate", &run_arg]);

    let views = folder.path().join("views");
    let rendered = json(&["render", &run_arg, "--out", &arg(&views), "--split", "train"]);
    let first = &rendered["views"][0];
    let path = Path::new(first["shadow"].as_str().expect("a path"));
    let mask = RasterFile::open(path)
        .and_then(|file| file.read_all())
        .expect("a shadow mask");
    let known: Vec<f32> = mask.values.iter().copied().filter(|v| v.is_finite()).collect();
    let dark = known.iter().filter(|&&v| v > 0.5).count() as f64 / known.len() as f64;
    assert!(
        known.iter().all(|v| (0.0..=1.0).contains(v)) && (0.01..0.6).contains(&dark),
        "{dark} in shadow"
    );

    // The sweep alone, from the scene: the surface that the run started from.
    let swept = folder.path().join("swept.tif");
    fault(&["dsm", &run_arg, "--from", "sweep", "--out", &arg(&swept)], 2);
    assert!(!swept.exists());
    let said = json(&["dsm", &scene, "--from", "sweep", "--out", &arg(&swept)]);
    let stages = said["timeline"].as_array().expect("a timeline");
    for name in ["read", "ties", "sweep", "products"] {
        let stage = stages.iter().find(|stage| stage["stage"] == name).expect(name);
        assert!(stage["wall_s"].as_f64().is_some_and(|s| s > 0.0), "{stage}");
    }
    let truth = Path::new(&scene).join("truth").join("dsm.tif");
    let swept = json(&["evaluate", "--dsm", &arg(&swept), "--truth", &arg(&truth)]);
    let (alone, start) = (&swept["dsm"]["mae_m"], &metrics["start"]["mae_m"]);
    let (alone, start) = (alone.as_f64().expect("a number"), start.as_f64().expect("a number"));
    assert!((alone - start).abs() < 0.02, "{alone} m alone, {start} m in the run");
}

#[test]
fn clouds_are_left_out_of_the_images_that_have_them_and_of_no_other() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (scene, run) = (folder.path().join("scene"), folder.path().join("run"));
    let arg = |path: &Path| path.to_str().expect("an UTF-8 path").to_owned();
    let scene_arg = arg(&scene);
    json(&[
        "synth",
        "satellite",
        "--site",
        "tiny",
        "--seed",
        "2",
        "--clouds",
        "2",
        "--out",
        &scene_arg,
    ]);
    let masks = std::fs::read_dir(scene.join("truth")).expect("the truth of the scene");
    let clouded = |name: std::ffi::OsString| name.to_string_lossy().starts_with("cloud_");
    assert_eq!(masks.flatten().filter(|file| clouded(file.file_name())).count(), 2);
    let train = [
        "train",
        &scene_arg,
        "--preset",
        "fast",
        "--set",
        "train.iterations=6",
        "--out",
    ];
    json(&[&train[..], &[&arg(&run)]].concat());
    let shares: Vec<f64> =
        serde_json::from_value(metrics(&run)["clouded"].clone()).expect("a share for each image trained on");
    assert_eq!(shares.len(), 6);
    let found = shares.iter().filter(|share| **share > 0.05);
    assert_eq!(found.count(), 2, "{shares:?}");
    assert!(
        shares.iter().all(|share| *share == 0.0 || (0.05..0.4).contains(share)),
        "{shares:?}"
    );
}
