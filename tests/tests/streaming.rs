//! Sweeps of scenes that do not fit into memory, and scenes across the antimeridian and the borders of UTM zones.

use heliosplat::Raster;
use heliosplat_raster::GeoRaster;
use heliosplat_tests::program::{fault, json};
use heliosplat_tests::town::Pair;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

const SIZE_PX: usize = 600;
/// Less than this scene takes as a whole, enough for some tiles.
const LITTLE: &str = "290MB";

/// A folder with a scene in it, and that scene.
fn town(centre_deg: [f64; 2]) -> (tempfile::TempDir, String) {
    let home = tempfile::tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    Pair::new(SIZE_PX, centre_deg).write(&scene);
    let word = scene.display().to_string();
    (home, word)
}

/// Sweeps a scene into a file; returns the document of `--json`.
fn swept(scene: &str, out: &Path, more: &[&str]) -> Value {
    let file = out.display().to_string();
    let words = ["dsm", scene, "--from", "sweep", "--out", file.as_str()];
    json(&[&words[..], more].concat())
}

fn read(path: &Path) -> Raster {
    GeoRaster::read_surface(path).expect("a surface model").raster
}

fn number(of: &Value, pointer: &str) -> f64 {
    of.pointer(pointer).and_then(Value::as_f64).expect("a number")
}

/// Median steps of two rasters across each line between two columns, over the rows known in both; of lines that are
/// mostly known. A wall that moves by a cell is in few places of a line; a seam is all along it.
fn steps_between_columns(one: &Raster, many: &Raster) -> Vec<[f64; 2]> {
    let steps = |col: usize| {
        let across =
            |raster: &Raster, row: usize| f64::from((raster.at(0, col, row) - raster.at(0, col - 1, row)).abs());
        let both = (0..one.height).map(|row| [across(one, row), across(many, row)]);
        let known: Vec<[f64; 2]> = both.filter(|steps| steps.iter().all(|step| step.is_finite())).collect();
        let median = |which: usize| {
            let mut steps: Vec<f64> = known.iter().map(|steps| steps[which]).collect();
            steps.sort_by(f64::total_cmp);
            steps[steps.len() / 2]
        };
        (known.len() > one.height / 2).then(|| [median(0), median(1)])
    };
    // At the rim of the scene, where two images hardly meet, heights are guessed anyway.
    let rim = one.width / 8;
    (rim..one.width - rim).filter_map(steps).collect()
}

fn turned(raster: &Raster) -> Raster {
    let mut out = Raster::filled(raster.height, raster.width, 1, f32::NAN);
    for row in 0..raster.height {
        for col in 0..raster.width {
            out.values[col * raster.height + row] = raster.at(0, col, row);
        }
    }
    out
}

#[test]
fn a_pair_swept_in_tiles_is_that_swept_at_once_and_shows_no_seam() {
    let (home, scene) = town([36.91, 37.58]);
    let out = |name: &str| -> PathBuf { home.path().join(name).join("dsm.tif") };
    let whole = swept(&scene, &out("whole"), &["--memory", "4GiB"]);
    let tiled = swept(&scene, &out("tiled"), &["--memory", LITTLE]);
    assert_eq!(whole["tiles"], 1);
    assert!(number(&tiled, "/tiles") >= 4.0, "{tiled}");
    for said in [&whole, &tiled] {
        let stages = said["timeline"].as_array().expect("a timeline");
        let has = |name: &str| stages.iter().any(|stage| stage["stage"] == name);
        assert!(["read", "sweep", "products"].into_iter().all(has), "{said}");
        let [limit, planned, peak] =
            ["limit", "planned", "peak"].map(|name| number(said, &format!("/memory/{name}_bytes")));
        assert!(peak > 0.0 && peak <= planned && planned <= limit, "{said}");
    }
    for key in ["width", "height", "crs", "gsd_m"] {
        assert_eq!(whole[key], tiled[key], "{key}");
    }
    let [one, many] = ["whole", "tiled"].map(|name| read(&out(name)));
    let both = |i: usize| one.values[i].is_finite() && many.values[i].is_finite();
    let cells = (0..one.plane_len()).filter(|&i| both(i)).count();
    let apart = |i: usize| (one.values[i] - many.values[i]).abs() > 0.1;
    let differing = (0..one.plane_len()).filter(|&i| both(i) && apart(i)).count();
    assert!(cells > one.plane_len() * 8 / 10, "{cells} of {}", one.plane_len());
    assert!(differing * 50 < cells, "{differing} of {cells} differ");
    let known = |raster: &Raster| raster.plane(0).iter().filter(|z| z.is_finite()).count();
    assert!(known(&one).abs_diff(known(&many)) * 100 < cells);
    // No line between two columns or rows has a larger step than in the whole.
    for (one, many) in [(&one, &many), (&turned(&one), &turned(&many))] {
        let lines = steps_between_columns(one, many);
        assert!(lines.len() > SIZE_PX / 2);
        for (line, [one, many]) in lines.into_iter().enumerate() {
            assert!(many - one < 0.02, "line {line}: {one} m and {many} m");
        }
    }
    // Unknown cells are unknown in all bands, and nothing else is left in the folder.
    for i in (0..many.plane_len()).filter(|&i| many.values[i].is_nan()) {
        assert!((1..4).all(|band| many.plane(band)[i].is_nan()));
    }
    let folder = out("tiled");
    let left = fs::read_dir(folder.parent().expect("a folder")).expect("listable");
    assert_eq!(
        left.count(),
        8,
        "altitude, deviation, coverage and views, each with its style"
    );
    // The number of threads changes nothing.
    swept(&scene, &out("alone"), &["--memory", LITTLE, "--threads", "1"]);
    let [a, b] = ["tiled", "alone"].map(|name| fs::read(out(name)).expect("readable"));
    assert!(a == b, "one thread makes other bytes");
}

#[test]
fn a_sweep_of_which_no_tile_fits_is_refused_and_writes_nothing() {
    let (home, scene) = town([36.91, 37.58]);
    let out = home.path().join("out").join("dsm.tif");
    let file = out.display().to_string();
    let words = ["dsm", &scene, "--from", "sweep", "--out", &file, "--memory"];
    let line = fault(&[&words[..], &["100MB"]].concat(), 2);
    assert!(line.contains("--memory") && line.contains("--altitude"), "{line}");
    let line = fault(&[&words[..], &[LITTLE, "--fill"]].concat(), 2);
    assert!(line.contains("--fill"), "{line}");
    assert!(!out.parent().expect("a folder").exists());
}

#[test]
fn a_scene_across_the_antimeridian_or_the_border_of_a_zone_is_swept_as_one_elsewhere() {
    let (home, inland) = town([39.0, -17.0]);
    let out = home.path().join("inland.tif");
    let expected = number(&swept(&inland, &out, &["--memory", LITTLE]), "/completeness");
    for (longitude_deg, zones) in [(180.0, ["60S", "1S"]), (36.0, ["36S", "37S"])] {
        let (home, scene) = town([longitude_deg, -17.0]);
        let out = home.path().join("dsm.tif");
        for memory in ["4GiB", LITTLE] {
            let said = swept(&scene, &out, &["--memory", memory]);
            let crs = said["crs"].as_str().expect("a name");
            assert!(zones.iter().any(|zone| crs.ends_with(zone)), "{crs}");
            // Meridians lean at the border of a zone: the rectangle around the scene is larger there.
            let side = number(&said, "/width").max(number(&said, "/height"));
            assert!(side < 1.1 * SIZE_PX as f64, "{said}");
            assert!(
                number(&said, "/completeness") > expected - 0.08,
                "{said} for {expected}"
            );
        }
    }
}

#[test]
fn an_area_and_tiles_of_a_batch_may_cross_the_antimeridian() {
    let (home, scene) = town([180.0, -17.0]);
    let out = home.path().join("dsm.tif");
    let area = "--area=179.9996,-17.0004,-179.9996,-16.9996";
    let said = swept(&scene, &out, &[area]);
    // 85 m each way.
    assert!((160.0..190.0).contains(&number(&said, "/width")), "{said}");
    assert!(number(&said, "/completeness") > 0.9, "{said}");
    let manifest = home.path().join("batch.toml");
    let text = "[[images]]\nname = \"town\"\nscene = \"scene\"\n[[areas]]\nname = \"middle\"\n\
        bounds = [179.9994, -17.0006, -179.9994, -16.9994]\n[tiles]\nside_m = 80.0\n";
    fs::write(&manifest, text).expect("written");
    let [manifest, out] = [manifest, home.path().join("out")].map(|path| path.display().to_string());
    let plan = json(&["batch", &manifest, "--out", &out, "--plan"]);
    let units = plan["units"].as_array().expect("units");
    assert!(units.len() >= 5, "{plan}");
    assert!(!plan.to_string().contains("refused"), "{plan}");
}
