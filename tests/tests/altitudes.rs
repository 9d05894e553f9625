//! Altitudes of a scene that states none.

use heliosplat::Raster;
use heliosplat_raster::{ImageSpec, RasterFile, SampleType, write_geotiff};
use heliosplat_rpc::write;
use heliosplat_scene::{IngestOptions, Scene};
use heliosplat_tests::program::{json, tiny_scene};
use heliosplat_tests::scenes::{SIZE_PX, View};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Removes the altitudes from the JSONs of a scene, which leaves half a kilometre up and down.
fn forget_altitudes(scene: &Path) {
    for entry in fs::read_dir(scene).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|extension| extension == "json") {
            let mut said: Value = serde_json::from_slice(&fs::read(&path).expect("readable")).expect("JSON");
            let said_of_image = said.as_object_mut().expect("an object");
            said_of_image.remove("min_alt");
            said_of_image.remove("max_alt");
            fs::write(&path, said.to_string()).expect("written");
        }
    }
}

#[test]
fn a_scene_without_altitudes_is_searched_where_its_tie_points_lie() {
    let home = tempfile::tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    let word = scene.display().to_string();
    tiny_scene(&scene);
    let stated = json(&["inspect", &word]);
    assert_eq!(stated["altitude_m"]["source"], "given");
    forget_altitudes(&scene);
    let found = json(&["inspect", &word]);
    assert_eq!(found["altitude_m"]["source"], "ties", "{}", found["altitude_m"]);
    let limit = |scene: &Value, end: &str| scene["altitude_m"][end].as_f64().expect("a number");
    let (low_m, high_m) = (limit(&found, "low"), limit(&found, "high"));
    // The site's ground and roofs are well between the stated altitudes.
    let middle_m = 0.5 * (limit(&stated, "low") + limit(&stated, "high"));
    assert!(low_m < middle_m && middle_m < high_m, "{low_m} to {high_m}");
    assert!(high_m - low_m < 150.0, "{low_m} to {high_m} of a kilometre");
    assert!(
        found["warnings"].to_string().find("--altitude").is_none(),
        "{}",
        found["warnings"]
    );
    // The command line takes precedence.
    let (low_m, high_m) = ((middle_m - 60.0).round(), (middle_m + 60.0).round());
    let range = format!("--altitude={low_m},{high_m}");
    let given = json(&["inspect", &word, &range]);
    assert_eq!(
        given["altitude_m"],
        serde_json::json!({"low": low_m, "high": high_m, "source": "given"})
    );
    // Every verb that reads a scene finds them.
    let dsm = home.path().join("dsm.tif").display().to_string();
    let swept = json(&["dsm", &word, "--from", "sweep", "--out", &dsm]);
    // The images are small: two of them see about half of the rectangle around their common ground.
    assert!(swept["completeness"].as_f64().expect("a number") > 0.3, "{swept}");
}

/// Writes an image of `SIDE_PX` pixels each way that shows the view's ground from a corner at (`col`, `row`) on, and
/// nothing else.
fn on_a_canvas(view: &View, folder: &Path, (col, row): (usize, usize)) {
    let shown = view.write(folder);
    let small = RasterFile::open(&shown)
        .and_then(|file| file.read_all())
        .expect("readable");
    let mut canvas = Raster::filled(SIDE_PX, SIDE_PX, 1, 0.0);
    for line in 0..small.height {
        let start = (row + line) * SIDE_PX + col;
        let from = &small.values[line * small.width..(line + 1) * small.width];
        canvas.values[start..start + small.width].copy_from_slice(from);
    }
    let rpc = view.rpc().cropped(-(col as f64), -(row as f64));
    let rpc: Vec<(String, String)> = write::gdal_domain(&rpc).into_iter().collect();
    let spec = ImageSpec {
        rpc: &rpc,
        ..ImageSpec::plain(&canvas)
    };
    write_geotiff(&shown, &spec, SampleType::U16).expect("written");
}

const SIDE_PX: usize = 640;

#[test]
fn of_images_that_share_a_corner_that_corner_is_read() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let view = |number: usize| View {
        date: None,
        ..View::new(number)
    };
    let last = SIDE_PX - SIZE_PX;
    on_a_canvas(&view(0), folder.path(), (last, last));
    on_a_canvas(&view(1), folder.path(), (0, 0));
    let images = ["view_0.tif", "view_1.tif"];
    let images = images.map(|name| format!("[[images]]\npath = \"{name}\"\ntime = \"2016-04-23T08:34:00Z\"\n"));
    let manifest = format!("altitude_range_m = [690, 720]\n{}", images.concat());
    fs::write(folder.path().join("scene.toml"), manifest).expect("written");
    let scene = Scene::open(folder.path(), &IngestOptions::default()).expect("a scene");
    for image in &scene.images {
        let (width, height) = (image.pixels.width, image.pixels.height);
        assert!(
            width < 3 * SIZE_PX && height < 3 * SIZE_PX,
            "{}: {width} x {height}",
            image.name
        );
        // The window's camera is that of the file.
        let (enu, place) = (nalgebra::Vector3::zeros(), scene.origin());
        let [col, row] = image.pinhole.map.project(enu);
        let at = image.window_rpc().project(place);
        assert!(
            (at.col - col).abs() < 0.1 && (at.row - row).abs() < 0.1,
            "{at:?} and {col}, {row}"
        );
        assert!(image.sees(enu), "the ground is on it");
    }
}
