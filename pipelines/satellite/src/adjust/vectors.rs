//! Residuals of an adjustment, image by image, for a plot.

use crate::ground::GroundViews;
use heliosplat_rpc::adjust::{Adjustment, ImageResiduals, ResidualVector};

/// Residuals of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageVectors {
    /// Name of the image.
    pub name: String,
    /// Width of the image, pixels.
    pub width: usize,
    /// Height of the image, pixels.
    pub height: usize,
    /// Statistics of the residuals.
    pub residuals: ImageResiduals,
    /// All residuals, outliers included.
    pub vectors: Vec<ResidualVector>,
}

/// Residuals of each image of `ground`, in its order.
pub(super) fn image_vectors(ground: &GroundViews, adjustment: &Adjustment) -> Vec<ImageVectors> {
    let images = ground.images.iter().zip(&adjustment.images).enumerate();
    let of_image = |place: usize| {
        let all = adjustment.residuals.iter();
        all.filter(move |residual| residual.image == place).copied().collect()
    };
    images
        .map(|(place, (image, residuals))| ImageVectors {
            name: image.name.clone(),
            width: image.pixels.width,
            height: image.pixels.height,
            residuals: *residuals,
            vectors: of_image(place),
        })
        .collect()
}
