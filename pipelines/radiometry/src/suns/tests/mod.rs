use super::*;
use glam::{DVec3, Vec3};
use heliosplat::{ProjectiveCamera, Raster};

const SIDE: usize = 160;
const LATITUDE_DEG: f64 = 38.0;
const SUNS_DEG: [[f64; 2]; 4] = [[150.0, 55.0], [165.0, 28.0], [138.0, 40.0], [172.0, 47.0]];

/// Boxes of 6 to 18 m on level ground, a metre to a cell.
fn town() -> Surface {
    let mut altitude = vec![0.0f32; SIDE * SIDE];
    for (n, z) in altitude.iter_mut().enumerate() {
        let (col, row) = (n % SIDE, n / SIDE);
        let (block, within) = ((col / 32 + 5 * (row / 32)), (col % 32, row % 32));
        let side = 6 + 2 * (block * 7 % 4);
        if (8..8 + side).contains(&within.0) && (10..10 + side).contains(&within.1) {
            *z = 6.0 + 3.0 * (block * 11 % 5) as f32;
        }
    }
    of_altitude(altitude)
}

fn of_altitude(altitude: Vec<f32>) -> Surface {
    Surface {
        width: SIDE,
        height: SIDE,
        west_m: 0.0,
        north_m: SIDE as f32,
        cell_m: 1.0,
        confidence: vec![1.0; altitude.len()],
        filled: vec![false; altitude.len()],
        resolution_m: 0.1,
        altitude,
        ..Surface::default()
    }
}

/// Image of a camera straight above under a sun: patches of albedo, a third as bright in shadow.
fn image(surface: &Surface, [azimuth_deg, elevation_deg]: [f64; 2]) -> Raster {
    let relief = relief_of(surface, &vec![true; SIDE * SIDE]);
    let toward = toward(azimuth_deg, 1.0);
    let mut image = Raster::filled(SIDE, SIDE, 1, 0.0);
    for (cell, value) in image.values.iter_mut().enumerate() {
        let (col, row) = (cell % SIDE, cell / SIDE);
        let albedo = 0.1 + 0.3 * (((col / 4) * 7919 + (row / 4) * 104_729) % 97) as f32 / 97.0;
        let shaded = f64::from(relief.horizon(cell, &toward)) > elevation_deg.to_radians().tan();
        *value = albedo * if shaded { 0.33 } else { 1.0 };
    }
    image
}

fn views(images: &[Raster]) -> Vec<SweepView<'_>> {
    let middle = SIDE as f64 - 0.5;
    let camera = ProjectiveCamera::new(
        [1.0, 0.0, 0.0, -0.5],
        [0.0, -1.0, 0.0, middle],
        [0.0; 3],
        (SIDE, SIDE),
        -DVec3::Z,
    );
    let view = |(date, image)| SweepView {
        camera,
        image,
        index: None,
        date_group: date as u32,
        sun: None,
    };
    images.iter().enumerate().map(view).collect()
}

fn off_deg(found: &ShadowSun, [azimuth_deg, elevation_deg]: [f64; 2]) -> f64 {
    apart_deg(
        direction(found.azimuth_deg, found.elevation_deg),
        direction(azimuth_deg, elevation_deg),
    )
}

#[test]
fn the_shadows_of_a_town_say_where_the_suns_stood() {
    let surface = town();
    let images: Vec<Raster> = SUNS_DEG.iter().map(|&sun| image(&surface, sun)).collect();
    let found = find_suns(&views(&images), &surface, &vec![true; SIDE * SIDE], LATITUDE_DEG);
    for (found, sun) in found.iter().zip(SUNS_DEG) {
        let found = found.expect("there are shadows");
        assert!(found.is_decisive(), "{found:?}");
        assert!(off_deg(&found, sun) < 1.5, "{found:?} for {sun:?}");
    }
}

#[test]
fn views_of_one_date_share_one_sun_and_known_suns_are_left_alone() {
    let surface = town();
    let images: Vec<Raster> = SUNS_DEG.iter().map(|&sun| image(&surface, sun)).collect();
    let mut views = views(&images);
    let again = SweepView { ..views[0] };
    views.push(again);
    views[1..4].iter_mut().for_each(|view| view.sun = Some(Vec3::Z));
    let found = find_suns(&views, &surface, &vec![true; SIDE * SIDE], LATITUDE_DEG);
    assert_eq!(found[0], found[4]);
    assert!(found[0].is_some() && found[1].is_none());
}

#[test]
fn a_town_upside_down_is_told_from_a_town_by_its_shadows() {
    let town = town();
    let images: Vec<Raster> = SUNS_DEG.iter().map(|&sun| image(&town, sun)).collect();
    let mut views = views(&images);
    let of = |views: &[SweepView], surface: &Surface| Inversion::of(views, surface, &vec![true; SIDE * SIDE]);
    assert_eq!(of(&views, &town), None, "no sun is known");
    for (view, [azimuth_deg, elevation_deg]) in views.iter_mut().zip(SUNS_DEG) {
        view.sun = Some(Vec3::from(direction(azimuth_deg, elevation_deg).map(|v| v as f32)));
    }
    let inverted = of_altitude(town.altitude.iter().map(|altitude| -altitude).collect());
    let found = [&town, &inverted].map(|surface| of(&views, surface).expect("suns are known"));
    assert!(!found[0].is_decisive() && found[1].is_decisive(), "{found:?}");
    let level = of(&views, &of_altitude(vec![0.0; SIDE * SIDE])).expect("suns are known");
    assert!(!level.is_decisive(), "{level:?}");
}

#[test]
fn level_ground_says_nothing() {
    let surface = of_altitude(vec![0.0; SIDE * SIDE]);
    let town = town();
    let images: Vec<Raster> = SUNS_DEG.iter().map(|&sun| image(&town, sun)).collect();
    let found = find_suns(&views(&images), &surface, &vec![true; SIDE * SIDE], LATITUDE_DEG);
    assert!(found.iter().flatten().all(|sun| !sun.is_decisive()), "{found:?}");
}

#[test]
fn images_without_shadows_say_nothing() {
    let surface = town();
    let lit = of_altitude(vec![0.0; SIDE * SIDE]);
    let images: Vec<Raster> = SUNS_DEG.iter().map(|&sun| image(&lit, sun)).collect();
    let mut views = views(&images);
    views[1..].iter_mut().for_each(|view| view.sun = Some(Vec3::Z));
    let found = find_suns(&views, &surface, &vec![true; SIDE * SIDE], LATITUDE_DEG);
    assert!(found.iter().flatten().all(|sun| !sun.is_decisive()), "{found:?}");
}

#[test]
fn a_sun_in_the_north_is_impossible_in_the_north() {
    assert!(is_possible(180.0, 60.0, 40.0) && is_possible(95.0, 30.0, 40.0));
    assert!(!is_possible(0.0, 60.0, 40.0) && !is_possible(180.0, 80.0, 40.0));
    assert!(is_possible(0.0, 60.0, -20.0) && is_possible(0.0, 86.0, 20.0));
}
