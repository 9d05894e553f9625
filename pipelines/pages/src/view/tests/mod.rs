//! Content and permissions of a page. Its shadows are tested where programs can run it: `tests/tests/view.rs`.

use super::exhibit::{CELLS_MAX, averaged};
use super::*;
use heliosplat::Raster;
use heliosplat_raster::{Crs, GeoTransform, GridSpec};
use heliosplat_rpc::sun::SunPosition;

/// Pseudorandom number from 0 to 1 for a cell.
fn noise(col: usize, row: usize) -> f32 {
    let mixed = (col as u32)
        .wrapping_mul(0x9E37_79B9)
        .wrapping_add((row as u32).wrapping_mul(0x85EB_CA6B));
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x2C1B_3C6D);
    (mixed ^ (mixed >> 12)) as f32 / u32::MAX as f32
}

/// Houses of 8 to 20 m every 40 cells on a slope, with 10 cm of noise; one corner is unknown.
fn town(width: usize, height: usize) -> Exhibit {
    let mut altitude = Raster::filled(width, height, 1, 0.0);
    let mut albedo = Raster::filled(width, height, 3, 0.0);
    for row in 0..height {
        for col in 0..width {
            let i = row * width + col;
            let (house_col, house_row) = (col / 40, row / 40);
            let is_house = (10..30).contains(&(col % 40)) && (8..28).contains(&(row % 40));
            let roof = if is_house {
                8.0 + 12.0 * noise(house_col, house_row)
            } else {
                0.0
            };
            altitude.values[i] = 700.0 + 0.01 * col as f32 + roof + 0.1 * noise(col, row);
            for band in 0..3 {
                let patch = noise(house_col + 7 * band, house_row + usize::from(is_house));
                albedo.values[band * width * height + i] = 0.2 + 0.4 * patch + 0.05 * noise(col + band, row);
            }
            if col + row < 20 {
                altitude.values[i] = f32::NAN;
            }
        }
    }
    Exhibit {
        title: "town".into(),
        grid: GridSpec {
            width,
            height,
            transform: GeoTransform::north_up(320_000.0, 4_160_000.0, 0.5),
            crs: Crs::from_epsg(32637).expect("UTM"),
        },
        gsd_m: 0.5,
        altitude,
        vertical_datum: "WGS84 ellipsoid".into(),
        albedo: Some(albedo),
        light: LightTable::of_sky([0.2, 0.22, 0.25]),
        old_shadows: false,
        dates: Vec::new(),
        layers: Vec::new(),
    }
}

#[test]
fn a_page_fetches_nothing_and_keeps_names_as_text() {
    let exhibit = Exhibit {
        title: "</script><script>alert(1)</script>".into(),
        ..town(64, 48)
    };
    let page = document::page(&exhibit).expect("a page");
    assert!(page.contains("Content-Security-Policy") && page.contains("default-src 'none'"));
    assert!(!page.contains("http://") && !page.contains("https://"), "no address");
    assert_eq!(page.matches("<script").count(), 2);
    assert_eq!(page.matches("</script").count(), 2);
    assert!(!page.contains("alert(1)</script>"));
}

#[test]
fn a_page_of_a_million_cells_has_four_megabytes_at_most() {
    let mut exhibit = town(1024, 1024);
    let noisy = |seed: usize| Raster {
        values: (0..1024 * 1024 * 3).map(|i| 255.0 * noise(i, seed)).collect(),
        ..Raster::filled(1024, 1024, 3, 0.0)
    };
    exhibit.layers = (0..3)
        .map(|k| Layer::picture(&format!("image-{k}"), "Image", noisy(k)))
        .collect();
    exhibit.dates.push(TracedDate {
        name: "2020-06-01".into(),
        time: None,
        sun: SunPosition::from_degrees(140.0, 50.0),
        shadows: Some(Raster::filled(1024, 1024, 1, 0.0)),
    });
    let page = document::page(&exhibit).expect("a page");
    assert!(page.len() <= 4_000_000, "{} bytes", page.len());
    assert!(page.len() > 500_000, "the surface itself is there");
    assert!(!page.contains("\"image-2\""), "what does not fit is left out");
}

#[test]
fn a_larger_surface_is_averaged_and_stays_in_its_place() {
    let large = town(1500, 1000);
    let outer = |exhibit: &Exhibit| {
        let transform = &exhibit.grid.transform;
        transform.map_from_pixel(-0.5, -0.5)
    };
    let before = (outer(&large), large.altitude.values[40 * 1500 + 60]);
    let small = large.reduced();
    assert_eq!((small.altitude.width, small.altitude.height), (750, 500));
    assert!(small.altitude.plane_len() <= CELLS_MAX && small.gsd_m == 1.0);
    assert_eq!(outer(&small), before.0);
    assert_eq!(small.grid.transform.pixel_size(), (1.0, 1.0));
    assert!((small.altitude.values[20 * 750 + 30] - before.1).abs() < 0.2);
    assert!(small.altitude.values[0].is_nan(), "four unknown cells are unknown");
    assert_eq!(averaged(&large.altitude, 2).values.len(), 750 * 500);
}

#[test]
fn a_surface_without_any_height_has_no_page() {
    let mut exhibit = town(8, 8);
    exhibit.altitude.values.fill(f32::NAN);
    let error = document::page(&exhibit).expect_err("nothing to show");
    assert!(matches!(error, ViewError::Nothing { .. }) && error.is_input_fault());
}

#[test]
fn the_light_of_a_sky_is_that_of_the_model() {
    // L = S + (1 - S) sky
    let light = LightTable::of_sky([0.2, 0.3, 0.4]);
    for (band, sky) in [0.2f32, 0.3, 0.4].into_iter().enumerate() {
        for visible in [0.0f32, 0.3, 1.0] {
            let of_page = light.shade[0][band] + light.sun[0][band] * visible;
            assert!((of_page - (visible + (1.0 - visible) * sky)).abs() < 1e-6);
        }
    }
}
