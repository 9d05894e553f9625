//! The common ground of a scene's images, for the plane sweep and for tie points.

use super::error::SatelliteError;
use heliosplat::Raster;
use heliosplat_grid::statistics::upper_quantile;
use heliosplat_products::change::day_of;
use heliosplat_raster::Window;
use heliosplat_rpc::LocalFrame;
use heliosplat_rpc::parallax::LEAST_BASE_TO_HEIGHT;
use heliosplat_scene::crop;
use heliosplat_scene::{Area, ImageSun, Scene, SceneImage};
use heliosplat_stereo::{
    MatchingFacts, MatchingParameters, PlaneSweepRequest, SearchVolume, SweepView, ViewGeometry, Widest, widest_base,
};

/// Margin of the ground around the area, metres: shadows fall into it, and ties near the edge have a surface.
pub const MARGIN_M: f64 = 4.0;

/// Ground and the images that show it.
pub struct GroundViews<'a> {
    /// Images that show the ground.
    pub images: Vec<&'a SceneImage>,
    /// Crop of each image that shows the ground.
    pub crops: Vec<Window>,
    /// Ground, metres of the scene's frame.
    pub area: Area,
    /// Lowest and highest altitude, metres of the scene's frame.
    pub up_m: (f64, f64),
    /// Frame of the scene.
    pub frame: &'a LocalFrame,
    /// Sun of each image.
    suns: Vec<ImageSun>,
    groups: Vec<u32>,
}

impl<'a> GroundViews<'a> {
    /// Ground of `scene`, grown by [`MARGIN_M`], and those of `images` that show it.
    ///
    /// # Errors
    /// When fewer than two images show the ground, or all of them look from one place.
    pub fn new(scene: &'a Scene, images: impl Iterator<Item = &'a SceneImage>) -> Result<Self, SatelliteError> {
        Self::over(scene, crop::grown(&scene.area, MARGIN_M), images)
    }

    /// Ground `area` (metres of the scene's frame), and those of `images` that show it.
    ///
    /// # Errors
    /// When fewer than two images show the ground, or all of them look from one place.
    pub fn over(
        scene: &'a Scene,
        area: Area,
        images: impl Iterator<Item = &'a SceneImage>,
    ) -> Result<Self, SatelliteError> {
        let up_m = crop::altitude_range(scene);
        let (images, crops): (Vec<&SceneImage>, Vec<Window>) = images
            .filter_map(|image| Some((image, crop::window_of(image, &area, up_m)?)))
            .unzip();
        if images.len() < 2 {
            return Err(SatelliteError::too_few_views(images.len()));
        }
        let ground = Self {
            groups: crop::date_groups(&images),
            suns: images.iter().map(|image| image.sun).collect(),
            images,
            crops,
            area,
            up_m,
            frame: &scene.frame,
        };
        ground.check_parallax()?;
        Ok(ground)
    }

    /// Refuses images that all look from one place.
    fn check_parallax(&self) -> Result<(), SatelliteError> {
        let shifts = vec![[0.0; 2]; self.images.len()];
        let centre = volume(&self.area, self.up_m, 1.0).centre();
        let Widest { views, base_to_height } = widest_base(&self.geometries(&shifts), centre);
        if f64::from(base_to_height) >= LEAST_BASE_TO_HEIGHT {
            return Ok(());
        }
        let [first, second] = views.map(|view| self.images[view].path.display());
        Err(SatelliteError::Input(format!(
            "no parallax: {first} and {second} look from one place (base-to-height ratio {base_to_height:.4}) and no two images of the ground from {LEAST_BASE_TO_HEIGHT} apart; give images from other directions"
        )))
    }

    /// Replaces the suns, one for each image; returns true if they group the images into other passes.
    pub(super) fn take_suns(&mut self, suns: Vec<ImageSun>) -> bool {
        let times = self.images.iter().map(|image| image.time);
        let lights: Vec<_> = times.zip(suns.iter().map(|sun| sun.position)).collect();
        let groups = std::mem::replace(&mut self.groups, crop::lights_in_groups(&lights));
        self.suns = suns;
        groups != self.groups
    }

    /// Day of each image, in days since 1970; `None` where an image has no time.
    pub(super) fn days(&self) -> Option<Vec<i32>> {
        self.images.iter().map(|image| image.time.map(day_of)).collect()
    }

    /// Pixels of each crop.
    pub fn rasters(&self) -> Vec<Raster> {
        let crops = self.images.iter().zip(&self.crops);
        crops.map(|(image, crop)| crop.cut(&image.pixels)).collect()
    }

    /// Number of pixels of each crop.
    pub(super) fn pixels(&self) -> Vec<usize> {
        self.crops.iter().map(|crop| crop.width * crop.height).collect()
    }

    /// Refuses an image whose crop has no contrast: nearly all of its pixels have one value in every band. Crops
    /// without any known pixel are accepted.
    ///
    /// # Errors
    /// `SatelliteError::Input` for the first such image.
    pub(super) fn check_contrast(&self, rasters: &[Raster]) -> Result<(), SatelliteError> {
        let flat = self.images.iter().zip(rasters).find(|(_, raster)| is_flat(raster));
        flat.map_or(Ok(()), |(image, _)| {
            Err(SatelliteError::Input(format!(
                "{}: the ground that the images have in common has no contrast in it: nearly all of its pixels have one value; take the image out of the scene",
                image.path.display()
            )))
        })
    }

    /// Viewing geometries and suns of the crops, with the cameras moved by `shifts` (columns, rows; pixels).
    fn geometries(&self, shifts: &[[f32; 2]]) -> Vec<ViewGeometry> {
        (0..self.images.len())
            .map(|i| ViewGeometry {
                camera: crop::camera(&self.images[i].pinhole.map, &self.crops[i], shifts[i]),
                date_group: self.groups[i],
                sun: crop::direction(&self.suns[i]),
            })
            .collect()
    }

    /// Views of the crops with their pixels, and with the cameras moved by `shifts` (columns, rows; pixels).
    pub fn sweep_views<'r>(&self, rasters: &'r [Raster], shifts: &[[f32; 2]]) -> Vec<SweepView<'r>> {
        let geometries = self.geometries(shifts).into_iter().zip(rasters);
        geometries
            .map(|(geometry, image)| SweepView {
                camera: geometry.camera,
                image,
                index: None,
                date_group: geometry.date_group,
                sun: geometry.sun,
            })
            .collect()
    }

    /// Vegetation index of each crop; `None` where an image lacks the bands. It separates leaves from pavement of the
    /// same brightness, and hardly depends on shadows.
    pub fn vegetation_indices(&self, rasters: &[Raster]) -> Option<Vec<Raster>> {
        let index = |(image, raster): (&&SceneImage, &Raster)| {
            let index = image.vegetation_index()?;
            let plane = raster.plane_len();
            let values = (0..plane).map(|pixel| index.of(|band| raster.values[band * plane + pixel]));
            Some(Raster::of_plane(raster.width, raster.height, values.collect()))
        };
        self.images.iter().zip(rasters).map(index).collect()
    }

    /// Search volume of a plane sweep with cells of `cell_m` metres.
    pub fn volume(&self, cell_m: f64) -> SearchVolume {
        volume(&self.area, self.up_m, cell_m)
    }

    /// Input for the choice of the matching parameters, with cells of `cell_m` metres, from the cameras as delivered:
    /// pointing corrections do not change viewing directions.
    pub fn matching_facts(&self, cell_m: f64) -> MatchingFacts {
        let shifts = vec![[0.0; 2]; self.images.len()];
        let has_index = self.images.iter().all(|image| image.vegetation_index().is_some());
        MatchingFacts::new(&self.geometries(&shifts), &self.volume(cell_m), has_index)
    }

    /// Largest base-to-height ratio of two of the images.
    pub fn widest_base_to_height(&self) -> f64 {
        let shifts = vec![[0.0; 2]; self.images.len()];
        let centre = volume(&self.area, self.up_m, 1.0).centre();
        widest_base(&self.geometries(&shifts), centre).base_to_height.into()
    }

    /// Request for a plane sweep with cells of `cell_m` metres.
    pub fn request(&self, cell_m: f64, parameters: MatchingParameters) -> PlaneSweepRequest {
        let volume = self.volume(cell_m);
        PlaneSweepRequest {
            centre: volume.centre(),
            volume,
            parameters,
        }
    }
}

/// Search volume over `area` between two altitudes (metres of the scene's frame), with edges on multiples of `cell_m`.
pub(super) fn volume(area: &Area, up_m: (f64, f64), cell_m: f64) -> SearchVolume {
    let snapped = |v: f64| (v / cell_m).round() * cell_m;
    SearchVolume {
        west_m: snapped(area.west_m) as f32,
        south_m: snapped(area.south_m) as f32,
        east_m: snapped(area.east_m) as f32,
        north_m: snapped(area.north_m) as f32,
        cell_m: cell_m as f32,
        altitude_min_m: up_m.0 as f32,
        altitude_max_m: up_m.1 as f32,
    }
}

/// Share of an image's pixels at each end of their values that does not count as contrast.
const TAIL: f64 = 0.01;
/// Approximate number of pixels sampled for the contrast of an image.
const CONTRAST_PIXELS: usize = 1 << 16;

/// True if nearly all known pixels have one value, in every band.
fn is_flat(raster: &Raster) -> bool {
    let step = (raster.width * raster.height / CONTRAST_PIXELS).max(1);
    let spread = |band: usize| {
        let known = raster
            .plane(band)
            .iter()
            .step_by(step)
            .filter(|value| value.is_finite());
        let mut values: Vec<f32> = known.copied().collect();
        Some(upper_quantile(&mut values, 1.0 - TAIL)? - upper_quantile(&mut values, TAIL)?)
    };
    (0..raster.bands).all(|band| spread(band) == Some(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_is_flat_only_where_hardly_a_pixel_differs() {
        let mut raster = Raster::filled(40, 50, 2, 0.3);
        assert!(is_flat(&raster));
        // Hot pixels are no contrast; a street of thirty pixels is.
        raster.values[7] = 0.9;
        assert!(is_flat(&raster));
        raster.values[100..130].fill(0.1);
        assert!(!is_flat(&raster));
        assert!(!is_flat(&Raster::filled(40, 50, 2, f32::NAN)), "nothing is known of it");
    }
}
