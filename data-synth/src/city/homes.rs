//! Blocks where people live: detached houses in gardens, and apartment houses around a courtyard.

use super::building::{Design, Roof};
use super::palette;
use super::planner::{Planner, Plot};
use crate::materials::{Material, grey};

/// Detached houses on two rows of lots back to back, or on one row where the block is too narrow.
pub(crate) fn houses(planner: &mut Planner, plot: &Plot) {
    planner.cover(plot, [0.0, 0.0], plot.half, Material::Lawn);
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
    planner.cover(plot, [a, front - side * 0.5 * depth], [lot, 0.5 * depth], material);
    let setback = planner.range(2.5, 4.5);
    let half_width = planner.range(4.6, 6.2).min(lot - 1.1);
    let half_depth = planner.range(5.0, 7.0).min(0.5 * (depth - setback) - 1.5).max(2.5);
    let shift = planner.range(-0.4, 0.4);
    let middle = front - side * (setback + half_depth);
    if half_width < 2.5 {
        return;
    }
    let (house, half) = ([a + shift, middle], [half_width, half_depth]);
    let design = house_design(planner, half_width.min(half_depth));
    erect_house(planner, plot, house, half, design);
    drive_and_shed(planner, plot, (house, half), [lot, depth, side]);
    let behind = setback + 2.0 * half_depth;
    for _ in 0..planner.pick(&[3, 4, 5, 6]) {
        let b = front - side * planner.range(behind + 0.5, depth.max(behind + 1.0));
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

fn house_design(planner: &mut Planner, shorter: f64) -> Design {
    let rise_m = planner.range(0.45, 0.80) * shorter;
    let roof = match planner.share() {
        s if s < 0.50 => (Roof::Gabled { rise_m }, palette::pitched_cover(planner)),
        s if s < 0.85 => (Roof::Hipped { rise_m }, palette::pitched_cover(planner)),
        _ => (Roof::Flat { parapet_m: 0.4 }, palette::flat_cover(planner)),
    };
    let storeys = planner.pick(&[1.0, 2.0, 2.0]);
    let eaves_m = 2.9 * storeys + planner.range(0.2, 0.7);
    Design::new(eaves_m, palette::facade(planner), roof)
}

/// The ridge runs along the longer side: the footprint's first half size must be the longer one.
fn erect_house(planner: &mut Planner, plot: &Plot, at: [f64; 2], [length, width]: [f64; 2], design: Design) {
    if length >= width {
        return planner.erect(plot, at, [length, width], design);
    }
    planner.erect(plot, at, [width, length], design);
    if let Some(building) = planner.buildings.last_mut() {
        building.footprint.angle_rad += std::f64::consts::FRAC_PI_2;
    }
}

fn drive_and_shed(
    planner: &mut Planner,
    plot: &Plot,
    (house, [half_width, half_depth]): ([f64; 2], [f64; 2]),
    [lot, depth, side]: [f64; 3],
) {
    let front = side * plot.half[1];
    let left = planner.pick(&[-1.0, 1.0]);
    let room = lot - half_width;
    let a = house[0] + left * (half_width + 0.5 * room).min(half_width + 1.5);
    let drive_end = house[1];
    let half_length = 0.5 * (front - drive_end).abs();
    let material = palette::paving(planner);
    planner.cover(plot, [a, 0.5 * (front + drive_end)], [1.25, half_length], material);
    planner.park(plot, [a, front - side * 3.0], true);
    let patio = house[1] - side * (half_depth + 1.4);
    planner.cover(plot, [house[0], patio], [0.6 * half_width, 1.4], material);
    let rear = front - side * (depth - 2.2);
    if planner.chance(0.4) && (rear - house[1]).abs() > half_depth + 3.0 {
        let eaves_m = planner.range(2.1, 2.6);
        let roof = (Roof::Flat { parapet_m: 0.0 }, palette::flat_cover(planner));
        let shed = Design::new(eaves_m, Material::Concrete(grey(0.3)), roof);
        planner.erect(plot, [a, rear], [1.4, 1.9], shed);
    }
}

/// Apartment houses of several heights along the edges, a courtyard within.
pub(crate) fn apartments(planner: &mut Planner, plot: &Plot) {
    let pavement = palette::paving(planner);
    planner.cover(plot, [0.0, 0.0], plot.half, pavement);
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
        let roof = if pitched {
            let rise_m = common_pitch * depth;
            (Roof::Gabled { rise_m }, palette::pitched_cover(planner))
        } else {
            let parapet_m = planner.range(0.5, 1.0);
            (Roof::Flat { parapet_m }, palette::flat_cover(planner))
        };
        let eaves_m = 3.0 * planner.pick(&[3.0, 4.0, 4.0, 5.0]) + planner.range(0.3, 1.5);
        let design = Design::new(eaves_m, palette::facade(planner), roof);
        planner.erect(plot, [a + 0.5 * piece, b], [0.5 * piece, depth], design);
        let passage = planner.chance(0.3).then(|| planner.range(3.0, 6.0));
        a += piece + passage.unwrap_or(0.0);
    }
}

/// A lower house across one end of the courtyard or both.
fn close_ends(planner: &mut Planner, plot: &Plot, [length, court_width, depth]: [f64; 3]) {
    for end in [-1.0, 1.0] {
        let half_width = court_width - 2.0;
        if half_width < 4.0 || planner.chance(0.4) {
            continue;
        }
        let roof = if planner.chance(0.5) {
            let rise_m = 0.6 * half_width.min(depth);
            (Roof::Hipped { rise_m }, palette::pitched_cover(planner))
        } else {
            (Roof::Flat { parapet_m: 0.6 }, palette::flat_cover(planner))
        };
        let eaves_m = planner.range(4.0, 9.5);
        let design = Design::new(eaves_m, palette::facade(planner), roof);
        let at = [end * (length - 0.8 - depth), 0.0];
        erect_house(planner, plot, at, [depth, half_width], design);
    }
}

fn courtyard(planner: &mut Planner, plot: &Plot, half: [f64; 2]) {
    let green = planner.pick(&[Material::Lawn, Material::Lawn, Material::Garden]);
    planner.cover(plot, [0.0, 0.0], half, green);
    let path = palette::paving(planner);
    planner.cover(plot, [0.0, 0.0], [half[0], 0.9], path);
    let cross = planner.range(-0.4, 0.4) * half[0];
    planner.cover(plot, [cross, 0.0], [0.9, half[1]], path);
    let trees = (half[0] * half[1] / 13.0).ceil() as u32;
    for _ in 0..trees {
        let at = [planner.range(-0.95, 0.95) * half[0], planner.range(-0.8, 0.8) * half[1]];
        let (radius, kind) = (planner.range(2.0, 4.2), planner.any_tree());
        planner.plant(plot, at, radius, kind);
    }
}
