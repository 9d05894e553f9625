//! Products of light for planners: hours of direct sun, sky view factor, and irradiation under a clear sky.
//!
//! All three come from the surface model. For each of `SECTORS` azimuths one sweep finds the horizon of every cell; a
//! sun in that sector lights the cell while it stands above the horizon. Terrain beyond the model casts no shadow, and
//! light reflected by other surfaces is not counted.
//!
//! Sky view factor of an inclined surface: J. Dozier and J. Frew, "Rapid calculation of terrain parameters for
//! radiation modeling from digital elevation data", IEEE Trans. Geosci. Remote Sensing 28(5), 1990.

mod clear_sky;
mod facets;
mod horizon;
mod suns;

pub use clear_sky::LINKE_TURBIDITY;
pub use suns::Period;

use crate::nadir::NadirGrid;
use facets::Facets;
use heliosplat::Raster;
use heliosplat_rpc::GeoPoint;
use horizon::Horizons;
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};
use suns::Suns;

/// Number of azimuths for which the horizon is found.
const SECTORS: usize = 360;
/// Number of azimuths that are swept at a time: their horizons are held in memory together.
const AT_ONCE: usize = 8;

/// Hours of sun, sky view factor and irradiation, one band each; `NaN` where the surface is unknown.
pub struct Sunshine {
    /// Hours of direct sun per day, mean over the days of the period.
    pub sun_hours: Raster,
    /// Share of the light of an even sky that reaches the surface, 0 to 1.
    pub sky_view: Raster,
    /// Irradiation of the inclined surface over the whole period under a clear sky, kWh/m².
    pub irradiation: Raster,
}

impl Sunshine {
    /// Sunshine of a part of the grid; `part` cuts it out of each raster.
    #[must_use]
    pub fn cut(&self, part: &dyn Fn(&Raster) -> Raster) -> Self {
        Self {
            sun_hours: part(&self.sun_hours),
            sky_view: part(&self.sky_view),
            irradiation: part(&self.irradiation),
        }
    }
}

/// Sums of one cell over the azimuth sectors.
#[derive(Debug, Clone, Copy, Default)]
struct Gathered {
    hours: f64,
    sky_view: f64,
    /// Sum of the sun's beam over the visible part of its path, Wh/m², as a vector toward it: east, north, up.
    beam_wh_m2: [f64; 3],
}

/// Sunshine of a surface (`altitude_m`, metres, one band on the grid of `nadir`) on all days of a period, under the sun
/// and the air of `place`.
pub fn sunshine(nadir: &NadirGrid, altitude_m: &Raster, place: GeoPoint, period: &Period) -> Sunshine {
    let cells = nadir.cell_vectors_m(place.height_m);
    let facets = Facets::of(altitude_m, &cells);
    let suns = Suns::new(place, period, SECTORS);
    let mut gathered = vec![Gathered::default(); altitude_m.plane_len()];
    let azimuths: Vec<usize> = (0..SECTORS).collect();
    for some in azimuths.chunks(AT_ONCE) {
        let horizons = Horizons::new(&facets, &cells);
        let swept = some.par_iter().map(|&sector| horizons.toward(azimuth_rad(sector)));
        let swept: Vec<Vec<f32>> = swept.collect();
        gathered.par_iter_mut().enumerate().for_each(|(cell, sum)| {
            for (&sector, tangents) in some.iter().zip(&swept) {
                sum.add(sector, f64::from(tangents[cell]), &facets.normal(cell), &suns);
            }
        });
    }
    let raster = |value: &(dyn Fn(usize, &Gathered) -> f64 + Sync)| {
        let values = gathered
            .iter()
            .enumerate()
            .map(|(cell, sum)| match facets.is_known(cell) {
                true => value(cell, sum) as f32,
                false => f32::NAN,
            });
        Raster::of_plane(altitude_m.width, altitude_m.height, values.collect())
    };
    Sunshine {
        sun_hours: raster(&|_, sum| sum.hours / suns.days()),
        sky_view: raster(&|_, sum| sum.sky_view.clamp(0.0, 1.0)),
        irradiation: raster(&|cell, sum| {
            let normal = facets.normal(cell);
            let beam: f64 = normal.iter().zip(sum.beam_wh_m2).map(|(n, b)| n * b).sum();
            (beam.max(0.0) + suns.diffuse_wh_m2 * sum.sky_view.clamp(0.0, 1.0)) / 1000.0
        }),
    }
}

/// Azimuth of the middle of a sector, radians.
fn azimuth_rad(sector: usize) -> f64 {
    (sector as f64 + 0.5) / SECTORS as f64 * TAU
}

impl Gathered {
    /// Adds the sunshine and the sky of a sector above a horizon (tangent of its elevation) for a surface with this
    /// normal.
    fn add(&mut self, sector: usize, tangent: f64, normal: &[f64; 3], suns: &Suns) {
        if tangent.is_nan() {
            return;
        }
        let seen = suns.above(sector, tangent);
        self.hours += seen.hours;
        for (sum, part) in self.beam_wh_m2.iter_mut().zip(seen.beam_wh_m2) {
            *sum += part;
        }
        // From the zenith down to the horizon, H in the paper.
        let zenith_rad = 0.5 * PI - tangent.atan();
        let (sin, cos) = zenith_rad.sin_cos();
        let (east, north) = azimuth_rad(sector).sin_cos();
        let toward = normal[0] * east + normal[1] * north;
        self.sky_view += (normal[2] * sin * sin + toward * (zenith_rad - sin * cos)) / SECTORS as f64;
    }
}

#[cfg(test)]
mod tests;
