//! Truth for relighting: the site from straight above under suns that no image has, and the hours of sun of one day.
//!
//! Air, season and gain are those of the image with the highest sun, the reference for relit images; only the sun
//! moves. There are no cars, clouds or noise, and counts are linear even where the images are for display.

use crate::encoding::Encoding;
use crate::nadir::NadirSensor;
use crate::noise::{hash2, stream};
use crate::plan::Collection;
use crate::radiometry::{LitScene, SURFACE_BIAS_M};
use crate::ray::Ray;
use crate::render::{Exposure, Image, render};
use crate::request::SatelliteRequest;
use crate::studio::Studio;
use crate::truth::look_down;
use heliosplat_rpc::GeoPoint;
use heliosplat_rpc::sun::{SunPosition, sun_position};
use jiff::Timestamp;
use nalgebra::Vector3;
use rand::RngExt;
use rand::seq::SliceRandom;

/// Lowest and highest sun, degrees.
const ELEVATIONS_DEG: [f64; 2] = [10.0, 70.0];
/// Largest azimuth of a sun from the meridian, on either side, degrees.
const ASIDE_DEG: f64 = 90.0;
/// A sun nearer than this to that of an image is drawn again, degrees.
const APART_DEG: f64 = 8.0;
/// Most draws for one sun; after these the last one is used.
const DRAWS: usize = 40;
/// Day of the hours of sun: an equinox.
pub(crate) const DAY: &str = "2016-03-20";
/// Time between two suns of that day, seconds.
const STEP_S: i64 = 360;

/// Azimuth and elevation of the `request.relight` suns, degrees: elevations evenly from lowest to highest, azimuths
/// over the sunny half of the sky, in random order, away from the suns of the images.
pub(crate) fn suns_deg(request: &SatelliteRequest, collection: &Collection) -> Vec<[f64; 2]> {
    let count = request.relight;
    let mut random = stream(request.seed, 0x5E11);
    let mut elevations_deg: Vec<f64> = (0..count).map(|index| elevation_deg(index, count)).collect();
    elevations_deg.shuffle(&mut random);
    let meridian_deg = if collection.origin.lat_deg >= 0.0 { 180.0 } else { 0.0 };
    let mut slots: Vec<usize> = (0..count).collect();
    slots.shuffle(&mut random);
    let taken: Vec<Vector3<f64>> = collection.views.iter().map(|view| view.sun.direction_enu()).collect();
    let mut draw = |elevation_deg: f64, slot: usize| {
        let mut sun = [0.0, elevation_deg];
        for _ in 0..DRAWS {
            let share = (slot as f64 + random.random_range(0.0..1.0)) / count as f64;
            sun[0] = (meridian_deg + ASIDE_DEG * (2.0 * share - 1.0)).rem_euclid(360.0);
            let direction = SunPosition::from_degrees(sun[0], sun[1]).direction_enu();
            let apart = |other: &Vector3<f64>| direction.dot(other) < APART_DEG.to_radians().cos();
            if taken.iter().all(apart) {
                break;
            }
        }
        sun
    };
    let drawn = elevations_deg.into_iter().zip(slots);
    drawn.map(|(elevation_deg, slot)| draw(elevation_deg, slot)).collect()
}

/// The elevation of sun `index` of `count`, before they are shuffled, degrees; a single one is in the middle.
fn elevation_deg(index: usize, count: usize) -> f64 {
    let [low_deg, high_deg] = ELEVATIONS_DEG;
    let share = match count {
        0 | 1 => 0.5,
        _ => index as f64 / (count - 1) as f64,
    };
    low_deg + share * (high_deg - low_deg)
}

/// Image and shadow mask of the site from straight above under one sun (azimuth and elevation, degrees). `rows_done`
/// receives the number of rows of each finished batch.
pub(crate) fn relit(
    request: &SatelliteRequest,
    scene: &LitScene,
    sensor: &NadirSensor,
    studio: &Studio,
    [azimuth_deg, elevation_deg]: [f64; 2],
    rows_done: &mut dyn FnMut(usize),
) -> Image {
    let sun = SunPosition::from_degrees(azimuth_deg, elevation_deg);
    let seed = hash2(request.seed, 0x5E12);
    let light = studio.light(request, &sun, 0.0, seed);
    let exposure = Exposure {
        encoding: Encoding {
            noise: 0.0,
            bits: 16,
            ..studio.encoding
        },
        ..studio.exposure(request, (sensor, sensor.crop()), &light, seed)
    };
    render(scene, &exposure, rows_done)
}

/// Hours of direct sun on the highest surface at each cell's centre on [`DAY`], from one midnight of mean solar time to
/// the next; NaN where there is no surface.
pub(crate) fn sun_hours(scene: &LitScene, nadir: &NadirSensor) -> Vec<f32> {
    let suns = suns_of_day(nadir.frame.origin);
    let step_hours = STEP_S as f64 / 3600.0;
    nadir.of_cells(|centre| {
        let Some(hit) = look_down(scene, nadir, centre) else {
            return f32::NAN;
        };
        let origin = hit.point + hit.normal * SURFACE_BIAS_M;
        let lit = suns.iter().filter(|&&direction| {
            hit.normal.dot(&direction) > 0.0 && !scene.tracer.occluded(&Ray::new(origin, direction), f64::INFINITY)
        });
        (lit.count() as f64 * step_hours) as f32
    })
}

/// Directions to the sun in the middle of each step of [`DAY`] in which it is up.
fn suns_of_day(place: GeoPoint) -> Vec<Vector3<f64>> {
    const DAY_S: i64 = 86_400;
    // `DAY` is a constant that parses: the other value is never used.
    let midnight: Timestamp = format!("{DAY}T00:00:00Z").parse().unwrap_or(Timestamp::UNIX_EPOCH);
    let first_s = midnight.as_second() - (place.lon_deg / 360.0 * DAY_S as f64).round() as i64;
    (0..DAY_S / STEP_S)
        .filter_map(|step| Timestamp::from_second(first_s + step * STEP_S + STEP_S / 2).ok())
        .map(|time| sun_position(time, place))
        .filter(|sun| sun.elevation_rad > 0.0)
        .map(|sun| sun.direction_enu())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planned(relight: usize, seed: u64) -> (SatelliteRequest, Collection) {
        let request = SatelliteRequest {
            relight,
            seed,
            ..Default::default()
        };
        let collection = Collection::new(&request).expect("a plan");
        (request, collection)
    }

    #[test]
    fn suns_go_from_ten_to_seventy_degrees_and_are_none_of_the_images() {
        for seed in 1..8 {
            let (request, collection) = planned(6, seed);
            let suns = suns_deg(&request, &collection);
            assert_eq!(suns, suns_deg(&request, &collection), "from the seed alone");
            let mut elevations: Vec<f64> = suns.iter().map(|sun| sun[1]).collect();
            elevations.sort_by(f64::total_cmp);
            assert_eq!(elevations, [10.0, 22.0, 34.0, 46.0, 58.0, 70.0]);
            for sun in &suns {
                let direction = SunPosition::from_degrees(sun[0], sun[1]).direction_enu();
                for view in &collection.views {
                    let apart = direction.dot(&view.sun.direction_enu()).acos().to_degrees();
                    assert!(apart > 2.0, "seed {seed}: {apart}");
                }
            }
            let eastern = suns.iter().filter(|sun| (0.0..180.0).contains(&sun[0])).count();
            assert_eq!(eastern, 3, "as many in the morning as in the afternoon");
        }
        let (request, collection) = planned(1, 1);
        assert_eq!(suns_deg(&request, &collection)[0][1], 40.0);
    }

    #[test]
    fn the_sun_of_an_equinox_is_up_for_about_twelve_hours() {
        let place = GeoPoint::new(150.0, -33.0, 0.0);
        let suns = suns_of_day(place);
        let hours = suns.len() as f64 * STEP_S as f64 / 3600.0;
        assert!((11.8..12.3).contains(&hours), "{hours}");
        // From midnight to midnight of the place: it comes up in the east and goes down in the west.
        assert!(suns[0].x > 0.9 && suns[suns.len() - 1].x < -0.9);
    }
}
