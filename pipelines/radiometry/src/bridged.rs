//! Ground between walls that the sweep has bridged: shaded courts and alleys of uniform colour with few matches, so
//! that the adjacent roofs hold the surface up.
//!
//! Uncertain parts of the surface are tested by their light. Each of two surfaces, the current one and one with the
//! part lowered to the ground around it, predicts the images and pixels that show the part, and the dates on which the
//! sun reaches it. On the right surface, places lit on some dates and shaded on others are brighter when lit. A part
//! that is right as it is seldom has such a contrast when lowered, since other ground is then sampled. Figures are in
//! docs/lab/edges.md.
//!
//! Limits: a part stays unchanged when less than a tenth of it and less than five square metres are both lit on one
//! date and shaded on another. A part includes the edges of adjacent roofs, which training restores; the probability
//! and deviation of a lowered cell include its matched altitude.

use super::ground::{ground_below, ground_probability, is_sure};
use super::suns::{angles_deg, bilinear, toward};
use glam::Vec3;
use heliosplat_grid::Grid;
use heliosplat_grid::relief::{Relief, Toward};
use heliosplat_grid::statistics::{upper_median, upper_quantile};
use heliosplat_stereo::Surface;
use heliosplat_stereo::SweepView;
use heliosplat_stereo::change::Changes;
use rayon::prelude::*;

/// Least height above the ground of cells next to a part, metres.
const LEAST_ADJACENT_M: f32 = 2.0;
/// Neighbours that differ by more belong to different parts, metres.
const STEP_M: f32 = 3.0;
/// Least ground of a part, m².
const LEAST_M2: f32 = 15.0;
/// Longest shadow that is followed, metres.
const REACH_M: f32 = 60.0;
/// Least contrast of lit and shaded dates on the lowered part, a natural logarithm: direct light is at least as strong
/// as that of the sky.
const LEAST_CONTRAST: f32 = 0.65;
/// Least difference of the contrast from that on the current surface.
const LEAST_GAIN: f32 = 0.5;
/// Most contrast on the current surface of a part that is lowered: with more, the surface explains the light in part,
/// and training corrects the rest.
const MOST_CONTRAST_NOW: f32 = 0.4;
/// Least share of a part's cells that are lit on one date and shaded on another.
const LEAST_SHARE: f32 = 0.1;
/// Area of such cells that suffices at any share, m².
const LEAST_TESTED_M2: f32 = 5.0;
/// Distance from a lowered cell within which the level of the ground is measured, metres each way (docs/lab/edges.md).
const LEVEL_REACH_M: f32 = 18.0;
/// Most height above the ground of cells that count as ground, metres.
const MOST_ON_GROUND_M: f32 = 1.0;
/// Least area of such ground, m².
const LEAST_LEVEL_M2: f32 = 15.0;
/// Probability that a lowered cell is ground: the share of the lowered cells that were right within two metres, `city`
/// 11, 13, 14, 16 and `block` 21 (docs/lab/edges.md).
const LOWERED_PROBABILITY: f32 = 0.65;
/// Share of an image's pixels that are darker than its path radiance.
const DARKEST: f64 = 0.003;
/// Least brightness that is compared, as a share of the image's median.
const LEAST_BRIGHTNESS: f32 = 0.02;
/// One pixel in so many, each way, samples the brightness of an image.
const STRIDE: usize = 5;

/// The parts of a surface that were lowered.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Lowered {
    /// Number of parts.
    pub parts: usize,
    /// Ground area of these parts, m².
    pub area_m2: f64,
}

impl std::ops::AddAssign for Lowered {
    fn add_assign(&mut self, other: Self) {
        self.parts += other.parts;
        self.area_m2 += other.area_m2;
    }
}

/// Lowers the parts of a surface that bridge ground, by the light of the `views` with a known sun. Changed segments
/// stay, and the state before a change (`changes`) follows the surface elsewhere. `None` where fewer than two suns are
/// known, so that no test is possible.
pub fn lower(views: &[SweepView], surface: &mut Surface, changes: &mut Changes) -> Option<Lowered> {
    let lights: Vec<SunlitView> = views.par_iter().map(|view| SunlitView::of(view, surface)).collect();
    if lights.iter().filter(|light| light.to_sun.is_some()).count() < 2 {
        return None;
    }
    let grid = surface.grid();
    let ground_m = ground_below((grid.width, grid.height), grid.cell_m, &surface.altitude);
    let parts = parts(&grid, surface, &ground_m, changes);
    let bridged: Vec<&Vec<usize>> = (parts.par_iter())
        .filter(|part| is_bridged(&grid, surface, &ground_m, part, &lights))
        .collect();
    let parts = bridged.len();
    let mut cells: Vec<usize> = bridged.into_iter().flatten().copied().collect();
    // Neighbouring parts may share cells at their edges.
    cells.sort_unstable();
    cells.dedup();
    let level_m = levels(&grid, surface, &ground_m, &cells);
    for (&cell, &level_m) in cells.iter().zip(&level_m) {
        let height_m = surface.altitude[cell] - level_m;
        surface.probability[cell] = LOWERED_PROBABILITY;
        surface.deviation_m[cell] =
            ((1.0 - LOWERED_PROBABILITY) * height_m * height_m + surface.resolution_m * surface.resolution_m).sqrt();
        surface.altitude[cell] = level_m;
        surface.above[cell] = level_m;
        if let Some(before_m) = changes.before_m.get_mut(cell) {
            *before_m = level_m;
        }
    }
    if parts > 0 {
        let relief = Relief::new((grid.width, grid.height), grid.cell_m, surface.altitude.clone());
        for &cell in &cells {
            let point = surface.point(cell % grid.width, cell / grid.width);
            let seen = lights.iter().filter(|light| light.sees(&relief, cell, point).is_some());
            surface.views[cell] = seen.count().min(usize::from(u8::MAX)) as u8;
        }
    }
    Some(Lowered {
        parts,
        area_m2: cells.len() as f64 * f64::from(grid.cell_m * grid.cell_m),
    })
}

/// A view with its sun.
struct SunlitView<'a> {
    view: &'a SweepView<'a>,
    /// `None` where the sun is unknown, or the image shows nothing.
    to_sun: Option<Toward>,
    /// `None` for a camera straight above, from which no cell is hidden.
    to_camera: Option<Toward>,
    /// Path radiance, and the median above it.
    dark: f32,
    median: f32,
}

impl<'a> SunlitView<'a> {
    fn of(view: &'a SweepView<'a>, surface: &Surface) -> Self {
        let middle = surface.point(surface.width / 2, surface.height / 2);
        let [azimuth_deg, elevation_deg] = angles_deg(view.geometry().toward(middle));
        let image = view.image;
        let mut values: Vec<f32> = (0..image.height)
            .step_by(STRIDE)
            .flat_map(|row| (0..image.width).step_by(STRIDE).map(move |col| (col, row)))
            .map(|(col, row)| (0..image.bands).map(|band| image.at(band, col, row)).sum::<f32>() / image.bands as f32)
            .filter(|value| value.is_finite())
            .collect();
        let dark = upper_quantile(&mut values, DARKEST).unwrap_or(0.0);
        let median = upper_median(&mut values).unwrap_or(0.0) - dark;
        let sun = view.sun.filter(|_| median > 0.0).map(angles_deg);
        Self {
            view,
            to_sun: sun.map(|[azimuth_deg, elevation_deg]| toward(azimuth_deg, elevation_deg)),
            to_camera: (elevation_deg < 89.9).then(|| toward(azimuth_deg, elevation_deg)),
            dark,
            median,
        }
    }

    /// Value of the view at a cell of a relief with the centre `point`; `None` where it is hidden.
    fn sees(&self, relief: &Relief, cell: usize, point: Vec3) -> Option<f32> {
        if self.to_camera.as_ref().is_some_and(|to| relief.is_shaded(cell, to)) {
            return None;
        }
        let (col, row, _) = self.view.camera.project(point);
        Some(bilinear(self.view.image, col, row)).filter(|value| value.is_finite())
    }
}

/// Altitude of the ground at cells to lower, in ascending order: the median of certain ground around them. The opening
/// is not used, since it follows the lowest cells around, which have the largest errors. No cell is raised.
fn levels(grid: &Grid, surface: &Surface, ground_m: &[f32], cells: &[usize]) -> Vec<f32> {
    let is_ground = |&cell: &usize| {
        let height_m = surface.altitude[cell] - ground_m[cell];
        height_m <= MOST_ON_GROUND_M && is_sure(surface.probability[cell]) && cells.binary_search(&cell).is_err()
    };
    let reach = (LEVEL_REACH_M / grid.cell_m).round() as usize;
    let least = (LEAST_LEVEL_M2 / (grid.cell_m * grid.cell_m)).ceil() as usize;
    let level_m = |&cell: &usize| {
        let ground = grid.around(cell, reach).filter(is_ground);
        let mut around_m: Vec<f32> = ground.map(|cell| surface.altitude[cell]).collect();
        let median_m = upper_median(&mut around_m).filter(|_| around_m.len() >= least);
        median_m.unwrap_or(ground_m[cell]).min(surface.altitude[cell])
    };
    cells.par_iter().map(level_m).collect()
}

/// Connected uncertain cells that are above the ground around them.
fn parts(grid: &Grid, surface: &Surface, ground_m: &[f32], changes: &Changes) -> Vec<Vec<usize>> {
    let height_m = |cell: usize| surface.altitude[cell] - ground_m[cell];
    let unsure = |cell: usize| ground_probability(height_m(cell), || surface.probability[cell]).is_some();
    let level = |cell: usize| {
        let near = grid.around(cell, 1).map(|near| surface.altitude[near]);
        let (low, high) = near.fold((f32::MAX, f32::MIN), |(low, high), z| (low.min(z), high.max(z)));
        high - low <= STEP_M
    };
    let mask: Vec<bool> = grid.cells().map(|cell| unsure(cell) && level(cell)).collect();
    let whole = |cells: Vec<usize>| {
        let mut part: Vec<usize> = cells.iter().flat_map(|&cell| grid.around(cell, 1)).collect();
        part.retain(|&cell| height_m(cell) > LEAST_ADJACENT_M && changes.at(cell).is_none());
        part.sort_unstable();
        part.dedup();
        part
    };
    let least = (LEAST_M2 / (grid.cell_m * grid.cell_m)).ceil() as usize;
    let groups = grid.connected(&mask).into_iter().filter(|cells| cells.len() >= least);
    // Nothing may remain of a part in a changed segment.
    groups.map(whole).filter(|part| !part.is_empty()).collect()
}

/// True if the light of a part (cells in ascending order) is evidence of bridged ground.
fn is_bridged(grid: &Grid, surface: &Surface, ground_m: &[f32], part: &[usize], lights: &[SunlitView]) -> bool {
    let window = Surroundings::around(grid, part);
    let now = window.contrast(grid, part, lights, &|cell| surface.altitude[cell]);
    let then = window.contrast(grid, part, lights, &|cell| match part.binary_search(&cell) {
        Ok(_) => ground_m[cell],
        Err(_) => surface.altitude[cell],
    });
    let now = now.map_or(0.0, |now| now.mean);
    let part_m2 = part.len() as f32 * grid.cell_m * grid.cell_m;
    let tells = |then: Contrast| {
        let enough = then.share > LEAST_SHARE || then.share * part_m2 >= LEAST_TESTED_M2;
        enough && then.mean > LEAST_CONTRAST && then.mean - now.max(0.0) > LEAST_GAIN
    };
    let bridged = now < MOST_CONTRAST_NOW && then.is_some_and(tells);
    tracing::debug!(
        cells = part.len(),
        col = part[0] % grid.width,
        row = part[0] / grid.width,
        now,
        lowered = ?then,
        bridged,
        "in doubt"
    );
    bridged
}

/// Brightness of cells on the dates on which they are lit relative to those on which they are shaded.
#[derive(Debug, Clone, Copy)]
struct Contrast {
    /// Mean over the cells that are both, a natural logarithm.
    mean: f32,
    /// Share of the part's cells that are both, 0 to 1.
    share: f32,
}

/// The ground around a part, within the reach of shadows and occlusion on the part.
struct Surroundings {
    first: [usize; 2],
    size: (usize, usize),
}

impl Surroundings {
    fn around(grid: &Grid, part: &[usize]) -> Self {
        let reach = (REACH_M / grid.cell_m).ceil() as usize;
        let span = |at: &dyn Fn(usize) -> usize, count: usize| {
            let all = || part.iter().map(|&cell| at(cell));
            let (first, last) = (all().min().unwrap_or(0), all().max().unwrap_or(0));
            let first = first.saturating_sub(reach);
            (first, (last + reach + 1).min(count) - first)
        };
        let (col, width) = span(&|cell| cell % grid.width, grid.width);
        let (row, height) = span(&|cell| cell / grid.width, grid.height);
        Self {
            first: [col, row],
            size: (width, height),
        }
    }

    /// The contrast of a part on a surface; `None` where no cell is both lit and in shade.
    fn contrast(
        &self,
        grid: &Grid,
        part: &[usize],
        lights: &[SunlitView],
        altitude_m: &dyn Fn(usize) -> f32,
    ) -> Option<Contrast> {
        let [col0, row0] = self.first;
        let (width, height) = self.size;
        let cells = (0..height).flat_map(|row| (0..width).map(move |col| (row0 + row) * grid.width + col0 + col));
        let relief = Relief::new(self.size, grid.cell_m, cells.map(altitude_m).collect());
        let (mut sum, mut both) = (0.0f64, 0usize);
        for &cell in part {
            let (col, row) = (cell % grid.width, cell / grid.width);
            let place = (row - row0) * width + col - col0;
            let point = grid.point(col as isize, row as isize, altitude_m(cell));
            let (mut sums, mut counts) = ([0.0f64; 2], [0usize; 2]);
            for light in lights {
                let Some(to_sun) = &light.to_sun else { continue };
                let Some(value) = light.sees(&relief, place, point) else {
                    continue;
                };
                let brightness = ((value - light.dark) / light.median).max(LEAST_BRIGHTNESS);
                let lit = usize::from(!relief.is_shaded(place, to_sun));
                sums[lit] += f64::from(brightness.ln());
                counts[lit] += 1;
            }
            if counts[0] > 0 && counts[1] > 0 {
                sum += sums[1] / counts[1] as f64 - sums[0] / counts[0] as f64;
                both += 1;
            }
        }
        (both > 0).then(|| Contrast {
            mean: (sum / both as f64) as f32,
            share: both as f32 / part.len() as f32,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat::{ProjectiveCamera, Raster};
    use heliosplat_stereo::change::Segment;

    const SIDE: usize = 60;
    const HOUSES_M: f32 = 10.0;
    /// Azimuths and elevations of the suns of the images, degrees.
    const SUNS: [[f64; 2]; 5] = [[180.0, 50.0], [180.0, 65.0], [95.0, 40.0], [150.0, 45.0], [230.0, 60.0]];

    /// Azimuths and elevations of their cameras as the ground sees them, degrees. The last looks over the northern
    /// houses, which hide 2.7 m of the court.
    const CAMERAS: [[f64; 2]; 5] = [[90.0, 75.0], [270.0, 80.0], [90.0, 85.0], [270.0, 89.95], [0.0, 75.0]];

    /// Rows next to the houses where the sweep is too low, and their altitude there, metres.
    const BESIDE: [usize; 4] = [18, 19, 42, 43];
    const BESIDE_M: f32 = -0.9;

    /// Two rows of houses, and the court of ten metres between them.
    fn is_court(cell: usize) -> bool {
        (26..36).contains(&(cell / SIDE)) && (10..50).contains(&(cell % SIDE))
    }

    fn is_built(cell: usize) -> bool {
        (20..42).contains(&(cell / SIDE)) && (10..50).contains(&(cell % SIDE))
    }

    fn direction([azimuth_deg, elevation_deg]: [f64; 2]) -> Vec3 {
        let ((east, north), (up, across)) = (azimuth_deg.to_radians().sin_cos(), elevation_deg.to_radians().sin_cos());
        Vec3::new((across * east) as f32, (across * north) as f32, up as f32)
    }

    /// Image of `values` on a relief from a camera whose pixels are the cells at altitude 0.
    fn seen(height_m: &dyn Fn(usize) -> f32, values: &[f32], to_camera: Vec3) -> Raster {
        let mut image = Raster::filled(SIDE, SIDE, 1, 0.0);
        image.values = (0..SIDE * SIDE)
            .map(|pixel| {
                let cell_below = |z: f32| {
                    let shift = to_camera * (z / to_camera.z);
                    let at = |index: usize, by: f32| (index as f32 + by).round().clamp(0.0, SIDE as f32 - 1.0) as usize;
                    at(pixel / SIDE, -shift.y) * SIDE + at(pixel % SIDE, shift.x)
                };
                let altitudes = (0..=100).rev().map(|step| step as f32 / 100.0 * HOUSES_M);
                let mut hits = altitudes.filter(|&z| height_m(cell_below(z)) >= z).map(cell_below);
                values[hits.next().expect("the ground")]
            })
            .collect();
        image
    }

    fn camera(to_camera: Vec3) -> ProjectiveCamera {
        let [east, north] = [to_camera.x, to_camera.y].map(|across| f64::from(across / to_camera.z));
        let (u, v) = ([1.0, 0.0, -east, -0.5], [0.0, -1.0, north, -0.5]);
        ProjectiveCamera::new(u, v, [0.0; 3], (SIDE, SIDE), -to_camera.as_dvec3())
    }

    /// Remaining height of a court that the sweep bridged with low certainty, in images of a court `court_m` high with
    /// an `albedo`.
    fn left_m(court_m: f32, albedo: f32) -> f32 {
        let cells = SIDE * SIDE;
        let height_m = |cell: usize| match cell {
            cell if is_court(cell) => court_m,
            cell if is_built(cell) => HOUSES_M,
            _ => 0.0,
        };
        let relief = Relief::new((SIDE, SIDE), 1.0, (0..cells).map(height_m).collect());
        let image = |([azimuth_deg, elevation_deg], at): ([f64; 2], [f64; 2])| {
            let shadows = relief.shadows(azimuth_deg, elevation_deg);
            let brightness = |cell: usize| {
                let albedo = if is_court(cell) { albedo } else { 0.2 };
                (albedo + 0.01 * (cell * 7919 % 11) as f32) * if shadows[cell] { 0.35 } else { 1.0 }
            };
            let values: Vec<f32> = (0..cells).map(brightness).collect();
            seen(&height_m, &values, direction(at))
        };
        let images: Vec<Raster> = SUNS.into_iter().zip(CAMERAS).map(image).collect();
        let views: Vec<SweepView> = (images.iter().zip(SUNS.into_iter().zip(CAMERAS)).enumerate())
            .map(|(k, (image, (sun, at)))| SweepView {
                camera: camera(direction(at)),
                image,
                index: None,
                date_group: k as u32,
                sun: Some(direction(sun)),
            })
            .collect();
        let swept_m = |cell: usize| match cell {
            cell if is_built(cell) => HOUSES_M,
            cell if BESIDE.contains(&(cell / SIDE)) => BESIDE_M,
            _ => 0.0,
        };
        let altitude: Vec<f32> = (0..cells).map(swept_m).collect();
        let mut surface = Surface {
            width: SIDE,
            height: SIDE,
            cell_m: 1.0,
            above: altitude.clone(),
            altitude: altitude.clone(),
            views: vec![0; cells],
            probability: (0..cells).map(|cell| if is_court(cell) { 0.8 } else { 1.0 }).collect(),
            deviation_m: vec![0.5; cells],
            resolution_m: 0.5,
            ..Surface::default()
        };
        let lowered = lower(&views, &mut surface, &mut Changes::default()).expect("suns are known");
        let court = (0..cells).filter(|&cell| is_court(cell));
        let highest = court.map(|cell| surface.altitude[cell]).fold(f32::MIN, f32::max);
        assert_eq!(lowered.parts, usize::from(highest < HOUSES_M));
        for (row, count) in [(27, views.len() - 1), (30, views.len())] {
            let seen_by = usize::from(surface.views[row * SIDE + SIDE / 2]);
            assert_eq!(seen_by, lowered.parts * count, "who sees the court is counted anew");
        }
        let opened: Vec<usize> = (0..cells)
            .filter(|&cell| surface.altitude[cell] < altitude[cell])
            .collect();
        assert_eq!(lowered.area_m2, opened.len() as f64);
        let may_be_a_roof = |&cell: &usize| {
            let deviation_m = surface.deviation_m[cell];
            surface.probability[cell] < 0.8 && deviation_m > HOUSES_M / 2.0 && deviation_m < HOUSES_M
        };
        assert!(
            opened.iter().all(may_be_a_roof),
            "a lowered cell may be as high as it was"
        );
        assert!(
            (0..cells)
                .filter(|&cell| !is_built(cell))
                .all(|cell| surface.altitude[cell] == altitude[cell])
        );
        assert!(
            opened.iter().all(|&cell| surface.altitude[cell] == 0.0),
            "opened ground is as high as most ground around, not as the lowest"
        );
        highest
    }

    #[test]
    fn a_part_that_changed_altogether_is_no_part() {
        let grid = Grid::plain(SIDE, SIDE);
        let height_m: Vec<f32> = (0..SIDE * SIDE)
            .map(|cell| if is_built(cell) { HOUSES_M } else { 0.0 })
            .collect();
        let surface = Surface {
            width: SIDE,
            height: SIDE,
            cell_m: 1.0,
            probability: (0..SIDE * SIDE)
                .map(|cell| if is_court(cell) { 0.8 } else { 1.0 })
                .collect(),
            altitude: height_m,
            ..Surface::default()
        };
        let changed = Changes {
            segments: vec![Segment {
                day: 1,
                difference_m: HOUSES_M,
                area_m2: 1.0,
                bounds_m: [0.0; 4],
                confidence: 0.9,
            }],
            label: vec![1; SIDE * SIDE],
            ..Changes::default()
        };
        let ground_m = vec![0.0; SIDE * SIDE];
        assert_eq!(parts(&grid, &surface, &ground_m, &Changes::default()).len(), 1);
        assert!(parts(&grid, &surface, &ground_m, &changed).is_empty());
    }

    #[test]
    fn a_court_in_shade_that_was_bridged_is_opened() {
        assert_eq!(left_m(0.0, 0.2), 0.0);
    }

    #[test]
    fn a_dark_roof_of_which_the_sweep_is_not_sure_stays() {
        assert_eq!(left_m(HOUSES_M, 0.03), HOUSES_M);
    }
}
