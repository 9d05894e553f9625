//! Cloud masks of a scene's images.

use super::ground::GroundViews;
use heliosplat::Raster;
use heliosplat_stereo::PlaneSweepRequest;
use heliosplat_stereo::clouds::find_clouds;

/// Cloud mask of each crop of `ground`, with the cameras moved by `shifts_px`; a mask is empty where there are no
/// clouds.
pub(super) fn find(
    ground: &GroundViews,
    rasters: &[Raster],
    shifts_px: &[[f32; 2]],
    request: &PlaneSweepRequest,
) -> Vec<Vec<bool>> {
    let mut masks = find_clouds(&ground.sweep_views(rasters, shifts_px), request);
    let clear = masks.iter_mut().filter(|mask| share(mask) == 0.0);
    clear.for_each(Vec::clear);
    masks
}

/// Logs the share of clouds in each crop of `ground`, except for the images that are `left_out` as a whole.
pub(super) fn log_shares(ground: &GroundViews, masks: &[Vec<bool>], left_out: &[bool]) {
    for (place, (mask, image)) in masks.iter().zip(&ground.images).enumerate() {
        let share = 100.0 * share(mask);
        if !mask.is_empty() && left_out.get(place) != Some(&true) {
            tracing::info!("{}: clouds over {share:.1} % are left out", image.name);
        }
    }
}

/// Marks all pixels of the images that are `left_out` as unknown, as clouds are.
pub(super) fn leave_out(rasters: &mut [Raster], masks: &mut [Vec<bool>], left_out: &[bool]) {
    let images = rasters.iter_mut().zip(masks).zip(left_out);
    for ((raster, mask), _) in images.filter(|(_, out)| **out) {
        *mask = vec![true; raster.plane_len()];
        blank(raster, mask);
    }
}

/// Share of a mask's pixels with clouds, 0..1; 0 for an empty mask.
pub(super) fn share(mask: &[bool]) -> f64 {
    mask.iter().filter(|&&cloud| cloud).count() as f64 / mask.len().max(1) as f64
}

/// Marks the pixels of a mask as unknown; an empty mask has none.
pub(super) fn blank(raster: &mut Raster, mask: &[bool]) {
    for band in 0..raster.bands {
        let values = raster.plane_mut(band).iter_mut().zip(mask);
        values
            .filter(|(_, cloud)| **cloud)
            .for_each(|(value, _)| *value = f32::NAN);
    }
}
