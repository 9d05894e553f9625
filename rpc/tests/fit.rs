//! RPCs fitted to samples of real cameras, and to a synthetic push-broom.

mod common;

use common::push_broom::PushBroom;
use common::{distance_px, golden_camera, golden_rpcs, shared};
use heliosplat_rpc::fit::{FEWEST_SAMPLES, fit_rpc};
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc, RpcError};

fn grid(low: f64, high: f64, count: usize) -> impl Iterator<Item = f64> + Clone {
    (0..count).map(move |i| low + (high - low) * i as f64 / (count - 1) as f64)
}

fn camera_samples(rpc: &Rpc, across: usize, levels: usize) -> Vec<(GeoPoint, ImagePoint)> {
    let mut samples = Vec::new();
    for height_m in grid(
        rpc.height_offset_m - 0.5 * rpc.height_scale_m,
        rpc.height_offset_m + 0.5 * rpc.height_scale_m,
        levels,
    ) {
        for row in grid(
            rpc.line_offset - 0.9 * rpc.line_scale,
            rpc.line_offset + 0.9 * rpc.line_scale,
            across,
        ) {
            for col in grid(
                rpc.sample_offset - 0.9 * rpc.sample_scale,
                rpc.sample_offset + 0.9 * rpc.sample_scale,
                across,
            ) {
                let image = ImagePoint { col, row };
                if let Ok(ground) = rpc.localise(image, height_m) {
                    samples.push((ground, image));
                }
            }
        }
    }
    samples
}

#[test]
fn a_real_camera_is_refitted_from_its_own_samples() {
    let Some(shared) = shared() else { return };
    for (name, golden) in golden_rpcs(&shared) {
        // The s2p and VRT crops are extrapolated outside their windows; erosb cannot be localised.
        if name == "erosb" || name.starts_with("s2p") || name == "phr_iceland_01" {
            continue;
        }
        let rpc = golden_camera(&golden);
        let fit = fit_rpc(&camera_samples(&rpc, 12, 5)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let between = camera_samples(&rpc, 15, 4);
        let check_px = between
            .iter()
            .map(|(ground, image)| distance_px(fit.rpc.project(*ground), *image))
            .fold(0.0, f64::max);
        println!(
            "{name:<28} rms {:.2e} px, max {:.2e} px, between samples {check_px:.2e} px",
            fit.rms_px, fit.max_px
        );
        assert!(
            fit.max_px < 1e-3 && check_px < 1e-3,
            "{name}: {:?}",
            (fit.rms_px, fit.max_px, check_px)
        );
    }
}

#[test]
fn a_push_broom_is_fitted_to_a_thousandth_of_a_pixel_anywhere_on_earth() {
    for (lon_deg, lat_deg) in [
        (36.9, 37.6),
        (179.999, -17.0),
        (-180.0, 0.0),
        (15.0, 78.0),
        (100.0, -89.0),
    ] {
        let sensor = PushBroom::over(lon_deg, lat_deg);
        let fit = fit_rpc(&sensor.samples(15, &[-100.0, 50.0, 200.0, 350.0, 500.0])).expect("fits");
        let between = sensor.samples(8, &[-20.0, 130.0, 420.0]);
        let check_px = between
            .iter()
            .map(|(ground, image)| distance_px(fit.rpc.project(*ground), *image))
            .fold(0.0, f64::max);
        println!(
            "{lon_deg} {lat_deg}: rms {:.2e} px, max {:.2e} px, between {check_px:.2e} px",
            fit.rms_px, fit.max_px
        );
        assert!(fit.rms_px <= fit.max_px && fit.max_px < 1e-3 && check_px < 1e-3);
        // The model is consistent: it localises its own projections.
        for (ground, image) in between {
            let found = fit.rpc.localise(image, ground.height_m).expect("localises");
            assert!(distance_px(fit.rpc.project(found), image) < 1e-8);
        }
    }
}

#[test]
fn few_heights_leave_the_height_smooth_between_them() {
    let sensor = PushBroom::over(36.9, 37.6);
    let between = sensor.samples(8, &[-20.0, 130.0, 420.0]);
    for (heights_m, bar_px) in [(&[-100.0, 200.0, 500.0][..], 0.01), (&[-100.0, 500.0][..], 0.5)] {
        let fit = fit_rpc(&sensor.samples(15, heights_m)).expect("fits");
        let check_px = between
            .iter()
            .map(|(ground, image)| distance_px(fit.rpc.project(*ground), *image))
            .fold(0.0, f64::max);
        println!("{} heights: {check_px:.2e} px between", heights_m.len());
        assert!(
            fit.max_px < 1e-3 && check_px < bar_px,
            "{} heights: {check_px}",
            heights_m.len()
        );
    }
}

#[test]
fn noise_in_the_samples_is_smoothed_and_not_followed() {
    let sensor = PushBroom::over(36.9, 37.6);
    let truth = sensor.samples(20, &[0.0, 150.0, 300.0]);
    let noise = |i: usize, k: f64| 0.5 * ((i as f64 + 1.0) * k).sin();
    let noisy: Vec<(GeoPoint, ImagePoint)> = truth
        .iter()
        .enumerate()
        .map(|(i, (ground, image))| {
            (
                *ground,
                ImagePoint::new(image.col + noise(i, 12.9898), image.row + noise(i, 78.233)),
            )
        })
        .collect();
    let fit = fit_rpc(&noisy).expect("fits");
    assert!((0.4..0.6).contains(&fit.rms_px), "{}", fit.rms_px);
    let to_truth_px = truth
        .iter()
        .map(|(ground, image)| distance_px(fit.rpc.project(*ground), *image))
        .fold(0.0, f64::max);
    assert!(to_truth_px < 0.4, "{to_truth_px}");
}

#[test]
fn samples_that_cannot_make_a_camera_are_errors() {
    let sensor = PushBroom::over(36.9, 37.6);
    let samples = sensor.samples(7, &[0.0, 100.0]);
    let message = |samples: &[(GeoPoint, ImagePoint)]| match fit_rpc(samples) {
        Err(RpcError::Invalid(message)) => message,
        other => panic!("{other:?}"),
    };
    assert!(message(&samples[..FEWEST_SAMPLES - 1]).contains("39"));
    let mut bad = samples.clone();
    bad[3].1.row = f64::NAN;
    assert!(message(&bad).contains("rows"));
    bad[3] = samples[3];
    bad[5].0.lat_deg = f64::INFINITY;
    assert!(message(&bad).contains("latitudes"));
    assert!(message(&vec![samples[0]; 50]).contains("spread"));
    // One height alone is legal.
    assert!(fit_rpc(&sensor.samples(10, &[100.0])).expect("fits").max_px < 1e-3);
}
