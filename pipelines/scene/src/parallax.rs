//! Geometry of image pairs: base-to-height ratio and overlap.

use super::{Finding, Scene, SceneImage, Severity};
use heliosplat_grid::statistics::correlation;
use heliosplat_rpc::parallax::MATCHING_PX;
use nalgebra::{Vector2, Vector3};

/// Two training images of a scene.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct ImagePair {
    /// Name of the first image.
    pub a: String,
    /// Name of the second image.
    pub b: String,
    /// Angle between their rays at the scene's centre, degrees.
    pub convergence_deg: f64,
    /// Relative displacement of the two rays per metre of altitude, metres.
    pub base_to_height: f64,
    /// Overlap: ground that both images show over ground that either shows, 0..1; within the scene's area at mid
    /// altitude.
    pub overlap: f64,
}

/// Number of sample places along each side of the area, for the overlap.
const STEPS: usize = 32;

/// Correlation above which patches at equal places of two files are of one picture. A linear stretch of real and generated
/// images to eight bits leaves 0.9998; views of level ground without noise exceed 0.98 (docs/lab/deliveries.md).
const OF_ONE_PICTURE: f64 = 0.9995;
/// Side of such a patch, pixels.
const PATCH_PX: usize = 16;
/// Number of patches along each side of the files' common part.
const PATCHES: usize = 4;

impl SceneImage {
    /// Unit vector of the ray through the scene's centre, from the camera downward, in the scene's frame.
    pub fn ray(&self) -> Vector3<f64> {
        let map = &self.pinhole.map;
        let [col, row] = map.project(Vector3::zeros());
        let along =
            |numerator: &[f64; 4], at: f64| Vector3::from([0, 1, 2].map(|axis| numerator[axis] - at * map.w[axis]));
        // Column and row are constant along a ray, so the ray is normal to both gradients.
        let ray = along(&map.u, col).cross(&along(&map.v, row)).normalize();
        if ray.z > 0.0 { -ray } else { ray }
    }

    /// True if the two files show one picture: of patches at equal places in both, a quarter correlates by more than
    /// [`OF_ONE_PICTURE`]. Another gain, and pixels that one of them lacks, do not hide it.
    fn has_pixels_of(&self, other: &Self) -> bool {
        let (a, b) = (&self.window, &other.window);
        let (col0, row0) = (a.col0.max(b.col0), a.row0.max(b.row0));
        let cols = (a.col0 + a.width).min(b.col0 + b.width).saturating_sub(col0);
        let rows = (a.row0 + a.height).min(b.row0 + b.height).saturating_sub(row0);
        if cols < PATCH_PX || rows < PATCH_PX {
            return false;
        }
        let values = |image: &Self, [col, row]: [usize; 2]| {
            let (col, row) = (col - image.window.col0, row - image.window.row0);
            let places = (row..row + PATCH_PX).flat_map(|row| (col..col + PATCH_PX).map(move |col| [col, row]));
            let sum = |[col, row]: [usize; 2]| {
                (0..image.pixels.bands)
                    .map(|band| image.pixels.at(band, col, row))
                    .sum()
            };
            places.map(sum).collect::<Vec<f32>>()
        };
        let corner = |patch: usize| {
            let along = |free: usize, step: usize| free * (2 * step + 1) / (2 * PATCHES);
            let [across, down] = [
                along(cols - PATCH_PX, patch % PATCHES),
                along(rows - PATCH_PX, patch / PATCHES),
            ];
            [col0 + across, row0 + down]
        };
        let correlated = (0..PATCHES * PATCHES).filter(|&patch| {
            let [a, b] = [self, other].map(|image| values(image, corner(patch)));
            let both = a.into_iter().zip(b).filter(|(a, b)| (a + b).is_finite());
            let both: Vec<(f64, f64)> = both.map(|(a, b)| (a.into(), b.into())).collect();
            let found = correlation(both.iter().copied()).filter(|_| 2 * both.len() >= PATCH_PX * PATCH_PX);
            found.is_some_and(|found| found > OF_ONE_PICTURE)
        });
        4 * correlated.count() >= PATCHES * PATCHES
    }

    /// Displacement of the ray through the scene's centre per metre of altitude, metres east and north.
    fn parallax(&self) -> Vector2<f64> {
        let ray = self.ray();
        ray.xy() / ray.z
    }
}

impl Scene {
    /// All pairs of training images, in the order of the images.
    pub fn pairs(&self) -> Vec<ImagePair> {
        let images: Vec<&SceneImage> = self.training().collect();
        let shown: Vec<Vec<bool>> = images.iter().map(|image| self.shown_by(image)).collect();
        let mut pairs = Vec::with_capacity(images.len() * images.len().saturating_sub(1) / 2);
        for (b, second) in images.iter().enumerate() {
            for (a, first) in images[..b].iter().enumerate() {
                let places = || shown[a].iter().zip(&shown[b]);
                let both = places().filter(|(a, b)| **a && **b).count();
                let either = places().filter(|(a, b)| **a || **b).count();
                pairs.push(ImagePair {
                    a: first.name.clone(),
                    b: second.name.clone(),
                    convergence_deg: first.ray().angle(&second.ray()).to_degrees(),
                    base_to_height: base_to_height(first, second),
                    overlap: both as f64 / either.max(1) as f64,
                });
            }
        }
        pairs
    }

    /// True for each place of a grid over the area, at mid altitude, that the image shows.
    fn shown_by(&self, image: &SceneImage) -> Vec<bool> {
        let along = |low: f64, high: f64, step: usize| low + (high - low) * (step as f64 + 0.5) / STEPS as f64;
        let sees = |i: usize| {
            let east_m = along(self.area.west_m, self.area.east_m, i % STEPS);
            let north_m = along(self.area.south_m, self.area.north_m, i / STEPS);
            image.sees(Vector3::new(east_m, north_m, 0.0))
        };
        (0..STEPS * STEPS).map(sees).collect()
    }

    /// Warns about pairs of training images with equal cameras (over the whole range of altitudes, the parallax between
    /// them is less than matching can measure) and about those with equal pixels under unlike cameras.
    pub(super) fn warn_of_copies(&mut self) {
        let (low_m, high_m) = self.altitude_range_m;
        let measurable = MATCHING_PX * self.gsd_m / (high_m - low_m);
        let mut warned: Vec<String> = Vec::new();
        for pair in self.pairs() {
            let images = [&pair.a, &pair.b].map(|name| self.images.iter().find(|image| image.name == *name));
            let [Some(a), Some(b)] = images else { continue };
            let has_one_camera = pair.base_to_height < measurable && pair.overlap > 0.0;
            let (code, what) = match has_one_camera {
                true => (
                    "same-camera",
                    "have the same camera: no parallax between them, and they count as one view",
                ),
                false if a.has_pixels_of(b) => (
                    "same-pixels",
                    "show the same pixels under unlike cameras: take out the one whose camera is not its own",
                ),
                false => continue,
            };
            if warned.contains(&pair.b) {
                continue;
            }
            let message = format!("{} and {} {what}", pair.a, pair.b);
            self.findings.push(Finding {
                code,
                severity: Severity::Warning,
                files: vec![a.path.clone(), b.path.clone()],
                images: vec![pair.a, pair.b.clone()],
                value: has_one_camera.then_some(pair.base_to_height),
                bound: has_one_camera.then_some(measurable),
                message: message.clone(),
            });
            self.warnings.push(message);
            warned.push(pair.b);
        }
    }
}

fn base_to_height(a: &SceneImage, b: &SceneImage) -> f64 {
    (a.parallax() - b.parallax()).norm()
}
