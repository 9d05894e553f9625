//! Indices of two bands, and where on them vegetation begins.

/// Vegetation index above which a pixel is taken for vegetation.
pub const VEGETATION_INDEX: f32 = 0.3;

/// Less light than this says nothing of colour.
const DARKEST: f32 = 1e-3;

/// `(a - b) / (a + b)` of two bands, near zero where both are dark: of near infrared and red the normalised difference vegetation index
/// (Rouse et al. 1974), of green and near infrared the water index (McFeeters 1996). Of reflectance where gains are known, else of the
/// values as they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalisedDifference {
    first: Term,
    second: Term,
}

/// A band of an index, and how its values become what the index compares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Term {
    pub(super) band: usize,
    pub(super) scale: f32,
    pub(super) offset: f32,
}

impl NormalisedDifference {
    pub(super) fn new(first: Term, second: Term) -> Self {
        Self { first, second }
    }

    /// The index of a pixel, of which `value` tells the value of each band.
    #[inline]
    pub fn of(&self, value: impl Fn(usize) -> f32) -> f32 {
        let [a, b] = [self.first, self.second].map(|term| term.scale * value(term.band) + term.offset);
        (a - b) / (a + b).max(DARKEST)
    }
}
