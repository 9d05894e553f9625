//! Correction of an image's camera as a function of the image position alone, the result of an adjustment.

use crate::rpc::ImagePoint;

/// Error model of an image's camera.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BiasModel {
    /// A shift of the whole image.
    #[default]
    Translation,
    /// A shift that changes linearly over the image: rotation, scale, drift.
    Affine,
    /// A shift that changes linearly along the rows of the images whose ties show it, and a shift of each other image.
    #[cfg_attr(feature = "clap", value(skip))]
    Drift,
}

/// Offset of a camera's projections.
///
/// With `u` and `v` the column and row from [`Self::centre`] in units of [`Self::half_side_px`]:
/// `col += shift_px[0] + slope_px[0][0] u + slope_px[0][1] v`, `row` likewise with the second entries.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Correction {
    /// Offset of columns and rows at the centre, pixels.
    pub shift_px: [f64; 2],
    /// Change of the correction of columns (first) and rows (second) from the centre to the edge, along columns and
    /// rows, pixels.
    pub slope_px: [[f64; 2]; 2],
    /// The image's centre, pixels; with a drift its row is the middle of the rows that ties show.
    pub centre: ImagePoint,
    /// Half the image's longer side, pixels; with a drift half the length of the rows that ties show.
    pub half_side_px: f64,
}

impl Correction {
    /// A correction of zero for an image of `width` by `height` pixels.
    pub fn none(width: usize, height: usize) -> Self {
        Self {
            shift_px: [0.0; 2],
            slope_px: [[0.0; 2]; 2],
            centre: ImagePoint::new((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0),
            half_side_px: (width.max(height) as f64 / 2.0).max(1.0),
        }
    }

    /// Offset at a projected position: columns and rows, pixels.
    pub fn at(&self, projected: ImagePoint) -> [f64; 2] {
        let [u, v] = self.half_sides_from_centre(projected);
        [0, 1].map(|axis| self.shift_px[axis] + self.slope_px[axis][0] * u + self.slope_px[axis][1] * v)
    }

    /// Corrected position: `projected` plus its offset.
    pub fn apply(&self, projected: ImagePoint) -> ImagePoint {
        let [col, row] = self.at(projected);
        ImagePoint::new(projected.col + col, projected.row + row)
    }

    /// True if the offset is constant over the image.
    pub fn is_translation(&self) -> bool {
        self.slope_px == [[0.0; 2]; 2]
    }

    /// Column and row from the centre, in units of `half_side_px`.
    pub(super) fn half_sides_from_centre(&self, at: ImagePoint) -> [f64; 2] {
        [
            (at.col - self.centre.col) / self.half_side_px,
            (at.row - self.centre.row) / self.half_side_px,
        ]
    }
}
