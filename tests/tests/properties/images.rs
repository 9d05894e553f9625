//! Losses on degenerate images and maps: even ones, one saturated pixel, half of them missing, raw counts.

use crate::config;
use heliosplat::loss::geometry::depth_normal;
use heliosplat::loss::photometric::photometric;
use heliosplat::splat::{MapGradients, Maps};
use heliosplat::{ProjectiveCamera, Raster};
use proptest::collection::vec;
use proptest::prelude::*;

/// An image: even, noise, noise with one saturated pixel, half of it missing, raw 16-bit counts, infinities among the
/// pixels.
fn image(width: usize, height: usize) -> impl Strategy<Value = Raster> {
    let count = width * height;
    let noise = move || vec(0.0f32..1.0, count);
    let values = prop_oneof![
        prop_oneof![Just(0.0f32), Just(1.0), 0.0f32..3.0, Just(131.0), Just(65_535.0)]
            .prop_map(move |v| vec![v; count]),
        noise(),
        (noise(), 0..count, prop_oneof![Just(65_535.0f32), Just(300.0)]).prop_map(|(mut v, at, most)| {
            v[at] = most;
            v
        }),
        noise().prop_map(move |mut v| {
            v[..count / 2].fill(f32::NAN);
            v
        }),
        noise().prop_map(|v| v.iter().map(|x| (x * 65_535.0).round()).collect()),
        (noise(), 0..count, 0..count).prop_map(|(mut v, a, b)| {
            v[a] = f32::INFINITY;
            v[b] = f32::NEG_INFINITY;
            v
        }),
    ];
    values.prop_map(move |values| Raster {
        width,
        height,
        bands: 1,
        values,
    })
}

fn pair() -> impl Strategy<Value = (Raster, Raster, Vec<f32>)> {
    let sizes = prop_oneof![4 => (1..24usize, 1..24usize), 1 => Just((1, 1)), 1 => Just((400, 1)), 1 => Just((1, 400))];
    sizes.prop_flat_map(|(w, h)| {
        let rendered = image(w, h).prop_map(|mut r| {
            r.values.iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = 0.4);
            r
        });
        (
            rendered,
            image(w, h),
            vec(prop_oneof![3 => Just(1.0f32), 1 => Just(0.0)], w * h),
        )
    })
}

proptest! {
    #![proptest_config(config("photometric"))]
    #[test]
    fn the_photometric_loss_is_finite_and_never_below_zero((rendered, truth, weight) in pair(), lambda in 0.0f32..1.0) {
        let (value, gradient) = photometric(&rendered, &truth, &weight, lambda);
        let largest = rendered.values.iter().chain(&truth.values).filter(|v| v.is_finite()).fold(1.0f32, |a, &b| a.max(b.abs()));
        prop_assert!(value.is_finite() && value >= -1e-4, "{value}");
        // The difference, and a structural part of two at most.
        prop_assert!(value <= 2.0 * f64::from(largest * (1.0 - lambda)) + 2.01, "{value} of values up to {largest}");
        let steepest = gradient.values.iter().fold(0.0f32, |a, &b| a.max(b.abs()));
        // The structural part is steepest where its variance is least, 2 / C2, over a window's brightness.
        prop_assert!(steepest.is_finite() && steepest <= 1e4 * (largest + 1.0), "{steepest} at values up to {largest}");
        for i in (0..weight.len()).filter(|&i| weight[i] == 0.0 || !truth.values[i].is_finite()) {
            prop_assert_eq!(gradient.values[i], 0.0);
        }
    }
}

proptest! {
    #![proptest_config(config("map_losses"))]
    #[test]
    fn losses_on_maps_are_finite(
        (width, height) in (1..12usize, 1..12usize),
        values in vec((0.0f32..=1.0, -5000.0f32..5000.0, -1.0f32..1.0), 144),
        gsd in prop_oneof![Just(1e-3f32), Just(0.3), Just(30.0)], hidden in any::<bool>(),
    ) {
        let pixels = width * height;
        let alpha: Vec<f32> = values[..pixels].iter().map(|v| if hidden && v.0 < 0.3 { 0.0 } else { v.0 }).collect();
        let depth: Vec<f32> = alpha.iter().zip(&values).map(|(a, v)| a * v.1).collect();
        let maps = Maps {
            width,
            height,
            channels: (0..3).map(|_| values[..pixels].iter().map(|v| v.2).collect()).collect(),
            alpha,
            depth,
            ..Maps::default()
        };
        let camera = ProjectiveCamera::nadir(0.0, 0.0, f64::from(gsd), (width, height));
        let mut grads = MapGradients::zeros(3, pixels);
        let normal = depth_normal(&camera, &maps, 0, 3.0 * gsd, 1.0, &mut grads);
        // Normals that are drawn are up to sqrt(3) long.
        prop_assert!((-0.8..=2.8).contains(&normal), "{normal}");
        let all = [&grads.alpha, &grads.depth].into_iter().chain(&grads.channels);
        for plane in all {
            prop_assert!(plane.iter().all(|g| g.is_finite()), "{plane:?}");
        }
    }
}
