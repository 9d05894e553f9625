//! Light of earlier steps that still serves.

/// A view's transmittances of an earlier step, by Gaussian.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(super) struct KnownLight {
    /// Transmittances; what the view did not show counts as lit.
    pub(super) values: Vec<f32>,
    /// Visits it has served.
    pub(super) visits: usize,
}

impl KnownLight {
    /// Whether it serves one visit more where a trace serves `light_every` of them.
    pub(super) fn serves(&self, light_every: usize) -> bool {
        self.visits < light_every
    }
}
