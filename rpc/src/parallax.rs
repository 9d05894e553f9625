//! Precision of altitudes from images of different directions.
//!
//! A pair of images whose rays part by `b` metres per metre of altitude (the base-to-height ratio) turns an error of
//! matching of `e` metres on the ground into one of `e / b` in altitude.

/// Error of matching between two images, pixels: residual pointing error and sub-pixel error (docs/lab/known.md).
pub const MATCHING_PX: f64 = 0.2;

/// Least base-to-height ratio of two images with usable parallax. Below it, [`MATCHING_PX`] is an error of more than
/// ten pixels in altitude: more than the height of houses and trees.
pub const LEAST_BASE_TO_HEIGHT: f64 = 0.02;
