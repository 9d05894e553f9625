//! The small tools of the program against golden values: RPC by hand, the sun, evaluation, synthesis.

use heliosplat_tests::program::{heliosplat, json};
use heliosplat_tests::scenes::{View, write_altitudes};
use heliosplat_tests::shared::shared;
use serde_json::Value;
use std::path::Path;
use tempfile::tempdir;

fn numbers(text: &str) -> Vec<Vec<f64>> {
    let line = |line: &str| {
        line.split_whitespace()
            .map(|word| word.parse().expect("a number"))
            .collect()
    };
    text.lines().map(line).collect()
}

fn run_lines(arguments: &[&str], input: String) -> Vec<Vec<f64>> {
    let assert = heliosplat(arguments).write_stdin(input).assert().success();
    numbers(&String::from_utf8_lossy(&assert.get_output().stdout))
}

fn text_of(rows: &[Value]) -> String {
    let line = |row: &Value| {
        let values = row.as_array().expect("a row of numbers");
        values.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ") + "\n"
    };
    rows.iter().map(line).collect()
}

#[test]
fn projection_and_localisation_by_hand_meet_the_golden_values() {
    let (Some(rpc), Some(golden)) = (
        shared("data/formats/gdal/md_dg.RPB"),
        shared("golden/rpc/wv3_gdal_rome.json"),
    ) else {
        return;
    };
    let golden: Value = serde_json::from_slice(&std::fs::read(golden).expect("readable")).expect("JSON");
    let rpc = rpc.to_str().expect("UTF-8");
    let rows = |group: &str, key: &str| golden[group][key].as_array().expect("rows").clone();

    let want = rows("projection", "col_row");
    let got = run_lines(&["rpc", "project", rpc], text_of(&rows("projection", "lon_lat_alt")));
    assert_eq!(got.len(), want.len());
    for (got, want) in got.iter().zip(&want) {
        let distance = (got[0] - want[0].as_f64().expect("col")).hypot(got[1] - want[1].as_f64().expect("row"));
        assert!(distance < 1e-9, "{distance} px");
    }

    let want = rows("localisation", "lon_lat");
    let got = run_lines(&["rpc", "localise", rpc], text_of(&rows("localisation", "col_row_alt")));
    assert_eq!(got.len(), want.len());
    for (got, want) in got.iter().zip(&want) {
        // 1e-13 degrees are 10 nanometres.
        let distance = (got[0] - want[0].as_f64().expect("lon")).hypot(got[1] - want[1].as_f64().expect("lat"));
        assert!(distance < 1e-12, "{distance} degrees");
    }
}

#[test]
fn an_image_and_its_json_are_one_camera() {
    let folder = tempdir().expect("a temporary folder");
    let view = View::new(1);
    let image = view.write(folder.path());
    let json_file = image.with_extension("json");
    let project = |file: &Path| {
        let file = file.to_str().expect("UTF-8");
        run_lines(
            &["rpc", "project", file],
            "36.91 37.58 710\n\n36.9101,37.5801,690\n".to_owned(),
        )
    };
    let (from_tag, from_json) = (project(&image), project(&json_file));
    assert_eq!(from_tag.len(), 2);
    for (a, b) in from_tag.iter().flatten().zip(from_json.iter().flatten()) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
}

#[test]
fn points_far_from_the_camera_are_named() {
    let folder = tempdir().expect("a temporary folder");
    let image = View::new(0).write(folder.path());
    let image = image.to_str().expect("UTF-8");
    let said = |lines: &str| {
        let assert = heliosplat(&["rpc", "project", image])
            .write_stdin(lines.to_owned())
            .assert();
        String::from_utf8_lossy(&assert.success().get_output().stderr).into_owned()
    };
    let warned = said("36.91 37.58 700\n37.58 36.91 700\n37.58 36.91 710\n");
    assert!(
        warned.contains("line 2 and 1 more") && warned.contains("lon lat alt"),
        "{warned}"
    );
    assert!(!said("36.91 37.58 700\n").contains("far from"));
}

#[test]
fn a_line_that_is_no_point_is_named() {
    let folder = tempdir().expect("a temporary folder");
    let image = View::new(0).write(folder.path());
    let image = image.to_str().expect("UTF-8");
    let assert = heliosplat(&["rpc", "project", image])
        .write_stdin("36.9 37.5 700\n36.9 north\n")
        .assert()
        .code(2);
    let said = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    assert!(said.contains("line 2") && said.contains("three numbers"), "{said}");
}

#[test]
fn the_sun_meets_the_golden_values() {
    let Some(golden) = shared("golden/sun.json") else {
        return;
    };
    let golden: Value = serde_json::from_slice(&std::fs::read(golden).expect("readable")).expect("JSON");
    // Every row is checked in the sun's own tests; here a few go all the way through the command line.
    for row in golden["rows"].as_array().expect("rows").iter().step_by(40) {
        let field = |name: &str| row[name].as_f64().expect("a number");
        let at = format!("{},{},{}", field("lat"), field("lon"), field("alt_m"));
        let time = row["utc"].as_str().expect("a time");
        let sun = json(&["sun", "--time", time, "--at", &at]);
        let direction = |azimuth: f64, elevation: f64| {
            let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
            nalgebra::Vector3::new(
                elevation.cos() * azimuth.sin(),
                elevation.cos() * azimuth.cos(),
                elevation.sin(),
            )
        };
        let got = direction(
            sun["azimuth_deg"].as_f64().expect("azimuth"),
            sun["elevation_deg"].as_f64().expect("elevation"),
        );
        let want = direction(field("azimuth_deg"), field("elevation_deg"));
        let apart_deg = got.cross(&want).norm().atan2(got.dot(&want)).to_degrees();
        assert!(apart_deg < 0.01, "{time} {at}: {apart_deg} degrees");
    }
}

#[test]
fn the_sun_prints_two_numbers() {
    let rows = run_lines(
        &[
            "sun",
            "--time",
            "2003-10-17T19:30:30Z",
            "--at",
            "39.742476,-105.1786,1830.14",
        ],
        String::new(),
    );
    // NREL's report: azimuth 194.340241, geometric elevation 39.872046.
    assert!(
        (rows[0][0] - 194.34024).abs() < 0.01 && (rows[0][1] - 39.87205).abs() < 0.01,
        "{rows:?}"
    );
}

#[test]
fn evaluation_by_hand_tells_raw_from_aligned() {
    let folder = tempdir().expect("a temporary folder");
    let (dsm, truth) = (folder.path().join("dsm.tif"), folder.path().join("truth.tif"));
    let mut hills = heliosplat::Raster::filled(150, 140, 1, 0.0);
    for (index, value) in hills.values.iter_mut().enumerate() {
        let (col, row) = ((index % 150) as f32, (index / 150) as f32);
        *value = 700.0 + 6.0 * (col / 8.0).sin() * (row / 11.0).cos() + 0.05 * col;
    }
    write_altitudes(&truth, &hills, 312_000.0, 4_160_000.0);
    // 1.5 m to the east, 1 m to the south, 2 m up.
    hills.values.iter_mut().for_each(|value| *value += 2.0);
    write_altitudes(&dsm, &hills, 312_001.5, 4_159_999.0);
    let evaluate = |protocol: &str| {
        let files = [dsm.to_str().expect("UTF-8"), truth.to_str().expect("UTF-8")];
        json(&[
            "evaluate",
            "--dsm",
            files[0],
            "--truth",
            files[1],
            "--protocol",
            protocol,
        ])
    };
    let (raw, aligned) = (evaluate("raw"), evaluate("aligned"));
    assert!(raw["dsm"]["mae_m"].as_f64().expect("MAE") > 1.5);
    assert!(aligned["dsm"]["mae_m"].as_f64().expect("MAE") < 1e-3, "{aligned}");
    let shift: Vec<f64> = serde_json::from_value(aligned["dsm"]["shift_m"].clone()).expect("three numbers");
    for (got, want) in shift.iter().zip([-1.5, 1.0, -2.0]) {
        assert!((got - want).abs() < 1e-3, "{shift:?}");
    }
    assert_eq!(aligned["dsm"]["protocol"], "aligned");
}

#[test]
fn a_synthetic_site_is_a_scene_with_truth() {
    let folder = tempdir().expect("a temporary folder");
    let site = folder.path().join("site");
    let out = site.to_str().expect("UTF-8");
    let made = json(&[
        "synth",
        "satellite",
        "--out",
        out,
        "--site",
        "tiny",
        "--seed",
        "3",
        "--views",
        "4",
        "--gsd",
        "1",
    ]);
    assert_eq!(made["images"].as_array().map(Vec::len), Some(4));
    let seen = json(&["inspect", out]);
    assert_eq!(
        seen["bands"],
        serde_json::json!(["red", "green", "blue", "near_infrared"])
    );
    assert_eq!(seen["truth"]["shadows"], 4);
    assert!(seen["truth"]["dsm"].is_string() && seen["truth"]["classes"].is_string());
    assert_eq!(
        seen["warnings"].as_array().map(Vec::len),
        Some(0),
        "{}",
        seen["warnings"]
    );
    for image in seen["images"].as_array().expect("images") {
        assert!(image["pinhole_max_px"].as_f64().expect("a residual") < 0.05, "{image}");
        assert_eq!(image["sun_source"], "time");
    }
}

#[test]
fn the_version_names_the_build_gdal_and_proj() {
    let assert = heliosplat(&["--version"]).assert().success();
    let said = String::from_utf8_lossy(&assert.get_output().stdout).into_owned();
    assert!(
        said.contains("(build ") && said.contains("GDAL 3.") && said.contains("PROJ "),
        "{said}"
    );
}
