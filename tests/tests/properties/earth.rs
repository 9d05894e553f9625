//! The Earth: poles, date line, both hemispheres, from below the sea to the highest summit.

use crate::config;
use heliosplat_rpc::sun::{SunPosition, sun_position};
use heliosplat_rpc::{GeoPoint, ImagePoint, ImageWindow, LocalFrame, PinholeFit, Rpc};
use nalgebra::Vector3;
use proptest::prelude::*;

fn longitude() -> impl Strategy<Value = f64> {
    prop_oneof![3 => -180.0f64..180.0, 1 => Just(180.0), 1 => Just(-180.0), 1 => 179.99f64..180.0, 1 => -180.0f64..-179.99]
}

fn place() -> impl Strategy<Value = GeoPoint> {
    let latitude = prop_oneof![3 => -90.0f64..90.0, 1 => Just(90.0), 1 => Just(-90.0), 1 => Just(0.0)];
    (longitude(), latitude, -400.0f64..8800.0)
        .prop_map(|(lon_deg, lat_deg, height_m)| GeoPoint::new(lon_deg, lat_deg, height_m))
}

proptest! {
    #![proptest_config(config("frames"))]
    #[test]
    fn local_frames_lead_there_and_back(origin in place(), offset in prop::array::uniform3(-20e3f64..20e3)) {
        let (frame, offset) = (LocalFrame::new(origin), Vector3::from(offset));
        let there = frame.geo_from_enu(offset);
        prop_assert!((-180.0..=180.0).contains(&there.lon_deg) && (-90.0..=90.0).contains(&there.lat_deg), "{there:?}");
        let back = frame.enu_from_geo(there);
        prop_assert!((back - offset).norm() < 1e-6, "{offset} came back as {back}");
        let rotation = frame.enu_from_ecef_rotation();
        prop_assert!((rotation * rotation.transpose() - nalgebra::Matrix3::identity()).norm() < 1e-14);
    }
}

/// A camera that looks down, `tilt` metres sideways per metre of height, over a place where longitudes mean something.
fn rpc(at: GeoPoint, tilt: [f64; 2]) -> Rpc {
    let half_m = 250.0;
    let latitude_scale_deg = half_m / 111_320.0;
    let numerator = |longitude: f64, latitude: f64, height: f64| {
        let mut coefficients = [0.0; 20];
        coefficients[1..4].copy_from_slice(&[longitude, latitude, height]);
        coefficients
    };
    let mut one = [0.0; 20];
    one[0] = 1.0;
    Rpc {
        line_offset: 499.5,
        sample_offset: 499.5,
        latitude_offset_deg: at.lat_deg,
        longitude_offset_deg: at.lon_deg,
        height_offset_m: at.height_m,
        line_scale: 500.0,
        sample_scale: 500.0,
        latitude_scale_deg,
        longitude_scale_deg: latitude_scale_deg / at.lat_deg.to_radians().cos(),
        height_scale_m: 500.0,
        line_numerator: numerator(0.0, -1.0, -2.0 * tilt[1]),
        line_denominator: one,
        sample_numerator: numerator(1.0, 0.0, 2.0 * tilt[0]),
        sample_denominator: one,
        error_bias_m: None,
        error_random_m: None,
    }
}

proptest! {
    #![proptest_config(config("cameras"))]
    #[test]
    fn cameras_work_across_the_date_line_and_near_the_poles(
        longitude in longitude(), latitude in -85.0f64..85.0, height_m in -400.0f64..8800.0,
        tilt in prop::array::uniform2(-1.7f64..1.7), pixel in prop::array::uniform2(0.0f64..999.0), up in -100.0f64..100.0,
    ) {
        let at = GeoPoint { lon_deg: longitude, lat_deg: latitude, height_m };
        let rpc = rpc(at, tilt);
        let seen = ImagePoint { col: pixel[0], row: pixel[1] };
        let ground = rpc.localise(seen, height_m + up).map_err(|error| TestCaseError::fail(error.to_string()))?;
        let again = rpc.project(ground);
        prop_assert!((again.col - seen.col).hypot(again.row - seen.row) < 1e-6, "{seen:?} came back as {again:?}");
        let frame = LocalFrame::new(at);
        let enu = frame.enu_from_geo(ground);
        // 60 degrees off nadir and half an image.
        prop_assert!(enu.norm() < 1000.0, "{enu}");
        let window = ImageWindow { col0: 300.0, row0: 300.0, width: 400, height: 400 };
        let fit = PinholeFit::fit(&rpc, &frame, window, (height_m - 50.0, height_m + 50.0))
            .map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert!(fit.max_px < 0.25, "{} px", fit.max_px);
    }
}

proptest! {
    #![proptest_config(config("suns"))]
    #[test]
    fn suns_are_directions_anywhere_at_any_time(at in place(), second in 0i64..4_102_444_800) {
        let time = jiff::Timestamp::from_second(second).expect("a time of this century or the last");
        let sun = sun_position(time, at);
        prop_assert!((-91.0f64.to_radians()..=91.0f64.to_radians()).contains(&sun.elevation_rad), "{sun:?}");
        let direction = sun.direction_enu();
        prop_assert!((direction.norm() - 1.0).abs() < 1e-12);
        let again = SunPosition::from_direction_enu(direction).direction_enu();
        prop_assert!((again - direction).norm() < 1e-12);
        // A metre to the east, over the date line too, it is at the same place.
        let beside = GeoPoint { lon_deg: if at.lon_deg > 0.0 { at.lon_deg - 360.0 } else { at.lon_deg + 360.0 }, ..at };
        let other = sun_position(time, beside).direction_enu();
        prop_assert!((other - direction).norm() < 1e-9, "{other} against {direction}");
    }
}
