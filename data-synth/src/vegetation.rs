//! Trees and hedges: clusters of ellipsoids, opaque, so that the canopy has one exact top surface.

use crate::materials::{Class, Material, Spectrum};
use crate::noise::stream;
use crate::raytrace::SurfaceId;
use crate::solid::{Finish, Footprint, Solids};
use nalgebra::Vector3;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// Shape of a tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TreeKind {
    /// A round crown whose colour follows the seasons.
    Broadleaf,
    /// A round crown that keeps its leaves.
    Evergreen,
    /// A cone that keeps its needles.
    Conifer,
}

/// One tree.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tree {
    /// Distance of the trunk east of the site's centre, metres.
    pub(crate) x: f64,
    /// Distance of the trunk north of the site's centre, metres.
    pub(crate) y: f64,
    /// Radius of the crown, metres.
    pub(crate) radius_m: f64,
    /// Height above the ground, metres.
    pub(crate) height_m: f64,
    /// Shape of the tree.
    pub(crate) kind: TreeKind,
    /// Mean albedo of the leaves in summer.
    pub(crate) leaf: Spectrum,
    /// Seed of the shape.
    pub(crate) seed: u64,
}

/// A straight hedge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hedge {
    /// Both ends, (east, north) of the site's centre, metres.
    pub(crate) ends: [[f64; 2]; 2],
    /// Mean height above the ground, metres.
    pub(crate) height_m: f64,
    /// Seed of the shape.
    pub(crate) seed: u64,
}

impl Tree {
    /// Adds the tree to the solids; `ground_z` is the altitude of the ground, metres of the scene's frame.
    pub(crate) fn build(&self, solids: &mut Solids, ground_z: f64) {
        let mut random = stream(self.seed, 0x7EE);
        let leaves = self.leaf_surfaces(solids, ground_z, &mut random);
        self.trunk(solids, ground_z);
        match self.kind {
            TreeKind::Conifer => self.cone(solids, ground_z, &leaves, &mut random),
            _ => self.crown(solids, ground_z, &leaves, &mut random),
        }
    }

    /// Three tones of the tree's own colour.
    fn leaf_surfaces(&self, solids: &mut Solids, ground_z: f64, random: &mut Pcg64Mcg) -> [SurfaceId; 3] {
        let evergreen = self.kind != TreeKind::Broadleaf;
        [0.82, 1.0, 1.2].map(|tone| {
            let leaves = Material::Leaves(self.leaf * tone, evergreen);
            let finish = Finish::new(Class::Vegetation, leaves, random.random());
            solids.foliage_surface(Vector3::new(self.x, self.y, ground_z), finish)
        })
    }

    fn trunk(&self, solids: &mut Solids, ground_z: f64) {
        let thickness_m = 0.04 * self.radius_m + 0.06;
        let plan = Footprint {
            x: self.x,
            y: self.y,
            angle_rad: 0.0,
            half: [thickness_m; 2],
        };
        let bark = Finish::new(Class::Vegetation, Material::Bark, self.seed as u32);
        solids.walls(&plan, ground_z - 0.5, ground_z + 0.6 * self.height_m, bark);
    }

    fn crown(&self, solids: &mut Solids, ground_z: f64, leaves: &[SurfaceId; 3], random: &mut Pcg64Mcg) {
        let depth_m = (0.72 * self.height_m).min(1.7 * self.radius_m);
        let hull = Vector3::new(self.radius_m, self.radius_m, 0.5 * depth_m);
        let centre = Vector3::new(self.x, self.y, ground_z + self.height_m - hull.z);
        solids.ellipsoid(centre, hull * 0.72, leaves[0]);
        let clusters = (14.0 + 2.4 * self.radius_m * self.radius_m).min(60.0) as u32;
        for k in 0..clusters {
            // Evenly over the sphere by the golden angle, shaken; the underside is left open.
            let up = 1.0 - 1.5 * (f64::from(k) + 0.5) / f64::from(clusters);
            let turn = 2.399_963 * f64::from(k) + random.random_range(-0.5..0.5);
            let level = (1.0 - up * up).max(0.0).sqrt();
            let outward = random.random_range(0.55..0.80);
            let radius_m = self.radius_m * random.random_range(0.20..0.34);
            let offset = Vector3::new(level * turn.cos(), level * turn.sin(), up).component_mul(&hull) * outward;
            let radii = Vector3::new(radius_m, radius_m * random.random_range(0.8..1.2), radius_m * 0.75);
            // The hull's top is the tree's height: no cluster rises above it.
            let mut middle = centre + offset;
            middle.z = middle.z.min(ground_z + self.height_m - radii.z);
            solids.ellipsoid(middle, radii, leaves[random.random_range(0..3)]);
        }
    }

    fn cone(&self, solids: &mut Solids, ground_z: f64, leaves: &[SurfaceId; 3], random: &mut Pcg64Mcg) {
        const LAYERS: u32 = 9;
        for layer in 0..LAYERS {
            let share = (f64::from(layer) + 0.5) / f64::from(LAYERS);
            let z = ground_z + self.height_m * (0.18 + 0.80 * share);
            let reach_m = self.radius_m * (1.0 - share).powf(0.85);
            let thick_m = 0.09 * self.height_m;
            let centre = Vector3::new(self.x, self.y, z.min(ground_z + self.height_m - thick_m));
            let wide_m = 0.8 * reach_m + 0.1;
            let radii = Vector3::new(wide_m, wide_m, thick_m);
            solids.ellipsoid(centre, radii, leaves[layer as usize % 3]);
            for arm in 0..5 {
                let turn = f64::from(arm) * 1.2566 + random.random_range(-0.4..0.4);
                let radius_m = 0.38 * reach_m + 0.08;
                let out_m = 0.62 * reach_m;
                let centre = Vector3::new(self.x + out_m * turn.cos(), self.y + out_m * turn.sin(), z - 0.2);
                let radii = Vector3::new(radius_m, radius_m, 0.5 * thick_m);
                solids.ellipsoid(centre, radii, leaves[arm as usize % 3]);
            }
        }
    }
}

impl Hedge {
    /// Adds the hedge to the solids as a row of overlapping bushes. `height_at(x, y)` is the altitude of the ground,
    /// metres.
    pub(crate) fn build(&self, solids: &mut Solids, height_at: impl Fn(f64, f64) -> f64) {
        let mut random = stream(self.seed, 0x4ED);
        let [from, to] = self.ends;
        let length_m = (to[0] - from[0]).hypot(to[1] - from[1]);
        let bushes = (length_m / 0.8).ceil().max(1.0) as u32;
        let leaves = Material::Leaves(Spectrum::new(0.045, 0.070, 0.032, 0.40), true);
        let finish = Finish::new(Class::Vegetation, leaves, self.seed as u32);
        let surface = solids.foliage_surface(Vector3::new(from[0], from[1], height_at(from[0], from[1])), finish);
        for k in 0..bushes {
            let share = (f64::from(k) + random.random_range(0.3..0.7)) / f64::from(bushes);
            let (x, y) = (from[0] + (to[0] - from[0]) * share, from[1] + (to[1] - from[1]) * share);
            let tall_m = self.height_m * random.random_range(0.85..1.1);
            let wide_m = random.random_range(0.5..0.75);
            let centre = Vector3::new(x, y, height_at(x, y) + 0.45 * tall_m);
            solids.ellipsoid(centre, Vector3::new(wide_m, wide_m, 0.55 * tall_m), surface);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ray::Ray;
    use crate::raytrace::Tracer;
    use crate::terrain::HeightField;

    #[test]
    fn a_crown_is_as_high_and_as_wide_as_the_tree_says() {
        let ground = HeightField::sample(12.0, 1.0, |_, _| 0.0);
        for kind in [TreeKind::Broadleaf, TreeKind::Conifer] {
            let tree = Tree {
                x: 0.3,
                y: -0.2,
                radius_m: 3.0,
                height_m: 9.0,
                kind,
                leaf: Spectrum::new(0.05, 0.08, 0.03, 0.4),
                seed: 5,
            };
            let mut solids = Solids::default();
            tree.build(&mut solids, 0.0);
            let tracer = Tracer::new(&ground, solids.primitives);
            let mut covered_m2 = 0.0;
            let mut top_m = 0.0f64;
            for k in 0..10_000 {
                let (x, y) = (f64::from(k % 100) * 0.1 - 5.0, f64::from(k / 100) * 0.1 - 5.0);
                let ray = Ray::new(Vector3::new(x, y, 30.0), -Vector3::z());
                let z = tracer.trace(&ray).map_or(0.0, |hit| hit.point.z);
                top_m = top_m.max(z);
                covered_m2 += if z > 0.01 { 0.01 } else { 0.0 };
            }
            assert!((8.0..=9.0 + 1e-9).contains(&top_m), "{kind:?}: {top_m}");
            let disc_m2 = std::f64::consts::PI * 9.0;
            assert!(
                (0.6 * disc_m2..1.15 * disc_m2).contains(&covered_m2),
                "{kind:?}: {covered_m2}"
            );
        }
    }
}
