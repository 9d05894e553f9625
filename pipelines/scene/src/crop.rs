//! View of an image: the crop that shows an area, its camera, its sun and its pass.

use crate::area::window_around;
use crate::{Area, ImageSun, Scene, SceneImage};
use glam::{DVec3, Vec3};
use heliosplat::ProjectiveCamera;
use heliosplat_raster::Window;
use heliosplat_rpc::ProjectiveMap;
use heliosplat_rpc::sun::SunPosition;
use jiff::Timestamp;
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Margin around the area, pixels: losses with a window, and splats across the edge, need the surroundings.
/// Smaller windows show too little to be compared.
const SHOWN_PX: (f64, usize) = (8.0, 17);

/// Smallest window of an image, with a margin, that shows all of `area` between two altitudes (metres of the scene's
/// frame); `None` where the image shows none of it.
pub fn window_of(image: &SceneImage, area: &Area, up_m: (f64, f64)) -> Option<Window> {
    let mut places = Vec::with_capacity(8);
    for x in [area.west_m, area.east_m] {
        for y in [area.south_m, area.north_m] {
            places.extend([up_m.0, up_m.1].map(|z| image.pinhole.map.project(Vector3::new(x, y, z))));
        }
    }
    window_around(places, (image.pixels.width, image.pixels.height), SHOWN_PX)
}

/// Camera of the engine for a rectangle of the image of `map`, with projections moved by `shift_px` (columns, rows;
/// pixels).
pub fn camera(map: &ProjectiveMap, crop: &Window, shift_px: [f32; 2]) -> ProjectiveCamera {
    let moved = |row: [f64; 4], by: f64| {
        // (u·p + u0)/(1 + w·p) + by = ((u + by·w)·p + u0 + by)/(1 + w·p)
        let [x, y, z] = [0, 1, 2].map(|axis| row[axis] + by * map.w[axis]);
        [x, y, z, row[3] + by]
    };
    let u = moved(map.u, f64::from(shift_px[0]) - crop.col0 as f64);
    let v = moved(map.v, f64::from(shift_px[1]) - crop.row0 as f64);
    ProjectiveCamera::new(u, v, map.w, (crop.width, crop.height), -DVec3::Z)
}

/// Unit vector toward a sun in the scene's frame; `None` where the sun is unknown.
pub fn direction(sun: &ImageSun) -> Option<Vec3> {
    sun.position.as_ref().map(toward)
}

/// Unit vector toward a sun at this position in the scene's frame.
pub fn toward(sun: &SunPosition) -> Vec3 {
    let direction = sun.direction_enu();
    Vec3::new(direction.x as f32, direction.y as f32, direction.z as f32)
}

/// Largest time between two images of one pass, seconds; they have one light. A satellite 600 km up sees a place from
/// 45 degrees before the nadir to 45 degrees behind it in some three minutes; in five the sun moves 1.25 degrees, and
/// the shadow of a house by less than a pixel.
const PASS_S: i64 = 300;
/// Largest angle between the suns of one pass for images without times, degrees of arc: the sun's movement during a
/// pass.
const ONE_SUN_DEG: f64 = 1.25;

/// Number of the pass of each image. Images of one pass have one light: they were taken within five minutes of the
/// pass's first image or, without times, under suns within 1.25 degrees of the first image's sun. An image without time
/// and sun is a separate pass, since its light is unknown. Numbers ascend in the order of the images.
pub fn date_groups(images: &[&SceneImage]) -> Vec<u32> {
    let lights: Vec<_> = images.iter().map(|image| (image.time, image.sun.position)).collect();
    lights_in_groups(&lights)
}

/// Number of the pass of each image, as [`date_groups`], from times and suns.
pub fn lights_in_groups(lights: &[(Option<Timestamp>, Option<SunPosition>)]) -> Vec<u32> {
    let numbered = lights.iter().zip(0..);
    let in_time = numbered.filter_map(|(light, place)| Some((light.0?, place)));
    let mut in_time: Vec<(Timestamp, usize)> = in_time.collect();
    in_time.sort();
    // First image of each image's group, as a provisional name of the group.
    let mut first: Vec<usize> = (0..lights.len()).collect();
    let mut pass: Option<(Timestamp, usize)> = None;
    for (time, place) in in_time {
        match pass {
            Some((begun, of)) if time.duration_since(begun).as_secs() <= PASS_S => first[place] = of,
            _ => pass = Some((time, place)),
        }
    }
    let timeless = |place: usize| lights[place].1.filter(|_| lights[place].0.is_none());
    for place in 0..lights.len() {
        let Some(sun) = timeless(place) else { continue };
        let alike = |other: &usize| {
            first[*other] == *other
                && timeless(*other).is_some_and(|of| {
                    let cosine = of.direction_enu().dot(&sun.direction_enu());
                    cosine.clamp(-1.0, 1.0).acos().to_degrees() <= ONE_SUN_DEG
                })
        };
        first[place] = (0..place).find(alike).unwrap_or(place);
    }
    let mut known = BTreeMap::new();
    let number = |of| {
        let next = known.len() as u32;
        *known.entry(of).or_insert(next)
    };
    first.into_iter().map(number).collect()
}

/// Lowest and highest altitude of a scene relative to the origin of its frame, metres.
pub fn altitude_range(scene: &Scene) -> (f64, f64) {
    let origin = scene.origin().height_m;
    (scene.altitude_range_m.0 - origin, scene.altitude_range_m.1 - origin)
}

/// `area` grown by `margin_m` (metres) on all sides.
pub fn grown(area: &Area, margin_m: f64) -> Area {
    Area {
        west_m: area.west_m - margin_m,
        south_m: area.south_m - margin_m,
        east_m: area.east_m + margin_m,
        north_m: area.north_m + margin_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn groups(times: &[&str]) -> Vec<u32> {
        let lights: Vec<_> = times
            .iter()
            .map(|text| (Some(text.parse().expect("RFC 3339")), None))
            .collect();
        lights_in_groups(&lights)
    }

    #[test]
    fn a_pass_is_one_light_across_midnight_and_two_passes_of_a_day_are_two() {
        assert_eq!(groups(&["2016-04-23T23:59:10Z", "2016-04-24T00:00:20Z"]), [0, 0]);
        assert_eq!(
            groups(&["2016-04-23T13:40:00Z", "2016-04-23T10:20:00Z", "2016-04-23T10:21:00Z"]),
            [0, 1, 1]
        );
        assert_eq!(
            groups(&["2016-04-23T10:20:00Z", "2016-04-23T10:50:00Z"]),
            [0, 1],
            "two satellites"
        );
    }

    #[test]
    fn a_group_does_not_grow_from_image_to_image() {
        let minutes = ["2016-04-23T10:08:00Z", "2016-04-23T10:00:00Z", "2016-04-23T10:04:00Z"];
        assert_eq!(groups(&minutes), [0, 1, 1]);
    }

    #[test]
    fn images_without_times_are_grouped_by_their_suns_and_without_both_they_are_alone() {
        let sun = |azimuth, elevation| (None, Some(SunPosition::from_degrees(azimuth, elevation)));
        let timed = (
            Some(Timestamp::UNIX_EPOCH),
            Some(SunPosition::from_degrees(150.0, 40.0)),
        );
        let lights = [
            sun(150.4, 40.4),
            sun(150.6, 40.6),
            sun(150.0, 43.0),
            timed,
            (None, None),
            (None, None),
        ];
        assert_eq!(lights_in_groups(&lights), [0, 0, 1, 2, 3, 4]);
    }
}
