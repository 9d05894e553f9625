//! Occluders and the bounding volume hierarchy over them; the only file that uses `obvhs`.
//!
//! A Gaussian occludes inside the ellipsoid of `sqrt(2 ln(o / o_min))` standard deviations (the stretched icosahedron
//! of 3D Gaussian ray tracing, Moenne-Loccoz et al. 2024, encloses the same ellipsoid); its axis-aligned bounds go into
//! a binary hierarchy, which is traversed by bundles of neighbouring rays, not by single ones.

use crate::gaussians::Table;
use glam::{Mat3, Vec3, Vec3A};
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;
use std::time::Duration;

/// Attenuation at which the reach of an occluding Gaussian ends.
pub const OPACITY_MIN: f32 = 0.001;

/// One Gaussian as an occluder of light.
#[derive(Debug, Clone, Copy)]
pub struct Occluder {
    /// Centre, metres.
    pub position: Vec3,
    /// `R S`, rotation times scales: its columns are the own axes, one standard deviation long, in scene metres.
    pub scaled_axes: Mat3,
    /// Standard deviations along its own axes, metres: the lengths of the columns of `scaled_axes`.
    pub scale: Vec3,
    /// Opacity, 0 to 1.
    pub opacity: f32,
    /// Squared radius of its reach, in standard deviations; zero when it occludes nothing.
    pub reach_square: f32,
}

impl Occluder {
    /// Occluder of Gaussian `index`.
    pub fn new(gaussians: &Table, index: usize) -> Self {
        let opacity = gaussians.opacity(index);
        let scale = gaussians.scale(index);
        let rotation = gaussians.rotation(index);
        let scaled_axes = Mat3::from_cols(
            rotation.x_axis * scale.x,
            rotation.y_axis * scale.y,
            rotation.z_axis * scale.z,
        );
        let position = gaussians.position(index);
        let finite =
            position.is_finite() && scale.recip().is_finite() && scaled_axes.is_finite() && opacity.is_finite();
        let reach_square = if finite && opacity > OPACITY_MIN {
            2.0 * (opacity / OPACITY_MIN).ln()
        } else {
            0.0
        };
        Self {
            position,
            scaled_axes,
            scale,
            opacity,
            reach_square,
        }
    }

    /// Whitening `S⁻¹ Rᵀ`: takes scene metres to standard deviations.
    #[inline(always)]
    pub fn whiten(&self) -> Mat3 {
        let inverse = (self.scale * self.scale).recip();
        let rows = [
            self.scaled_axes.x_axis * inverse.x,
            self.scaled_axes.y_axis * inverse.y,
            self.scaled_axes.z_axis * inverse.z,
        ];
        Mat3::from_cols(rows[0], rows[1], rows[2]).transpose()
    }

    /// Axis-aligned bounds of its reach.
    fn bounds(&self) -> Aabb {
        if self.reach_square <= 0.0 {
            // A point that no ray hits; the index must keep its place.
            return Aabb::from_point(Vec3A::from(self.position.clamp(Vec3::splat(-1e18), Vec3::splat(1e18))));
        }
        let variance = |r: usize| self.scaled_axes.row(r).length_squared();
        let half = Vec3::new(variance(0), variance(1), variance(2)).map(f32::sqrt) * self.reach_square.sqrt();
        Aabb::new(Vec3A::from(self.position - half), Vec3A::from(self.position + half))
    }
}

/// Axis-aligned bounds: least and largest east, north and up, metres.
pub(crate) type Bounds = [[f32; 3]; 2];

/// Bounding volume hierarchy over the bounds of all occluders.
pub(super) struct Hierarchy {
    tree: Bvh2,
    /// Bounds that the tree was built on; it has since been refitted to others.
    built_on: Vec<Bounds>,
    /// Place of each Gaussian in an order in which neighbours in the scene are neighbours.
    pub(super) rank: Vec<u32>,
}

/// Bundles of rays from a box, all along one axis or towards one point on it.
pub(super) struct Shaft {
    /// Centre of the box, metres.
    pub(super) centre: Vec3,
    /// Half sizes of the box, metres.
    pub(super) half: Vec3,
    /// Unit vector along the axis.
    pub(super) direction: Vec3,
    /// Length of the axis, metres; infinite for parallel light.
    pub(super) length: f32,
}

fn bounds(list: &[Occluder]) -> Vec<Aabb> {
    list.par_iter().with_min_len(512).map(Occluder::bounds).collect()
}

impl Hierarchy {
    fn new(list: &[Occluder]) -> Self {
        Self::on(&bounds(list))
    }

    fn on(bounds: &[Aabb]) -> Self {
        let mut spent = Duration::default();
        let mut tree = build_bvh2(bounds, BvhBuildParams::fast_build(), &mut spent);
        // Parents before children: a refit is then one sweep, and a traversal goes forward in memory.
        tree.reorder_in_stack_traversal_order();
        let mut rank = vec![0; bounds.len()];
        let leaves = tree.nodes.iter().filter(|node| node.is_leaf());
        let primitives = leaves.flat_map(|leaf| leaf_range(leaf.first_index, leaf.prim_count));
        for (place, primitive) in primitives.enumerate() {
            rank[tree.primitive_indices[primitive] as usize] = place as u32;
        }
        let corners = |b: &Aabb| [b.min.to_array(), b.max.to_array()];
        let built_on = bounds.iter().map(corners).collect();
        Self { tree, built_on, rank }
    }

    /// Fits the bounds to occluders that have moved; each leaf keeps its occluders.
    fn refit(&mut self, list: &[Occluder]) {
        let bounds = bounds(list);
        let Bvh2 {
            nodes,
            primitive_indices,
            ..
        } = &mut self.tree;
        for node in nodes.iter_mut().filter(|node| node.is_leaf()) {
            let held = leaf_range(node.first_index, node.prim_count);
            let all = held.map(|place| bounds[primitive_indices[place] as usize]);
            if let Some(bounds) = all.reduce(|a, b| a.union(&b)) {
                node.set_aabb(bounds);
            }
        }
        self.tree.refit_all();
    }

    /// Lists in `candidates` every Gaussian whose leaf's bounds intersect the shaft, in the order of the tree; `stack`
    /// is scratch space.
    pub(super) fn intersecting(&self, shaft: &Shaft, stack: &mut Vec<u32>, candidates: &mut Vec<u32>) {
        candidates.clear();
        stack.clear();
        if self.tree.nodes.is_empty() {
            return;
        }
        let slab = Slab::new(shaft);
        stack.push(0);
        while let Some(index) = stack.pop() {
            let node = &self.tree.nodes[index as usize];
            if !slab.intersects(node.aabb()) {
                continue;
            }
            if node.is_leaf() {
                let held = leaf_range(node.first_index, node.prim_count);
                candidates.extend_from_slice(&self.tree.primitive_indices[held]);
            } else {
                stack.extend([node.first_index + 1, node.first_index]);
            }
        }
    }
}

fn leaf_range(first: u32, count: u32) -> Range<usize> {
    first as usize..(first + count) as usize
}

/// A shaft as boxes are tested against it: its axis against boxes grown by its half sizes. Rays toward one point stay
/// inside, because the box they cross the shaft in shrinks.
struct Slab {
    centre: Vec3A,
    half: Vec3A,
    inverse: Vec3A,
    length: f32,
}

impl Slab {
    fn new(shaft: &Shaft) -> Self {
        // Never zero, so that no slab is 0 · ∞.
        let bounded = |d: f32| if d.abs() < 1e-12 { 1e-12f32.copysign(d) } else { d };
        Self {
            centre: Vec3A::from(shaft.centre),
            half: Vec3A::from(shaft.half),
            inverse: Vec3A::from(shaft.direction.map(bounded)).recip(),
            length: shaft.length,
        }
    }

    #[inline(always)]
    fn intersects(&self, bounds: &Aabb) -> bool {
        let a = (bounds.min - self.half - self.centre) * self.inverse;
        let b = (bounds.max + self.half - self.centre) * self.inverse;
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        near <= far && far >= 0.0 && near <= self.length
    }
}

/// Search for the Gaussians between a Gaussian and the sun. Point lights always take the hierarchy.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SunVisibility {
    /// Grids on the plane normal to the sun.
    #[default]
    Plane,
    /// The bounding volume hierarchy.
    Bvh,
}

/// All Gaussians of a table as occluders, as they were when this was made. The hierarchy over them is built on first
/// use.
pub struct Occluders {
    /// Occluders, one for each Gaussian, in their order.
    pub list: Vec<Occluder>,
    /// Tracer of parallel light.
    pub sun_visibility: SunVisibility,
    hierarchy: OnceLock<Hierarchy>,
}

fn list(gaussians: &Table) -> Vec<Occluder> {
    (0..gaussians.count)
        .into_par_iter()
        .with_min_len(512)
        .map(|i| Occluder::new(gaussians, i))
        .collect()
}

impl Occluders {
    /// The occluders of a table; parallel light is traced by [`SunVisibility::Plane`].
    pub fn new(gaussians: &Table) -> Self {
        Self::tracing_by(SunVisibility::default(), gaussians)
    }

    /// The occluders of a table, with `sun_visibility` as the tracer of parallel light.
    pub fn tracing_by(sun_visibility: SunVisibility, gaussians: &Table) -> Self {
        Self {
            list: list(gaussians),
            sun_visibility,
            hierarchy: OnceLock::new(),
        }
    }

    /// Occluders with a hierarchy that was built on earlier bounds of the Gaussians, `built_on`, and is refitted to the
    /// current ones.
    ///
    /// # Panics
    /// When the number of bounds differs.
    pub(crate) fn with_hierarchy_on(sun_visibility: SunVisibility, gaussians: &Table, built_on: Vec<Bounds>) -> Self {
        assert_eq!(gaussians.count, built_on.len(), "the same Gaussians");
        let bounds = |[min, max]: &Bounds| Aabb::new(Vec3A::from_array(*min), Vec3A::from_array(*max));
        let bounds: Vec<Aabb> = built_on.iter().map(bounds).collect();
        let list = list(gaussians);
        let mut hierarchy = Hierarchy::on(&bounds);
        hierarchy.refit(&list);
        Self {
            list,
            sun_visibility,
            hierarchy: hierarchy.into(),
        }
    }

    /// Bounds that the hierarchy was built on, if there is one.
    pub(crate) fn hierarchy_built_on(&self) -> Option<&[Bounds]> {
        self.hierarchy.get().map(|hierarchy| hierarchy.built_on.as_slice())
    }

    /// Replaces the occluders after their Gaussians have moved; an existing hierarchy is kept and refitted.
    ///
    /// # Panics
    /// When the number of Gaussians differs.
    pub fn renew(&mut self, gaussians: &Table) {
        assert_eq!(gaussians.count, self.list.len(), "the same Gaussians");
        self.list = list(gaussians);
        if let Some(hierarchy) = self.hierarchy.get_mut() {
            hierarchy.refit(&self.list);
        }
    }

    /// Lets light through the Gaussians that are not `present` (a flag per Gaussian), until [`Self::renew`].
    pub fn hide(&mut self, present: &[bool]) {
        for (occluder, present) in self.list.iter_mut().zip(present) {
            if !present {
                occluder.reach_square = 0.0;
            }
        }
    }

    /// The hierarchy over the occluders, built on first use.
    pub(super) fn hierarchy(&self) -> &Hierarchy {
        self.hierarchy.get_or_init(|| Hierarchy::new(&self.list))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::{POSITION, core_groups};

    fn scattered(shift: f32) -> Table {
        let mut table = Table::zeros(core_groups(), 500);
        for (i, value) in table.group_mut(POSITION).iter_mut().enumerate() {
            *value = ((i * 7919) % 1000) as f32 * 0.1 + shift * ((i * 31) % 17) as f32;
        }
        table
    }

    fn listed(hierarchy: &Hierarchy, shaft: &Shaft) -> Vec<u32> {
        let (mut stack, mut candidates) = (Vec::new(), Vec::new());
        hierarchy.intersecting(shaft, &mut stack, &mut candidates);
        candidates.sort_unstable();
        candidates
    }

    #[test]
    fn a_refitted_hierarchy_finds_what_one_built_anew_finds() {
        let mut occluders = Occluders::new(&scattered(0.0));
        occluders.hierarchy();
        let moved = scattered(0.3);
        occluders.renew(&moved);
        let anew = Occluders::new(&moved);
        for direction in [Vec3::Z, Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.48, 0.6, 0.64)] {
            let shaft = Shaft {
                centre: Vec3::new(50.0, 50.0, 20.0),
                half: Vec3::new(15.0, 12.0, 5.0),
                direction,
                length: f32::INFINITY,
            };
            // Leaves differ, but Gaussians inside the shaft must be in both.
            let slab = Slab::new(&shaft);
            let truly: Vec<u32> = (0..500)
                .filter(|&i| slab.intersects(&anew.list[i as usize].bounds()))
                .collect();
            assert!(!truly.is_empty());
            for hierarchy in [occluders.hierarchy(), anew.hierarchy()] {
                let candidates = listed(hierarchy, &shaft);
                assert!(truly.iter().all(|i| candidates.binary_search(i).is_ok()), "{direction}");
            }
        }
    }

    #[test]
    fn neighbours_in_rank_are_neighbours_in_the_scene() {
        let table = scattered(0.0);
        let occluders = Occluders::new(&table);
        let rank = &occluders.hierarchy().rank;
        let mut order = vec![usize::MAX; rank.len()];
        for (gaussian, &place) in rank.iter().enumerate() {
            order[place as usize] = gaussian;
        }
        let step = |pair: &[usize]| table.position(pair[0]).distance(table.position(pair[1]));
        let mean = order.windows(2).map(step).sum::<f32>() / 499.0;
        let as_listed = (0..499).map(|i| step(&[i, i + 1])).sum::<f32>() / 499.0;
        assert!(mean < 0.5 * as_listed, "{mean} against {as_listed}");
    }
}
