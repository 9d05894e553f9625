//! Two images with each other's cameras: their ties agree better once the cameras are exchanged.
//!
//! Cameras of like views pass the other checks, since their ties fit to a fraction of a pixel, and the surface is wrong
//! by metres. Each pair of images is therefore adjusted once with exchanged cameras too, and the likelihoods of both
//! adjustments are compared. Residuals count by their Cauchy likelihood: neither hypothesis gains by rejecting
//! sightings.

use super::solution::{AdjustOptions, Adjustment};
use super::{AdjustImage, BiasModel, Track, adjust, pixels_per_metre};
use crate::frame::LocalFrame;
use crate::rpc::{GeoPoint, Rpc};
use nalgebra::Vector3;

/// Most tracks that are compared.
const MOST_TRACKS: usize = 200;
/// Images of the most similar directions with which an image is compared: cameras of unlike views cannot be exchanged
/// unnoticed.
const LIKE_VIEWS: usize = 4;
/// Sightings with errors in common, on average: shadows and surfaces that move the ties of neighbours alike.
const COMMON_ERRORS: f64 = 3.0;

/// Two images whose ties agree better with exchanged cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exchange {
    /// Indices of the images, the lower first.
    pub images: [usize; 2],
    /// Standard deviation of a good sighting with the cameras as delivered and exchanged, pixels.
    pub sigma_px: [f64; 2],
}

/// The two images whose cameras are most likely exchanged, if the logarithm of the likelihoods' ratio exceeds that of
/// the number of hypotheses and sightings (as in the criterion of Schwarz 1978). `None` also where the ties are too few
/// for an adjustment, and for two images alone, of which each camera explains the ties. `frame` is any local frame
/// near the tracks.
pub fn exchange(images: &[AdjustImage], tracks: &[Track], frame: &LocalFrame) -> Option<Exchange> {
    if images.len() < 3 {
        return None;
    }
    let some: Vec<Track> = tracks.iter().step_by(tracks.len() / MOST_TRACKS + 1).cloned().collect();
    let model = BiasModel::Translation;
    let options = AdjustOptions {
        model,
        ..AdjustOptions::default()
    };
    let delivered = adjust(images, &some, frame, options).ok()?;
    let middle = middle(&delivered.points, frame);
    let pairs = like_views(images, frame, middle);
    let sightings = delivered.residuals.len() as f64;
    let enough = COMMON_ERRORS * (sightings * pairs.len() as f64).ln();
    let cost = |adjustment: &Adjustment| -> f64 {
        let squares = adjustment.residuals.iter().map(|residual| {
            let [col, row] = residual.after_px.map(|px| px / delivered.sigma_px);
            col * col + row * row
        });
        squares.map(f64::ln_1p).sum()
    };
    let before = cost(&delivered);
    let gains = pairs.into_iter().filter_map(|[a, b]| {
        let moved = |image: usize, camera: usize| in_place_of(images[image].rpc, images[camera].rpc, frame, middle);
        let (of_a, of_b) = (moved(a, b), moved(b, a));
        let mut exchanged = images.to_vec();
        exchanged[a].rpc = &of_a;
        exchanged[b].rpc = &of_b;
        let found = adjust(&exchanged, &some, frame, options).ok()?;
        let sigma_px = [delivered.sigma_px, found.sigma_px];
        Some((
            before - cost(&found),
            Exchange {
                images: [a, b],
                sigma_px,
            },
        ))
    });
    let (gain, best) = gains.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let [delivered_px, exchanged_px] = best.sigma_px;
    (gain > enough && exchanged_px < delivered_px).then_some(best)
}

/// Mean of the points, metres east, north and up.
fn middle(points: &[GeoPoint], frame: &LocalFrame) -> Vector3<f64> {
    let sum: Vector3<f64> = points.iter().map(|point| frame.enu_from_geo(*point)).sum();
    sum / points.len().max(1) as f64
}

/// Pairs of an image and one of those that see the ground from the most similar directions, the lower index first.
fn like_views(images: &[AdjustImage], frame: &LocalFrame, middle: Vector3<f64>) -> Vec<[usize; 2]> {
    let toward: Vec<Vector3<f64>> = images
        .iter()
        .map(|image| {
            // The direction along which a point does not move in the image.
            let slope = pixels_per_metre(image.rpc, frame, middle);
            slope.row(0).transpose().cross(&slope.row(1).transpose()).normalize()
        })
        .collect();
    let mut pairs = Vec::new();
    for (a, direction) in toward.iter().enumerate() {
        let mut others: Vec<usize> = (0..toward.len()).filter(|&b| b != a).collect();
        let likeness = |b: usize| direction.dot(&toward[b]).abs();
        others.sort_by(|&b, &c| likeness(c).total_cmp(&likeness(b)));
        pairs.extend(others.into_iter().take(LIKE_VIEWS).map(|b| [a.min(b), a.max(b)]));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// `camera`, shifted so that it sees the middle where `delivered` does: windows of the files have different corners.
fn in_place_of(delivered: &Rpc, camera: &Rpc, frame: &LocalFrame, middle: Vector3<f64>) -> Rpc {
    let point = frame.geo_from_enu(middle);
    let (from, to) = (camera.project(point), delivered.project(point));
    camera.cropped(from.col - to.col, from.row - to.row)
}
