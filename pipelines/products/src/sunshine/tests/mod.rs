//! Against shadows that can be worked out by hand.

use super::*;
use crate::nadir::CellVectors;
use heliosplat_raster::Crs;
use heliosplat_raster::grid::GridSpec;
use heliosplat_rpc::LocalFrame;
use heliosplat_scene::Area;

const PLACE: GeoPoint = GeoPoint::new(9.0, 48.0, 0.0);
const CELLS: CellVectors = CellVectors {
    per_col: [0.5, 0.0],
    per_row: [0.0, -0.5],
};

fn raster(side: usize, up_m: impl Fn(usize, usize) -> f32) -> Raster {
    Raster {
        width: side,
        height: side,
        bands: 1,
        values: (0..side * side).map(|cell| up_m(cell % side, cell / side)).collect(),
    }
}

fn toward(altitude_m: &Raster, azimuth_deg: f64) -> Vec<f32> {
    let facets = Facets::of(altitude_m, &CELLS);
    Horizons::new(&facets, &CELLS).toward(azimuth_deg.to_radians())
}

#[test]
fn the_horizon_of_a_wall_is_its_height_over_its_distance_in_every_direction() {
    // A tower of 20 m, 4 m wide, in the middle; seen from cells around it toward it.
    let side = 161;
    let town = raster(side, |col, row| {
        f32::from(u8::from((77..=84).contains(&col) && (77..=84).contains(&row))) * 20.0
    });
    for azimuth_deg in [0.0, 30.0, 45.0, 77.0, 90.0, 180.0, 200.0, 270.0, 333.0] {
        let horizons = toward(&town, azimuth_deg);
        let (sin, cos) = f64::to_radians(azimuth_deg).sin_cos();
        for distance_m in [12.0, 25.0] {
            let (col, row) = (80.5 - sin * distance_m * 2.0, 80.5 + cos * distance_m * 2.0);
            let got = f64::from(horizons[row.round() as usize * side + col.round() as usize]);
            // To the tower's near face or corner, give or take the cell of the viewpoint.
            assert!(
                (20.0 / (distance_m - 0.5)..=20.0 / (distance_m - 3.3)).contains(&got),
                "{azimuth_deg} {distance_m}: {got}"
            );
        }
        // Behind the viewpoint there is nothing.
        let (col, row) = (80.5 + sin * 30.0, 80.5 - cos * 30.0);
        assert_eq!(horizons[row.round() as usize * side + col.round() as usize], 0.0);
    }
}

#[test]
fn a_plane_has_itself_as_horizon_uphill_and_nothing_else() {
    let slope = 0.6f32;
    let hill = raster(80, |col, _| col as f32 * 0.5 * slope);
    for (azimuth_deg, want) in [
        (90.0f64, 0.6),
        (45.0, 0.6 * 0.5f64.sqrt()),
        (0.0, 0.0),
        (270.0, 0.0),
        (225.0, 0.0),
    ] {
        let horizons = toward(&hill, azimuth_deg);
        for (row, col) in [(40, 40), (20, 50), (55, 30)] {
            let got = f64::from(horizons[row * 80 + col]);
            assert!((got - want).abs() < 1e-3, "{azimuth_deg}: {got}");
        }
    }
}

#[test]
fn roughness_of_a_decimetre_does_not_shade_level_ground() {
    let rough = raster(60, |col, row| 0.08 * (((col * 7 + row * 13) % 5) as f32 - 2.0) / 2.0);
    let horizons = toward(&rough, 100.0);
    let inner = (5..55).flat_map(|row| (5..55).map(move |col| row * 60 + col));
    let highest_deg = inner.map(|cell| horizons[cell].atan().to_degrees()).fold(0.0, f32::max);
    assert!(highest_deg < 3.0, "{highest_deg}");
}

#[test]
fn a_sweep_finds_what_a_walk_of_every_cell_finds() {
    let side = 60;
    let town = raster(side, |col, row| ((col / 7 * 5 + row / 9 * 11) % 6) as f32 * 3.0);
    let facets = Facets::of(&town, &CELLS);
    let swept = Horizons::new(&facets, &CELLS).toward(0.5 * PI);
    for cell in 0..side * side {
        let up_m = |cell: usize| f64::from(facets.up_m[cell]);
        let rises = (1..side - cell % side).map(|step| (up_m(cell + step) - up_m(cell) - 0.1) / (step as f64 * 0.5));
        let own = f64::from(facets.slope[cell][0]);
        let want = rises.fold(own.max(0.0), f64::max);
        assert!(
            (f64::from(swept[cell]) - want).abs() < 1e-5,
            "{cell}: {} {want}",
            swept[cell]
        );
    }
}

fn shone(altitude_m: &Raster, period: &Period) -> Sunshine {
    let half = altitude_m.width as f64 * 0.25;
    let frame = LocalFrame::new(PLACE);
    let place = crate::nadir::GroundExtent {
        frame,
        area: Area {
            west_m: -half,
            south_m: -half,
            east_m: half,
            north_m: half,
        },
        altitude_range_m: (-10.0, 50.0),
    };
    let crs = Crs::utm(PLACE).expect("a zone");
    let covering = GridSpec::covering(&frame, [-half, -half, half, half], &crs, 0.5).expect("a grid");
    let grid = covering.part((0, 0), (altitude_m.width, altitude_m.height));
    sunshine(&NadirGrid::on(&place, grid).expect("a grid"), altitude_m, PLACE, period)
}

fn day(text: &str) -> Period {
    let date = text.parse().expect("a date");
    Period::new(date, date).expect("a day")
}

#[test]
fn open_level_ground_has_the_whole_day_and_the_whole_sky() {
    let got = shone(&raster(40, |_, _| 3.0), &day("2026-06-21"));
    let middle = 20 * 40 + 20;
    // 2 acos(-tan(48) tan(23.44)) / 15 hours.
    assert!(
        (got.sun_hours.values[middle] - 15.84).abs() < 0.12,
        "{}",
        got.sun_hours.values[middle]
    );
    assert!((got.sky_view.values[middle] - 1.0).abs() < 1e-3);
    // The model's formulas summed over the day apart from this program: 8.785 kWh/m².
    let energy = got.irradiation.values[middle];
    assert!((energy - 8.785).abs() < 0.09, "{energy}");
}

#[test]
fn a_long_wall_takes_half_of_the_sky_at_its_foot_and_the_sun_of_its_side() {
    // Ground west of a high wall that runs north and south.
    let got = shone(
        &raster(120, |col, _| if col >= 60 { 200.0 } else { 0.0 }),
        &day("2026-03-20"),
    );
    let foot = 60 * 120 + 59;
    assert!(
        (got.sky_view.values[foot] - 0.5).abs() < 0.03,
        "{}",
        got.sky_view.values[foot]
    );
    assert!(
        (got.sun_hours.values[foot] - 6.0).abs() < 0.3,
        "{}",
        got.sun_hours.values[foot]
    );
    // Further off the wall hides less.
    let away = 60 * 120 + 20;
    assert!(got.sky_view.values[away] > got.sky_view.values[foot]);
}

#[test]
fn a_roof_toward_the_equator_gets_more_than_level_ground_in_winter_and_one_away_from_it_less() {
    let roof = |rise: f32| raster(60, move |_, row| row as f32 * 0.5 * rise);
    let winter = day("2026-12-21");
    let at = |raster: &Raster| shone(raster, &winter).irradiation.values[30 * 60 + 30];
    // Rows run south: a surface that rises with them faces north.
    let (level, north, south) = (at(&roof(0.0)), at(&roof(0.5)), at(&roof(-0.5)));
    assert!(south > 1.5 * level && north < 0.5 * level, "{south} {level} {north}");
}

#[test]
fn what_is_not_known_stays_unknown_and_shades_nothing() {
    let holed = raster(40, |col, row| {
        if (10..20).contains(&col) && (10..20).contains(&row) {
            f32::NAN
        } else {
            0.0
        }
    });
    let got = shone(&holed, &day("2026-06-21"));
    let (hole, beside) = (15 * 40 + 15, 15 * 40 + 22);
    assert!(got.sun_hours.values[hole].is_nan() && got.irradiation.values[hole].is_nan());
    assert!(got.sky_view.values[beside] > 0.999);
}
