//! Images whose tie points contradict their cameras.

use heliosplat_rpc::adjust::{Adjustment, FEWEST_SIGHTINGS};
use heliosplat_scene::SceneImage;

/// Share of an image's tie points that agree with the other images; below it, they agree by chance.
const LEAST_AGREEING: f64 = 0.3;
/// Raw cameras of vendors are off by up to this, pixels; an adjustment that moves one further has matched something
/// else, or the camera is that of another image.
const FARTHEST_PX: f64 = 10.0;

/// One flag per image, true if its ties contradict its camera. Warns of these, and of corrections beyond `FARTHEST_PX`.
pub(crate) fn contradicting(images: &[&SceneImage], adjustment: &Adjustment) -> Vec<bool> {
    let ties = adjustment.images.iter().zip(&adjustment.corrections);
    let mut found = Vec::with_capacity(images.len());
    for (image, (ties, correction)) in images.iter().zip(ties) {
        let few = ties.good < FEWEST_SIGHTINGS || (ties.good as f64) < LEAST_AGREEING * ties.sightings as f64;
        let moved_px = correction.shift_px[0].hypot(correction.shift_px[1]);
        if few {
            tracing::warn!(
                "{}: its camera contradicts the others ({} good tie points of {}); give the camera of these pixels, or take \
                 the image out of the scene",
                image.name,
                ties.good,
                ties.sightings
            );
        } else if moved_px > FARTHEST_PX {
            tracing::warn!(
                "{}: its camera had to be moved by {moved_px:.1} px, more than the {FARTHEST_PX:.0} px that cameras of vendors are off; is \
                 it the camera of this image?",
                image.name
            );
        }
        found.push(few);
    }
    found
}
