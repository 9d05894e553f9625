//! Maps of changes against the truth, by area and by segments at least as large as a house.

use super::Result;
use super::resample::Placement;
use heliosplat_raster::{GeoRaster, RasterFile, dsm_bands};
use jiff::civil::Date;
use std::path::Path;

/// Least difference of a changed cell, metres.
const LEAST_M: f32 = 1.0;
/// Least ground of a segment, m².
const SEGMENT_M2: f64 = 30.0;
/// Least mean difference of a segment, metres.
const SEGMENT_M: f32 = 3.0;

/// Precision and recall of changes. Segments are connected cells (by their sides) that rose, or that fell, by more than
/// 1 m, of at least 30 m² and 3 m on average.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct ChangeScore {
    /// Share of the found area that changed in truth, 0..1; absent where nothing was found.
    pub precision: Option<f64>,
    /// Share of the truly changed area that was found, 0..1; absent where nothing changed.
    pub recall: Option<f64>,
    /// Ground that changed in truth, m².
    pub true_m2: f64,
    /// Ground found to have changed, m².
    pub found_m2: f64,
    /// Number of segments that changed in truth.
    pub true_segments: usize,
    /// Number of segments found.
    pub found_segments: usize,
    /// Share of the correctly found area with the true day, to within a day, 0..1; absent where either map has no days
    /// or nothing was found correctly.
    pub right_day: Option<f64>,
}

/// Compares a map of changes with the true one. First bands are differences (metres, last minus first). Second bands,
/// or the files of dates beside the maps, are days as YYYYMMDD.
///
/// # Errors
/// [`EvaluateError`](super::EvaluateError), naming the file at fault.
pub fn evaluate_change(found: &Path, truth: &Path) -> Result<ChangeScore> {
    let (found, truth) = (read(found)?, read(truth)?);
    let placement = Placement::new(&found, &truth)?;
    let size = (truth.raster.width, truth.raster.height);
    let [width_m, height_m] = truth.transform.cell_m(size, truth.crs.as_ref());
    let has_days = found.raster.bands > 1 && truth.raster.bands > 1;
    let found_days = has_days.then(|| placement.nearest_band(1));
    let days = found_days.as_ref().map(|found| (found.plane(0), truth.raster.plane(1)));
    let found = placement.moved(0.0, 0.0);
    let (found, truth) = (found.plane(0), truth.raster.plane(0));
    Ok(score(size.0, found, truth, days, width_m * height_m))
}

/// A map of changes with a second band of days since 1970, where it or the file of dates beside it has them.
fn read(path: &Path) -> Result<GeoRaster> {
    let mut map = GeoRaster::read_heights(path)?;
    let beside = dsm_bands::companion(path, "date");
    let dates = match map.raster.bands > 1 {
        true => RasterFile::open(path)?.read_doubles(1)?,
        false if beside.is_file() => RasterFile::open(&beside)?.read_doubles(0)?,
        false => return Ok(map),
    };
    map.raster = map.raster.band(0);
    if dates.len() == map.raster.values.len() {
        map.raster.values.extend(dates.into_iter().map(day_of));
        map.raster.bands = 2;
    }
    Ok(map)
}

/// Days from 1970 to a date written as YYYYMMDD; NaN where it is none.
fn day_of(date: f64) -> f32 {
    let number = date as i64;
    let [year, month, day] = [number / 10_000, number / 100 % 100, number % 100];
    let date = Date::new(year as i16, month as i8, day as i8);
    let days = date.and_then(|date| date.since(Date::constant(1970, 1, 1)));
    days.map_or(f32::NAN, |days| days.get_days() as f32)
}

/// The score of differences (metres, NaN where unknown) on one grid of `width` columns; days (found, true) since 1970.
fn score(width: usize, found: &[f32], truth: &[f32], days: Option<(&[f32], &[f32])>, cell_m2: f64) -> ChangeScore {
    let (found, found_segments) = segments(width, found, cell_m2);
    let (changed, true_segments) = segments(width, truth, cell_m2);
    let area = |cells: usize| cells as f64 * cell_m2;
    let count = |mask: &[bool]| mask.iter().filter(|&&inside| inside).count();
    let both: Vec<usize> = (0..found.len()).filter(|&cell| found[cell] && changed[cell]).collect();
    let share = |of: usize| (of > 0).then(|| both.len() as f64 / of as f64);
    let right = |(found, truth): (&[f32], &[f32])| {
        let within_a_day = |cell: &&usize| (found[**cell] - truth[**cell]).abs() <= 1.0;
        both.iter().filter(within_a_day).count()
    };
    let known_days = days.filter(|_| !both.is_empty());
    ChangeScore {
        precision: share(count(&found)),
        recall: share(count(&changed)),
        true_m2: area(count(&changed)),
        found_m2: area(count(&found)),
        true_segments,
        found_segments,
        right_day: known_days.map(|days| right(days) as f64 / both.len() as f64),
    }
}

/// The cells of segments that count, and the number of segments.
fn segments(width: usize, difference_m: &[f32], cell_m2: f64) -> (Vec<bool>, usize) {
    let mut seen = vec![false; difference_m.len()];
    let mut inside = vec![false; difference_m.len()];
    let mut count = 0;
    for start in 0..difference_m.len() {
        if seen[start] || difference_m[start].is_nan() || difference_m[start].abs() < LEAST_M {
            continue;
        }
        seen[start] = true;
        let mut group = vec![start];
        let mut next = 0;
        while let Some(&cell) = group.get(next) {
            next += 1;
            let col = cell % width;
            let sides = [
                (col > 0).then(|| cell - 1),
                (col + 1 < width).then(|| cell + 1),
                cell.checked_sub(width),
                Some(cell + width).filter(|&below| below < difference_m.len()),
            ];
            let sign = difference_m[start].signum();
            let alike = |near: &usize| difference_m[*near] * sign >= LEAST_M;
            let new = sides.into_iter().flatten().filter(alike);
            group.extend(new.filter(|&near| !std::mem::replace(&mut seen[near], true)));
        }
        let mean_m = group.iter().map(|&cell| difference_m[cell].abs()).sum::<f32>() / group.len() as f32;
        if group.len() as f64 * cell_m2 >= SEGMENT_M2 && mean_m >= SEGMENT_M {
            count += 1;
            group.into_iter().for_each(|cell| inside[cell] = true);
        }
    }
    (inside, count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat::Raster;
    use heliosplat_raster::write::{ImageSpec, write_cog, write_integer_cog};
    use heliosplat_raster::{Crs, GeoTransform};

    /// 20 × 20 cells of a metre that rise by `up_m` in some columns and rows.
    fn house(up_m: f32, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> Vec<f32> {
        let inside = |cell: usize| columns.contains(&(cell % 20)) && rows.contains(&(cell / 20));
        (0..400).map(|cell| if inside(cell) { up_m } else { 0.0 }).collect()
    }

    #[test]
    fn half_a_house_found_is_half_of_the_recall_and_all_of_the_precision() {
        let found = score(20, &house(5.0, 2..8, 2..10), &house(5.0, 2..14, 2..10), None, 1.0);
        assert_eq!((found.precision, found.recall), (Some(1.0), Some(0.5)));
        assert_eq!((found.true_segments, found.found_segments), (1, 1));
    }

    #[test]
    fn the_right_day_is_counted_by_the_calendar() {
        let house = house(5.0, 2..14, 2..10);
        let right = |found: f64, truth: f64| {
            let [found, truth] = [found, truth].map(|date| vec![day_of(date); 400]);
            score(20, &house, &house, Some((&found, &truth)), 1.0).right_day
        };
        assert_eq!(right(20_230_131.0, 20_230_201.0), Some(1.0), "over a month's end");
        assert_eq!(right(20_230_207.0, 20_230_208.0), Some(1.0));
        assert_eq!(right(20_230_205.0, 20_230_207.0), Some(0.0), "two days off");
        assert_eq!(right(0.0, 20_230_207.0), Some(0.0), "no day found");
    }

    #[test]
    fn dates_of_files_are_read_to_the_day() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let write = |name: &str, date: i32| {
            let mut raster = Raster::filled(20, 20, 1, 1.0);
            let (transform, crs) = (GeoTransform::north_up(5e5, 4e6, 1.0), Crs::from_epsg(32_637));
            let crs = crs.expect("UTM");
            let path = folder.path().join(name);
            let georeference = Some((&transform, &crs));
            let dates = ImageSpec {
                georeference,
                ..ImageSpec::plain(&raster)
            };
            write_integer_cog(&dsm_bands::companion(&path, "date"), &dates, |_| date).expect("a file");
            raster.values = house(5.0, 2..14, 2..10);
            let difference = ImageSpec {
                georeference,
                ..ImageSpec::plain(&raster)
            };
            write_cog(&path, &difference).expect("a file");
            path
        };
        let truth = write("truth.tif", 20_230_207);
        for (date, right) in [(20_230_206, 1.0), (20_230_209, 0.0)] {
            let score = evaluate_change(&write("found.tif", date), &truth).expect("a score");
            assert_eq!(score.right_day, Some(right), "{date}");
        }
    }

    #[test]
    fn sheds_and_noise_are_no_segments() {
        let found = score(20, &house(5.0, 2..5, 2..5), &house(2.0, 2..14, 2..10), None, 1.0);
        assert_eq!((found.precision, found.recall, found.found_m2), (None, None, 0.0));
    }

    #[test]
    fn what_rose_and_what_fell_beside_it_are_two() {
        let mut truth = house(5.0, 2..8, 2..10);
        truth
            .iter_mut()
            .zip(house(-6.0, 8..14, 2..10))
            .for_each(|(all, other)| *all += other);
        assert_eq!(score(20, &truth, &truth, None, 1.0).true_segments, 2);
    }
}
