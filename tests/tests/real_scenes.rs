//! Ingest of real images, where they are present.

use heliosplat_raster::{CrsTransform, GeoRaster};
use heliosplat_tests::program::json;
use heliosplat_tests::shared::shared;
use serde_json::Value;

fn inspect(scene: &str) -> Option<Value> {
    let path = shared(scene)?;
    Some(json(&["inspect".as_ref(), path.as_os_str()]))
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

#[test]
fn kahramanmaras_fits_pinhole_cameras_within_a_twentieth_of_a_pixel() {
    let Some(scene) = inspect("data/kahramanmaras") else {
        return;
    };
    let images = scene["images"].as_array().expect("images");
    assert_eq!(images.len(), 4);
    for image in images {
        assert!(number(&image["pinhole_rms_px"]) <= 0.02, "{image}");
        assert!(number(&image["pinhole_max_px"]) <= 0.05, "{image}");
        assert_eq!(image["bands"], serde_json::json!(["pan"]));
        assert_eq!(image["sun_source"], "time");
        // The JSONs carry suns computed by NREL's SPA.
        for angle in ["azimuth_deg", "elevation_deg"] {
            let apart = number(&image["sun"][angle]) - number(&image["metadata_sun"][angle]);
            assert!(apart.abs() < 0.02, "{angle} {apart}");
        }
    }
    assert_eq!(scene["altitude_range_m"], serde_json::json!([640.0, 780.0]));
    assert!(number(&scene["covered_by_at_least"][1]) > 0.9);
    assert_eq!(
        scene["warnings"].as_array().map(Vec::len),
        Some(0),
        "{}",
        scene["warnings"]
    );
}

#[test]
fn giza_and_ventoux_are_scenes_of_two_overlapping_views() {
    for (name, ground_m, centre) in [
        ("data/giza", 75.9, [31.135, 29.979]),
        ("data/ventoux", 540.0, [5.195, 44.206]),
    ] {
        let Some(scene) = inspect(name) else {
            return;
        };
        assert_eq!(scene["images"].as_array().map(Vec::len), Some(2));
        let origin = &scene["origin"];
        assert!((number(&origin["lon_deg"]) - centre[0]).abs() < 0.002, "{origin}");
        assert!((number(&origin["lat_deg"]) - centre[1]).abs() < 0.002, "{origin}");
        let range = &scene["altitude_range_m"];
        assert!(number(&range[0]) < ground_m && ground_m < number(&range[1]));
        assert!(number(&scene["covered_by_at_least"][1]) > 0.6, "{scene}");
        assert_eq!(
            scene["warnings"].as_array().map(Vec::len),
            Some(0),
            "{}",
            scene["warnings"]
        );
    }
}

#[test]
fn the_benchmark_is_read_as_it_is_published() {
    let Some(top) = shared("data/jax068") else { return };
    let adjusted = top.join("root_dir/crops_rpcs_ba_v2/JAX_068");
    let raw = top.join("root_dir/crops_rpcs_raw/JAX_068");
    for (start, warned) in [(&adjusted, false), (&raw, false), (&top, true)] {
        let scene = json(&["inspect".as_ref(), start.as_os_str()]);
        let images = scene["images"].as_array().expect("images");
        let held_out = images.iter().filter(|image| image["split"] == "test").count();
        assert_eq!((images.len(), held_out), (19, 3), "{}", start.display());
        assert_eq!(images[0]["bands"], serde_json::json!(["red", "green", "blue"]));
        assert!(
            scene["truth"]["dsm"]
                .as_str()
                .is_some_and(|path| path.ends_with("Track3-Truth/JAX_068_DSM.tif"))
        );
        let warnings = scene["warnings"].as_array().expect("warnings");
        let chosen = |line: &&Value| line.as_str().is_some_and(|line| line.contains("crops_rpcs_raw"));
        assert_eq!(
            warnings.iter().filter(chosen).count(),
            usize::from(warned),
            "{}",
            scene["warnings"]
        );
    }
}

/// A face of the pyramid as a plane `height = slope · outward + along · sideways + apex`, by least squares with
/// outliers left out round by round; `points` are outward, sideways, height.
fn face(points: &[[f64; 3]]) -> nalgebra::Vector3<f64> {
    let mut kept: Vec<[f64; 3]> = points.to_vec();
    let mut plane = nalgebra::Vector3::zeros();
    for _ in 0..10 {
        let (mut normal, mut right) = (nalgebra::Matrix3::zeros(), nalgebra::Vector3::zeros());
        for p in &kept {
            let x = nalgebra::Vector3::new(p[0], p[1], 1.0);
            normal += x * x.transpose();
            right += x * p[2];
        }
        plane = normal.try_inverse().expect("points in two directions") * right;
        let residual = |p: &[f64; 3]| (p[2] - plane.x * p[0] - plane.y * p[1] - plane.z).abs();
        let mut sizes: Vec<f64> = kept.iter().map(residual).collect();
        sizes.sort_by(f64::total_cmp);
        let limit = (3.7 * sizes[sizes.len() / 2]).max(0.8);
        kept = points.iter().copied().filter(|p| residual(p) < limit).collect();
    }
    plane
}

/// The Great Pyramid is 230.3 m wide with faces of 51.84 degrees around 31.134192 E 29.979180 N (shared/README.md).
#[test]
fn the_pyramid_of_giza_stands() {
    let Some(scene) = shared("data/giza") else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let run = folder.path().join("run");
    let arguments = [
        "train".as_ref(),
        scene.as_os_str(),
        "--out".as_ref(),
        run.as_os_str(),
        "--preset".as_ref(),
        "fast".as_ref(),
        "--set".as_ref(),
        "train.iterations=2".as_ref(),
    ];
    json(&arguments);
    let dsm = GeoRaster::read(&run.join("dsm.tif")).expect("a surface model");
    let crs = dsm.crs.expect("its coordinate system");
    let [east, north] = CrsTransform::from_lon_lat(&crs)
        .and_then(|way| way.apply(31.134192, 29.979180))
        .map(|(x, y)| [x, y])
        .expect("Giza lies in the zone");
    // The faces look along the meridian, the grid does not: 0.93 degrees of convergence.
    let (sin, cos) = (-0.932_6_f64).to_radians().sin_cos();
    let mut faces = [const { Vec::new() }; 4];
    for (i, &height) in dsm.raster.plane(0).iter().enumerate() {
        let (col, row) = (i % dsm.raster.width, i / dsm.raster.width);
        let [x, y] = dsm.transform.map_from_pixel(col as f64, row as f64);
        let (x, y) = (x - east, y - north);
        let (e, n) = (x * cos - y * sin, x * sin + y * cos);
        for (face, (outward, sideways)) in faces.iter_mut().zip([(e, n), (-e, n), (n, e), (-n, e)]) {
            if (20.0..95.0).contains(&outward) && sideways.abs() < 0.8 * outward && height.is_finite() {
                face.push([outward, sideways, f64::from(height)]);
            }
        }
    }
    let planes = faces.each_ref().map(|points| face(points));
    for plane in &planes {
        let slope = plane.x.hypot(plane.y).atan().to_degrees();
        assert!((slope - 51.84).abs() < 2.0, "a face of {slope} degrees");
    }
    // Opposite faces at a height of 145 m: half the difference of their distances is the error of the centre.
    let distance = |plane: &nalgebra::Vector3<f64>| (145.0 - plane.z) / plane.x;
    for pair in [[0, 1], [2, 3]] {
        let off = 0.5 * (distance(&planes[pair[0]]) - distance(&planes[pair[1]]));
        assert!(off.abs() < 3.0, "the centre is {off} m off");
    }
}
