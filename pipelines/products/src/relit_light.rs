//! Light of relit images. Each model finds air, path radiance and exposure for itself; relit images of neighbouring
//! models are brought to one light before they are merged. With the visibility `v` of the sun, a band of a relit image is
//!
//! ```text
//! value = albedo · (v + (1 - v) · shade) · ground + path
//! ```
//!
//! as `relight` composes it.

use super::model::ModelFile;
use heliosplat::gaussians::Table;
use heliosplat::model::shadow_gs::ShadowGs;
use heliosplat::model::{Parameters, SceneModel};
use heliosplat_rpc::sun::SunPosition;
use serde::{Deserialize, Serialize};

/// Albedo at or below which the visibility of the sun cannot be computed from a relit value.
const DARK: f32 = 1e-4;

/// Light of a relit image in one band.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BandLight {
    /// Sunlit level ground of albedo 1, without path radiance, counts.
    pub ground: f64,
    /// Brightness of a shadow relative to sunlit ground, 0 to 1.
    pub shade: f64,
    /// Path radiance, counts.
    pub path: f64,
}

impl BandLight {
    /// Lights of a model's image relit under `sun`, band by band; `None` for a model without daylight.
    pub fn of(file: &ModelFile, sun: &SunPosition) -> Option<Vec<Self>> {
        let daylight = file.daylight.as_ref()?;
        let model = ShadowGs::new(file.options.clone());
        let (gaussians, globals) = (Table::zeros(model.feature_groups(), 0), file.globals.clone());
        let parameters = Parameters { gaussians, globals };
        let path = model.colour(&parameters, file.options.reference).1;
        let light = |(k, path): (usize, f32)| Self {
            ground: file.counts_per_unit * daylight.gain(k, sun.elevation_rad),
            shade: daylight.shade(k, sun.elevation_rad),
            path: file.counts_per_unit * f64::from(path),
        };
        Some(path.into_iter().enumerate().map(light).collect())
    }

    /// Mean of lights, band by band; `None` without lights of equally many bands.
    pub fn mean(lights: &[Vec<Self>]) -> Option<Vec<Self>> {
        let bands = lights.first()?.len();
        let count = lights.len() as f64;
        let mean = |k: usize| {
            let sum = |value: fn(&Self) -> f64| lights.iter().map(|light| value(&light[k])).sum::<f64>() / count;
            Self {
                ground: sum(|light| light.ground.ln()).exp(),
                shade: sum(|light| light.shade),
                path: sum(|light| light.path),
            }
        };
        let is_even = lights.iter().all(|light| light.len() == bands);
        is_even.then(|| (0..bands).map(mean).collect())
    }

    /// Value (counts) under the light `to` of a cell with the relit `value` (counts) and the `albedo` that already has
    /// its `gain`: albedos of `to` are `gain` times those of this light.
    pub fn moved(&self, to: &Self, value: f32, albedo: f32, gain: f64) -> f32 {
        let reflected = gain * (f64::from(value) - self.path) / self.ground;
        let lit = match albedo > DARK {
            true => reflected / f64::from(albedo),
            false => 1.0,
        };
        let visibility = ((lit - self.shade) / (1.0 - self.shade).max(1e-6)).clamp(0.0, 1.0);
        let under = |shade: f64| visibility + (1.0 - visibility) * shade;
        let ratio = under(to.shade) / under(self.shade).max(1e-6);
        (reflected * ratio * to.ground + to.path) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ground_relit_by_two_models_is_one_under_their_mean_light() {
        let (first, second) = (
            BandLight {
                ground: 900.0,
                shade: 0.2,
                path: 30.0,
            },
            BandLight {
                ground: 1400.0,
                shade: 0.1,
                path: 80.0,
            },
        );
        let mean = BandLight::mean(&[vec![first], vec![second]]).expect("two lights")[0];
        assert!((mean.shade - 0.15).abs() < 1e-12 && (mean.path - 55.0).abs() < 1e-12);
        // Albedo of the first model is twice that of the second.
        for (albedo, visibility) in [(0.3, 1.0), (0.3, 0.0), (0.1, 0.5)] {
            let moved = |light: &BandLight, gain: f64| {
                let lit = visibility + (1.0 - visibility) * light.shade;
                let value = albedo / gain * lit * light.ground + light.path;
                light.moved(&mean, value as f32, albedo as f32, gain)
            };
            let [a, b] = [moved(&first, 0.5), moved(&second, 1.0)];
            let expected = albedo * (visibility + (1.0 - visibility) * mean.shade) * mean.ground + mean.path;
            assert!(
                (f64::from(a) - expected).abs() < 1e-2 && (a - b).abs() < 1e-2,
                "{a}, {b}, {expected}"
            );
        }
    }
}
