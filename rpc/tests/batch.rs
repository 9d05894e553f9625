//! Projection and localisation of many points at once equal those of single points.

mod common;

use common::{distance_px, golden_camera, golden_rpcs, localisation_table, projection_table, shared};
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc};

/// Bar of localisation, pixels of the point projected back.
const LOCALISATION_BAR_PX: f64 = 1e-8;

fn ground(count: usize) -> Vec<GeoPoint> {
    let fraction = |i: usize, step: f64| (i as f64 * step).fract();
    (0..count)
        .map(|i| {
            GeoPoint::new(
                36.86 + 0.1 * fraction(i, 0.618_033_988_7),
                37.54 + 0.08 * fraction(i, 0.754_877_666_2),
                300.0 + 900.0 * fraction(i, 0.569_840_290_9),
            )
        })
        .collect()
}

#[test]
fn projecting_many_gives_the_bits_of_projecting_one() {
    let rpc = Rpc::example();
    for count in [0, 1, 7, 8, 9, 1003] {
        let points = ground(count);
        let all = rpc.project_all(&points);
        assert_eq!(all.len(), count);
        for (point, image) in points.iter().zip(&all) {
            assert_eq!(rpc.project(*point), *image);
        }
    }
}

#[test]
fn localising_many_returns_to_the_same_pixels() {
    let rpc = Rpc::example();
    let points = ground(5003);
    let heights: Vec<f64> = points.iter().map(|p| p.height_m).collect();
    let images = rpc.project_all(&points);
    for (found, (image, truth)) in rpc
        .localise_all(&images, &heights)
        .iter()
        .zip(images.iter().zip(&points))
    {
        let found = found.expect("the point lies on the model's ground");
        assert!(distance_px(rpc.project(found), *image) < LOCALISATION_BAR_PX);
        assert!((found.lon_deg - truth.lon_deg).abs() < 1e-9 && (found.lat_deg - truth.lat_deg).abs() < 1e-9);
    }
}

#[test]
fn what_cannot_be_localised_is_none_and_spoils_no_neighbour() {
    let rpc = Rpc::example();
    let points = ground(16);
    let mut images = rpc.project_all(&points);
    images[3].col = f64::NAN;
    images[5].row = 1e12;
    let heights: Vec<f64> = points.iter().map(|p| p.height_m).collect();
    let found = rpc.localise_all(&images, &heights);
    for (i, (found, image)) in found.iter().zip(&images).enumerate() {
        assert_eq!(found.is_some(), rpc.localise(*image, heights[i]).is_ok(), "point {i}");
    }
    assert!(found[3].is_none() && found[4].is_some());
}

#[test]
fn every_golden_rpc_keeps_its_bars_in_batches() {
    let Some(shared) = shared() else { return };
    for (name, golden) in &golden_rpcs(&shared) {
        let rpc = golden_camera(golden);
        let table = projection_table(golden);
        let points: Vec<GeoPoint> = table.iter().map(|(point, _)| *point).collect();
        for (image, (_, exact)) in rpc.project_all(&points).iter().zip(&table) {
            assert!(distance_px(*image, *exact) < 1e-9, "{name}");
        }
        let table = localisation_table(golden);
        let images: Vec<ImagePoint> = table.iter().map(|(image, _)| *image).collect();
        let heights: Vec<f64> = table.iter().map(|(_, truth)| truth.height_m).collect();
        for (found, (image, truth)) in rpc.localise_all(&images, &heights).iter().zip(&table) {
            let alone = rpc.localise(*image, truth.height_m).ok();
            assert_eq!(found.is_some(), alone.is_some(), "{name}");
            if let Some(found) = found {
                let off_px = distance_px(rpc.project(*found), *image);
                assert!(off_px < LOCALISATION_BAR_PX, "{name}: {off_px} px");
                assert!((found.lon_deg - truth.lon_deg).abs() < 1e-9, "{name}");
                assert!((found.lat_deg - truth.lat_deg).abs() < 1e-9, "{name}");
            }
        }
    }
}
