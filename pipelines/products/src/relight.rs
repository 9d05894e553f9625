//! The scene under any sun, and its shadow mask.

use super::nadir::NadirGrid;
use super::surface_shadow::SurfaceShadows;
use super::views::camera_of;
use crate::model::LoadedModel;
use heliosplat::gaussians::Table;
use heliosplat::light::Light;
use heliosplat::model::shadow_gs::{SKY, softplus_inverse};
use heliosplat::model::{Context, Parameters, SceneModel};
use heliosplat::render::{Rendering, render};
use heliosplat::splat::Maps;
use heliosplat::timeline;
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_fitting::run_folder::RunError;
use heliosplat_raster::write::{ImageSpec, SampleType, write_cog, write_geotiff};
use heliosplat_raster::{GridSpec, RasterError, preview};
use heliosplat_rpc::sun::SunPosition;
use heliosplat_scene::crop;
use std::path::{Path, PathBuf};

/// Reason that a scene cannot be relit.
#[derive(Debug, thiserror::Error)]
pub enum RelightError {
    /// A sun, a view or a model that cannot be used, with the remedy.
    #[error("{0}")]
    Refused(String),
    /// The run cannot be used.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A file cannot be written.
    #[error(transparent)]
    Raster(#[from] RasterError),
}

impl RelightError {
    /// True if the input of the user is at fault, and not the machine.
    pub fn is_input_fault(&self) -> bool {
        match self {
            Self::Run(error) => error.is_input_fault(),
            Self::Raster(error) => error.is_input_fault(),
            Self::Refused(_) => true,
        }
    }
}

/// Least elevation of the sun for relighting, degrees: below it shadows are longer than any site.
pub const LOWEST_SUN_DEG: f64 = 1.0;

/// Weight of the visibility over the surface model, beside that through the Gaussians: under high suns, and under low
/// ones, whose rays graze the Gaussians of level ground and roofs and meet some.
const OVER_SURFACE: [f32; 2] = [0.4, 0.8];
/// Elevations of the sun that are high and low, degrees.
const HIGH_AND_LOW_DEG: [f64; 2] = [20.0, 4.0];
/// Visibility below which a pixel is in shadow, traced through the Gaussians alone.
const SHADED_BELOW: f32 = 0.5;
/// Visibility below which a cell is in shadow in the mean of both traces, which misses shadow more often than it
/// invents some.
const SHADED_BELOW_IN_THE_MEAN: f32 = 0.6;

/// A relit view.
pub struct Relit {
    /// Colours in the units of the images' counts.
    pub image: Raster,
    /// Visibility of the sun from each pixel, 0 to 1.
    pub visibility: Raster,
    /// Exposure of the counts, in words; the metadata item `EXPOSURE` of files.
    pub exposure: String,
    shaded_below: f32,
    grid: Option<GridSpec>,
}

/// Camera from which a model is relit under suns.
///
/// From straight above, visibility is the weighted mean of two traces: through the Gaussians, from each that is seen,
/// and over the surface model, whose altitudes are smoothed. Their errors at shadow borders differ
/// (docs/lab/shadows.md). Other views use the trace through the Gaussians alone.
pub struct Viewpoint<'a> {
    model: &'a LoadedModel,
    camera: ProjectiveCamera,
    above: Option<Above>,
}

/// Grid and surface of a nadir view.
struct Above {
    grid: GridSpec,
    /// Surface that casts shadows; `None` for a model without light.
    surface: Option<SurfaceShadows>,
}

impl<'a> Viewpoint<'a> {
    /// View from straight above (`nadir`) at the resolution of the images, or of the image called `view`.
    ///
    /// # Errors
    /// [`RelightError`] when no image has this name, or the grid from above cannot be made.
    pub fn new(model: &'a LoadedModel, view: &str) -> Result<Self, RelightError> {
        if view == "nadir" {
            let nadir = NadirGrid::new(&model.into(), model.file.gsd_m, None)?;
            return Ok(Self::above(model, &nadir));
        }
        let (camera, above) = (named_camera(model, view)?, None);
        Ok(Self { model, camera, above })
    }

    /// View from straight above: one pixel per cell of a grid.
    pub fn above(model: &'a LoadedModel, nadir: &NadirGrid) -> Self {
        let surface = model.file.has_light().then(|| SurfaceShadows::new(model, nadir));
        let (camera, grid) = (nadir.camera, nadir.grid.clone());
        let above = Some(Above { grid, surface });
        Self { model, camera, above }
    }

    /// Renders the view under `sun`, in counts of the reference image: exposure and path radiance are those of that
    /// image, irradiance and sky light those of the sun.
    ///
    /// # Errors
    /// [`RelightError`] when the sun is lower than [`LOWEST_SUN_DEG`], or the model has no light.
    pub fn relit(&self, sun: &SunPosition) -> Result<Relit, RelightError> {
        let (light, maps) = self.traced(sun)?;
        let visibility = visibility_of(self.model, &maps);
        let mut image = composed(self.model, sun, light, &self.camera, &maps)?;
        let counts = self.model.file.counts_per_unit as f32;
        image.values.iter_mut().for_each(|value| *value *= counts);
        image.blank_unknown(&visibility.values);
        Ok(Relit {
            image,
            visibility,
            exposure: exposure(self.model),
            shaded_below: self.shaded_below(),
            grid: self.above.as_ref().map(|above| above.grid.clone()),
        })
    }

    /// Shadow mask of the view under `sun`: 1 in shadow, 0 in the sun, `NaN` where unknown.
    ///
    /// # Errors
    /// [`RelightError`] when the sun is lower than [`LOWEST_SUN_DEG`], or the model has no light.
    pub fn shadows(&self, sun: &SunPosition) -> Result<Raster, RelightError> {
        let (_, maps) = self.traced(sun)?;
        Ok(mask_of(visibility_of(self.model, &maps), self.shaded_below()))
    }

    fn shaded_below(&self) -> f32 {
        match self.above {
            Some(_) => SHADED_BELOW_IN_THE_MEAN,
            None => SHADED_BELOW,
        }
    }

    fn surface(&self) -> Option<&SurfaceShadows> {
        self.above.as_ref()?.surface.as_ref()
    }

    /// Maps of the view with the shadows cast under `sun`, and the light of that sun.
    fn traced(&self, sun: &SunPosition) -> Result<(Light, Maps), RelightError> {
        let model = self.model;
        let light = light_of(model, sun)?;
        let options = model.pass_options();
        let lit = || self.surface().map(|surface| surface.lit(sun));
        let through = || {
            let (parameters, camera) = (&model.parameters, &self.camera);
            render(&model.model, parameters, camera, Some(light), None, options)
        };
        let (lit, Rendering { mut maps, .. }) = timeline::concurrently(lit, through);
        if let Some(lit) = lit {
            let Maps { channels, alpha, .. } = &mut maps;
            let weight = over_surface(sun.elevation_rad.to_degrees());
            mix(&mut channels[model.model.visibility_channel()], alpha, &lit, weight);
        }
        Ok((light, maps))
    }
}

/// Directional light of a sun on `model`.
///
/// # Errors
/// [`RelightError`] when the sun is lower than [`LOWEST_SUN_DEG`], or the model has no light.
pub(crate) fn light_of(model: &LoadedModel, sun: &SunPosition) -> Result<Light, RelightError> {
    let elevation_deg = sun.elevation_rad.to_degrees();
    if !elevation_deg.is_finite() || elevation_deg < LOWEST_SUN_DEG {
        return Err(RelightError::Refused(format!(
            "the sun stands {elevation_deg:.2} degrees above the horizon; relight needs it at {LOWEST_SUN_DEG} degrees or higher"
        )));
    }
    if !model.file.has_light() {
        return Err(RelightError::Refused(format!(
            "{}: no sun was known in training, so this run cannot be relit; train again with acquisition times: .IMD, DIM_*.XML or .json files beside the images, or time = \"2016-04-23T08:34:00Z\" in scene.toml",
            model.folder.display()
        )));
    }
    Ok(Light::Directional(crop::toward(sun)))
}

fn visibility_of(model: &LoadedModel, maps: &Maps) -> Raster {
    Raster::of_plane(maps.width, maps.height, model.model.sunlit(maps))
}

/// Weight of the visibility over the surface model under a sun of this elevation, degrees.
fn over_surface(elevation_deg: f64) -> f32 {
    let [high, low] = HIGH_AND_LOW_DEG;
    let sunk = ((high - elevation_deg) / (high - low)).clamp(0.0, 1.0) as f32;
    OVER_SURFACE[0] + (OVER_SURFACE[1] - OVER_SURFACE[0]) * sunk
}

/// Mixes `over`, the visibility over the surface (NaN where it is unknown), with this weight into `through`, the
/// composited visibility of pixels.
fn mix(through: &mut [f32], alpha: &[f32], over: &[f32], weight: f32) {
    for ((through, alpha), over) in through.iter_mut().zip(alpha).zip(over) {
        if over.is_finite() {
            *through += weight * (over * alpha - *through);
        }
    }
}

fn mask_of(mut visibility: Raster, shaded_below: f32) -> Raster {
    for value in visibility.values.iter_mut().filter(|v| !v.is_nan()) {
        *value = if *value < shaded_below { 1.0 } else { 0.0 };
    }
    visibility
}

/// Image of `maps`, traced under the light of `sun`, with the irradiance and the sky light of that sun, in units of the
/// model's colours.
///
/// # Errors
/// [`RelightError`] for a model without irradiance and sky light under other suns.
pub(crate) fn composed(
    model: &LoadedModel,
    sun: &SunPosition,
    light: Light,
    camera: &ProjectiveCamera,
    maps: &Maps,
) -> Result<Raster, RelightError> {
    let daylight = model.file.daylight.as_ref().ok_or_else(|| {
        let folder = model.folder.display();
        RelightError::Refused(format!(
            "{folder}: the model does not state how bright the ground is under another sun; train again to relight it"
        ))
    })?;
    let (reference, bands) = (model.file.options.reference, model.file.options.bands);
    let mut globals = model.parameters.globals.clone();
    for k in 0..bands {
        let shade = daylight.shade(k, sun.elevation_rad) as f32;
        globals.group_mut(SKY)[reference * bands + k] = softplus_inverse(shade);
    }
    // The maps hold the features of the Gaussians.
    let gaussians = Table::zeros(model.model.feature_groups(), 0);
    let parameters = Parameters { gaussians, globals };
    let context = Context {
        parameters: &parameters,
        camera,
        light: Some(light),
        appearance: None,
    };
    let mut image = model.model.compose(&context, maps);
    for (k, kept) in path_radiance(model).into_iter().enumerate() {
        let gain = daylight.gain(k, sun.elevation_rad) as f32;
        for value in image.plane_mut(k) {
            *value = (*value - kept) * gain + kept;
        }
    }
    Ok(image)
}

/// The path radiance of the reference image, per band, in units of the model's colours.
fn path_radiance(model: &LoadedModel) -> Vec<f32> {
    model.model.colour(&model.parameters, model.file.options.reference).1
}

/// Exposure of relit counts, in words.
fn exposure(model: &LoadedModel) -> String {
    let reference = model.file.options.reference;
    let mut images = model.file.images.iter();
    let image = images.find(|image| image.appearance == Some(reference));
    let counts = |value: f32| format!("{:.0}", f64::from(value) * model.file.counts_per_unit);
    let kept: Vec<String> = path_radiance(model).into_iter().map(counts).collect();
    let image = image.map_or("the reference image", |image| &image.name);
    let kept = kept.join(", ");
    format!("counts of {image} under this sun, its path radiance of {kept} kept")
}

fn named_camera(model: &LoadedModel, view: &str) -> Result<ProjectiveCamera, RelightError> {
    let image = model.file.images.iter().find(|image| image.name == view);
    image.map(camera_of).ok_or_else(|| {
        let known: Vec<&str> = model.file.images.iter().map(|image| image.name.as_str()).collect();
        RelightError::Refused(format!(
            "no image of the run is called {view}; the names are {}, or nadir",
            known.join(", ")
        ))
    })
}

impl Relit {
    /// Shadow mask: 1 in shadow, 0 in the sun, `NaN` where unknown.
    pub fn shadows(&self) -> Raster {
        mask_of(self.visibility.clone(), self.shaded_below)
    }

    /// Writes the image to `path` (PNG: a picture; otherwise GeoTIFF in counts) and its shadow mask beside it
    /// (`*_shadow`, 1 in shadow, 0 elsewhere); returns the path of the mask.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, path: &Path) -> Result<PathBuf, RasterError> {
        let png = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mask_path = path.with_file_name(format!("{stem}_shadow.{}", if png { "png" } else { "tif" }));
        let mut mask = self.shadows();
        mask.values.iter_mut().filter(|v| v.is_nan()).for_each(|v| *v = 0.0);
        if png {
            preview::write_png(path, &preview::stretched(&self.image))?;
            preview::write_png(&mask_path, &preview::stretched(&mask))?;
            return Ok(mask_path);
        }
        let georeference = self.grid.as_ref().map(|grid| (&grid.transform, &grid.crs));
        let spec = ImageSpec {
            georeference,
            metadata: &[("EXPOSURE".into(), self.exposure.clone())],
            ..ImageSpec::plain(&self.image)
        };
        match georeference {
            Some(_) => write_cog(path, &spec)?,
            None => write_geotiff(path, &spec, SampleType::F32)?,
        }
        let mask = ImageSpec {
            georeference,
            ..ImageSpec::plain(&mask)
        };
        write_geotiff(&mask_path, &mask, SampleType::U8)?;
        Ok(mask_path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_as_lit_as_gaussians_and_surface_say_and_where_the_surface_is_unknown_as_the_gaussians_say() {
        let mut through = vec![0.9, 0.9, 0.0, 0.45];
        mix(&mut through, &[0.9; 4], &[0.0, 1.0, 1.0, f32::NAN], 0.4);
        for (mixed, wanted) in through.iter().zip([0.6, 1.0, 0.4, 0.5]) {
            assert!((mixed / 0.9 - wanted).abs() < 1e-6, "{through:?}");
        }
    }

    #[test]
    fn the_lower_the_sun_the_more_the_surface_says() {
        let weights = [70.0, 20.0, 16.0, 12.0, 3.0].map(over_surface);
        for (weight, wanted) in weights.iter().zip([0.4, 0.4, 0.5, 0.6, 0.8]) {
            assert!((weight - wanted).abs() < 1e-6, "{weights:?}");
        }
    }

    #[test]
    fn what_is_unknown_is_neither_shadow_nor_lit() {
        let visibility = Raster {
            width: 3,
            height: 1,
            bands: 1,
            values: vec![0.55, 0.65, f32::NAN],
        };
        let mask = mask_of(visibility, SHADED_BELOW_IN_THE_MEAN).values;
        assert!(mask[0] == 1.0 && mask[1] == 0.0 && mask[2].is_nan());
    }
}
