//! How much a surface faces the sun.
//!
//! Of a surface with normal `n` under a sun in direction `s`, level ground gets `s_z` and the surface `n·s` of the sun's
//! light (Lambert). Their ratio `f = max(0, n·s) / s_z` is one on level ground, so that albedo keeps its meaning; a roof
//! that falls away from the sun is darker, a façade under a low sun brighter. The normal is the composited one.

use crate::light::Light;
use crate::splat::Maps;
use glam::Vec3;

/// A façade under a low sun gets at most this many times the light of level ground.
const MOST: f32 = 4.0;
/// Share of the sun's light on level ground below which a surface counts as turned away from it.
const GRAZING: f32 = 0.1;
/// Sine of the sun's elevation below which level ground is no measure any more.
const LEAST_HEIGHT: f32 = 0.05;

/// The sun as the normals of a view see it.
pub(super) struct Facing<'a> {
    sun: Vec3,
    inverse_height: f32,
    normals: [&'a [f32]; 3],
}

impl<'a> Facing<'a> {
    /// `None` without a directional light, or where the maps hold no normals at channel `at`.
    pub(super) fn new(light: Option<Light>, maps: &'a Maps, at: usize) -> Option<Self> {
        let Some(Light::Directional(sun)) = light else {
            return None;
        };
        let [x, y, z] = maps.channels.get(at..at + 3)? else {
            return None;
        };
        Some(Self {
            sun,
            inverse_height: 1.0 / sun.z.max(LEAST_HEIGHT),
            normals: [x, y, z],
        })
    }

    fn normal(&self, pixel: usize) -> Vec3 {
        Vec3::from(self.normals.map(|plane| plane[pixel]))
    }

    /// `f` of a pixel, and its gradient to the composited normal.
    #[inline]
    pub(super) fn factor(&self, pixel: usize) -> (f32, Vec3) {
        let normal = self.normal(pixel);
        let length = normal.length();
        if length < 1e-3 {
            return (1.0, Vec3::ZERO);
        }
        let unit = normal / length;
        let cosine = unit.dot(self.sun);
        let factor = cosine * self.inverse_height;
        if factor <= 0.0 {
            return (0.0, Vec3::ZERO);
        }
        if factor >= MOST {
            return (MOST, Vec3::ZERO);
        }
        (factor, (self.sun - unit * cosine) * (self.inverse_height / length))
    }

    /// From 0 (turned away from the sun) to 1 (well lit).
    #[inline]
    pub(super) fn lit(&self, pixel: usize) -> f32 {
        (self.factor(pixel).0 / GRAZING).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn maps(normals: &[Vec3]) -> Maps {
        Maps {
            width: normals.len(),
            height: 1,
            channels: (0..3).map(|k| normals.iter().map(|n| n[k]).collect()).collect(),
            ..Maps::default()
        }
    }

    #[test]
    fn level_ground_is_the_measure_and_what_turns_away_is_dark() {
        let sun = Vec3::new(0.6, 0.0, 0.8);
        let maps = maps(&[Vec3::Z * 0.9, Vec3::X, -Vec3::X]);
        let facing = Facing::new(Some(Light::Directional(sun)), &maps, 0).expect("a sun and normals");
        assert!((facing.factor(0).0 - 1.0).abs() < 1e-6);
        assert!((facing.factor(1).0 - 0.75).abs() < 1e-6);
        assert_eq!((facing.factor(2).0, facing.lit(2), facing.lit(0)), (0.0, 0.0, 1.0));
    }

    #[test]
    fn its_gradient_matches_central_differences() {
        let sun = Vec3::new(0.3, -0.5, 0.6).normalize();
        let base = Vec3::new(0.2, 0.1, 0.7);
        let value = |n: Vec3| {
            let maps = maps(&[n]);
            Facing::new(Some(Light::Directional(sun)), &maps, 0)
                .expect("normals")
                .factor(0)
        };
        for k in 0..3 {
            let step = Vec3::AXES[k] * 1e-3;
            let numeric = (value(base + step).0 - value(base - step).0) / 2e-3;
            assert!((numeric - value(base).1[k]).abs() < 1e-3);
        }
    }
}
