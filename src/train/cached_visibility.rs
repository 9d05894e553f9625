//! Visibility of the light cached between visits of a view: tracing is the dearest part of a step, and visibility changes slowly.
//! A step with cached visibility has no gradients along the light.

/// A view's transmittances toward its light from an earlier step, by Gaussian.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct CachedVisibility {
    /// Transmittances, 0 to 1; Gaussians that the view did not show count as lit.
    pub(super) values: Vec<f32>,
    /// Steps that have used it, the one that traced it included.
    pub(super) uses: usize,
}

impl CachedVisibility {
    /// Whether one more step may use it, where one trace is for `light_every` steps of the view.
    pub(super) fn is_fresh(&self, light_every: usize) -> bool {
        self.uses < light_every
    }
}
