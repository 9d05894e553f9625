//! Images whose tie points contradict their cameras.

use super::AdjustInput;
use crate::config::{Align, SatelliteConfig};
use crate::ground::{GroundViews, MARGIN_M};
use crate::plan::Decisions;
use heliosplat_grid::statistics::upper_median;
use heliosplat_rpc::adjust::{Adjustment, BiasModel, Exchange, FEWEST_SIGHTINGS, ImageResiduals};
use heliosplat_scene::{Area, Finding, Scene, Severity, crop};

/// Least share of an image's tie points that agree with the other images; fewer may agree by chance.
const LEAST_AGREEING: f64 = 0.3;
/// Largest error of vendors' raw cameras, pixels. An adjustment by more has matched something else, or the camera is
/// that of another image.
const FARTHEST_PX: f64 = 10.0;
/// Least expected number of an image's tie points at which a lack of ties counts against its camera, as a multiple of
/// [`FEWEST_SIGHTINGS`]; the expectation is from the density of ties in the other images.
const ENOUGH: f64 = 4.0;
/// Side of the middle part of a large scene whose ties are searched for a finding, pixels.
const PATCH_PX: f64 = 1000.0;

/// A camera that the ties of its image contradict.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Contradiction {
    /// Index of the image among the images of the ground.
    pub(crate) image: usize,
    /// True if the image is left out: its ties do not agree even with a corrected camera.
    pub(crate) is_out: bool,
    good: usize,
    /// Number of sightings of ties in the image.
    pub(crate) sightings: usize,
    moved_px: f64,
}

impl Contradiction {
    /// One line with image, figures and remedy.
    pub(crate) fn message(&self, name: &str) -> String {
        let (good, sightings, moved_px) = (self.good, self.sightings, self.moved_px);
        match self.is_out {
            true => format!(
                "{name}: its camera contradicts the others ({good} good tie points of {sightings}), and it is left out; give the camera of \
                 these pixels"
            ),
            false if moved_px > FARTHEST_PX => format!(
                "{name}: its camera had to be moved by {moved_px:.1} px, more than the {FARTHEST_PX:.0} px that cameras of vendors are off; \
                 is it the camera of this image?"
            ),
            false => format!(
                "{name}: its camera contradicts the others ({good} good tie points of {sightings}); give the camera of these pixels, or \
                 take the image out of the scene"
            ),
        }
    }
}

/// Share of an image's tie points that agree with the other images, 0..1.
fn share(ties: &ImageResiduals) -> f64 {
    ties.good as f64 / ties.sightings.max(1) as f64
}

fn is_sound(ties: &ImageResiduals) -> bool {
    ties.good >= FEWEST_SIGHTINGS && share(ties) >= LEAST_AGREEING
}

/// Cameras that the ties of their images contradict. `pixels` is the number of pixels of each image on the ground. An
/// image is left out only where two others agree.
pub(crate) fn contradictions(pixels: &[usize], adjustment: &Adjustment) -> Vec<Contradiction> {
    let images = || adjustment.images.iter().zip(pixels);
    let sound = || images().filter(|(ties, _)| is_sound(ties));
    let mut shares: Vec<f64> = sound().map(|(ties, _)| share(ties)).collect();
    let mut densities: Vec<f64> = sound()
        .map(|(ties, &pixels)| ties.good as f64 / pixels.max(1) as f64)
        .collect();
    let usual = upper_median(&mut shares).unwrap_or(0.0);
    let density = upper_median(&mut densities).unwrap_or(0.0);
    let mut found = Vec::new();
    for (image, ((ties, &pixels), correction)) in images().zip(&adjustment.corrections).enumerate() {
        let moved_px = correction.shift_px[0].hypot(correction.shift_px[1]);
        let is_few = !is_sound(ties);
        let is_far = moved_px > FARTHEST_PX;
        if !(is_few || is_far) {
            continue;
        }
        let is_shown = density * pixels as f64 >= ENOUGH * FEWEST_SIGHTINGS as f64;
        // Ties that agree as well as those of other images have found the camera, however far it was off.
        let is_wrong = is_few || share(ties) < usual / 2.0;
        let others = shares.len() - usize::from(!is_few);
        found.push(Contradiction {
            image,
            is_out: is_shown && is_wrong && others >= 2,
            good: ties.good,
            sightings: ties.sightings,
            moved_px,
        });
    }
    // No image is left out where fewer than two would remain.
    if pixels.len() < 2 + found.iter().filter(|contradiction| contradiction.is_out).count() {
        found.iter_mut().for_each(|contradiction| contradiction.is_out = false);
    }
    found
}

/// Warns about contradictions of the images of `ground`; returns a flag for each image, true if it is left out.
pub(crate) fn left_out(ground: &GroundViews, adjustment: &Adjustment) -> Vec<bool> {
    let mut out = vec![false; ground.images.len()];
    for contradiction in contradictions(&ground.pixels(), adjustment) {
        let image = contradiction.image;
        tracing::warn!("{}", contradiction.message(&ground.images[image].name));
        out[image] = contradiction.is_out;
    }
    out
}

/// Findings about contradictions between the training images of a scene, from ties in its middle.
pub fn findings(scene: &Scene, config: &SatelliteConfig) -> Vec<Finding> {
    let decisions = Decisions::of(scene, config);
    let area = middle(crop::grown(&scene.area, MARGIN_M), PATCH_PX * scene.gsd_m);
    let (Ok(ground), Some(matching)) = (GroundViews::over(scene, area, scene.training()), decisions.matching) else {
        return Vec::new();
    };
    // Of two images, neither is known to be wrong.
    if ground.images.len() < 3 || decisions.align == Align::Off {
        return Vec::new();
    }
    let rasters = ground.rasters();
    let input = AdjustInput {
        ground: &ground,
        views: &ground.sweep_views(&rasters, &vec![[0.0; 2]; rasters.len()]),
        cell_m: scene.gsd_m,
        matching,
    };
    let pixels = ground.pixels();
    // Half resolution passes sound scenes in half of the time; a contradiction there is confirmed at full resolution,
    // as in `dsm` and `train`.
    let Some((half, ties)) = input.at_half_resolution().ok().map(|mut found| found.swap_remove(0)) else {
        return Vec::new();
    };
    let exchanged = input.exchange(&ties).map(|exchange| of_exchange(&exchange, &ground));
    let contradicting = match contradictions(&pixels, &half).is_empty() {
        true => Vec::new(),
        false => input
            .adjust(BiasModel::Translation, &|_| {})
            .map_or_else(|_| Vec::new(), |whole| contradictions(&pixels, &whole)),
    };
    let finding = |contradiction: Contradiction| {
        let image = ground.images[contradiction.image];
        let is_moved = !contradiction.is_out && contradiction.moved_px > FARTHEST_PX;
        let agreeing = contradiction.good as f64 / contradiction.sightings.max(1) as f64;
        let (code, value, bound) = match is_moved {
            true => ("camera-far-off", contradiction.moved_px, FARTHEST_PX),
            false => ("camera-contradicts-others", agreeing, LEAST_AGREEING),
        };
        Finding {
            code,
            severity: Severity::Warning,
            images: vec![image.name.clone()],
            files: vec![image.path.clone()],
            value: Some(value),
            bound: Some(bound),
            message: contradiction.message(&image.name),
        }
    };
    exchanged
        .into_iter()
        .chain(contradicting.into_iter().map(finding))
        .collect()
}

/// Finding about two images with each other's cameras.
pub(super) fn of_exchange(exchange: &Exchange, ground: &GroundViews) -> Finding {
    let images = exchange.images.map(|image| ground.images[image]);
    let [delivered_px, exchanged_px] = exchange.sigma_px;
    Finding {
        code: "cameras-exchanged",
        severity: Severity::Warning,
        images: images.map(|image| image.name.clone()).into(),
        files: images.map(|image| image.path.clone()).into(),
        value: Some(delivered_px),
        bound: Some(exchanged_px),
        message: format!(
            "{} and {}: tie points agree to {exchanged_px:.2} px with exchanged cameras, to {delivered_px:.2} px as they are; check that \
             each image has its own camera",
            images[0].name, images[1].name
        ),
    }
}

/// The middle of an area, at most `side_m` metres along each side.
fn middle(area: Area, side_m: f64) -> Area {
    let lengths_m = [area.east_m - area.west_m, area.north_m - area.south_m];
    let [wide_m, high_m] = lengths_m.map(|length_m| length_m.min(side_m) / 2.0);
    let (east, north) = ((area.east_m + area.west_m) / 2.0, (area.north_m + area.south_m) / 2.0);
    Area::new([east - wide_m, north - high_m, east + wide_m, north + high_m])
}
