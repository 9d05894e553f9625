//! User errors: each gets one line that names the file and the remedy, the right exit code, and no half-written file.

use heliosplat::train::TrainOptions;
use heliosplat_fitting::request::{TrainOutcome, TrainRequest};
use heliosplat_fitting::settings::Preset;
use heliosplat_fitting::training::Ending;
use heliosplat_raster::GeoRaster;
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_satellite::training::train;
use heliosplat_scene::{IngestOptions, Scene};
use heliosplat_session::Session;
use heliosplat_tests::program::{fault, heliosplat, json};
use heliosplat_tests::scenes::{Shows, View, write_altitudes, write_scene};
use serde_json::Value;
use std::ffi::OsString;
use std::path::Path;
use tempfile::{TempDir, tempdir};

/// Files in a folder, sorted.
fn listing(folder: &Path) -> Vec<OsString> {
    let mut names: Vec<OsString> = std::fs::read_dir(folder)
        .expect("listable")
        .map(|entry| entry.expect("readable").file_name())
        .collect();
    names.sort();
    names
}

/// Inspects and trains a broken scene: both must fail with the same line and leave the disk unchanged.
fn refused(scene: &Path, said: &[&str]) {
    let home = tempdir().expect("a temporary folder");
    let run = home.path().join("run");
    let before = scene.is_dir().then(|| listing(scene));
    let inspected = fault(&["inspect".as_ref(), scene.as_os_str()], 2);
    let trained = fault(
        &["train".as_ref(), scene.as_os_str(), "--out".as_ref(), run.as_os_str()],
        2,
    );
    assert_eq!(inspected, trained);
    for part in said {
        assert!(inspected.contains(part), "'{part}' is not in '{inspected}'");
    }
    assert!(!run.exists(), "no run is begun");
    assert_eq!(
        before,
        scene.is_dir().then(|| listing(scene)),
        "the scene is left alone"
    );
}

fn scene(views: &[View]) -> TempDir {
    let folder = tempdir().expect("a temporary folder");
    write_scene(folder.path(), views);
    folder
}

#[test]
fn a_sound_scene_is_accepted() {
    let folder = scene(&[View::new(0), View::new(1), View::new(2)]);
    let seen = json(&["inspect".as_ref(), folder.path().as_os_str()]);
    assert_eq!(seen["images"].as_array().map(Vec::len), Some(3));
    assert_eq!(
        seen["warnings"].as_array().map(Vec::len),
        Some(0),
        "{}",
        seen["warnings"]
    );
    assert_eq!(seen["altitude_range_m"], serde_json::json!([690.0, 720.0]));
    assert!((seen["gsd_m"].as_f64().expect("a number") - 0.5).abs() < 0.005);
}

#[test]
fn a_missing_path_is_named() {
    refused(
        Path::new("no/such/scene"),
        &["no/such/scene", "no such file or folder", "scene.toml"],
    );
}

#[test]
fn an_address_is_not_fetched() {
    refused(
        Path::new("https://example.org/scene"),
        &["https://example.org/scene", "download"],
    );
}

#[test]
fn an_empty_folder_is_named() {
    let folder = scene(&[]);
    refused(
        folder.path(),
        &[&folder.path().display().to_string(), "no images found"],
    );
}

#[test]
fn a_missing_rpc_names_the_image_and_what_to_add() {
    let bare = View {
        has_rpc: false,
        ..View::new(1)
    };
    let folder = scene(&[View::new(0), bare]);
    refused(folder.path(), &["view_1.tif", "no RPC", ".RPB"]);
}

#[test]
fn a_file_that_is_no_image_is_named() {
    let folder = scene(&[View::new(0), View::new(1)]);
    std::fs::write(folder.path().join("view_2.tif"), "this is no image").expect("written");
    refused(folder.path(), &["view_2.tif", "not an image"]);
}

#[test]
fn a_truncated_image_is_named() {
    let folder = scene(&[View::new(0), View::new(1)]);
    let path = folder.path().join("view_1.tif");
    let bytes = std::fs::read(&path).expect("readable");
    std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("written");
    refused(folder.path(), &["view_1.tif", "fetch it again"]);
}

#[test]
fn images_that_do_not_overlap_are_both_named() {
    let far = View {
        centre_m: [500.0, 0.0],
        ..View::new(1)
    };
    let folder = scene(&[View::new(0), far]);
    refused(folder.path(), &["view_0.tif", "view_1.tif", "does not overlap"]);
}

#[test]
fn one_stranger_among_many_is_left_out_with_a_warning() {
    let far = View {
        centre_m: [0.0, 900.0],
        ..View::new(3)
    };
    let folder = scene(&[View::new(0), View::new(1), View::new(2), far]);
    let seen = json(&["inspect".as_ref(), folder.path().as_os_str()]);
    assert_eq!(seen["images"].as_array().map(Vec::len), Some(3));
    assert!(
        seen["warnings"][0]
            .as_str()
            .is_some_and(|line| line.contains("view_3.tif")),
        "{seen}"
    );
}

/// The only finding on a scene, which is one of this code, and whether each image has a sun.
fn finding_and_suns(folder: &Path, code: &str) -> (Value, Vec<bool>) {
    let seen = json(&["inspect".as_ref(), folder.as_os_str()]);
    let findings = seen["findings"].as_array().expect("findings");
    assert!(findings.len() == 1 && findings[0]["code"] == code, "{findings:?}");
    let images = seen["images"].as_array().expect("images").iter();
    let has_sun = images.map(|image| image["sun"]["elevation_deg"].is_number());
    (findings[0].clone(), has_sun.collect())
}

#[test]
fn a_sun_below_the_horizon_is_unknown_and_its_time_is_named() {
    let night = View {
        date: Some("20160423203400"),
        ..View::new(1)
    };
    let folder = scene(&[View::new(0), night]);
    let (finding, has_sun) = finding_and_suns(folder.path(), "sun-below-horizon");
    let message = finding["message"].as_str().expect("a line");
    for word in [
        "view_1.tif",
        "below the horizon",
        "2016-04-23T20:34:00Z",
        "correct the time",
    ] {
        assert!(message.contains(word), "{word} in {message}");
    }
    assert_eq!(has_sun, [true, false]);
}

#[test]
fn metadata_that_put_the_sun_below_the_horizon_are_not_used() {
    let night = View {
        date: None,
        sun_deg: Some([150.0, -3.0]),
        ..View::new(1)
    };
    let folder = scene(&[View::new(0), night]);
    let (finding, has_sun) = finding_and_suns(folder.path(), "sun-below-horizon");
    assert!(
        (finding["value"].as_f64().expect("an elevation") + 3.0).abs() < 1e-9,
        "{finding}"
    );
    assert_eq!(has_sun, [true, false]);
}

#[test]
fn a_single_view_is_not_enough() {
    let folder = scene(&[View::new(0)]);
    refused(folder.path(), &["1 training image;", "at least two"]);
}

#[test]
fn more_bands_than_a_model_renders_are_refused_before_anything_is_computed() {
    let of_bands = |number: usize, bands: usize| View {
        bands,
        ..View::new(number)
    };
    let folder = scene(&[of_bands(0, 13), of_bands(1, 13)]);
    refused(
        folder.path(),
        &["view_0.tif", "13 bands", "12 at most", "gdal_translate"],
    );
    // Twelve are inspected as any others.
    let folder = scene(&[of_bands(0, 12), of_bands(1, 12)]);
    heliosplat(&["inspect".as_ref(), folder.path().as_os_str()])
        .assert()
        .success();
}

#[test]
fn mixed_band_counts_name_both_images() {
    let colour = View {
        bands: 3,
        ..View::new(1)
    };
    let folder = scene(&[View::new(0), colour]);
    refused(folder.path(), &["view_1.tif", "view_0.tif", "3 bands", "1 band (pan)"]);
}

#[test]
fn a_mistake_in_a_scene_toml_names_its_line() {
    let folder = scene(&[View::new(0), View::new(1)]);
    let manifest = folder.path().join("scene.toml");
    std::fs::write(&manifest, "[[images]]\npath = \"view_0.tif\"\nsplitt = \"train\"\n").expect("written");
    refused(folder.path(), &["scene.toml", "line 3", "splitt"]);
    std::fs::write(&manifest, "[[images]]\npath = \"view_9.tif\"\n").expect("written");
    refused(&manifest, &["view_9.tif", "no such file"]);
    std::fs::write(&manifest, "[[images]]\npath = \"http://example.org/a.tif\"\n").expect("written");
    refused(folder.path(), &["http://example.org/a.tif", "download"]);
}

#[test]
fn an_altitude_range_upside_down_is_explained() {
    let folder = scene(&[View::new(0), View::new(1)]);
    let scene = folder.path().as_os_str();
    let line = fault(
        &["inspect".as_ref(), scene, "--altitude".as_ref(), "780,640".as_ref()],
        2,
    );
    assert!(line.contains("780") && line.contains("MIN below MAX"), "{line}");
}

#[test]
fn with_json_a_fault_is_one_object_on_stdout_too() {
    let assert = heliosplat(&["inspect", "no/such/scene", "--json"]).assert().code(2);
    let object: serde_json::Value = serde_json::from_slice(&assert.get_output().stdout).expect("one JSON object");
    assert_eq!(object["exit_code"], 2);
    assert!(
        object["error"]
            .as_str()
            .is_some_and(|line| line.contains("no/such/scene"))
    );
}

#[test]
fn bad_usage_is_exit_code_2() {
    for arguments in [
        &["train"][..],
        &["relight", "run", "--out", "a.tif"],
        &["nonsense"],
        &["sun", "--at", "1,2"],
    ] {
        heliosplat(arguments).assert().code(2);
    }
}

/// Runs a command whose output folder is a file system of 32 KiB; `None` where such a thing cannot be made here.
fn on_a_full_disk(arguments: &str, folder: &Path) -> Option<std::process::Output> {
    on_a_disk("size=32k", arguments, folder)
}

/// Runs a command whose output folder is a file system with these options; `None` where such a thing cannot be made
/// here.
fn on_a_disk(options: &str, arguments: &str, folder: &Path) -> Option<std::process::Output> {
    let probe = format!("mount -t tmpfs -o {options} tmpfs \"$FOLDER\"");
    let unshare = |script: &str| {
        let mut command = std::process::Command::new("unshare");
        command
            .args(["--user", "--map-root-user", "--mount", "sh", "-c", script])
            .env("FOLDER", folder);
        command.output().ok()
    };
    if !unshare(&probe)?.status.success() {
        return None;
    }
    let program = heliosplat_tests::program::binary().display();
    let script = format!(
        "{probe} && \"{program}\" {arguments}; code=$?; cd \"$FOLDER\" && find . -mindepth 1 -printf '%P\\n'; exit $code"
    );
    unshare(&script)
}

/// Files left by a command that must fail with exit code 1 because the disk is full at `file`.
fn left_on_a_full_disk(arguments: &str, folder: &Path, file: &str) -> Option<String> {
    let Some(output) = on_a_full_disk(arguments, folder) else {
        println!("skipped: no small file system can be mounted here");
        return None;
    };
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains(file) && said.contains("disk is full"), "{said}");
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[test]
fn a_full_disk_is_exit_code_1_names_the_file_and_leaves_nothing() {
    let home = tempdir().expect("a temporary folder");
    let full = home.path().join("full");
    std::fs::create_dir(&full).expect("made");
    let mut noise = heliosplat::Raster::filled(300, 300, 1, 0.0);
    let mut state = 1u32;
    for value in &mut noise.values {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *value = 700.0 + (state >> 16) as f32 / 6553.6;
    }
    let dsm = home.path().join("dsm.tif");
    write_altitudes(&dsm, &noise, 312_000.0, 4_160_000.0);
    let truth = home.path().join("truth.tif");
    write_altitudes(
        &truth,
        &heliosplat::Raster::filled(300, 300, 1, 705.0),
        312_000.0,
        4_160_000.0,
    );
    let arguments = format!(
        "evaluate --dsm {} --truth {} --error-map {}/errors.png",
        dsm.display(),
        truth.display(),
        full.display()
    );
    if let Some(left) = left_on_a_full_disk(&arguments, &full, "errors.png") {
        assert!(left.is_empty(), "nothing is left: {left}");
    }
}

#[test]
fn training_onto_a_full_disk_is_exit_code_1_and_leaves_no_half_run() {
    let home = scene(&[View::new(0), View::new(1), View::new(2)]);
    let full = home.path().join("full");
    std::fs::create_dir(&full).expect("made");
    let arguments = format!(
        "train {} --out {}/run --preset fast --altitude 690,710 --set train.iterations=1",
        home.path().display(),
        full.display()
    );
    if let Some(left) = left_on_a_full_disk(&arguments, &full, "model.ply") {
        assert_eq!(left.trim(), "run\nrun/log.txt", "the log at most: {left}");
    }
}

#[test]
fn a_training_whose_checkpoints_find_no_room_goes_on_and_leaves_none_half_written() {
    let home = scene(&[View::new(0), View::new(1), View::new(2)]);
    let full = home.path().join("full");
    std::fs::create_dir(&full).expect("made");
    let arguments = format!(
        "train {} --out {}/run --preset fast --altitude 690,710 --set train.iterations=3 --checkpoint-every 0",
        home.path().display(),
        full.display()
    );
    let Some(output) = on_a_full_disk(&arguments, &full) else {
        println!("skipped: no small file system can be mounted here");
        return;
    };
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("no checkpoint") && said.contains("model.ply"), "{said}");
    let left = String::from_utf8_lossy(&output.stdout).into_owned();
    let expected = ["run", "run/checkpoint", "run/log.txt"];
    assert!(
        left.lines().all(|line| expected.contains(&line)),
        "folders and the log at most: {left}"
    );
}

#[test]
fn a_folder_that_may_only_be_read_is_told_before_any_work() {
    let home = scene(&[View::new(0), View::new(1), View::new(2)]);
    let locked = home.path().join("locked");
    std::fs::create_dir(&locked).expect("made");
    std::fs::write(
        home.path().join("batch.toml"),
        "[[images]]\nname = \"a\"\nscene = \".\"\n[[areas]]\nname = \"b\"\naltitude_m = [690.0, 710.0]\n",
    )
    .expect("written");
    let scene = home.path().display();
    for verb in [
        format!("train {scene} --altitude 690,710"),
        format!("batch {scene}/batch.toml"),
    ] {
        let arguments = format!("{verb} --out {}/run", locked.display());
        let Some(output) = on_a_disk("ro", &arguments, &locked) else {
            println!("skipped: no file system can be mounted here");
            return;
        };
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(
            said.contains("the folder cannot be made") && !said.contains("panicked"),
            "{said}"
        );
        assert!(output.stdout.is_empty(), "nothing is left");
    }
}

/// Arguments of a training of a few steps.
fn training<'a>(scene: &'a Path, run: &'a Path, more: &[&'a str]) -> Vec<std::ffi::OsString> {
    let mut arguments: Vec<OsString> = ["train".into(), scene.into(), "--out".into(), run.into()].to_vec();
    arguments.extend(["--preset", "fast", "--altitude", "690,710"].map(OsString::from));
    arguments.extend(more.iter().map(OsString::from));
    arguments
}

#[test]
fn images_of_nothing_of_one_glint_and_of_one_half_train_or_say_why_not() {
    for shows in [Shows::Nothing, Shows::OneGlint, Shows::Half] {
        let views = [0, 1, 2].map(|number| View {
            shows,
            ..View::new(number)
        });
        let home = scene(&views);
        let run = home.path().join("run");
        let output = heliosplat(&training(
            home.path(),
            &run,
            &["--json", "--set", "train.iterations=40"],
        ))
        .output()
        .expect("runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!said.contains("panicked"), "{shows:?}: {said}");
        match output.status.code() {
            Some(0) => {
                let metrics: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
                assert_eq!(metrics["rejected_steps"], 0, "{shows:?}");
                assert!(
                    metrics["train"]["psnr"].as_f64().is_none_or(f64::is_finite),
                    "{shows:?}: {}",
                    metrics["train"]
                );
            }
            code => assert!(
                matches!(code, Some(1 | 2)) && said.contains("error: "),
                "{shows:?}: {code:?} {said}"
            ),
        }
    }
}

#[test]
fn training_that_finds_no_finite_step_fails_says_where_and_leaves_no_run() {
    let home = scene(&[View::new(0), View::new(1), View::new(2)]);
    let run = home.path().join("run");
    let line = fault(
        &training(
            home.path(),
            &run,
            &[
                "--set",
                "train.consistency_weight=3e38",
                "--set",
                "train.consistency_every=1",
            ],
        ),
        1,
    );
    assert!(
        line.contains("20 steps in a row") && line.contains("the gradient to '"),
        "{line}"
    );
    assert!(!run.exists(), "no run is left");
}

#[test]
fn training_that_goes_astray_keeps_its_last_good_state_and_says_why_it_stopped() {
    let home = scene(&[View::new(0), View::new(1), View::new(2)]);
    let run = home.path().join("run");
    let mut config = SatelliteConfig::resolve(Preset::Fast, &[], 1).expect("a preset");
    // Rates that grow instead of falling, which no user can set: after some steps colours are so bright that gradients
    // are not finite.
    config.train = TrainOptions {
        iterations: 120,
        epochs: 40,
        patience: 1000,
        position_rate_gsd: 0.0,
        final_rate: 1e30,
        ..config.train
    };
    let ingest = IngestOptions::default();
    let read = Scene::open(home.path(), &ingest).expect("a scene");
    let request = TrainRequest::new(run.clone(), Preset::Fast);
    let outcome = train(&read, &ingest, &config, &request, &Session::quiet()).expect("a run of the last good state");
    let TrainOutcome::Trained(trained) = outcome else {
        panic!("there was no run before")
    };
    let Ending::GaveUp(error) = &trained.ending else {
        panic!("it went on to the end: {:?}", trained.ending)
    };
    assert!(trained.ending.check(&run).is_err());
    let line = error.to_string();
    for part in [
        "20 steps in a row",
        "is not finite, last in view view_",
        "the last good state is kept",
    ] {
        assert!(line.contains(part), "'{part}' is not in '{line}'");
    }
    let model = heliosplat_products::model::load(&run).expect("a run that can be read");
    assert!(model.parameters.is_finite() && model.parameters.gaussians.count > 100);
    let text = std::fs::read_to_string(run.join("metrics.json")).expect("metrics");
    let metrics: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert!(metrics["rejected_steps"].as_u64().is_some_and(|n| n >= 20), "{metrics}");
    assert_eq!(
        metrics["training"],
        serde_json::Value::Null,
        "it is not taken for finished"
    );
    // Its ground is usable: flat, and at the right place.
    let dsm = home.path().join("dsm.tif");
    heliosplat(&["dsm".as_ref(), run.as_os_str(), "--out".as_ref(), dsm.as_os_str()])
        .assert()
        .success();
    let surface = GeoRaster::read(&dsm).expect("a surface model").raster;
    let mut altitudes: Vec<f32> = surface.plane(0).iter().copied().filter(|z| z.is_finite()).collect();
    altitudes.sort_by(f32::total_cmp);
    let middle = altitudes.get(altitudes.len() / 2).copied().expect("a surface");
    assert!((middle - 700.0).abs() < 2.0, "{middle} m");
}

#[test]
fn settings_that_mean_nothing_are_named() {
    let home = scene(&[View::new(0), View::new(1)]);
    let run = home.path().join("run");
    for (set, said) in [
        (
            "train.pyramid_share=1.5",
            "train.pyramid_share is 1.5, expected a number from 0 to 1",
        ),
        (
            "model.sh_degree=4",
            "model.sh_degree is 4, expected a whole number from 0 to 3",
        ),
        ("train.position_rate_gsd=nan", "train.position_rate_gsd is NaN"),
    ] {
        let line = fault(&training(home.path(), &run, &["--set", set]), 2);
        assert!(line.contains(said), "{line}");
    }
}

#[test]
fn an_image_without_contrast_is_named() {
    let views = [Shows::Waves, Shows::Nothing, Shows::Waves];
    let views: Vec<View> = (0..3)
        .map(|number| View {
            shows: views[number],
            ..View::new(number)
        })
        .collect();
    let home = scene(&views);
    let dsm = home.path().join("dsm.tif");
    let mut arguments: Vec<OsString> = ["dsm".into(), home.path().into(), "--out".into(), dsm.clone().into()].to_vec();
    arguments.extend(["--from", "sweep", "--altitude", "690,710"].map(OsString::from));
    let line = fault(&arguments, 2);
    assert!(line.contains("view_1.tif") && line.contains("contrast"), "{line}");
    assert!(!dsm.exists());
}
