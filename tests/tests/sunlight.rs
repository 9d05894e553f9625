//! Suns that no image had, from truth to page: `synth --relight`, `evaluate`, `products --sun-hours`, on the tiny site.

use gdal::{Dataset, Metadata};
use heliosplat_tests::program::{fault, heliosplat, json};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use tempfile::{TempDir, tempdir};

/// A scene with truth under three suns, and a short run on it.
static HOME: LazyLock<TempDir> = LazyLock::new(|| {
    let home = tempdir().expect("a temporary folder");
    let text = |name: &str| home.path().join(name).display().to_string();
    let made = "synth satellite --site tiny --seed 5 --views 4 --gsd 1 --relight 3 --out";
    json(&words(made, &[&text("scene")]));
    let trained = "train --preset fast --set train.iterations=10";
    json(&words(trained, &[&text("scene"), "--out", &text("run")]));
    home
});

fn words<'a>(line: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    line.split(' ').chain(more.iter().copied()).collect()
}

fn path(name: &str) -> PathBuf {
    HOME.path().join(name)
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

fn band(file: &Path) -> Vec<f32> {
    let dataset = Dataset::open(file).expect("GDAL reads it");
    let size = dataset.raster_size();
    let band = dataset.rasterband(1).expect("a band");
    band.read_as::<f32>((0, 0), size, size, None)
        .expect("pixels")
        .data()
        .to_vec()
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("readable")).expect("JSON")
}

#[test]
fn a_run_is_measured_under_suns_of_no_image_and_its_page_shows_it() {
    // Training measures it already, without an option.
    let trained = read_json(&path("run/metrics.json"));
    let measured = json(&["evaluate", &shown(&path("run"))]);
    assert_eq!(trained["relit"], measured["relit"]);
    let relit = &measured["relit"];
    let suns = relit["suns"].as_array().expect("suns");
    assert_eq!(suns.len(), 3);
    let listed = read_json(&path("scene/truth/relit.json"));
    for (sun, listed) in suns.iter().zip(listed.as_array().expect("a list")) {
        for key in ["sun_azimuth_deg", "sun_elevation_deg"] {
            let [ours, theirs] = [sun, listed].map(|sun| sun[key].as_f64().expect("an angle"));
            assert!((ours - theirs).abs() < 1e-9, "{key}");
        }
        let number = |key: &str| sun[key].as_f64().expect(key);
        assert!(number("psnr_own_gain_db") >= number("psnr_one_gain_db") && number("psnr_own_gain_db") > 10.0);
        assert!((0.0..=1.0).contains(&number("ber")) && (0.0..=1.0).contains(&number("iou")));
        assert!((0.2..5.0).contains(&number("brightness_ratio")) && number("completeness") > 0.5);
    }
    let page = std::fs::read_to_string(path("run/report.html")).expect("a page");
    assert!(page.contains("Under suns of no image") && path("run/relit/sun_2.png").is_file());
    let text = heliosplat(&["evaluate", &shown(&path("run"))]).assert().success();
    let text = String::from_utf8_lossy(&text.get_output().stdout).into_owned();
    assert!(text.contains("one gain dB") && text.contains("relit BER"), "{text}");
}

#[test]
fn truth_elsewhere_is_measured_when_asked_for_and_refused_in_one_line_when_it_is_none() {
    let home = tempdir().expect("a temporary folder");
    for name in [
        "run.toml",
        "cut.json",
        "model.json",
        "model.ply",
        "dsm.tif",
        "metrics.json",
    ] {
        std::fs::copy(path("run").join(name), home.path().join(name)).expect("copied");
    }
    let run = shown(home.path());
    let scene = json(&["evaluate", &shown(&path("run"))]);
    let asked = json(&["evaluate", &run, "--relit", &shown(&path("scene/truth"))]);
    assert_eq!(asked["relit"], scene["relit"]);
    assert_eq!(read_json(&home.path().join("metrics.json"))["relit"], scene["relit"]);
    let said = fault(&["evaluate", &run, "--relit", &shown(&path("scene"))], 2);
    assert!(said.contains("relit.json"), "{said}");
}

#[test]
fn sunshine_is_cloud_optimised_has_units_joins_the_catalogue_and_is_near_the_truth() {
    let home = tempdir().expect("a temporary folder");
    let (run, out) = (shown(&path("run")), shown(home.path()));
    json(&["products", &run, "--out", &out, "--sun-hours", "2016-03-20"]);
    let item = read_json(&home.path().join("item.json"));
    for (name, band_name, unit, most) in [
        ("sun_hours", "sun_hours", "h", 12.3),
        ("sky_view", "sky_view_factor", "1", 1.0),
        ("irradiation", "irradiation", "kWh/m²", 9.0),
    ] {
        let file = home.path().join(format!("{name}.tif"));
        let dataset = Dataset::open(&file).expect("GDAL reads it");
        assert_eq!(
            dataset.metadata_item("LAYOUT", "IMAGE_STRUCTURE").as_deref(),
            Some("COG")
        );
        let of = dataset.rasterband(1).expect("a band");
        assert_eq!((of.unit(), of.no_data_value()), (unit.to_owned(), Some(-9999.0)));
        assert_eq!(of.description().expect("a description"), band_name);
        assert_eq!(item["assets"][name]["bands"][0]["unit"], unit);
        let known: Vec<f32> = band(&file).into_iter().filter(|v| *v != -9999.0).collect();
        assert!(
            known.len() > 1000 && known.iter().all(|v| (0.0..=most).contains(v)),
            "{name}"
        );
    }
    let period = Dataset::open(home.path().join("irradiation.tif")).expect("GDAL reads it");
    assert_eq!(period.metadata_item("FROM", "").as_deref(), Some("2016-03-20"));
    assert_eq!(period.metadata_item("LINKE_TURBIDITY", "").as_deref(), Some("3"));
    near_the_truth(&home.path().join("sun_hours.tif"));
    let said = heliosplat(&["products", &run, "--out", &out, "--sun-hours", "2016-03-21/2016-03-20"])
        .assert()
        .code(2);
    assert!(String::from_utf8_lossy(&said.get_output().stderr).contains("ends before it begins"));
}

/// In the mean within two and a half hours of rays through the true site: a run of seconds on four coarse views is no
/// better.
fn near_the_truth(ours: &Path) {
    let truth = path("scene/truth/sun_hours.tif");
    let (our_file, true_file) = (
        Dataset::open(ours).expect("ours"),
        Dataset::open(&truth).expect("truth"),
    );
    assert_eq!(true_file.metadata_item("DATE", "").as_deref(), Some("2016-03-20"));
    let [west, cell_m, _, north, _, _] = true_file.geo_transform().expect("a place");
    let ours_at = our_file.geo_transform().expect("a place");
    let (width, height) = true_file.raster_size();
    let our_width = our_file.raster_size().0;
    let (our_hours, true_hours) = (band(ours), band(&truth));
    let (mut off_hours, mut known) = (0.0, 0usize);
    for cell in 0..width * height {
        let x = west + (cell % width) as f64 * cell_m + 0.5 * cell_m;
        let y = north - (cell / width) as f64 * cell_m - 0.5 * cell_m;
        let (col, row) = (
            ((x - ours_at[0]) / ours_at[1]) as usize,
            ((y - ours_at[3]) / ours_at[5]) as usize,
        );
        match our_hours.get(row * our_width + col).filter(|v| **v >= 0.0) {
            Some(hours) if col < our_width => {
                known += 1;
                off_hours += f64::from((hours - true_hours[cell]).abs());
            }
            _ => (),
        }
    }
    assert!(known * 10 > width * height * 8, "{known}");
    assert!(off_hours / (known as f64) < 2.5, "{off_hours} of {known}");
}
