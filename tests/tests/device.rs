//! `train --device`: without a GPU in the build, and on a device (feature `gpu`; software Vulkan will do).

use heliosplat_tests::program::{fault, heliosplat, json};
use tempfile::{TempDir, tempdir};

/// A small capture of an object.
fn capture() -> TempDir {
    let folder = tempdir().expect("a temporary folder");
    let out = folder.path().display().to_string();
    let arguments = [
        "synth", "object", "--out", &out, "--views", "6", "--size", "48", "--paths", "4", "--seed", "3",
    ];
    heliosplat(&arguments).assert().success();
    folder
}

/// Arguments of a short training of a model.
fn arguments<'a>(capture: &'a str, run: &'a str, device: &'a str, model: &'a str) -> Vec<&'a str> {
    let start = ["train", capture, "--out", run, "--device", device, "--preset", "fast"];
    let short = ["--set", "start.gaussians=800", "--set", "train.iterations=24"];
    [&start[..], &short, &["--set", "model.pilot_steps=0", "--set", model]].concat()
}

#[cfg(not(feature = "gpu"))]
#[test]
fn a_build_without_a_gpu_says_how_to_make_one_and_auto_is_the_cpu() {
    let (capture, home) = (capture(), tempdir().expect("a temporary folder"));
    let (of, run) = (capture.path().display().to_string(), home.path().display().to_string());
    let told = fault(&arguments(&of, &run, "gpu", "model.kind=\"radiance\""), 2);
    assert!(
        told.contains("--features gpu") && told.contains("--device cpu"),
        "{told}"
    );
    let metrics = json(&arguments(&of, &run, "auto", "model.kind=\"radiance\""));
    assert_eq!(metrics["device"], "cpu");
}

#[cfg(feature = "gpu")]
#[test]
fn a_run_says_its_device_and_other_models_name_the_way_back() {
    let (capture, home) = (capture(), tempdir().expect("a temporary folder"));
    let of = capture.path().display().to_string();
    let run = |name: &str| home.path().join(name).display().to_string();
    let on_cpu = json(&arguments(&of, &run("cpu"), "cpu", "model.kind=\"radiance\""));
    let on_gpu = json(&arguments(&of, &run("gpu"), "gpu", "model.kind=\"radiance\""));
    assert_eq!(on_cpu["device"], "cpu");
    let name = on_gpu["device"].as_str().expect("a name").to_owned();
    assert!(name != "cpu" && name.contains(", "), "{name}");
    let psnr = |metrics: &serde_json::Value| metrics["train"]["psnr"].as_f64().expect("measured");
    assert!(
        (psnr(&on_cpu) - psnr(&on_gpu)).abs() < 0.05,
        "{} {}",
        psnr(&on_cpu),
        psnr(&on_gpu)
    );
    // With more steps the CPU would turn cameras; a device does not, and says nothing else.
    let longer = run("longer");
    let more = ["--set", "train.iterations=30"];
    let longer = json(&[arguments(&of, &longer, "gpu", "model.kind=\"radiance\""), more.to_vec()].concat());
    assert_eq!(longer["camera_turns"], serde_json::json!([]));
    // The device is part of the training: another one is another training.
    let (again, other) = (run("gpu"), run("gpu"));
    let resumed = |device| {
        [
            arguments(&of, &again, device, "model.kind=\"radiance\""),
            vec!["--resume"],
        ]
        .concat()
    };
    assert_eq!(json(&resumed("gpu"))["device"], name.as_str());
    let told = fault(&resumed("cpu"), 2);
    assert!(told.contains(&other), "{told}");
    let told = fault(&arguments(&of, &run("lit"), "gpu", "model.kind=\"reflective\""), 1);
    assert!(told.contains("reflective") && told.contains("--device cpu"), "{told}");
}
