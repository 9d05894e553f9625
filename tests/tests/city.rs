//! Batches over images as large as those of a satellite: how much of them is read.

use heliosplat_scene::{RpcPreference, camera_of};
use heliosplat_tests::canvas;
use heliosplat_tests::measured::{Measured, run};
use heliosplat_tests::program::{binary, json};
use heliosplat_tests::scenes::parallel_camera;
use std::path::Path;
use std::time::Duration;
use tempfile::tempdir;

/// Pixels of an image each way.
const CANVAS_PX: usize = 40_000;
/// The same of images whose cameras are valid for a small site alone: 72 MB each.
const SMALL_CANVAS_PX: usize = 3_000;
/// Bytes that a process may read besides the pixels of its windows.
const BESIDES: u64 = 50_000_000;

fn batch(home: &Path, more: &[&str]) -> Measured {
    let [manifest, out] = ["batch.toml", "out"].map(|name| home.join(name).display().to_string());
    let mut arguments = vec!["batch", &manifest, "--out", &out];
    arguments.extend(more);
    let measured = run(&arguments, Duration::from_secs(300));
    assert_eq!(measured.code, Some(0), "{}", measured.stderr);
    measured
}

fn executable_bytes() -> u64 {
    std::fs::metadata(binary()).expect("there").len()
}

#[test]
fn a_city_is_planned_without_reading_a_pixel_and_once() {
    let home = tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    std::fs::create_dir(&scene).expect("made");
    for (number, tilt) in [[0.1, 0.2], [-0.2, 0.1], [0.0, -0.3], [0.25, -0.1]]
        .into_iter()
        .enumerate()
    {
        let camera = parallel_camera(CANVAS_PX, 0.4, [36.91, 37.58], tilt);
        let path = scene.join(format!("2015090{}T083000_{number}.tif", number + 1));
        drop(canvas::empty(&path, CANVAS_PX, 1, &camera));
    }
    // Two kilometres by two in tiles of a hundred metres.
    let manifest = "
[tiles]
side_m = 100.0
[products]
dsm_only = true
[[areas]]
name = \"city\"
bounds = [340000.0, 4160000.0, 342000.0, 4162000.0]
crs = \"EPSG:32637\"
altitude_m = [650, 750]
[[images]]
name = \"first\"
scene = \"scene\"
[[presets]]
name = \"sweep\"
";
    let place = heliosplat_raster::Crs::from_epsg(32637).expect("UTM");
    let to_map = heliosplat_raster::CrsTransform::from_lon_lat(&place).expect("a transformation");
    let (east, north) = to_map.apply(36.91, 37.58).expect("a place");
    let bounds = [east - 1000.0, north - 1000.0, east + 1000.0, north + 1000.0];
    let manifest = manifest.replace("[340000.0, 4160000.0, 342000.0, 4162000.0]", &format!("{bounds:?}"));
    std::fs::write(home.path().join("batch.toml"), manifest).expect("written");
    let first = batch(home.path(), &["--plan", "--json"]);
    assert!(
        first.read_bytes < executable_bytes() + BESIDES,
        "{} bytes",
        first.read_bytes
    );
    assert!(first.peak_bytes < 1 << 30, "{} bytes", first.peak_bytes);
    let plan: serde_json::Value = serde_json::from_str(&first.stdout).expect("JSON");
    let units = plan["units"].as_array().expect("units");
    // The grid is the smallest that holds the rectangle, which a map's north turns.
    let count = |kind: &str| units.iter().filter(|unit| unit["work"]["kind"] == kind).count();
    // Two kilometres of these images are more than 4,096 cells in each direction.
    let counts = ["ties", "adjust", "tile", "block", "joined"].map(count);
    assert_eq!(counts[1..], [1, 21 * 21, 4, 1]);
    assert!(
        (2..=25).contains(&counts[0]) && units.len() == counts.iter().sum::<usize>(),
        "{counts:?}"
    );
    let adjust = units
        .iter()
        .find(|unit| unit["work"]["kind"] == "adjust")
        .expect("a unit");
    assert_eq!(adjust["after"].as_array().map(Vec::len), Some(counts[0]));
    // Kept: neither the delivery nor the executable is read once more.
    let again = batch(home.path(), &["--plan", "--json"]);
    assert_eq!(again.stdout, first.stdout);
    assert!(again.read_bytes < 10_000_000, "{} bytes", again.read_bytes);
    // An image that is not what it was is noticed.
    let changed = scene.join("20150901T083000_0.tif");
    let file = std::fs::OpenOptions::new()
        .append(true)
        .open(&changed)
        .expect("writable");
    file.set_len(file.metadata().expect("a size").len() + 1)
        .expect("longer");
    drop(file);
    let other = batch(home.path(), &["--plan", "--json"]);
    let other: serde_json::Value = serde_json::from_str(&other.stdout).expect("JSON");
    assert_ne!(other["units"][0]["key"], units[0]["key"]);
}

#[test]
fn a_tile_reads_its_windows_and_a_finished_one_next_to_nothing() {
    let home = tempdir().expect("a temporary folder");
    let small = home.path().join("small");
    let words = "synth satellite --site tiny --seed 5 --views 7 --pointing-bias 5 --out";
    let target = small.display().to_string();
    json(&words.split(' ').chain([target.as_str()]).collect::<Vec<_>>());
    let camera = |path: &Path| camera_of(path, RpcPreference::Image).expect("a camera");
    canvas::scene(&small, &home.path().join("scene"), SMALL_CANVAS_PX, &camera);
    let manifest = "
[tiles]
side_m = 40.0
overlap_m = 6.0
[[areas]]
name = \"site\"
altitude_m = [470, 530]
[[images]]
name = \"first\"
scene = \"scene\"
rpc = \"image\"
[[presets]]
name = \"sweep\"
[[presets]]
name = \"fast\"
set = { \"train.iterations\" = 4 }
";
    let bounds = json(&["inspect", &small.display().to_string()]);
    let at = |key: &str| bounds["origin"][key].as_f64().expect("a place");
    let (lon, lat) = (at("lon_deg"), at("lat_deg"));
    let area = format!(
        "bounds = [{}, {}, {}, {}]",
        lon - 3e-4,
        lat - 2.5e-4,
        lon + 3e-4,
        lat + 2.5e-4
    );
    let manifest = manifest.replace("altitude_m", &format!("{area}\naltitude_m"));
    std::fs::write(home.path().join("batch.toml"), manifest).expect("written");
    let plan = batch(home.path(), &["--plan", "--json"]);
    let plan: serde_json::Value = serde_json::from_str(&plan.stdout).expect("JSON");
    let ids: Vec<&str> = plan["units"]
        .as_array()
        .expect("units")
        .iter()
        .filter_map(|unit| unit["id"].as_str())
        .collect();
    // Cameras are corrected once, for the tiles of all presets.
    let adjust: Vec<&&str> = ids
        .iter()
        .filter(|id| !id.contains("/sweep/") && !id.contains("/fast/"))
        .collect();
    assert_eq!(adjust, [&"site/first/ties-0", &"site/first/adjust"]);
    for unit in adjust {
        let corrected = batch(home.path(), &["--only", unit]);
        assert!(corrected.read_bytes < BESIDES, "{} bytes", corrected.read_bytes);
    }
    for preset in ["sweep", "fast"] {
        let tile = ids
            .iter()
            .find(|id| id.contains(preset) && id.contains("tile"))
            .expect("a tile");
        let first = batch(home.path(), &["--only", tile]);
        // The windows are a few hundred pixels wide; the images have 288 MB.
        assert!(first.read_bytes < BESIDES, "{preset}: {} bytes", first.read_bytes);
        // With corrected cameras one search for clouds suffices.
        assert!(
            first.stderr.contains("INFO") && !first.stderr.contains("clouds again"),
            "{}",
            first.stderr
        );
        let again = batch(home.path(), &["--only", tile]);
        assert!(again.stdout.contains("finished before"), "{}", again.stdout);
        assert!(again.read_bytes < 10_000_000, "{preset}: {} bytes", again.read_bytes);
    }
    // The model of the tile has the corrections of the area for its own.
    let read = |name: &str| -> serde_json::Value {
        let text = std::fs::read(home.path().join("out/site/first").join(name)).expect("readable");
        serde_json::from_slice(&text).expect("JSON")
    };
    let shared = read("adjust/cameras.json");
    let shared = shared["shifts_px"].as_object().expect("shifts");
    let largest = shared.values().flat_map(|shift| shift.as_array().into_iter().flatten());
    let largest = largest
        .filter_map(serde_json::Value::as_f64)
        .fold(0.0, |most: f64, v| most.max(v.abs()));
    assert!((4.0..20.0).contains(&largest), "{largest} px");
    let tile = ids.iter().find(|id| id.contains("/fast/tile")).expect("a tile");
    let tile = tile.trim_start_matches("site/first/");
    let model = read(&format!("{tile}/run/model.json"));
    let trained: Vec<&serde_json::Value> = model["images"].as_array().expect("images").iter().collect();
    let trained = trained.into_iter().filter(|image| !image["appearance"].is_null());
    let pairs: Vec<_> = trained
        .map(|image| (&image["shift_px"], &shared[image["name"].as_str().expect("a name")]))
        .collect();
    assert!(pairs.len() >= 3, "{pairs:?}");
    for (own, shared) in pairs {
        for axis in 0..2 {
            let [own, shared] = [own, shared].map(|shift| shift[axis].as_f64().expect("a number"));
            assert!((own - shared).abs() < 1e-5, "{own} and {shared}");
        }
    }
    // Surfaces of tiles without training become one.
    let out = home.path().join("out/site/first/sweep");
    for id in ids.iter().filter(|id| id.contains("/sweep/")) {
        batch(home.path(), &["--only", id]);
    }
    assert!(out.join("mosaic/dsm.tif").is_file() && out.join("mosaic/report.html").is_file());
    assert!(!out.join("tile-r0c0/run").exists(), "nothing is trained");
    let mosaic: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("mosaic/mosaic.json")).expect("readable")).expect("JSON");
    assert!(
        mosaic["completeness"].as_f64().is_some_and(|share| share > 0.7),
        "{mosaic}"
    );
}

#[test]
fn a_canvas_changes_no_surface_and_stores_only_the_image() {
    // As wide as the scene of the sensor; a wider canvas would widen the scene.
    const CANVAS_PX: u64 = 2400;
    let home = tempdir().expect("a temporary folder");
    let path = |name: &str| home.path().join(name).display().to_string();
    let [plain, canvas] = ["plain", "canvas"].map(path);
    let words = "synth satellite --site tiny --seed 5 --views 4 --size 240 --out";
    json(&words.split(' ').chain([plain.as_str()]).collect::<Vec<_>>());
    let words = format!("{words} {canvas} --canvas {CANVAS_PX}");
    let made = json(&words.split(' ').collect::<Vec<_>>());
    for image in made["images"].as_array().expect("images") {
        let name = image["name"].as_str().expect("a name");
        let of = |key: &str| image[key].as_array().expect("numbers").clone();
        let (offset, size) = (of("canvas_offset_px"), of("size_px"));
        let file = home.path().join(format!("canvas/{name}.tif"));
        let stored = std::fs::metadata(&file).expect("there").len();
        // Whole tiles of 256 pixels around 240, with four bands of two bytes, and the index of the tiles.
        assert!(stored < 4 * 256 * 256 * 8 + 10_000, "{stored} bytes");
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(file.with_extension("json")).expect("readable")).expect("JSON");
        assert_eq!(
            (&json["width"], &json["height"]),
            (&CANVAS_PX.into(), &CANVAS_PX.into())
        );
        // JSON and tag place the site's centre in the part of the file that holds the image.
        let origin = &made["origin"];
        let place = ["lon_deg", "lat_deg", "height_m"].map(|key| origin[key].as_f64().expect("a number"));
        let in_file = |camera: heliosplat_rpc::Rpc| {
            let [lon_deg, lat_deg, height_m] = place;
            camera.project(heliosplat_rpc::GeoPoint::new(lon_deg, lat_deg, height_m))
        };
        for preference in [RpcPreference::Json, RpcPreference::Tag] {
            let at = in_file(camera_of(&file, preference).expect("a camera"));
            for (pixel, axis) in [(at.col, 0), (at.row, 1)] {
                let first = offset[axis].as_f64().expect("a number");
                let last = first + size[axis].as_f64().expect("a number");
                assert!((first..last).contains(&pixel), "{name}: {pixel}");
            }
        }
    }
    // A part of the site, so that windows end at no edge of an image.
    let grid = &made["grid"];
    let of = |key: &str| grid[key].as_f64().expect("a number");
    let (west, north) = (of("west_m") + 12.0, of("north_m") - 12.0);
    let zone = &grid["zone"];
    let epsg = 32600 + zone["number"].as_u64().expect("a zone") + 100 * u64::from(zone["south"] == true);
    let area = format!("{west},{},{},{north},EPSG:{epsg}", north - 24.0, west + 24.0);
    let surface = |scene: &str| {
        let out = format!("{scene}.tif");
        json(&["dsm", scene, "--from", "sweep", "--area", &area, "--out", &out]);
        heliosplat_raster::GeoRaster::read(Path::new(&out))
            .expect("a surface")
            .raster
            .values
    };
    let (plain, canvas) = (surface(&plain), surface(&canvas));
    assert_eq!(plain.len(), canvas.len());
    for (a, b) in plain.iter().zip(&canvas) {
        assert!((a - b).abs() < 1e-3 || a.is_nan() && b.is_nan(), "{a} and {b}");
    }
}

#[test]
fn a_district_is_a_square_kilometre() {
    let home = tempdir().expect("a temporary folder");
    let scene = home.path().join("scene").display().to_string();
    let words = "synth satellite --site district --seed 3 --views 2 --gsd 4 --size 64 --bands pan --out";
    let made = json(&words.split(' ').chain([scene.as_str()]).collect::<Vec<_>>());
    let side_m = made["grid"]["size"].as_f64().expect("cells") * made["grid"]["cell_m"].as_f64().expect("metres");
    assert_eq!(side_m, 1000.0);
    assert!(made["class_share"]["water"].as_f64().is_some_and(|share| share > 0.001));
    assert!(home.path().join("scene/truth/dtm.tif").is_file());
}
