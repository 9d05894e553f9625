//! Gaussians as a camera sees them, lit and composed, forward and backward.

use crate::config;
use crate::draw::{Drawn, extreme_gaussians, looks, model, ordinary_gaussians, parameters, reference_camera};
use crate::draw::{reference_gaussians, small_image, sun, wide, with_one_and_two_threads};
use glam::Vec3;
use heliosplat::light::Light;
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::{Lit, Pass, PassOptions};
use heliosplat::splat::{Depths, Maps, ProjectionOptions};
use heliosplat::trace::{OccluderGradients, Occluders};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_tests::reference;
use proptest::prelude::*;

const OPTIONS: PassOptions = PassOptions {
    projection: ProjectionOptions {
        filter_px2: 0.1,
        antialias: true,
    },
    occluder_gradients: OccluderGradients::All,
    normals: true,
    depths: Depths::Median,
};

struct Seen {
    maps: Maps,
    image: Raster,
    gradients: Parameters,
    /// Gaussians that could not be projected.
    non_finite: usize,
}

fn look(drawn: &[Drawn], camera: &ProjectiveCamera, sun: Vec3) -> Seen {
    let model = model();
    let parameters = parameters(&model, drawn);
    let occluders = Occluders::new(&parameters.gaussians);
    let context = Context {
        parameters: &parameters,
        camera,
        light: Some(Light::Directional(sun)),
        appearance: Some(1),
    };
    let pass = Pass::new(&model, context, Lit::Traced(&occluders), OPTIONS);
    let image = pass.image();
    let (mut d_maps, mut d_image) = (pass.zero_gradients(), image.clone());
    let sign = |i: usize| if i.is_multiple_of(3) { -1.0 } else { 1.0 };
    for (i, d) in d_image.values.iter_mut().enumerate() {
        *d = sign(i);
        d_maps.alpha[i] = -sign(i + 1);
        d_maps.depth[i] = 0.1 * sign(i + 2);
    }
    let mut gradients = parameters.zeros_like();
    model.compose_backward(&context, &pass.maps, &d_image, &mut d_maps, &mut gradients);
    let (non_finite, maps) = (pass.projected.non_finite, pass.maps.clone());
    pass.backward(d_maps, &mut gradients);
    Seen {
        non_finite,
        maps,
        image,
        gradients,
    }
}

/// Properties of any view: shares are shares, colours are mixed and not made, no number is lost.
fn is_physical(seen: &Seen) -> Result<(), TestCaseError> {
    let (maps, ulps) = (&seen.maps, 1.0 + 1e-4);
    for i in 0..maps.alpha.len() {
        let alpha = maps.alpha[i];
        prop_assert!((0.0..=1.0).contains(&alpha), "alpha {alpha}");
        for (name, channel) in [("albedo", 0), ("visibility", 1)] {
            let value = maps.channels[channel][i];
            prop_assert!(
                value >= 0.0 && value <= alpha * ulps + 1e-6,
                "{name} {value} of alpha {alpha}"
            );
        }
        let normal = Vec3::new(maps.channels[2][i], maps.channels[3][i], maps.channels[4][i]);
        prop_assert!(
            normal.length() <= alpha * ulps + 1e-6,
            "normal {normal} of alpha {alpha}"
        );
        prop_assert!(
            maps.depth[i].is_finite() && maps.depth_square[i] >= 0.0,
            "depth {}",
            maps.depth[i]
        );
        prop_assert!(
            maps.median_depth[i].is_finite() || alpha == 0.0,
            "surface of alpha {alpha}"
        );
        // At most four times the sun of level ground, and the sky.
        prop_assert!(
            (0.0..=4.0 * ulps).contains(&seen.image.values[i]),
            "{}",
            seen.image.values[i]
        );
    }
    for table in [&seen.gradients.gaussians, &seen.gradients.globals] {
        for group in &table.groups {
            prop_assert!(
                group.values.iter().all(|g| g.is_finite()),
                "{}: {:?}",
                group.spec.name,
                group.values
            );
        }
    }
    Ok(())
}

/// The sun of a case: its own, or one behind the camera.
fn sun_or_view() -> impl Strategy<Value = Option<Vec3>> {
    prop_oneof![3 => sun().prop_map(Some), 1 => Just(None)]
}

proptest! {
    #![proptest_config(config("view_bounds"))]
    #[test]
    fn views_of_the_extremes_are_physical(
        drawn in extreme_gaussians(24), looks in looks(small_image()), sun in sun_or_view(),
    ) {
        let camera = looks.camera();
        let seen = look(&drawn, &camera, sun.unwrap_or(-camera.depth_axis));
        // Nearby, a Gaussian of a thousand kilometres at a distance of a millimetre overflows.
        prop_assert!(seen.non_finite == 0 || !looks.is_in_orbit(), "{} legal Gaussians were dropped", seen.non_finite);
        is_physical(&seen)?;
    }
}

proptest! {
    #![proptest_config(config("view_strips"))]
    #[test]
    fn strips_of_twenty_thousand_pixels_are_physical(
        drawn in extreme_gaussians(12), lying in any::<bool>(), looks in looks(Just((20_000, 1))), sun in sun(),
    ) {
        let size = if lying { (20_000, 1) } else { (1, 20_000) };
        is_physical(&look(&drawn, &looks.with_size(size).camera(), sun))?;
    }
}

proptest! {
    #![proptest_config(config("view_threads"))]
    #[test]
    fn views_have_the_same_bytes_for_any_number_of_threads(
        drawn in extreme_gaussians(40), looks in looks((60..90usize, 30..60usize)), sun in sun(),
    ) {
        let camera = looks.camera();
        let bits = || {
            let seen = look(&drawn, &camera, sun);
            let tables = [seen.gradients.gaussians, seen.gradients.globals];
            let gradients = tables.iter().flat_map(|t| &t.groups).flat_map(|g| &g.values);
            let maps = seen.maps.channels.iter().flatten().chain(&seen.maps.depth).chain(&seen.maps.median_depth);
            maps.chain(&seen.image.values).chain(gradients).map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        let (one, two) = with_one_and_two_threads(bits);
        prop_assert_eq!(one, two);
    }
}

proptest! {
    #![proptest_config(config("view_reference"))]
    #[test]
    fn views_agree_with_the_reference(drawn in ordinary_gaussians(16), looks in looks((1..20usize, 1..20usize)), sun in sun()) {
        let camera = looks.camera();
        let seen = look(&drawn, &camera, sun);
        let exact = reference_gaussians(&drawn);
        if exact.is_empty() {
            prop_assert!(seen.maps.alpha.iter().all(|&a| a == 0.0));
            return Ok(());
        }
        // Light is tested separately; splats of nearly equal depth may change places.
        let visibility = vec![1.0; exact.len()];
        let mut depths: Vec<f64> = exact.iter().map(|g| wide(camera.depth_axis).dot(&g.position)).collect();
        depths.sort_by(f64::total_cmp);
        prop_assume!(depths.windows(2).all(|pair| pair[1] - pair[0] > 1e-5));
        let pixels = reference::render(&exact, &reference_camera(&camera), &visibility, 0.1, true);
        let (mut error, mut norm) = ([0.0f64; 2], [0.0f64; 2]);
        for (i, pixel) in pixels.iter().enumerate().filter(|(_, pixel)| pixel.is_stable) {
            let maps = &seen.maps;
            let pairs = [(0, maps.alpha[i], pixel.alpha), (0, maps.channels[0][i], pixel.albedo[0]), (1, maps.depth[i], pixel.depth)];
            for (of, engine, exact) in pairs {
                error[of] += (f64::from(engine) - exact).powi(2);
                norm[of] += exact.powi(2);
            }
        }
        for (name, of) in [("shares", 0), ("depths", 1)] {
            let (error, norm) = (error[of].sqrt(), norm[of].sqrt());
            prop_assert!(error <= 1e-4 * norm + 1e-5, "{name}: {error} of {norm}");
        }
    }
}

#[test]
fn a_million_gaussians_are_seen_and_lit() {
    use heliosplat::gaussians::{LOG_SCALE, OPACITY, POSITION, Table, core_groups};
    let model = model();
    let mut groups = core_groups();
    groups.extend(model.feature_groups());
    let mut gaussians = Table::zeros(groups, 1_000_000);
    let draw = |i: usize, k: usize| {
        ((i as u64 * 7919 + k as u64 * 104_729).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f32 / (1 << 24) as f32
    };
    for i in 0..gaussians.count {
        for k in 0..3 {
            let extent = if k == 2 { 20.0 } else { 500.0 };
            gaussians.group_mut(POSITION)[i * 3 + k] = (draw(i, k) - 0.5) * extent;
            gaussians.group_mut(LOG_SCALE)[i * 3 + k] = -2.0 + draw(i, 3 + k);
        }
        gaussians.group_mut(OPACITY)[i] = 12.0 * draw(i, 6) - 6.0;
    }
    let parameters = Parameters {
        gaussians,
        globals: model.initial_globals(0.3),
    };
    let camera = ProjectiveCamera::nadir(-128.0, 128.0, 1.0, (256, 256));
    let occluders = Occluders::new(&parameters.gaussians);
    let context = Context {
        parameters: &parameters,
        camera: &camera,
        light: Some(Light::Directional(Vec3::new(0.6, 0.0, 0.8))),
        appearance: None,
    };
    let pass = Pass::new(&model, context, Lit::Traced(&occluders), OPTIONS);
    assert!(pass.maps.alpha.iter().all(|a| (0.0..=1.0).contains(a)) && pass.maps.pairs > 1_000_000);
    assert!(pass.transmittances().iter().all(|s| (0.0..=1.0).contains(s)));
    let mut gradients = parameters.zeros_like();
    let mut d_maps = pass.zero_gradients();
    d_maps.alpha.fill(1.0);
    d_maps.channels[1].fill(-1.0);
    pass.backward(d_maps, &mut gradients);
    assert!(gradients.is_finite());
}
