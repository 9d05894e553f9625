//! Captures of objects through the program: made, recognised, trained, measured, rendered; and their faults reported.

use heliosplat_tests::program::{fault, heliosplat, json};
use serde_json::{Value, json};
use std::path::Path;
use tempfile::{TempDir, tempdir};

/// A small capture of an object.
fn capture(views: usize) -> TempDir {
    let folder = tempdir().expect("a temporary folder");
    let (out, views) = (folder.path().display().to_string(), views.to_string());
    let arguments = [
        "synth", "object", "--out", &out, "--views", &views, "--size", "64", "--paths", "9", "--seed", "3",
    ];
    heliosplat(&arguments).assert().success();
    folder
}

fn train(capture: &Path, run: &Path, more: &[&str]) -> Value {
    let (capture, run) = (capture.display().to_string(), run.display().to_string());
    let mut arguments = vec![
        "train",
        &capture,
        "--out",
        &run,
        "--preset",
        "fast",
        "--set",
        "start.gaussians=1500",
    ];
    arguments.extend(more);
    json(&arguments)
}

#[test]
fn a_capture_is_recognised_trained_measured_and_rendered() {
    let (capture, home) = (capture(16), tempdir().expect("a temporary folder"));
    let seen = json(&["inspect".as_ref(), capture.path().as_os_str()]);
    assert_eq!((seen["train"].as_u64(), seen["test"].as_u64()), (Some(16), Some(15)));
    assert_eq!(seen["background"], json!([1.0, 1.0, 1.0]));

    let run = home.path().join("run");
    let metrics = train(capture.path(), &run, &["--set", "train.iterations=500"]);
    let psnr = metrics.pointer("/test/psnr").and_then(Value::as_f64).expect("a score");
    assert!(psnr > 22.0, "{psnr}");
    for file in [
        "run.toml",
        "model.ply",
        "model.json",
        "metrics.json",
        "views/test_r_003.png",
    ] {
        assert!(run.join(file).is_file(), "{file}");
    }
    let stages = metrics["timeline"].as_array().expect("a timeline");
    for name in ["read", "trials", "start", "train", "save", "evaluate", "report"] {
        let stage = stages.iter().find(|stage| stage["stage"] == name).expect(name);
        assert!(stage["wall_s"].as_f64().is_some_and(|s| s > 0.0), "{stage}");
    }
    let wall_s: f64 = stages.iter().filter_map(|stage| stage["wall_s"].as_f64()).sum();
    let run_s = metrics["seconds"].as_f64().expect("seconds");
    assert!(wall_s <= run_s && wall_s > 0.8 * run_s, "{wall_s} of {run_s} s");
    // The saved model is the measured one.
    let again = json(&["evaluate".as_ref(), run.as_os_str()]);
    let same = again.pointer("/test/psnr").and_then(Value::as_f64).expect("a score");
    assert!((same - psnr).abs() < 1e-9, "{same} {psnr}");

    let rendered = home.path().join("rendered");
    let arguments = [
        "render".as_ref(),
        run.as_os_str(),
        "--out".as_ref(),
        rendered.as_os_str(),
    ];
    let written = json(&arguments);
    assert_eq!(written["views"].as_array().map(Vec::len), Some(15));
    assert!(rendered.join("test_r_000.png").is_file());
    its_page_needs_nothing_else(&run, &metrics);
}

/// Training writes the page, `report` writes the same again, and its curve has the accuracy of the model.
fn its_page_needs_nothing_else(run: &Path, metrics: &Value) {
    let path = run.join("report.html");
    let page = std::fs::read_to_string(&path).expect("train writes it");
    for part in [
        "Held-out images",
        "Light components",
        "PSNR of held-out images, dB",
        "Component plan",
        "Time and memory",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("http") && !page.contains("<script") && !page.contains("<link"));
    let sources = page.matches("src=").count();
    assert!(sources > 30 && sources == page.matches("src=\"data:image/jpeg;base64,").count());
    json(&["report".as_ref(), run.as_os_str()]);
    assert!(
        page == std::fs::read_to_string(&path).expect("readable"),
        "the same page again"
    );

    let curve = metrics["curve"].as_array().expect("a curve");
    let psnrs: Vec<f64> = curve
        .iter()
        .filter_map(|point| point.pointer("/accuracy/psnr_db")?.as_f64())
        .collect();
    assert!((8..=25).contains(&psnrs.len()), "{psnrs:?}");
    assert!(psnrs[psnrs.len() - 1] > psnrs[0], "{psnrs:?}");
}

#[test]
fn a_training_is_the_same_bytes_for_any_number_of_threads() {
    let (capture, home) = (capture(6), tempdir().expect("a temporary folder"));
    let trained = |threads: &str| {
        let run = home.path().join(threads);
        train(
            capture.path(),
            &run,
            &["--set", "train.iterations=60", "--threads", threads],
        );
        std::fs::read(run.join("model.ply")).expect("a model")
    };
    assert!(trained("1") == trained("3"));
}

/// A capture whose list of training images is changed must be refused by `inspect` and `train` with one line, and no
/// run begun.
fn refused(change: &dyn Fn(&mut Value, &Path), said: &[&str]) {
    let (capture, home) = (capture(3), tempdir().expect("a temporary folder"));
    let path = capture.path().join("transforms_train.json");
    let mut file: Value = serde_json::from_str(&std::fs::read_to_string(&path).expect("text")).expect("JSON");
    change(&mut file, capture.path());
    std::fs::write(&path, file.to_string()).expect("written");
    let run = home.path().join("run");
    let inspected = fault(&["inspect".as_ref(), capture.path().as_os_str()], 2);
    let arguments = [
        "train".as_ref(),
        capture.path().as_os_str(),
        "--out".as_ref(),
        run.as_os_str(),
    ];
    assert_eq!(inspected, fault(&arguments, 2));
    assert!(!run.exists(), "no run is begun");
    for part in said {
        assert!(inspected.contains(part), "'{part}' is not in '{inspected}'");
    }
}

#[test]
fn captures_that_are_wrong_are_refused_with_the_file_and_what_to_do() {
    refused(
        &|file, _| file["frames"][1]["file_path"] = json!("../../secret"),
        &["transforms_train.json: frame 1", "points out of the folder"],
    );
    refused(
        &|file, _| file["frames"][2]["transform_matrix"][0] = json!([0, 0, 0, 1e300]),
        &["frame 2", "spans no space"],
    );
    refused(
        &|file, folder| {
            file["frames"][0]["file_path"] = json!("notes");
            std::fs::write(folder.join("notes"), "no image").expect("written");
        },
        &["notes: it is no PNG, JPEG or EXR", "convert it"],
    );
    refused(
        &|_, folder| std::fs::remove_file(folder.join("train/r_001.png")).expect("removed"),
        &["frame 1", "no image ./train/r_001"],
    );
    refused(
        &|_, folder| {
            let path = folder.join("train/r_002.png");
            let bytes = std::fs::read(&path).expect("readable");
            std::fs::write(&path, &bytes[..bytes.len() / 2]).expect("written");
        },
        &["r_002.png: it cannot be read", "anew"],
    );
}

#[test]
fn memory_that_does_not_suffice_is_said_before_training() {
    let (capture, home) = (capture(3), tempdir().expect("a temporary folder"));
    let run = home.path().join("run");
    let (capture, run_text) = (capture.path().display().to_string(), run.display().to_string());
    for (limit, said) in [("100KiB", "images take"), ("8MiB", "no room for")] {
        let line = fault(&["train", &capture, "--out", &run_text, "--memory", limit], 2);
        assert!(line.contains(said) && line.contains("--memory"), "{line}");
        assert!(!run.exists());
    }
}

#[test]
fn lights_of_a_capture_are_recognised_learnt_and_changed() {
    let (capture, home) = (
        tempdir().expect("a temporary folder"),
        tempdir().expect("a temporary folder"),
    );
    let out = capture.path().display().to_string();
    let arguments = [
        "synth", "olat", "--out", &out, "--views", "40", "--size", "48", "--paths", "4", "--seed", "2",
    ];
    heliosplat(&arguments).assert().success();
    let seen = json(&["inspect".as_ref(), capture.path().as_os_str()]);
    assert_eq!((&seen["model"], &seen["values"]), (&json!("olat"), &json!("linear")));

    let run = home.path().join("run");
    let metrics = train(capture.path(), &run, &["--set", "train.iterations=400"]);
    let score = |metrics: &Value, at: &str| metrics.pointer(at).and_then(Value::as_f64).expect("a score");
    let (near, far) = (score(&metrics, "/test/near/psnr"), score(&metrics, "/test/far/psnr"));
    assert!(near > 20.0 && far > 18.0, "{near} {far}");
    // Without shadows the model cannot explain the images.
    let flat = home.path().join("flat");
    let without = train(
        capture.path(),
        &flat,
        &["--set", "train.iterations=400", "--set", "model.shadow=false"],
    );
    assert!(score(&without, "/test/psnr") < score(&metrics, "/test/psnr") - 1.0);

    let (run_text, lit) = (run.display().to_string(), home.path().join("lit.png"));
    let lit_text = lit.display().to_string();
    json(&[
        "relight",
        &run_text,
        "--out",
        &lit_text,
        "--light",
        "2,-1,3",
        "--toward",
        "0,0,1",
        "--view",
        "test/far_001",
    ]);
    assert!(lit.is_file());
    let parts = home.path().join("parts");
    let arguments = [
        "render",
        &run_text,
        "--out",
        &parts.display().to_string(),
        "--components",
    ];
    heliosplat(&arguments).assert().success();
    for part in ["diffuse", "specular", "shadow"] {
        assert!(parts.join(format!("test_near_000_{part}.png")).is_file(), "{part}");
    }
    let line = fault(&["relight", &run_text, "--out", &lit_text, "--sun", "10,20"], 2);
    assert!(line.contains("--light"), "{line}");
}

#[test]
fn a_reflective_model_is_planned_trained_relit_and_exported() {
    let (capture, home) = (
        tempdir().expect("a temporary folder"),
        tempdir().expect("a temporary folder"),
    );
    let out = capture.path().display().to_string();
    let arguments = [
        "synth",
        "reflective",
        "--look",
        "glossy",
        "--out",
        &out,
        "--views",
        "18",
        "--size",
        "48",
        "--paths",
        "9",
        "--seed",
        "2",
    ];
    let made = json(&arguments);
    assert!(made["noise_floor_db"].as_f64().is_some_and(|db| db > 20.0));

    // Short fits are made, and their results decide.
    let planned = home.path().join("planned");
    let short = ["--set", "train.iterations=60", "--set", "model.pilot_steps=60"];
    let metrics = train(capture.path(), &planned, &short);
    let trials = metrics
        .pointer("/plan/trials")
        .and_then(Value::as_array)
        .expect("trials");
    let gloss = &trials[0];
    let number = |at: &str| gloss.pointer(at).and_then(Value::as_f64).expect("a number");
    let (gain, error) = (number("/gain/gain_db"), number("/gain/standard_error_db"));
    let ahead = number("/with_db") - number("/without_db");
    assert!((gain - ahead).abs() < 1e-6, "{gain} {ahead}");
    let taken = gain > 2.0 * error && gain > 0.5;
    let kind = if taken { "reflective" } else { "radiance" };
    assert_eq!(
        (trials.len(), &gloss["taken"], &metrics["model"]),
        (1, &json!(taken), &json!(kind))
    );
    let text = std::fs::read_to_string(planned.join("run.toml")).expect("text");
    assert!(text.contains("[plan]") && text.contains("short fits"), "{text}");

    let run = home.path().join("run");
    let told = ["--set", "train.iterations=250", "--set", "model.kind=reflective"];
    let metrics = train(capture.path(), &run, &told);
    let number = |at: &str| metrics.pointer(at).and_then(Value::as_f64).expect("a number");
    assert!(number("/test/psnr") > 20.0, "{}", number("/test/psnr"));
    assert!(
        number("/test/normals/mean_deg") < 40.0,
        "{}",
        number("/test/normals/mean_deg")
    );

    // Under other surroundings: black but for one place.
    let (run_text, sky) = (run.display().to_string(), home.path().join("sky.png"));
    let mut picture = image::RgbImage::new(32, 16);
    (10..20).for_each(|x| picture.put_pixel(x, 3, image::Rgb([255; 3])));
    picture.save(&sky).expect("written");
    let lit = home.path().join("lit.png");
    let (sky, lit_text) = (sky.display().to_string(), lit.display().to_string());
    let relight = [
        "relight",
        &run_text,
        "--surroundings",
        &sky,
        "--samples",
        "8",
        "--view",
        "test/r_000",
        "--out",
    ];
    json(&[&relight[..], &[&lit_text]].concat());
    let bright = |picture: &Path| {
        let picture = image::open(picture).expect("a picture").to_rgb8();
        picture.pixels().filter(|p| p.0 != [255; 3] && p.0[1] > 20).count()
    };
    assert!(bright(&lit) > 20);

    // The model alone shows the same images, to the byte; splats have the columns of viewers and no others.
    let (asset, splats) = (home.path().join("asset"), home.path().join("splats.ply"));
    let (asset_text, splats_text) = (asset.display().to_string(), splats.display().to_string());
    let export = [
        "export",
        &run_text,
        "--asset",
        &asset_text,
        "--ply",
        &splats_text,
        "--toward",
        "0,0,1",
    ];
    json(&export);
    let rendered = |folder: &str, name: &str| {
        let to = home.path().join(name);
        json(&["render", folder, "--out", &to.display().to_string()]);
        std::fs::read(to.join("test_r_004.png")).expect("a picture")
    };
    assert!(rendered(&run_text, "of_run") == rendered(&asset_text, "of_asset"));
    let bytes = std::fs::read(&splats).expect("splats");
    let header = String::from_utf8_lossy(&bytes[..bytes.len().min(4000)]).into_owned();
    assert!(header.contains("property float f_rest_44\n") && !header.contains("albedo"));
    let line = fault(
        &["export", &home.path().display().to_string(), "--asset", &asset_text],
        2,
    );
    assert!(line.contains("not a finished run"), "{line}");
    a_mesh_lies_where_the_object_is(&run_text, home.path());
}

/// The mesh of a run is within the cube of the synthetic object, coloured, and in both formats the same.
fn a_mesh_lies_where_the_object_is(run: &str, home: &Path) {
    let write = |name: &str| {
        let path = home.join(name).display().to_string();
        json(&["export", run, "--mesh", &path, "--cells", "48"]);
        std::fs::read(path).expect("a mesh")
    };
    let (ply, glb) = (write("mesh.ply"), write("mesh.glb"));
    let end = ply.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    let header = String::from_utf8_lossy(&ply[..end]).into_owned();
    let count = |element: &str| -> usize {
        let line = header.lines().find_map(|line| line.strip_prefix(element));
        line.expect("an element").trim().parse().expect("a count")
    };
    let (corners, triangles) = (count("element vertex "), count("element face "));
    assert!(triangles > 1000, "{triangles} triangles");
    assert_eq!(ply.len() - end, corners * 27 + triangles * 13);
    let float = |at: usize| f32::from_le_bytes([ply[at], ply[at + 1], ply[at + 2], ply[at + 3]]);
    for corner in 0..corners {
        let at = end + 27 * corner;
        assert!((0..3).all(|k| float(at + 4 * k).abs() < 2.0), "a corner outside");
    }
    let shown = (0..corners).filter(|corner| ply[end + 27 * corner + 24..][..3].iter().any(|&c| c > 20));
    assert!(shown.count() > corners / 3, "a black mesh");
    let text = u32::from_le_bytes([glb[12], glb[13], glb[14], glb[15]]) as usize;
    let document: Value = serde_json::from_slice(&glb[20..20 + text]).expect("JSON");
    assert_eq!(document["accessors"][0]["count"], corners);
    assert_eq!(document["accessors"][3]["count"], 3 * triangles);
    let line = fault(&["export", run, "--mesh", "mesh.obj"], 2);
    assert!(line.contains(".ply or .glb"), "{line}");
}

/// Turns the training cameras of a capture about their centres by up to 0.04 radians, 4 pixels of 64.
fn disturb_cameras(capture: &Path) {
    let path = capture.join("transforms_train.json");
    let text = std::fs::read_to_string(&path).expect("readable");
    let mut list: Value = serde_json::from_str(&text).expect("JSON");
    let frames = list["frames"].as_array_mut().expect("frames");
    for (n, frame) in frames.iter_mut().enumerate() {
        let number = |row: usize, col: usize| frame["transform_matrix"][row][col].as_f64().expect("a number");
        // The axes to the right and upwards turn against the third.
        let [yaw, pitch] = [0.03 * (1.7 * n as f64).sin(), 0.03 * (2.9 * n as f64).cos()];
        let turned: Vec<Value> = (0..3)
            .map(|row| {
                let [right, up, back] = [0, 1, 2].map(|col| number(row, col));
                json!([
                    right - yaw * back,
                    up - pitch * back,
                    back + yaw * right + pitch * up,
                    number(row, 3)
                ])
            })
            .chain([json!([0.0, 0.0, 0.0, 1.0])])
            .collect();
        frame["transform_matrix"] = json!(turned);
    }
    std::fs::write(&path, list.to_string()).expect("written");
}

#[test]
fn training_cameras_that_are_off_are_turned_and_those_that_are_right_stay() {
    let (capture, home) = (capture(16), tempdir().expect("a temporary folder"));
    let steps = ["--set", "train.iterations=480"];
    let exact = train(capture.path(), &home.path().join("exact"), &steps);
    assert_eq!(exact["camera_turns"], json!([]));
    let says_too_seldom = |run: &str| {
        let log = std::fs::read_to_string(home.path().join(run).join("log.txt")).expect("a log");
        log.contains("too seldom")
    };
    assert!(!says_too_seldom("exact"));
    train(
        capture.path(),
        &home.path().join("short"),
        &["--set", "train.iterations=40"],
    );
    assert!(says_too_seldom("short"));
    disturb_cameras(capture.path());
    let run = home.path().join("off");
    let metrics = train(capture.path(), &run, &steps);
    let turns = metrics["camera_turns"].as_array().expect("a list");
    let pixels: Vec<f64> = turns.iter().filter_map(|turn| turn["pixels"].as_f64()).collect();
    let mean = pixels.iter().sum::<f64>() / 16.0;
    assert!(pixels.len() == 16 && (1.0..3.5).contains(&mean), "{pixels:?}");
    // Training views are measured with the turned cameras, by `evaluate` too.
    let psnr = |metrics: &Value| metrics.pointer("/train/psnr").and_then(Value::as_f64).expect("a score");
    assert!(
        psnr(&metrics) > psnr(&exact) - 2.0,
        "{} {}",
        psnr(&metrics),
        psnr(&exact)
    );
    let again = json(&["evaluate".as_ref(), run.as_os_str()]);
    assert!((psnr(&again) - psnr(&metrics)).abs() < 1e-9);
}
