//! The sun against published values and against general properties.

use heliosplat_rpc::{GeoPoint, SunPosition, sun_position};
use nalgebra::Vector3;
use proptest::prelude::*;

fn at(lon_deg: f64, lat_deg: f64) -> GeoPoint {
    GeoPoint::new(lon_deg, lat_deg, 0.0)
}

fn time(text: &str) -> jiff::Timestamp {
    text.parse().expect("RFC 3339")
}

#[test]
fn the_worked_example_of_the_nrel_report_is_reproduced() {
    // NREL/TP-560-34302, table A5.1; its zenith of 50.11162 includes refraction of 0.01633 degree.
    let place = GeoPoint::new(-105.1786, 39.742_476, 1_830.14);
    let sun = sun_position(time("2003-10-17T19:30:30Z"), place);
    let expected = SunPosition::from_degrees(194.340_24, 90.0 - 50.111_62 - 0.016_33);
    let apart_deg = sun.direction_enu().angle(&expected.direction_enu()).to_degrees();
    assert!(apart_deg < 5e-4, "{apart_deg}: {sun:?}");
}

#[test]
fn midsummer_midnight_is_bright_at_the_pole_and_midwinter_noon_dark() {
    let north = at(0.0, 89.999);
    assert!(
        sun_position(time("2024-06-20T00:00:00Z"), north)
            .elevation_rad
            .to_degrees()
            > 23.3
    );
    assert!(
        sun_position(time("2024-12-21T12:00:00Z"), north)
            .elevation_rad
            .to_degrees()
            < -23.3
    );
}

#[test]
fn times_far_from_today_give_directions_all_the_same() {
    for year in [
        "-009999-01-02T03:04:05Z",
        "1850-06-01T12:00:00Z",
        "1910-06-01T12:00:00Z",
        "1930-06-01T12:00:00Z",
        "1950-06-01T12:00:00Z",
        "1980-06-01T12:00:00Z",
        "2100-06-01T12:00:00Z",
        "9999-06-01T12:00:00Z",
    ] {
        let direction = sun_position(time(year), at(10.0, 50.0)).direction_enu();
        assert!((direction.norm() - 1.0).abs() < 1e-12, "{year}: {direction}");
    }
}

#[test]
fn angles_and_directions_are_each_others_inverse() {
    let east = SunPosition::from_degrees(90.0, 0.0).direction_enu();
    assert!((east - Vector3::x()).norm() < 1e-15);
    let north = SunPosition::from_direction_enu(Vector3::new(0.0, 2.0, 2.0));
    assert!(
        (north.azimuth_rad, north.elevation_rad) == (0.0, std::f64::consts::FRAC_PI_4),
        "{north:?}"
    );
    let zenith = SunPosition::from_direction_enu(Vector3::z());
    assert_eq!(zenith.elevation_rad, std::f64::consts::FRAC_PI_2);
}

proptest! {
    #[test]
    fn the_sun_moves_at_most_as_fast_as_the_earth_turns(
        seconds in 0_i64..4_000_000_000, lon_deg in -180.0..180.0, lat_deg in -90.0..90.0, later_s in 1_i64..3_600,
    ) {
        let moment = |s| jiff::Timestamp::from_second(s).expect("in range");
        let first = sun_position(moment(seconds), at(lon_deg, lat_deg));
        let second = sun_position(moment(seconds + later_s), at(lon_deg, lat_deg));
        prop_assert!((0.0..std::f64::consts::TAU).contains(&first.azimuth_rad));
        prop_assert!(first.elevation_rad.abs() <= std::f64::consts::FRAC_PI_2);
        let (a, b) = (first.direction_enu(), second.direction_enu());
        let moved_deg = a.cross(&b).norm().atan2(a.dot(&b)).to_degrees();
        // 360.99 degrees a day, and never faster; over an hour at declinations up to 23.5 degrees, never at rest.
        prop_assert!(moved_deg <= later_s as f64 * 361.0 / 86_400.0);
        prop_assert!(moved_deg >= later_s as f64 * 360.0 / 86_400.0 * 0.9);
    }
}
