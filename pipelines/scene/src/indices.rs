//! Indices of bands, and their thresholds for vegetation.

use super::BandKind;

/// Least normalised difference vegetation index of vegetation.
pub const VEGETATION_INDEX: f32 = 0.3;
/// Least excess green of vegetation.
pub const VEGETATION_GREEN: f32 = 0.08;

/// Least sum of two values with a meaningful index.
const DARKEST: f32 = 1e-3;

/// Normalised difference `(a - b) / (a + b)` of two bands, near zero where both are dark: the vegetation index of near
/// infrared and red (Rouse et al. 1974), or the water index of green and near infrared (McFeeters 1996). It is computed
/// from reflectance where gains are known, else from the values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalisedDifference {
    first: Term,
    second: Term,
}

/// Band of an index, with the conversion of its values: `scale · value + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Term {
    /// Place of the band, from 0.
    pub(super) band: usize,
    /// Factor of the value.
    pub(super) scale: f32,
    /// Offset of the result.
    pub(super) offset: f32,
}

impl NormalisedDifference {
    pub(super) fn new(first: Term, second: Term) -> Self {
        Self { first, second }
    }

    /// Value of the index for one pixel; `value` returns the value of a band by its place.
    #[inline]
    pub fn of(&self, value: impl Fn(usize) -> f32) -> f32 {
        let [a, b] = [self.first, self.second].map(|term| term.scale * value(term.band) + term.offset);
        (a - b) / (a + b).max(DARKEST)
    }
}

/// Excess green `(2g - r - b) / (r + g + b)` of red, green and blue, near zero where all are dark (Woebbecke et al.,
/// Color indices for weed identification, Transactions of the ASAE 38, 1995). Red and blue are interchangeable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExcessGreen {
    /// Places of red, green and blue among the bands, from 0.
    places: [usize; 3],
}

impl ExcessGreen {
    /// Excess green for bands of these kinds; `None` where a colour is missing.
    pub fn new(bands: &[BandKind]) -> Option<Self> {
        let place = |kind: BandKind| bands.iter().position(|&band| band == kind);
        let places = [place(BandKind::Red)?, place(BandKind::Green)?, place(BandKind::Blue)?];
        Some(Self { places })
    }

    /// Value of the index for one pixel; `value` returns the value of a band by its place.
    #[inline]
    pub fn of(&self, value: impl Fn(usize) -> f32) -> f32 {
        let [red, green, blue] = self.places.map(value);
        (2.0 * green - red - blue) / (red + green + blue).max(DARKEST)
    }
}

/// The index that separates leaves from pavement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum VegetationIndex {
    /// The normalised difference vegetation index.
    Infrared(NormalisedDifference),
    /// Excess green, where there is no near infrared: lawns and painted roofs have high values, autumn leaves have low
    /// ones.
    Green(ExcessGreen),
}

impl VegetationIndex {
    /// Value of the index for one pixel; `value` returns the value of a band by its place.
    #[inline]
    pub fn of(&self, value: impl Fn(usize) -> f32) -> f32 {
        match self {
            Self::Infrared(index) => index.of(value),
            Self::Green(index) => index.of(value),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use BandKind::{Blue, Green, Red};

    #[test]
    fn excess_green_tells_leaves_from_pavement_in_light_and_shade_and_whichever_way_red_and_blue_lie() {
        let (leaves, pavement) = ([0.05, 0.08, 0.04], [0.3, 0.29, 0.27]);
        for kinds in [[Red, Green, Blue], [Blue, Green, Red]] {
            let index = ExcessGreen::new(&kinds).expect("three colours");
            for light in [1.0, 0.2] {
                assert!(index.of(|band| light * leaves[band]) > VEGETATION_GREEN);
                assert!(index.of(|band| light * pavement[band]) < VEGETATION_GREEN);
            }
            assert_eq!(index.of(|_| 0.0), 0.0);
        }
        assert_eq!(ExcessGreen::new(&[Red, Green]), None);
    }
}
