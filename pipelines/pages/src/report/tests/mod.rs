//! Pages of hostile contents: input text is escaped, and nothing is loaded from the network.

use super::*;
use crate::view::{Layer, LightTable, Ramp};
use heliosplat::Raster;
use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
use heliosplat::splat::ProjectionOptions;
use heliosplat_raster::Window;
use heliosplat_raster::write::{ImageSpec, write_cog};
use heliosplat_raster::{Crs, GeoTransform, GridSpec};
use heliosplat_rpc::sun::SunPosition;
use heliosplat_rpc::{GeoPoint, ProjectiveMap};
use heliosplat_satellite::PlanItem;
use heliosplat_satellite::config::SatelliteConfig;
use heliosplat_scene::{Area, BandKind, Split, SunSource, Values};
use serde_json::json;

const EVIL: &str = "<script>alert(1)</script><img src=x onerror=alert(1)>\"'&";

fn contents(folder: &Path) -> Contents {
    let options = ShadowGsOptions::default();
    let model = ShadowGs::new(options.clone());
    let config = SatelliteConfig::resolve(heliosplat_fitting::settings::Preset::Fast, &[], 1).expect("a preset");
    let image = heliosplat_products::model::ModelImage {
        name: "view".into(),
        split: Split::Test,
        appearance: None,
        same_day: None,
        map: ProjectiveMap {
            u: [1.0, 0.0, 0.0, 0.0],
            v: [0.0, 1.0, 0.0, 0.0],
            w: [0.0; 3],
        },
        crop: Window {
            col0: 0,
            row0: 0,
            width: 20,
            height: 10,
        },
        shift_px: [0.0; 2],
        known: None,
        sun: Some(SunPosition::from_degrees(100.0, 40.0)),
        sun_sigma_deg: Some(0.1),
        sun_source: SunSource::Time,
        time: None,
    };
    Contents {
        run: RunFile {
            area: None,
            version: EVIL.into(),
            build: EVIL.into(),
            preset: EVIL.into(),
            seed: 1,
            scene: EVIL.into(),
            altitude_range_m: None,
            altitude_from_ties_m: None,
            plan: vec![PlanItem {
                component: EVIL.into(),
                on: true,
                reason: EVIL.into(),
            }],
            inputs: Vec::new(),
            config: config.clone(),
        },
        model: ModelFile {
            schema: heliosplat_products::model::SCHEMA,
            model: "shadow_gs".into(),
            gaussians_sha256: None,
            globals: model.initial_globals(0.3),
            daylight: None,
            options,
            origin: GeoPoint::new(0.0, 0.0, 0.0),
            altitude_range_m: (0.0, 1.0),
            area: Area {
                west_m: 0.0,
                south_m: 0.0,
                east_m: 1.0,
                north_m: 1.0,
            },
            gsd_m: 1.0,
            counts_per_unit: 1.0,
            projection: ProjectionOptions::default(),
            bands: vec![BandKind::Pan],
            values: Values::default(),
            images: vec![image],
            changes: None,
        },
        folder: Folder {
            path: folder.to_owned(),
            metrics: json!({
            "dsm": {"mae_m": 0.5, "protocol": EVIL, "by_class": {EVIL: {"mae_m": 0.1}}, "error_quantiles_m": [0.0, 0.1, 0.4, 9.0]},
            "curve": [{"step": 25, "l1": 0.1, "held_out_l1": 0.2, "accuracy": {"height_mae_m": 2.0}, "losses": {EVIL: 1.0}}, {"step": 50, "l1": 0.05, "held_out_l1": 0.1, "accuracy": {"height_mae_m": 1.0}, "losses": {EVIL: 0.5}}],
            }),
        },
    }
}

#[test]
fn what_comes_from_outside_stays_text_and_nothing_is_fetched() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::create_dir(folder.path().join("views")).expect("made");
    let picture = RgbImage::new(80, 10);
    picture.save(folder.path().join("views/view.png")).expect("written");
    std::fs::write(folder.path().join("views/other.png"), b"no picture").expect("written");
    std::fs::write(folder.path().join("dsm.tif"), b"").expect("written");
    let page = page_of_run(&contents(folder.path()));
    assert!(!page.contains("<img src=x"), "an image from outside");
    assert!(!page.contains("http") && !page.contains("<script") && !page.contains("src=\"views"));
    // Heights, standard deviations, albedo and the four panels of the view; a damaged picture is left out.
    assert_eq!(page.matches("<img src=\"data:image/jpeg;base64,").count(), 7);
    assert!(page.contains("held out") && page.matches("<polyline").count() == 5);
}

/// A slope of 40 x 20 cells of half a metre whose last row is unknown, west of the zone's central meridian.
fn shown() -> Exhibit {
    let (width, height) = (40, 20);
    let mut altitude = Raster::filled(width, height, 1, f32::NAN);
    for i in 0..width * (height - 1) {
        altitude.values[i] = 700.0 + (i % width) as f32;
    }
    let deviation = Layer::map(
        "deviation",
        "Standard deviation of heights",
        (Ramp::Sequential, [0.0, 2.0]),
        Raster::filled(width, height, 1, 0.25),
    );
    Exhibit {
        title: EVIL.into(),
        grid: GridSpec {
            width,
            height,
            transform: GeoTransform::north_up(320_000.0, 4_160_000.0, 0.5),
            crs: Crs::from_epsg(32637).expect("UTM"),
        },
        gsd_m: 0.5,
        altitude,
        vertical_datum: EVIL.into(),
        albedo: Some(Raster::filled(width, height, 3, 0.3)),
        light: LightTable::usual(),
        old_shadows: false,
        dates: Vec::new(),
        layers: vec![deviation],
    }
}

#[test]
fn the_page_is_about_the_surface_and_its_making_is_folded_away() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for name in ["dsm.tif", "dsm_stddev.tif", "notes.tif"] {
        std::fs::write(folder.path().join(name), b"").expect("written");
    }
    let page = page_of_run(&contents(folder.path()));
    // UTM zone 37: 320 km is 180 km west of 39 degrees east; at 37.57 degrees north a degree is 88.4 km wide.
    for part in [
        "37.5",
        "36.9",
        "EPSG:32637",
        "20 × 10 m",
        "cells of 0.5 m",
        "<b>95.0 %</b>",
        "<b>700.0 m</b>",
        "<b>739.0 m</b>",
        "<b>0.25 m</b>",
    ] {
        assert!(page.contains(part), "{part}");
    }
    // The longest round bar within 40 % of 20 m.
    assert!(page.contains("<div class=\"bar\" style=\"width:25.00%\">5 m</div>"));
    assert!(page.contains("<a href=\"./dsm.tif\">dsm.tif</a>") && !page.contains("notes.tif"));
    let (surface, making) = page.split_once("<details>").expect("a part that is folded away");
    assert!(making.contains("Component plan") && making.contains("Loss: "));
    assert!(!surface.contains("PSNR") && !surface.contains("Gaussians\"") && !surface.contains("preset"));
}

fn page_of_run(contents: &Contents) -> String {
    page(contents, Some(&shown())).expect("written")
}

#[test]
fn the_time_of_a_run_counts_its_pages_and_they_say_the_time_before_them() {
    timeline::take();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut metrics = json!({"seconds": 10.0, "timeline": [{"stage": "read", "wall_s": 1.0}]});
    let wait = || -> Result<(), RunError> {
        std::thread::sleep(std::time::Duration::from_millis(20));
        Ok(())
    };
    add_report(folder.path(), &mut metrics, wait).expect("written");
    let seconds = metrics["seconds"].as_f64().expect("a number");
    assert!((10.02..11.0).contains(&seconds), "{seconds}");
    assert_eq!(metrics["timeline"][1]["stage"], "report");
    let read = Folder::read(folder.path(), "metrics.json").expect("written");
    assert_eq!(read.metrics, metrics);
    assert!((read.seconds().expect("a number") - 10.0).abs() < 1e-9);
}

#[test]
fn a_run_without_metrics_still_has_a_page() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut contents = contents(folder.path());
    contents.folder.metrics = Value::Null;
    let page = page_of_run(&contents);
    assert!(page.contains("Component plan") && !page.contains("<svg"));
}

#[test]
fn the_page_of_a_mosaic_keeps_what_comes_from_outside_as_text_and_looks_nowhere_else() {
    let home = tempfile::tempdir().expect("a temporary folder");
    let folder = home.path().join("mosaic");
    std::fs::create_dir_all(folder.join("pictures")).expect("made");
    let picture = RgbImage::new(60, 40);
    for name in ["dsm.png", "pictures/shadow_2020-01-01.png"] {
        picture.save(folder.join(name)).expect("written");
    }
    picture.save(home.path().join("outside.png")).expect("written");
    let shown = shown();
    let spec = ImageSpec {
        georeference: Some((&shown.grid.transform, &shown.grid.crs)),
        ..ImageSpec::plain(&shown.altitude)
    };
    write_cog(&folder.join("dsm.tif"), &spec).expect("written");
    let huge = [[0u32, u32::MAX], [7, u32::MAX]];
    let said = json!({
        "tiles": 2, "gsd_m": 0.5, "width": 60, "height": 40,
        "pieces": [
            {"unit": format!("a/{EVIL}"), "core": huge},
            {"unit": "a/..", "core": [[0, 10], [0, 10]]},
            {"unit": "a/tile-r0c1", "core": [[20, 60], [0, 40]]},
        ],
        "seams": {"border": {"mean_m": 0.5}, "overlaps": [{"tiles": [EVIL, EVIL], "cells": 5, "median_m": 0.1}]},
        "products": {"dates": ["2020-01-01", EVIL, "/../../../outside"]},
    });
    std::fs::write(folder.join("mosaic.json"), said.to_string()).expect("written");
    // Tiles without a training have no page to link to.
    std::fs::create_dir_all(home.path().join("tile-r0c1/run")).expect("made");
    std::fs::write(home.path().join("tile-r0c1/run/report.html"), "a page").expect("written");
    let path = mosaic::write(&folder).expect("a page");
    let page = std::fs::read_to_string(path).expect("readable");
    assert!(!page.contains("<img src=x") && !page.contains("<script") && !page.contains("http"));
    // Heights overlaid with the borders of three tiles, and one date.
    assert!(page.contains("<rect x=\"20\" y=\"0\" width=\"40\" height=\"40\""));
    assert_eq!(page.matches("<img src=\"data:image/jpeg;base64,").count(), 2);
    assert_eq!(page.matches("run/report.html").count(), 1);
    assert!(mosaic::write(home.path()).is_err(), "no mosaic");
}
