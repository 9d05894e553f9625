//! The sun of an image from its shadows: the direction under which the cast shadows of the surface coincide with dark
//! ground.
//!
//! The views are orthorectified on the surface (`darkness`). The darkness of a cell on one date relative to the other
//! dates on which it is lit does not depend on its albedo. The other dates on which it is lit follow from their own
//! suns, so all dates are searched in turns. For each azimuth one walk per cell toward the sun gives the elevation
//! below which the cell is in shadow (`horizon`), so that all elevations are scored together (`score`): the score is
//! the correlation between cast shadow and darkness. The whole sky is searched, coarse to fine; directions that the sun
//! never has at the scene's latitude are left out. Views of one date share one sun.
//!
//! Blocks of ground are resampled (bootstrap): the spread of the best sun is its standard deviation, and the best must
//! exceed the best of all others in the sky by several deviations of the difference. Otherwise it is rejected.
//!
//! Limits: level ground without structures has no shadows; the surface must be right where it casts them. The constants
//! were chosen on synthetic sites of half a metre per cell.

mod darkness;
mod horizon;
mod inverted;
mod score;

pub(crate) use darkness::{Darkness, bilinear};
use glam::Vec3;
use heliosplat_grid::relief::Relief;
use heliosplat_stereo::Surface;
use heliosplat_stereo::SweepView;
pub(crate) use horizon::toward;
use horizon::{relief_of, sample};
pub use inverted::Inversion;
use rayon::prelude::*;
use score::{BLOCKS, CellDarkness, Moments, shaded_sums};

/// Searched elevations, degrees: lower suns cast shadows out of the scene, higher ones under their occluders.
const ELEVATIONS_DEG: [f64; 2] = [10.0, 85.0];
/// Steps of azimuth and elevation of the search over the sky, degrees.
const COARSE_DEG: [f64; 2] = [3.0, 1.0];
/// Half of the window of the fine search around the best sun, degrees of arc.
const FINE_DEG: f64 = 6.0;
/// Steps from the middle of that window to its edge.
const FINE_STEPS: usize = 8;
/// Least distance of other suns from the best one, degrees of arc: closer ones cast nearly the same shadows.
const APART_DEG: f64 = 15.0;
/// Largest declination that is searched, degrees: the inclination of the Earth's axis, and two degrees for the error of
/// an estimate.
const DECLINATION_MAX_DEG: f64 = 23.44 + 2.0;
/// Tolerance of the elevation of another date's sun up to which a cell counts as lit, degrees.
const DOUBT_DEG: f64 = 3.0;
/// Searches of the whole sky, each with the suns of the one before.
const ROUNDS: usize = 6;
/// Number of bootstrap draws of the blocks.
const DRAWS: usize = 200;
/// Least correlation of shadow and darkness on a swept surface: suns below it had errors of 3° to 6° with deviations of
/// 1.1° to 1.5° (docs/lab/suns.md).
const LEAST_SCORE: f64 = 0.5;
/// Least correlation on a model's surface, where suns below it had errors of 5° to 8°, and above it of 2° at most.
const LEAST_SCORE_OF_MODEL: f64 = 0.35;
/// Least difference of the scores of the best sun and of the best other one, in standard deviations of the difference.
const LEAST_MARGIN: f64 = 3.0;
/// Largest standard deviation of an accepted sun, degrees: a trace tolerates twice that.
const MOST_SIGMA_DEG: f64 = 1.6;
/// Systematic error that no bootstrap measures, degrees: roofs and walls that are swept too wide or too low everywhere
/// move all shadows alike.
const SYSTEMATIC_DEG: f64 = 0.5;
/// Most cells that are sampled.
const MOST_CELLS: usize = 40_000;

/// A sun estimated from shadows.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ShadowSun {
    /// Azimuth, degrees clockwise from the frame's north, 0 to 360.
    pub azimuth_deg: f64,
    /// Elevation, degrees above the horizon.
    pub elevation_deg: f64,
    /// Standard deviation of the direction, degrees of arc.
    pub sigma_deg: f64,
    /// Correlation between cast shadow and darkness, 0 to 1.
    pub score: f64,
    /// Difference of the score to that of the best sun elsewhere in the sky, standard deviations.
    pub margin: f64,
    /// True if the shadows are those of a model's surface, which is sharper than a swept one.
    #[serde(default)]
    pub of_model: bool,
}

impl ShadowSun {
    /// True if the sun is accepted: by its score, its margin and its standard deviation.
    pub fn is_decisive(&self) -> bool {
        let least = if self.of_model {
            LEAST_SCORE_OF_MODEL
        } else {
            LEAST_SCORE
        };
        self.score >= least && self.beats_others() && self.sigma_deg <= MOST_SIGMA_DEG
    }

    /// True if no sun elsewhere in the sky explains the shadows as well.
    pub fn beats_others(&self) -> bool {
        self.margin >= LEAST_MARGIN
    }
}

/// The suns of the views whose sun is unknown, from the shadows of `surface` on the cells that are `covered`, at a
/// latitude in degrees; views of one date get the same sun. `None` for views whose sun is known, and where there is no
/// estimate. [`ShadowSun::is_decisive`] accepts or rejects an estimate.
pub fn find_suns(
    views: &[SweepView],
    surface: &Surface,
    covered: &[bool],
    latitude_deg: f64,
) -> Vec<Option<ShadowSun>> {
    let mut dates: Vec<u32> = views
        .iter()
        .filter(|view| view.sun.is_none())
        .map(|view| view.date_group)
        .collect();
    dates.sort_unstable();
    dates.dedup();
    if dates.is_empty() {
        return vec![None; views.len()];
    }
    let relief = relief_of(surface, covered);
    let cells = sample(&relief, MOST_CELLS);
    let darkness = Darkness::new(views, surface, &relief, &cells);
    let horizons = Horizons::new(&relief, &cells);
    let mut samples: Vec<Vec<CellDarkness>> = Vec::new();
    let mut sky: Vec<Option<Sky>> = Vec::new();
    for round in 0..ROUNDS {
        // Cells lit in each view, where its sun is known or was found in the round before.
        let lit: Vec<Option<Vec<bool>>> = views
            .iter()
            .map(|view| {
                let sun = view.sun.map(angles_deg).or_else(|| {
                    let place = dates.iter().position(|&date| date == view.date_group)?;
                    let best = sky.get(place)?.as_ref()?.best;
                    Some([best.azimuth_deg, best.elevation_deg])
                });
                sun.map(|sun| horizons.lit(sun))
            })
            .collect();
        tracing::debug!("round {round} of the search for suns");
        samples = dates
            .par_iter()
            .map(|&date| score::samples(&relief, &cells, &darkness.of_date(views, date, &lit)))
            .collect();
        sky = Sky::search(&horizons, &samples, latitude_deg);
    }
    let found: Vec<Option<ShadowSun>> = samples
        .iter()
        .zip(&sky)
        .map(|(samples, sky)| sky.as_ref().and_then(|sky| refine(&relief, &cells, samples, sky)))
        .collect();
    views
        .iter()
        .map(|view| {
            let place = dates.iter().position(|&date| date == view.date_group)?;
            found[place].filter(|_| view.sun.is_none())
        })
        .collect()
}

fn direction(azimuth_deg: f64, elevation_deg: f64) -> [f64; 3] {
    let ((sin_a, cos_a), (sin_e, cos_e)) = (azimuth_deg.to_radians().sin_cos(), elevation_deg.to_radians().sin_cos());
    [cos_e * sin_a, cos_e * cos_a, sin_e]
}

/// Angle between two directions, degrees.
fn apart_deg(a: [f64; 3], b: [f64; 3]) -> f64 {
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    dot.clamp(-1.0, 1.0).acos().to_degrees()
}

/// True if the sun is in this direction on some day of the year: its declination is within the tropics.
fn is_possible(azimuth_deg: f64, elevation_deg: f64, latitude_deg: f64) -> bool {
    let [_, north, up] = direction(azimuth_deg, elevation_deg);
    let (sin_lat, cos_lat) = latitude_deg.to_radians().sin_cos();
    let declination = (sin_lat * up + cos_lat * north).clamp(-1.0, 1.0).asin();
    declination.to_degrees().abs() <= DECLINATION_MAX_DEG
}

/// A direction in the sky and its score.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    azimuth_deg: f64,
    elevation_deg: f64,
    score: f64,
}

/// The horizons of all cells toward all azimuths of the coarse search.
struct Horizons {
    tangents: Vec<Vec<f32>>,
}

impl Horizons {
    fn new(relief: &Relief, cells: &[usize]) -> Self {
        let azimuths = (360.0 / COARSE_DEG[0]) as usize;
        let of_azimuth = |step: usize| {
            let toward = toward(step as f64 * COARSE_DEG[0], ELEVATIONS_DEG[0]);
            relief.horizons(cells, &toward)
        };
        Self {
            tangents: (0..azimuths).into_par_iter().map(of_azimuth).collect(),
        }
    }

    /// Cells that a sun certainly lights: also after a change of its azimuth by a step of the search either way, or of
    /// its elevation by [`DOUBT_DEG`] downward.
    fn lit(&self, [azimuth_deg, elevation_deg]: [f64; 2]) -> Vec<bool> {
        let step = (azimuth_deg.rem_euclid(360.0) / COARSE_DEG[0]).round() as usize % self.tangents.len();
        let tangent = (elevation_deg - DOUBT_DEG).to_radians().tan() as f32;
        let around = self.tangents.len();
        let near = [step + around - 1, step, step + 1].map(|step| &self.tangents[step % around]);
        let cells = 0..self.tangents[step].len();
        cells
            .map(|cell| near.iter().all(|tangents| tangents[cell] <= tangent))
            .collect()
    }
}

/// Azimuth (clockwise from north) and elevation of a direction toward the sun, degrees.
pub(crate) fn angles_deg(sun: Vec3) -> [f64; 2] {
    let sun = sun.as_dvec3();
    [
        sun.x.atan2(sun.y).to_degrees().rem_euclid(360.0),
        sun.z.atan2(sun.x.hypot(sun.y)).to_degrees(),
    ]
}

/// The best sun of a date, and the best of those elsewhere.
#[derive(Debug, Clone, Copy)]
struct Sky {
    best: Candidate,
    other: Option<Candidate>,
}

impl Sky {
    /// Scores the whole sky for each date.
    fn search(horizons: &Horizons, samples: &[Vec<CellDarkness>], latitude_deg: f64) -> Vec<Option<Self>> {
        let elevations = elevations(ELEVATIONS_DEG[0], ELEVATIONS_DEG[1], COARSE_DEG[1]);
        let scored: Vec<Vec<Vec<Candidate>>> = horizons
            .tangents
            .par_iter()
            .enumerate()
            .map(|(step, tangents)| {
                let azimuth_deg = step as f64 * COARSE_DEG[0];
                let of_date = |samples: &Vec<CellDarkness>| {
                    let scores = score::of_azimuth(tangents, samples, &elevations);
                    let candidates = elevations.iter().zip(scores).map(|(&elevation_deg, score)| Candidate {
                        azimuth_deg,
                        elevation_deg,
                        score,
                    });
                    candidates
                        .filter(|c| is_possible(c.azimuth_deg, c.elevation_deg, latitude_deg))
                        .collect()
                };
                samples.iter().map(of_date).collect()
            })
            .collect();
        (0..samples.len())
            .map(|date| {
                let all = || scored.iter().flat_map(|azimuth| azimuth[date].iter().copied());
                let highest = |a: Candidate, b: Candidate| if b.score > a.score { b } else { a };
                let best = all().reduce(highest)?;
                let here = direction(best.azimuth_deg, best.elevation_deg);
                let elsewhere = |c: &Candidate| apart_deg(here, direction(c.azimuth_deg, c.elevation_deg)) > APART_DEG;
                Some(Self {
                    best,
                    other: all().filter(elsewhere).reduce(highest),
                })
            })
            .collect()
    }
}

/// Elevations from `low` to `high`, degrees.
fn elevations(low: f64, high: f64, step: f64) -> Vec<f64> {
    let count = ((high - low) / step).round() as usize;
    (0..=count).map(|i| low + step * i as f64).collect()
}

/// The sun around the best of the coarse search, with its deviation and its margin over the best elsewhere.
fn refine(relief: &Relief, cells: &[usize], samples: &[CellDarkness], sky: &Sky) -> Option<ShadowSun> {
    let (azimuth_deg, elevation_deg) = (sky.best.azimuth_deg, sky.best.elevation_deg);
    let step = FINE_DEG / FINE_STEPS as f64;
    // Degrees of azimuth per degree of arc; near the zenith the azimuth matters little.
    let widen = (1.0 / elevation_deg.to_radians().cos()).min(6.0);
    let low = (elevation_deg - FINE_DEG).max(ELEVATIONS_DEG[0] - FINE_DEG / 2.0);
    let high = (elevation_deg + FINE_DEG).min(88.0);
    let elevations = elevations(low, high, step);
    let azimuths: Vec<f64> = (0..=2 * FINE_STEPS)
        .map(|i| azimuth_deg + (i as f64 - FINE_STEPS as f64) * step * widen)
        .collect();
    let per_azimuth: Vec<Vec<Vec<Moments>>> = azimuths
        .par_iter()
        .map(|&azimuth| {
            let toward = toward(azimuth, elevations[0]);
            shaded_sums(&relief.horizons(cells, &toward), samples, &elevations)
        })
        .collect();
    let elsewhere = sky.other.map(|other| {
        let toward = toward(other.azimuth_deg, other.elevation_deg);
        shaded_sums(&relief.horizons(cells, &toward), samples, &[other.elevation_deg]).remove(0)
    });
    let all = score::all_sums(samples);
    let whole: Vec<u32> = vec![1; BLOCKS * BLOCKS];
    // The best candidate for blocks with these numbers of repetitions.
    let best_of = |times: &[u32]| {
        let total = Moments::weighted(&all, times);
        let mut best: Option<(f64, usize, usize)> = None;
        for (a, rows) in per_azimuth.iter().enumerate() {
            for (e, shaded) in rows.iter().enumerate() {
                let score = total.correlation(&Moments::weighted(shaded, times));
                if best.is_none_or(|(most, ..)| score > most) {
                    best = Some((score, a, e));
                }
            }
        }
        best
    };
    let (score, best_a, best_e) = best_of(&whole)?;
    let mut draws = score::Draws::new();
    let (mut sum, mut directions, mut leads) = ([0.0; 3], Vec::new(), Vec::new());
    for _ in 0..DRAWS {
        let times = draws.next();
        let (_, a, e) = best_of(&times)?;
        let at = direction(azimuths[a], elevations[e]);
        sum.iter_mut().zip(at).for_each(|(s, v)| *s += v);
        directions.push(at);
        let total = Moments::weighted(&all, &times);
        let own = total.correlation(&Moments::weighted(&per_azimuth[best_a][best_e], &times));
        let other = elsewhere
            .as_ref()
            .map_or(0.0, |shaded| total.correlation(&Moments::weighted(shaded, &times)));
        leads.push(own - other.max(0.0));
    }
    let length = sum.iter().map(|v| v * v).sum::<f64>().sqrt();
    let mean = sum.map(|v| v / length);
    let variance = directions.iter().map(|&d| apart_deg(mean, d).powi(2)).sum::<f64>() / DRAWS as f64;
    let lead = leads.iter().sum::<f64>() / DRAWS as f64;
    let spread = (leads.iter().map(|l| (l - lead).powi(2)).sum::<f64>() / DRAWS as f64).sqrt();
    Some(ShadowSun {
        azimuth_deg: mean[0].atan2(mean[1]).to_degrees().rem_euclid(360.0),
        elevation_deg: mean[2].clamp(-1.0, 1.0).asin().to_degrees(),
        sigma_deg: (variance + SYSTEMATIC_DEG * SYSTEMATIC_DEG).sqrt(),
        score,
        margin: lead / spread.max(f64::MIN_POSITIVE),
        of_model: false,
    })
}

#[cfg(test)]
mod tests;
