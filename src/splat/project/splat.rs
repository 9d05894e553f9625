//! The record of a projected Gaussian, its gradient, and the options of projection.

/// Alpha below which a splat does not touch a pixel.
pub const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Alpha above which it saturates (its gradient is then zero).
pub const ALPHA_MAX: f32 = 0.99;
/// Keeps the depth plane of an edge-on disc bounded; pixels². At a standard deviation of one pixel it changes slopes by
/// 5 %.
pub const DEPTH_FILTER_PX2: f32 = 0.05;

/// Options of the projection of Gaussians to splats.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProjectionOptions {
    /// Variance added to the image covariance: the pixel filter, pixels².
    pub filter_px2: f32,
    /// Multiply opacity by `sqrt(det before / det after)` the filter, so that small splats dim instead of growing.
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

/// A projected Gaussian: all that the rasteriser reads, in one record, in one line of the cache.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(align(64))]
pub struct Splat {
    /// Column of the centre, pixels.
    pub col: f32,
    /// Row of the centre, pixels.
    pub row: f32,
    /// Inverse image covariance: `q = conic[0]·x² + 2·conic[1]·x·y + conic[2]·y²`.
    pub conic: [f32; 3],
    /// Opacity at the centre.
    pub opacity: f32,
    /// Depth of the centre, metres from the scene centre along the camera's depth axis.
    pub depth: f32,
    /// Change of depth per column and per row, metres per pixel.
    pub slope: [f32; 2],
    /// `q` beyond which alpha is below [`ALPHA_MIN`].
    pub reach: f32,
    /// Half sizes of the box of that reach, pixels.
    pub half: [f32; 2],
    /// Unit normal of the depth plane, facing the camera.
    pub normal: [f32; 3],
}

/// Gradient of a loss to a [`Splat`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SplatGradient {
    /// To the column.
    pub col: f32,
    /// To the row.
    pub row: f32,
    /// To the conic's three numbers.
    pub conic: [f32; 3],
    /// To the opacity.
    pub opacity: f32,
    /// To the depth.
    pub depth: f32,
    /// To the slopes.
    pub slope: [f32; 2],
    /// To the normal.
    pub normal: [f32; 3],
}
