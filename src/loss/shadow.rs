//! Losses on light: visibilities agree with a prior, and surfaces visible from the light are lit.

use crate::camera::ProjectiveCamera;
use crate::gaussians::Table;
use crate::light::Light;
use crate::splat::{MapGradients, Projected, ProjectionOptions, Rasteriser, project::project_backward};
use crate::trace::{OccluderGradients, Occluders, transmittance};

/// Visibilities are clamped to `[CLAMP, 1 - CLAMP]` in the cross entropy, so that it and its gradient are bounded.
const CLAMP: f32 = 0.02;

/// Mean binary cross entropy (nats) between a visibility map and a prior `lit` from 0 to 1, NaN where unknown, over the
/// pixels where `mask` is positive. Adds `weight` times its gradient to `d_visibility`.
///
/// The shadow prior of ShadowGS (Luo et al. 2026, eq. 17, whose arguments are printed the other way round). It helps
/// only with few views: with many, the images determine shadows better than their darkness does.
pub fn prior(visibility: &[f32], lit: &[f32], mask: &[f32], weight: f32, d_visibility: &mut [f32]) -> f64 {
    let counts = |lit: f32, mask: f32| mask > 0.0 && !lit.is_nan();
    let count = lit.iter().zip(mask).filter(|&(&l, &m)| counts(l, m)).count().max(1) as f32;
    let mut total = 0.0f64;
    for (((&s, &l), &m), d) in visibility.iter().zip(lit).zip(mask).zip(d_visibility) {
        if !counts(l, m) {
            continue;
        }
        let c = s.clamp(CLAMP, 1.0 - CLAMP);
        total -= f64::from(l * c.ln() + (1.0 - l) * (1.0 - c).ln());
        // A clamped visibility keeps its gradient, so that a wrong one can recover.
        *d += weight / count * (c - l) / (c * (1.0 - c));
    }
    total / f64::from(count)
}

/// Inputs and settings of [`consistency`].
pub struct ConsistencyPass<'a> {
    /// Camera of the view.
    pub camera: &'a ProjectiveCamera,
    /// Options of the projection of Gaussians to splats.
    pub projection: &'a ProjectionOptions,
    /// Gradients of light that reach the occluders.
    pub occluder_gradients: OccluderGradients,
    /// Occluders of the light.
    pub occluders: &'a Occluders,
    /// Weight of the loss.
    pub weight: f32,
}

/// Mean of `alpha - Σ w S` over the pixels, with the light moved onto the view: a light at the camera reaches
/// everything that the camera sees. Adds `weight` times its gradient to `out`. ShadowGS (eq. 16) has `1 - Σ w S`, which
/// also rewards opacity; raising opacity loses the gain of the other half (docs/lab/shadows.md).
///
/// With a nadir camera this is the paper's second form, with light and view at the zenith.
pub fn consistency(gaussians: &Table, projected: &Projected, pass: &ConsistencyPass, out: &mut Table) -> f64 {
    let light = Light::Directional(-pass.camera.depth_axis);
    let traced = transmittance(pass.occluders, &projected.gaussian, &light);
    let rasteriser = Rasteriser::new(projected, pass.camera.width, pass.camera.height);
    let maps = rasteriser.forward(&traced.values, 1);
    let pixels = pass.camera.width * pass.camera.height;
    // Pixels without a surface have no light: the shadow is alpha - Σ w S.
    let shadow: f64 = maps
        .alpha
        .iter()
        .zip(&maps.channels[0])
        .map(|(a, s)| f64::from(a - s))
        .sum::<f64>()
        / pixels as f64;
    let mut d_maps = MapGradients::zeros(1, pixels);
    let unit = pass.weight / pixels as f32;
    d_maps.alpha.fill(unit);
    d_maps.channels[0].fill(-unit);
    let back = rasteriser.backward(&traced.values, 1, &maps, &d_maps);
    project_backward(gaussians, pass.camera, pass.projection, projected, &back.splats, out);
    let occluders = (pass.occluders, pass.occluder_gradients);
    traced.backward(gaussians, occluders, &projected.gaussian, &back.features, out);
    shadow
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, core_groups, logit};
    use glam::Vec3;

    /// Level discs of these centres, standard deviations (metres) and opacities.
    fn discs(discs: &[(Vec3, f32, f32)]) -> Table {
        let mut table = Table::zeros(core_groups(), discs.len());
        for (g, &(centre, sigma_m, opacity)) in discs.iter().enumerate() {
            table.group_mut(POSITION)[3 * g..3 * g + 3].copy_from_slice(&centre.to_array());
            let scales = [sigma_m, sigma_m, 0.05 * sigma_m].map(f32::ln);
            table.group_mut(LOG_SCALE)[3 * g..3 * g + 3].copy_from_slice(&scales);
            table.group_mut(ROTATION)[4 * g..4 * g + 4].copy_from_slice(&[1.0, 0.02, -0.03, 0.0]);
            table.group_mut(OPACITY)[g] = logit(opacity);
        }
        table
    }

    /// Consistency from straight above, over square pixels of half a metre around the origin, and its gradients.
    fn from_above(gaussians: &Table, side_px: usize) -> (f64, Table) {
        let first_m = -0.25 * (side_px as f64 - 1.0);
        let camera = ProjectiveCamera::nadir(first_m, -first_m, 0.5, (side_px, side_px));
        let projection = ProjectionOptions::default();
        let projected = crate::splat::project::project(gaussians, &camera, &projection);
        let pass = ConsistencyPass {
            camera: &camera,
            projection: &projection,
            occluder_gradients: OccluderGradients::All,
            occluders: &Occluders::new(gaussians),
            weight: 1.0,
        };
        let mut gradients = gaussians.zeros_like();
        let value = consistency(gaussians, &projected, &pass, &mut gradients);
        (value, gradients)
    }

    #[test]
    fn consistency_is_what_is_seen_in_the_shadow_of_something() {
        let (upper, lower) = (Vec3::new(0.0, 0.0, 2.0), Vec3::ZERO);
        // The upper disc is lit. A fifth of the view passes through it; the lower disc covers seven tenths of that
        // fifth, and a fifth of the light reaches the lower disc.
        let (value, gradients) = from_above(&discs(&[(upper, 20.0, 0.8), (lower, 20.0, 0.7)]), 1);
        let expected = 0.2 * 0.7 * (1.0 - 0.2);
        assert!((value - expected).abs() < 2e-3, "{value} for {expected}");
        // Gradient descent makes the upper disc more opaque, which hides the shaded one, and the lower disc more
        // transparent.
        let d_opacity = gradients.group(OPACITY);
        assert!(d_opacity[0] < 0.0 && d_opacity[1] > 0.0, "{d_opacity:?}");
        // One surface alone has no shadow, however transparent.
        let (value, _) = from_above(&discs(&[(lower, 20.0, 0.3)]), 1);
        assert!(value.abs() < 1e-6, "{value}");
    }

    #[test]
    fn gradients_of_consistency_are_those_of_its_value() {
        let start = discs(&[
            (Vec3::new(0.1, -0.2, 3.0), 1.1, 0.75),
            (Vec3::new(0.6, 0.3, 1.5), 1.6, 0.7),
            (Vec3::new(-0.4, 0.2, 0.0), 3.5, 0.9),
        ]);
        let (_, gradients) = from_above(&start, 6);
        for group in [POSITION, LOG_SCALE, OPACITY] {
            let slope: f64 = gradients.group(group).iter().map(|&d| f64::from(d).powi(2)).sum();
            let step = 0.02 / slope.sqrt().max(1e-12);
            let moved = |by: f64| {
                let mut table = start.clone();
                let along = table.group_mut(group).iter_mut().zip(gradients.group(group));
                along.for_each(|(value, d)| *value += (by * f64::from(*d)) as f32);
                from_above(&table, 6).0
            };
            let found = (moved(step) - moved(-step)) / (2.0 * step);
            assert!(
                slope > 0.0 && (found / slope - 1.0).abs() < 0.02,
                "group {group}: {found} against {slope}"
            );
        }
    }

    #[test]
    fn a_prior_pulls_visibility_to_what_is_thought_and_says_nothing_elsewhere() {
        let (visibility, lit) = ([0.3f32, 0.7, 0.5, 0.2], [1.0, 0.0, f32::NAN, 0.2]);
        let mut d = [0.0; 4];
        let value = prior(&visibility, &lit, &[1.0; 4], 1.0, &mut d);
        // Nats: visibility 0.3 with prior 1, 0.7 with prior 0, 0.2 with prior 0.2.
        let expected = -(2.0 * 0.3f64.ln() + 0.2 * 0.2f64.ln() + 0.8 * 0.8f64.ln()) / 3.0;
        assert!((value - expected).abs() < 1e-6, "{value} for {expected}");
        assert!(d[0] < 0.0 && d[1] > 0.0 && d[2] == 0.0 && d[3].abs() < 1e-6);
        let step = 1e-3;
        let moved = |by: f32| prior(&[0.3 + by, 0.7, 0.5, 0.2], &lit, &[1.0; 4], 1.0, &mut [0.0; 4]);
        let slope = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
        assert!(
            (slope - f64::from(d[0])).abs() < 1e-3 * slope.abs(),
            "{slope} against {}",
            d[0]
        );
        assert_eq!(prior(&visibility, &lit, &[0.0; 4], 1.0, &mut d), 0.0);
    }
}
