//! Vegetation index that the plane sweep compares, if there is one.

use heliosplat_scene::indices::VegetationIndex;
use heliosplat_scene::{SceneImage, Values};
use heliosplat_stereo::CENSUS_CELLS;

/// Diameter of the crown of a street tree, metres.
const CROWN_M: f64 = 6.0;

/// Availability and kind of the vegetation index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Index {
    /// No index: near infrared is missing, and at least one of red, green and blue.
    NoBands,
    /// No index: the values are for display.
    ForDisplay,
    /// No index: a window is wider than a crown, so that trees would raise the ground around them.
    Coarse,
    /// Index of counts.
    Counts,
    /// Index of reflectance.
    Reflectance,
    /// Excess green, where near infrared is missing.
    Green,
}

impl Index {
    /// The index that all images support and that helps a sweep with cells of `cell_m` metres (docs/lab/surface.md).
    pub(super) fn of(images: &[&SceneImage], cell_m: f64) -> Self {
        let of = |values: fn(&SceneImage) -> Option<VegetationIndex>| -> Option<Vec<VegetationIndex>> {
            images.iter().map(|image| values(image)).collect()
        };
        let Some(indices) = of(SceneImage::vegetation_index) else {
            return match of(|image| Values::default().vegetation_index(&image.bands)) {
                Some(_) => Self::ForDisplay,
                None => Self::NoBands,
            };
        };
        if CENSUS_CELLS as f64 * cell_m > CROWN_M {
            return Self::Coarse;
        }
        if indices.iter().any(|index| matches!(index, VegetationIndex::Green(_))) {
            return Self::Green;
        }
        match images.iter().all(|image| image.values.reflectance.is_empty()) {
            true => Self::Counts,
            false => Self::Reflectance,
        }
    }

    /// True if there is an index.
    pub(super) fn is_there(self) -> bool {
        matches!(self, Self::Counts | Self::Reflectance | Self::Green)
    }

    /// Availability of the index, in words.
    pub(super) fn reason(self) -> &'static str {
        match self {
            Self::NoBands => {
                "no near infrared and not all three colours in all images: the sweep compares brightness alone"
            }
            Self::ForDisplay => {
                "values are for display: their bands cannot be compared, and the sweep compares brightness alone"
            }
            Self::Coarse => "tree crowns are narrower than the matching window: the sweep compares brightness alone",
            Self::Counts => "red and near infrared: separate leaves from pavement of equal brightness",
            Self::Reflectance => {
                "reflectance of red and near infrared: separates leaves from pavement of equal brightness"
            }
            Self::Green => "no near infrared in all images: excess green separates leaves from pavement",
        }
    }
}
