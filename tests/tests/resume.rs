//! Interrupted trainings: whatever stops them and whenever, the result is the same, byte for byte.

use heliosplat::Raster;
use heliosplat::bench_fixture::Site;
use heliosplat::light::Light;
use heliosplat::model::View;
use heliosplat::optim::DensityOptions;
use heliosplat::trace::SunVisibility;
use heliosplat::train::{TrainOptions, Trainer, TrainerState};
use heliosplat_tests::program::{binary, fault, heliosplat, json, tiny_scene};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::{TempDir, tempdir};

const STEPS: usize = 28;

/// A site of `Site::new`, seen twice, in a training that uses every memory a trainer has.
fn views(site: &Site, light: Light) -> Vec<View> {
    let (width, height) = (site.camera.width, site.camera.height);
    let view = |number: usize| {
        let mut image = Raster::filled(width, height, 3, 0.3);
        for (i, value) in image.values.iter_mut().enumerate() {
            *value += 0.2 * ((i * (7 + number)) as f32 * 0.01).sin();
        }
        View {
            name: format!("view {number}"),
            camera: site.camera,
            light: Some(light),
            appearance: 0,
            weight: vec![1.0; width * height],
            visibility_prior: None,
            ceiling: Vec::new(),
            image: image.into(),
        }
    };
    vec![view(0), view(1), view(2)]
}

fn options() -> TrainOptions {
    TrainOptions {
        iterations: STEPS,
        gsd_m: 0.5,
        holdout: 0.3,
        patience: 50,
        light_every: 3,
        consistency_every: 5,
        pyramid_share: 0.4,
        density: DensityOptions {
            every: 11,
            gradient_threshold: 0.0,
            ..DensityOptions::default()
        },
        ..TrainOptions::default()
    }
}

fn trainer(site: &Site, light: Light, sun_visibility: SunVisibility) -> Trainer<'_> {
    let reach = glam::Vec3::splat(200.0);
    let parameters = site.parameters.clone();
    Trainer::new(
        &site.model,
        views(site, light),
        parameters,
        TrainOptions {
            sun_visibility,
            ..options()
        },
        (-reach, reach),
        None,
    )
    .expect("can begin")
}

#[test]
fn a_trainer_that_takes_up_a_state_goes_on_as_the_one_that_left_it() {
    let site = Site::new(900, 64, 0.6);
    let lamp = Light::Point(glam::Vec3::new(20.0, -10.0, 60.0));
    for (light, by) in [
        (site.sun, SunVisibility::Plane),
        (site.sun, SunVisibility::Bvh),
        (lamp, SunVisibility::Plane),
    ] {
        let mut whole = trainer(&site, light, by);
        let mut kept = Vec::new();
        while !whole.finished() {
            if [1, 4, 10, 11, 12, 19, 25, 27].contains(&whole.steps()) {
                kept.push(postcard::to_allocvec(&whole.state()).expect("plain data"));
            }
            whole.step().expect("a sound step");
        }
        let grown = whole.parameters().gaussians.count;
        let whole = whole.into_best();
        assert!(grown > 900, "{grown}");
        for bytes in &kept {
            let state: TrainerState = postcard::from_bytes(bytes).expect("what was written");
            let from = state.steps();
            let mut later = trainer(&site, light, by);
            later.restore(state).expect("of the same training");
            assert_eq!(later.steps(), from);
            while !later.finished() {
                later.step().expect("a sound step");
            }
            assert!(later.into_best() == whole, "{light:?} by {by:?} from step {from}");
        }
    }
}

#[test]
fn trainings_that_trace_the_sun_by_plane_and_by_hierarchy_stay_together() {
    let site = Site::new(900, 64, 0.6);
    let trained = |by: SunVisibility| {
        let mut trainer = trainer(&site, site.sun, by);
        let losses: Vec<f64> = (0..10).map(|_| trainer.step().expect("a sound step").l1).collect();
        (losses, trainer.parameters().clone())
    };
    let [(plane_losses, plane), (bvh_losses, bvh)] = [SunVisibility::Plane, SunVisibility::Bvh].map(trained);
    assert!(plane != bvh, "the setting reaches the trace");
    for (a, b) in plane_losses.iter().zip(&bvh_losses) {
        assert!((a - b).abs() < 0.02 * a, "{plane_losses:?} {bvh_losses:?}");
    }
}

#[test]
fn a_state_of_another_training_is_refused_and_changes_nothing() {
    let (site, other) = (Site::new(400, 64, 0.6), Site::new(400, 64, 0.6));
    let mut first = trainer(&site, site.sun, SunVisibility::Plane);
    first.step().expect("a sound step");
    let state = postcard::to_allocvec(&first.state()).expect("plain data");
    let state: TrainerState = postcard::from_bytes(&state).expect("what was written");
    let reach = glam::Vec3::splat(200.0);
    let fewer = views(&other, other.sun)[..2].to_vec();
    let parameters = other.parameters.clone();
    let mut second = Trainer::new(
        &other.model,
        fewer,
        parameters.clone(),
        options(),
        (-reach, reach),
        None,
    )
    .expect("can begin");
    let error = second.restore(state).expect_err("it has three views");
    assert!(error.to_string().contains("views"), "{error}");
    assert!(second.steps() == 0 && second.parameters() == &parameters);
}

/// A tiny scene, and the run that nothing interrupts.
struct Home {
    folder: TempDir,
    scene: PathBuf,
}

impl Home {
    fn new() -> Self {
        let folder = tempdir().expect("a temporary folder");
        let scene = folder.path().join("scene");
        tiny_scene(&scene);
        Self { folder, scene }
    }

    fn run(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn arguments(&self, run: &Path, more: &[&str]) -> Vec<String> {
        let mut all: Vec<String> = [
            "train",
            &self.scene.display().to_string(),
            "--out",
            &run.display().to_string(),
        ]
        .map(String::from)
        .to_vec();
        let density = "train.density.every=10";
        for text in [
            "--preset",
            "fast",
            "--set",
            "train.iterations=40",
            "--set",
            density,
            "--set",
            "train.epochs=100",
        ] {
            all.push(text.into());
        }
        all.extend(more.iter().map(|text| (*text).to_owned()));
        all
    }

    /// Starts a training that keeps its state after every step.
    fn start(&self, run: &Path) -> Child {
        let arguments = self.arguments(run, &["--resume", "--checkpoint-every", "0"]);
        let mut command = Command::new(binary());
        command.args(arguments).stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().expect("starts")
    }
}

fn checkpoint(run: &Path) -> PathBuf {
    run.join("checkpoint/training.bin")
}

/// Waits until the checkpoint has been written `times` times.
fn wait_for_checkpoints(child: &mut Child, run: &Path, times: usize) {
    let (begun, mut seen, mut last) = (Instant::now(), 0, None);
    while seen < times {
        assert!(
            begun.elapsed() < Duration::from_secs(300),
            "no checkpoint after five minutes"
        );
        assert!(
            child.try_wait().expect("waited").is_none(),
            "it ended before it could be interrupted"
        );
        let now = std::fs::metadata(checkpoint(run)).and_then(|data| data.modified()).ok();
        if now.is_some() && now != last {
            last = now;
            seen += 1;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn signal(child: &Child, name: &str) {
    let status = Command::new("kill")
        .args([&format!("-{name}"), &child.id().to_string()])
        .status();
    assert!(status.is_ok_and(|status| status.success()));
}

fn same_products(a: &Path, b: &Path) {
    for name in ["model.ply", "model.json", "dsm.tif", "start.tif"] {
        let read = |run: &Path| std::fs::read(run.join(name)).expect(name);
        assert!(read(a) == read(b), "{name} differs");
    }
}

#[test]
fn trainings_that_are_stopped_or_killed_end_with_the_same_bytes() {
    let home = Home::new();
    let whole = home.run("whole");
    json(&home.arguments(&whole, &[]));
    assert!(!checkpoint(&whole).exists(), "a finished run keeps no checkpoint");

    // Its configuration gives the same run again, under one bar from the cameras to the products.
    let again = home.run("again");
    let settings = whole.join("run.toml").display().to_string();
    let mut command = Command::new(binary());
    command.args([
        "train",
        &home.scene.display().to_string(),
        "--config",
        &settings,
        "--out",
    ]);
    let output = command
        .arg(&again)
        .env("HELIOSPLAT_PROGRESS", "lines")
        .output()
        .expect("starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    same_products(&whole, &again);
    let percent: Vec<u64> = said
        .lines()
        .filter_map(|line| line.strip_prefix("progress train ")?.strip_suffix(" %")?.parse().ok())
        .collect();
    assert!(percent.len() > 10 && percent.is_sorted(), "{percent:?}");
    assert!(!said.contains("progress sweep"), "{said}");
    let wrong = home.run("wrong.toml");
    std::fs::write(&wrong, "preset = \"fast\"\niterations = 9\n").expect("written");
    let words = ["train", "S", "--config", &wrong.display().to_string(), "--out", "none"].map(String::from);
    let line = fault(&words, 2);
    assert!(line.contains("wrong.toml") && line.contains("iterations"), "{line}");

    let run = home.run("interrupted");
    for (name, code, after) in [
        ("TERM", Some(130), 3),
        ("KILL", None, 4),
        ("INT", Some(130), 2),
        ("KILL", None, 1),
    ] {
        let mut child = home.start(&run);
        wait_for_checkpoints(&mut child, &run, after);
        signal(&child, name);
        let status = child.wait().expect("ends");
        assert_eq!(status.code(), code, "{name}");
        assert!(checkpoint(&run).is_file(), "{name}");
        assert!(!run.join("model.json").exists(), "nothing half-done is taken for a run");
    }

    // One at a time.
    let mut child = home.start(&run);
    wait_for_checkpoints(&mut child, &run, 2);
    signal(&child, "STOP");
    let line = fault(&home.arguments(&run, &[]), 2);
    assert!(line.contains("another training"), "{line}");
    signal(&child, "KILL");
    child.wait().expect("ends");

    // The same program must continue: a byte more at its end, which changes nothing else, is another build.
    let other = home.run("heliosplat");
    std::fs::copy(binary(), &other).expect("copied");
    let mut file = std::fs::OpenOptions::new().append(true).open(&other).expect("writable");
    file.write_all(b"\n").expect("written");
    drop(file);
    let output = Command::new(&other)
        .args(home.arguments(&run, &[]))
        .output()
        .expect("starts");
    let line = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{line}");
    assert!(line.contains("build ") && line.contains("--overwrite"), "{line}");

    // The inputs must be those of the first call.
    let other = ["--resume", "--set", "train.position_rate_gsd=0.05"];
    let line = fault(&home.arguments(&run, &other), 2);
    assert!(
        line.contains("training.bin") && line.contains("then: position_rate_gsd = "),
        "{line}"
    );
    let line = fault(&home.arguments(&run, &["--resume", "--seed", "2"]), 2);
    assert!(line.contains("seed = 1") && line.contains("seed = 2"), "{line}");

    // A truncated checkpoint is detected.
    let damaged = home.run("damaged");
    std::fs::create_dir_all(damaged.join("checkpoint")).expect("made");
    let bytes = std::fs::read(checkpoint(&run)).expect("readable");
    std::fs::write(checkpoint(&damaged), &bytes[..bytes.len() - 9]).expect("written");
    let line = fault(&home.arguments(&damaged, &["--resume"]), 2);
    assert!(line.contains("check sum") && line.contains("--overwrite"), "{line}");

    // It continues without an option.
    let continued = heliosplat(&home.arguments(&run, &[])).assert().success();
    let said = String::from_utf8_lossy(&continued.get_output().stderr).into_owned();
    assert!(said.contains("continues at step "), "{said}");
    same_products(&whole, &run);
    assert!(!run.join("checkpoint").exists());

    // A finished run is left unchanged; a page that it could not write before it was killed is made.
    std::fs::remove_file(run.join("report.html")).expect("a page");
    let before = std::fs::metadata(run.join("model.ply"))
        .and_then(|data| data.modified())
        .expect("there");
    let again = json(&home.arguments(&run, &["--resume"]));
    assert!(again["dsm"]["mae_m"].as_f64().is_some());
    assert!(run.join("report.html").is_file());
    let after = std::fs::metadata(run.join("model.ply"))
        .and_then(|data| data.modified())
        .expect("there");
    assert_eq!(before, after);
    // Without an option it is never replaced.
    for more in [&[][..], &["--seed", "2"], &["--resume", "--seed", "2"]] {
        let line = fault(&home.arguments(&run, more), 2);
        assert!(line.contains("finished run") && line.contains("--overwrite"), "{line}");
    }
    json(&home.arguments(&run, &["--overwrite", "--seed", "2", "--set", "train.iterations=1"]));
    let model = |run: &Path| std::fs::read(run.join("model.ply")).expect("a model");
    assert!(model(&run) != model(&whole));
}
