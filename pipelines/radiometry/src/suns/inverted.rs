//! Relief that is upside down.
//!
//! Views in a row, of which two have each other's cameras, agree on a mirrored surface as sound ones do on the true
//! surface, and level ground hides the difference. Cast shadows tell the two apart: under the known suns, those of the
//! true surface lie on dark ground.
//!
//! Limits: ground without shadows says nothing.

use super::score::{BLOCKS, Draws, Moments, all_sums, samples, shaded_sums};
use super::{DOUBT_DEG, DRAWS, Darkness, angles_deg, relief_of, sample, toward};
use heliosplat_grid::relief::Relief;
use heliosplat_stereo::{Surface, SweepView};

/// Least correlation of dark ground with the shadows of a surface upside down, and least margin over its own shadows,
/// standard deviations. Of some 1,100 right surfaces of the scene fuzzer with true dates none reaches both; the margin
/// of six real or generated scenes is 0 to -23 (docs/lab/deliveries.md).
const LEAST_SCORE: f64 = 0.15;
const LEAST_MARGIN: f64 = 1.3;
/// Most cells that are sampled: the two surfaces differ in whole shadows.
const MOST_CELLS: usize = 10_000;

/// Correlations of cast shadows with dark ground, -1 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inversion {
    /// That of the surface.
    pub upright: f64,
    /// That of the surface upside down.
    pub inverted: f64,
    /// Difference of the two, standard deviations.
    pub margin: f64,
}

impl Inversion {
    /// True if the shadows are those of a surface that is upside down.
    pub fn is_decisive(&self) -> bool {
        self.inverted >= LEAST_SCORE && self.margin >= LEAST_MARGIN
    }

    /// Compares the shadows of `surface` on the cells that are `covered` with those of the surface upside down; `None`
    /// without a known sun.
    pub fn of(views: &[SweepView], surface: &Surface, covered: &[bool]) -> Option<Self> {
        views.iter().find(|view| view.sun.is_some())?;
        let relief = relief_of(surface, covered);
        let cells = sample(&relief, MOST_CELLS);
        let darkness = Darkness::new(views, surface, &relief, &cells);
        let mirrored = Surface {
            altitude: surface.altitude.iter().map(|altitude| -altitude).collect(),
            ..surface.clone()
        };
        let upright = Shadows::new(views, &relief, &cells, &darkness);
        let inverted = Shadows::new(views, &relief_of(&mirrored, covered), &cells, &darkness);
        let mut draws = Draws::new();
        let leads: Vec<f64> = (0..DRAWS)
            .map(|_| {
                let times = draws.next();
                inverted.correlation(&times) - upright.correlation(&times)
            })
            .collect();
        let mean = leads.iter().sum::<f64>() / DRAWS as f64;
        let variance = leads.iter().map(|lead| (lead - mean).powi(2)).sum::<f64>() / DRAWS as f64;
        let once = [1; BLOCKS * BLOCKS];
        Some(Self {
            upright: upright.correlation(&once),
            inverted: inverted.correlation(&once),
            margin: mean / variance.sqrt().max(f64::MIN_POSITIVE),
        })
    }
}

/// Darkness on all dates with a known sun, block by block: of all cells, and of those that a relief shades.
struct Shadows {
    all: Vec<Moments>,
    shaded: Vec<Moments>,
}

impl Shadows {
    fn new(views: &[SweepView], relief: &Relief, cells: &[usize], darkness: &Darkness) -> Self {
        let horizon = |view: &SweepView| {
            let [azimuth_deg, elevation_deg] = angles_deg(view.sun?);
            Some((elevation_deg, relief.horizons(cells, &toward(azimuth_deg, DOUBT_DEG))))
        };
        let horizons: Vec<Option<(f64, Vec<f32>)>> = views.iter().map(horizon).collect();
        let lit = |(elevation_deg, tangents): &(f64, Vec<f32>)| {
            let tangent = (elevation_deg - DOUBT_DEG).to_radians().tan() as f32;
            tangents.iter().map(|horizon| *horizon <= tangent).collect()
        };
        let lit: Vec<Option<Vec<bool>>> = horizons.iter().map(|found| found.as_ref().map(lit)).collect();
        let none = vec![Moments::default(); BLOCKS * BLOCKS];
        let mut found = Self {
            all: none.clone(),
            shaded: none,
        };
        let mut dates = Vec::new();
        for (view, horizon) in views.iter().zip(&horizons) {
            let Some((elevation_deg, tangents)) = horizon.as_ref().filter(|_| !dates.contains(&view.date_group)) else {
                continue;
            };
            dates.push(view.date_group);
            let samples = samples(relief, cells, &darkness.of_date(views, view.date_group, &lit));
            let shaded = shaded_sums(tangents, &samples, &[*elevation_deg]).swap_remove(0);
            add(&mut found.all, &all_sums(&samples));
            add(&mut found.shaded, &shaded);
        }
        found
    }

    /// Correlation of shadow and darkness where each block counts as often as `times` says.
    fn correlation(&self, times: &[u32]) -> f64 {
        Moments::weighted(&self.all, times).correlation(&Moments::weighted(&self.shaded, times))
    }
}

fn add(sums: &mut [Moments], more: &[Moments]) {
    sums.iter_mut().zip(more).for_each(|(sum, more)| sum.plus(more, 1.0));
}
