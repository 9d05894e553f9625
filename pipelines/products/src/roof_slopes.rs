//! What stands high and slopes is brighter where it faces the sun.
//!
//! The albedo of a roof's face that looks to the south holds how it was lit while the images were taken. Under another sun the direct light on
//! it changes by the cosine between its normal and the sun, over that on level ground, beside the same in the mean of the images' suns.
//!
//! A cell's slope is that of a plane through the cells around it, which those beyond an edge do not join. Only what stands above its
//! neighbourhood has one: on the ground slopes of the model are mostly the foot of what stands on it. And half of what a slope
//! says is believed, since slopes are of altitudes that err. Each of these is worth something: docs/lab/shadows.md.

use crate::nadir::CellVectors;
use glam::{Mat3, Vec3};
use heliosplat_grid::opening;
use heliosplat_rpc::sun::SunPosition;
use rayon::prelude::*;

/// Half the width of the window that a plane is laid through, metres.
const WINDOW_M: f64 = 1.6;
/// Cells that the window reaches at least, each way.
const WINDOW_CELLS: usize = 2;
/// How often the plane is laid again through what lies near it.
const ROUNDS: usize = 3;
/// Distances in height from the middle cell, in the first round, and from the plane, in later ones, from which on a cell does not count, metres.
const NEAR_M: [f32; 2] = [2.5, 0.5];
/// Mean weight of the window's cells above which the plane is a surface.
const LEAST_SHARE: f32 = 0.5;
/// Slopes that count, rise over run: less is level, more is a wall.
const SLOPES: [f32; 2] = [0.1, 1.2];
/// Half the width of what is so narrow that it stands upon the ground, metres.
const STANDING_M: f64 = 8.6;
/// Height above the ground from which on something stands upon it, metres.
const HIGH_M: f32 = 2.0;
/// Share of what a slope says that is believed.
const BELIEVED: f64 = 0.5;
/// Bounds of the direct light relative to that on level ground, in the images and under another sun.
const IN_IMAGES: [f64; 2] = [0.2, 3.0];
const RELIT: [f64; 2] = [0.3, 2.5];

/// The slopes of a surface, where it has some.
pub(crate) struct RoofSlopes(Vec<Slope>);

/// The slope of a cell.
#[derive(Debug, Clone, Copy)]
struct Slope {
    cell: usize,
    /// Rise over run to the east and to the north.
    rise: [f64; 2],
    /// Direct light relative to level ground, in the mean of the images.
    in_images: f64,
}

impl RoofSlopes {
    /// The slopes of a surface of known and unknown (NaN) altitudes, `width` cells wide, whose images had these suns. Without suns it
    /// has none.
    pub(crate) fn new(up_m: &[f32], width: usize, cells: &CellVectors, suns: &[SunPosition]) -> Self {
        if suns.is_empty() || up_m.is_empty() {
            return Self(Vec::new());
        }
        let size = (width, up_m.len() / width);
        let ground = opening(size, up_m, cells.reach(STANDING_M));
        let window = Window::new(cells);
        let slope = |cell: usize| {
            let stands = up_m[cell] - ground[cell] > HIGH_M;
            let rise = stands.then(|| window.rise(up_m, size, cell)).flatten()?;
            let steep = rise[0].hypot(rise[1]);
            (SLOPES[0]..SLOPES[1]).contains(&steep).then(|| {
                let rise = rise.map(f64::from);
                let lit = suns.iter().map(|sun| facing(rise, sun).min(IN_IMAGES[1]));
                Slope {
                    cell,
                    rise,
                    in_images: (lit.sum::<f64>() / suns.len() as f64).max(IN_IMAGES[0]),
                }
            })
        };
        let slopes = (0..up_m.len()).into_par_iter().with_min_len(1024).filter_map(slope);
        Self(slopes.collect())
    }

    /// Multiplies the shares of the sun that cells see by how they face it, beside how they faced those of the images.
    pub(crate) fn shade(&self, sun: &SunPosition, share: &mut [f32]) {
        for slope in &self.0 {
            let change = facing(slope.rise, sun) / slope.in_images;
            let factor = 1.0 + BELIEVED * (change - 1.0);
            share[slope.cell] *= factor.clamp(RELIT[0], RELIT[1]) as f32;
        }
    }
}

/// Direct light on a slope, relative to that on level ground; zero where it faces away.
fn facing([east, north]: [f64; 2], sun: &SunPosition) -> f64 {
    let light = sun.direction_enu();
    let along = light.z - east * light.x - north * light.y;
    (along / (light.z * (1.0 + east * east + north * north).sqrt())).max(0.0)
}

/// The cells around a cell.
struct Window {
    /// Columns and rows away, and one and metres to the east and to the north.
    cells: Vec<([isize; 2], Vec3)>,
}

impl Window {
    fn new(cells: &CellVectors) -> Self {
        let reach = cells.reach(WINDOW_M).map(|cells| cells.max(WINDOW_CELLS) as isize);
        let rows = -reach[1]..=reach[1];
        let around = rows.flat_map(|row| (-reach[0]..=reach[0]).map(move |col| [col, row]));
        let place = |[col, row]: [isize; 2]| {
            let [east, north] = cells.offset_m(col as f64, row as f64);
            ([col, row], Vec3::new(1.0, east as f32, north as f32))
        };
        Self {
            cells: around.map(place).collect(),
        }
    }

    /// Rise over run to the east and to the north of the plane that most of the cells around a cell lie in; `None` where they lie in none.
    fn rise(&self, up_m: &[f32], (width, height): (usize, usize), cell: usize) -> Option<[f32; 2]> {
        let (col, row) = (cell % width, cell / width);
        let altitude = |[cols, rows]: [isize; 2]| {
            let (col, row) = (col.checked_add_signed(cols)?, row.checked_add_signed(rows)?);
            let up_m = (col < width && row < height).then(|| up_m[row * width + col])?;
            up_m.is_finite().then_some(up_m)
        };
        let middle = up_m[cell];
        let around = self.cells.iter();
        let above: Vec<(Vec3, f32)> = around
            .filter_map(|(away, place)| Some((*place, altitude(*away)? - middle)))
            .collect();
        let mut plane = Vec3::ZERO;
        for round in 0..ROUNDS {
            let near_m = NEAR_M[round.min(1)];
            // A little of the identity, so that cells in a row have a plane too.
            let (mut normal, mut right) = (Mat3::from_diagonal(Vec3::splat(1e-3)), Vec3::ZERO);
            for &(place, above_m) in &above {
                let weight = weight((above_m - plane.dot(place)) / near_m);
                normal += Mat3::from_cols(place * place.x, place * place.y, place * place.z) * weight;
                right += place * (above_m * weight);
            }
            plane = normal.inverse() * right;
        }
        let weights = above
            .iter()
            .map(|(place, above_m)| weight((above_m - plane.dot(*place)) / NEAR_M[1]));
        let share = weights.sum::<f32>() / self.cells.len() as f32;
        (share > LEAST_SHARE && plane.is_finite()).then_some([plane.y, plane.z])
    }
}

/// Tukey's biweight: one at nothing, none from one on.
fn weight(distance: f32) -> f32 {
    (1.0 - distance * distance).max(0.0).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CELL_M: f64 = 0.5;
    const WIDTH: usize = 80;
    const CELLS: CellVectors = CellVectors {
        per_col: [CELL_M, 0.0],
        per_row: [0.0, -CELL_M],
    };

    /// Level ground with a house of 16 m by 10 m whose roof rises by `rise` to a ridge from west to east, 4 m high at its eaves.
    fn house(rise: f32) -> Vec<f32> {
        let up_m = |i: usize| {
            let (col, row) = (i % WIDTH, i / WIDTH);
            let inside = (24..56).contains(&col) && (30..50).contains(&row);
            let from_ridge_m = (row as f32 - 39.5).abs() * CELL_M as f32;
            if inside { 4.0 + rise * (5.0 - from_ridge_m) } else { 0.0 }
        };
        (0..WIDTH * WIDTH).map(up_m).collect()
    }

    fn shaded(up_m: &[f32], suns: &[SunPosition], sun: &SunPosition) -> Vec<f32> {
        let mut share = vec![1.0; up_m.len()];
        RoofSlopes::new(up_m, WIDTH, &CELLS, suns).shade(sun, &mut share);
        share
    }

    const SOUTHERN: usize = 45 * WIDTH + 40;
    const NORTHERN: usize = 34 * WIDTH + 40;

    #[test]
    fn a_face_toward_a_new_sun_gains_light_and_the_other_loses_some() {
        let (above, south) = (
            SunPosition::from_degrees(90.0, 89.99),
            SunPosition::from_degrees(180.0, 40.0),
        );
        let share = shaded(&house(0.5), &[above], &south);
        // Half of what the cosine says: beside level ground 1 ± 0.5 / tan 40.
        let wanted = |sign: f64| (1.0 + BELIEVED * sign * 0.5 / 40f64.to_radians().tan()) as f32;
        assert!((share[SOUTHERN] - wanted(1.0)).abs() < 0.02, "{}", share[SOUTHERN]);
        assert!((share[NORTHERN] - wanted(-1.0)).abs() < 0.02, "{}", share[NORTHERN]);
    }

    #[test]
    fn under_the_sun_of_the_images_nothing_changes() {
        let sun = SunPosition::from_degrees(160.0, 50.0);
        let share = shaded(&house(0.5), &[sun], &sun);
        assert!(share.iter().all(|share| (share - 1.0).abs() < 1e-6));
    }

    #[test]
    fn level_roofs_ground_and_walls_keep_their_light() {
        let (noon, evening) = (
            SunPosition::from_degrees(180.0, 60.0),
            SunPosition::from_degrees(270.0, 12.0),
        );
        assert!(shaded(&house(0.0), &[noon], &evening).iter().all(|share| *share == 1.0));
        // A slope that stands upon nothing, and one whose images have no sun.
        let hill: Vec<f32> = (0..WIDTH * WIDTH).map(|i| 0.2 * (i % WIDTH) as f32).collect();
        let share = shaded(&hill, &[noon], &evening);
        assert!((0..WIDTH).all(|row| share[row * WIDTH + 40] == 1.0));
        assert!(shaded(&house(0.5), &[], &evening).iter().all(|share| *share == 1.0));
    }

    #[test]
    fn unknown_cells_have_no_slope_and_do_not_spoil_those_beside_them() {
        let (noon, south) = (
            SunPosition::from_degrees(0.0, 89.99),
            SunPosition::from_degrees(180.0, 40.0),
        );
        let whole = shaded(&house(0.5), &[noon], &south);
        let mut up_m = house(0.5);
        up_m[SOUTHERN + 1] = f32::NAN;
        let holed = shaded(&up_m, &[noon], &south);
        assert_eq!(holed[SOUTHERN + 1], 1.0);
        assert!((holed[SOUTHERN] - whole[SOUTHERN]).abs() < 1e-3);
    }
}
