//! Triangulation against a published example and against itself.

mod common;

use common::{distance_px, golden_camera, read_json, row, shared};
use heliosplat_rpc::triangulate::triangulate;
use heliosplat_rpc::{GeoPoint, ImagePoint, LocalFrame, Rpc, RpcError, read};
use nalgebra::Vector3;

/// The 40 cameras of one site, by name.
fn cameras(shared: &std::path::Path) -> Vec<(String, Rpc)> {
    let all = read_json(&shared.join("data/cameras/mvs3dm_worldview3_40.json"));
    let read = |(name, value): (&String, &serde_json::Value)| {
        (name.clone(), read::satnerf_json(&value.to_string()).unwrap_or_else(|e| panic!("{name}: {e}")))
    };
    all.as_object().expect("object").iter().map(read).collect()
}

#[test]
fn a_point_seen_by_many_views_is_found_again() {
    let Some(shared) = shared() else { return };
    let cameras = cameras(&shared);
    assert_eq!(cameras.len(), 40);
    for (i, height_m) in [(0, 10.0), (7, 55.0), (23, -40.0)] {
        let truth = cameras[i].1.localise(ImagePoint { col: 600.0, row: 500.0 }, height_m).expect("localises");
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
    let truth = cameras[0].1.localise(ImagePoint { col: 300.0, row: 300.0 }, 20.0).expect("localises");
    let views: Vec<(&Rpc, ImagePoint)> = cameras
        .iter()
        .enumerate()
        .map(|(i, (_, rpc))| {
            let seen = rpc.project(truth);
            let noise = |k: f64| ((i as f64 + 1.0) * k).sin();
            (rpc, ImagePoint { col: seen.col + noise(12.9), row: seen.row + noise(78.2) })
        })
        .collect();
    let found = triangulate(&views).expect("triangulates");
    let rms_px = |point: GeoPoint| {
        let sum: f64 = views.iter().map(|(rpc, seen)| distance_px(rpc.project(point), *seen).powi(2)).sum();
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
fn views_that_cannot_fix_a_point_are_errors() {
    let Some(shared) = shared() else { return };
    let rpc = golden_camera(&common::golden(&shared, "phr1b_ventoux"));
    let seen = ImagePoint { col: 10_000.0, row: 12_000.0 };
    assert!(matches!(triangulate(&[]), Err(RpcError::Invalid(_))));
    assert!(matches!(triangulate(&[(&rpc, seen)]), Err(RpcError::Invalid(_))));
    let error = triangulate(&[(&rpc, seen), (&rpc, seen)]).expect_err("one view twice has no height");
    assert!(error.to_string().contains("parallel"), "{error}");
    let nan = ImagePoint { col: f64::NAN, row: 0.0 };
    assert!(triangulate(&[(&rpc, nan), (&rpc, seen)]).is_err());
    assert!(triangulate(&[(&rpc, seen), (&rpc, nan)]).is_err());
}
