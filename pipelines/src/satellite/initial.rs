//! Gaussians on a swept surface: one flat disc per cell. Steps get no walls of their own: discs on façades were tried and
//! made both surface and shadows worse (`docs/satellite.md`).

use super::config::StartOptions;
use glam::{Quat, Vec3};
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
    fn add(&mut self, centre: Vec3, rotation: Quat) {
        let spread = self.options.spread_cells * self.cell_m;
        let thickness = self.options.thickness_cells * self.cell_m;
        self.position.extend(centre.to_array());
        self.rotation.extend(rotation.to_array());
        self.log_scale.extend([spread.ln(), spread.ln(), thickness.ln()]);
        self.opacity.push(logit(self.options.opacity));
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
            discs.add(here, Quat::from_rotation_arc(Vec3::Z, normal));
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
    fn a_cell_that_few_images_show_gets_no_disc() {
        let covered = [true, false, true, true];
        let table = gaussians_on(
            &surface(vec![0.0, 9.0, 0.0, 0.0], 4),
            &covered,
            &StartOptions::default(),
            vec![],
        );
        assert_eq!(table.count, 3);
        assert!((0..3).all(|i| table.position(i).z < 1.0));
    }
}
