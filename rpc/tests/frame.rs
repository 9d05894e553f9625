//! The ENU frame: round trips below a micrometre anywhere, and correct directions.

use heliosplat_rpc::frame::{WGS84_SEMI_MAJOR_M, ecef_from_geo, geo_from_ecef};
use heliosplat_rpc::{GeoPoint, LocalFrame};
use nalgebra::Vector3;
use proptest::prelude::*;

const MICROMETRE: f64 = 1e-6;

fn geo(lon_deg: f64, lat_deg: f64, height_m: f64) -> GeoPoint {
    GeoPoint::new(lon_deg, lat_deg, height_m)
}

#[test]
fn special_places_have_the_coordinates_of_the_ellipsoid() {
    let semi_minor_m = 6_356_752.314_245_179;
    for (place, expected) in [
        (geo(0.0, 0.0, 0.0), [WGS84_SEMI_MAJOR_M, 0.0, 0.0]),
        (geo(90.0, 0.0, 10.0), [0.0, WGS84_SEMI_MAJOR_M + 10.0, 0.0]),
        (geo(0.0, 90.0, 0.0), [0.0, 0.0, semi_minor_m]),
        (geo(77.0, -90.0, 5.0), [0.0, 0.0, -semi_minor_m - 5.0]),
    ] {
        let ecef_m = ecef_from_geo(place);
        assert!((ecef_m - Vector3::from(expected)).norm() < 2e-9, "{place:?}: {ecef_m}");
        let back = geo_from_ecef(ecef_m);
        assert!((back.lat_deg - place.lat_deg).abs() < 1e-13 && (back.height_m - place.height_m).abs() < 2e-9);
    }
    let centre = geo_from_ecef(Vector3::zeros());
    assert!(centre.lat_deg.is_finite() && centre.lon_deg.is_finite() && centre.height_m.is_finite());
}

#[test]
fn axes_point_east_north_and_up() {
    let frame = LocalFrame::new(geo(36.9, 37.6, 700.0));
    let east = frame.enu_from_geo(geo(36.901, 37.6, 700.0));
    let north = frame.enu_from_geo(geo(36.9, 37.601, 700.0));
    let up = frame.enu_from_geo(geo(36.9, 37.6, 800.0));
    assert!(
        (east.x - 88.3).abs() < 0.1 && east.y.abs() < 1e-3 && east.z.abs() < 1e-3,
        "{east}"
    );
    assert!(
        (north.y - 111.0).abs() < 0.2 && north.x.abs() < 1e-3 && north.z.abs() < 1e-2,
        "{north}"
    );
    assert!((up - Vector3::new(0.0, 0.0, 100.0)).norm() < 1e-8, "{up}");
}

#[test]
fn the_date_line_is_not_there() {
    let frame = LocalFrame::new(geo(179.9999, -17.0, 0.0));
    let across = frame.enu_from_geo(geo(-179.9999, -17.0, 0.0));
    assert!((across.x - 21.29).abs() < 0.05, "{across}");
    let back = frame.geo_from_enu(across);
    assert!((back.lon_deg + 179.9999).abs() < 1e-11, "{back:?}");
}

#[test]
fn a_frame_on_the_pole_works() {
    for lat_deg in [90.0, -90.0] {
        let frame = LocalFrame::new(geo(0.0, lat_deg, 2_800.0));
        for enu_m in [
            Vector3::new(500.0, -300.0, 20.0),
            Vector3::zeros(),
            Vector3::new(0.0, 1e-3, 0.0),
        ] {
            let back = frame.enu_from_geo(frame.geo_from_enu(enu_m));
            assert!((back - enu_m).norm() < MICROMETRE, "{lat_deg}: {back} for {enu_m}");
        }
    }
}

proptest! {
    #[test]
    fn enu_survives_the_round_trip(
        lon_deg in -180.0..=180.0, lat_deg in -90.0..=90.0, height_m in -500.0..9_000.0,
        east_m in -50_000.0..50_000.0, north_m in -50_000.0..50_000.0, up_m in -1_000.0..9_000.0,
    ) {
        let frame = LocalFrame::new(geo(lon_deg, lat_deg, height_m));
        let enu_m = Vector3::new(east_m, north_m, up_m);
        let back = frame.enu_from_geo(frame.geo_from_enu(enu_m));
        prop_assert!((back - enu_m).norm() < MICROMETRE, "{} for {}", back, enu_m);
    }

    #[test]
    fn geodetic_coordinates_survive_the_round_trip_up_to_orbit(
        lon_deg in -180.0..=180.0, lat_deg in -90.0..=90.0, height_m in -10_000.0..40_000_000.0,
    ) {
        let place = geo(lon_deg, lat_deg, height_m);
        let back = geo_from_ecef(ecef_from_geo(place));
        prop_assert!((back.height_m - height_m).abs() < MICROMETRE);
        prop_assert!((ecef_from_geo(back) - ecef_from_geo(place)).norm() < MICROMETRE);
        prop_assert!((-180.0..=180.0).contains(&back.lon_deg) && (-90.0..=90.0).contains(&back.lat_deg));
    }

    #[test]
    fn distances_are_those_of_space(
        lat_deg in -89.0..89.0, east_m in -1_000.0..1_000.0, north_m in -1_000.0..1_000.0, up_m in -1_000.0..1_000.0,
    ) {
        let frame = LocalFrame::new(geo(12.0, lat_deg, 100.0));
        let enu_m = Vector3::new(east_m, north_m, up_m);
        let space = ecef_from_geo(frame.geo_from_enu(enu_m)) - ecef_from_geo(frame.origin);
        prop_assert!((space.norm() - enu_m.norm()).abs() < MICROMETRE);
    }
}
