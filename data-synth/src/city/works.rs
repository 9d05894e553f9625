//! Blocks where people work, shop and rest: halls with car parks, towers on a square, parks with ponds.

use super::building::{Design, Roof};
use super::palette;
use super::planner::{Planner, Plot};
use crate::materials::{Material, Spectrum};
use crate::vegetation::TreeKind;

/// Width of a bay, metres.
const BAY_M: f64 = 2.6;
/// Distance from one row of bays to the next but one, metres.
const ROW_PITCH_M: f64 = 16.0;
/// Parks of at least this half length have a lake instead of a pond, metres.
const LARGE_PARK_M: f64 = 50.0;

/// A hall on one half of the plot, a car park on the other.
pub(crate) fn commerce(planner: &mut Planner, plot: &Plot) {
    let asphalt = palette::asphalt(planner);
    planner.cover(plot, [0.0, 0.0], plot.half, Material::Asphalt(asphalt));
    let [length, width] = plot.half;
    let side = planner.pick(&[-1.0, 1.0]);
    let share = planner.range(0.50, 0.62);
    let hall = [share * length - 0.5, width - planner.range(1.0, 3.0)];
    let eaves_m = planner.range(6.0, 9.5);
    let wall = palette::facade(planner);
    let cover = palette::hall_cover(planner);
    let parapet_m = planner.range(0.3, 0.9);
    let at = side * (length - hall[0] - 0.5);
    let design = Design::new(eaves_m, wall, (Roof::Flat { parapet_m }, cover));
    planner.erect(plot, [at, 0.0], hall, design);
    annexe(planner, plot, [at, hall[0], hall[1]], eaves_m, wall);
    car_park(planner, plot, -side, [length, width, (1.0 - share) * length]);
}

/// A lower or higher part at one end of the hall, inside its outline, as extensions are.
fn annexe(planner: &mut Planner, plot: &Plot, [at, half_length, half_width]: [f64; 3], eaves_m: f64, wall: Material) {
    let half = [0.28 * half_length, 0.45 * half_width];
    if half[0] < 2.0 || half[1] < 2.0 {
        return;
    }
    let a = at + planner.range(-0.5, 0.5) * half_length;
    let b = planner.range(-0.45, 0.45) * half_width;
    let eaves_m = eaves_m + planner.range(2.5, 4.5);
    let roof = (Roof::Flat { parapet_m: 0.5 }, palette::flat_cover(planner));
    planner.erect(plot, [a, b], half, Design::new(eaves_m, wall, roof));
}

fn car_park(planner: &mut Planner, plot: &Plot, side: f64, [length, width, reach]: [f64; 3]) {
    let asphalt = palette::asphalt(planner);
    let half = [reach - 1.0, width - 0.8];
    let middle = side * (length - reach);
    let parking = Material::Parking(asphalt, [BAY_M, ROW_PITCH_M]);
    planner.cover(plot, [middle, 0.0], half, parking);
    let bays = (half[0] / BAY_M).floor() as i32;
    for row in -3..=3 {
        // As in the markings: bays reach 5 m to both sides of each multiple of the row pitch.
        for (offset, flip) in [(2.5, 1.0), (-2.5, -1.0)] {
            let b = f64::from(row) * ROW_PITCH_M + offset;
            if b.abs() > half[1] - 2.5 {
                continue;
            }
            for k in -bays..bays {
                let a = middle + (f64::from(k) + 0.5) * BAY_M;
                if planner.chance(0.06) {
                    let radius = planner.range(1.3, 2.2);
                    planner.plant(plot, [a, b + flip], radius, TreeKind::Broadleaf);
                } else if planner.chance(0.75) {
                    planner.park(plot, [a, b], true);
                }
            }
        }
    }
    for end in [-1.0, 1.0] {
        let b = end * (width - 0.9);
        planner.cover(plot, [middle, b], [half[0], 0.8], Material::Lawn);
        for _ in 0..4 {
            let at = [middle + planner.range(-1.0, 1.0) * half[0], b];
            let radius = planner.range(1.2, 2.2);
            planner.plant(plot, at, radius, TreeKind::Broadleaf);
        }
    }
}

/// A stepped tower, a slab next to it, and a paved square with trees.
pub(crate) fn tower(planner: &mut Planner, plot: &Plot) {
    let square = palette::paving(planner);
    planner.cover(plot, [0.0, 0.0], plot.half, square);
    let [length, width] = plot.half;
    let side = planner.pick(&[-1.0, 1.0]);
    let half = [(0.40 * length).min(13.0), (0.62 * width).min(11.0)];
    let tiers = planner.pick(&[1, 2, 3]);
    let tier_m = planner.range(3.0, 4.0);
    let wall = palette::facade(planner);
    let cover = palette::flat_cover(planner);
    let eaves_m = (planner.range(20.0, 29.0) - tier_m * f64::from(tiers)).max(9.0);
    let at = [side * (length - half[0] - 2.0), planner.range(-0.2, 0.2) * width];
    let design = Design::new(eaves_m, wall, (Roof::Stepped { tier_m, tiers }, cover));
    planner.erect(plot, at, half, design);
    let slab = [(0.42 * length).min(20.0), (0.32 * width).clamp(3.5, 7.5)];
    let eaves_m = 3.0 * planner.pick(&[3.0, 4.0, 5.0]) + 1.0;
    let wall = palette::facade(planner);
    let roof = (Roof::Flat { parapet_m: 0.9 }, palette::flat_cover(planner));
    let b = planner.pick(&[-1.0, 1.0]) * (width - slab[1] - 1.5);
    let at = [-side * (length - slab[0] - 2.0), b];
    planner.erect(plot, at, slab, Design::new(eaves_m, wall, roof));
    square_green(planner, plot, [-side * 0.35 * length, -b.signum() * 0.4 * width]);
}

fn square_green(planner: &mut Planner, plot: &Plot, middle: [f64; 2]) {
    let half = [0.45 * plot.half[0], 0.32 * plot.half[1]];
    planner.cover(plot, middle, half, Material::Lawn);
    for _ in 0..20 {
        let at = [0, 1].map(|axis| middle[axis] + planner.range(-1.0, 1.0) * half[axis]);
        let (radius, kind) = (planner.range(1.8, 3.2), planner.any_tree());
        planner.plant(plot, at, radius, kind);
    }
}

/// Lawn, paths, a pond, clumps of trees, sometimes a playing field and a pavilion.
pub(crate) fn park(planner: &mut Planner, plot: &Plot) {
    planner.cover(plot, [0.0, 0.0], plot.half, Material::Lawn);
    let [length, width] = plot.half;
    // The pond lies on the side that looks to the city's centre.
    let side = plot.towards_centre();
    let gravel = Material::Gravel(Spectrum::new(0.32, 0.28, 0.22, 0.36));
    let path_b = planner.range(-0.15, 0.15) * width;
    planner.cover(plot, [0.0, path_b], [length, 1.3], gravel);
    planner.cover(plot, [side * 0.1 * length, 0.0], [1.3, width], gravel);
    // A park that is longer than a block of houses has a lake.
    let lake = length > LARGE_PARK_M;
    let most_m = if lake { [48.0, 30.0] } else { [9.0, 7.0] };
    let pond = [(0.30 * length).min(most_m[0]), (0.34 * width).min(most_m[1])];
    planner.pond(plot, [side * 0.55 * length, path_b + 0.48 * (width - path_b)], pond);
    if planner.chance(0.7) {
        field(planner, plot, [-side * 0.52 * length, path_b - 0.5 * (width + path_b)]);
    }
    let clumps = (length * width / 30.0).ceil() as u32;
    for _ in 0..clumps {
        let at = [planner.range(-0.95, 0.95) * length, planner.range(-0.92, 0.92) * width];
        let kind = planner.any_tree();
        for _ in 0..planner.pick(&[1, 2, 3]) {
            let near = [at[0] + planner.range(-4.0, 4.0), at[1] + planner.range(-4.0, 4.0)];
            let inside = near[0].abs() < length - 1.0 && near[1].abs() < width - 1.0;
            let radius = planner.range(2.4, 5.0);
            if inside && (near[1] - path_b).abs() > 2.0 {
                planner.plant(plot, near, radius, kind);
            }
        }
    }
}

fn field(planner: &mut Planner, plot: &Plot, at: [f64; 2]) {
    let half = [(0.36 * plot.half[0]).min(8.0), (0.34 * plot.half[1]).min(5.0)];
    let colour = planner.pick(&[
        [0.10, 0.17, 0.10, 0.20],
        [0.28, 0.13, 0.09, 0.33],
        [0.08, 0.13, 0.20, 0.16],
    ]);
    planner.cover(plot, at, half, Material::Court(Spectrum::from(colour), half));
}
