//! Light on surfaces of any roughness and medium; models of objects at the extremes, lamps among them.

use crate::config;
use crate::draw::{Drawn, extreme_gaussians, gaussians, looks, small_image, sun};
use glam::{DVec3, Vec3};
use heliosplat::Raster;
use heliosplat::gaussians::{FEATURES, POSITION, Table};
use heliosplat::light::Light;
use heliosplat::model::olat::{Olat, OlatOptions};
use heliosplat::model::radiance::{Radiance, RadianceOptions};
use heliosplat::model::reflective::{Reflective, ReflectiveOptions};
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::{Lit, Pass, PassOptions};
use heliosplat::shade::asg::Lobe;
use heliosplat::shade::dipole::Medium;
use heliosplat::shade::falloff::falloff;
use heliosplat::shade::{display, ggx, split_sum};
use heliosplat::trace::Occluders;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::f64::consts::PI;

/// From a ten-thousandth to one, evenly in its logarithm, and both ends.
fn roughness() -> impl Strategy<Value = f32> {
    prop_oneof![4 => (-4.0f32..0.0).prop_map(|e| 10f32.powf(e)), 1 => Just(1e-4f32), 1 => Just(1.0)]
}

/// A direction above a surface, to a hair above it and to its normal.
fn above() -> impl Strategy<Value = Vec3> {
    let height = prop_oneof![3 => 0.0f32..1.0, 1 => (-30.0f32..0.0).prop_map(|e| 10f32.powf(e)), 1 => Just(1.0f32)];
    (height, 0.0f32..6.3).prop_map(|(z, azimuth)| {
        let across = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(across * azimuth.cos(), across * azimuth.sin(), z)
    })
}

/// Zero, tiny, ordinary, huge or infinite.
fn coefficient() -> impl Strategy<Value = f32> {
    prop_oneof![
        3 => (-6.0f32..6.0).prop_map(|e| 10f32.powf(e)),
        1 => Just(0.0f32),
        1 => Just(f32::INFINITY),
        1 => prop::num::f32::POSITIVE | prop::num::f32::SUBNORMAL,
    ]
}

/// `D G / (4 (n·v))` in f64, as the textbook has it.
fn textbook(light: Vec3, eye: Vec3, alpha: [f32; 2]) -> f64 {
    let (l, v) = (light.as_dvec3(), eye.as_dvec3());
    let half = (l + v).normalize();
    let [x, y] = alpha.map(f64::from);
    let sum = (half.x / x).powi(2) + (half.y / y).powi(2) + half.z.powi(2);
    let masking = |w: DVec3| 2.0 * w.z / (w.z + DVec3::new(x * w.x, y * w.y, w.z).length());
    masking(l) * masking(v) / (PI * x * y * sum * sum) / (4.0 * v.z)
}

proptest! {
    #![proptest_config(config("microfacets"))]
    #[test]
    fn microfacets_are_finite_bounded_and_those_of_the_textbook(
        light in above(), eye in above(), mirrored in any::<bool>(), a in roughness(), b in roughness(),
    ) {
        // Half of the cases look where a mirror would send the light.
        let eye = if mirrored { Vec3::new(-light.x, -light.y, light.z) } else { eye };
        let alpha = [a, b];
        let found = f64::from(ggx::reflected(light, eye, alpha));
        let narrow = f64::from(a.min(b));
        prop_assert!(found >= 0.0 && found <= 0.5 / (PI * f64::from(a) * f64::from(b) * narrow), "{found}");
        let (masked, f0) = (ggx::masking(eye, alpha), ggx::schlick(0.04, light.dot(eye)));
        prop_assert!((0.0..=1.0001).contains(&masked) && (0.0399..=1.0).contains(&f0), "{masked} {f0}");
        if light.z > 1e-15 && eye.z > 1e-15 {
            let exact = textbook(light, eye, alpha);
            // The half vector is known to rounding only, and the narrower the lobe the more that is.
            let unsure = 1e-5 + 2e-6 / narrow;
            prop_assert!((found - exact).abs() <= unsure * exact + 1e-30, "{found} {exact}");
        }
    }

    #[test]
    fn split_sums_never_reflect_more_than_arrives(rough in roughness(), cosine in prop_oneof![0.0f32..=1.0, Just(0.0), Just(1e-12)]) {
        let found = split_sum::look_up(rough, cosine);
        let [first, second] = found.values;
        prop_assert!(first >= 0.0 && second >= 0.0 && first + second <= 1.0 + 2e-3, "{found:?}");
        prop_assert!(found.roughness.iter().chain(&found.cosine).all(|d| d.is_finite()), "{found:?}");
    }

    #[test]
    fn lobes_are_finite_from_the_axis_to_its_opposite(
        v in above(), below in any::<bool>(), lambda in roughness(), mu in roughness(), sigma in roughness(),
    ) {
        let v = if below { Vec3::new(v.x, v.y, -v.z) } else { v };
        let lobe = Lobe { lambda: 10.0 * lambda, mu: 10.0 * mu, sigma };
        let found = lobe.value_and_gradients(v);
        prop_assert!(found.value >= 0.0 && found.value <= 0.33 / sigma, "{found:?}");
        prop_assert!(found.direction.is_finite() && found.shape.iter().all(|d| d.is_finite()), "{found:?}");
    }

    #[test]
    fn what_scatters_is_finite_in_any_medium_and_falls_with_the_distance(
        scattering in coefficient(), absorption in coefficient(), r in prop_oneof![Just(0.0f32), (-6.0f32..6.0).prop_map(|e| 10f32.powf(e))],
    ) {
        let medium = Medium { scattering, absorption };
        let (near, far) = (medium.profile(r), medium.profile(2.0 * r));
        prop_assert!(near.value >= 0.0 && near.value >= far.value * (1.0 - 1e-5), "{near:?} {far:?}");
        for number in [near.value, near.distance, near.scattering, near.absorption] {
            prop_assert!(number.is_finite(), "{near:?}");
        }
        if scattering == 0.0 {
            prop_assert_eq!(near.value, 0.0);
        }
    }

    #[test]
    fn lamps_and_displays_are_finite_and_monotone(light in prop_oneof![Just(0.0f32), (-30.0f32..30.0).prop_map(|e| 10f32.powf(e))], radius in 0.0f32..1.0) {
        let ((told, slope), (more, _)) = (display::encode(light), display::encode(light * 1.1));
        prop_assert!(told >= 0.0 && more >= told && slope > 0.0 && slope <= 12.921, "{told} {more} {slope}");
        let ((value, slope), (less, _)) = (falloff(light, 2.0, radius), falloff(light * 1.1, 2.0, radius));
        prop_assert!((0.0..=1.0001e6).contains(&value) && less <= value && slope <= 0.0 && slope.is_finite(), "{value} {less} {slope}");
    }
}

/// Position of the light of an object.
#[derive(Debug, Clone, Copy)]
enum Lamp {
    /// Parallel light.
    Far(Vec3),
    /// A lamp anywhere, also among the Gaussians.
    At(Vec3),
    /// In the very centre of the first Gaussian.
    InTheFirst,
    /// At the camera.
    InTheEye,
    /// None.
    Off,
}

fn lamp() -> impl Strategy<Value = Lamp> {
    prop_oneof![
        2 => sun().prop_map(Lamp::Far),
        3 => prop::array::uniform3(-20.0f32..20.0).prop_map(|p| Lamp::At(Vec3::from(p))),
        2 => Just(Lamp::InTheFirst),
        1 => Just(Lamp::InTheEye),
        1 => Just(Lamp::Off),
    ]
}

/// Values before their sigmoids and softpluses: ordinary ones, and one in `rare` as far as saturation.
fn fill(table: &mut Table, from: usize, random: &mut Pcg32, rare: u32) {
    for group in &mut table.groups[from..] {
        for value in &mut group.values {
            let ordinary = 6.0 * random.random::<f32>() - 3.0;
            let saturated = [-90.0, -20.0, 0.0, 20.0][random.random_range(0..4)];
            *value = if random.random_range(0..rare) == 0 {
                saturated
            } else {
                ordinary
            };
        }
    }
}

fn model(kind: usize, half: bool) -> (Box<dyn SceneModel>, Table) {
    match kind {
        0 => (Box::new(Radiance::new(RadianceOptions::default())), Table::default()),
        1 => {
            let model = Reflective::new(ReflectiveOptions {
                width: 8,
                hidden: 2,
                display: half,
                coverage: true,
                normal_weight: 0.1,
                ..ReflectiveOptions::default()
            });
            let globals = model.initial_globals(1);
            (Box::new(model), globals)
        }
        _ => {
            let model = Olat::new(OlatOptions {
                specular: kind == 3 || half,
                scattering: kind == 3,
                refined: kind == 3,
                width: 8,
                hidden: 2,
                coverage: true,
                distance: 3.0,
                radius: if half { 0.0 } else { 0.3 },
                ..OlatOptions::default()
            });
            let globals = model.initial_globals();
            (Box::new(model), globals)
        }
    }
}

proptest! {
    #![proptest_config(config("objects"))]
    #[test]
    fn models_of_objects_are_finite_and_never_darker_than_black(
        drawn in extreme_gaussians(16), looks in looks(small_image()), lamp in lamp(), kind in 0..4usize, half in any::<bool>(), seed in any::<u64>(),
    ) {
        objects(&drawn, looks.camera(), lamp, (kind, half, seed))?;
    }
}

fn objects(
    drawn: &[Drawn],
    camera: heliosplat::ProjectiveCamera,
    lamp: Lamp,
    (kind, half, seed): (usize, bool, u64),
) -> Result<(), TestCaseError> {
    let (model, mut globals) = model(kind, half);
    let mut random = Pcg32::seed_from_u64(seed);
    let mut gaussians = gaussians(model.feature_groups(), drawn);
    fill(&mut gaussians, FEATURES, &mut random, 8);
    // Networks and surroundings stay near their initial values; lobes take extreme ones.
    for group in &mut globals.groups {
        let lobes = group.spec.name.starts_with("lobe");
        for value in &mut group.values {
            let far = lobes && random.random_range(0..8) == 0;
            *value += if far { -90.0 } else { random.random::<f32>() - 0.5 };
        }
    }
    let first = gaussians.group(POSITION).get(..3).map_or(Vec3::ZERO, Vec3::from_slice);
    let light = match lamp {
        Lamp::Far(direction) => Some(Light::Directional(direction)),
        Lamp::At(place) => Some(Light::Point(place)),
        Lamp::InTheFirst => Some(Light::Point(first)),
        Lamp::InTheEye => Some(Light::Point(camera.eye().unwrap_or(Vec3::ZERO))),
        Lamp::Off => None,
    };
    let parameters = Parameters { gaussians, globals };
    let occluders = Occluders::new(&parameters.gaussians);
    let context = Context {
        parameters: &parameters,
        camera: &camera,
        light,
        appearance: None,
    };
    let lit = match light {
        Some(_) => Lit::Traced(&occluders),
        None => Lit::Everywhere,
    };
    let pass = Pass::new(&*model, context, lit, PassOptions::default());
    let image = pass.image();
    prop_assert!(
        image.values.iter().all(|v| *v >= 0.0 && v.is_finite()),
        "{:?}",
        image.values
    );
    let (mut d_maps, mut gradients) = (pass.zero_gradients(), parameters.zeros_like());
    let signs = (0..image.values.len()).map(|i| if i % 3 == 0 { -1.0 } else { 1.0 });
    let d_image = Raster {
        values: signs.collect(),
        ..image
    };
    model.compose_backward(&context, &pass.maps, &d_image, &mut d_maps, &mut gradients);
    for (name, value) in model.map_losses(&context, &pass.maps, &mut d_maps) {
        prop_assert!(value.is_finite(), "{name} {value}");
    }
    pass.backward(d_maps, &mut gradients);
    for group in gradients.gaussians.groups.iter().chain(&gradients.globals.groups) {
        prop_assert!(
            group.values.iter().all(|g| g.is_finite()),
            "{} {:?}",
            group.spec.name,
            group.values
        );
    }
    Ok(())
}
