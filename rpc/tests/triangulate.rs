//! Triangulation against a published example and against itself.

mod common;

use common::push_broom::PushBroom;
use common::{distance_px, read_json, row, shared};
use heliosplat_rpc::fit::fit_rpc;
use heliosplat_rpc::triangulate::triangulate;
use heliosplat_rpc::{GeoPoint, ImagePoint, LocalFrame, Rpc, RpcError, read};
use nalgebra::Vector3;

/// The 40 cameras of one site, by name.
fn cameras(shared: &std::path::Path) -> Vec<(String, Rpc)> {
    let all = read_json(&shared.join("data/cameras/mvs3dm_worldview3_40.json"));
    let read = |(name, value): (&String, &serde_json::Value)| {
        (
            name.clone(),
            read::satnerf_json(&value.to_string()).unwrap_or_else(|e| panic!("{name}: {e}")),
        )
    };
    all.as_object().expect("object").iter().map(read).collect()
}

#[test]
fn a_point_seen_by_many_views_is_found_again() {
    let Some(shared) = shared() else { return };
    let cameras = cameras(&shared);
    assert_eq!(cameras.len(), 40);
    for (i, height_m) in [(0, 10.0), (7, 55.0), (23, -40.0)] {
        let truth = cameras[i]
            .1
            .localise(ImagePoint { col: 600.0, row: 500.0 }, height_m)
            .expect("localises");
        let views: Vec<(&Rpc, ImagePoint)> = cameras.iter().map(|(_, rpc)| (rpc, rpc.project(truth))).collect();
        for views in [&views[..], &views[..2], &views[10..13]] {
            let found = triangulate(views).expect("triangulates");
            let error_m = LocalFrame::new(truth).enu_from_geo(found.point).norm();
            assert!(error_m < 1e-5, "{error_m} m from {} views", views.len());
            assert!(found.rms_px < 1e-6, "{}", found.rms_px);
        }
    }
}

#[test]
fn residuals_are_the_least_near_the_point_found() {
    let Some(shared) = shared() else { return };
    let cameras = cameras(&shared);
    let truth = cameras[0]
        .1
        .localise(ImagePoint { col: 300.0, row: 300.0 }, 20.0)
        .expect("localises");
    let views: Vec<(&Rpc, ImagePoint)> = cameras
        .iter()
        .enumerate()
        .map(|(i, (_, rpc))| {
            let seen = rpc.project(truth);
            let noise = |k: f64| ((i as f64 + 1.0) * k).sin();
            (rpc, ImagePoint::new(seen.col + noise(12.9), seen.row + noise(78.2)))
        })
        .collect();
    let found = triangulate(&views).expect("triangulates");
    let rms_px = |point: GeoPoint| {
        let sum: f64 = views
            .iter()
            .map(|(rpc, seen)| distance_px(rpc.project(point), *seen).powi(2))
            .sum();
        (sum / views.len() as f64).sqrt()
    };
    assert!((rms_px(found.point) - found.rms_px).abs() < 1e-9);
    let frame = LocalFrame::new(found.point);
    for axis in 0..3 {
        for step_m in [-0.01, 0.01] {
            let mut offset = Vector3::zeros();
            offset[axis] = step_m;
            assert!(rms_px(frame.geo_from_enu(offset)) > found.rms_px, "axis {axis}");
        }
    }
}

#[test]
fn the_published_track_of_three_views_is_found_with_no_larger_residual() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/vissat_jacksonville.json");
    let example = read_json(&path);
    let cameras: Vec<Rpc> = (0..3)
        .map(|i| read::satnerf_json(&example["views"][i].to_string()).expect("the camera reads"))
        .collect();
    let views: Vec<(&Rpc, ImagePoint)> = cameras
        .iter()
        .enumerate()
        .map(|(i, rpc)| {
            let [col, row] = row(&example["track_col_row"][i]);
            (rpc, ImagePoint { col, row })
        })
        .collect();
    let found = triangulate(&views).expect("triangulates");
    let [lat_deg, lon_deg, height_m] = row(&example["expected_lat_lon_alt"]);
    let published = GeoPoint::new(lon_deg, lat_deg, height_m);
    let squared: f64 = views
        .iter()
        .map(|(rpc, seen)| distance_px(rpc.project(published), *seen).powi(2))
        .sum();
    let published_rms_px = (squared / 3.0).sqrt();
    let expected_rms_px = example["expected_rms_px"].as_f64().expect("number");
    assert!((published_rms_px - expected_rms_px).abs() < 1e-9, "{published_rms_px}");
    let apart_m = LocalFrame::new(published).enu_from_geo(found.point).norm();
    println!(
        "{apart_m:.3} m from the published point, rms {} px there {published_rms_px} px",
        found.rms_px
    );
    // The published solver stopped at its own tolerance, 0.2 m short of the minimum.
    assert!(found.rms_px <= published_rms_px && apart_m < 0.3, "{found:?}");
}

#[test]
fn a_point_across_the_date_line_is_found() {
    let west = PushBroom::over(179.995, -16.0);
    let mut east = PushBroom::over(179.995, -16.0);
    east.roll_rad = -0.2;
    let [west, east] = [west, east].map(|sensor| fit_rpc(&sensor.samples(12, &[0.0, 200.0, 400.0])).expect("fits").rpc);
    let truth = GeoPoint::new(-179.999, -16.001, 123.0);
    let found = triangulate(&[(&west, west.project(truth)), (&east, east.project(truth))]).expect("triangulates");
    assert!(
        LocalFrame::new(truth).enu_from_geo(found.point).norm() < 1e-5,
        "{found:?}"
    );
}

#[test]
fn views_that_cannot_fix_a_point_are_errors() {
    let rpc = fit_rpc(&PushBroom::over(5.2, 44.2).samples(12, &[0.0, 200.0, 400.0]))
        .expect("fits")
        .rpc;
    let seen = ImagePoint::new(1_000.0, 1_200.0);
    assert!(matches!(triangulate(&[]), Err(RpcError::Invalid(_))));
    assert!(matches!(triangulate(&[(&rpc, seen)]), Err(RpcError::Invalid(_))));
    let error = triangulate(&[(&rpc, seen), (&rpc, seen)]).expect_err("one view twice has no height");
    assert!(error.to_string().contains("parallel"), "{error}");
    let nan = ImagePoint::new(f64::NAN, 0.0);
    assert!(triangulate(&[(&rpc, nan), (&rpc, seen)]).is_err());
    assert!(triangulate(&[(&rpc, seen), (&rpc, nan)]).is_err());
}
