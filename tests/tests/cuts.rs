//! A run is measured on the pixels that it was trained on: the same windows, cameras and scale, or it is refused in one
//! line.

use heliosplat_raster::write::{ImageSpec, SampleType, write_geotiff};
use heliosplat_raster::{RasterFile, Window};
use heliosplat_rpc::write::gdal_domain;
use heliosplat_tests::program::{binary, fault, heliosplat, json};
use heliosplat_tests::scenes::{Shows, View, write_scene};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::{TempDir, tempdir};

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Three views and a run on them.
struct Trained {
    _home: TempDir,
    scene: PathBuf,
    run: PathBuf,
}

impl Trained {
    fn new(options: &[&str]) -> Self {
        let home = tempdir().expect("a temporary folder");
        let [scene, run] = ["scene", "run"].map(|name| home.path().join(name));
        fs::create_dir(&scene).expect("made");
        write_scene(&scene, &[0, 1, 2].map(View::new));
        let trained = Self {
            _home: home,
            scene,
            run,
        };
        trained.train(options);
        trained
    }

    fn train(&self, options: &[&str]) {
        let (scene, run) = (text(&self.scene), text(&self.run));
        let words = ["train", &scene, "--out", &run, "--preset", "preview"];
        let set = ["--altitude", "690,710", "--set", "train.iterations=12"];
        json(&[&words[..], &set, options].concat());
    }

    /// Scores of the run's images.
    fn figures(&self) -> Value {
        let metrics = json(&["evaluate", &text(&self.run)]);
        assert!(metrics["train"]["psnr"].is_number(), "{metrics}");
        metrics["train"].clone()
    }

    /// `evaluate` and `render` refuse the scene and name the difference.
    fn is_refused(&self, image: &str, difference: &str) {
        let (run, out) = (text(&self.run), text(&self.run.join("again")));
        for words in [
            &["evaluate", &run][..],
            &["render", &run, "--split", "all", "--out", &out],
        ] {
            let line = fault(words, 2);
            assert!(
                line.contains(difference) && line.contains(image),
                "{difference}: {line}"
            );
        }
    }
}

#[test]
fn an_added_image_changes_no_figure_of_a_run() {
    let trained = Trained::new(&[]);
    let before = trained.figures();
    // It widens the ground seen twice, and is brighter than the others.
    let added = View {
        centre_m: [12.0, 0.0],
        shows: Shows::OneGlint,
        ..View::new(3)
    };
    added.write(&trained.scene);
    assert_eq!(trained.figures(), before);
    // Splits and meanings of values are those of the training too.
    let images = [0, 1, 2].map(|number| {
        let split = if number == 0 { "test" } else { "train" };
        format!("[[images]]\npath = \"view_{number}.tif\"\nsplit = \"{split}\"\n")
    });
    fs::write(trained.scene.join("scene.toml"), images.concat()).expect("written");
    assert_eq!(trained.figures(), before);
}

#[test]
fn a_scene_that_has_changed_is_refused_with_the_first_difference() {
    let trained = Trained::new(&[]);
    let before = trained.figures();
    let image = trained.scene.join("view_1.tif");
    let bytes = fs::read(&image).expect("an image");
    fs::remove_file(&image).expect("removed");
    trained.is_refused("view_1", "missing");
    let four = View {
        bands: 4,
        ..View::new(1)
    };
    four.write(&trained.scene);
    trained.is_refused("view_1.tif", "other bands");
    let glint = View {
        shows: Shows::OneGlint,
        ..View::new(1)
    };
    glint.write(&trained.scene);
    trained.is_refused("view_1.tif", "has changed");
    let window = Window {
        col0: 0,
        row0: 0,
        width: 60,
        height: 50,
    };
    let crop = RasterFile::open(&image)
        .expect("an image")
        .read(window, &[0])
        .expect("pixels");
    let rpc: Vec<_> = gdal_domain(&View::new(1).rpc()).into_iter().collect();
    let spec = ImageSpec {
        rpc: &rpc,
        ..ImageSpec::plain(&crop)
    };
    write_geotiff(&image, &spec, SampleType::U16).expect("written");
    trained.is_refused("view_1.tif", "60 x 50 pixels");
    // The same bytes, written at another time, are the same image.
    fs::write(&image, &bytes).expect("written");
    assert_eq!(trained.figures(), before);
    let json = image.with_extension("json");
    let other = fs::read_to_string(trained.scene.join("view_2.json")).expect("a JSON");
    fs::write(&json, other.replace("view_2", "view_1")).expect("written");
    trained.is_refused("view_1.tif", "the camera of");
    fs::remove_file(json).expect("removed");
    trained.is_refused("view_1.tif", "is that of image, not that of view_1.json");
    fs::remove_file(trained.run.join("cut.json")).expect("removed");
    let line = fault(&["evaluate", &text(&trained.run)], 2);
    assert!(
        line.contains("cut.json") && line.contains("train the run again"),
        "{line}"
    );
}

#[test]
fn the_camera_that_was_trained_on_is_the_one_that_is_evaluated() {
    let trained = Trained::new(&["--rpc", "image"]);
    let before = trained.figures();
    for number in 0..3 {
        let path = trained.scene.join(format!("view_{number}.json"));
        let mut json: Value = serde_json::from_slice(&fs::read(&path).expect("a JSON")).expect("a JSON");
        let offset = json["rpc"]["row_offset"].as_f64().expect("a number");
        json["rpc"]["row_offset"] = (offset + 20.0).into();
        fs::write(&path, json.to_string()).expect("written");
    }
    assert_eq!(
        trained.figures(),
        before,
        "the cameras of the JSON files were not asked for"
    );
}

#[test]
fn a_run_whose_scene_is_gone_is_rendered_without_it() {
    let trained = Trained::new(&[]);
    fs::remove_dir_all(&trained.scene).expect("removed");
    let out = text(&trained.run.join("again"));
    let views = json(&["render", &text(&trained.run), "--split", "all", "--out", &out]);
    assert_eq!(views["views"].as_array().map(Vec::len), Some(3));
    let line = fault(&["evaluate", &text(&trained.run)], 2);
    assert!(line.contains(&text(&trained.scene)), "{line}");
    heliosplat(&["report", &text(&trained.run)]).assert().success();
}

/// Number of times that a command opens each of three images, counted by strace; `None` without strace.
fn opens(words: &[&str]) -> Option<Vec<usize>> {
    let home = tempdir().expect("a temporary folder");
    let log = text(&home.path().join("opens"));
    let traced = Command::new("strace")
        .args(["-f", "-e", "trace=open,openat,openat2", "-o", &log])
        .arg(binary())
        .args(words)
        .output();
    traced.is_ok_and(|output| output.status.success()).then(|| {
        let log = fs::read_to_string(&log).expect("a log");
        let of_image = |number: usize| log.matches(&format!("/view_{number}.tif\"")).count();
        (0..3).map(of_image).collect()
    })
}

#[test]
fn an_image_is_opened_at_most_twice_by_inspect_and_three_times_by_a_training() {
    let home = tempdir().expect("a temporary folder");
    let (scene, run) = (text(&home.path().join("scene")), text(&home.path().join("run")));
    fs::create_dir(&scene).expect("made");
    write_scene(Path::new(&scene), &[0, 1, 2].map(View::new));
    let Some(inspected) = opens(&["inspect", &scene]) else {
        eprintln!("skipped: strace is not there, or may not trace");
        return;
    };
    assert_eq!(inspected, [2; 3]);
    let words = ["train", &scene, "--out", &run, "--preset", "preview"];
    let set = ["--altitude", "690,710", "--set", "train.iterations=12"];
    assert_eq!(opens(&[&words[..], &set].concat()), Some(vec![3; 3]));
}
