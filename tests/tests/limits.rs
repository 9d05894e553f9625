//! Limits of time and memory, and their effect: `--time-budget` and `--memory`.

use heliosplat_tests::program::{fault, json};
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
