//! Sun positions on the days of a period, by azimuth, and the sunshine of a surface above a horizon.

use super::clear_sky::{LINKE_TURBIDITY, irradiance};
use heliosplat_rpc::GeoPoint;
use heliosplat_rpc::sun::{earth_sun_distance_au, sun_position};
use jiff::Timestamp;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use std::f64::consts::TAU;
use std::str::FromStr;

/// Time between two suns, seconds.
const STEP_S: i64 = 300;
const DAY_S: i64 = 86_400;
/// Most days of a period.
const DAYS_MAX: i64 = 366;

/// Period of whole days, the last one included; each runs from midnight to midnight of mean solar time at the place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Period {
    from: Date,
    days: i64,
}

impl Period {
    /// Period from one day to another, both included.
    ///
    /// # Errors
    /// A sentence on the fault, where the period ends before it begins or has more than 366 days.
    pub fn new(from: Date, to: Date) -> Result<Self, String> {
        let days = i64::from((to - from).get_days()) + 1;
        match days {
            1..=DAYS_MAX => Ok(Self { from, days }),
            ..1 => Err("the period ends before it begins".into()),
            _ => Err(format!("{days} days; a period has {DAYS_MAX} at most")),
        }
    }

    /// First and last day of the period.
    pub fn ends(&self) -> (Date, Date) {
        let last = self.from.checked_add(jiff::Span::new().days(self.days - 1));
        (self.from, last.unwrap_or(self.from))
    }
}

impl FromStr for Period {
    type Err = String;

    /// Period from `FROM` or `FROM/TO`, dates such as 2026-06-21.
    fn from_str(text: &str) -> Result<Self, String> {
        let date = |word: &str| {
            let wrong = |_| format!("'{word}' is not a date such as 2026-06-21");
            word.trim().parse().map_err(wrong)
        };
        let (from, to) = text.split_once('/').unwrap_or((text, text));
        Self::new(date(from)?, date(to)?)
    }
}

/// Sunshine above a horizon in one azimuth sector, summed over the period.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Seen {
    /// Hours of sun.
    pub(super) hours: f64,
    /// Energy of the sun's beam, Wh/m² on a surface that faces it, as a vector toward it: east, north, up.
    pub(super) beam_wh_m2: [f64; 3],
}

/// The suns of a period, sorted by azimuth and elevation.
pub(super) struct Suns {
    days: i64,
    /// Of each sector: tangents of elevations from high to low, and the sunshine summed down to each.
    sectors: Vec<Vec<(f64, Seen)>>,
    /// Diffuse irradiation of level ground under the whole sky over the period, Wh/m².
    pub(super) diffuse_wh_m2: f64,
}

impl Suns {
    /// Suns of a period at a place; its height above the ellipsoid serves as height above the sea.
    pub(super) fn new(place: GeoPoint, period: &Period, sectors: usize) -> Self {
        let hours = STEP_S as f64 / 3600.0;
        let mut out = Self {
            days: period.days,
            sectors: vec![Vec::new(); sectors],
            diffuse_wh_m2: 0.0,
        };
        for time in times(place, period) {
            let sun = sun_position(time, place);
            if sun.elevation_rad <= 0.0 {
                continue;
            }
            let distance_au = earth_sun_distance_au(time);
            let light = irradiance(sun.elevation_rad, distance_au, place.height_m, LINKE_TURBIDITY);
            out.diffuse_wh_m2 += light.diffuse_w_m2 * hours;
            let direction = sun.direction_enu();
            let beam_wh_m2 = [direction.x, direction.y, direction.z].map(|share| share * light.beam_w_m2 * hours);
            let sector = (sun.azimuth_rad.rem_euclid(TAU) / TAU * sectors as f64) as usize;
            out.sectors[sector.min(sectors - 1)].push((sun.elevation_rad.tan(), Seen { hours, beam_wh_m2 }));
        }
        for suns in &mut out.sectors {
            // Sums from the highest sun down; suns of one height keep their order in time.
            suns.sort_by(|a, b| b.0.total_cmp(&a.0));
            let mut sum = Seen::default();
            for (_, seen) in suns {
                sum.hours += seen.hours;
                for (sum, part) in sum.beam_wh_m2.iter_mut().zip(seen.beam_wh_m2) {
                    *sum += part;
                }
                *seen = sum;
            }
        }
        out
    }

    /// Number of days.
    pub(super) fn days(&self) -> f64 {
        self.days as f64
    }

    /// Sunshine in a sector above a horizon, given as the tangent of its elevation.
    pub(super) fn above(&self, sector: usize, tangent: f64) -> Seen {
        let suns = &self.sectors[sector];
        match suns.partition_point(|(sun, _)| *sun > tangent) {
            0 => Seen::default(),
            count => suns[count - 1].1,
        }
    }
}

/// The middles of all steps of a period.
fn times(place: GeoPoint, period: &Period) -> impl Iterator<Item = Timestamp> + use<> {
    let midnight = period.from.to_zoned(TimeZone::UTC).map(|zoned| zoned.timestamp());
    // Dates at the very ends of the calendar have no moment in UTC: no suns are better than wrong ones.
    let first_s = midnight.map_or(i64::MAX / 2, Timestamp::as_second);
    let first_s = first_s - (place.lon_deg / 360.0 * DAY_S as f64).round() as i64;
    let steps = period.days * DAY_S / STEP_S;
    (0..steps).filter_map(move |step| Timestamp::from_second(first_s + step * STEP_S + STEP_S / 2).ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn date(text: &str) -> Date {
        text.parse().expect("a date")
    }

    #[test]
    fn periods_are_days_with_both_ends() {
        let ends = |text: &str| {
            text.parse()
                .map(|period: Period| (period.ends().0.to_string(), period.ends().1.to_string()))
        };
        let said = |from: &str, to: &str| Ok((from.to_owned(), to.to_owned()));
        assert_eq!(ends("2026-06-21"), said("2026-06-21", "2026-06-21"));
        assert_eq!(ends("2026-06-01/2026-08-31"), said("2026-06-01", "2026-08-31"));
        for bad in [
            "",
            "june",
            "2026-06-31",
            "2026-06-21/2026-06-20",
            "2026-01-01/2028-01-01",
            "2026-06-21/",
        ] {
            assert!(bad.parse::<Period>().is_err(), "{bad}");
        }
    }

    #[test]
    fn a_period_has_both_its_ends_and_at_most_a_year() {
        let period = Period::new(date("2026-06-21"), date("2026-06-23")).expect("days");
        assert_eq!((period.days, period.ends().1), (3, date("2026-06-23")));
        assert_eq!(
            Period::new(date("2024-01-01"), date("2024-12-31"))
                .expect("a year")
                .days,
            366
        );
        assert!(Period::new(date("2026-06-21"), date("2026-06-20")).is_err());
        assert!(Period::new(date("2026-01-01"), date("2027-06-20")).is_err());
    }

    #[test]
    fn an_open_place_sees_the_sun_for_half_a_day_of_the_year_s_hours() {
        let place = GeoPoint::new(135.5, 34.7, 50.0);
        let hours = |from: &str, to: &str| {
            let period = Period::new(date(from), date(to)).expect("days");
            let suns = Suns::new(place, &period, 90);
            (0..90).map(|sector| suns.above(sector, 0.0).hours).sum::<f64>() / suns.days()
        };
        // Geometric day lengths at this latitude: 2 acos(-tan(lat) tan(declination)) / 15.
        assert!((hours("2026-06-21", "2026-06-21") - 14.33).abs() < 0.1);
        assert!((hours("2026-12-21", "2026-12-21") - 9.67).abs() < 0.1);
        // A little more than twelve: the northern summer is some days longer than the winter.
        assert!((hours("2025-01-01", "2025-12-31") - 12.05).abs() < 0.06);
    }
}
