//! Projection, its Jacobian and localisation over whole images, and inputs that make no sense.

mod common;

use common::push_broom::PushBroom;
use common::{distance_px, golden_camera, golden_rpcs, projection_table, shared};
use heliosplat_rpc::fit::fit_rpc;
use heliosplat_rpc::{GeoPoint, ImagePoint, Rpc, RpcError};
use proptest::prelude::*;
use std::sync::LazyLock;

/// Cameras with and without the date line, and close to a pole.
static CAMERAS: LazyLock<Vec<Rpc>> = LazyLock::new(|| {
    [
        (36.9, 37.6),
        (179.999, -17.0),
        (-180.0, 0.0),
        (15.0, 78.0),
        (100.0, -89.0),
    ]
    .map(|(lon_deg, lat_deg)| {
        let sensor = PushBroom::over(lon_deg, lat_deg);
        fit_rpc(&sensor.samples(12, &[-100.0, 200.0, 500.0])).expect("fits").rpc
    })
    .into()
});

/// Central differences of a projection, `d(col, row) / d(lon, lat, height)`.
fn numeric_jacobian(rpc: &Rpc, at: GeoPoint) -> [[f64; 3]; 2] {
    let steps = [rpc.longitude_scale_deg, rpc.latitude_scale_deg, rpc.height_scale_m].map(|s| s.abs() * 1e-4);
    let moved = |axis: usize, sign: f64| {
        let mut offsets = [0.0; 3];
        offsets[axis] = sign * steps[axis];
        rpc.project(GeoPoint::new(
            at.lon_deg + offsets[0],
            at.lat_deg + offsets[1],
            at.height_m + offsets[2],
        ))
    };
    let column = |axis: usize| {
        let (high, low) = (moved(axis, 1.0), moved(axis, -1.0));
        [
            (high.col - low.col) / (2.0 * steps[axis]),
            (high.row - low.row) / (2.0 * steps[axis]),
        ]
    };
    let columns = [column(0), column(1), column(2)];
    [0, 1].map(|r| columns.map(|c| c[r]))
}

/// Largest difference of the analytic Jacobian from the numeric one, of the largest entry in its column.
fn jacobian_error(rpc: &Rpc, at: GeoPoint) -> f64 {
    let (image, analytic) = rpc.project_with_jacobian(at);
    assert!(distance_px(image, rpc.project(at)) < 1e-9);
    let numeric = numeric_jacobian(rpc, at);
    let mut largest = 0.0_f64;
    for axis in 0..3 {
        let size = numeric[0][axis].abs().max(numeric[1][axis].abs());
        for r in 0..2 {
            largest = largest.max((analytic[(r, axis)] - numeric[r][axis]).abs() / size);
        }
    }
    largest
}

#[test]
fn the_jacobian_of_every_golden_camera_is_that_of_central_differences() {
    let Some(shared) = shared() else { return };
    let mut worst = (0.0, String::new());
    for (name, golden) in golden_rpcs(&shared) {
        let rpc = golden_camera(&golden);
        for (ground, _) in projection_table(&golden) {
            let error = jacobian_error(&rpc, ground);
            assert!(error < 1e-5, "{name} at {ground:?}: {error}");
            if error > worst.0 {
                worst = (error, name.clone());
            }
        }
    }
    println!("largest relative difference {:.2e} ({})", worst.0, worst.1);
}

#[test]
fn longitudes_on_both_sides_of_the_date_line_are_one_place() {
    let rpc = &CAMERAS[1];
    let place = GeoPoint::new(-179.999, -17.0, 50.0);
    let same = GeoPoint {
        lon_deg: 180.001,
        ..place
    };
    let turned = GeoPoint {
        lon_deg: 540.001,
        ..place
    };
    let image = rpc.project(place);
    assert!((0.0..4_000.0).contains(&image.col), "{image:?}");
    assert!(distance_px(image, rpc.project(same)) < 1e-6);
    assert!(distance_px(image, rpc.project(turned)) < 1e-6);
    assert!(distance_px(image, rpc.project_with_jacobian(place).0) < 1e-9);
    let found = rpc.localise(image, 50.0).expect("localises");
    assert!((found.lon_deg + 179.999).abs() < 1e-10, "{found:?}");
    // A vendor may count longitudes from 0 to 360.
    let unwrapped = Rpc {
        longitude_offset_deg: rpc.longitude_offset_deg.rem_euclid(360.0),
        ..rpc.clone()
    };
    assert!(distance_px(image, unwrapped.project(place)) < 1e-6);
    assert!((unwrapped.localise(image, 50.0).expect("localises").lon_deg + 179.999).abs() < 1e-10);
}

#[test]
fn a_crop_sees_the_same_ground() {
    let rpc = &CAMERAS[0];
    let crop = rpc.cropped(1_000.0, 500.0);
    let whole = rpc.localise(ImagePoint::new(1_100.0, 700.0), 30.0).expect("localises");
    let cropped = crop
        .localise(ImagePoint { col: 100.0, row: 200.0 }, 30.0)
        .expect("localises");
    assert!((whole.lon_deg - cropped.lon_deg).abs() < 1e-12 && (whole.lat_deg - cropped.lat_deg).abs() < 1e-12);
}

#[test]
fn what_cannot_be_localised_is_a_clear_error() {
    let rpc = &CAMERAS[0];
    let localise = |col, row, height_m| rpc.localise(ImagePoint { col, row }, height_m);
    for (col, row, height_m) in [
        (f64::NAN, 0.0, 0.0),
        (0.0, f64::INFINITY, 0.0),
        (0.0, 0.0, f64::NAN),
        (1e300, 1e300, 0.0),
        (0.0, 0.0, 1e300),
    ] {
        match localise(col, row, height_m) {
            Err(RpcError::NoConvergence { .. } | RpcError::Inconsistent { .. }) => {}
            other => panic!("{col}, {row}, {height_m}: {other:?}"),
        }
    }
    let message = localise(1e300, 5.0, 7.0).expect_err("too far").to_string();
    assert!(message.contains("1e300") || message.contains("000000"), "{message}");
    // A constant camera has no slope, one of zero scale no unit.
    let constant = Rpc {
        line_numerator: [0.0; 20],
        ..rpc.clone()
    };
    assert!(constant.localise(ImagePoint { col: 5.0, row: 5.0 }, 0.0).is_err());
    let collapsed = Rpc {
        line_scale: 0.0,
        ..rpc.clone()
    };
    let unscaled = Rpc {
        latitude_scale_deg: f64::NAN,
        longitude_scale_deg: 0.0,
        ..rpc.clone()
    };
    assert!(unscaled.localise(ImagePoint { col: 5.0, row: 5.0 }, 0.0).is_err());
    assert!(collapsed.localise(ImagePoint { col: 5.0, row: 5.0 }, 0.0).is_err());
}

/// Exponents of longitude, latitude and height in the order of the coefficients.
const POWERS: [[i32; 3]; 20] = [
    [0, 0, 0],
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [1, 1, 0],
    [1, 0, 1],
    [0, 1, 1],
    [2, 0, 0],
    [0, 2, 0],
    [0, 0, 2],
    [1, 1, 1],
    [3, 0, 0],
    [1, 2, 0],
    [1, 0, 2],
    [2, 1, 0],
    [0, 3, 0],
    [0, 1, 2],
    [2, 0, 1],
    [0, 2, 1],
    [0, 0, 3],
];

/// The same camera with other scales: those of the ground `ground` times, those of the image `image` times as large.
fn rescaled(rpc: &Rpc, ground: [f64; 3], image: [f64; 2]) -> Rpc {
    let term = |of: usize| (0..3).map(|axis| ground[axis].powi(POWERS[of][axis])).product::<f64>();
    let polynomial = |values: &[f64; 20], by: f64| std::array::from_fn(|of| values[of] * term(of) * by);
    Rpc {
        longitude_scale_deg: rpc.longitude_scale_deg * ground[0],
        latitude_scale_deg: rpc.latitude_scale_deg * ground[1],
        height_scale_m: rpc.height_scale_m * ground[2],
        sample_scale: rpc.sample_scale * image[0],
        line_scale: rpc.line_scale * image[1],
        sample_numerator: polynomial(&rpc.sample_numerator, 1.0 / image[0]),
        sample_denominator: polynomial(&rpc.sample_denominator, 1.0),
        line_numerator: polynomial(&rpc.line_numerator, 1.0 / image[1]),
        line_denominator: polynomial(&rpc.line_denominator, 1.0),
        ..rpc.clone()
    }
}

#[test]
fn scales_of_no_image_make_an_equivalent_camera() {
    for rpc in CAMERAS.iter() {
        for (ground, image) in [
            ([0.05; 3], [1.0; 2]),
            ([1.0; 3], [1e5; 2]),
            ([20.0, 20.0, 1.0], [1.0; 2]),
            ([-0.05, 0.05, 1.0], [1.0, 0.01]),
            ([0.05; 3], [1e5; 2]),
            ([1e5; 3], [1e5; 2]),
        ] {
            let odd = rescaled(rpc, ground, image);
            for (col, row) in [(0.0, 0.0), (3_999.0, 0.0), (2_000.0, 1_000.0), (3_999.0, 3_999.0)] {
                let at = ImagePoint { col, row };
                let expected = rpc.localise(at, 300.0).expect("localises");
                let found = odd
                    .localise(at, 300.0)
                    .unwrap_or_else(|error| panic!("{ground:?} {image:?}: {error}"));
                assert!(
                    (found.lat_deg - expected.lat_deg).abs() < 1e-10,
                    "{found:?} {expected:?}"
                );
                assert!(
                    (found.lon_deg - expected.lon_deg).abs() < 1e-8,
                    "{found:?} {expected:?}"
                );
            }
        }
    }
}

#[test]
fn a_model_that_bends_far_more_over_its_image_than_it_slopes_is_refused_when_localised() {
    let rpc = &CAMERAS[0];
    let mut inconsistent = Rpc {
        sample_numerator: rpc.sample_numerator.map(|c| c * 0.1),
        ..rpc.clone()
    };
    // The cubic term of the longitude.
    inconsistent.sample_numerator[11] += 0.02;
    let image = ImagePoint::new(rpc.sample_offset + rpc.sample_scale, rpc.line_offset);
    match inconsistent.localise(image, 100.0) {
        Err(RpcError::Inconsistent { span }) => assert!((5.0..20.0).contains(&span), "{span}"),
        other => panic!("{other:?}"),
    }
}

proptest! {
    #[test]
    fn localising_what_was_projected_returns_it(
        camera in 0..5_usize, col in -400.0..4_400.0, row in -400.0..4_400.0, height_m in -200.0..700.0,
    ) {
        let rpc = &CAMERAS[camera];
        let image = ImagePoint { col, row };
        let ground = rpc.localise(image, height_m).expect("localises");
        prop_assert!((-180.0..=180.0).contains(&ground.lon_deg));
        prop_assert!(distance_px(rpc.project(ground), image) < 1e-8);
        let again = rpc.localise(rpc.project(ground), height_m).expect("localises");
        prop_assert!((again.lat_deg - ground.lat_deg).abs() < 1e-12);
    }

    #[test]
    fn the_jacobian_is_that_of_central_differences(
        camera in 0..5_usize, l in -1.0..1.0, p in -1.0..1.0, h in -1.0..1.0,
    ) {
        let rpc = &CAMERAS[camera];
        let at = GeoPoint::new(rpc.longitude_offset_deg + l * rpc.longitude_scale_deg, rpc.latitude_offset_deg + p * rpc.latitude_scale_deg, rpc.height_offset_m + h * rpc.height_scale_m);
        prop_assert!(jacobian_error(rpc, at) < 1e-6);
    }

    #[test]
    fn any_camera_at_all_ends_in_a_point_or_an_error(
        coefficients in prop::collection::vec(-2.0..2.0_f64, 80),
        scales in prop::collection::vec(prop_oneof![-10.0..10.0_f64, Just(0.0), Just(1e-300), Just(f64::NAN)], 5),
        col in prop_oneof![-1e4..1e4_f64, Just(f64::NAN)], row in -1e4..1e4_f64, height_m in -1e4..1e4_f64,
    ) {
        let list = |k: usize| std::array::from_fn(|i| coefficients[20 * k + i]);
        let rpc = Rpc {
            line_offset: 0.0,
            sample_offset: 0.0,
            latitude_offset_deg: 10.0,
            longitude_offset_deg: 20.0,
            height_offset_m: 30.0,
            line_scale: scales[0] * 100.0,
            sample_scale: scales[1] * 100.0,
            latitude_scale_deg: scales[2],
            longitude_scale_deg: scales[3],
            height_scale_m: scales[4] * 100.0,
            line_numerator: list(0),
            line_denominator: list(1),
            sample_numerator: list(2),
            sample_denominator: list(3),
            error_bias_m: None,
            error_random_m: None,
        };
        let image = ImagePoint { col, row };
        if let Ok(ground) = rpc.localise(image, height_m) {
            prop_assert!(distance_px(rpc.project(ground), image) < 1e-5);
        }
    }
}
