//! Batches through the program: tiles, their mosaic, what fails and stops nobody, and processes killed at any moment.
//!
//! `HELIOSPLAT_KILLS` says how often the batch is killed (3 where not said).

use gdal::{Dataset, Metadata};
use heliosplat_tests::program::{binary, fault, heliosplat, json, tiny_scene};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use serde_json::Value;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::{TempDir, tempdir};

/// A folder with a tiny scene and a manifest that cuts it into four tiles.
fn home(manifest: &str) -> TempDir {
    let folder = tempdir().expect("a temporary folder");
    tiny_scene(&folder.path().join("scene"));
    std::fs::write(folder.path().join("batch.toml"), manifest).expect("written");
    folder
}

const FOUR_TILES: &str = "
[tiles]
side_m = 48.0
overlap_m = 6.0

[products]
sun = [200.0, 40.0]
sun_hours = \"2016-06-21\"
globe = true

[[images]]
name = \"first\"
scene = \"scene\"

[[presets]]
name = \"quick\"
preset = \"fast\"
set = { \"train.iterations\" = 12, \"train.epochs\" = 100 }
";

fn batch(home: &Path, out: &str, more: &[&str]) -> Vec<String> {
    let manifest = home.join("batch.toml").display().to_string();
    let out = home.join(out).display().to_string();
    let mut arguments = vec!["batch".to_owned(), manifest, "--out".to_owned(), out];
    arguments.extend(more.iter().map(|text| (*text).to_owned()));
    arguments
}

/// Files below a folder that are products: the same whenever and however often they were made.
fn products(out: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let (mut found, mut open) = (Vec::new(), vec![out.to_owned()]);
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).expect("listable").flatten() {
            let path = entry.path();
            let product = ["tif", "ply", "png", "laz", "glb"]
                .iter()
                .any(|e| path.extension().is_some_and(|x| x == *e))
                || [
                    "model.json",
                    "mosaic.json",
                    "item.json",
                    "collection.json",
                    "tileset.json",
                    "ties.bin",
                    "cameras.json",
                ]
                .iter()
                .any(|name| path.ends_with(name));
            if path.is_dir() {
                open.push(path);
            } else if product {
                let below = path.strip_prefix(out).expect("below").to_owned();
                found.push((below, std::fs::read(&path).expect("readable")));
            }
        }
    }
    found.sort();
    found
}

fn assert_same(a: &[(PathBuf, Vec<u8>)], b: &[(PathBuf, Vec<u8>)]) {
    let names = |all: &[(PathBuf, Vec<u8>)]| all.iter().map(|(path, _)| path.clone()).collect::<Vec<_>>();
    assert_eq!(names(a), names(b));
    for ((path, a), (_, b)) in a.iter().zip(b) {
        assert!(a == b, "{} differs", path.display());
    }
}

/// Starts the batch in a process group of its own and kills all of it after a while, unless it is done before; whether
/// it was killed.
fn killed_after(home: &Path, out: &str, wait: Duration) -> bool {
    let mut command = Command::new(binary());
    command
        .args(batch(home, out, &["--checkpoint-every", "0", "--jobs", "2"]))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .process_group(0);
    let mut child = command.spawn().expect("starts");
    let begun = Instant::now();
    while begun.elapsed() < wait {
        if let Some(status) = child.try_wait().expect("waited") {
            assert!(status.success());
            return false;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let group = format!("-{}", child.id());
    let status = Command::new("kill").args(["-KILL", "--", &group]).status();
    assert!(status.is_ok_and(|status| status.success()));
    child.wait().expect("ends");
    true
}

#[test]
fn a_batch_that_is_killed_again_and_again_ends_with_the_same_bytes() {
    let home = home(FOUR_TILES);
    let kills: usize = std::env::var("HELIOSPLAT_KILLS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(3);
    let begun = Instant::now();
    let whole = json(&batch(home.path(), "whole", &["--jobs", "2"]));
    let took = begun.elapsed();
    assert_eq!(
        (whole["done"].as_u64(), whole["failed"].as_u64()),
        (Some(7), Some(0)),
        "{whole}"
    );
    let undisturbed = products(&home.path().join("whole"));
    assert!(undisturbed.len() > 80, "{}", undisturbed.len());
    products_of_the_mosaic(&home.path().join("whole"));

    // Every life is long enough to come further than the one before, so that all moments of the batch are met.
    let mut random = Pcg32::seed_from_u64(std::process::id().into());
    let (mut killed, mut lives) = (0, 0);
    while killed < kills {
        let life = took.mul_f64(random.random_range(0.05..1.0) * if kills > 5 { 0.5 } else { 0.8 });
        lives += 1;
        if killed_after(home.path(), "killed", life) {
            killed += 1;
        } else {
            // Done before its time: begun anew, until it was killed often enough.
            std::fs::remove_dir_all(home.path().join("killed")).expect("removed");
        }
    }
    let after = json(&batch(home.path(), "killed", &["--jobs", "2"]));
    println!(
        "killed {killed} times in {lives} lives; {} units were finished before the last",
        after["skipped"]
    );
    assert_eq!(
        (after["done"].as_u64(), after["failed"].as_u64()),
        (Some(7), Some(0)),
        "{after}"
    );
    assert_same(&undisturbed, &products(&home.path().join("killed")));

    // Once more there is nothing to do.
    let again = json(&batch(home.path(), "killed", &[]));
    assert_eq!(again["skipped"].as_u64(), Some(7));
    // Single units, as a workflow asks for them.
    let plan = json(&batch(home.path(), "killed", &["--plan"]));
    let units = plan["units"].as_array().expect("units");
    assert!(
        units
            .iter()
            .all(|unit| unit["done"] == true && unit["mem_mb"].as_u64().is_some_and(|mb| mb > 0))
    );
    let mosaic = units
        .iter()
        .find(|unit| unit["work"]["kind"] == "mosaic")
        .expect("a mosaic");
    assert_eq!(mosaic["after"].as_array().map(Vec::len), Some(4));
    let id = mosaic["id"].as_str().expect("a name");
    // A product that is gone makes its unit unfinished, and only that one.
    std::fs::remove_file(home.path().join("killed").join(id).join("dsm.tif")).expect("removed");
    let left = json(&batch(home.path(), "killed", &["--dry-run"]));
    let open = |unit: &&Value| unit["done"] == false;
    assert_eq!(left["units"].as_array().expect("units").iter().filter(open).count(), 1);
    json(&batch(home.path(), "killed", &["--only", id]));
    assert_same(&undisturbed, &products(&home.path().join("killed")));
}

/// Blocks have the values of a mosaic in one piece; what an earlier mosaic left is gone.
#[test]
fn the_blocks_of_a_mosaic_have_the_values_of_one_piece() {
    let home = home(FOUR_TILES);
    json(&batch(home.path(), "out", &["--jobs", "2"]));
    let of_preset = home.path().join("out/all/first/quick");
    let (joined, one) = (of_preset.join("mosaic"), home.path().join("one"));
    std::fs::rename(&joined, &one).expect("moved");
    let small = FOUR_TILES.replace("[tiles]", "[tiles]\nblock = 64");
    std::fs::write(home.path().join("batch.toml"), small).expect("written");
    let done = json(&batch(home.path(), "out", &["--jobs", "2"]));
    assert_eq!(
        (done["failed"].as_u64(), done["skipped"].as_u64()),
        (Some(0), Some(6)),
        "the tiles are kept"
    );
    let read = |path: &Path| {
        let file = Dataset::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let bands = 1..=file.raster_count();
        let values = bands.flat_map(|band| {
            let band = file.rasterband(band).expect("a band");
            band.read_as::<f32>((0, 0), file.raster_size(), file.raster_size(), None)
                .expect("pixels")
                .data()
                .to_vec()
        });
        (
            file.raster_size(),
            file.geo_transform().expect("a place"),
            values.collect::<Vec<f32>>(),
        )
    };
    let mut compared = 0;
    for (name, far_m) in [
        ("dsm", 0.0),
        ("dsm_stddev", 0.0),
        ("dsm_views", 0.0),
        ("albedo", 0.0),
        ("relit", 0.0),
        ("relit_shadow", 0.0),
        ("hillshade", 0.0),
        ("dtm", 0.1),
        ("sun_hours", 0.02),
    ] {
        let (whole, blocks) = (
            read(&one.join(format!("{name}.tif"))),
            read(&joined.join(format!("{name}.vrt"))),
        );
        assert!(
            whole.0 == blocks.0 && whole.1 == blocks.1,
            "{name}: {:?} {:?}",
            whole.1,
            blocks.1
        );
        let apart = whole
            .2
            .iter()
            .zip(&blocks.2)
            .filter(|(a, b)| (*a - *b).abs() > far_m)
            .count();
        assert!(apart == 0, "{name}: {apart} of {} cells differ", whole.2.len());
        assert!(whole.2.iter().any(|value| *value > -9999.0), "{name}");
        compared += 1;
    }
    assert_eq!(compared, 9);
    assert!(!joined.join("dsm.tif").exists() && joined.join("overview/dsm.tif").is_file());
    let count = |file: &Path| {
        las::Reader::from_path(file)
            .expect("a LAZ file")
            .header()
            .number_of_points()
    };
    let folders = std::fs::read_dir(&of_preset)
        .expect("listable")
        .flatten()
        .map(|entry| entry.path());
    let blocks: Vec<PathBuf> = folders
        .filter(|path| path.to_string_lossy().contains("block-r"))
        .collect();
    assert!(blocks.len() >= 4, "{blocks:?}");
    let points: u64 = blocks.iter().map(|block| count(&block.join("points.laz"))).sum();
    assert_eq!(points, count(&one.join("points.laz")));
    // The tileset over the blocks names theirs.
    let tileset = read_json(&joined.join("splats/tileset.json"));
    for child in tileset["root"]["children"].as_array().expect("children") {
        let uri = child["content"]["uri"].as_str().expect("an address");
        assert!(joined.join("splats").join(uri).is_file(), "{uri}");
    }
    let page = std::fs::read_to_string(joined.join("report.html")).expect("a page");
    assert!(
        page.contains("../block-r0c0/report.html")
            && page.contains("dsm.vrt")
            && page.contains("Tile-edge consistency")
    );
    assert!(joined.join("sun.html").is_file());
    let text = |path: PathBuf| std::fs::read_to_string(path).expect("a text");
    let layers = text(joined.join("layers.qlr"));
    assert!(layers.contains("./dsm.vrt") && layers.contains("./hillshade.vrt") && !layers.contains(".tif"));
    // Heights have one colour in all blocks: the style has the range of all.
    let range = |folder: &Path| {
        let style = text(folder.join("dsm.qml"));
        let number = |name: &str| {
            let (_, rest) = style.split_once(&format!("{name}=\"")).expect("a range");
            rest.split('"')
                .next()
                .and_then(|text| text.parse::<f32>().ok())
                .expect("a number")
        };
        [number("minimumValue"), number("maximumValue")]
    };
    let all = blocks.iter().map(|block| range(block));
    let widest = all.fold([f32::MAX, f32::MIN], |a, b| [a[0].min(b[0]), a[1].max(b[1])]);
    assert_eq!(range(&joined), widest);
    assert!(
        layers.contains(&format!("minimumValue=\"{}\"", widest[0])),
        "{widest:?}"
    );
    // In one piece again, nothing of the blocks is left in the folder.
    std::fs::write(home.path().join("batch.toml"), FOUR_TILES).expect("written");
    json(&batch(home.path(), "out", &[]));
    assert!(!joined.join("dsm.vrt").exists() && !joined.join("overview").exists());
    assert_eq!(
        std::fs::read(joined.join("dsm.tif")).expect("bytes"),
        std::fs::read(one.join("dsm.tif")).expect("bytes")
    );
}

/// The mosaic has all products on one grid, they are those of its tiles, and its item and its page name them.
fn products_of_the_mosaic(out: &Path) {
    let home = out.join("all/first/quick");
    let folder = home.join("mosaic");
    let item = read_json(&folder.join("item.json"));
    let assets = item["assets"].as_object().expect("assets");
    let masks: Vec<&String> = assets.keys().filter(|key| key.starts_with("shadow_")).collect();
    assert!(!masks.is_empty(), "{:?}", assets.keys());
    let open = |path: PathBuf| Dataset::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let dsm = open(folder.join("dsm.tif"));
    let rasters = ["dsm", "hillshade", "albedo", "relit", "relit_shadow", "sun_hours"].map(str::to_owned);
    for key in rasters.iter().chain(masks) {
        let file = open(folder.join(assets[key.as_str()]["href"].as_str().expect("a file")));
        assert_eq!(file.raster_size(), dsm.raster_size(), "{key}");
        assert_eq!(
            file.geo_transform().expect("a place"),
            dsm.geo_transform().expect("a place")
        );
        assert_eq!(
            file.metadata_item("LAYOUT", "IMAGE_STRUCTURE").as_deref(),
            Some("COG"),
            "{key}"
        );
    }
    // In the north-west corner only the first tile says anything.
    let tile = home.join("tile-r0c0");
    let [dsm_west, _, _, dsm_north, ..] = dsm.geo_transform().expect("a place");
    let corner = |folder: &Path, name: &str| {
        let file = open(folder.join(name));
        let [west, size, _, north, ..] = file.geo_transform().expect("a place");
        let cell = |distance: f64| (distance / size).round() as isize + 4;
        let at = (cell(dsm_west - west), cell(north - dsm_north));
        let band = file.rasterband(1).expect("a band");
        let pixels = band.read_as::<f32>(at, (30, 30), (30, 30), None).expect("pixels");
        pixels.data().to_vec()
    };
    let surface = corner(&folder, "dsm.tif");
    assert!(surface.iter().any(|z| *z > -9999.0));
    for name in ["dsm.tif", "hillshade.tif", "relit_shadow.tif"] {
        let (one, all) = (corner(&tile, name), corner(&folder, name));
        let apart = one
            .iter()
            .zip(&all)
            .filter(|(one, all)| (*one - *all).abs() > 1e-3)
            .count();
        assert!(apart == 0, "{name}: {apart} cells differ");
    }
    let (all, one) = (corner(&folder, "albedo.tif"), corner(&tile, "albedo.tif"));
    let known = all
        .iter()
        .zip(&one)
        .filter(|(all, one)| **all > -9999.0 && **one > 0.01);
    let ratios: Vec<f32> = known.map(|(all, one)| all / one).collect();
    assert!(ratios.len() > 100, "{}", ratios.len());
    let uneven = ratios.iter().filter(|r| (*r / ratios[0] - 1.0).abs() > 1e-3).count();
    assert!(
        uneven == 0,
        "{uneven} of {} cells have a gain of their own",
        ratios.len()
    );

    of_globes(&folder, &dsm, assets);

    // Every point of a core, once.
    let count = |file: PathBuf| {
        las::Reader::from_path(file)
            .expect("a LAZ file")
            .header()
            .number_of_points()
    };
    let of_tiles: u64 = ["r0c0", "r0c1", "r1c0", "r1c1"]
        .map(|name| count(home.join(format!("tile-{name}/points.laz"))))
        .iter()
        .sum();
    let merged = count(folder.join("points.laz"));
    assert!(merged > of_tiles / 2 && merged < of_tiles, "{merged} of {of_tiles}");

    let collection = read_json(&out.join("collection.json"));
    assert!(
        collection["links"]
            .to_string()
            .contains("./all/first/quick/mosaic/item.json")
    );
    assert_eq!(item["collection"], collection["id"]);
    let page = std::fs::read_to_string(folder.join("report.html")).expect("a page");
    for part in [
        "Tile-edge consistency",
        "tile-r1c1/run/report.html",
        "Shadows by date",
        "relit.tif",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("http") && !page.contains("<script") && !page.contains("<link"));
    assert_eq!(
        page.matches("src=").count(),
        page.matches("src=\"data:image/jpeg;base64,").count()
    );
    // Surface, lines, errors, albedo, relit, a date, four tiles.
    assert!(page.matches("src=").count() >= 10);
    let folder = folder.display().to_string();
    json(&["report", folder.as_str()]);
    assert!(page == std::fs::read_to_string(Path::new(&folder).join("report.html")).expect("a page"));
}

/// The 3D Tiles of a mosaic: levels of detail, files that are there, and the site's middle where it is; `export` of its
/// folder writes the same.
fn of_globes(folder: &Path, dsm: &Dataset, assets: &serde_json::Map<String, Value>) {
    let again = tempdir().expect("a temporary folder");
    for (name, mesh) in [("splats", false), ("surface", true)] {
        let href = assets[name]["href"].as_str().expect("a file");
        assert_eq!(href, format!("./{name}/tileset.json"));
        let tileset = read_json(&folder.join(href));
        let number = |value: &Value| value.as_f64().expect("a number");
        let mut deepest = 0;
        let mut open = vec![(&tileset["root"], 1)];
        while let Some((tile, depth)) = open.pop() {
            deepest = deepest.max(depth);
            let file = tile["content"]["uri"].as_str().expect("a name");
            assert!(
                std::fs::read(folder.join(name).join(file))
                    .expect("readable")
                    .starts_with(b"glTF")
            );
            open.extend(
                tile["children"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .map(|child| (child, depth + 1)),
            );
        }
        assert!(deepest >= 3, "{name}: {deepest} levels");
        // The frame stands below the middle of the grid, and the root's box reaches over most of the surface.
        let (width, height) = dsm.raster_size();
        let cell_m = dsm.geo_transform().expect("a place")[1];
        let sides = [width as f64 * cell_m, height as f64 * cell_m];
        let volume: Vec<f64> = tileset["root"]["boundingVolume"]["box"]
            .as_array()
            .expect("12")
            .iter()
            .map(number)
            .collect();
        for (k, side) in sides.into_iter().enumerate() {
            assert!(volume[k].abs() < 0.2 * side, "{name}: {volume:?}");
            assert!(
                (0.6 * side..1.4 * side).contains(&(2.0 * volume[3 + 4 * k])),
                "{name}: {volume:?} of {side} m"
            );
        }
        let out = again.path().join(name).display().to_string();
        let mosaic = folder.display().to_string();
        let mut arguments = vec!["export", mosaic.as_str(), "--tiles", &out, "--sun", "200,40"];
        arguments.extend(mesh.then_some("--mesh"));
        json(&arguments);
        for file in ["tileset.json", "tile.glb"] {
            let read = |home: &Path| std::fs::read(home.join(file)).expect("readable");
            assert!(read(Path::new(&out)) == read(&folder.join(name)), "{name}/{file}");
        }
    }
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("readable")).expect("JSON")
}

#[test]
fn a_batch_may_make_surface_models_alone() {
    let home = home(
        "
[products]
dsm_only = true
[[images]]
name = \"first\"
scene = \"scene\"
[[presets]]
name = \"fast\"
set = { \"train.iterations\" = 4 }
",
    );
    json(&batch(home.path(), "out", &[]));
    let mosaic = home.path().join("out/all/first/fast/mosaic");
    assert!(mosaic.join("dsm.tif").is_file() && mosaic.join("report.html").is_file());
    assert!(!mosaic.join("albedo.tif").exists() && !mosaic.join("item.json").exists());
    assert!(!home.path().join("out/collection.json").exists());
    // Another build of the program, of which this is one by a byte more at its end, does not take them for its own.
    let other = home.path().join("heliosplat");
    let mut program = std::fs::read(binary()).expect("readable");
    program.push(b'\n');
    std::fs::write(&other, program).expect("written");
    std::fs::set_permissions(&other, std::fs::Permissions::from_mode(0o755)).expect("made a program");
    let output = Command::new(&other)
        .args(batch(home.path(), "out", &["--dry-run"]))
        .output();
    let said = String::from_utf8_lossy(&output.expect("starts").stdout).into_owned();
    let again = said
        .lines()
        .filter(|line| line.starts_with("to do, done by another build"));
    assert_eq!(again.count(), 2, "{said}");
    // Asked for later, the other products are made without another training.
    let manifest = home.path().join("batch.toml");
    let text = std::fs::read_to_string(&manifest).expect("readable");
    std::fs::write(&manifest, text.replace("dsm_only = true", "")).expect("written");
    let model = home.path().join("out/all/first/fast/tile-r0c0/run/model.json");
    let changed = |path: &Path| {
        std::fs::metadata(path)
            .and_then(|data| data.modified())
            .expect("a time")
    };
    let before = changed(&model);
    let again = json(&batch(home.path(), "out", &[]));
    assert_eq!(again["skipped"].as_u64(), Some(0));
    assert!(mosaic.join("albedo.tif").is_file() && mosaic.join("item.json").is_file());
    assert_eq!(changed(&model), before, "the model is the one that was trained");
}

#[test]
fn what_fails_is_told_with_its_log_and_does_not_stop_the_rest() {
    let manifest = "
[[images]]
name = \"sound\"
scene = \"scene\"
[[images]]
name = \"gone\"
scene = \"no_such_folder\"
[[images]]
name = \"broken\"
scene = \"broken\"
[[presets]]
name = \"fast\"
set = { \"train.iterations\" = 4 }
";
    let home = home(manifest);
    let broken = home.path().join("broken");
    std::fs::create_dir(&broken).expect("made");
    for entry in std::fs::read_dir(home.path().join("scene"))
        .expect("listable")
        .flatten()
    {
        if entry.path().is_file() {
            std::fs::copy(entry.path(), broken.join(entry.file_name())).expect("copied");
        }
    }
    let image = std::fs::read_dir(&broken)
        .expect("listable")
        .flatten()
        .map(|entry| entry.path());
    let image = image
        .filter(|path| path.extension().is_some_and(|e| e == "tif"))
        .min()
        .expect("an image");
    // Its header is whole, its pixels are not.
    let bytes = std::fs::read(&image).expect("readable");
    std::fs::write(&image, &bytes[..bytes.len() * 2 / 3]).expect("written");

    let line = fault(&batch(home.path(), "out", &[]), 1);
    assert!(
        line.contains("units are not done") && line.contains("all/gone/refused"),
        "{line}"
    );
    let summary = std::fs::read(home.path().join("out/summary.json")).expect("a summary");
    let summary: Value = serde_json::from_slice(&summary).expect("JSON");
    let state = |id: &str| -> (String, String) {
        let rows = summary["units"].as_array().expect("units");
        let row = rows
            .iter()
            .find(|row| row["unit"] == id)
            .unwrap_or_else(|| panic!("{id} in {summary}"));
        let text = |key: &str| row[key].as_str().unwrap_or("").to_owned();
        (text("state"), text("error"))
    };
    assert_eq!(state("all/sound/fast/mosaic").0, "done");
    let (gone, why) = state("all/gone/refused");
    assert!(gone == "failed" && why.contains("no_such_folder"), "{why}");
    // The plan is kept with the refused unit: the process of a unit reads it, and does not plan again.
    let plan = home.path().join("out/plan.json");
    let modified = || plan.metadata().and_then(|data| data.modified()).expect("a plan");
    let (before, shown) = (
        modified(),
        heliosplat(&batch(home.path(), "out", &["--dry-run"])).output(),
    );
    let shown = String::from_utf8_lossy(&shown.expect("it runs").stdout).into_owned();
    assert!(
        shown.contains("refused   all/gone/refused: ") && shown.contains("no_such_folder"),
        "{shown}"
    );
    assert_eq!(modified(), before);
    assert!(home.path().join("out/inputs.json").is_file());
    let units = summary["units"].as_array().expect("units");
    let row = units
        .iter()
        .find(|row| row["unit"].as_str().is_some_and(|id| id.starts_with("all/broken")));
    let row = row.expect("the broken scene is there");
    assert_eq!(row["state"], "failed", "{row}");
    let log = std::fs::read_to_string(row["log"].as_str().expect("a log"));
    assert!(log.is_ok_and(|log| log.contains("error: ")), "{row}");
    for name in ["summary.csv", "summary.html"] {
        let text = std::fs::read_to_string(home.path().join("out").join(name)).expect(name);
        assert!(
            text.contains("all/sound/fast/mosaic") && text.contains("failed"),
            "{name}"
        );
    }
}

#[test]
fn manifests_that_would_write_elsewhere_or_mean_nothing_are_refused_at_once() {
    let folder = tempdir().expect("a temporary folder");
    let cases = [
        ("[[images]]\nname = \"../../x\"\nscene = \"a\"\n", "is no name"),
        ("[[images]]\nname = \"/etc\"\nscene = \"a\"\n", "is no name"),
        (
            "[[images]]\nname = \"a\"\nscene = \"a\"\n[[areas]]\nname = \"..\"\n",
            "is no name",
        ),
        ("[[images]]\nname = \"a\"\n", "scene"),
        ("nothing", "line 1"),
        ("images = []\n", "no images"),
    ];
    for (text, said) in cases {
        std::fs::write(folder.path().join("batch.toml"), text).expect("written");
        let line = fault(&batch(folder.path(), "out", &["--plan"]), 2);
        assert!(line.contains(said) && line.contains("batch.toml"), "{line}");
        assert!(!folder.path().join("out").exists(), "nothing is written");
    }
    let line = fault(&["batch", "no/such.toml", "--out", "x"], 2);
    assert!(line.contains("no/such.toml"), "{line}");
    heliosplat(&["batch", "a.toml", "--out", "x", "--jobs", "0"])
        .assert()
        .code(2);
}

#[test]
fn a_scene_in_an_archive_is_read_where_the_user_names_it_and_a_piece_of_ground_alone() {
    let home = home(FOUR_TILES);
    let status = Command::new("tar")
        .args(["-cf", "scene.tar", "scene"])
        .current_dir(home.path())
        .status();
    assert!(status.is_ok_and(|status| status.success()));
    let archive = format!("/vsitar/{}/scene.tar/scene", home.path().display());
    let seen = json(&["inspect", &archive, "--altitude", "470,530"]);
    assert_eq!(seen["images"].as_array().map(Vec::len), Some(4));
    let line = fault(&["inspect", "/vsitar//no/such.tar/scene"], 2);
    assert!(line.contains("/no/such.tar"), "{line}");

    let scene = home.path().join("scene").display().to_string();
    let (lon, lat) = (seen["origin"]["lon_deg"].as_f64(), seen["origin"]["lat_deg"].as_f64());
    let (lon, lat) = (lon.expect("a longitude"), lat.expect("a latitude"));
    let area = format!("{},{},{},{}", lon - 1e-4, lat - 1e-4, lon + 1e-4, lat + 1e-4);
    let piece = json(&["inspect", &scene, "--area", &area]);
    let width = |seen: &Value| {
        seen["area_m"]["east_m"].as_f64().expect("east") - seen["area_m"]["west_m"].as_f64().expect("west")
    };
    assert!(
        width(&piece) < 25.0 && width(&seen) > 40.0,
        "{} {}",
        width(&piece),
        width(&seen)
    );
    let line = fault(&["inspect", &scene, "--area", "10,10,10.1,10.1"], 2);
    assert!(line.contains("10,10,10.1,10.1"), "{line}");
}
