//! The parameter table: every trained number, as a structure of arrays in named groups.
//!
//! One [`Table`] holds the Gaussians, another the parameters shared by all Gaussians (sky, per-image colour). Gradients
//! and Adam's moments are tables of the same shape, so optimiser, density control and checkpoint loop over groups
//! without regard to their meaning. Learning rates are in [`ParameterGroup`](crate::optim::ParameterGroup).

use glam::{Mat3, Quat, Vec3};
use rayon::prelude::*;
use std::ops::Range;

/// Index of the group of centres, metres from the scene centre.
pub const POSITION: usize = 0;
/// Index of the group of log scales: natural logarithm of the standard deviation in metres along each own axis.
pub const LOG_SCALE: usize = 1;
/// Index of the group of rotations: quaternion `x, y, z, w`, not necessarily unit.
pub const ROTATION: usize = 2;
/// Index of the group of opacities, as logits.
pub const OPACITY: usize = 3;
/// Index of the first group that a scene model adds.
pub const FEATURES: usize = 4;

/// Name of a group and numbers per element.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct GroupSpec {
    /// Name, as written in checkpoints, model files and messages.
    pub name: String,
    /// Numbers per element.
    pub width: usize,
}

impl GroupSpec {
    /// A group `name` of `width` numbers per element.
    pub fn new(name: &str, width: usize) -> Self {
        Self {
            name: name.into(),
            width,
        }
    }
}

/// Specifications of the four core groups that every Gaussian has, in the order of their indices.
pub fn core_groups() -> Vec<GroupSpec> {
    vec![
        GroupSpec::new("position", 3),
        GroupSpec::new("log_scale", 3),
        GroupSpec::new("rotation", 4),
        GroupSpec::new("opacity", 1),
    ]
}

/// One named group: `values[element * width + component]`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Group {
    /// Name and width.
    pub spec: GroupSpec,
    /// Values, element after element.
    pub values: Vec<f32>,
}

/// Elements with the same named groups of numbers.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Table {
    /// Number of elements.
    pub count: usize,
    /// Groups, each with values for all elements.
    pub groups: Vec<Group>,
}

impl Table {
    /// `count` elements, all zero.
    pub fn zeros(specs: Vec<GroupSpec>, count: usize) -> Self {
        let groups = specs
            .into_iter()
            .map(|spec| Group {
                values: vec![0.0; spec.width * count],
                spec,
            })
            .collect();
        Self { count, groups }
    }

    /// A table of the same shape, all zero.
    pub fn zeros_like(&self) -> Self {
        Self::zeros(self.groups.iter().map(|g| g.spec.clone()).collect(), self.count)
    }

    /// Sets every value to zero, keeping the memory; grows or shrinks to `count` elements.
    pub fn reset(&mut self, count: usize) {
        self.count = count;
        for group in &mut self.groups {
            group.values.resize(group.spec.width * count, 0.0);
            group.values.par_chunks_mut(1 << 15).for_each(|part| part.fill(0.0));
        }
    }

    /// Values of group `index`, element after element.
    pub fn group(&self, index: usize) -> &[f32] {
        &self.groups[index].values
    }

    /// Values of group `index`, element after element, to write.
    pub fn group_mut(&mut self, index: usize) -> &mut [f32] {
        &mut self.groups[index].values
    }

    /// A table of the elements `indices`, in that order; an index may come more than once.
    pub fn gather(&self, indices: &[u32]) -> Self {
        let groups = self
            .groups
            .iter()
            .map(|group| {
                let width = group.spec.width;
                let mut values = Vec::with_capacity(width * indices.len());
                for &index in indices {
                    let start = index as usize * width;
                    values.extend_from_slice(&group.values[start..start + width]);
                }
                Group {
                    spec: group.spec.clone(),
                    values,
                }
            })
            .collect();
        Self {
            count: indices.len(),
            groups,
        }
    }

    /// True if every value is finite.
    pub fn is_finite(&self) -> bool {
        self.groups.iter().all(|g| g.values.iter().all(|v| v.is_finite()))
    }

    /// Centre of a Gaussian, metres.
    #[inline]
    pub fn position(&self, index: usize) -> Vec3 {
        Vec3::from_slice(&self.groups[POSITION].values[index * 3..])
    }

    /// Standard deviations of a Gaussian along its own axes, metres.
    #[inline]
    pub fn scale(&self, index: usize) -> Vec3 {
        let log = &self.groups[LOG_SCALE].values[index * 3..index * 3 + 3];
        Vec3::new(log[0].exp(), log[1].exp(), log[2].exp())
    }

    /// Rotation of a Gaussian as stored, not normalised.
    #[inline]
    pub fn raw_rotation(&self, index: usize) -> [f32; 4] {
        let q = &self.groups[ROTATION].values[index * 4..index * 4 + 4];
        [q[0], q[1], q[2], q[3]]
    }

    /// Rotation matrix of a Gaussian: its columns are its own axes in the scene frame.
    #[inline]
    pub fn rotation(&self, index: usize) -> Mat3 {
        Mat3::from_quat(normalised(self.raw_rotation(index)))
    }

    /// Opacity of a Gaussian, 0 to 1.
    #[inline]
    pub fn opacity(&self, index: usize) -> f32 {
        sigmoid(self.groups[OPACITY].values[index])
    }
}

/// Core parameters of one Gaussian as stored, or gradients of a loss to them.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Core {
    /// Centre, metres; gradients per metre.
    pub(crate) position: Vec3,
    /// Log scales: natural logarithms of the standard deviations in metres.
    pub(crate) log_scale: Vec3,
    /// Quaternion `x, y, z, w`, not necessarily unit.
    pub(crate) rotation: [f32; 4],
    /// Opacity logit.
    pub(crate) opacity: f32,
}

/// The core groups of some neighbouring Gaussians, to write.
struct CoreChunk<'t> {
    position: &'t mut [f32],
    log_scale: &'t mut [f32],
    rotation: &'t mut [f32],
    opacity: &'t mut [f32],
}

impl CoreChunk<'_> {
    /// Adds to Gaussian `index` of the chunk.
    fn add(&mut self, index: usize, d: &Core) {
        let add = |slots: &mut [f32], values: &[f32]| slots.iter_mut().zip(values).for_each(|(slot, v)| *slot += v);
        add(&mut self.position[index * 3..index * 3 + 3], &d.position.to_array());
        add(&mut self.log_scale[index * 3..index * 3 + 3], &d.log_scale.to_array());
        add(&mut self.rotation[index * 4..index * 4 + 4], &d.rotation);
        self.opacity[index] += d.opacity;
    }
}

impl Table {
    /// The core groups, `elements` Gaussians at a time.
    fn core_chunks_mut(&mut self, elements: usize) -> impl IndexedParallelIterator<Item = CoreChunk<'_>> {
        let [position, log_scale, rotation, opacity] = &mut self.groups[..FEATURES] else {
            unreachable!("a table of Gaussians has the core groups");
        };
        position
            .values
            .par_chunks_mut(elements * 3)
            .zip(log_scale.values.par_chunks_mut(elements * 3))
            .zip(rotation.values.par_chunks_mut(elements * 4))
            .zip(opacity.values.par_chunks_mut(elements))
            .map(|(((position, log_scale), rotation), opacity)| CoreChunk {
                position,
                log_scale,
                rotation,
                opacity,
            })
    }

    /// Adds to each of the Gaussians `indices`, in ascending order, the `gradient` for its place among them.
    ///
    /// # Panics
    /// When the indices are not in ascending order.
    pub(crate) fn add_core(&mut self, indices: &[u32], gradient: impl Fn(usize) -> Core + Sync) {
        self.add_core_in_blocks::<1>(indices, |places, add| add(0, &gradient(places.start)));
    }

    /// Adds to each of the Gaussians `indices`, in ascending order, in blocks of up to `N` consecutive ones.
    /// `gradients` receives the places of a block among the indices and a function that adds to the first, second and
    /// so on Gaussian of the block.
    ///
    /// # Panics
    /// When the indices are not in ascending order.
    pub(crate) fn add_core_in_blocks<const N: usize>(
        &mut self,
        indices: &[u32],
        gradients: impl Fn(Range<usize>, &mut dyn FnMut(usize, &Core)) + Sync,
    ) {
        const CHUNK: usize = 2048;
        assert!(
            indices.is_sorted_by(|a, b| a < b),
            "every Gaussian once, in rising order"
        );
        self.core_chunks_mut(CHUNK).enumerate().for_each(|(number, mut chunk)| {
            let first = number * CHUNK;
            let from = indices.partition_point(|&i| (i as usize) < first);
            let to = indices.partition_point(|&i| (i as usize) < first + CHUNK);
            for start in (from..to).step_by(N) {
                gradients(start..(start + N).min(to), &mut |place, d| {
                    chunk.add(indices[start + place] as usize - first, d);
                });
            }
        });
    }

    /// Calls `add` in parallel for each of the elements `indices`, in ascending order, with its place among them and
    /// its values in `group`.
    ///
    /// # Panics
    /// When the indices are not in ascending order.
    pub(crate) fn add_to_group(&mut self, group: usize, indices: &[u32], add: impl Fn(usize, &mut [f32]) + Sync) {
        let Group { spec, values } = &mut self.groups[group];
        let width = spec.width.max(1);
        in_order(values, width, indices, |place, values| add(place, values));
    }

    /// Adds `gradient` to Gaussian `index`; an index beyond the end has no effect.
    pub(crate) fn add_core_to(&mut self, index: usize, gradient: &Core) {
        let chunk = self.core_chunks_mut(1).skip(index).take(1);
        chunk.for_each(|mut chunk| chunk.add(0, gradient));
    }

    /// Calls `make` in parallel for every `range` consecutive Gaussians, with the number of the range and a function
    /// that adds to a Gaussian by its offset in the range.
    pub(crate) fn add_core_by_range(
        &mut self,
        range: usize,
        make: impl Fn(usize, &mut dyn FnMut(usize, &Core)) + Sync,
    ) {
        self.core_chunks_mut(range)
            .enumerate()
            .for_each(|(number, mut chunk)| make(number, &mut |index, d| chunk.add(index, d)));
    }
}

/// Calls `change` in parallel for each of `indices`, in ascending order, with its place among them and the value of
/// that index.
///
/// # Panics
/// When the indices are not in ascending order.
pub(crate) fn for_each_of<T: Send>(values: &mut [T], indices: &[u32], change: impl Fn(usize, &mut T) + Sync) {
    in_order(values, 1, indices, |place, values| change(place, &mut values[0]));
}

/// Changes the `width` values of each index, in the order of the indices.
fn in_order<T: Send>(values: &mut [T], width: usize, indices: &[u32], change: impl Fn(usize, &mut [T]) + Sync) {
    const CHUNK: usize = 4096;
    let parts = (0..indices.len()).into_par_iter().step_by(CHUNK);
    let is_rising = |first: usize| indices[first..(first + CHUNK + 1).min(indices.len())].is_sorted_by(|a, b| a < b);
    assert!(
        parts.map(is_rising).all(|rising| rising),
        "every element once, in rising order"
    );
    let chunks = values.par_chunks_mut(CHUNK * width).enumerate();
    chunks.for_each(|(number, values)| {
        let first = number * CHUNK;
        let from = indices.partition_point(|&i| (i as usize) < first);
        let to = indices.partition_point(|&i| (i as usize) < first + CHUNK);
        for place in from..to {
            let at = (indices[place] as usize - first) * width;
            change(place, &mut values[at..at + width]);
        }
    });
}

/// The unit quaternion along `q`; the identity when the norm of `q` is below 1e-12 or not finite.
#[inline]
pub fn normalised(q: [f32; 4]) -> Quat {
    let norm = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    if norm < 1e-12 || !norm.is_finite() {
        return Quat::IDENTITY;
    }
    Quat::from_xyzw(q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)
}

/// Gradient of a loss to a raw quaternion from its gradient to the rotation matrix built of the normalised one.
///
/// `d_rotation` holds `∂L/∂R` column by column. The result is projected on the tangent of the sphere and divided by the
/// norm, which is the derivative of the normalisation. It is zero when the norm is below 1e-12 or not finite.
pub fn rotation_backward(raw: [f32; 4], d_rotation: Mat3) -> [f32; 4] {
    let norm = (raw[0] * raw[0] + raw[1] * raw[1] + raw[2] * raw[2] + raw[3] * raw[3]).sqrt();
    if norm < 1e-12 || !norm.is_finite() {
        return [0.0; 4];
    }
    let [x, y, z, w] = raw.map(|c| c / norm);
    let g = |row: usize, col: usize| d_rotation.col(col)[row];
    let unit = [
        2.0 * (y * (g(0, 1) + g(1, 0)) + z * (g(0, 2) + g(2, 0)) - 2.0 * x * (g(1, 1) + g(2, 2))
            + w * (g(2, 1) - g(1, 2))),
        2.0 * (x * (g(0, 1) + g(1, 0)) + z * (g(1, 2) + g(2, 1)) - 2.0 * y * (g(0, 0) + g(2, 2))
            + w * (g(0, 2) - g(2, 0))),
        2.0 * (x * (g(0, 2) + g(2, 0)) + y * (g(1, 2) + g(2, 1)) - 2.0 * z * (g(0, 0) + g(1, 1))
            + w * (g(1, 0) - g(0, 1))),
        2.0 * (x * (g(2, 1) - g(1, 2)) + y * (g(0, 2) - g(2, 0)) + z * (g(1, 0) - g(0, 1))),
    ];
    let q = [x, y, z, w];
    let along: f32 = (0..4).map(|i| unit[i] * q[i]).sum();
    [0, 1, 2, 3].map(|i| (unit[i] - along * q[i]) / norm)
}

/// `1 / (1 + e^-x)`, without overflow.
#[inline]
pub fn sigmoid(x: f32) -> f32 {
    if x >= 0.0 {
        1.0 / (1.0 + (-x).exp())
    } else {
        let e = x.exp();
        e / (1.0 + e)
    }
}

/// Inverse of [`sigmoid`], `ln(p / (1 - p))`, for probabilities inside (0, 1).
#[inline]
pub fn logit(p: f32) -> f32 {
    (p / (1.0 - p)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_to_a_quaternion_matches_central_differences() {
        let raw = [0.3f32, -0.5, 0.2, 0.9];
        // L = Σ weights ⊙ R
        let weights = Mat3::from_cols(
            Vec3::new(0.2, -1.0, 0.4),
            Vec3::new(0.9, 0.1, -0.3),
            Vec3::new(0.5, 0.7, -0.6),
        );
        let loss = |q: [f32; 4]| {
            let r = Mat3::from_quat(normalised(q));
            (0..3).map(|c| r.col(c).dot(weights.col(c))).sum::<f32>()
        };
        let analytic = rotation_backward(raw, weights);
        for i in 0..4 {
            let (mut hi, mut lo) = (raw, raw);
            hi[i] += 1e-2;
            lo[i] -= 1e-2;
            let numeric = (loss(hi) - loss(lo)) / 2e-2;
            assert!(
                (numeric - analytic[i]).abs() < 2e-3,
                "component {i}: {numeric} against {}",
                analytic[i]
            );
        }
    }

    #[test]
    fn a_degenerate_quaternion_is_the_identity_with_no_gradient() {
        assert_eq!(normalised([0.0; 4]), Quat::IDENTITY);
        assert_eq!(rotation_backward([0.0; 4], Mat3::IDENTITY), [0.0; 4]);
    }

    #[test]
    fn gathering_repeats_and_reorders_elements() {
        let mut table = Table::zeros(core_groups(), 3);
        table.group_mut(OPACITY).copy_from_slice(&[1.0, 2.0, 3.0]);
        let gathered = table.gather(&[2, 0, 2]);
        assert_eq!(gathered.group(OPACITY), &[3.0, 1.0, 3.0]);
        assert_eq!(gathered.count, 3);
    }

    #[test]
    fn sigmoid_stays_in_bounds_at_the_extremes() {
        for x in [-1e30f32, -100.0, -20.0, 0.0, 20.0, 100.0, 1e30] {
            assert!((0.0..=1.0).contains(&sigmoid(x)), "{x}");
        }
    }
}
