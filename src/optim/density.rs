//! Adaptive density control (Kerbl et al. 2023): more Gaussians where the image needs detail, none where nothing is
//! seen.
//!
//! The criterion is the mean 2-D positional gradient of a Gaussian: the mean length of its splats' gradients to column
//! and row. Above a threshold a Gaussian larger than the split size is split in two smaller ones, a small one is
//! cloned; transparent and oversized ones are pruned. A cap on the number, which follows from the memory budget, takes
//! the largest gradients first. No opacity reset (ShadowGS).

use crate::gaussians::{LOG_SCALE, OPACITY, POSITION, Table, for_each_of};
use crate::splat::{Projected, SplatGradient};
use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// Last step at which the number changes, as a fraction of all steps: new Gaussians need the remaining steps to
/// converge.
pub(crate) const UNTIL_FRACTION: f32 = 0.6;
/// Gaussians below this opacity are pruned: they absorb a fiftieth of the light at most, at the cost of any other.
const PRUNE_OPACITY: f32 = 0.02;

/// Schedule and thresholds of density control.
///
/// Fields that serde skips are not user settings: the program sets them for each kind of scene. Their defaults are for
/// ground seen from satellites.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensityOptions {
    /// Steps between two rounds of density control; 0 is never. `fast` has none, `balanced` one every 100 steps, and
    /// objects one every 50 or 100.
    pub every: usize,
    /// At most this many Gaussians: 20,000 to 150,000 for objects; `--memory` may lower it.
    pub cap: usize,
    /// First step with density control.
    #[serde(skip)]
    pub from: usize,
    /// Fraction of the Gaussians that may be added at a time, largest gradients first.
    #[serde(skip)]
    pub growth: f32,
    /// Mean 2-D positional gradient below which a Gaussian is neither split nor cloned, in loss per pixel; the loss is
    /// summed over pixels.
    #[serde(skip)]
    pub gradient_threshold: f32,
    /// Largest standard deviation, ground sampling distances, above which a growing Gaussian is split instead of
    /// cloned.
    #[serde(skip)]
    pub split_gsd: f32,
    /// Largest standard deviation, ground sampling distances, from which on a Gaussian is pruned.
    #[serde(skip)]
    pub prune_gsd: f32,
}

impl Default for DensityOptions {
    fn default() -> Self {
        Self {
            every: 300,
            cap: 2_000_000,
            from: 0,
            growth: 0.05,
            gradient_threshold: 0.2,
            split_gsd: 1.2,
            prune_gsd: 12.0,
        }
    }
}

/// Gradients of each Gaussian, collected since the table was last rebuilt.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DensityStatistics {
    /// Sum of the lengths of the 2-D positional gradients, per pixel.
    pub gradient: Vec<f32>,
    /// Number of views that saw each Gaussian.
    pub seen: Vec<u32>,
}

/// Relation of a rebuilt table to the old one.
#[derive(Debug, Clone, PartialEq)]
pub struct Rebuild {
    /// Index of the old element from which each new one comes.
    pub sources: Vec<u32>,
    /// Index of the first new element.
    pub fresh: usize,
    /// Number of elements that were pruned.
    pub pruned: usize,
}

impl DensityStatistics {
    /// Empty statistics of `count` Gaussians.
    pub fn new(count: usize) -> Self {
        Self {
            gradient: vec![0.0; count],
            seen: vec![0; count],
        }
    }

    /// True if the statistics belong to `count` Gaussians.
    pub(crate) fn fits(&self, count: usize) -> bool {
        self.gradient.len() == count && self.seen.len() == count
    }

    /// Adds the gradients of one view. `pixels` is the number of its pixels: it turns the gradient of a mean over
    /// pixels into that of a sum.
    pub fn add(&mut self, projected: &Projected, grads: &[SplatGradient], pixels: usize) {
        // A step with numbers that are not finite is rejected, so its gradients must not count here either.
        let length = |place: usize| (grads[place].col * grads[place].col + grads[place].row * grads[place].row).sqrt();
        let is_sound = |place: usize| length(place).is_finite();
        for_each_of(&mut self.gradient, &projected.gaussian, |place, gradient| {
            if is_sound(place) {
                *gradient += length(place) * pixels as f32;
            }
        });
        for_each_of(&mut self.seen, &projected.gaussian, |place, seen| {
            *seen += u32::from(is_sound(place));
        });
    }

    /// Prunes, splits and clones `gaussians`, and resets the statistics. Gaussians outside `bounds` (lowest and highest
    /// corner, metres) are pruned; `gsd_m` is the ground sampling distance, metres.
    pub fn apply(
        &mut self,
        gaussians: &mut Table,
        options: &DensityOptions,
        gsd_m: f32,
        bounds: (Vec3, Vec3),
        seed: u64,
    ) -> Rebuild {
        let keep: Vec<u32> = (0..gaussians.count as u32)
            .filter(|&i| is_kept(gaussians, i as usize, options, gsd_m, bounds))
            .collect();
        let gradient = |i: u32| self.gradient[i as usize] / self.seen[i as usize].max(1) as f32;
        let mut grow: Vec<u32> = keep
            .iter()
            .copied()
            .filter(|&i| gradient(i) > options.gradient_threshold)
            .collect();
        grow.sort_by(|&a, &b| gradient(b).total_cmp(&gradient(a)).then(a.cmp(&b)));
        let room = options
            .cap
            .saturating_sub(keep.len())
            .min((options.growth * keep.len() as f32) as usize);
        grow.truncate(room);
        grow.sort_unstable();

        let pruned = gaussians.count - keep.len();
        let fresh = keep.len();
        let mut sources = keep;
        sources.extend(&grow);
        let mut rebuilt = gaussians.gather(&sources);
        let mut place_of = vec![u32::MAX; gaussians.count];
        for (place, &source) in sources[..fresh].iter().enumerate() {
            place_of[source as usize] = place as u32;
        }
        let mut random = Pcg32::seed_from_u64(seed);
        for (n, &source) in grow.iter().enumerate() {
            split_or_clone(
                &mut rebuilt,
                place_of[source as usize] as usize,
                fresh + n,
                options.split_gsd * gsd_m,
                &mut random,
            );
        }
        *gaussians = rebuilt;
        *self = Self::new(gaussians.count);
        Rebuild { sources, fresh, pruned }
    }
}

fn is_kept(gaussians: &Table, index: usize, options: &DensityOptions, gsd_m: f32, bounds: (Vec3, Vec3)) -> bool {
    let position = gaussians.position(index);
    let inside = position.cmpge(bounds.0).all() && position.cmple(bounds.1).all();
    inside
        && gaussians.opacity(index) > PRUNE_OPACITY
        && gaussians.scale(index).max_element() < options.prune_gsd * gsd_m
}

/// Makes two Gaussians of one. One whose longest standard deviation exceeds `split_m` metres is split along that axis;
/// a smaller one is cloned in place, and both copies get the opacity that keeps their joint absorption equal to the
/// original's.
fn split_or_clone(table: &mut Table, old: usize, new: usize, split_m: f32, random: &mut Pcg32) {
    let scale = table.scale(old);
    let longest = if scale.x >= scale.y && scale.x >= scale.z {
        0
    } else if scale.y >= scale.z {
        1
    } else {
        2
    };
    let axis = table.rotation(old).col(longest);
    let (offset, shrink) = if scale[longest] > split_m {
        (axis * (0.5 * scale[longest]), 0.6f32.ln())
    } else {
        let jitter = 0.1 * (random.random::<f32>() - 0.5);
        let opacity = table.opacity(old);
        let half = crate::gaussians::logit((1.0 - (1.0 - opacity).max(1e-4).sqrt()).clamp(1e-4, 0.9999));
        table.group_mut(OPACITY)[old] = half;
        table.group_mut(OPACITY)[new] = half;
        (axis * (jitter * scale[longest]), 0.0)
    };
    for (element, sign) in [(old, 1.0), (new, -1.0)] {
        for k in 0..3 {
            table.group_mut(POSITION)[element * 3 + k] += sign * offset[k];
        }
        table.group_mut(LOG_SCALE)[element * 3 + longest] += shrink;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::{ROTATION, core_groups, logit};

    fn table() -> Table {
        let mut table = Table::zeros(core_groups(), 3);
        for i in 0..3 {
            table.group_mut(ROTATION)[i * 4 + 3] = 1.0;
            table.group_mut(OPACITY)[i] = logit(0.5);
            table.group_mut(POSITION)[i * 3] = i as f32;
        }
        table
    }

    const BOUNDS: (Vec3, Vec3) = (Vec3::splat(-100.0), Vec3::splat(100.0));

    #[test]
    fn transparent_gaussians_are_pruned_and_those_with_large_gradients_split() {
        let mut gaussians = table();
        gaussians.group_mut(OPACITY)[1] = logit(0.001);
        let mut statistics = DensityStatistics::new(3);
        statistics.gradient = vec![0.0, 9.0, 9.0];
        statistics.seen = vec![1; 3];
        let options = DensityOptions {
            growth: 1.0,
            ..DensityOptions::default()
        };
        let rebuild = statistics.apply(&mut gaussians, &options, 0.5, BOUNDS, 1);
        assert_eq!(
            rebuild,
            Rebuild {
                sources: vec![0, 2, 2],
                fresh: 2,
                pruned: 1
            }
        );
        assert_eq!(gaussians.count, 3);
        // The pair is on both sides of the original position.
        let (a, b) = (gaussians.position(1), gaussians.position(2));
        assert!(a != b && ((a + b) * 0.5 - Vec3::new(2.0, 0.0, 0.0)).length() < 1e-6);
    }

    #[test]
    fn the_cap_holds() {
        let mut gaussians = table();
        let mut statistics = DensityStatistics::new(3);
        statistics.gradient = vec![9.0; 3];
        statistics.seen = vec![1; 3];
        let options = DensityOptions {
            growth: 10.0,
            cap: 4,
            ..DensityOptions::default()
        };
        statistics.apply(&mut gaussians, &options, 0.5, BOUNDS, 1);
        assert_eq!(gaussians.count, 4);
    }
}
