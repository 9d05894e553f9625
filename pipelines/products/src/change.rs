//! Map of changes between the images of a model: surface on the last day minus surface on the first, and date of the
//! change.

use crate::dsm::{Dsm, seen_of};
use crate::model::LoadedModel;
use crate::nadir::NadirGrid;
use crate::style::Style;
use heliosplat::Raster;
use heliosplat_raster::write::{ImageSpec, write_cog, write_integer_cog};
use heliosplat_raster::{GridSpec, RasterError, dsm_bands};
use heliosplat_stereo::change::Segment;
use jiff::Timestamp;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use rayon::prelude::*;
use std::ops::Sub;
use std::path::{Path, PathBuf};

/// Names of the bands of a map of changes.
pub const BANDS: [&str; 3] = ["difference_m", "changed_at", "confidence"];
/// Units of the bands, in the order of [`BANDS`].
pub const UNITS: [&str; 3] = ["metre", "YYYYMMDD", "1"];
/// Suffixes of the names of the files of the bands after the first.
pub const SUFFIXES: [&str; 2] = ["date", "confidence"];
/// Descriptions of the bands.
const DESCRIPTIONS: [&str; 3] = [
    "last minus first surface",
    "day of the first image that shows the new state; nodata where nothing changed",
    "confidence that it changed",
];
/// Least difference of two surfaces that counts as a change, metres.
const LEAST_M: f32 = 1.5;
/// Margin around a segment within which a cell may belong to it, metres.
const AROUND_M: f64 = 1.0;

/// The day (UTC) of a moment, days since 1970.
pub fn day_of(time: Timestamp) -> i32 {
    time.as_second().div_euclid(86_400) as i32
}

/// A date as days since 1970.
pub fn as_day(date: Date) -> i32 {
    date.to_zoned(TimeZone::UTC).map_or(0, |at| day_of(at.timestamp()))
}

/// A day (days since 1970) as a date YYYYMMDD; 0 outside the calendar.
pub fn as_date(day: i32) -> u32 {
    let date = Timestamp::from_second(i64::from(day) * 86_400).map(|time| time.to_zoned(TimeZone::UTC).date());
    date.map_or(0, |date| {
        let year: u32 = date.year().unsigned_abs().into();
        year * 10_000 + u32::from(date.month().unsigned_abs()) * 100 + u32::from(date.day().unsigned_abs())
    })
}

/// Map of changes: difference (metres, last minus first surface), day of the first image that shows the new state (days
/// since 1970, 0 where nothing changed), and confidence of the change (0.5 to 1, 0 where nothing changed); NaN where
/// the surface is unknown on the first or on the last day.
pub struct ChangeMap {
    /// Raster of the three bands, in the order of [`BANDS`].
    pub raster: Raster,
}

impl ChangeMap {
    /// Changes of a `whole` model on the grid of `nadir`; `last` is its surface on the last day, above the ellipsoid.
    /// `None` where changes cannot be determined from the images.
    pub fn of(whole: &LoadedModel, nadir: &NadirGrid, last: &Dsm) -> Option<Self> {
        let changes = whole.file.changes.as_ref()?;
        let mut days: Vec<i32> = changes.segments.iter().map(|segment| segment.day).collect();
        days.sort_unstable();
        days.dedup();
        let first = days.first().map_or(0, |day| day - 1);
        let moments: Vec<i32> = std::iter::once(first).chain(days).collect();
        let before_last = &moments[..moments.len() - 1];
        let heights = |dsm: &Dsm| dsm.raster.plane(0).to_vec();
        let earlier = before_last.iter().map(|&day| heights(&seen_of(nadir, &whole.on(day))));
        let surfaces: Vec<Vec<f32>> = earlier.chain([heights(last)]).collect();
        let (width, height) = (nadir.grid.width, nadir.grid.height);
        let height_m = whole.file.origin.height_m;
        let of_row = |row: usize| {
            let place = |col: usize| nadir.enu.enu(col as f64, row as f64, height_m);
            let places: Vec<[f64; 3]> = (0..width).map(place).collect();
            let near = segments_along(&changes.segments, &places);
            let mut heights = Vec::with_capacity(surfaces.len());
            let of_cell = |col: usize| {
                heights.clear();
                heights.extend(surfaces.iter().map(|surface| surface[row * width + col]));
                cell_change(&moments, &heights, &|day| confidence(&near, day, &places[col]))
            };
            (0..width).map(of_cell).collect::<Vec<[f32; 3]>>()
        };
        let told: Vec<[f32; 3]> = (0..height).into_par_iter().flat_map_iter(of_row).collect();
        let mut raster = Raster::filled(width, height, BANDS.len(), 0.0);
        for band in 0..BANDS.len() {
            let cells = raster.plane_mut(band).iter_mut().zip(&told);
            cells.for_each(|(value, told)| *value = told[band]);
        }
        Some(Self { raster })
    }

    /// Band of differences, metres.
    pub fn difference(&self) -> Raster {
        self.raster.band(0)
    }

    /// Map of changes from the rasters of its files. Dates were read as 32-bit floats, which are up to one short of
    /// YYYYMMDD; each becomes the nearest of `days` (days since 1970) on which something changed. `None` unless each
    /// raster has one band.
    pub fn read(difference: Raster, [mut dates, confidence]: [Raster; 2], days: &[i32]) -> Option<Self> {
        let rasters = [&difference, &dates, &confidence];
        if rasters.iter().any(|raster| raster.bands != 1) {
            return None;
        }
        for (value, difference) in dates.values.iter_mut().zip(&difference.values) {
            let off = |day: &&i32| f64::from(as_date(**day)).sub(f64::from(*value)).abs();
            let nearest = days.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
            let is_changed = *value > 0.0 && difference.abs() > 0.0;
            *value = nearest.filter(|_| is_changed).map_or(0.0, |day| *day as f32);
        }
        let mut raster = difference;
        raster.values.extend(dates.values);
        raster.values.extend(confidence.values);
        raster.bands = BANDS.len();
        Some(Self { raster })
    }

    /// File of a band of the map; `path` is the file of the differences.
    pub fn file_of(path: &Path, band: usize) -> PathBuf {
        match band {
            0 => path.to_owned(),
            _ => dsm_bands::companion(path, SUFFIXES[band - 1]),
        }
    }

    /// QGIS style of a band, with the range of its values.
    pub fn style(&self, band: usize) -> Style {
        let values = self.raster.plane(band);
        match band {
            0 => {
                let known = values.iter().filter(|v| v.is_finite());
                Style::Differences(known.fold(1.0, |most, v| v.abs().max(most)))
            }
            1 => {
                let days = values.iter();
                let days = days.filter(|day| **day > 0.0).map(|day| as_date(*day as i32) as f32);
                let [first, last] = days.fold([f32::MAX, 0.0], |[low, high], date| [date.min(low), date.max(high)]);
                Style::Amounts([first.min(last), last.max(1.0)])
            }
            _ => Style::Amounts([0.0, 1.0]),
        }
    }

    /// Writes the map as cloud-optimised GeoTIFFs of one band, with their styles; dates are whole numbers YYYYMMDD.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, path: &Path, grid: &GridSpec) -> Result<(), RasterError> {
        (0..BANDS.len()).into_par_iter().try_for_each(|band| {
            let metadata = [
                ("DESCRIPTION", DESCRIPTIONS[band]),
                ("SOFTWARE", concat!("heliosplat ", env!("CARGO_PKG_VERSION"))),
            ]
            .map(|(key, value)| (key.to_owned(), value.to_owned()));
            let raster = self.raster.band(band);
            let spec = ImageSpec {
                band_descriptions: &BANDS[band..=band],
                band_units: &UNITS[band..=band],
                georeference: Some((&grid.transform, &grid.crs)),
                metadata: &metadata,
                ..ImageSpec::plain(&raster)
            };
            let path = Self::file_of(path, band);
            self.style(band).write(&path)?;
            match band {
                1 => write_integer_cog(&path, &spec, |day| as_date(day as i32) as i32),
                _ => write_cog(&path, &spec),
            }
        })
    }
}

/// Segments whose bounds, margin included, meet the bounds of `places`, metres of the local frame.
fn segments_along<'a>(segments: &'a [Segment], places: &[[f64; 3]]) -> Vec<&'a Segment> {
    let [low, high] = [f64::min, f64::max].map(|bound| {
        let both = |a: [f64; 2], at: &[f64; 3]| [bound(a[0], at[0]), bound(a[1], at[1])];
        places.iter().fold([f64::NAN; 2], both)
    });
    let meets = |segment: &&Segment| {
        let [west_m, south_m, east_m, north_m] = grown(segment);
        west_m <= high[0] && east_m >= low[0] && south_m <= high[1] && north_m >= low[1]
    };
    segments.iter().filter(meets).collect()
}

/// Largest confidence of a day's segments whose bounds, margin included, contain a position, metres of the local frame.
fn confidence(segments: &[&Segment], day: i32, [east, north, _]: &[f64; 3]) -> Option<f32> {
    let holds = |segment: &&&Segment| {
        let [west_m, south_m, east_m, north_m] = grown(segment);
        segment.day == day && (west_m..east_m).contains(east) && (south_m..north_m).contains(north)
    };
    let there = segments.iter().filter(holds);
    there.map(|segment| segment.confidence).reduce(f32::max)
}

/// Bounds of a segment with the margin around it: west, south, east, north, metres.
fn grown(segment: &Segment) -> [f64; 4] {
    let [west_m, south_m, east_m, north_m] = segment.bounds_m.map(f64::from);
    [
        west_m - AROUND_M,
        south_m - AROUND_M,
        east_m + AROUND_M,
        north_m + AROUND_M,
    ]
}

/// Difference, day and confidence of a cell. `heights` are its altitudes on the days `moments`, `of_day` the confidence
/// of a change of the cell on a day.
fn cell_change(moments: &[i32], heights: &[f32], of_day: &dyn Fn(i32) -> Option<f32>) -> [f32; 3] {
    let (Some(first), Some(last)) = (heights.first(), heights.last()) else {
        return [f32::NAN; 3];
    };
    if !(first.is_finite() && last.is_finite()) {
        return [f32::NAN; 3];
    }
    let mut steps = moments.iter().zip(heights).skip(1).zip(heights).rev();
    let changed = steps.find_map(|((day, now), before)| {
        let confidence = of_day(*day)?;
        ((now - before).abs() > LEAST_M).then_some((*day, confidence))
    });
    match changed {
        Some((day, confidence)) => [last - first, day as f32, confidence],
        None => [0.0; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_written_as_dates() {
        assert_eq!(as_date(0), 19_700_101);
        assert_eq!(
            as_date(day_of("2023-02-06T01:17:00Z".parse().expect("a time"))),
            20_230_206
        );
        assert_eq!(
            as_date(day_of("1969-12-31T23:00:00Z".parse().expect("a time"))),
            19_691_231
        );
    }

    #[test]
    fn a_row_is_compared_with_the_segments_that_it_passes_alone() {
        let segments: Vec<Segment> = (0..400)
            .map(|i| {
                let west_m = (i % 20 * 13) as f32 - 130.0;
                let south_m = (i / 20 * 11) as f32 - 110.0;
                Segment {
                    day: i % 3,
                    difference_m: 4.0,
                    area_m2: 1.0,
                    bounds_m: [
                        west_m,
                        south_m,
                        west_m + (i % 7 * 9) as f32,
                        south_m + (i % 5 * 8) as f32,
                    ],
                    confidence: 0.5 + (i * 37 % 100) as f32 / 250.0,
                }
            })
            .collect();
        let all: Vec<&Segment> = segments.iter().collect();
        let mut tested = 0;
        for north in (-130..180).step_by(7) {
            // A row of a grid that is not quite north up.
            let place = |i: i32| [f64::from(i), f64::from(north) + 0.05 * f64::from(i), 0.0];
            let places: Vec<[f64; 3]> = (-150..200).step_by(3).map(place).collect();
            let near = segments_along(&segments, &places);
            tested += near.len();
            for (place, day) in places.iter().flat_map(|place| (0..3).map(move |day| (place, day))) {
                assert_eq!(
                    confidence(&near, day, place),
                    confidence(&all, day, place),
                    "{place:?} {day}"
                );
            }
        }
        assert!(tested < 45 * segments.len() / 2, "most segments lie beside a row");
        assert!(segments_along(&segments, &[]).is_empty());
    }

    #[test]
    fn a_cell_changed_on_the_day_on_which_its_surface_did() {
        let all = |_: i32| Some(0.9);
        assert_eq!(cell_change(&[9, 10, 20], &[5.0, 5.2, 11.0], &all), [6.0, 20.0, 0.9]);
        assert_eq!(
            cell_change(&[9, 10, 20], &[5.0, 11.0, 11.1], &all),
            [6.1000004, 10.0, 0.9]
        );
        assert_eq!(cell_change(&[9, 10, 20], &[5.0, 5.2, 5.1], &all), [0.0; 3]);
        let other = |day: i32| (day == 10).then_some(0.9);
        assert_eq!(
            cell_change(&[9, 10, 20], &[5.0, 5.0, 11.0], &other),
            [0.0; 3],
            "no segment there"
        );
        assert!(cell_change(&[9, 10], &[5.0, f32::NAN], &all)[0].is_nan());
    }
}
