//! The 283 golden suns of the NREL algorithm, compared as the angle between directions.

mod common;

use common::{read_json, row, shared};
use heliosplat_rpc::{GeoPoint, SunPosition, sun_position};
use nalgebra::Vector3;
use std::collections::BTreeMap;

const BAR_DEG: f64 = 0.01;

fn angle_deg(a: Vector3<f64>, b: Vector3<f64>) -> f64 {
    // Accurate for small angles, where the arc cosine is not.
    a.cross(&b).norm().atan2(a.dot(&b)).to_degrees()
}

#[test]
fn every_golden_sun_is_within_a_hundredth_of_a_degree() {
    let Some(shared) = shared() else { return };
    let golden = read_json(&shared.join("golden/sun.json"));
    let rows = golden["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 283);
    let mut largest: BTreeMap<String, f64> = BTreeMap::new();
    for case in rows {
        let number = |key: &str| case[key].as_f64().expect(key);
        let time: jiff::Timestamp = case["utc"].as_str().expect("utc").parse().expect("RFC 3339");
        let at = GeoPoint::new(number("lon"), number("lat"), number("alt_m"));
        let sun = sun_position(time, at);
        let error_deg = angle_deg(sun.direction_enu(), Vector3::from(row::<3>(&case["sun_enu"])));
        assert!(error_deg < BAR_DEG, "{case}: {error_deg} degree off");
        let golden_angles = SunPosition::from_degrees(number("azimuth_deg"), number("elevation_deg"));
        assert!(angle_deg(sun.direction_enu(), golden_angles.direction_enu()) < BAR_DEG);
        let entry = largest
            .entry(case["cat"].as_str().unwrap_or("?").to_owned())
            .or_default();
        *entry = entry.max(error_deg);
    }
    for (category, error_deg) in largest {
        println!("{category:<24} {error_deg:.6} degree");
    }
}
