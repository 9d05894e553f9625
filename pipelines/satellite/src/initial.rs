//! Gaussians on an initial surface: one flat disc per cell, walls under its steps, and ground under structures at a
//! step.
//!
//! * Without walls a roof is a table: oblique views look under it and the sun shines through below. The discs of a wall
//!   are half a cell inside the roof's edge, where the roof hides them from above, and begin below the roof.
//! * A sweep makes roofs a cell or two too wide and covers narrow alleys. Near a step, and further where the sweep was
//!   uncertain, the ground is laid under the roof as well, and the roof starts less opaque: training removes the parts
//!   of the roof that the images do not show, and the ground below remains.

use glam::{Mat3, Quat, Vec3};
use heliosplat::gaussians::{Group, GroupSpec, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups, logit};
use heliosplat::model::shadow_gs::{ALWAYS, DAYS};
use heliosplat_stereo::Surface;
use heliosplat_stereo::change::Changes;
use std::collections::BTreeSet;

/// Standard deviation of a disc along the surface, cells: neighbours overlap so that no light passes between them.
const SPREAD_CELLS: f32 = 0.65;
/// Standard deviation of a disc across the surface, cells: flat, but thick enough to be visible from the side.
const THICKNESS_CELLS: f32 = 0.2;
/// Opacity of certain surfaces; higher opacities are saturated and have no gradients.
const OPACITY_SURE: f32 = 0.99;
/// Least height of a step with a wall, metres: lower steps are cars, hedges or noise.
const WALL_FROM_M: f32 = 2.0;
/// Vertical distance between the discs of a wall, cells; they are stretched to meet.
const WALL_PITCH_CELLS: f32 = 2.0;
/// Slope above which a disc stays level: the surface has a step there.
const STEEPEST: f32 = 1.5;
/// Least height of a step with a wall, height steps of the plane sweep: lower steps are noise.
const WALL_FROM_STEPS: f32 = 3.0;
/// Radius of the neighbourhood whose lowest cell is the floor, cells: near a step, and where the sweep was uncertain.
const FLOOR_CELLS: (usize, usize) = (4, 9);
/// Confidence below which the sweep counts as uncertain.
const DOUBT: f32 = 0.1;
/// Factor of the opacity at steps for a roof or crown where the sweep was uncertain or preferred the ground. Such a
/// place is mostly ground (docs/lab/start.md).
const DOUBTFUL_SHARE: f32 = 0.25;

/// Positions and orientations of the discs.
struct Discs {
    cell_m: f32,
    position: Vec<f32>,
    rotation: Vec<f32>,
    log_scale: Vec<f32>,
    opacity: Vec<f32>,
}

/// A disc: its normal is the rotated z axis; extents along the rotated x and y axes are in cells.
struct Disc {
    centre: Vec3,
    rotation: Quat,
    extent_cells: [f32; 2],
    opacity: f32,
}

impl Discs {
    fn add(&mut self, disc: &Disc) {
        let spread = disc.extent_cells.map(|cells| (SPREAD_CELLS * cells * self.cell_m).ln());
        let thickness = (THICKNESS_CELLS * self.cell_m).ln();
        self.position.extend(disc.centre.to_array());
        self.rotation.extend(disc.rotation.to_array());
        self.log_scale.extend([spread[0], spread[1], thickness]);
        self.opacity.push(logit(disc.opacity));
    }

    /// Adds the wall under a cell that stands `step.drop_m` above its lowest neighbour.
    fn add_wall(&mut self, top: Vec3, step: &Step, opacity: f32) {
        let pitch = WALL_PITCH_CELLS * self.cell_m;
        let height = (step.drop_m - self.cell_m).max(self.cell_m);
        let count = (height / pitch).ceil().max(1.0);
        for k in 0..count as usize {
            let down = self.cell_m + height * (k as f32 + 0.5) / count;
            self.add(&Disc {
                centre: top - Vec3::Z * down,
                rotation: upright(step.outward),
                extent_cells: [1.0, height / count / self.cell_m],
                opacity,
            });
        }
    }
}

/// Rotation of z to a horizontal direction and of y to the vertical.
fn upright(outward: Vec3) -> Quat {
    Quat::from_mat3(&Mat3::from_cols(Vec3::Z.cross(outward), Vec3::Z, outward))
}

/// Step down from a cell to a neighbour.
struct Step {
    /// Height of the cell above its lowest side neighbour, metres.
    drop_m: f32,
    /// Horizontal unit vector down the step.
    outward: Vec3,
}

fn step_at(surface: &Surface, col: usize, row: usize) -> Option<Step> {
    let here = surface.altitude[row * surface.width + col];
    let (mut drop_m, mut outward) = (0.0f32, Vec3::ZERO);
    for (dc, dr) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
        let (c, r) = (col as isize + dc, row as isize + dr);
        if c < 0 || r < 0 || c >= surface.width as isize || r >= surface.height as isize {
            continue;
        }
        let fall = here - surface.altitude[r as usize * surface.width + c as usize];
        if fall > 0.0 {
            outward += Vec3::new(dc as f32, -dr as f32, 0.0).normalize() * fall;
            if dc == 0 || dr == 0 {
                drop_m = drop_m.max(fall);
            }
        }
    }
    let outward = outward.try_normalize()?;
    Some(Step { drop_m, outward })
}

/// Rotation and extents, cells, of a cell's disc: inclined as the surface, and as long up the slope as the surface in
/// the cell, else steep ground has gaps; level where the surface has a step.
fn lie(surface: &Surface, col: usize, row: usize) -> (Quat, [f32; 2]) {
    let (east, north) = surface.slope(col, row);
    let level = Vec3::new(north, -east, 0.0).try_normalize();
    match level.filter(|_| east.abs().max(north.abs()) <= STEEPEST) {
        None => (Quat::IDENTITY, [1.0; 2]),
        Some(level) => {
            let normal = Vec3::new(-east, -north, 1.0);
            let up = normal.normalize();
            let rotation = Quat::from_mat3(&Mat3::from_cols(level, up.cross(level), up));
            (rotation, [1.0, normal.length()])
        }
    }
}

/// Opacity of Gaussians near a step above ground that is laid under them; training decides which of the two is real
/// (docs/lab/start.md).
const STEP_OPACITY: f32 = 0.35;

/// Input of the initial Gaussians.
pub(super) struct Start<'a> {
    /// Initial surface.
    pub(super) surface: &'a Surface,
    /// True for the cells that get discs.
    pub(super) covered: &'a [bool],
}

impl Start<'_> {
    /// The Gaussians; the groups of `features` are zero.
    pub(super) fn gaussians(&self, features: Vec<GroupSpec>) -> Table {
        let mut discs = Discs {
            cell_m: self.surface.cell_m,
            position: Vec::new(),
            rotation: Vec::new(),
            log_scale: Vec::new(),
            opacity: Vec::new(),
        };
        self.on_surface(&mut discs);
        let mut groups = core_groups();
        groups.extend(features);
        let mut table = Table::zeros(groups, discs.opacity.len());
        table.group_mut(POSITION).copy_from_slice(&discs.position);
        table.group_mut(ROTATION).copy_from_slice(&discs.rotation);
        table.group_mut(LOG_SCALE).copy_from_slice(&discs.log_scale);
        table.group_mut(OPACITY).copy_from_slice(&discs.opacity);
        table
    }

    /// Adds the discs of the covered cells, with their walls and floors.
    fn on_surface(&self, discs: &mut Discs) {
        let &Self { surface, covered } = self;
        let wall_from_m = WALL_FROM_M.max(WALL_FROM_STEPS * surface.resolution_m);
        let floors = (surface.lowest(FLOOR_CELLS.0), surface.lowest(FLOOR_CELLS.1));
        for cell in (0..covered.len()).filter(|&cell| covered[cell]) {
            let (col, row) = (cell % surface.width, cell / surface.width);
            let here = surface.point(col, row);
            let doubtful = surface.confidence[cell] < DOUBT;
            let floor_m = if doubtful { floors.1[cell] } else { floors.0[cell] };
            let above_floor = here.z - floor_m > wall_from_m;
            let opacity = match (above_floor, doubtful) {
                (false, _) => OPACITY_SURE,
                (true, false) => STEP_OPACITY,
                (true, true) => DOUBTFUL_SHARE * STEP_OPACITY,
            };
            let (rotation, extent_cells) = lie(surface, col, row);
            discs.add(&Disc {
                centre: here,
                rotation,
                extent_cells,
                opacity,
            });
            let level = |z: f32, opacity: f32| Disc {
                centre: here.with_z(z),
                rotation: Quat::IDENTITY,
                extent_cells: [1.0; 2],
                opacity,
            };
            let above_m = surface.above[cell];
            if above_m - here.z > wall_from_m {
                // Ground that was preferred to a match is uncertain, so training decides between the two.
                discs.add(&level(above_m, DOUBTFUL_SHARE * STEP_OPACITY));
            }
            if above_floor {
                discs.add(&level(floor_m, OPACITY_SURE));
            }
            if let Some(step) = step_at(surface, col, row).filter(|step| step.drop_m > wall_from_m) {
                discs.add_wall(here, &step, opacity);
            }
        }
    }
}

/// Gaussians of a surface that changed. Unchanged cells get the Gaussians of the surface, which is that of the last
/// day. Changed cells get those of the earlier surface until the day of the change, and those of the surface from then
/// on. `groups` end with the days.
pub(super) fn changing(start: &Start, changes: &Changes, groups: &[GroupSpec]) -> Table {
    let &Start { surface, covered, .. } = start;
    let before = Surface {
        above: changes.before_m.clone(),
        altitude: changes.before_m.clone(),
        ..surface.clone()
    };
    let near = around_changes(surface, changes);
    let part = |surface: &Surface, day: Option<i32>, days: [f32; 2]| {
        let covered: Vec<bool> = covered
            .iter()
            .zip(&near)
            .map(|(covered, near)| *covered && *near == day)
            .collect();
        let of = Start {
            surface,
            covered: &covered,
        };
        let mut table = of.gaussians(groups.to_vec());
        if let Some(group) = table.groups.iter_mut().find(|group| group.spec.name == DAYS) {
            group
                .values
                .chunks_exact_mut(2)
                .for_each(|window| window.copy_from_slice(&days));
        }
        table
    };
    let mut all = part(surface, None, ALWAYS);
    let days: BTreeSet<i32> = near.iter().copied().flatten().collect();
    for day in days {
        all = joined(all, part(&before, Some(day), [ALWAYS[0], day as f32]));
        all = joined(all, part(surface, Some(day), [day as f32, ALWAYS[1]]));
    }
    all
}

/// Radius around a segment within which Gaussians get the segment's days, cells: for its walls and the ground under its
/// eaves.
const AROUND_CELLS: usize = 2;

/// Day of the change for each cell in or near a segment; `None` elsewhere.
fn around_changes(surface: &Surface, changes: &Changes) -> Vec<Option<i32>> {
    let (width, height) = (surface.width, surface.height);
    let mut near = vec![None; width * height];
    for cell in 0..near.len() {
        let Some(segment) = changes.at(cell) else { continue };
        let (col, row) = (cell % width, cell / width);
        let span = |at: usize, count: usize| at.saturating_sub(AROUND_CELLS)..(at + AROUND_CELLS + 1).min(count);
        for r in span(row, height) {
            for c in span(col, width) {
                let of = &mut near[r * width + c];
                *of = Some(of.map_or(segment.day, |day: i32| day.max(segment.day)));
            }
        }
    }
    // In a segment the segment's day counts, whatever other segments are near.
    for (cell, of) in near.iter_mut().enumerate() {
        if let Some(segment) = changes.at(cell) {
            *of = Some(segment.day);
        }
    }
    near
}

/// Joins the elements of two tables with equal groups.
fn joined(a: Table, b: Table) -> Table {
    let groups = a.groups.into_iter().zip(b.groups).map(|(a, b)| Group {
        spec: a.spec,
        values: [a.values, b.values].concat(),
    });
    Table {
        count: a.count + b.count,
        groups: groups.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use heliosplat::camera::ProjectiveCamera;
    use heliosplat::model::shadow_gs::{ShadowGs, ShadowGsOptions};
    use heliosplat::model::{Parameters, SceneModel};
    use heliosplat::render::{PassOptions, render};

    fn surface(altitude: Vec<f32>, width: usize) -> Surface {
        let count = altitude.len();
        Surface {
            width,
            height: count / width,
            west_m: 0.0,
            north_m: 0.0,
            cell_m: 0.5,
            above: altitude.clone(),
            altitude,
            confidence: vec![1.0; count],
            resolution_m: 0.1,
            filled: vec![false; count],
            ..Surface::default()
        }
    }

    fn gaussians_on(surface: &Surface, covered: &[bool]) -> Table {
        let start = Start { surface, covered };
        start.gaussians(vec![])
    }

    #[test]
    fn level_ground_is_one_level_disc_per_cell() {
        let table = gaussians_on(&surface(vec![3.0; 6], 3), &[true; 6]);
        assert_eq!(table.count, 6);
        assert_eq!(table.position(4), Vec3::new(0.75, -0.75, 3.0));
        assert!((table.rotation(4) * Vec3::Z - Vec3::Z).length() < 1e-6);
    }

    /// Least alpha of solid Gaussians in the middle of a plane of the given slopes, seen along `tilt`, metres east and
    /// north per metre up.
    fn least_alpha(slopes: [f32; 2], tilt: [f64; 2]) -> f32 {
        let (cells, cell_m) = (41, 0.5f32);
        let altitude = |cell: usize| {
            let [east, south] = [cell % cells, cell / cells].map(|i| (i as f32 - 20.0) * cell_m);
            slopes[0] * east - slopes[1] * south
        };
        let plane = surface((0..cells * cells).map(altitude).collect(), cells);
        let model = ShadowGs::new(ShadowGsOptions::default());
        let mut parameters = Parameters {
            gaussians: Start {
                surface: &plane,
                covered: &vec![true; cells * cells],
            }
            .gaussians(model.feature_groups()),
            globals: model.initial_globals(0.3),
        };
        parameters.gaussians.group_mut(OPACITY).fill(logit(0.99));
        // Eleven by eleven pixels as large as cells, around the middle of the plane.
        let middle = f64::from(cell_m) * 20.5;
        let per_m = 1.0 / f64::from(cell_m);
        let u = [per_m, 0.0, -tilt[0] * per_m, 5.0 - middle * per_m];
        let v = [0.0, -per_m, tilt[1] * per_m, 5.0 - middle * per_m];
        let camera = ProjectiveCamera::new(u, v, [0.0; 3], (11, 11), -DVec3::Z);
        let rendered = render(&model, &parameters, &camera, None, None, PassOptions::default());
        rendered.maps.alpha.iter().copied().fold(1.0, f32::min)
    }

    #[test]
    fn slopes_have_no_gaps_from_above_nor_from_the_side() {
        for slope in [0.0, 0.6, 1.0, 1.3, 1.5] {
            for slopes in [[slope, 0.0], [0.0, -slope], [0.7 * slope, 0.7 * slope]] {
                for tilt in [[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.3, -0.4]] {
                    // From behind, the plane hides its own front.
                    if f64::from(slopes[0]) * tilt[0] + f64::from(slopes[1]) * tilt[1] < 0.7 {
                        let least = least_alpha(slopes, tilt);
                        assert!(least > 0.95, "{slopes:?} seen along {tilt:?}: {least}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_cell_that_few_images_show_gets_no_disc() {
        let covered = [true, false, true, true];
        let table = gaussians_on(&surface(vec![0.0, 9.0, 0.0, 0.0], 4), &covered);
        assert_eq!(table.count, 3);
        assert!((0..3).all(|i| table.position(i).z < 1.0));
    }

    /// A strip of roof, 6 m up, west of level ground: twenty cells of each.
    fn eaves() -> Table {
        let altitude: Vec<f32> = (0..40).map(|i| if i < 20 { 6.0 } else { 0.0 }).collect();
        gaussians_on(&surface(altitude, 40), &[true; 40])
    }

    #[test]
    fn a_step_gets_a_wall_below_its_roof_and_above_the_ground() {
        let table = eaves();
        let upright: Vec<usize> = (0..table.count)
            .filter(|&i| (table.rotation(i) * Vec3::Z).z.abs() < 1e-3)
            .collect();
        assert!(!upright.is_empty());
        for i in upright {
            let (p, normal) = (table.position(i), table.rotation(i) * Vec3::Z);
            assert!((p.x - 9.75).abs() < 1e-5, "in the last cell of the roof: {p}");
            assert!(p.z > 0.0 && p.z < 5.5, "{p}");
            assert!(
                (normal - Vec3::X).length() < 1e-3,
                "facing the ground beside it: {normal}"
            );
        }
    }

    #[test]
    fn ground_lies_under_the_edge_of_a_roof_and_only_there() {
        let table = eaves();
        let under_roof: Vec<f32> = (0..table.count)
            .map(|i| table.position(i))
            .filter(|p| p.x < 10.0 && p.z == 0.0)
            .map(|p| p.x)
            .collect();
        assert_eq!(under_roof.len(), FLOOR_CELLS.0);
        assert!(under_roof.iter().all(|&x| x > 8.0));
    }

    #[test]
    fn what_the_ground_was_preferred_to_starts_above_it() {
        let mut surface = surface(vec![0.0; 9], 3);
        surface.above[4] = 6.0;
        let table = gaussians_on(&surface, &[true; 9]);
        let over: Vec<usize> = (0..table.count).filter(|&i| table.position(i).z == 6.0).collect();
        assert_eq!((table.count, over.len()), (10, 1));
        assert!((table.opacity(over[0]) - DOUBTFUL_SHARE * 0.35).abs() < 1e-5);
    }
}
