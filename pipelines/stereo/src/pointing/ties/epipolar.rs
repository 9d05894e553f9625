//! Tie points of two images whose ground may lie at any altitude of a wide range: before a surface, a common frame or a
//! pinhole camera is known.
//!
//! A corner of the first image is projected into the second through the two rational cameras at the altitudes of the
//! range: its epipolar curve, which is a straight line to a fraction of a pixel. Both images are resampled along it, in
//! the first image's scale and orientation, so that the search is over integer shifts along the line, and a few pixels
//! across it for the pointing error of the cameras. A match must correlate well, be unique on the line, and lead back
//! to the corner. Matches whose altitude no neighbour shares are dropped.

use super::patch::{LEAST_SPREAD, normalise};
use super::{HALF, corners};
use heliosplat::Raster;
use heliosplat_grid::statistics::median;
use heliosplat_grid::{Grid, parabola_top};
use heliosplat_rpc::{ImagePoint, Rpc};
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

/// Least correlation of a match.
const LEAST_SCORE: f32 = 0.7;
/// Share of the best correlation that another place may reach: beyond it the match is ambiguous.
const MOST_RIVAL: f32 = 0.93;
/// Places this close to the best belong to its own peak, pixels.
const SAME_PEAK: usize = 3;
/// Largest distance from the corner that the search back may lead to, pixels.
const CLOSURE_PX: usize = 1;
/// Longest search each way along the epipolar line, pixels.
const LONGEST_PX: f64 = 4096.0;
/// Half the distance over which the change of scale and orientation between the images is measured, pixels.
const JACOBIAN_PX: f64 = 8.0;
/// Neighbours of a match that are tested for agreement with it.
const NEIGHBOURS: usize = 8;
/// Least number of agreeing neighbours.
const AGREEING: usize = 3;
/// Tolerance between the altitudes of neighbours, metres: the height of a house.
const AGREE_M: f64 = 15.0;
/// Additional tolerance per metre of distance, metres: the slope of steep ground.
const AGREE_SLOPE: f64 = 0.5;
/// Additional tolerance, pixels of parallax.
const AGREE_PX: f64 = 2.0;

/// A window of an image, averaged down, and the rational camera of the whole image.
#[derive(Debug, Clone, Copy)]
pub struct ReducedView<'a> {
    /// The camera, in the pixel coordinates of the file.
    pub rpc: &'a Rpc,
    /// The averaged window, one band; NaN where values are missing.
    pub image: &'a Raster,
    /// Column and row of the file at which the window begins.
    pub first_px: [usize; 2],
    /// Pixels of the file per pixel of `image`, each way.
    pub factor: usize,
}

impl ReducedView<'_> {
    /// Position in the file of a position in the reduced image; pixel centres are at integers in both.
    fn in_file(&self, at: Vector2<f64>) -> ImagePoint {
        let one = |value: f64, first: usize| first as f64 - 0.5 + (value + 0.5) * self.factor as f64;
        ImagePoint::new(one(at.x, self.first_px[0]), one(at.y, self.first_px[1]))
    }

    fn reduced(&self, at: ImagePoint) -> Vector2<f64> {
        let one = |value: f64, first: usize| (value + 0.5 - first as f64) / self.factor as f64 - 0.5;
        Vector2::new(one(at.col, self.first_px[0]), one(at.row, self.first_px[1]))
    }

    /// Position in this view of the point that another view shows at `at`, for its altitude in metres above the
    /// ellipsoid; `None` where the other camera cannot be inverted.
    fn place_of(&self, other: &Self, at: Vector2<f64>, altitude_m: f64) -> Option<Vector2<f64>> {
        let place = other.rpc.localise(other.in_file(at), altitude_m).ok()?;
        Some(self.reduced(self.rpc.project(place)))
    }

    /// Bilinear value; `NaN` outside the image and next to missing pixels.
    fn sample(&self, at: Vector2<f64>) -> f32 {
        heliosplat_grid::bilinear(&self.image.values, (self.image.width, self.image.height), at.x, at.y)
    }
}

/// Range of a search along epipolar lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EpipolarSearch {
    /// Lowest and highest altitude, metres above the ellipsoid.
    pub range_m: (f64, f64),
    /// Expected offset of matches across the epipolar line, pixels of the first image's file.
    pub across_px: f64,
    /// Largest distance of the search from that offset, pixels of the first image's file.
    pub reach_px: f64,
    /// Approximate number of corners that are tried.
    pub corners: usize,
    /// Ground distance between pixels of the first image's file, metres.
    pub gsd_m: f64,
}

/// Altitudes from tie points of two images.
#[derive(Debug, Clone, PartialEq)]
pub struct TiedAltitudes {
    /// Altitude of each tie point, metres above the ellipsoid.
    pub altitudes_m: Vec<f64>,
    /// Number of corners that were tried.
    pub tried: usize,
    /// Number of corners with a match, before the test of neighbours.
    pub matched: usize,
    /// Median offset of the second image across the epipolar line, pixels of the first image's file; the expected one
    /// without a tie point.
    pub across_px: f64,
    /// Median altitude per pixel of parallax in the reduced first image, metres: a few times the error of the
    /// altitudes. Infinite without a match.
    pub step_m: f64,
}

/// One match: the corner in the first image, its altitude, and its distance from the line, pixels of the reduced image.
#[derive(Debug, Clone, Copy)]
struct Match {
    at: Vector2<f64>,
    altitude_m: f64,
    across: f64,
    step_m: f64,
}

/// Altitudes of corners of the first image that match in the second along their epipolar lines. The result is the same
/// for any number of threads.
pub fn tied_altitudes(first: &ReducedView, second: &ReducedView, search: &EpipolarSearch) -> TiedAltitudes {
    let image = first.image;
    let grid = Grid {
        width: image.width,
        height: image.height,
        west_m: 0.0,
        north_m: 0.0,
        cell_m: 1.0,
    };
    let corners = corners::choose(&grid, std::slice::from_ref(&image.values), search.corners);
    let matches: Vec<Match> = corners
        .par_iter()
        .filter_map(|corner| {
            let at = Vector2::new(corner.col as f64, corner.row as f64);
            EpipolarLine::through(first, second, at, search)?.find(first, second)
        })
        .collect();
    let metres_per_px = search.gsd_m * first.factor as f64;
    let kept = agreeing(&matches, metres_per_px);
    let mut across: Vec<f64> = kept.iter().map(|found| found.across * first.factor as f64).collect();
    let mut steps: Vec<f64> = matches.iter().map(|found| found.step_m).collect();
    TiedAltitudes {
        altitudes_m: kept.iter().map(|found| found.altitude_m).collect(),
        tried: corners.len(),
        matched: matches.len(),
        across_px: median(&mut across).unwrap_or(search.across_px),
        step_m: median(&mut steps).unwrap_or(f64::INFINITY),
    }
}

/// The epipolar line of a corner, and the frame along it in which both images are resampled: `u` along the line in the
/// direction of rising altitude, `v` across it, pixels of the first image.
struct EpipolarLine {
    corner: Vector2<f64>,
    /// Position of the corner in the second image at the middle of the range.
    middle: Vector2<f64>,
    middle_m: f64,
    /// Unit vectors of `u` and `v` in the first image.
    axes: Matrix2<f64>,
    /// Pixels of the second image per pixel of the first.
    jacobian: Matrix2<f64>,
    /// Shift along `u` per metre of altitude, pixels.
    px_per_m: f64,
    /// Longest shift along `u` each way, pixels.
    shifts: usize,
    /// Longest shift along `v` each way, pixels.
    across: usize,
    /// Shift along `v` around which the search is centred, pixels.
    offset: f64,
}

impl EpipolarLine {
    fn through(
        first: &ReducedView,
        second: &ReducedView,
        corner: Vector2<f64>,
        search: &EpipolarSearch,
    ) -> Option<Self> {
        let (low_m, high_m) = Self::visible(first, second, corner, search.range_m)?;
        let middle_m = 0.5 * (low_m + high_m);
        let seen = |at: Vector2<f64>, height_m: f64| second.place_of(first, at, height_m);
        let per_m = (seen(corner, high_m)? - seen(corner, low_m)?) / (high_m - low_m);
        let slope = |step: Vector2<f64>| -> Option<Vector2<f64>> {
            Some((seen(corner + step, middle_m)? - seen(corner - step, middle_m)?) / (2.0 * JACOBIAN_PX))
        };
        let jacobian = Matrix2::from_columns(&[
            slope(Vector2::new(JACOBIAN_PX, 0.0))?,
            slope(Vector2::new(0.0, JACOBIAN_PX))?,
        ]);
        let along = jacobian.try_inverse()? * per_m;
        let px_per_m = along.norm();
        let shifts = 0.5 * (high_m - low_m) * px_per_m;
        // Written so that values that are no numbers fail too.
        if !(px_per_m > 0.0 && shifts <= LONGEST_PX) {
            return None;
        }
        let u = along / px_per_m;
        let reduced = |px: f64| px / first.factor as f64;
        Some(Self {
            corner,
            middle: seen(corner, middle_m)?,
            middle_m,
            axes: Matrix2::from_columns(&[u, Vector2::new(-u.y, u.x)]),
            jacobian,
            px_per_m,
            shifts: shifts.ceil() as usize + 1,
            across: reduced(search.reach_px).ceil() as usize,
            offset: reduced(search.across_px),
        })
    }

    /// The part of a range of altitudes at which the second image shows a corner; `None` where there is none.
    fn visible(
        first: &ReducedView,
        second: &ReducedView,
        corner: Vector2<f64>,
        (low_m, high_m): (f64, f64),
    ) -> Option<(f64, f64)> {
        let place = |height_m: f64| second.place_of(first, corner, height_m);
        let (from, to) = (place(low_m)?, place(high_m)?);
        // Parameters at which the line enters and leaves the image, as shares of its length (Liang and Barsky 1984).
        let (mut enters, mut leaves) = (0.0f64, 1.0f64);
        for (at, along, size) in [
            (from.x, to.x - from.x, second.image.width),
            (from.y, to.y - from.y, second.image.height),
        ] {
            let ends = [-at / along, (size as f64 - 1.0 - at) / along];
            if along == 0.0 {
                continue;
            }
            enters = enters.max(ends[0].min(ends[1]));
            leaves = leaves.min(ends[0].max(ends[1]));
        }
        let at = |share: f64| low_m + share * (high_m - low_m);
        (enters < leaves).then(|| (at(enters), at(leaves)))
    }

    fn find(&self, first: &ReducedView, second: &ReducedView) -> Option<Match> {
        let here = Strip::new(self, |offset| first.sample(self.corner + self.axes * offset));
        let shift = Vector2::new(0.0, self.offset);
        let there = Strip::new(self, |offset| {
            second.sample(self.middle + self.jacobian * (self.axes * (offset + shift)))
        });
        let template = here.template(self.shifts, self.across)?;
        let scores = there.correlate(&template);
        let best = scores.best(LEAST_SCORE)?;
        if scores.has_rival(best) {
            return None;
        }
        let back = here.correlate(&there.template(best.0, best.1)?).best(LEAST_SCORE)?;
        if back.0.abs_diff(self.shifts) > CLOSURE_PX || back.1.abs_diff(self.across) > CLOSURE_PX {
            return None;
        }
        let along = best.0 as f64 - self.shifts as f64 + scores.refined(best)?;
        Some(Match {
            at: self.corner,
            altitude_m: self.middle_m + along / self.px_per_m,
            across: self.offset + best.1 as f64 - self.across as f64,
            step_m: 1.0 / self.px_per_m,
        })
    }
}

const SIDE: usize = 2 * HALF as usize + 1;

/// An image resampled along an epipolar line: rows across it, columns along it.
struct Strip {
    width: usize,
    values: Vec<f32>,
    /// A value of the strip, subtracted before sums of squares are formed, so that they keep their precision in f32.
    about: f32,
    /// Shifts of a patch: columns, rows.
    shifts: (usize, usize),
}

/// The correlation at every shift; -1 where it is undefined.
struct Scores {
    width: usize,
    values: Vec<f32>,
}

impl Strip {
    /// `sample` takes the offset from the line's middle along and across it, pixels.
    fn new(line: &EpipolarLine, sample: impl Fn(Vector2<f64>) -> f32) -> Self {
        let (columns, rows) = (2 * line.shifts + SIDE, 2 * line.across + SIDE);
        let offset = |index: usize, count: usize| index as f64 - (count / 2) as f64;
        let mut values = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for col in 0..columns {
                values.push(sample(Vector2::new(offset(col, columns), offset(row, rows))));
            }
        }
        Self {
            width: columns,
            about: values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0),
            values,
            shifts: (2 * line.shifts + 1, 2 * line.across + 1),
        }
    }

    /// The patch at a shift with zero mean and unit length; `None` where it is not whole or has no texture.
    fn template(&self, col: usize, row: usize) -> Option<[f32; SIDE * SIDE]> {
        let mut patch = [0.0; SIDE * SIDE];
        for (line, out) in patch.chunks_exact_mut(SIDE).enumerate() {
            let start = (row + line) * self.width + col;
            out.copy_from_slice(&self.values[start..start + SIDE]);
        }
        normalise(&mut patch).then_some(patch)
    }

    /// Normalised cross-correlation with a template at every shift.
    fn correlate(&self, template: &[f32; SIDE * SIDE]) -> Scores {
        let (width, height) = self.shifts;
        let spreads = self.spreads();
        let mut values = vec![0.0f32; width * height];
        for (row, scores) in values.chunks_exact_mut(width).enumerate() {
            for (cell, &weight) in template.iter().enumerate() {
                let start = (row + cell / SIDE) * self.width + cell % SIDE;
                for (score, value) in scores.iter_mut().zip(&self.values[start..start + width]) {
                    *score += weight * (value - self.about);
                }
            }
            for (score, spread) in scores.iter_mut().zip(&spreads[row * width..]) {
                *score = if *spread > 0.0 { *score / spread } else { -1.0 };
            }
        }
        Scores { width, values }
    }

    /// The root of the sum of squares about the mean of the patch at every shift; 0 where it is not whole or has no
    /// texture.
    fn spreads(&self) -> Vec<f32> {
        let (width, height) = self.shifts;
        let count = (SIDE * SIDE) as f32;
        let mut spreads = Vec::with_capacity(width * height);
        let (mut sums, mut squares) = (vec![0.0f32; self.width], vec![0.0f32; self.width]);
        for row in 0..height {
            sums.fill(0.0);
            squares.fill(0.0);
            for line in self.values[row * self.width..(row + SIDE) * self.width].chunks_exact(self.width) {
                for ((sum, square), value) in sums.iter_mut().zip(&mut squares).zip(line) {
                    let value = value - self.about;
                    *sum += value;
                    *square += value * value;
                }
            }
            spreads.extend((0..width).map(|col| {
                let sum: f32 = sums[col..col + SIDE].iter().sum();
                let square: f32 = squares[col..col + SIDE].iter().sum();
                let variance = square - sum * sum / count;
                let least = (LEAST_SPREAD * (self.about + sum / count)).powi(2) * count;
                if variance > least { variance.sqrt() } else { 0.0 }
            }));
        }
        spreads
    }
}

impl Scores {
    fn at(&self, col: usize, row: usize) -> f32 {
        self.values[row * self.width + col]
    }

    /// The shift of the best correlation, if it reaches `least` and does not lie at the end of the line.
    fn best(&self, least: f32) -> Option<(usize, usize)> {
        let mut best = (least, None);
        for (index, &score) in self.values.iter().enumerate() {
            if score > best.0 {
                best = (score, Some(index));
            }
        }
        let (col, row) = (best.1? % self.width, best.1? / self.width);
        (col > 0 && col + 1 < self.width).then_some((col, row))
    }

    fn has_rival(&self, (col, row): (usize, usize)) -> bool {
        let limit = MOST_RIVAL * self.at(col, row);
        self.values.iter().enumerate().any(|(index, &score)| {
            let apart = (index % self.width)
                .abs_diff(col)
                .max((index / self.width).abs_diff(row));
            apart > SAME_PEAK && score > limit
        })
    }

    /// Offset of the peak along the line, between pixels, by a parabola; `None` where the correlation of its neighbours
    /// is undefined.
    fn refined(&self, (col, row): (usize, usize)) -> Option<f64> {
        let [before, here, after] = [col - 1, col, col + 1].map(|c| self.at(c, row));
        let known = before > -1.0 && after > -1.0;
        parabola_top([before, here, after]).filter(|_| known).map(f64::from)
    }
}

/// The matches whose altitude enough of their neighbours share.
fn agreeing(matches: &[Match], metres_per_px: f64) -> Vec<Match> {
    let agrees = |one: &Match| {
        let mut near: Vec<(f64, f64)> = matches
            .iter()
            .map(|other| ((other.at - one.at).norm(), other.altitude_m))
            .filter(|&(distance, _)| distance > 0.0)
            .collect();
        let count = NEIGHBOURS.min(near.len());
        if count < AGREEING {
            return false;
        }
        near.select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let same = near[..count].iter().filter(|(distance, altitude_m)| {
            let tolerance_m = AGREE_M + AGREE_PX * one.step_m + AGREE_SLOPE * distance * metres_per_px;
            (altitude_m - one.altitude_m).abs() <= tolerance_m
        });
        same.count() >= AGREEING
    };
    matches.par_iter().filter(|one| agrees(one)).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: usize = 200;
    const GSD_M: f64 = 2.0;
    const PLACE: (f64, f64) = (37.58, 36.91);

    /// A parallel projection, `tilt` metres east per metre of height, good from 0 to 1,000 m.
    fn camera(tilt: f64) -> Rpc {
        let half_m = SIZE as f64 / 2.0 * GSD_M;
        let latitude_scale_deg = half_m / 111_320.0;
        let numerator = |longitude: f64, latitude: f64, height: f64| {
            let mut coefficients = [0.0; 20];
            coefficients[1..4].copy_from_slice(&[longitude, latitude, height]);
            coefficients
        };
        let mut one = [0.0; 20];
        one[0] = 1.0;
        Rpc {
            line_offset: (SIZE as f64 - 1.0) / 2.0,
            sample_offset: (SIZE as f64 - 1.0) / 2.0,
            latitude_offset_deg: PLACE.0,
            longitude_offset_deg: PLACE.1,
            height_offset_m: 500.0,
            line_scale: SIZE as f64 / 2.0,
            sample_scale: SIZE as f64 / 2.0,
            latitude_scale_deg,
            longitude_scale_deg: latitude_scale_deg / PLACE.0.to_radians().cos(),
            height_scale_m: 500.0,
            line_numerator: numerator(0.0, -1.0, 0.0),
            line_denominator: one,
            sample_numerator: numerator(1.0, 0.0, tilt * 500.0 / half_m),
            sample_denominator: one,
            error_bias_m: None,
            error_random_m: None,
        }
    }

    /// Brightness of the ground, without a period.
    fn ground(east_m: f64, north_m: f64) -> f32 {
        let cell = |x: i64, y: i64| {
            let mixed = (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663)).wrapping_mul(83_492_791);
            ((mixed >> 7) & 1023) as f64
        };
        let (x, y) = (east_m / 8.0, north_m / 8.0);
        let (c, r) = (x.floor(), y.floor());
        let (fx, fy) = (x - c, y - r);
        let (c, r) = (c as i64, r as i64);
        let top = cell(c, r) * (1.0 - fx) + cell(c + 1, r) * fx;
        let bottom = cell(c, r + 1) * (1.0 - fx) + cell(c + 1, r + 1) * fx;
        (100.0 + top * (1.0 - fy) + bottom * fy) as f32
    }

    /// Flat ground of `altitude_m` as the camera of `tilt` sees it, `off_px` rows too low.
    fn image(tilt: f64, altitude_m: f64, off_px: f64) -> Raster {
        let mut image = Raster::filled(SIZE, SIZE, 1, 0.0);
        for (index, value) in image.values.iter_mut().enumerate() {
            let (col, row) = ((index % SIZE) as f64, (index / SIZE) as f64 - off_px);
            let middle = (SIZE as f64 - 1.0) / 2.0;
            let east_m = (col - middle) * GSD_M - tilt * (altitude_m - 500.0);
            *value = ground(east_m, (middle - row) * GSD_M);
        }
        image
    }

    /// Tie points of the images of two cameras at altitudes from 0 to 1,000 m.
    fn tied(first: (&Rpc, &Raster), second: (&Rpc, &Raster)) -> TiedAltitudes {
        let view = |(rpc, image)| ReducedView {
            rpc,
            image,
            first_px: [0, 0],
            factor: 1,
        };
        let search = EpipolarSearch {
            range_m: (0.0, 1000.0),
            across_px: 0.0,
            reach_px: 4.0,
            corners: 100,
            gsd_m: GSD_M,
        };
        tied_altitudes(&view(first), &view(second), &search)
    }

    #[test]
    fn the_altitude_of_the_ground_is_found_in_a_wide_range_though_the_pointing_is_off() {
        let (first_rpc, second_rpc) = (camera(0.0), camera(0.3));
        let (first, second) = (image(0.0, 583.0, 0.0), image(0.3, 583.0, 2.0));
        let found = tied((&first_rpc, &first), (&second_rpc, &second));
        assert!(found.altitudes_m.len() > 30, "{found:?}");
        assert!((found.step_m - GSD_M / 0.3).abs() < 0.1, "{}", found.step_m);
        assert_eq!(found.across_px.abs(), 2.0);
        let off = found.altitudes_m.iter().map(|altitude| (altitude - 583.0).abs());
        assert!(off.fold(0.0, f64::max) < found.step_m, "{:?}", found.altitudes_m);
    }

    #[test]
    fn images_of_other_places_give_no_altitudes() {
        let rpcs = (camera(0.0), camera(0.3));
        let first = image(0.0, 583.0, 0.0);
        let mut other = image(0.3, 583.0, 0.0);
        for (index, value) in other.values.iter_mut().enumerate() {
            *value = ground(
                12_345.0 + 2.0 * (index % SIZE) as f64,
                6_789.0 + 2.0 * (index / SIZE) as f64,
            );
        }
        let found = tied((&rpcs.0, &first), (&rpcs.1, &other));
        assert!(found.altitudes_m.len() < 3, "{found:?}");
    }
}
