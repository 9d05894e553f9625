//! Time and memory of large adjustments, by hand: `cargo test -p heliosplat-rpc --test adjust_size -- --ignored
//! --nocapture`. `HELIOSPLAT_TIES` and `HELIOSPLAT_SHOWING` are the numbers of ties and of images that show each.

use heliosplat_rpc::adjust::{AdjustImage, AdjustOptions, BiasModel, Sighting, Track, adjust};
use heliosplat_rpc::{GeoPoint, ImagePoint, LocalFrame, Rpc};
use nalgebra::Vector3;
use std::time::Instant;

mod common;

use common::push_broom::PushBroom;

const IMAGES: usize = 50;
const SIZE: usize = 4_000;

fn setting(name: &str, usual: usize) -> usize {
    std::env::var(name)
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(usual)
}

/// Peak memory of the process, MiB.
fn peak_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok())
        .unwrap_or(0.0)
        / 1024.0
}

fn biases_px(image: usize) -> [f64; 2] {
    [2.3, 3.1].map(|rate| 3.0 * (rate * image as f64).sin())
}

/// The camera as delivered: off by its bias.
fn camera(image: usize) -> Rpc {
    let mut sensor = PushBroom::over(36.9, 37.5);
    let angle = image as f64;
    (sensor.size, sensor.roll_rad, sensor.pitch_rad) = (SIZE, 0.35 * angle.sin(), 0.3 * (1.7 * angle).cos());
    let samples = sensor.samples(11, &[0.0, 70.0, 140.0, 210.0]);
    let rpc = heliosplat_rpc::fit::fit_rpc(&samples).expect("fits").rpc;
    let [col, row] = biases_px(image);
    rpc.cropped(col, row)
}

#[test]
#[ignore = "a measurement"]
fn fifty_images_and_many_ties() {
    let (ties, showing) = (setting("HELIOSPLAT_TIES", 200_000), setting("HELIOSPLAT_SHOWING", 8));
    let frame = LocalFrame::new(GeoPoint::new(36.9, 37.5, 100.0));
    let cameras: Vec<Rpc> = (0..IMAGES).map(camera).collect();
    let tracks: Vec<Track> = (0..ties)
        .map(|k| {
            let [east, north, up] = [0.618, 0.755, 0.570].map(|step| (k as f64 * step).fract() - 0.5);
            let ground = frame.geo_from_enu(Vector3::new(1600.0 * east, 1600.0 * north, 80.0 * up));
            let sightings = (0..showing).map(|turn| {
                let image = (k + 7 * turn) % IMAGES;
                let at = cameras[image].project(ground);
                let [col, row] = biases_px(image);
                let noise = |rate: f64| 0.15 * (rate * (k * IMAGES + image) as f64).sin();
                Sighting {
                    image,
                    at: ImagePoint::new(at.col + col + noise(1.3), at.row + row + noise(2.7)),
                    weight: 1.0,
                }
            });
            Track {
                near: ground,
                sightings: sightings.collect(),
            }
        })
        .collect();
    let images: Vec<AdjustImage> = cameras
        .iter()
        .map(|rpc| AdjustImage {
            rpc,
            width: SIZE,
            height: SIZE,
        })
        .collect();
    println!(
        "{ties} ties of {showing} sightings in {IMAGES} images: {:.0} MiB",
        peak_mib()
    );
    for model in [BiasModel::Translation, BiasModel::Drift] {
        let begun = Instant::now();
        let options = AdjustOptions {
            model,
            ..Default::default()
        };
        let found = adjust(&images, &tracks, &frame, options).expect("adjusts");
        let (rounds, sigma_px, seconds) = (found.rounds, found.sigma_px, begun.elapsed().as_secs_f64());
        println!(
            "{model:?}: {seconds:.1} s, {rounds} rounds, {sigma_px:.3} px, peak {:.0} MiB",
            peak_mib()
        );
    }
}
