//! Occluders and the hierarchy over their bounds; the only place that speaks `obvhs`.
//!
//! A Gaussian occludes inside the ellipsoid of `sqrt(2 ln(o / o_min))` standard deviations (the stretched icosahedron of
//! 3D Gaussian ray tracing, Moenne-Loccoz et al. 2024, encloses the same ellipsoid); its axis-aligned bounds go into an
//! eight-wide hierarchy.

use crate::gaussians::Table;
use glam::{Mat3, Vec3, Vec3A};
use obvhs::{BvhBuildParams, aabb::Aabb, cwbvh::CwBvh, cwbvh::builder::build_cwbvh, ray::Ray};
use rayon::prelude::*;
use std::sync::OnceLock;
use std::time::Duration;

/// Opacity at which a Gaussian ends for the light.
pub const OPACITY_MIN: f32 = 0.001;

/// One Gaussian as the light meets it.
#[derive(Debug, Clone, Copy)]
pub struct Occluder {
    /// Centre, metres.
    pub position: Vec3,
    /// `S⁻¹ Rᵀ`: scene metres to standard deviations.
    pub whiten: Mat3,
    /// `R S`: standard deviations to scene metres.
    pub spread: Mat3,
    /// Opacity, 0 to 1.
    pub opacity: f32,
    /// Squared radius of its reach, in standard deviations; zero when it occludes nothing.
    pub reach_square: f32,
}

impl Occluder {
    /// The occluder of a Gaussian.
    pub fn new(gaussians: &Table, index: usize) -> Self {
        let opacity = gaussians.opacity(index);
        let scale = gaussians.scale(index);
        let rotation = gaussians.rotation(index);
        let whiten = Mat3::from_diagonal(scale.recip()) * rotation.transpose();
        let spread = rotation * Mat3::from_diagonal(scale);
        let position = gaussians.position(index);
        let finite = position.is_finite() && whiten.is_finite() && opacity.is_finite();
        let reach_square = if finite && opacity > OPACITY_MIN {
            2.0 * (opacity / OPACITY_MIN).ln()
        } else {
            0.0
        };
        Self {
            position,
            whiten,
            spread,
            opacity,
            reach_square,
        }
    }

    /// Axis-aligned bounds of its reach.
    fn bounds(&self) -> Aabb {
        if self.reach_square <= 0.0 {
            // A point that no ray meets; the index must keep its place.
            return Aabb::from_point(Vec3A::from(self.position.clamp(Vec3::splat(-1e18), Vec3::splat(1e18))));
        }
        let variance = |r: usize| self.spread.row(r).length_squared();
        let half = Vec3::new(variance(0), variance(1), variance(2)).map(f32::sqrt) * self.reach_square.sqrt();
        Aabb::new(Vec3A::from(self.position - half), Vec3A::from(self.position + half))
    }
}

/// All Gaussians of a table as the light meets them, as they stood when this was made. The hierarchy over them is built
/// when it is first asked for.
pub struct Occluders {
    /// The occluders, by Gaussian.
    pub list: Vec<Occluder>,
    bounds: Vec<Aabb>,
    hierarchy: OnceLock<CwBvh>,
}

impl Occluders {
    /// The occluders of a table.
    pub fn new(gaussians: &Table) -> Self {
        let (list, bounds) = (0..gaussians.count)
            .into_par_iter()
            .with_min_len(512)
            .map(|i| {
                let occluder = Occluder::new(gaussians, i);
                (occluder, occluder.bounds())
            })
            .unzip();
        Self {
            list,
            bounds,
            hierarchy: OnceLock::new(),
        }
    }

    fn hierarchy(&self) -> &CwBvh {
        self.hierarchy.get_or_init(|| {
            let mut spent = Duration::default();
            build_cwbvh(&self.bounds, BvhBuildParams::fast_build(), &mut spent)
        })
    }

    /// Calls `visit` with every Gaussian whose leaf bounds meet the ray; some of those are not truly met.
    #[inline]
    pub fn visit(&self, origin: Vec3, direction: Vec3, length: f32, mut visit: impl FnMut(u32)) {
        if self.list.is_empty() {
            return;
        }
        let tree = self.hierarchy();
        let ray = Ray::new(Vec3A::from(origin), Vec3A::from(direction), 0.0, length);
        tree.ray_traverse_anyhit(ray, |_, place| visit(tree.primitive_indices[place]));
    }
}
