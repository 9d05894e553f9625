//! Losses on what light reaches: shadows are hard, and what is seen from the light is lit.

use crate::camera::ProjectiveCamera;
use crate::gaussians::Table;
use crate::light::Light;
use crate::splat::{MapGradients, Projected, ProjectionOptions, Rasteriser, project::project_backward};
use crate::trace::{Occluders, transmittance};

/// Visibilities outside `[CLAMP, 1 - CLAMP]` are settled: no gradient.
const CLAMP: f32 = 0.02;

/// Mean binary entropy (bits) of a visibility map; adds `weight` times its gradient to `d_visibility`.
///
/// Pushes shadows to be either there or not (ShadowGS eq. 18, EOGS's opaqueness).
pub fn opaqueness(visibility: &[f32], mask: &[f32], weight: f32, d_visibility: &mut [f32]) -> f64 {
    let count = mask.iter().filter(|&&m| m > 0.0).count().max(1) as f32;
    let mut total = 0.0f64;
    for ((&s, &m), d) in visibility.iter().zip(mask).zip(d_visibility) {
        if m <= 0.0 {
            continue;
        }
        let c = s.clamp(CLAMP, 1.0 - CLAMP);
        total += f64::from(-(c * c.log2() + (1.0 - c) * (1.0 - c).log2()));
        if s > CLAMP && s < 1.0 - CLAMP {
            *d += weight / count * ((1.0 - s) / s).log2();
        }
    }
    total / f64::from(count)
}

/// Mean binary cross entropy (nats) between a visibility map and what is thought to be lit, `lit` from 0 to 1, NaN where nothing is
/// thought; adds `weight` times its gradient to `d_visibility`.
///
/// The shadow prior of ShadowGS (Luo et al. 2026, eq. 17, whose arguments are printed the other way round): only with few views do
/// images say less of shadows than their darkness does.
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
        // What is clamped still hears that it is on the wrong side.
        *d += weight / count * (c - l) / (c * (1.0 - c));
    }
    total / f64::from(count)
}

/// What a pass of [`consistency`] needs besides the Gaussians.
pub struct ConsistencyPass<'a> {
    /// The view.
    pub camera: &'a ProjectiveCamera,
    /// How Gaussians become splats.
    pub projection: &'a ProjectionOptions,
    /// Whether gradients of light reach what stands in its way.
    pub occluder_gradients: bool,
    /// The occluders.
    pub occluders: &'a Occluders,
    /// Weight of the loss.
    pub weight: f32,
}

/// Mean of `1 - S` with the light moved onto the view (ShadowGS eq. 16): whatever the camera sees, a light at the camera
/// reaches. Adds `weight` times its gradient to `out`.
///
/// With a nadir camera this is the paper's second form, light and view both at the zenith.
pub fn consistency(gaussians: &Table, projected: &Projected, pass: &ConsistencyPass, out: &mut Table) -> f64 {
    let light = Light::Directional(-pass.camera.depth_axis);
    let traced = transmittance(pass.occluders, &projected.gaussian, &light);
    let rasteriser = Rasteriser::new(projected, pass.camera.width, pass.camera.height);
    let maps = rasteriser.forward(&traced.values, 1);
    let pixels = pass.camera.width * pass.camera.height;
    // Where nothing is seen there is nothing to light: the shadow is alpha - Σ w S.
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
    if pass.occluder_gradients {
        traced.backward(gaussians, pass.occluders, &projected.gaussian, &back.features, out);
    } else {
        traced.backward_to_origins(gaussians, &projected.gaussian, &back.features, out);
    }
    shadow
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prior_pulls_visibility_to_what_is_thought_and_says_nothing_elsewhere() {
        let (visibility, lit) = ([0.3f32, 0.7, 0.5, 0.2], [1.0, 0.0, f32::NAN, 0.2]);
        let mut d = [0.0; 4];
        let value = prior(&visibility, &lit, &[1.0; 4], 1.0, &mut d);
        assert!(value > 0.0);
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

    #[test]
    fn entropy_is_least_where_shadows_are_settled_and_points_away_from_doubt() {
        let mask = [1.0; 4];
        let mut d = [0.0; 4];
        let value = opaqueness(&[0.001, 0.3, 0.7, 0.999], &mask, 1.0, &mut d);
        assert!(value > 0.0 && value < 1.0);
        // The gradient raises the loss toward one half: descending moves 0.3 down and 0.7 up.
        assert!(d[1] > 0.0 && d[2] < 0.0);
        assert_eq!((d[0], d[3]), (0.0, 0.0));
    }
}
