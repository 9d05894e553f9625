//! Gaussians on a swept surface: one flat disc per cell, and walls where the surface steps.

use super::config::StartOptions;
use glam::{Mat3, Quat, Vec3};
use heliosplat::gaussians::{GroupSpec, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups, logit};
use heliosplat::start::Surface;

/// Slopes beyond this are steps, not slopes: the disc stays level there.
const STEEPEST: f32 = 1.5;

/// Where the discs stand and how they lie.
struct Discs<'a> {
    options: &'a StartOptions,
    cell_m: f32,
    position: Vec<f32>,
    rotation: Vec<f32>,
    log_scale: Vec<f32>,
    opacity: Vec<f32>,
}

impl Discs<'_> {
    /// A disc of one cell's width and `tall` cells' height across its own third axis.
    fn add(&mut self, centre: Vec3, rotation: Quat, tall: f32) {
        let spread = self.options.spread_cells * self.cell_m;
        let thickness = self.options.thickness_cells * self.cell_m;
        self.position.extend(centre.to_array());
        self.rotation.extend(rotation.to_array());
        self.log_scale
            .extend([spread.ln(), (spread * tall).ln(), thickness.ln()]);
        self.opacity.push(logit(self.options.opacity));
    }

    /// A wall between two neighbouring cells' centres, `along` the direction from the first to the second.
    fn wall(&mut self, a: Vec3, b: Vec3, along: Vec3) {
        let height = (b.z - a.z).abs();
        if height < self.options.wall_cells * self.cell_m {
            return;
        }
        let (low, normal) = if a.z < b.z { (a.z, -along) } else { (b.z, along) };
        // A façade has nothing to say at the resolution of the ground: its discs are twice as tall as wide.
        let steps = (height / (2.0 * self.cell_m)).round().max(1.0) as usize;
        let tall = height / steps as f32;
        // Under the eaves of the high side: seen from above, the wall's own width must not widen the roof.
        let (high, ground) = if a.z < b.z { (b, a) } else { (a, b) };
        let foot = high * 0.8 + ground * 0.2;
        for step in 0..steps {
            let z = low + (step as f32 + 0.5) * tall;
            let rotation = Quat::from_mat3(&Mat3::from_cols(normal.cross(Vec3::Z), Vec3::Z, normal));
            self.add(foot.with_z(z), rotation, tall / self.cell_m);
        }
    }
}

/// The Gaussians of the cells of `surface` that are `covered`; the groups of `features` are zero.
pub(super) fn gaussians_on(
    surface: &Surface,
    covered: &[bool],
    options: &StartOptions,
    features: Vec<GroupSpec>,
) -> Table {
    let mut discs = Discs {
        options,
        cell_m: surface.cell_m,
        position: Vec::new(),
        rotation: Vec::new(),
        log_scale: Vec::new(),
        opacity: Vec::new(),
    };
    let rough = rough(surface, options.wall_cells * surface.cell_m);
    for row in 0..surface.height {
        for col in 0..surface.width {
            let cell = row * surface.width + col;
            if !covered[cell] {
                continue;
            }
            let here = surface.point(col, row);
            let (east, north) = surface.slope(col, row);
            let slope = if east.abs().max(north.abs()) > STEEPEST {
                (0.0, 0.0)
            } else {
                (east, north)
            };
            let normal = Vec3::new(-slope.0, -slope.1, 1.0).normalize();
            discs.add(here, Quat::from_rotation_arc(Vec3::Z, normal), 1.0);
            if rough[cell] {
                continue;
            }
            if col + 1 < surface.width && covered[cell + 1] {
                discs.wall(here, surface.point(col + 1, row), Vec3::X);
            }
            if row + 1 < surface.height && covered[cell + surface.width] {
                discs.wall(here, surface.point(col, row + 1), Vec3::NEG_Y);
            }
        }
    }
    let mut groups = core_groups();
    groups.extend(features);
    let mut table = Table::zeros(groups, discs.opacity.len());
    table.group_mut(POSITION).copy_from_slice(&discs.position);
    table.group_mut(ROTATION).copy_from_slice(&discs.rotation);
    table.group_mut(LOG_SCALE).copy_from_slice(&discs.log_scale);
    table.group_mut(OPACITY).copy_from_slice(&discs.opacity);
    table
}

/// Cells around which the surface steps so often that it is noise and no building: walls there would be a thicket.
fn rough(surface: &Surface, step_m: f32) -> Vec<bool> {
    const RADIUS: usize = 3;
    /// A straight wall steps once per row of the window, a corner or a narrow yard up to three times.
    const STEPS_PER_ROW: usize = 3;
    let (width, height) = (surface.width, surface.height);
    let steps = |i: usize, j: usize| usize::from((surface.altitude[i] - surface.altitude[j]).abs() > step_m);
    (0..width * height)
        .map(|cell| {
            let (col, row) = (cell % width, cell / width);
            let mut count = 0;
            for r in row.saturating_sub(RADIUS)..(row + RADIUS).min(height - 1) {
                for c in col.saturating_sub(RADIUS)..(col + RADIUS).min(width - 1) {
                    let i = r * width + c;
                    count += steps(i, i + 1) + steps(i, i + width);
                }
            }
            count > STEPS_PER_ROW * 2 * RADIUS
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface(altitude: Vec<f32>, width: usize) -> Surface {
        let count = altitude.len();
        Surface {
            width,
            height: count / width,
            west_m: 0.0,
            north_m: 0.0,
            cell_m: 0.5,
            altitude,
            confidence: vec![1.0; count],
            views: vec![2; count],
            filled: vec![false; count],
        }
    }

    #[test]
    fn level_ground_is_one_level_disc_per_cell() {
        let table = gaussians_on(&surface(vec![3.0; 6], 3), &[true; 6], &StartOptions::default(), vec![]);
        assert_eq!(table.count, 6);
        assert_eq!(table.position(4), Vec3::new(0.75, -0.75, 3.0));
        assert!((table.rotation(4) * Vec3::Z - Vec3::Z).length() < 1e-6);
    }

    #[test]
    fn a_step_gets_a_wall_that_faces_the_low_side() {
        let table = gaussians_on(
            &surface(vec![0.0, 0.0, 4.0, 4.0], 4),
            &[true; 4],
            &StartOptions::default(),
            vec![],
        );
        assert_eq!(table.count, 4 + 4);
        let walls: Vec<usize> = (0..table.count)
            .filter(|&i| (table.position(i).x - 1.0).abs() < 1e-6)
            .collect();
        assert_eq!(walls.len(), 4);
        for i in walls {
            assert!((table.rotation(i) * Vec3::Z - Vec3::NEG_X).length() < 1e-5);
            assert!((0.0..4.0).contains(&table.position(i).z));
        }
    }
}
