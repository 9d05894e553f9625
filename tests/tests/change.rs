//! Buildings built and torn down between the images, end to end on a tiny synthetic site.

use heliosplat_raster::RasterFile;
use heliosplat_tests::program::json;
use std::path::Path;

/// Least precision and recall of the changed area; 0.90 and 0.92 when the test was written.
const LEAST: f64 = 0.75;
/// Mean absolute error that the surface at the first image must stay below, metres: two ground sampling distances.
const MAE_LIMIT_M: f64 = 1.0;

fn text(path: &Path) -> String {
    path.to_str().expect("an UTF-8 path").to_owned()
}

/// The change in `metrics.json` of a training, for a site of which a share of the houses is built or torn down.
fn change(folder: &Path, share: &str) -> serde_json::Value {
    let (scene, run) = (text(&folder.join("scene")), text(&folder.join("run")));
    let words = format!("synth satellite --site tiny --seed 4 --views 12 --change {share} --out");
    json(&words.split(' ').chain([scene.as_str()]).collect::<Vec<_>>());
    let preset = ["--preset", "fast", "--set", "train.epochs=1"];
    let command = ["train", scene.as_str(), "--out", run.as_str()];
    json(&[&command[..], &preset[..]].concat());
    let metrics = std::fs::read_to_string(folder.join("run/metrics.json")).expect("the run has metrics");
    let metrics: serde_json::Value = serde_json::from_str(&metrics).expect("metrics are JSON");
    metrics["change"].clone()
}

#[test]
fn houses_that_come_and_go_are_found_with_their_days_and_both_states_stay() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let change = change(folder.path(), "0.6");
    let truth = &change["truth"];
    for key in ["precision", "recall", "right_day"] {
        assert!(truth[key].as_f64().expect(key) > LEAST, "{key}: {truth}");
    }
    let mae_m = change["dsm_before"]["mae_m"].as_f64().expect("an error");
    assert!(mae_m < MAE_LIMIT_M, "{mae_m} m");
    // The surface of a day before the first image is the old state: it differs from the last one by the values of
    // `change.tif`.
    let run = folder.path().join("run");
    let before = folder.path().join("before.tif");
    json(&["dsm", &text(&run), "--out", &text(&before), "--at", "2000-01-01"]);
    let first = |path: &Path| {
        let file = RasterFile::open(path).expect("a GeoTIFF");
        file.read(file.whole(), &[0]).expect("its first band").values
    };
    let (now, then) = (first(&run.join("dsm.tif")), first(&before));
    let difference = first(&run.join("change.tif"));
    let mut changed = 0;
    for ((now, then), difference) in now.iter().zip(&then).zip(&difference) {
        let known = [now, then, difference]
            .into_iter()
            .all(|z| z.is_finite() && *z > -9000.0);
        if known && difference.abs() > 2.5 {
            changed += 1;
            assert!((now - then - difference).abs() < 0.05, "{now} {then} {difference}");
        }
    }
    assert!(changed > 200, "{changed} cells");
}

#[test]
fn nothing_changed_where_no_house_did() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let change = change(folder.path(), "0");
    assert_eq!(change["segments"], 0, "{change}");
}
