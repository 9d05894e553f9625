//! Limits of time and memory, and their effect: `--time-budget`, `--memory`, `tradeoff`.

use heliosplat_tests::program::{fault, heliosplat, json};
use heliosplat_tests::scenes::{View, write_scene};
use std::path::Path;
use tempfile::tempdir;

fn three_views(folder: &Path) {
    write_scene(folder, &[View::new(0), View::new(1), View::new(2)]);
}

#[test]
fn a_scene_that_does_not_fit_into_memory_is_refused_before_training() {
    let home = tempdir().expect("a temporary folder");
    three_views(home.path());
    let (scene, run) = (home.path().as_os_str(), home.path().join("run"));
    let train = |more: &[&str]| {
        let mut arguments = vec!["train".as_ref(), scene, "--out".as_ref(), run.as_os_str()];
        arguments.extend(more.iter().map(std::ffi::OsStr::new));
        fault(&arguments, 2)
    };
    let line = train(&["--memory", "20MiB"]);
    assert!(line.contains("--memory") && line.contains("start.cell_gsd="), "{line}");
    assert!(!run.exists(), "no run is begun");
}

#[test]
fn a_training_takes_the_steps_that_fit_into_its_time_and_one_where_none_does() {
    let home = tempdir().expect("a temporary folder");
    three_views(home.path());
    let run = home.path().join("run");
    let trained = json(&[
        "train".as_ref(),
        home.path().as_os_str(),
        "--out".as_ref(),
        run.as_os_str(),
        "--preset".as_ref(),
        "preview".as_ref(),
        "--time-budget".as_ref(),
        "0.001s".as_ref(),
    ]);
    assert_eq!(trained["iterations"], 1);
    assert!(run.join("dsm.tif").is_file());
}

#[test]
fn inspect_states_the_steps_and_the_memory_of_each_preset() {
    let home = tempdir().expect("a temporary folder");
    three_views(home.path());
    let seen = json(&["inspect".as_ref(), home.path().as_os_str()]);
    let of = |key: &str| {
        ["preview", "fast", "balanced", "accurate", "best"]
            .map(|preset| seen["estimates"][preset][key].as_f64().expect("a number"))
    };
    let (steps, bytes) = (of("steps"), of("peak_bytes"));
    assert!(steps.is_sorted() && steps[0] < steps[4], "{steps:?}");
    assert!(bytes[0] > 1e7 && bytes[0] < bytes[1], "{bytes:?}");
}

#[test]
fn a_tradeoff_measures_its_points_once_and_writes_table_and_page() {
    let home = tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    std::fs::create_dir(&scene).expect("made");
    three_views(&scene);
    let points = home.path().join("points.toml");
    let point = |name: &str, more: &str| {
        format!("[[point]]\nname = \"{name}\"\naxis = \"steps\"\npreset = \"fast\"\nwhy = \"a test\"\n{more}\n")
    };
    let text = point("none", "set = { \"train.iterations\" = 0 }")
        + &point(
            "one",
            "base = \"none\"\nseeds = \"all\"\nset = { \"train.iterations\" = 1 }",
        );
    std::fs::write(&points, text).expect("written");
    let out = home.path().join("out");
    let arguments = [
        "tradeoff".as_ref(),
        scene.as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
        "--points".as_ref(),
        points.as_os_str(),
        "--seeds".as_ref(),
        "2".as_ref(),
    ];
    let seen = json(&arguments);
    assert_eq!(seen["trainings"].as_array().map(Vec::len), Some(3));
    assert_eq!(seen.pointer("/summary/points/1/against_base/pairs"), Some(&1.into()));
    let table = std::fs::read_to_string(out.join("tradeoff.csv")).expect("a table");
    assert_eq!(table.lines().count(), 4, "{table}");
    let page = std::fs::read_to_string(out.join("tradeoff.html")).expect("a page");
    assert!(page.contains("<svg") && page.contains("none"));

    // A second time nothing is trained: the metrics stay the files they were.
    let metrics = out.join("runs/scene/one-2/metrics.json");
    let written = |path: &Path| path.metadata().and_then(|m| m.modified()).expect("there");
    let before = written(&metrics);
    heliosplat(&arguments).assert().success();
    assert_eq!(before, written(&metrics));
}
