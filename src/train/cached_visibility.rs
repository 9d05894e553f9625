//! Visibility of the light cached between visits of a view: tracing is the most expensive part of a step, and
//! visibility changes slowly. A step with cached visibility has no gradients along the light.

use crate::gaussians::for_each_of;

/// Share of the mean non-zero gradient below which a gradient is negligible. A quarter to two fifths of a view's splats
/// are below it; about half would be below 0.3 (docs/lab/speed.md).
const NEGLIGIBLE: f64 = 0.1;

/// A view's transmittances toward its light from an earlier step, by Gaussian.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct CachedVisibility {
    /// Transmittances, 0 to 1; Gaussians that the view did not show count as lit.
    pub(super) values: Vec<f32>,
    /// Number of steps that have used the cache, including the one that traced it.
    pub(super) uses: usize,
    /// Flag per Gaussian, true if its light hardly changed the image of the view at the last trace.
    negligible: Vec<bool>,
    /// Number of traces of this view before this one, since the number of Gaussians changed.
    traces: usize,
}

impl CachedVisibility {
    /// True if every list has an entry for each of `count` Gaussians.
    pub(super) fn is_of(&self, count: usize) -> bool {
        self.values.len() == count && self.negligible.len() == count
    }

    /// Cache of a traced step: the `transmittances` of the `splats` (Gaussians, ascending) of `count` Gaussians, and
    /// the loss's gradients to them. `before` is the view's earlier cache.
    pub(super) fn traced(
        (splats, count): (&[u32], usize),
        transmittances: &[f32],
        gradients: &[f32],
        before: Option<&Self>,
    ) -> Self {
        let sizes = || gradients.iter().map(|d| f64::from(d.abs())).filter(|d| *d > 0.0);
        let bound = NEGLIGIBLE * sizes().sum::<f64>() / sizes().count().max(1) as f64;
        // Gaussians that this view does not show count as lit until the next trace.
        let (mut values, mut negligible) = (vec![1.0; count], vec![false; count]);
        for_each_of(&mut values, splats, |place, value| *value = transmittances[place]);
        for_each_of(&mut negligible, splats, |place, negligible| {
            *negligible = f64::from(gradients[place].abs()) < bound
        });
        Self {
            values,
            uses: 1,
            negligible,
            traces: before.map_or(0, |before| before.traces + 1),
        }
    }

    /// The cache after one more step that used it.
    pub(super) fn used(self) -> Self {
        Self {
            uses: self.uses + 1,
            ..self
        }
    }

    /// True if one more step may use the cache, when a view is traced once in `light_every` steps.
    pub(super) fn is_fresh(&self, light_every: usize) -> bool {
        self.uses < light_every
    }

    /// Flag per Gaussian, true if it keeps its light at the next trace: while its light is negligible, a Gaussian takes
    /// part in one trace of `every`, in turns. `None` if all take part.
    pub(super) fn kept(&self, every: usize) -> Option<Vec<bool>> {
        let kept =
            |(gaussian, &negligible): (usize, &bool)| negligible && !(gaussian + self.traces).is_multiple_of(every);
        (every > 1).then(|| self.negligible.iter().enumerate().map(kept).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_that_hardly_matters_is_traced_in_turns_and_the_rest_always() {
        let splats = [0, 2, 3, 5];
        let gradients = [1.0, 0.01, -2.0, 0.0];
        let mut cached = CachedVisibility::traced((&splats, 6), &[0.5; 4], &gradients, None);
        assert_eq!(cached.values, [0.5, 1.0, 0.5, 0.5, 1.0, 0.5]);
        assert!(cached.kept(1).is_none());
        let mut traced = [0; 6];
        for _ in 0..8 {
            let kept = cached.kept(4).expect("some may be kept");
            for (traced, kept) in traced.iter_mut().zip(kept) {
                *traced += usize::from(!kept);
            }
            cached = CachedVisibility::traced((&splats, 6), &[0.5; 4], &gradients, Some(&cached));
        }
        // A Gaussian is traced when it comes into view.
        assert_eq!(traced, [8, 8, 2, 8, 8, 2]);
    }
}
