//! The programs in `examples` run and give the right numbers.

use heliosplat::Raster;
use heliosplat_evaluate::{Protocol, evaluate_dsm};
use heliosplat_raster::GeoRaster;
use heliosplat_scene::{IngestOptions, Scene};
use heliosplat_synth::{SatelliteRequest, Site, write_satellite};
use heliosplat_tests::program::example;
use heliosplat_tests::scenes::{View, write_altitudes};
use std::path::{Path, PathBuf};

/// Stdout of a program that must succeed.
fn stdout(name: &str, arguments: &[&str]) -> String {
    let assert = example(name, arguments).assert().success();
    String::from_utf8_lossy(&assert.get_output().stdout).into_owned()
}

#[test]
fn projected_points_localise_back_to_where_they_were() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let image = View::new(1).write(folder.path()).display().to_string();
    let points = [
        [36.91, 37.58, 700.0],
        [36.91005, 37.58004, 715.5],
        [36.90996, 37.57993, 690.0],
    ];
    let texts = points.map(|[lon, lat, alt]| format!("{lon},{lat},{alt}"));
    let arguments: Vec<&str> = std::iter::once(image.as_str())
        .chain(texts.iter().map(String::as_str))
        .collect();
    let text = stdout("project_points", &arguments);
    assert_eq!(text.lines().count(), points.len());
    for (line, [lon, lat, alt]) in text.lines().zip(points) {
        let numbers: Vec<f64> = line.split(' ').map(|word| word.parse().expect("a number")).collect();
        assert_eq!(numbers[..3], [lon, lat, alt]);
        // The camera is a parallel projection: 0.5 m pixels, and 0.2 and 0.05 m east and north per metre of height.
        let metres = [
            (lon - 36.91) * 111_320.0 * 37.58_f64.to_radians().cos() + 0.2 * (alt - 700.0),
            (lat - 37.58) * 111_320.0 + 0.05 * (alt - 700.0),
        ];
        assert!((numbers[3] - (31.5 + metres[0] / 0.5)).abs() < 1e-2, "{line}");
        assert!((numbers[4] - (31.5 - metres[1] / 0.5)).abs() < 1e-2, "{line}");
        assert!(
            (numbers[5] - lon).abs() < 1e-6 && (numbers[6] - lat).abs() < 1e-6,
            "{line}"
        );
    }
}

/// A synthetic scene of six images of the smallest site.
fn tiny(folder: &Path) -> PathBuf {
    let scene = folder.join("scene");
    let request = SatelliteRequest {
        site: Site::Tiny,
        seed: 5,
        views: Some(6),
        ..Default::default()
    };
    write_satellite(&request, &scene, &|_, _| {}).expect("a scene");
    scene
}

#[test]
fn the_surface_model_of_a_folder_is_near_the_truth() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = tiny(folder.path());
    let dsm = folder.path().join("dsm.tif");
    let text = stdout(
        "dsm_from_folder",
        &[&scene.display().to_string(), &dsm.display().to_string()],
    );
    assert!(text.contains("cells of 0."), "{text}");
    let truth = Scene::open(&scene, &IngestOptions::default())
        .expect("the scene opens")
        .truth;
    let truth = truth.dsm.expect("true altitudes");
    let metrics = evaluate_dsm(&dsm, &truth, None, Protocol::Raw)
        .expect("comparable")
        .metrics;
    assert!(metrics.all.mae_m < 1.5, "{}", metrics.all.mae_m);
}

#[test]
fn presets_are_compared_and_a_run_is_read_without_training() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = tiny(folder.path()).display().to_string();
    let out = folder.path().display().to_string();
    let text = stdout("compare_presets", &[scene.as_str(), &out, "preview", "fast"]);
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split_whitespace().collect()).collect();
    assert_eq!(rows[0], ["preset", "steps", "seconds", "error_m"]);
    assert_eq!(
        [rows[1][..2].to_vec(), rows[2][..2].to_vec()],
        [["preview", "20"], ["fast", "40"]]
    );
    let number = |row: usize, column: usize| rows[row][column].parse::<f64>().expect("a number");
    assert!(number(1, 2) > 0.0 && number(2, 2) > 0.0, "{text}");
    assert!(number(1, 3) < 1.5 && number(2, 3) < 1.5, "{text}");

    // The second call reads the run and does not repeat the training.
    let run = format!("{out}/run");
    let arguments = [scene.as_str(), &run, "preview"];
    let first = stdout("train_and_read", &arguments);
    let finished = || std::fs::metadata(format!("{run}/metrics.json")).and_then(|file| file.modified());
    let before = finished().expect("a finished run");
    let read = stdout("train_and_read", &arguments);
    assert_eq!(
        (read.as_str(), finished().expect("a finished run")),
        (first.as_str(), before)
    );
    let gaussians = read.lines().next().and_then(|line| line.strip_suffix(" Gaussians"));
    assert!(
        gaussians.is_some_and(|count| count.parse::<usize>().is_ok_and(|count| count > 1000)),
        "{read}"
    );
    assert!(read.contains("m above the WGS84 ellipsoid"), "{read}");
    assert!(read.trim_end().ends_with(&format!("error {} m", rows[1][3])), "{read}");
}

/// A DSM of 60 x 60 cells of 0.5 m: a box of 10 m on level ground, 6 cells from east to west and 20 from north to
/// south.
fn a_box() -> Raster {
    let mut heights = Raster::filled(60, 60, 1, 700.0);
    for row in 20..40 {
        for col in 30..36 {
            heights.values[row * 60 + col] = 710.0;
        }
    }
    heights
}

#[test]
fn the_shadow_of_a_box_is_as_long_as_its_height_and_the_sun_say() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (dsm, mask) = (folder.path().join("dsm.tif"), folder.path().join("mask.tif"));
    write_altitudes(&dsm, &a_box(), 300_000.0, 4_160_000.0);
    let (dsm, out) = (dsm.display().to_string(), mask.display().to_string());
    // Azimuth and elevation of the sun, degrees; the cells next to the box from its wall on, away from the sun.
    type Cells = fn(usize) -> [usize; 2];
    let cases: [(&str, f64, Cells); 3] = [
        ("90", 50.0, |k| [29 - k, 30]),
        ("270", 55.0, |k| [36 + k, 30]),
        ("180", 60.0, |k| [33, 19 - k]),
    ];
    for (azimuth, elevation_deg, beside) in cases {
        stdout("cast_shadows", &[&dsm, azimuth, &elevation_deg.to_string(), &out]);
        let shadows = GeoRaster::read(&mask).expect("a mask").raster;
        let dark = |k: usize| beside(k).map(|place| place.min(59));
        let length_cells = (0..20)
            .filter(|&k| shadows.at(0, dark(k)[0], dark(k)[1]) == 1.0)
            .count();
        let expected_m = 10.0 / elevation_deg.to_radians().tan();
        let length_m = 0.5 * length_cells as f64;
        assert!(
            (length_m - expected_m).abs() <= 0.5,
            "azimuth {azimuth}: {length_m} m, not {expected_m} m"
        );
        // Neither the roof nor the ground on the sun's side.
        assert_eq!(shadows.at(0, 33, 30), 0.0);
        let lit = if azimuth == "90" { 40 } else { 25 };
        assert_eq!(shadows.at(0, lit, 45), 0.0);
    }
}

#[test]
fn faults_are_one_line() {
    for (name, arguments) in [
        ("project_points", &["no_such_image.tif", "1,2,3"][..]),
        ("project_points", &[]),
        ("dsm_from_folder", &["no_such_folder", "dsm.tif"]),
        ("dsm_from_folder", &["folder", "dsm.tif", "low"]),
        ("train_and_read", &["no_such_folder", "run"]),
        ("compare_presets", &["folder", "out", "quick"]),
        ("cast_shadows", &["no_such_dsm.tif", "90", "45", "mask.tif"]),
        ("cast_shadows", &["dsm.tif", "90", "-5", "mask.tif"]),
    ] {
        let assert = example(name, arguments).assert().code(1);
        let text = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
        assert!(
            text.starts_with("error: ") && text.lines().count() == 1,
            "{name} {arguments:?}: {text}"
        );
    }
}
