//! The suns that a model is lit by: those that are known, and of the other images those that their shadows tell.

use super::clouds;
use super::ground::Ground;
use super::preprocess::Preprocess;
use heliosplat::timeline::stage;
use heliosplat_rpc::sun::SunPosition;
use heliosplat_scene::{ImageSun, Scene, SceneImage};
use heliosplat_stereo::suns::{ShadowSun, find_suns};

/// Finds out what the shadows on the swept surface say of the suns that are unknown, image by image of the scene, those held out too; `None`
/// where a sun is known, or nothing can be said.
pub(super) fn search(scene: &Scene, swept: &mut Preprocess) {
    let _part = stage("suns");
    swept.found.shadow_suns = found(scene, swept);
}

fn found(scene: &Scene, swept: &Preprocess) -> Vec<Option<ShadowSun>> {
    let mut found = vec![None; scene.images.len()];
    let Ok(ground) = Ground::new(scene, scene.images.iter()) else {
        return found;
    };
    if ground.images.iter().all(|image| image.sun.position.is_some()) {
        return found;
    }
    let mut rasters = ground.rasters();
    let mut shifts_px = vec![[0.0; 2]; rasters.len()];
    for (place, image) in ground.images.iter().enumerate() {
        // Images held out have neither: their cameras are believed.
        if let Some(trained) = swept
            .ground
            .images
            .iter()
            .position(|other| std::ptr::eq(*other, *image))
        {
            shifts_px[place] = swept.found.shifts_px[trained];
            clouds::blank(&mut rasters[place], &swept.found.clouds[trained]);
        }
    }
    let views = ground.sweep_views(&rasters, &shifts_px);
    let surface = &swept.found.surface;
    let covered = surface.supported();
    let suns = find_suns(&views, surface, &covered, ground.frame.origin.lat_deg);
    for (image, sun) in ground.images.iter().zip(suns) {
        if let Some(sun) = sun {
            tracing::info!(
                "{}: shadows say azimuth {:.1}, elevation {:.1} degrees, deviation {:.2}, correlation {:.2}, ahead by {:.1}",
                image.name,
                sun.azimuth_deg,
                sun.elevation_deg,
                sun.sigma_deg,
                sun.score,
                sun.margin
            );
        }
        if let Some(place) = place_in(scene, image) {
            found[place] = sun;
        }
    }
    found
}

/// Where an image stands among those of its scene.
pub(super) fn place_in(scene: &Scene, image: &SceneImage) -> Option<usize> {
    scene.images.iter().position(|other| std::ptr::eq(other, image))
}

/// The suns of all images of the scene after the search: those of shadows only where they are decisive.
pub(super) fn after(scene: &Scene, searched: &[Option<ShadowSun>]) -> Vec<ImageSun> {
    let one = |(image, found): (&SceneImage, &Option<ShadowSun>)| match found {
        Some(sun) if image.sun.position.is_none() && sun.is_decisive() => ImageSun::from_shadows(
            SunPosition::from_degrees(sun.azimuth_deg, sun.elevation_deg),
            sun.sigma_deg,
        ),
        _ => image.sun,
    };
    scene.images.iter().zip(searched).map(one).collect()
}

/// The same of the images of `ground`.
pub(super) fn of_ground(scene: &Scene, ground: &Ground, searched: &[Option<ShadowSun>]) -> Vec<ImageSun> {
    let all = after(scene, searched);
    let places = ground.images.iter().filter_map(|image| place_in(scene, image));
    places.map(|place| all[place]).collect()
}
