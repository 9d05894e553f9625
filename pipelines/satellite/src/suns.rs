//! Suns that light a model: known ones, and suns estimated from shadows for the other images.

use super::clouds;
use super::ground::GroundViews;
use super::plan::Decisions;
use super::preprocess::Preprocess;
use heliosplat::timeline::stage;
use heliosplat_radiometry::suns::{ShadowSun, find_suns};
use heliosplat_rpc::sun::SunPosition;
use heliosplat_scene::{ImageSun, Scene, SceneImage};
use heliosplat_stereo::Surface;

/// Estimates the unknown suns of all images, held-out ones too, from shadows on the swept surface. The result is `None`
/// for images with a known sun and where there is no estimate.
pub(super) fn search(scene: &Scene, swept: &mut Preprocess) {
    let _part = stage("suns");
    swept.found.shadow_suns = found(scene, swept, &swept.found.surface);
}

/// Repeats the search on better altitudes of the swept surface's cells, metres (NaN where there are none). Decisive
/// results replace earlier ones. Returns true if a sun became known.
pub(super) fn search_again(scene: &Scene, swept: &mut Preprocess, altitude_m: &[f32]) -> bool {
    let _part = stage("suns");
    let mut surface = swept.found.surface.clone();
    for (old, new) in surface.altitude.iter_mut().zip(altitude_m) {
        *old = if new.is_nan() { *old } else { *new };
    }
    let again = found(scene, swept, &surface);
    let mut more = false;
    for (before, now) in swept.found.shadow_suns.iter_mut().zip(again) {
        let now = now.map(|sun| ShadowSun { of_model: true, ..sun });
        if now.is_some_and(|sun| sun.is_decisive()) {
            more |= !before.is_some_and(|sun| sun.is_decisive());
            *before = now;
        }
    }
    more
}

/// True if some estimate beats other suns without being decisive; a better surface may decide it.
pub(super) fn are_undecided(searched: &[Option<ShadowSun>]) -> bool {
    let in_doubt = |sun: &ShadowSun| !sun.is_decisive() && sun.beats_others();
    searched.iter().flatten().any(in_doubt)
}

fn found(scene: &Scene, swept: &Preprocess, surface: &Surface) -> Vec<Option<ShadowSun>> {
    let mut found = vec![None; scene.images.len()];
    let Ok(ground) = GroundViews::new(scene, scene.images.iter()) else {
        return found;
    };
    if ground.images.iter().all(|image| image.sun.position.is_some()) {
        return found;
    }
    let mut rasters = ground.rasters();
    let mut shifts_px = vec![[0.0; 2]; rasters.len()];
    for (place, image) in ground.images.iter().enumerate() {
        // Held-out images have neither shifts nor clouds: their cameras are used as delivered.
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
    let covered = surface.supported();
    let suns = find_suns(&views, surface, &covered, ground.frame.origin.lat_deg);
    let mut unreliable = Vec::new();
    for (image, sun) in ground.images.iter().zip(suns) {
        if let Some(sun) = sun {
            let name = &image.name;
            match sun.is_decisive() {
                true => tracing::info!(
                    "{name}: sun estimated from shadows, azimuth {:.1}°, elevation {:.1}°",
                    sun.azimuth_deg,
                    sun.elevation_deg
                ),
                false => unreliable.push(format!("{name} ({:.2})", sun.score)),
            }
            tracing::debug!(
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
    if !unreliable.is_empty() {
        tracing::info!(
            "Suns from shadows not reliable (correlation): {}",
            unreliable.join(", ")
        );
    }
    found
}

/// Index of an image in its scene.
pub(super) fn place_in(scene: &Scene, image: &SceneImage) -> Option<usize> {
    scene.images.iter().position(|other| std::ptr::eq(other, image))
}

/// Suns of all images of the scene after the search; estimates count only where they are decisive.
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

/// Suns of the images of `ground` after the search.
pub(super) fn of_ground(scene: &Scene, ground: &GroundViews, searched: &[Option<ShadowSun>]) -> Vec<ImageSun> {
    let all = after(scene, searched);
    let places = ground.images.iter().filter_map(|image| place_in(scene, image));
    places.map(|place| all[place]).collect()
}

/// Suns of the images of `ground` after the search, and the decisions under them.
pub(super) fn decided(
    scene: &Scene,
    ground: &GroundViews,
    searched: &[Option<ShadowSun>],
    decisions: &Decisions,
) -> (Vec<ImageSun>, Decisions) {
    let suns = of_ground(scene, ground, searched);
    let places = ground.images.iter().filter_map(|image| place_in(scene, image));
    let searched: Vec<Option<ShadowSun>> = places.map(|place| searched[place]).collect();
    let decisions = decisions.after_search(&suns, &searched);
    (suns, decisions)
}
