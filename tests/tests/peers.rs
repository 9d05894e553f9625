//! Scripts that measure: `compare_peers.py` names missing peers and measures the others; `tradeoff.py` trains each point once.
#![cfg(unix)]

use heliosplat_tests::program::{binary, json};
use heliosplat_tests::scenes::{View, write_scene};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// An s2p that takes its configuration's word for where to write, and finds the true surface.
const FAKE_S2P: &str = "#!/usr/bin/env python3
import json, os, shutil, sys
config = json.load(open(sys.argv[1]))
assert len(config['images']) >= 2 and config['dsm_resolution'] > 0, config
os.makedirs(config['out_dir'], exist_ok=True)
shutil.copy(os.environ['TRUE_DSM'], os.path.join(config['out_dir'], 'dsm.tif'))
";

#[test]
fn an_installed_peer_is_measured_and_a_missing_one_is_named() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    let text = |path: &Path| path.to_str().expect("an UTF-8 path").to_owned();
    json(&[
        "synth",
        "satellite",
        "--site",
        "tiny",
        "--views",
        "3",
        "--seed",
        "3",
        "--out",
        &text(&path("scene")),
    ]);
    let programs = path("bin");
    std::fs::create_dir(&programs).expect("a folder");
    let fake = programs.join("s2p");
    std::fs::write(&fake, FAKE_S2P).expect("a file");
    std::fs::set_permissions(&fake, std::fs::Permissions::from_mode(0o755)).expect("a mode");

    let truth = path("scene/truth/dsm.tif");
    assert!(truth.is_file(), "the scene has truth");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scripts/compare_peers.py");
    let search = format!("{}:/usr/bin:/bin", programs.display());
    let output = std::process::Command::new("python3")
        .arg(script)
        .arg(path("scene"))
        .args(["--presets", "preview", "--heliosplat"])
        .arg(binary())
        .arg("--truth")
        .arg(&truth)
        .arg("--out")
        .arg(path("results"))
        .env("PATH", search)
        .env("TRUE_DSM", &truth)
        .output()
        .expect("python3 runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("'cars' is not on PATH, left out"), "{said}");

    let results = std::fs::read_to_string(path("results/peers.json")).expect("results");
    let results: serde_json::Value = serde_json::from_str(&results).expect("JSON");
    assert_eq!(results["missing"], serde_json::json!(["CARS"]));
    let [ours, theirs] = [0, 1].map(|place| &results["programs"][place]);
    assert_eq!(
        (&ours["name"], &theirs["name"]),
        (&"heliosplat preview".into(), &"s2p".into())
    );
    let error = |program: &serde_json::Value| program["errors"]["mae_m"].as_f64().expect("an error");
    assert!(error(theirs) == 0.0 && error(ours) > 0.0, "{results}");
    assert!(ours["peak_bytes"].as_f64() > theirs["peak_bytes"].as_f64(), "{results}");
    let table = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        table.contains("| heliosplat preview |") && table.contains("| s2p |"),
        "{table}"
    );
}

#[test]
fn a_tradeoff_trains_its_points_once_and_compares_them_with_their_base() {
    let home = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| home.path().join(name);
    std::fs::create_dir(path("scene")).expect("a folder");
    write_scene(&path("scene"), &[View::new(0), View::new(1), View::new(2)]);
    let points = "[[point]]\nname = \"none\"\naxis = \"steps\"\npreset = \"fast\"\nwhy = \"a test\"\nset = { \"train.iterations\" = 0 }\n\
                  [[point]]\nname = \"one\"\naxis = \"steps\"\npreset = \"fast\"\nwhy = \"a test\"\nbase = \"none\"\nseeds = \"all\"\n\
                  set = { \"train.iterations\" = 1 }\n";
    std::fs::write(path("points.toml"), points).expect("written");
    let run = || {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scripts/tradeoff.py");
        let output = std::process::Command::new("python3")
            .arg(script)
            .arg(path("scene"))
            .arg("--out")
            .arg(path("out"))
            .arg("--points")
            .arg(path("points.toml"))
            .args(["--seeds", "2", "--heliosplat"])
            .arg(binary())
            .output()
            .expect("python3 runs");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{said}");
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let table = run();
    assert_eq!(table.lines().count(), 4, "{table}");
    assert!(
        table.lines().nth(3).is_some_and(|row| row.starts_with("| one")),
        "{table}"
    );
    let rows = std::fs::read_to_string(path("out/tradeoff.csv")).expect("a table");
    assert_eq!(rows.lines().count(), 4, "{rows}");

    // A second time nothing is trained: the metrics stay the files they were.
    let written = || {
        path("out/runs/scene/one-2/metrics.json")
            .metadata()
            .and_then(|m| m.modified())
    };
    let before = written().expect("there");
    assert_eq!(run(), table);
    assert_eq!(written().expect("there"), before);
}
