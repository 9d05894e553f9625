//! Light to Gaussians.

use crate::config;
use crate::draw::{Drawn, with_one_and_two_threads};
use crate::draw::{
    direction, extreme_gaussians, model, ordinary_gaussians, parameters, reference_gaussians, sun, wide,
};
use glam::Vec3;
use heliosplat::gaussians::Table;
use heliosplat::light::Light;
use heliosplat::trace::{OccluderGradients, Occluders, SunVisibility, Transmittance, transmittance};
use heliosplat_tests::reference;
use proptest::prelude::*;

const ROUTES: [SunVisibility; 2] = [SunVisibility::Plane, SunVisibility::Bvh];

/// A light of any kind: a sun, or a point in, above or beside the Gaussians, also in the centre of one.
fn light() -> impl Strategy<Value = Light> {
    prop_oneof![
        4 => sun().prop_map(Light::Directional),
        1 => prop::array::uniform3(-20.0f32..20.0).prop_map(|p| Light::Point(Vec3::from(p))),
        1 => Just(Light::Point(Vec3::ZERO)),
    ]
}

fn traced(gaussians: &Table, light: &Light, route: SunVisibility) -> (Transmittance, Table) {
    let occluders = Occluders::tracing_by(route, gaussians);
    let origins: Vec<u32> = (0..gaussians.count as u32).collect();
    let traced = transmittance(&occluders, &origins, light);
    let mut out = gaussians.zeros_like();
    let d = origins
        .iter()
        .map(|o| if o % 2 == 0 { 1.0 } else { -0.7 })
        .collect::<Vec<_>>();
    traced.backward(gaussians, (&occluders, OccluderGradients::All), &origins, &d, &mut out);
    (traced, out)
}

fn is_bounded(drawn: &[Drawn], light: &Light) -> Result<(), TestCaseError> {
    let gaussians = parameters(&model(), drawn).gaussians;
    for route in ROUTES {
        let (traced, gradients) = traced(&gaussians, light, route);
        prop_assert!(
            traced.values.iter().all(|s| (0.0..=1.0).contains(s)),
            "{route:?}: {:?}",
            traced.values
        );
        for group in &gradients.groups {
            prop_assert!(
                group.values.iter().all(|g| g.is_finite()),
                "{route:?}: {} {:?}",
                group.spec.name,
                group.values
            );
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(config("light_bounds"))]
    #[test]
    fn transmittance_is_a_share_and_has_gradients(drawn in extreme_gaussians(24), light in light()) {
        is_bounded(&drawn, &light)?;
    }
}

proptest! {
    #![proptest_config(config("light_reference"))]
    #[test]
    fn both_routes_agree_with_the_reference(drawn in ordinary_gaussians(24), sun in sun()) {
        let gaussians = parameters(&model(), &drawn).gaussians;
        let exact = reference_gaussians(&drawn);
        let light = Light::Directional(sun);
        for route in ROUTES {
            let (traced, _) = traced(&gaussians, &light, route);
            for (origin, &value) in traced.values.iter().enumerate() {
                let Some((least, most)) = reference::transmittance_bounds(&exact, origin, &wide(sun)) else { continue };
                let value = f64::from(value);
                prop_assert!(value > least - 1e-4 && value < most + 1e-4, "{route:?} {origin}: {value} of {least} to {most}");
            }
        }
    }
}

proptest! {
    #![proptest_config(config("light_threads"))]
    #[test]
    fn light_has_the_same_bytes_for_any_number_of_threads(drawn in extreme_gaussians(40), light in light()) {
        let gaussians = parameters(&model(), &drawn).gaussians;
        for route in ROUTES {
            let bits = || {
                let (traced, gradients) = traced(&gaussians, &light, route);
                let all = traced.values.iter().chain(gradients.groups.iter().flat_map(|g| &g.values));
                all.map(|v| v.to_bits()).collect::<Vec<_>>()
            };
            let (one, two) = with_one_and_two_threads(bits);
            prop_assert_eq!(one, two);
        }
    }
}

/// A level sheet of overlapping discs, `sigma` wide, on the plane through the origin with this normal.
fn sheet(side: i32, sigma: f32, thickness: f32, normal: Vec3) -> Table {
    use heliosplat::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, core_groups, logit};
    let turn = glam::Quat::from_rotation_arc(Vec3::Z, normal);
    let mut table = Table::zeros(core_groups(), (side * side) as usize);
    for i in 0..table.count {
        let place = Vec3::new(
            (i as i32 % side - side / 2) as f32,
            (i as i32 / side - side / 2) as f32,
            0.0,
        ) * (sigma * 1.2);
        table.group_mut(POSITION)[i * 3..i * 3 + 3].copy_from_slice(&(turn * place).to_array());
        let scales = [sigma.ln(), sigma.ln(), (sigma * thickness).ln()];
        table.group_mut(LOG_SCALE)[i * 3..i * 3 + 3].copy_from_slice(&scales);
        table.group_mut(ROTATION)[i * 4..i * 4 + 4].copy_from_slice(&turn.to_array());
        table.group_mut(OPACITY)[i] = logit(0.97);
    }
    table
}

#[test]
fn a_lit_plane_is_lit_at_every_degree_and_every_size() {
    for sigma in [1e-4f32, 1e-3, 0.01, 0.1, 1.0, 10.0, 100.0, 1e4] {
        for thickness in [1e-3, 0.03, 0.1, 0.3] {
            let table = sheet(15, sigma, thickness, Vec3::Z);
            for elevation in 1..=90 {
                let light = Light::Directional(direction(elevation as f32, 37.0 * elevation as f32));
                for route in ROUTES {
                    let (traced, _) = traced(&table, &light, route);
                    let least = traced.values.iter().copied().fold(1.0, f32::min);
                    assert!(
                        least >= 0.99,
                        "{route:?}, {elevation} degrees, {sigma} m, {thickness}: {least}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_slope_under_a_grazing_sun_is_lit_too() {
    for tilt in [10.0f32, 35.0, 60.0] {
        let normal = direction(90.0 - tilt, 120.0);
        let table = sheet(15, 0.4, 0.1, normal);
        for above in [1.0f32, 3.0, 10.0, 45.0] {
            // As high above the slope as that, along its line of fall.
            let down = (normal * normal.z - Vec3::Z).normalize();
            let light = Light::Directional(normal * above.to_radians().sin() + down * above.to_radians().cos());
            let (traced, _) = traced(&table, &light, SunVisibility::Plane);
            let least = traced.values.iter().copied().fold(1.0, f32::min);
            assert!(least >= 0.99, "tilt {tilt}, {above} degrees above it: {least}");
        }
    }
}

/// Position on the ground at which the shadow of a wall `height` tall along x = 0 ends, the sun in the west: where half
/// of the light returns, along a line of ground discs.
fn shadow_length_m(height: f32, elevation_deg: f32) -> f64 {
    use heliosplat::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, core_groups, logit};
    let expected = height / elevation_deg.to_radians().tan();
    // The wall: upright discs whose tops end at its height, much finer than its shadow is long.
    let size = height * 0.01;
    let (across, up) = (9, (height / size) as usize);
    let ground = 400;
    let mut table = Table::zeros(core_groups(), across * up + ground);
    let mut put = |i: usize, at: Vec3, scales: [f32; 3]| {
        table.group_mut(POSITION)[i * 3..i * 3 + 3].copy_from_slice(&at.to_array());
        table.group_mut(LOG_SCALE)[i * 3..i * 3 + 3].copy_from_slice(&scales.map(f32::ln));
        table.group_mut(ROTATION)[i * 4 + 3] = 1.0;
        table.group_mut(OPACITY)[i] = logit(0.98);
    };
    for i in 0..across * up {
        let (y, z) = ((i % across) as f32 - (across / 2) as f32, (i / across) as f32 + 0.5);
        put(
            i,
            Vec3::new(0.0, y * size, z * size),
            [0.05 * size, 0.6 * size, 0.6 * size],
        );
    }
    let near = 0.97 * expected;
    let step = 0.06 * expected / ground as f32;
    for k in 0..ground {
        let at = Vec3::new(near + step * k as f32, 0.0, 0.0);
        put(across * up + k, at, [0.3 * size, 0.3 * size, 0.01 * size]);
    }
    let light = Light::Directional(direction(elevation_deg, 270.0));
    let (traced, _) = traced(&table, &light, SunVisibility::Plane);
    let lit = traced.values[across * up..]
        .iter()
        .position(|&s| s > 0.5)
        .expect("the shadow ends");
    f64::from(near) + f64::from(step) * lit as f64
}

#[test]
fn the_shadow_of_a_wall_is_as_long_as_trigonometry_says() {
    for height in [0.5f32, 3.0, 12.0, 150.0] {
        for elevation in [3.0f32, 4.0, 6.0, 10.0, 20.0, 35.0, 50.0, 70.0] {
            let expected = f64::from(height) / f64::from(elevation).to_radians().tan();
            let found = shadow_length_m(height, elevation);
            let error = found / expected - 1.0;
            println!(
                "height {height} m, sun {elevation} degrees: {found:.3} m, {:.2} %",
                100.0 * error
            );
            assert!(
                error.abs() < 0.01,
                "height {height}, elevation {elevation}: {found} against {expected}"
            );
        }
    }
}
