//! Accuracy of a model during training, where the scene has truth.

use heliosplat::splat::ProjectionOptions;
use heliosplat_evaluate::{Protocol, evaluate_raster};
use heliosplat_fitting::curve::Accuracy;
use heliosplat_fitting::training::Probe;
use heliosplat_products::dsm::of_gaussians;
use heliosplat_products::nadir::NadirGrid;
use heliosplat_products::surface::SurfaceGaussians;
use heliosplat_scene::Scene;
use heliosplat_scene::indices::VegetationIndex;

/// Function that measures the error of the surface of a model in training against the scene's true surface; `None`
/// without truth. `leaves` is the index that separates leaves by their colours.
pub(super) fn height_probe(scene: &Scene, leaves: Option<VegetationIndex>) -> Option<Box<Probe<'_>>> {
    let truth = scene.truth.dsm.as_deref()?;
    let classes = scene.truth.classes.as_deref();
    let nadir = NadirGrid::new(&scene.into(), scene.gsd_m, None).ok()?;
    Some(Box::new(move |parameters| {
        let gaussians = SurfaceGaussians {
            gaussians: &parameters.gaussians,
            bands: scene.bands().len(),
            leaves,
            projection: ProjectionOptions::default(),
            gsd_m: scene.gsd_m as f32,
        };
        let surface = of_gaussians(&nadir, &gaussians).geo_raster();
        let evaluation = evaluate_raster((&scene.source, &surface), truth, classes, Protocol::Raw).ok()?;
        Some(Accuracy {
            height_mae_m: Some(evaluation.metrics.all.mae_m),
            psnr_db: None,
        })
    }))
}
