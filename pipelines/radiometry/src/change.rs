//! Evidence of change from the shadows around a segment, for its two states.
//!
//! A house shades ground outside its own lot. Where the two states shade different ground, its darkness in an image
//! identifies the state, independently of all other images. So a side with a single pair of images, for which matching
//! has little evidence, has as many observations as dates.
//!
//! Darkness is measured against the other dates on which the same ground is lit. The likelihood of each darkness in the
//! shadows of the surface of all images, and in its sun, is counted over the whole scene, so that errors of the
//! surface, and dates that hardly differ, weaken the evidence accordingly.
//!
//! Limits: the evidence of a date is at most `MOST_OF_DATE`; shadows of a segment on itself are not used.

use super::suns::{Darkness, angles_deg, toward};
use heliosplat_grid::Grid;
use heliosplat_grid::relief::Relief;
use heliosplat_stereo::change::{self, Changes, States};
use heliosplat_stereo::{PlaneSweepRequest, Surface, SweepView};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Classes of darkness.
const CLASSES: usize = 12;
/// Range of the classes each way, natural logarithm of brightness: darker ground is in the last class, brighter ground
/// in the first.
const DARKEST: f32 = 1.5;
/// Tolerance of the elevation up to which a cell counts as lit, degrees: edges of surfaces are ramps.
const DOUBT_DEG: f64 = 3.0;
/// Number of cells whose darkness amounts to one independent observation: dark ground comes in patches of several
/// cells. With twice as many, repeating patterns such as rows of trees were accepted as buildings (docs/lab/change.md).
const CELLS_OF_ONE: f32 = 2.5;
/// Most evidence of one date, as a logarithm of likelihood.
const MOST_OF_DATE: f32 = 16.0;
/// Longest shadow that is followed, metres.
const REACH_M: f32 = 60.0;

/// A date on which the sun is known.
struct Date {
    day: i32,
    azimuth_deg: f64,
    elevation_deg: f64,
    /// Darkness of each cell relative to other dates, natural logarithm; NaN where unknown.
    darkness: Vec<f32>,
}

/// Divides `surface` into the states before and after a day, as [`heliosplat_stereo::change::find`], including the
/// shadows around each segment; `days` are the dates of the views, days since 1970.
pub fn find(views: &[SweepView], days: &[i32], request: &PlaneSweepRequest, surface: &mut Surface) -> Changes {
    change::find(views, days, request, surface, |grid, altitude_m| {
        let shadows = Shadows::new(views, days, grid, altitude_m);
        move |states: &States| shadows.likelihood(states)
    })
}

/// The dates of a scene with the darkness of their ground.
struct Shadows {
    grid: Grid,
    altitude_m: Vec<f32>,
    dates: Vec<Date>,
    /// Log-likelihood ratio of shadow to sun for each class of darkness.
    in_shadow: [f32; CLASSES],
}

impl Shadows {
    /// The evidence of views taken on `days`, on a surface of `altitude_m` in the cells of a grid.
    fn new(views: &[SweepView], days: &[i32], grid: &Grid, altitude_m: &[f32]) -> Self {
        let surface = Surface {
            width: grid.width,
            height: grid.height,
            west_m: grid.west_m,
            north_m: grid.north_m,
            cell_m: grid.cell_m,
            altitude: altitude_m.to_vec(),
            ..Surface::default()
        };
        let relief = relief(grid, altitude_m.to_vec());
        let cells: Vec<usize> = (0..grid.len()).collect();
        let measured = Darkness::new(views, &surface, &relief, &cells);
        let lit = |view: &SweepView| {
            let [azimuth_deg, elevation_deg] = angles_deg(view.sun?);
            let toward = toward(azimuth_deg, elevation_deg - DOUBT_DEG);
            Some(cells.iter().map(|&cell| !relief.is_shaded(cell, &toward)).collect())
        };
        let lit: Vec<Option<Vec<bool>>> = views.par_iter().map(lit).collect();
        let mut groups: Vec<u32> = views.iter().map(|view| view.date_group).collect();
        groups.sort_unstable();
        groups.dedup();
        let date = |group: u32| {
            let first = views.iter().position(|view| view.date_group == group)?;
            let [azimuth_deg, elevation_deg] = angles_deg(views[first].sun?);
            Some(Date {
                day: days[first],
                azimuth_deg,
                elevation_deg,
                darkness: measured.of_date(views, group, &lit),
            })
        };
        let dates: Vec<Date> = groups.into_par_iter().filter_map(date).collect();
        let mut counts = [[1.0f32; CLASSES]; 2];
        for date in &dates {
            let toward = toward(date.azimuth_deg, date.elevation_deg);
            for &cell in &cells {
                if let Some(class) = class(date.darkness[cell]) {
                    counts[usize::from(relief.is_shaded(cell, &toward))][class] += 1.0;
                }
            }
        }
        let [in_sun, in_shadow] = counts.map(|counts| {
            let all: f32 = counts.iter().sum();
            counts.map(|count| (count / all).ln())
        });
        Self {
            grid: *grid,
            altitude_m: altitude_m.to_vec(),
            dates,
            in_shadow: std::array::from_fn(|class| in_shadow[class] - in_sun[class]),
        }
    }

    /// Log-likelihood ratio for the darkness around some cells: two states that change on a day, against the better of
    /// the two on all dates. `None` where no date shows ground on which they differ.
    fn likelihood(&self, states: &States) -> Option<f32> {
        let (cells, altitudes_m, day) = (states.cells, states.altitudes_m, states.day);
        let states = [0, 1].map(|state: usize| {
            let mut altitude_m = self.altitude_m.clone();
            for (&cell, altitudes) in cells.iter().zip(altitudes_m) {
                altitude_m[cell] = altitudes[state];
            }
            relief(&self.grid, altitude_m)
        });
        let around = self.around(cells);
        let (mut before, mut after) = (0.0, 0.0);
        let mut tells = false;
        for date in &self.dates {
            let toward = toward(date.azimuth_deg, date.elevation_deg);
            let mut old = 0.0;
            for &cell in &around {
                let Some(class) = class(date.darkness[cell]) else {
                    continue;
                };
                let [shaded, shaded_then] = states.each_ref().map(|state| state.is_shaded(cell, &toward));
                if shaded != shaded_then {
                    tells = true;
                    old += if shaded {
                        self.in_shadow[class]
                    } else {
                        -self.in_shadow[class]
                    };
                }
            }
            let old = (old / CELLS_OF_ONE).clamp(-MOST_OF_DATE, MOST_OF_DATE);
            match date.day < day {
                true => before += old,
                false => after -= old,
            }
        }
        tells.then(|| f32::min(before, after))
    }

    /// Cells within the reach of shadows of `cells`, without these.
    fn around(&self, cells: &BTreeSet<usize>) -> Vec<usize> {
        let width = self.grid.width;
        let reach = (REACH_M / self.grid.cell_m).ceil() as usize;
        let span = |at: &dyn Fn(usize) -> usize, most: usize| {
            let all = || cells.iter().map(|&cell| at(cell));
            let (first, last) = (all().min().unwrap_or(0), all().max().unwrap_or(0));
            first.saturating_sub(reach)..(last + reach + 1).min(most)
        };
        let columns = span(&|cell| cell % width, width);
        span(&|cell| cell / width, self.grid.height)
            .flat_map(|row| columns.clone().map(move |col| row * width + col))
            .filter(|cell| !cells.contains(cell))
            .collect()
    }
}

fn relief(grid: &Grid, altitude_m: Vec<f32>) -> Relief {
    Relief::new((grid.width, grid.height), grid.cell_m, altitude_m)
}

/// The class of a darkness; `None` where it is unknown.
fn class(darkness: f32) -> Option<usize> {
    let share = (darkness + DARKEST) / (2.0 * DARKEST);
    darkness
        .is_finite()
        .then(|| ((share * CLASSES as f32) as usize).min(CLASSES - 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use heliosplat::{ProjectiveCamera, Raster};

    const SIDE: usize = 60;
    const HOUSE_M: f32 = 8.0;
    /// First day, and days from one image to the next.
    const DAYS: (i32, i32) = (100, 10);
    /// Azimuths and elevations of the suns of the images, degrees.
    const SUNS: [[f64; 2]; 6] = [
        [100.0, 40.0],
        [150.0, 50.0],
        [200.0, 45.0],
        [170.0, 38.0],
        [230.0, 42.0],
        [130.0, 47.0],
    ];

    /// The lot, 10 m wide, and its cells' altitudes without a house and with one.
    fn lot() -> (BTreeSet<usize>, Vec<[f32; 2]>) {
        let cells: BTreeSet<usize> = (0..100).map(|i| (35 + i / 10) * SIDE + 30 + i % 10).collect();
        let altitudes_m = vec![[0.0, HOUSE_M]; cells.len()];
        (cells, altitudes_m)
    }

    /// The likelihood ratio that the house is new on `day`, from images in which it exists from `built` on; another
    /// house always exists.
    fn likelihood(day: i32, built: i32) -> f32 {
        let grid = Grid::plain(SIDE, SIDE);
        let (cells, altitudes_m) = lot();
        let mut ground_m = vec![0.0; SIDE * SIDE];
        for i in 0..100 {
            ground_m[(10 + i / 10) * SIDE + 10 + i % 10] = HOUSE_M;
        }
        let days: Vec<i32> = (0..SUNS.len() as i32).map(|k| DAYS.0 + k * DAYS.1).collect();
        let image = |k: usize| {
            let mut altitude_m = ground_m.clone();
            if days[k] >= built {
                cells.iter().for_each(|&cell| altitude_m[cell] = HOUSE_M);
            }
            let shadows = relief(&grid, altitude_m).shadows(SUNS[k][0], SUNS[k][1]);
            let brightness = |cell: usize| {
                let albedo = 0.2 + 0.02 * (cell * 7919 % 11) as f32;
                albedo * if shadows[cell] { 0.4 } else { 1.0 }
            };
            let mut image = Raster::filled(SIDE, SIDE, 1, 0.0);
            image.values = (0..SIDE * SIDE).map(brightness).collect();
            image
        };
        let images: Vec<Raster> = (0..SUNS.len()).map(image).collect();
        let first = grid.point(0, 0, 0.0);
        let camera = ProjectiveCamera::nadir(
            f64::from(first.x),
            f64::from(first.y),
            f64::from(grid.cell_m),
            (SIDE, SIDE),
        );
        let sun = |[azimuth_deg, elevation_deg]: [f64; 2]| {
            let ((east, north), (up, across)) =
                (azimuth_deg.to_radians().sin_cos(), elevation_deg.to_radians().sin_cos());
            Vec3::new((across * east) as f32, (across * north) as f32, up as f32)
        };
        let views: Vec<SweepView> = (images.iter().enumerate())
            .map(|(k, image)| SweepView {
                camera,
                image,
                index: None,
                date_group: k as u32,
                sun: Some(sun(SUNS[k])),
            })
            .collect();
        Shadows::new(&views, &days, &grid, &ground_m)
            .likelihood(&States {
                cells: &cells,
                altitudes_m: &altitudes_m,
                day,
            })
            .expect("shadows of a house tell")
    }

    #[test]
    fn shadows_tell_the_day_on_which_a_house_was_built() {
        let built = DAYS.0 + 3 * DAYS.1;
        let right = likelihood(built, built);
        assert!(right > 2.0 * MOST_OF_DATE, "{right}");
        for other in [built - 2 * DAYS.1, built - DAYS.1, built + DAYS.1, built + 2 * DAYS.1] {
            let likelihood = likelihood(other, built);
            assert!(likelihood < right, "day {other}: {likelihood} and {right}");
        }
    }

    #[test]
    fn shadows_refute_a_house_that_no_image_shows() {
        let refuted = likelihood(DAYS.0 + 3 * DAYS.1, i32::MAX);
        assert!(
            refuted < -2.0 * MOST_OF_DATE,
            "{refuted}: rows of trees match as well as a house"
        );
    }
}
