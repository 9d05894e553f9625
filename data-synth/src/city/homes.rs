//! Blocks where people live: detached houses in gardens, and apartment houses around a courtyard.

use super::building::Roof;
use super::palette;
use super::planner::{Design, Planner, Plot};
use crate::materials::{Class, Material};

/// Detached houses on two rows of lots back to back, or on one row where the block is too narrow.
pub(crate) fn houses(planner: &mut Planner, plot: &Plot) {
    planner.cover(plot, [0.0, 0.0], plot.half, Class::Ground, Material::Lawn);
    let [length, width] = plot.half;
    let rows: &[f64] = if width > 13.0 { &[-1.0, 1.0] } else { &[1.0] };
    let depth = if rows.len() == 2 { width } else { 2.0 * width };
    for &side in rows {
        let lots = ((2.0 * length) / planner.range(11.5, 14.5)).floor().max(1.0);
        let lot = length / lots;
        for k in 0..lots as u32 {
            let a = -length + lot * (2.0 * f64::from(k) + 1.0);
            // (a, front) is the middle of the lot's street side; `side` points from the house to the street.
            house_lot(planner, plot, a, [lot, depth], side);
            if k > 0 && planner.chance(0.45) {
                let front = side * (width - 5.0);
                planner.hedge(plot, [a - lot, front], [a - lot, front - side * (depth - 6.0)]);
            }
        }
    }
}

fn house_lot(planner: &mut Planner, plot: &Plot, a: f64, [lot, depth]: [f64; 2], side: f64) {
    let front = side * plot.half[1];
    let material = planner.pick(&[Material::Lawn, Material::Lawn, Material::Garden]);
    planner.cover(
        plot,
        [a, front - side * 0.5 * depth],
        [lot, 0.5 * depth],
        Class::Ground,
        material,
    );
    let setback = planner.range(2.5, 4.5);
    let half_width = planner.range(4.6, 6.2).min(lot - 1.1);
    let half_depth = planner.range(5.0, 7.0).min(0.5 * (depth - setback) - 1.5).max(2.5);
    let shift = planner.range(-0.4, 0.4);
    let middle = front - side * (setback + half_depth);
    if half_width < 2.5 {
        return;
    }
    let design = house_design(planner, [half_width, half_depth]);
    erect_house(planner, plot, [a + shift, middle], design);
    drive_and_shed(
        planner,
        plot,
        [a + shift, middle],
        [half_width, half_depth],
        [lot, depth, side],
    );
    for _ in 0..planner.pick(&[3, 4, 5, 6]) {
        let b = front
            - side
                * planner.range(
                    setback + 2.0 * half_depth + 0.5,
                    depth.max(setback + 2.0 * half_depth + 1.0),
                );
        let (at, radius) = ([a + planner.range(-0.8, 0.8) * lot, b], planner.range(1.8, 4.2));
        let kind = planner.any_tree();
        planner.plant(plot, at, radius, kind);
    }
    if planner.chance(0.5) {
        let at = [a + planner.range(-0.8, 0.8) * lot, front - side * 1.6];
        let (radius, kind) = (planner.range(1.2, 2.0), planner.any_tree());
        planner.plant(plot, at, radius, kind);
    }
}

fn house_design(planner: &mut Planner, half: [f64; 2]) -> Design {
    let shorter = half[0].min(half[1]);
    let pitch = planner.range(0.45, 0.80);
    let (roof, cover) = match planner.share() {
        s if s < 0.50 => (
            Roof::Gabled {
                rise_m: pitch * shorter,
            },
            palette::pitched_cover(planner),
        ),
        s if s < 0.85 => (
            Roof::Hipped {
                rise_m: pitch * shorter,
            },
            palette::pitched_cover(planner),
        ),
        _ => (Roof::Flat { parapet_m: 0.4 }, palette::flat_cover(planner)),
    };
    let storeys = planner.pick(&[1.0, 2.0, 2.0]);
    Design {
        half,
        eaves_m: 2.9 * storeys + planner.range(0.2, 0.7),
        roof,
        wall: palette::facade(planner),
        cover,
    }
}

/// The ridge runs along the longer side: the footprint's first half size must be the longer one.
fn erect_house(planner: &mut Planner, plot: &Plot, at: [f64; 2], mut design: Design) {
    let across = design.half[1] > design.half[0];
    if across {
        design.half.swap(0, 1);
    }
    let plan = planner.erect(plot, at, design);
    if across && let Some(building) = planner.buildings.last_mut() {
        building.footprint.angle_rad = plan.angle_rad + std::f64::consts::FRAC_PI_2;
    }
}

fn drive_and_shed(
    planner: &mut Planner,
    plot: &Plot,
    house: [f64; 2],
    [half_width, half_depth]: [f64; 2],
    [lot, depth, side]: [f64; 3],
) {
    let front = side * plot.half[1];
    let left = planner.pick(&[-1.0, 1.0]);
    let room = lot - half_width;
    let a = house[0] + left * (half_width + 0.5 * room).min(half_width + 1.5);
    let drive_end = house[1];
    let half_length = 0.5 * (front - drive_end).abs();
    let material = palette::paving(planner);
    planner.cover(
        plot,
        [a, 0.5 * (front + drive_end)],
        [1.25, half_length],
        Class::Ground,
        material,
    );
    planner.park(plot, [a, front - side * 3.0], true);
    let patio = house[1] - side * (half_depth + 1.4);
    planner.cover(
        plot,
        [house[0], patio],
        [0.6 * half_width, 1.4],
        Class::Ground,
        material,
    );
    let rear = front - side * (depth - 2.2);
    if planner.chance(0.4) && (rear - house[1]).abs() > half_depth + 3.0 {
        let design = Design {
            half: [1.4, 1.9],
            eaves_m: planner.range(2.1, 2.6),
            roof: Roof::Flat { parapet_m: 0.0 },
            wall: Material::Concrete(crate::materials::grey(0.3)),
            cover: palette::flat_cover(planner),
        };
        planner.erect(plot, [a, rear], design);
    }
}

/// Apartment houses of several heights along the edges, a courtyard within.
pub(crate) fn apartments(planner: &mut Planner, plot: &Plot) {
    let pavement = palette::paving(planner);
    planner.cover(plot, [0.0, 0.0], plot.half, Class::Ground, pavement);
    let [length, width] = plot.half;
    let depth = planner.range(5.2, 6.2).min(0.36 * width);
    let setback = 0.8;
    for side in [-1.0, 1.0] {
        let b = side * (width - setback - depth);
        apartment_row(planner, plot, b, [length - 0.5, depth]);
    }
    let court_width = width - setback - 2.0 * depth;
    if court_width > 4.0 {
        courtyard(planner, plot, [length - 1.5, court_width - 1.2]);
        close_ends(planner, plot, [length, court_width, depth]);
    }
}

/// Attached houses, each with a height and roof of its own, with a passage here and there.
fn apartment_row(planner: &mut Planner, plot: &Plot, b: f64, [half_length, depth]: [f64; 2]) {
    let mut a = -half_length;
    let common_pitch = planner.range(0.5, 0.75);
    let pitched_row = planner.chance(0.5);
    while half_length - a > 7.0 {
        let mut piece = planner.range(11.0, 20.0).min(half_length - a);
        if half_length - a - piece < 7.0 {
            piece = half_length - a;
        }
        let pitched = pitched_row != planner.chance(0.15);
        let (roof, cover) = if pitched {
            (
                Roof::Gabled {
                    rise_m: common_pitch * depth,
                },
                palette::pitched_cover(planner),
            )
        } else {
            (
                Roof::Flat {
                    parapet_m: planner.range(0.5, 1.0),
                },
                palette::flat_cover(planner),
            )
        };
        let design = Design {
            half: [0.5 * piece, depth],
            eaves_m: 3.0 * planner.pick(&[3.0, 4.0, 4.0, 5.0]) + planner.range(0.3, 1.5),
            roof,
            wall: palette::facade(planner),
            cover,
        };
        planner.erect(plot, [a + 0.5 * piece, b], design);
        a += piece
            + if planner.chance(0.3) {
                planner.range(3.0, 6.0)
            } else {
                0.0
            };
    }
}

/// A lower house across one end of the courtyard or both.
fn close_ends(planner: &mut Planner, plot: &Plot, [length, court_width, depth]: [f64; 3]) {
    for end in [-1.0, 1.0] {
        let half_width = court_width - 2.0;
        if half_width < 4.0 || planner.chance(0.4) {
            continue;
        }
        let shorter = half_width.min(depth);
        let pitched = planner.chance(0.5);
        let (roof, cover) = if pitched {
            (Roof::Hipped { rise_m: 0.6 * shorter }, palette::pitched_cover(planner))
        } else {
            (Roof::Flat { parapet_m: 0.6 }, palette::flat_cover(planner))
        };
        let design = Design {
            half: [depth, half_width],
            eaves_m: planner.range(4.0, 9.5),
            roof,
            wall: palette::facade(planner),
            cover,
        };
        erect_house(planner, plot, [end * (length - 0.8 - depth), 0.0], design);
    }
}

fn courtyard(planner: &mut Planner, plot: &Plot, half: [f64; 2]) {
    let green = planner.pick(&[Material::Lawn, Material::Lawn, Material::Garden]);
    planner.cover(plot, [0.0, 0.0], half, Class::Ground, green);
    let path = palette::paving(planner);
    planner.cover(plot, [0.0, 0.0], [half[0], 0.9], Class::Ground, path);
    let cross = planner.range(-0.4, 0.4) * half[0];
    planner.cover(plot, [cross, 0.0], [0.9, half[1]], Class::Ground, path);
    let trees = (half[0] * half[1] / 13.0).ceil() as u32;
    for _ in 0..trees {
        let at = [planner.range(-0.95, 0.95) * half[0], planner.range(-0.8, 0.8) * half[1]];
        let (radius, kind) = (planner.range(2.0, 4.2), planner.any_tree());
        planner.plant(plot, at, radius, kind);
    }
}
