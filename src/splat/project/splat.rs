//! The record of a projected Gaussian, its gradient, and the options of projection.

/// Alpha below which a splat does not touch a pixel.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Alpha at which a splat saturates; its gradient is zero beyond.
pub const ALPHA_MAX: f32 = 0.99;
/// Variance added to the image covariance for the slopes of the depth plane, pixels². It bounds the slopes of an
/// edge-on disc; at a standard deviation of one pixel it changes slopes by 5 %.
pub const DEPTH_FILTER_PX2: f32 = 0.05;

/// Options of the projection of Gaussians to splats.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProjectionOptions {
    /// Variance added to the image covariance: the pixel filter, pixels².
    pub filter_px2: f32,
    /// True if opacity is multiplied by `sqrt(det before / det after)` the filter, so that small splats dim instead of
    /// growing.
    pub antialias: bool,
}

impl Default for ProjectionOptions {
    fn default() -> Self {
        Self {
            filter_px2: 0.1,
            antialias: true,
        }
    }
}

/// A projected Gaussian: all inputs of the rasteriser in one record, which fits a cache line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(align(64))]
pub struct Splat {
    /// Column of the centre, pixels.
    pub col: f32,
    /// Row of the centre, pixels.
    pub row: f32,
    /// Inverse image covariance: `q = conic[0]·x² + 2·conic[1]·x·y + conic[2]·y²`.
    pub conic: [f32; 3],
    /// Opacity at the centre, 0 to 1.
    pub opacity: f32,
    /// Depth of the centre, metres from the scene centre along the camera's depth axis.
    pub depth: f32,
    /// Change of depth per column and per row, metres per pixel.
    pub slope: [f32; 2],
    /// Value of `q` beyond which alpha is below [`ALPHA_MIN`].
    pub reach: f32,
    /// Half sizes of the box around the ellipse `q = reach`, columns and rows, pixels.
    pub half: [f32; 2],
    /// Unit normal of the depth plane, facing the camera.
    pub normal: [f32; 3],
}

/// Gradient of a loss to a [`Splat`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SplatGradient {
    /// Gradient to the column.
    pub col: f32,
    /// Gradient to the row.
    pub row: f32,
    /// Gradients to the conic's three numbers.
    pub conic: [f32; 3],
    /// Gradient to the opacity.
    pub opacity: f32,
    /// Gradient to the depth.
    pub depth: f32,
    /// Gradients to the slopes.
    pub slope: [f32; 2],
    /// Gradient to the normal.
    pub normal: [f32; 3],
}
