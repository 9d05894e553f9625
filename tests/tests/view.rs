//! The page with the sun: results of its scripts, run by node where it is installed, and the page itself in Chromium
//! where it is installed. The sun is compared with `heliosplat sun`, shadows with a walk along each ray, which shares
//! no code with them.

use heliosplat::Raster;
use heliosplat_products::nadir::NadirGrid;
use heliosplat_products::surface_shadow::{CASTER, SurfaceShadows};
use heliosplat_raster::write::{ImageSpec, write_cog};
use heliosplat_raster::{Crs, CrsTransform, GeoTransform, GridSpec};
use heliosplat_rpc::GeoPoint;
use heliosplat_rpc::sun::{SunPosition, sun_position};
use heliosplat_tests::program::{fault, json};
use serde_json::{Value, json as value};
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::tempdir;

const WIDTH: usize = 220;
const HEIGHT: usize = 200;
const CELL_M: f64 = 0.5;
/// Suns that the shadows are compared under: azimuth and elevation, degrees.
const SUNS: [[f64; 2]; 6] = [
    [20.0, 40.0],
    [75.0, 25.0],
    [135.0, 55.0],
    [200.0, 35.0],
    [250.0, 35.0],
    [318.0, 60.0],
];

/// Runs JavaScript with the page's scripts that need no browser; it gets `input` and calls `answer(object)`. `None`
/// without node.
fn node(input: &Value, script: &str) -> Option<Value> {
    if Command::new("node").arg("--version").output().is_err() {
        println!("skipped: no node");
        return None;
    }
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/pages/src/view/page");
    let folder = tempdir().expect("a temporary folder");
    let mut text = String::new();
    for name in ["sun", "sweep", "light", "field"] {
        text += &std::fs::read_to_string(sources.join(format!("{name}.js"))).expect("a source");
    }
    let path = folder.path().join("run.js");
    std::fs::write(folder.path().join("input.json"), input.to_string()).expect("written");
    text += "\nconst input = JSON.parse(require('fs').readFileSync(__dirname + '/input.json', 'utf8'));\n";
    text += "const answer = (object) => console.log(JSON.stringify(object));\n";
    text += &format!("(async () => {{ {script} }})();\n");
    std::fs::write(&path, text).expect("written");
    let output = Command::new("node").arg(&path).output().expect("node runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).expect("an answer"))
}

/// Data of a page.
fn carried(page: &Path) -> Value {
    let text = std::fs::read_to_string(page).expect("a page");
    let (_, rest) = text
        .split_once("<script id=\"scene\" type=\"application/json\">")
        .expect("a scene");
    let (scene, _) = rest.split_once("</script>").expect("an end");
    serde_json::from_str(scene).expect("JSON")
}

/// A slope with three houses, a tower, a ridge and an unknown corner behind a pole that is unknown, too. North of the
/// equator, two degrees of longitude west of the zone's central meridian: grid north and true north differ by more than
/// a degree.
fn surface() -> Raster {
    let mut raster = Raster::filled(WIDTH, HEIGHT, 1, f32::NAN);
    for row in 0..HEIGHT {
        for col in 0..WIDTH {
            let mut z = 650.0 + 0.02 * col as f32;
            let inside =
                |[left, top, right, bottom]: [usize; 4]| (left..right).contains(&col) && (top..bottom).contains(&row);
            if inside([40, 40, 70, 64]) {
                z += 9.0;
            }
            if inside([110, 50, 124, 64]) {
                z += 24.0;
            }
            if inside([60, 110, 120, 130]) {
                z += 7.0 - 0.35 * (row as f32 - 119.5).abs();
            }
            if row > 150 {
                z += 3.0 * ((row - 150) as f32 / 12.0).sin().max(0.0);
            }
            if !inside([0, 180, 30, 200]) && !inside([160, 90, 164, 94]) {
                raster.values[row * WIDTH + col] = z;
            }
        }
    }
    raster
}

fn write_surface(path: &Path) -> (GeoTransform, Crs) {
    let crs = Crs::from_epsg(32637).expect("UTM");
    let transform = GeoTransform::north_up(320_000.0, 5_980_000.0, CELL_M);
    let raster = surface();
    let spec = ImageSpec {
        band_descriptions: &["altitude"],
        georeference: Some((&transform, &crs)),
        ..ImageSpec::plain(&raster)
    };
    write_cog(path, &spec).expect("written");
    (transform, crs)
}

fn page_of_surface(folder: &Path) -> (PathBuf, Value) {
    let (dsm, page) = (folder.join("dsm.tif"), folder.join("sun.html"));
    write_surface(&dsm);
    let arguments = [Path::new("view"), Path::new("--dsm"), &dsm, Path::new("--out"), &page];
    let said = json(&arguments);
    assert_eq!(
        (said["width"].as_u64(), said["height"].as_u64()),
        (Some(WIDTH as u64), Some(HEIGHT as u64))
    );
    let scene = carried(&page);
    (page, scene)
}

/// Height at a place between cells: bilinear, but that of the nearest cell where a wall is between them; NaN outside
/// and where unknown.
fn height_at(raster: &Raster, col: f64, row: f64) -> f64 {
    let (c, r) = (col.floor(), row.floor());
    if c < 0.0 || r < 0.0 || c + 1.0 >= WIDTH as f64 || r + 1.0 >= HEIGHT as f64 {
        return f64::NAN;
    }
    let at = |dc: usize, dr: usize| f64::from(raster.at(0, c as usize + dc, r as usize + dr));
    let (fc, fr) = (col - c, row - r);
    let all = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
    let (low, high) = (
        all.into_iter().fold(f64::MAX, f64::min),
        all.into_iter().fold(f64::MIN, f64::max),
    );
    if high - low > 1.5 * CELL_M || all.iter().any(|z| z.is_nan()) {
        return at(usize::from(fc >= 0.5), usize::from(fr >= 0.5));
    }
    (all[0] * (1.0 - fc) + all[1] * fc) * (1.0 - fr) + (all[2] * (1.0 - fc) + all[3] * fc) * fr
}

/// Shadows by a walk from each cell toward the sun, a tenth of a cell at a time, up to the highest roof.
fn walked([azimuth_deg, elevation_deg]: [f64; 2], transform: &GeoTransform, crs: &Crs) -> Vec<bool> {
    let raster = surface();
    // Ten metres toward the sun, on the map: by way of longitude and latitude.
    let centre = transform.map_from_pixel(WIDTH as f64 / 2.0, HEIGHT as f64 / 2.0);
    let to_lon_lat = CrsTransform::to_lon_lat(crs).expect("PROJ");
    let (lon, lat) = to_lon_lat.apply(centre[0], centre[1]).expect("inside");
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    let degree_m = 111_320.0;
    let lon_step = sin * 10.0 / (degree_m * lat.to_radians().cos());
    let there = CrsTransform::from_lon_lat(crs)
        .expect("PROJ")
        .apply(lon + lon_step, lat + cos * 10.0 / degree_m)
        .expect("inside");
    let toward = [there.0 - centre[0], centre[1] - there.1];
    let length = toward[0].hypot(toward[1]);
    let toward = toward.map(|part| part / length);
    let rise_m = 0.1 * CELL_M * elevation_deg.to_radians().tan();
    let highest = raster.values.iter().copied().fold(f32::MIN, f32::max);
    let steps = ((f64::from(highest) - 650.0) / rise_m) as usize;
    let shaded = |i: usize| {
        let start = f64::from(raster.values[i]);
        let (col, row) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
        (10..steps).any(|step| {
            let far = 0.1 * step as f64;
            height_at(&raster, col + far * toward[0], row + far * toward[1]) > start + rise_m * step as f64
        })
    };
    (0..WIDTH * HEIGHT)
        .map(|i| raster.values[i].is_finite() && shaded(i))
        .collect()
}

/// The page's masks under [`SUNS`], by node.
fn masks(scene: &Value) -> Option<Vec<Vec<bool>>> {
    let input = value!({"scene": scene, "suns": SUNS});
    let answer = node(
        &input,
        "const field = readField(await unpack(input.scene)), { east, north } = input.scene.place;
         const sweep = sweeper(field, east, north, input.scene.caster), out = new Uint8Array(field.z.length);
         answer(input.suns.map(([az, el]) => {
           sweep(az, el, out);
           return Array.from(out, (v, i) => (field.known[i] && v < 32 ? '1' : '0')).join('');
         }));",
    )?;
    let texts = answer
        .as_array()
        .expect("masks")
        .iter()
        .map(|mask| mask.as_str().expect("a mask"));
    Some(texts.map(|text| text.bytes().map(|b| b == b'1').collect()).collect())
}

fn intersection_over_union(a: &[bool], b: &[bool]) -> f64 {
    let both = a.iter().zip(b).filter(|(a, b)| **a && **b).count();
    let either = a.iter().zip(b).filter(|(a, b)| **a || **b).count();
    both as f64 / either.max(1) as f64
}

#[test]
fn shadows_of_the_page_are_those_of_rays_to_the_sun() {
    let folder = tempdir().expect("a temporary folder");
    let (transform, crs) = write_surface(&folder.path().join("surface.tif"));
    let (_, scene) = page_of_surface(folder.path());
    let turned = scene["place"]["true_north_deg"].as_f64().expect("an angle");
    assert!(turned.abs() > 1.0, "grid north and true north differ: {turned}");
    let Some(masks) = masks(&scene) else { return };
    for (sun, mask) in SUNS.into_iter().zip(&masks) {
        let expected = walked(sun, &transform, &crs);
        let iou = intersection_over_union(mask, &expected);
        assert!(iou > 0.9, "{sun:?}: {iou}");
    }
}

#[test]
fn the_page_casts_the_shadows_that_products_have() {
    let folder = tempdir().expect("a temporary folder");
    let (transform, crs) = write_surface(&folder.path().join("surface.tif"));
    let (_, scene) = page_of_surface(folder.path());
    let answer = node(
        &value!({"scene": scene, "suns": SUNS}),
        "const field = readField(await unpack(input.scene)), { east, north } = input.scene.place;
         const sweep = sweeper(field, east, north, input.scene.caster), out = new Uint8Array(field.z.length);
         const seen = input.suns.map(([az, el]) => Array.from(sweep(az, el, out)));
         answer({ heights: Array.from(field.z, (z) => (z === z ? z : null)), seen });",
    );
    let Some(answer) = answer else { return };
    let numbers = |list: &Value| -> Vec<f32> {
        let list = list.as_array().expect("a list").iter();
        list.map(|number| number.as_f64().map_or(f32::NAN, |number| number as f32))
            .collect()
    };
    let heights = numbers(&answer["heights"]);
    let grid = GridSpec {
        width: WIDTH,
        height: HEIGHT,
        transform,
        crs,
    };
    let (nadir, _) = NadirGrid::of_surface(grid, &heights).expect("a grid");
    let surface = SurfaceShadows::of_heights(WIDTH, heights, nadir.cell_vectors_m(650.0));
    for ([azimuth_deg, elevation_deg], page) in SUNS.into_iter().zip(answer["seen"].as_array().expect("suns")) {
        let products = surface.lit(&SunPosition::from_degrees(azimuth_deg, elevation_deg));
        let known = products.iter().zip(numbers(page)).filter(|(ours, _)| !ours.is_nan());
        // The page counts in 64 parts, which are averaged over nine cells.
        let (same, other): (Vec<f32>, Vec<f32>) = known
            .map(|(ours, page)| (ours - page / 64.0).abs())
            .partition(|d| *d < 0.025);
        assert!(
            other.len() * 1000 < same.len(),
            "{azimuth_deg}: {} cells differ",
            other.len()
        );
    }
}

#[test]
fn unknown_cells_throw_no_shadow_and_have_none() {
    let folder = tempdir().expect("a temporary folder");
    let (_, scene) = page_of_surface(folder.path());
    let Some(masks) = masks(&scene) else { return };
    for mask in &masks {
        // The unknown pole is on open ground; nothing around reaches it.
        for row in 86..98 {
            for col in 156..168 {
                assert!(!mask[row * WIDTH + col] || masks[1][row * WIDTH + col], "{col} {row}");
            }
        }
        assert!(!mask[190 * WIDTH + 10]);
    }
}

#[test]
fn heights_of_the_page_are_those_of_the_file_to_half_a_centimetre() {
    let folder = tempdir().expect("a temporary folder");
    let (_, scene) = page_of_surface(folder.path());
    let script = "const field = readField(await unpack(input));
        answer(Array.from(field.z, (z) => (z === z ? z : null)));";
    let Some(answer) = node(&scene, script) else { return };
    let heights = answer.as_array().expect("heights");
    assert_eq!(heights.len(), WIDTH * HEIGHT);
    for (read, expected) in heights.iter().zip(&surface().values) {
        match read.as_f64() {
            Some(read) => assert!((read - f64::from(*expected)).abs() < 0.0052, "{read} {expected}"),
            None => assert!(expected.is_nan()),
        }
    }
}

#[test]
fn the_sun_of_the_page_is_the_sun() {
    let mut cases = Vec::new();
    for year in [1975, 1999, 2016, 2026, 2049, 2090] {
        for (month, day, hour) in [(1, 3, 5), (3, 20, 12), (6, 21, 9), (9, 1, 17), (12, 21, 22)] {
            for [lat, lon] in [[37.6, 36.9], [-22.9, -47.0], [60.2, 25.0], [0.1, 101.0], [-54.8, -68.3]] {
                cases.push((format!("{year}-{month:02}-{day:02}T{hour:02}:17:00Z"), lat, lon));
            }
        }
    }
    let script = "answer(input.map(([time, lat, lon]) => {
        const { az, el } = sunAt(Date.parse(time), lat, lon);
        return [az, el, solarTime(Date.parse(time), lon)];
    }));";
    let Some(answer) = node(&value!(cases), script) else {
        return;
    };
    for ((time, lat_deg, lon_deg), said) in cases.iter().zip(answer.as_array().expect("suns")) {
        let place = GeoPoint::new(*lon_deg, *lat_deg, 0.0);
        let sun = sun_position(time.parse().expect("a time"), place);
        let number = |k: usize| said[k].as_f64().expect("a number");
        let elevation = sun.elevation_rad.to_degrees();
        let off = (number(0) - sun.azimuth_rad.to_degrees() + 180.0).rem_euclid(360.0) - 180.0;
        // As angles on the sky: near the zenith an azimuth is of little weight.
        let across = off * elevation.to_radians().cos();
        let distance = across.hypot(number(1) - elevation);
        assert!(distance < 0.02, "{time} {lat_deg} {lon_deg}: {distance} degrees");
        // In the northern morning the sun is in the east.
        let is_morning = number(2) < 12.0;
        assert_eq!(
            is_morning,
            sun.azimuth_rad.sin() > 0.0,
            "{time} {lon_deg}: {}",
            number(2)
        );
    }
}

#[test]
fn the_sun_is_a_disc_with_half_shade_at_the_border_of_a_shadow() {
    // A wall 100 m high, 100 m away: half-shade is 2 x 100 m x 0.2666 degrees / cos² = some metres wide.
    let input = value!({"width": 600, "height": 8, "caster": CASTER});
    let script = "const { width, height } = input, z = new Float32Array(width * height);
        for (let i = 0; i < z.length; i++) z[i] = i % width >= 100 && i % width < 110 ? 100 : 0;
        const out = new Uint8Array(z.length);
        sweeper({ width, height, z }, [2, 0], [0, -2], input.caster)(270, 45, out);
        answer(Array.from(out.subarray(4 * width, 5 * width)));";
    let Some(answer) = node(&input, script) else { return };
    let seen: Vec<u64> = answer
        .as_array()
        .expect("cells")
        .iter()
        .map(|v| v.as_u64().expect("a number"))
        .collect();
    // The cell at the foot of the wall is averaged with the sunlit top.
    let partly: Vec<usize> = (111..600).filter(|&col| (1..64).contains(&seen[col])).collect();
    // At 45 degrees the tip is 100 m = 200 cells behind the wall, and the disc's radius spans 100 sqrt(2) rad / sin 45
    // degrees on the ground.
    let width_m = 2.0 * 141.42 * 0.2666f64.to_radians() / 45.0f64.to_radians().sin();
    // Averaging with the neighbours adds a cell at either end.
    let expected = width_m / CELL_M + 1.0;
    assert!(
        (partly.len() as f64 - expected).abs() <= 2.0,
        "{} cells of {expected}",
        partly.len()
    );
    assert!(partly[0] > 300 && *partly.last().expect("some") < 315, "{partly:?}");
    assert!(
        partly.windows(2).all(|pair| seen[pair[0]] <= seen[pair[1]]),
        "it becomes brighter"
    );
    assert!(seen[120..300].iter().all(|&v| v == 0) && seen[330..].iter().all(|&v| v == 64));
}

#[test]
fn light_between_two_elevations_lies_between_theirs() {
    let input = value!({"elevation_deg": [10.0, 50.0], "sun": [[0.2, 0.3, 0.4], [0.8, 0.8, 0.8]], "shade": [[0.4, 0.4, 0.5], [0.2, 0.2, 0.3]]});
    let script = "answer([5, 10, 20, 50, 90].map((el) => lightAt(input, el)));";
    let Some(answer) = node(&input, script) else { return };
    let at = |k: usize| answer[k]["sun"][0].as_f64().expect("a number");
    for (k, expected) in [0.2, 0.2, 0.35, 0.8, 0.8].into_iter().enumerate() {
        assert!((at(k) - expected).abs() < 1e-9, "{k}: {}", at(k));
    }
    assert!((answer[2]["shade"][2].as_f64().expect("a number") - 0.45).abs() < 1e-9);
}

/// The page as Chromium has it after it was loaded; `None` without Chromium.
fn in_chromium(page: &Path, address: &str) -> Option<String> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let found = names
        .iter()
        .find(|name| Command::new(name).arg("--version").output().is_ok());
    let Some(program) = found else {
        println!("skipped: no Chromium");
        return None;
    };
    let home = tempdir().expect("a temporary folder");
    let output = Command::new(program)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--dump-dom",
        ])
        .arg(format!("--user-data-dir={}", home.path().display()))
        .arg(format!("file://{}{address}", page.display()))
        .output()
        .expect("it runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

fn report(page: &Path, address: &str) -> Option<Value> {
    let dom = in_chromium(page, address)?;
    let (_, rest) = dom.split_once("<pre id=\"report\"").expect("a report");
    let (_, rest) = rest.split_once('>').expect("a tag");
    let (text, _) = rest.split_once("</pre>").expect("an end");
    Some(serde_json::from_str(text).expect("one JSON object"))
}

#[test]
fn a_browser_shows_the_page_and_reports_what_node_finds() {
    let folder = tempdir().expect("a temporary folder");
    let (page, scene) = page_of_surface(folder.path());
    let [azimuth, elevation] = SUNS[4];
    let Some(said) = report(&page, &format!("#az={azimuth},el={elevation}&report")) else {
        return;
    };
    assert_eq!(said["width"].as_u64(), Some(WIDTH as u64));
    assert_eq!(said["height"].as_u64(), Some(HEIGHT as u64));
    assert_eq!(said["crs"], "EPSG:32637");
    assert_eq!(said["bounds"], value!([320_000, 5_979_900, 320_110, 5_980_000]));
    assert_eq!(said["iou_traced"], Value::Null);
    assert!(said["ms_per_sun"].is_number());
    if let Some(masks) = masks(&scene) {
        let known = surface().values.iter().filter(|z| z.is_finite()).count();
        let dark = masks[4].iter().filter(|dark| **dark).count();
        let share = said["shadow_share"].as_f64().expect("a share");
        assert!((share - dark as f64 / known as f64).abs() < 1e-9, "{share}");
    }
    let at_time = report(&page, "#t=2026-06-21T09:00Z&report").expect("Chromium is there");
    let place = GeoPoint::new(
        scene["place"]["lon_deg"].as_f64().expect("a longitude"),
        scene["place"]["lat_deg"].as_f64().expect("a latitude"),
        650.0,
    );
    let sun = sun_position("2026-06-21T09:00:00Z".parse().expect("a time"), place);
    let degrees = |key: &str| at_time["sun"][key].as_f64().expect("an angle");
    assert!((degrees("azimuth_deg") - sun.azimuth_rad.to_degrees()).abs() < 0.05);
    assert!((degrees("elevation_deg") - sun.elevation_rad.to_degrees()).abs() < 0.05);
}

#[test]
fn a_run_has_its_page_and_its_report_links_it() {
    let folder = tempdir().expect("a temporary folder");
    let (scene, run) = (folder.path().join("scene"), folder.path().join("run"));
    // As many views as the site has by default: with four, ten steps leave Gaussians that differ from the surface, and
    // masks are traced through them.
    let site = ["synth", "satellite", "--site", "tiny", "--seed", "1", "--out"].map(std::ffi::OsStr::new);
    json(&[site.to_vec(), vec![scene.as_ref()]].concat());
    let arguments: Vec<&std::ffi::OsStr> = vec!["train".as_ref(), scene.as_ref(), "--out".as_ref(), run.as_ref()];
    let more = ["--preset", "fast", "--set", "train.iterations=10"].map(std::ffi::OsStr::new);
    json(&[arguments, more.to_vec()].concat());
    let written = std::fs::read(run.join("sun.html")).expect("training writes the page");
    let report_page = std::fs::read_to_string(run.join("report.html")).expect("and the report");
    assert!(report_page.contains("./sun.html"));
    // The verb writes the same bytes again.
    let again = folder.path().join("again.html");
    json(&[Path::new("view"), &run, Path::new("--out"), &again]);
    assert!(std::fs::read(&again).expect("written") == written);
    let carried = carried(&again);
    let dates = carried["dates"].as_array().expect("dates");
    assert!(!dates.is_empty() && dates.iter().all(|date| date["mask"].is_string()));
    assert!(!carried["albedo"].is_null());
    let layers: Vec<_> = carried["layers"]
        .as_array()
        .expect("layers")
        .iter()
        .map(|layer| layer["id"].clone())
        .collect();
    assert!(
        layers.contains(&value!("errors")) && layers.contains(&value!("deviation")),
        "{layers:?}"
    );
    if let Some(said) = report(&again, "#report") {
        let iou = said["iou_traced"].as_f64().expect("an agreement");
        assert!(iou > 0.5 && iou <= 1.0, "{iou}");
    }
}

#[test]
fn what_cannot_be_shown_is_refused_in_one_line() {
    let folder = tempdir().expect("a temporary folder");
    let empty = folder.path().to_str().expect("UTF-8");
    assert!(fault(&["view", empty], 2).contains(empty));
    assert!(fault(&["view", "--dsm", "nowhere.tif"], 2).contains("nowhere.tif"));
}
