//! A model of an object, and its files: `model.ply`, `model.json`.

use super::capture::{Capture, Frame};
use super::frame_spec::PointLight;
use super::pinhole::Pinhole;
use super::pixels::Encoding;
use super::surroundings::Lamp;
use super::views::Preparation;
use glam::DVec3;
use heliosplat::gaussians::Table;
use heliosplat::light::Light;
use heliosplat::model::olat::{Component, Olat, OlatOptions};
use heliosplat::model::radiance::{Radiance, RadianceOptions};
use heliosplat::model::reflective::{Reflective, ReflectiveOptions};
use heliosplat::model::{Parameters, SceneModel};
use heliosplat::render::{PassOptions, render};
use heliosplat::splat::{Maps, ProjectionOptions};
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_exchange::splat_ply;
use heliosplat_fitting::run_folder::{self, MODEL, RunError, parsed, read_gaussians};
use heliosplat_raster::bounded;
use heliosplat_scene::Split;
use std::path::Path;

/// Version of `model.json`.
pub const SCHEMA: u32 = 1;

/// Kind of model with its options, which `model.json` contains.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "model", content = "options", rename_all = "snake_case")]
pub enum Kind {
    /// View-dependent colours.
    Radiance(RadianceOptions),
    /// Surfaces lit by one light at a time.
    Olat(OlatOptions),
    /// Glossy surfaces in constant surroundings.
    Reflective(ReflectiveOptions),
}

impl Kind {
    /// Model with these options.
    pub fn model(&self) -> Box<dyn SceneModel> {
        match self {
            Self::Radiance(options) => Box::new(Radiance::new(options.clone())),
            Self::Olat(options) => Box::new(Olat::new(options.clone())),
            Self::Reflective(options) => Box::new(Reflective::new(options.clone())),
        }
    }

    /// Kind that renders one component of the light alone; `None` if the model lacks the component.
    pub fn showing(&self, shows: Component) -> Option<Self> {
        match self {
            Self::Radiance(_) => None,
            Self::Olat(options) if shows == Component::Scattering && !options.scattering => None,
            Self::Olat(options) => Some(Self::Olat(OlatOptions {
                shows,
                ..options.clone()
            })),
            Self::Reflective(_) if shows == Component::Shadow || shows == Component::Scattering => None,
            Self::Reflective(options) => Some(Self::Reflective(ReflectiveOptions {
                shows,
                ..options.clone()
            })),
        }
    }

    /// Kind that renders under lamps; `None` if the model cannot be relit.
    pub fn lit(&self) -> Option<Self> {
        match self {
            Self::Radiance(_) => None,
            Self::Olat(_) => Some(self.clone()),
            Self::Reflective(options) => Some(Self::Reflective(ReflectiveOptions {
                lit: true,
                ..options.clone()
            })),
        }
    }

    /// Names of the parts that the model has.
    pub fn parts(&self) -> Vec<&'static str> {
        let named = |parts: &[(&'static str, bool)]| parts.iter().filter(|p| p.1).map(|p| p.0).collect();
        match self {
            Self::Radiance(_) => Vec::new(),
            Self::Olat(o) => named(&[
                ("diffuse", true),
                ("specular", o.specular),
                ("shadow", o.shadow),
                ("refined_shadow", o.refined),
                ("scattering", o.scattering),
            ]),
            Self::Reflective(o) => named(&[("diffuse", true), ("specular", o.specular)]),
        }
    }
}

/// Name, use, camera and light of an image of the capture.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ObjectImage {
    /// Name: the path as written in the capture's list, without extension.
    pub name: String,
    /// Use of the image: training or testing.
    pub split: Split,
    /// Camera in the capture's own frame and units.
    pub camera: Pinhole,
    /// Light, if known.
    pub light: Option<PointLight>,
}

impl From<&Frame> for ObjectImage {
    fn from(frame: &Frame) -> Self {
        Self {
            name: frame.name.clone(),
            split: frame.split,
            camera: frame.camera,
            light: frame.light,
        }
    }
}

/// `model.json`: all of a model besides its Gaussians.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ObjectFile {
    /// Version of this layout.
    pub schema: u32,
    /// SHA-256 of `model.ply`, hexadecimal; absent in models of versions that did not state it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gaussians_sha256: Option<String>,
    /// Kind of model with its options.
    #[serde(flatten)]
    pub kind: Kind,
    /// Parameters shared by all Gaussians.
    pub globals: Table,
    /// Origin of the model in the frame of the cameras; positions in `model.ply` are relative to it.
    pub centre: DVec3,
    /// Half side of the cube that the cameras see, in the capture's units.
    pub half_size: f64,
    /// Width of a pixel at the centre, in the capture's units.
    pub pixel_size: f64,
    /// Encoding of pixel values of the capture's images.
    pub encoding: Encoding,
    /// Conversion of images to training data.
    pub preparation: Preparation,
    /// Projection of Gaussians to splats.
    pub projection: ProjectionOptions,
    /// The images of the capture; cameras of training images as training turned them.
    pub images: Vec<ObjectImage>,
}

/// A model with its metadata.
pub struct ObjectModel {
    /// Content of `model.json`.
    pub file: ObjectFile,
    /// Model with the options of `file`.
    pub model: Box<dyn SceneModel>,
    /// Gaussians and shared parameters.
    pub parameters: Parameters,
}

impl ObjectModel {
    /// The model that `file` describes, with these parameters.
    pub(super) fn new(file: ObjectFile, parameters: Parameters) -> Self {
        let model = file.kind.model();
        Self {
            file,
            model,
            parameters,
        }
    }

    /// The image of a frame as the model knows it, with the camera that training left it; the frame's own where the
    /// model does not know it.
    pub(super) fn image_of(&self, frame: &Frame) -> ObjectImage {
        let known = |image: &&ObjectImage| image.split == frame.split && image.name == frame.name;
        let image = self.file.images.iter().find(known);
        image.cloned().unwrap_or_else(|| frame.into())
    }

    /// Rendering for an image's camera: red, green and blue, in front of the model's background, under the image's
    /// light. `None` when the model lies behind the camera.
    pub fn render(&self, image: &ObjectImage) -> Option<Raster> {
        self.render_as(&*self.model, image)
    }

    /// Rendering for an image's camera under the sum of `lamps`: red, green and blue, linear values, in front of the
    /// model's background. A lamp of strength one is as strong as those of the capture. `None` when the model lies
    /// behind the camera or cannot be relit, or when there is no lamp.
    pub fn relit(&self, image: &ObjectImage, lamps: &[Lamp]) -> Option<Raster> {
        let model = self.file.kind.lit()?.model();
        let behind = self.file.preparation.background;
        let mut sum: Option<Raster> = None;
        for lamp in lamps {
            let (_, maps, mut seen) = self.look(&*model, &image.camera, Some(lamp.light))?;
            for (k, behind) in behind.into_iter().enumerate() {
                for (value, alpha) in seen.plane_mut(k).iter_mut().zip(&maps.alpha) {
                    let open = (1.0 - alpha) * behind;
                    // The background is added once, whatever the number of lamps.
                    *value = (*value - open) * lamp.colour[k] + if sum.is_none() { open } else { 0.0 };
                }
            }
            match &mut sum {
                None => sum = Some(seen),
                Some(sum) => sum.values.iter_mut().zip(seen.values).for_each(|(s, v)| *s += v),
            }
        }
        sum
    }

    /// Unit normals at a camera's pixels, in the frame of the cameras: the model's own normals where it has them, else
    /// those of the Gaussians; zero on the background. `None` when the model lies behind the camera.
    pub fn normals(&self, image: &ObjectImage) -> Option<Raster> {
        let own = self.file.kind.showing(Component::Normal).map(|kind| kind.model());
        let model = own.as_deref().unwrap_or(&*self.model);
        let (camera, maps, _) = self.look(model, &image.camera, None)?;
        // The first three channels are colours, followed by the model's own normals or those of the Gaussians.
        let mut out = Raster::filled(camera.width, camera.height, 3, 0.0);
        for i in 0..out.plane_len() {
            let n = [3, 4, 5].map(|k| maps.channels[k][i]);
            let length = n.iter().map(|x| x * x).sum::<f32>().sqrt();
            if maps.alpha[i] > 0.5 && length > 1e-6 {
                (0..3).for_each(|k| out.plane_mut(k)[i] = n[k] / length);
            }
        }
        Some(out)
    }

    /// Rendering for an image's camera and light by another model of the same parameters, such as one of
    /// [`components`]. `None` when the model lies behind the camera.
    pub fn render_as(&self, model: &dyn SceneModel, image: &ObjectImage) -> Option<Raster> {
        let (_, maps, mut seen) = self.look(model, &image.camera, self.light(image))?;
        let behind = self.file.preparation.background;
        let strengths = self.file.preparation.strength(image.light.as_ref());
        for (k, strength) in strengths.into_iter().enumerate() {
            if strength != 1.0 {
                for (value, alpha) in seen.plane_mut(k).iter_mut().zip(&maps.alpha) {
                    let open = (1.0 - alpha) * behind[k];
                    *value = (*value - open) * strength + open;
                }
            }
        }
        Some(seen)
    }

    /// Rendering for an image's camera under its light at strength one: the camera, all maps, and red, green and blue.
    /// `None` when the model lies behind the camera.
    pub fn seen(&self, image: &ObjectImage) -> Option<(ProjectiveCamera, Maps, Raster)> {
        self.look(&*self.model, &image.camera, self.light(image))
    }

    fn light(&self, image: &ObjectImage) -> Option<Light> {
        image.light.map(|light| light.seen_from(self.file.centre))
    }

    fn look(
        &self,
        model: &dyn SceneModel,
        camera: &Pinhole,
        light: Option<Light>,
    ) -> Option<(ProjectiveCamera, Maps, Raster)> {
        let camera = camera.projective(self.file.centre)?;
        let options = PassOptions {
            projection: self.file.projection,
            ..PassOptions::default()
        };
        let rendering = render(model, &self.parameters, &camera, light, None, options);
        let mut seen = rendering.image;
        seen.values.truncate(3 * seen.plane_len());
        seen.bands = 3;
        Some((camera, rendering.maps, seen))
    }
}

/// Error of a file of a run with invalid content.
pub(super) fn damaged(path: &Path, reason: impl ToString) -> RunError {
    RunError::Damaged(path.to_owned(), reason.to_string())
}

/// True if a folder contains a run on a capture, finished or not, or a model of one without its run.
pub fn is_object_run(folder: &Path) -> bool {
    let (run, model) = (folder.join("run.toml"), folder.join("model.json"));
    if !run.is_file() {
        let text = bounded::read_text(&model).unwrap_or_default();
        let keys = serde_json::from_str::<serde_json::Value>(&text).unwrap_or_default();
        return keys.get("half_size").is_some() && keys.get("globals").is_some();
    }
    let text = bounded::read_text(&run).unwrap_or_default();
    text.parse::<toml::Table>()
        .is_ok_and(|table| table.contains_key("capture"))
}

/// Content of `model.json` for a model fitted to `capture`, without the SHA-256 of its Gaussians, which is computed
/// when the model is saved.
pub fn file(capture: &Capture, kind: Kind, preparation: Preparation, globals: Table) -> ObjectFile {
    ObjectFile {
        schema: SCHEMA,
        gaussians_sha256: None,
        kind,
        globals,
        centre: capture.centre,
        half_size: capture.half_size,
        pixel_size: capture.pixel_size,
        encoding: capture.frames.first().map_or(Encoding::Display, |f| f.picture.encoding),
        preparation,
        projection: ProjectionOptions::default(),
        images: capture.frames.iter().map(ObjectImage::from).collect(),
    }
}

/// Writes a model alone into `folder`, which must exist: `model.ply`, then `model.json`. Rendering needs no other file.
///
/// # Errors
/// When a file cannot be written.
pub fn save_model(folder: &Path, model: &ObjectModel) -> Result<(), RunError> {
    save(folder, &[], model)
}

/// Writes a model and the `texts` of its run (name, text) into `folder`, which must exist.
///
/// # Errors
/// When a file cannot be removed or written.
pub(super) fn save(folder: &Path, texts: &[(&str, &str)], model: &ObjectModel) -> Result<(), RunError> {
    let gaussians = splat_ply::encode(&model.parameters.gaussians, &[]);
    run_folder::save_model(folder, &gaussians, texts, |sum| {
        serde_json::to_string_pretty(&ObjectFile {
            gaussians_sha256: Some(sum),
            ..model.file.clone()
        })
    })
}

/// Reads the model of the run in `folder`.
///
/// # Errors
/// When a file is missing or damaged.
pub fn load(folder: &Path) -> Result<ObjectModel, RunError> {
    let file = parsed(folder, MODEL, ObjectFile::parse)?;
    let (ply_path, bytes) = read_gaussians(folder, file.gaussians_sha256.as_deref())?;
    let features = file.kind.model().feature_groups();
    let gaussians = splat_ply::decode(&bytes, features).map_err(|e| damaged(&ply_path, e))?;
    let globals = file.globals.clone();
    Ok(ObjectModel::new(file, Parameters { gaussians, globals }))
}

/// Models that render one component of the light each, with their names.
pub fn components(model: &ObjectModel) -> Vec<(&'static str, Box<dyn SceneModel>)> {
    let parts = [
        ("diffuse", Component::Diffuse),
        ("specular", Component::Specular),
        ("shadow", Component::Shadow),
        ("scattering", Component::Scattering),
    ];
    let shown = parts
        .into_iter()
        .filter_map(|(name, part)| Some((name, model.file.kind.showing(part)?.model())));
    shown.collect()
}
