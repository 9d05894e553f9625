//! Products of a run for a GIS, read back with GDAL and a LAS reader: georeference, bands, nodata, overviews, layout,
//! and the agreement of the STAC item with the files.

use gdal::raster::ColorInterpretation;
use gdal::{Dataset, Metadata};
use heliosplat_raster::Geoid;
use heliosplat_raster::geoid::Undulation;
use heliosplat_tests::program::{fault, json};
use heliosplat_tests::scenes::{View, write_scene};
use serde_json::Value;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use tempfile::{TempDir, tempdir};

/// A run over flat ground with four bands, made once; the second view is of another pass, the last one of another day.
static RUN: LazyLock<TempDir> = LazyLock::new(|| {
    let home = tempdir().expect("a temporary folder");
    let scene = home.path().join("scene");
    std::fs::create_dir(&scene).expect("made");
    let mut views = [0, 1, 2].map(|number| View {
        bands: 4,
        ..View::new(number)
    });
    views[1].date = Some("20160423140000");
    views[2].date = Some("20160920101500");
    write_scene(&scene, &views);
    let mut arguments: Vec<OsString> = [
        "train".into(),
        scene.into(),
        "--out".into(),
        home.path().join("run").into(),
    ]
    .into();
    arguments.extend(
        [
            "--preset",
            "fast",
            "--altitude",
            "690,710",
            "--set",
            "train.iterations=10",
        ]
        .map(OsString::from),
    );
    json(&arguments);
    home
});

fn run() -> PathBuf {
    RUN.path().join("run")
}

fn products(runs: &[&Path], out: &Path, more: &[&str]) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = vec!["products".into()];
    arguments.extend(runs.iter().map(|run| run.as_os_str().to_owned()));
    arguments.extend(["--out".into(), out.into()]);
    arguments.extend(more.iter().map(OsString::from));
    arguments
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("readable")).expect("JSON")
}

fn band(dataset: &Dataset, index: usize) -> Vec<f32> {
    let (width, height) = dataset.raster_size();
    let band = dataset.rasterband(index).expect("a band");
    let (_, values) = band
        .read_as::<f32>((0, 0), (width, height), (width, height), None)
        .expect("pixels")
        .into_shape_and_vec();
    values
}

/// Name of the file, descriptions of its bands, nodata.
const EXPECTED: [(&str, &[&str], f64); 15] = [
    ("dsm", &["altitude"], -9999.0),
    ("dsm_stddev", &["standard_deviation"], -9999.0),
    ("dsm_coverage", &["coverage"], -9999.0),
    ("dsm_views", &["views"], -9999.0),
    ("dtm", &["ground"], -9999.0),
    ("ndsm", &["height_above_ground"], -9999.0),
    ("hillshade", &["shade"], 0.0),
    ("albedo", &["red", "green", "blue", "near_infrared"], -9999.0),
    ("vegetation", &["vegetation"], 255.0),
    ("canopy", &["canopy_height"], -9999.0),
    ("relit", &["red", "green", "blue", "near_infrared"], -9999.0),
    ("relit_shadow", &["shadow"], 255.0),
    ("shadow_2016-04-23", &["shadow"], 255.0),
    ("shadow_2016-04-23_1400", &["shadow"], 255.0),
    ("shadow_2016-09-20", &["shadow"], 255.0),
];

#[test]
fn products_are_cloud_optimised_lie_on_one_grid_and_are_what_their_item_says() {
    let home = tempdir().expect("a temporary folder");
    let out = home.path().join("products");
    json(&products(&[&run()], &out, &["--sun", "200,40", "--gsd", "0.1"]));
    let item = read_json(&out.join("item.json"));
    let assets = item["assets"].as_object().expect("assets");
    // The point cloud and the thumbnail besides.
    assert_eq!(assets.len(), EXPECTED.len() + 2, "{:?}", assets.keys());
    assert_eq!(assets["thumbnail"]["roles"], serde_json::json!(["thumbnail"]));
    let thumbnail = image::open(out.join("thumbnail.png")).expect("a picture");
    assert!(thumbnail.width().max(thumbnail.height()) <= 512);
    for (key, names, nodata) in EXPECTED {
        let dataset = Dataset::open(out.join(format!("{key}.tif"))).expect("GDAL reads it");
        let layout = dataset.metadata_item("LAYOUT", "IMAGE_STRUCTURE");
        assert_eq!(layout.as_deref(), Some("COG"), "{key}");
        let predictor = dataset.metadata_item("PREDICTOR", "IMAGE_STRUCTURE");
        assert_eq!(predictor, None, "{key}: Whitebox reads none");
        assert_eq!(dataset.raster_count(), names.len(), "{key}");
        let (width, height) = dataset.raster_size();
        let transform = dataset.geo_transform().expect("a geotransform");
        same_place(&item["properties"], (width, height), &transform, &dataset);
        let asset = &assets[key];
        assert_eq!(asset["href"], format!("./{key}.tif"));
        for (index, name) in names.iter().enumerate() {
            let band_of = dataset.rasterband(index + 1).expect("a band");
            assert_eq!(band_of.description().expect("a description"), *name, "{key}");
            assert_eq!(band_of.no_data_value(), Some(nodata), "{key}");
            assert!(band_of.overview_count().expect("overviews") > 0, "{key}");
            assert_eq!(band_of.block_size(), (256, 256), "{key}");
            let colour = match *name {
                "red" => ColorInterpretation::RedBand,
                "green" => ColorInterpretation::GreenBand,
                "blue" => ColorInterpretation::BlueBand,
                "near_infrared" => ColorInterpretation::Undefined,
                _ => ColorInterpretation::GrayIndex,
            };
            assert_eq!(band_of.color_interpretation(), colour, "{key} {name}");
            let mean: f64 = band_of
                .metadata_item("STATISTICS_MEAN", "")
                .expect(key)
                .parse()
                .expect("a number");
            let said = asset["bands"][index]["statistics"]["mean"].as_f64().expect("a number");
            assert!(
                (mean - said).abs() <= 1e-4 * said.abs().max(1.0),
                "{key} {name}: {mean} {said}"
            );
            assert_eq!(asset["bands"][index]["name"], *name);
            assert_eq!(asset["bands"][index]["nodata"].as_f64(), Some(nodata));
            assert_eq!(asset["bands"][index]["raster:sampling"], "area");
            statistics_agree(
                &asset["bands"][index]["statistics"],
                &band(&dataset, index + 1),
                nodata,
                key,
            );
        }
    }
    styles_are_beside_their_rasters(&out);
    values_make_sense(&out);
    required_fields(&item);
    let sun = &assets["relit"];
    assert!((sun["view:sun_azimuth"].as_f64().expect("an angle") - 200.0).abs() < 1e-9);
    assert!((sun["view:sun_elevation"].as_f64().expect("an angle") - 40.0).abs() < 1e-9);
}

/// A style beside every raster, and a layer file that opens each of them once.
fn styles_are_beside_their_rasters(out: &Path) {
    let text = |name: &str| std::fs::read_to_string(out.join(name)).expect("readable");
    let layers = text("layers.qlr");
    for (key, names, _) in EXPECTED {
        let style = text(&format!("{key}.qml"));
        assert!(style.contains("<rasterrenderer") && !style.contains('{'), "{key}");
        if names[0] == "red" {
            assert!(style.contains("redBand=\"1\" greenBand=\"2\" blueBand=\"3\""), "{key}");
        }
        assert_eq!(layers.matches(&format!("<datasource>./{key}.tif<")).count(), 1, "{key}");
    }
    assert_eq!(layers.matches("<maplayer ").count(), EXPECTED.len());
}

fn same_place(properties: &Value, (width, height): (usize, usize), transform: &[f64; 6], dataset: &Dataset) {
    assert_eq!(properties["proj:shape"], serde_json::json!([height, width]));
    let said: Vec<f64> = serde_json::from_value(properties["proj:transform"].clone()).expect("six numbers");
    let [west, per_col, skew, north, other, per_row] = *transform;
    for (a, b) in said.iter().zip([per_col, skew, west, other, per_row, north]) {
        assert!((a - b).abs() < 1e-6, "{said:?} {transform:?}");
    }
    let reference = dataset.spatial_ref().expect("a coordinate system");
    assert_eq!(reference.authority().expect("a code"), "EPSG:32637");
    assert_eq!(properties["proj:code"], "EPSG:32637");
    assert!((per_col - 0.1).abs() < 1e-9 && (per_row + 0.1).abs() < 1e-9);
    // The scene's centre, 36.91 E 37.58 N, by an independent formula: PROJ's `cs2cs` gives it in UTM 37N.
    let (east, north_m) = (315_451.4, 4_161_270.1);
    let inside = west < east
        && east < west + per_col * width as f64
        && north_m < north
        && north_m > north + per_row * height as f64;
    assert!(inside, "{transform:?} {width} {height}");
}

fn statistics_agree(said: &Value, values: &[f32], nodata: f64, key: &str) {
    let known: Vec<f64> = values.iter().map(|&v| f64::from(v)).filter(|v| *v != nodata).collect();
    assert!(!known.is_empty(), "{key}: nothing is known");
    let close = |name: &str, value: f64| {
        let said = said[name].as_f64().expect("a number");
        assert!(
            (said - value).abs() <= 1e-4 * value.abs().max(1.0),
            "{key} {name}: {said} {value}"
        );
    };
    close("minimum", known.iter().copied().fold(f64::INFINITY, f64::min));
    close("maximum", known.iter().copied().fold(f64::NEG_INFINITY, f64::max));
    close("mean", known.iter().sum::<f64>() / known.len() as f64);
    close("valid_percent", 100.0 * known.len() as f64 / values.len() as f64);
}

fn values_make_sense(out: &Path) {
    let open = |name: &str| Dataset::open(out.join(name)).expect("readable");
    let dsm = open("dsm.tif");
    assert_eq!(dsm.rasterband(1).expect("a band").unit(), "metre");
    let altitude = band(&dsm, 1);
    let known = altitude.iter().filter(|v| **v != -9999.0);
    assert!(known.clone().all(|v| (685.0..715.0).contains(v)));
    for ((z, ground), above) in altitude
        .iter()
        .zip(band(&open("dtm.tif"), 1))
        .zip(band(&open("ndsm.tif"), 1))
    {
        let is_known = *z != -9999.0;
        assert!(if is_known {
            (z - ground - above).abs() < 1e-3 && above >= 0.0
        } else {
            ground == *z && above == *z
        });
    }
    let heights = band(&open("ndsm.tif"), 1);
    for ((canopy, leaf), above) in band(&open("canopy.tif"), 1)
        .iter()
        .zip(band(&open("vegetation.tif"), 1))
        .zip(heights)
    {
        let expected = match (leaf, above) {
            (255.0, _) | (_, -9999.0) => -9999.0,
            _ => leaf * above,
        };
        assert_eq!(*canopy, expected);
    }
    let (known, shade) = (known.count(), band(&open("hillshade.tif"), 1));
    assert_eq!(
        known,
        shade.iter().filter(|v| **v >= 1.0).count(),
        "shades where altitudes are"
    );
    for mask in ["vegetation.tif", "relit_shadow.tif", "shadow_2016-04-23.tif"] {
        assert!(
            band(&open(mask), 1).iter().all(|v| [0.0, 1.0, 255.0].contains(v)),
            "{mask}"
        );
    }
}

/// Fields that STAC 1.1 requires of every item.
fn required_fields(item: &Value) {
    assert_eq!(item["type"], "Feature");
    assert_eq!(item["stac_version"], "1.1.0");
    assert!(item["id"].is_string() && item["links"].is_array());
    let properties = &item["properties"];
    assert!(properties["datetime"].is_null());
    assert_eq!(properties["start_datetime"], "2016-04-23T08:34:00Z");
    assert_eq!(properties["end_datetime"], "2016-09-20T10:15:00Z");
    assert_eq!(properties["view:off_nadir"], 0.0);
    let extensions = item["stac_extensions"].to_string();
    assert!(
        ["projection", "raster", "view"]
            .iter()
            .all(|name| extensions.contains(name))
    );
    let bbox: Vec<f64> = serde_json::from_value(item["bbox"].clone()).expect("four numbers");
    assert!(
        bbox[0] < 36.91 && 36.91 < bbox[2] && bbox[1] < 37.58 && 37.58 < bbox[3],
        "{bbox:?}"
    );
    let ring: Vec<[f64; 2]> = serde_json::from_value(item["geometry"]["coordinates"][0].clone()).expect("a ring");
    assert!(ring.len() == 5 && ring[0] == ring[4]);
    let area: f64 = ring.windows(2).map(|p| p[0][0] * p[1][1] - p[1][0] * p[0][1]).sum();
    assert!(area > 0.0, "counter-clockwise");
}

#[test]
fn the_point_cloud_has_colours_a_coordinate_system_and_lies_on_the_surface() {
    let home = tempdir().expect("a temporary folder");
    let out = home.path().join("products");
    json(&products(&[&run()], &out, &[]));
    let mut reader = las::Reader::from_path(out.join("points.laz")).expect("a LAZ file");
    let header = reader.header().clone();
    assert_eq!((header.version().major, header.version().minor), (1, 4));
    let wkt = header.get_wkt_crs_bytes().expect("a coordinate system");
    assert!(String::from_utf8_lossy(wkt).contains("UTM zone 37N"));
    let points = reader.read_all().expect("points");
    let points: Vec<las::Point> = points.points().collect::<Result<_, _>>().expect("points");
    assert!(points.len() > 1000 && points.len() as u64 == header.number_of_points());
    let dsm = Dataset::open(out.join("dsm.tif")).expect("readable");
    let [west, size, _, north, _, _] = dsm.geo_transform().expect("a geotransform");
    let (width, height) = dsm.raster_size();
    let inside = |p: &&las::Point| {
        let (col, row) = ((p.x - west) / size, (north - p.y) / size);
        col >= 0.0 && col < width as f64 && row >= 0.0 && row < height as f64
    };
    assert_eq!(points.iter().filter(inside).count(), points.len());
    assert!(points.iter().all(|p| (680.0..720.0).contains(&p.z)));
    let coloured = points.iter().filter(|p| p.color.is_some_and(|c| c.red > 1000)).count();
    assert!(coloured * 2 > points.len(), "{coloured} of {}", points.len());
    let dtm = Dataset::open(out.join("dtm.tif")).expect("readable");
    let ground = dtm
        .rasterband(1)
        .expect("a band")
        .read_band_as::<f32>()
        .expect("readable");
    let height_m = |p: &las::Point| {
        let (col, row) = (((p.x - west) / size) as usize, ((north - p.y) / size) as usize);
        p.z - f64::from(ground.data()[row * width + col])
    };
    // The images are panchromatic, so only ground has a class. Coordinates in the file are rounded, so a few points
    // change their cell.
    let is_ground = |p: &&las::Point| p.classification == las::point::Classification::Ground;
    let wrong = |p: &&las::Point| is_ground(p) != (height_m(p) <= 0.5);
    assert!(points.iter().filter(is_ground).count() > 1000);
    let wrong = points.iter().filter(wrong).count();
    assert!(wrong * 100 < points.len(), "{wrong} of {}", points.len());
}

#[test]
fn heights_above_a_geoid_differ_by_it_in_all_files_and_a_missing_grid_is_named_before_anything_is_written() {
    let home = tempdir().expect("a temporary folder");
    let at = |name: &str| home.path().join(name);
    if Undulation::new(Geoid::Egm2008).is_err() {
        let line = fault(&products(&[&run()], &at("none"), &["--geoid", "egm2008"]), 2);
        assert!(
            line.contains("us_nga_egm08_25.tif") && line.contains("projsync"),
            "{line}"
        );
        assert!(!at("none").exists());
    }
    let Ok(egm96) = Undulation::new(Geoid::Egm96) else {
        println!("skipped: PROJ has no grid of EGM96 here");
        return;
    };
    json(&products(&[&run()], &at("ellipsoid"), &[]));
    json(&products(&[&run()], &at("geoid"), &["--geoid", "egm96"]));
    let open = |folder: &str| Dataset::open(at(folder).join("dsm.tif")).expect("readable");
    let (above, over) = (open("geoid"), open("ellipsoid"));
    let name = above
        .spatial_ref()
        .expect("a coordinate system")
        .name()
        .expect("a name");
    assert!(name.contains("EGM96"), "{name}");
    assert_eq!(above.metadata_item("VERTICAL_DATUM", "").as_deref(), Some("EGM96"));
    let height = egm96.at(36.91, 37.58).expect("a value");
    assert!(height > 10.0, "{height}");
    for (low, high) in band(&above, 1).iter().zip(band(&over, 1)) {
        let same = *low == -9999.0 && high == -9999.0;
        assert!(
            same || (f64::from(high - low) - height).abs() < 0.05,
            "{low} {high} {height}"
        );
    }
    let lowest = |folder: &str| {
        let reader = las::Reader::from_path(at(folder).join("points.laz")).expect("a LAZ file");
        reader.header().bounds().min.z
    };
    assert!((lowest("ellipsoid") - lowest("geoid") - height).abs() < 0.05);
    // A vertical part of the coordinate system is the same as the geoid, in all three files.
    json(&products(&[&run()], &at("compound"), &["--crs", "EPSG:32637+5773"]));
    assert_eq!(band(&open("compound"), 1), band(&above, 1));
    assert_eq!(lowest("compound"), lowest("geoid"));
    let reader = las::Reader::from_path(at("compound").join("points.laz")).expect("a LAZ file");
    let wkt = reader
        .header()
        .get_wkt_crs_bytes()
        .expect("a coordinate system")
        .to_vec();
    assert!(String::from_utf8_lossy(&wkt).contains("EGM96"));
    let item = read_json(&at("compound").join("item.json"));
    assert_eq!(item["properties"]["heliosplat:vertical_datum"], "EGM96");
    let surface = &item["assets"]["dsm"];
    assert!(
        surface["title"]
            .as_str()
            .is_some_and(|title| title.ends_with("above EGM96"))
    );
    let known = band(&above, 1).into_iter().filter(|z| *z != -9999.0);
    let least = f64::from(known.fold(f32::MAX, f32::min));
    let stated = surface["bands"][0]["statistics"]["minimum"].as_f64();
    assert!(
        stated.is_some_and(|stated| (stated - least).abs() < 1e-3),
        "{stated:?} {least}"
    );
}

#[test]
fn several_runs_make_a_collection_and_the_same_run_gives_the_same_bytes() {
    let home = tempdir().expect("a temporary folder");
    let out = home.path().join("catalogue");
    let folder = run();
    json(&products(&[&folder, &folder], &out, &[]));
    let collection = read_json(&out.join("collection.json"));
    assert_eq!(collection["type"], "Collection");
    assert!(collection["license"].is_string() && collection["description"].is_string());
    let links = collection["links"].as_array().expect("links");
    let items: Vec<&Value> = links.iter().filter(|link| link["rel"] == "item").collect();
    assert_eq!(items.len(), 2);
    for link in items {
        let item = read_json(&out.join(link["href"].as_str().expect("a path")));
        assert_eq!(item["collection"], collection["id"]);
        let up = item["links"].as_array().expect("links");
        assert!(
            up.iter()
                .any(|link| link["rel"] == "collection" && link["href"] == "../collection.json")
        );
        assert_eq!(collection["extent"]["spatial"]["bbox"][0], item["bbox"]);
    }
    for file in ["dsm.tif", "points.laz", "shadow_2016-04-23.tif"] {
        let read = |id: &str| std::fs::read(out.join(id).join(file)).expect("readable");
        assert!(read("run") == read("run_2"), "{file}");
    }
}

#[test]
fn a_sun_below_the_horizon_is_refused_and_nothing_is_written() {
    let home = tempdir().expect("a temporary folder");
    let out = home.path().join("products");
    let line = fault(&products(&[&run()], &out, &["--sun", "200,-5"]), 2);
    assert!(line.contains("-5.00"), "{line}");
    fault(&products(&[&run()], &out, &["--at", "2016-04-23T22:00:00Z"]), 2);
    fault(&products(&[home.path()], &out, &[]), 2);
    fault(&["products".into(), run().into_os_string(), run().into_os_string()], 2);
    assert!(!out.exists());
}

#[test]
fn a_run_has_a_page_that_needs_nothing_else() {
    let path = run().join("report.html");
    let page = std::fs::read_to_string(&path).expect("train writes it");
    for part in [
        "Surface",
        "2016-04-23",
        "2016-09-20",
        "Component plan",
        "Time and memory",
        "model.image_colour",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("http") && !page.contains("<script") && !page.contains("<link"));
    let (surface, _) = page.split_once("<details>").expect("the making is folded away");
    assert!(surface.contains("EPSG:32637") && surface.contains("./dsm.tif") && !surface.contains("PSNR"));
    let sources = page.matches("src=").count();
    assert!(sources > 8 && sources == page.matches("src=\"data:image/jpeg;base64,").count());
    json(&["report".into(), run().into_os_string()]);
    assert!(
        page == std::fs::read_to_string(&path).expect("readable"),
        "the same page again"
    );
    fault(&["report", "no/such/run"], 2);
}

#[test]
fn products_of_two_calls_are_all_listed_and_those_of_another_grid_are_not() {
    let home = tempdir().expect("a temporary folder");
    let out = home.path().join("products");
    let keys = |more: &[&str]| -> Vec<String> {
        json(&products(&[&run()], &out, more));
        let item = read_json(&out.join("item.json"));
        item["assets"].as_object().expect("assets").keys().cloned().collect()
    };
    let layers = || std::fs::read_to_string(out.join("layers.qlr")).expect("readable");
    let first = keys(&["--sun", "200,40"]);
    let has = |keys: &[String], key: &str| keys.iter().any(|known| known == key);
    assert!(has(&first, "relit") && has(&first, "relit_shadow"));
    let second = keys(&["--sun-hours", "2016-06-21"]);
    assert_eq!(second.len(), first.len() + 3, "{second:?}");
    assert!(has(&second, "relit") && has(&second, "sun_hours"));
    for file in ["relit.tif", "relit_shadow.tif", "sun_hours.tif", "dsm.tif"] {
        assert_eq!(layers().matches(&format!("<datasource>./{file}<")).count(), 1, "{file}");
    }
    std::fs::remove_file(out.join("relit_shadow.tif")).expect("removed");
    let third = keys(&[]);
    assert!(
        has(&third, "relit") && has(&third, "sky_view") && !has(&third, "relit_shadow"),
        "{third:?}"
    );
    let other_grid = keys(&["--gsd", "0.25"]);
    assert!(!has(&other_grid, "relit") && !has(&other_grid, "sun_hours") && has(&other_grid, "dsm"));
    assert!(!layers().contains("relit.tif"));
}

#[test]
fn a_run_has_one_surface_model_to_which_its_products_refer() {
    let home = tempdir().expect("a temporary folder");
    let copy = home.path().join("run");
    std::fs::create_dir(&copy).expect("made");
    for entry in std::fs::read_dir(run())
        .expect("listable")
        .map(|entry| entry.expect("an entry"))
    {
        if entry.path().is_file() {
            std::fs::copy(entry.path(), copy.join(entry.file_name())).expect("copied");
        }
    }
    let out = copy.join("products");
    json(&products(&[&copy], &out, &[]));
    assert!(!out.join("dsm.tif").exists() && !out.join("dsm_views.tif").exists());
    let item = read_json(&out.join("item.json"));
    assert_eq!(item["assets"]["dsm"]["href"], "../dsm.tif");
    assert_eq!(item["assets"]["dsm_stddev"]["href"], "../dsm_stddev.tif");
    let layers = std::fs::read_to_string(out.join("layers.qlr")).expect("readable");
    assert_eq!(layers.matches("<datasource>../dsm.tif<").count(), 1);
    let report = std::fs::read_to_string(copy.join("report.html")).expect("readable");
    assert!(report.contains("href=\"./products/ndsm.tif\""));
    // On another grid it is another surface model.
    json(&products(&[&copy], &out, &["--gsd", "0.25"]));
    assert_eq!(read_json(&out.join("item.json"))["assets"]["dsm"]["href"], "./dsm.tif");
    assert!(out.join("dsm_views.tif").is_file() && out.join("dsm_views.qml").is_file());
}
