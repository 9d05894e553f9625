//! The surface model: altitude seen from straight above, on a map grid.

use super::ground_doubt::StartProbability;
use super::style::Style;
use super::surface::{self, ALPHA_KNOWN, SurfaceGaussians};
use super::{fill, seen};
use crate::model::LoadedModel;
use crate::nadir::{GroundExtent, NadirGrid};
use heliosplat::render::render;
use heliosplat::splat::Maps;
use heliosplat::{ProjectiveCamera, Raster};
use heliosplat_grid::statistics::quantile;
use heliosplat_grid::{around, in_parallel};
use heliosplat_raster::geoid::GeoidGrid;
use heliosplat_raster::grid::GridSpec;
use heliosplat_raster::write::{ImageSpec, write_cog};
use heliosplat_raster::{GeoRaster, Geoid, Result, StreamedCog, dsm_bands};
use heliosplat_rpc::parallax::{LEAST_BASE_TO_HEIGHT, MATCHING_PX};
use heliosplat_stereo::{FEWEST_VIEWS, Surface, Witnesses};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Cells per parallel job.
const CHUNK: usize = 1024;
/// Names of the bands of a surface model.
pub const BANDS: [&str; 4] = [
    dsm_bands::ALTITUDE,
    dsm_bands::STANDARD_DEVIATION,
    dsm_bands::COVERAGE,
    dsm_bands::VIEWS,
];

/// Units of the bands of a surface model.
pub const UNITS: [&str; 4] = ["metre", "metre", "1", "1"];

/// Largest base-to-height ratio that makes an altitude more precise. Neither rays nor matching costs contain the errors
/// that all cells around share, above all cameras that are a tenth of a pixel off (docs/lab/surface.md, by errors on
/// lidar and synthetic truth); more images do not average them out.
const LONGEST_BASE_TO_HEIGHT: f32 = 1.0;

/// Vertical reference of altitudes without a geoid.
const ELLIPSOID: &str = "WGS84 ellipsoid";

/// Indices of the bands.
const ALTITUDE: usize = 0;
const DEVIATION: usize = 1;
const COVERAGE: usize = 2;
const VIEWS: usize = 3;

/// Surface model on its grid: altitude (metres above the ellipsoid or a geoid), standard deviation (metres), coverage
/// (accumulated alpha, or the probability of a swept altitude, 0 to 1) and the number of images that see the cell; NaN
/// in all bands where the altitude is unknown.
pub struct Dsm {
    /// Raster of the four bands, in the order of [`BANDS`].
    pub raster: Raster,
    /// Grid of the raster.
    pub grid: GridSpec,
    /// Geoid that altitudes refer to; `None`: the ellipsoid.
    pub geoid: Option<Geoid>,
}

/// Summary of a surface model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SurfaceFacts {
    /// Coordinate system: its code, or its name where it has none.
    pub crs: String,
    /// Width of a cell, metres.
    pub gsd_m: f64,
    /// Share of the grid whose altitude is known, 0 to 1.
    pub known: f64,
    /// Heights at the quantiles 0.01 and 0.99, metres.
    pub heights_m: [f32; 2],
    /// Median standard deviation, metres; absent where none is known.
    pub deviation_m: Option<f32>,
    /// Name of the vertical reference of heights.
    pub above: String,
}

impl SurfaceFacts {
    /// Report of three lines on the surface model in `file`.
    pub fn in_words(&self, file: &Path) -> String {
        let [low, high] = self.heights_m;
        let deviation = self.deviation_m;
        let deviation = deviation.map(|metres| format!(", median standard deviation {metres:.2} m"));
        let deviation = deviation.unwrap_or_default();
        format!(
            "surface model  {}\n               {}, cells of {} m, {:.1} % of the ground known\n               heights {low:.0} to {high:.0} m above the {}{deviation}",
            file.display(),
            self.crs,
            self.gsd_m,
            100.0 * self.known,
            self.above
        )
    }
}

/// Surface model of `model` with cells of `gsd_m` metres in the coordinate system `crs`, the local UTM zone by default.
///
/// # Errors
/// When the coordinate system does not cover the place, or the run's `start.tif` is damaged.
pub fn dsm(model: &LoadedModel, gsd_m: f64, crs: Option<&str>) -> Result<Dsm> {
    let nadir = NadirGrid::new(&model.into(), gsd_m, crs)?;
    of_model(&nadir, model)
}

/// Surface model of `model` on the grid of `nadir`, known where at least [`FEWEST_VIEWS`] of the training images see
/// it. Its standard deviations include the uncertainty of the sweep, from the run's [`START`](super::model::START).
///
/// # Errors
/// When that file is damaged.
pub fn of_model(nadir: &NadirGrid, model: &LoadedModel) -> Result<Dsm> {
    let mut dsm = seen_of(nadir, model);
    if let Some(start) = StartProbability::of_run(&model.folder, &model.into())? {
        let altitude = dsm.raster.plane(ALTITUDE).to_vec();
        start.widen(nadir, &altitude, dsm.raster.plane_mut(DEVIATION));
    }
    Ok(dsm)
}

/// Surface model without the uncertainty of the sweep.
pub(crate) fn seen_of(nadir: &NadirGrid, model: &LoadedModel) -> Dsm {
    let mut dsm = of_gaussians(nadir, &model.into());
    let seen_by = seen::views(nadir, dsm.raster.plane(ALTITUDE), &model.file);
    dsm.keep_seen(&seen_by, model.file.gsd_m as f32, model.file.altitude_range_m);
    dsm
}

/// Maps of `model` seen from straight above, rendered without light: one pixel for each cell of `nadir`.
pub fn maps(model: &LoadedModel, nadir: &NadirGrid) -> Maps {
    let (shown, options) = (&model.parameters, model.pass_options());
    render(&model.model, shown, &nadir.camera, None, None, options).maps
}

/// Surface model of Gaussians on the grid of `nadir`, known where they cover a cell. Its visibility in images is not
/// computed, and the band of views is NaN.
pub fn of_gaussians(nadir: &NadirGrid, surface: &SurfaceGaussians) -> Dsm {
    let (width, height) = (nadir.grid.width, nadir.grid.height);
    let mut raster = Raster::filled(width, height, BANDS.len(), f32::NAN);
    let cells = surface::cells(surface, &nadir.camera, nadir.cell_m());
    let altitudes = raster.plane_mut(ALTITUDE).par_iter_mut();
    let altitudes = altitudes.with_min_len(CHUNK).enumerate();
    altitudes.for_each(|(i, altitude)| {
        if cells[i].coverage >= ALPHA_KNOWN {
            *altitude = nadir.height(i % width, i / width, cells[i].up_m) as f32;
        }
    });
    for (i, cell) in cells.iter().enumerate() {
        if cell.coverage >= ALPHA_KNOWN {
            raster.plane_mut(DEVIATION)[i] = cell.spread_m2.sqrt();
            raster.plane_mut(COVERAGE)[i] = cell.coverage;
        }
    }
    widen_deviations(&mut raster, surface.gsd_m);
    Dsm::above_ellipsoid(raster, nadir.grid.clone())
}

/// Altitudes of Gaussians seen from straight above, metres above the frame's origin; NaN where they do not cover a
/// pixel. `nadir` is a camera that looks straight down at pixels of `cell_m` metres.
pub fn altitudes(nadir: &ProjectiveCamera, gaussians: &SurfaceGaussians, cell_m: f32) -> Vec<f32> {
    let up_m = |cell: &surface::Cell| {
        if cell.coverage >= ALPHA_KNOWN {
            cell.up_m
        } else {
            f32::NAN
        }
    };
    surface::cells(gaussians, nadir, cell_m).iter().map(up_m).collect()
}

/// Cells to each side over which the variances of the rays are averaged, and over which altitudes are compared: the
/// position of an edge is uncertain by a cell or two, and the cells beside an uncertain one share its error
/// (docs/lab/surface.md).
const OWN_REACH: usize = 1;
const AROUND_REACH: usize = 2;

/// Replaces each standard deviation by that of three errors together: the spread of the rays of the cells around, the
/// spread of the altitudes around, and the error that all cells share in images of `gsd_m` metres.
fn widen_deviations(raster: &mut Raster, gsd_m: f32) {
    let least_m2 = (MATCHING_PX as f32 * gsd_m / LONGEST_BASE_TO_HEIGHT).powi(2);
    let widened: Vec<f32> = in_parallel(raster.plane_len())
        .map(|cell| match raster.plane(DEVIATION)[cell].is_nan() {
            true => f32::NAN,
            false => (own_variance(raster, cell) + variance_around(raster, cell) + least_m2).sqrt(),
        })
        .collect();
    raster.plane_mut(DEVIATION).copy_from_slice(&widened);
}

/// Adds to standard deviations, metres, the error of matching in images of `gsd_m` metres, as far as it exceeds that of
/// the longest base.
fn add_error_of_base(deviation_m: &mut [f32], base_to_height: &[f32], gsd_m: f32) {
    let variance = |ratio: f32| (MATCHING_PX as f32 * gsd_m / ratio).powi(2);
    for (deviation, &ratio) in deviation_m.iter_mut().zip(base_to_height) {
        let more = variance(ratio.clamp(LEAST_BASE_TO_HEIGHT as f32, LONGEST_BASE_TO_HEIGHT))
            - variance(LONGEST_BASE_TO_HEIGHT);
        *deviation = (*deviation * *deviation + more).sqrt();
    }
}

/// Mean of the squared deviations of the cells around `cell`, metres².
fn own_variance(raster: &Raster, cell: usize) -> f32 {
    let deviations = raster.plane(DEVIATION);
    let known = around((raster.width, raster.height), cell, OWN_REACH).map(|cell| deviations[cell]);
    let known = known.filter(|d| d.is_finite());
    let (sum, count) = known.fold((0.0f32, 0.0f32), |(sum, count), d| (sum + d * d, count + 1.0));
    sum / count.max(1.0)
}

/// Variance of the altitudes known around `cell`, metres².
fn variance_around(raster: &Raster, cell: usize) -> f32 {
    let (mut count, mut sum, mut squares) = (0.0f32, 0.0f32, 0.0f32);
    for other in around((raster.width, raster.height), cell, AROUND_REACH) {
        // Differences to the middle keep their digits where altitudes are in thousands.
        let above = raster.values[other] - raster.values[cell];
        if above.is_finite() {
            (count, sum, squares) = (count + 1.0, sum + above, squares + above * above);
        }
    }
    let mean = sum / count;
    (squares / count - mean * mean).max(0.0)
}

/// Surface model of a swept surface with cells of `gsd_m` metres in the coordinate system `crs`, the local UTM zone by
/// default. It is known where the sweep is; its coverage is the probability of each altitude.
///
/// # Errors
/// When the coordinate system does not cover the place.
pub fn of_surface(place: &GroundExtent, surface: &Surface, gsd_m: f64, crs: Option<&str>) -> Result<Dsm> {
    Ok(of_surface_on(NadirGrid::new(place, gsd_m, crs)?, place, surface))
}

/// Surface model of a swept surface on the grid of `nadir`, known where the sweep is; its coverage is the probability
/// of each altitude.
pub fn of_surface_on(nadir: NadirGrid, place: &GroundExtent, surface: &Surface) -> Dsm {
    let (width, height) = (nadir.grid.width, nadir.grid.height);
    let mut raster = Raster::filled(width, height, BANDS.len(), f32::NAN);
    let found = |i: usize| -> Option<(f64, usize)> {
        let (col, row) = (i % width, i / width);
        let at = |height_m: f64| nadir.enu.enu(col as f64, row as f64, height_m);
        let mut height_m = place.frame.origin.height_m;
        // Plumb lines hardly lean over a scene: a second pass, at the altitude of the first, suffices.
        for _ in 0..2 {
            let [east, north, _] = at(height_m);
            let Some(up_m) = surface.altitude_at(east as f32, north as f32) else {
                break;
            };
            height_m = nadir.height(col, row, up_m);
        }
        let [east, north, _] = at(height_m);
        let cell = surface.cell_at(east as f32, north as f32);
        cell.filter(|&cell| surface.is_known(cell)).map(|cell| (height_m, cell))
    };
    let found: Vec<Option<(f64, usize)>> = in_parallel(width * height).map(found).collect();
    let mut base_to_height = vec![LONGEST_BASE_TO_HEIGHT; width * height];
    for (i, found) in found.into_iter().enumerate() {
        if let Some((height_m, cell)) = found {
            raster.plane_mut(ALTITUDE)[i] = height_m as f32;
            raster.plane_mut(DEVIATION)[i] = surface.deviation_m[cell];
            raster.plane_mut(COVERAGE)[i] = surface.probability[cell];
            raster.plane_mut(VIEWS)[i] = surface.views[cell].into();
            base_to_height[i] = surface.base_to_height[cell];
        }
    }
    widen_deviations(&mut raster, surface.cell_m);
    add_error_of_base(raster.plane_mut(DEVIATION), &base_to_height, surface.cell_m);
    Dsm::above_ellipsoid(raster, nadir.grid)
}

impl Dsm {
    /// A surface model whose altitudes are above the ellipsoid.
    pub fn above_ellipsoid(raster: Raster, grid: GridSpec) -> Self {
        let geoid = None;
        Self { raster, grid, geoid }
    }

    /// Surface model with altitudes above `geoid` instead of the ellipsoid, in the compound coordinate system of these
    /// heights.
    ///
    /// # Errors
    /// When the geoid's grid is missing, or the coordinate system takes no heights.
    pub fn above(mut self, geoid: Geoid) -> Result<Self> {
        let table = GeoidGrid::new(geoid, &self.grid)?;
        let width = self.raster.width;
        table.subtract(0, width, self.raster.plane_mut(ALTITUDE));
        self.grid.crs = geoid.compound(&self.grid.crs)?;
        self.geoid = Some(geoid);
        Ok(self)
    }

    /// Sets cells to NaN that too few images see or whose altitude is outside the searched range, metres, and adds to
    /// all deviations the error of the base between the images; `gsd_m` is that of the images.
    fn keep_seen(&mut self, seen_by: &Witnesses, gsd_m: f32, (low_m, high_m): (f64, f64)) {
        let searched_m = low_m as f32 - gsd_m..=high_m as f32 + gsd_m;
        add_error_of_base(self.raster.plane_mut(DEVIATION), &seen_by.base_to_height, gsd_m);
        for (i, &views) in seen_by.views.iter().enumerate() {
            let known = views >= FEWEST_VIEWS && searched_m.contains(&self.raster.plane(ALTITUDE)[i]);
            self.raster.plane_mut(VIEWS)[i] = views.into();
            for band in (0..BANDS.len()).filter(|_| !known) {
                self.raster.plane_mut(band)[i] = f32::NAN;
            }
        }
    }

    /// Fills holes, the unknown cells that known ones enclose, and returns their number. Filled cells have an altitude,
    /// coverage 0 and views 0, and no standard deviation.
    pub fn fill(&mut self) -> usize {
        let closed = fill::close_holes(self.raster.width, self.raster.plane_mut(ALTITUDE));
        for &cell in &closed {
            self.raster.plane_mut(COVERAGE)[cell] = 0.0;
            self.raster.plane_mut(VIEWS)[cell] = 0.0;
        }
        closed.len()
    }

    /// Sets the cells of a raster on the same grid to NaN where the altitude is unknown.
    pub fn blank_unknown(&self, raster: &mut Raster) {
        raster.blank_unknown(self.raster.plane(ALTITUDE));
    }

    /// True if the file at `path` holds equal altitudes on an equal grid above the same datum.
    pub fn is_in(&self, path: &Path) -> bool {
        let same = |file: &GeoRaster| {
            let altitudes = self.raster.plane(ALTITUDE).iter().zip(file.raster.plane(0));
            file.transform == self.grid.transform
                && file.crs.as_ref().is_some_and(|crs| crs.name() == self.grid.crs.name())
                && (file.raster.width, file.raster.height) == (self.grid.width, self.grid.height)
                && altitudes.into_iter().all(|(a, b)| a == b || (a.is_nan() && b.is_nan()))
        };
        GeoRaster::read(path).is_ok_and(|file| same(&file))
    }

    /// Share of the grid whose altitude is known, 0 to 1.
    pub fn completeness(&self) -> f64 {
        let known = self.raster.plane(0).iter().filter(|v| v.is_finite()).count();
        known as f64 / self.raster.plane_len().max(1) as f64
    }

    /// Name of the vertical datum of the altitudes.
    pub fn vertical_datum(&self) -> &'static str {
        self.geoid.map_or(ELLIPSOID, Geoid::name)
    }

    /// Summary of the surface model, whose cells are `gsd_m` metres wide.
    pub fn facts(&self, gsd_m: f64) -> SurfaceFacts {
        let crs = &self.grid.crs;
        let mut heights = self.raster.plane(ALTITUDE).to_vec();
        let mut deviations = self.raster.plane(DEVIATION).to_vec();
        for values in [&mut heights, &mut deviations] {
            values.retain(|value| value.is_finite());
        }
        SurfaceFacts {
            crs: match crs.definition().starts_with("EPSG:") {
                true => crs.definition().to_owned(),
                false => crs.name().to_owned(),
            },
            gsd_m,
            known: self.completeness(),
            heights_m: [0.01, 0.99].map(|share| quantile(&mut heights, share).unwrap_or(f32::NAN)),
            deviation_m: quantile(&mut deviations, 0.5),
            above: self.vertical_datum().to_owned(),
        }
    }

    /// Writes the surface model: the altitude as a cloud-optimised GeoTIFF of one band at `path`, and the other bands
    /// as its companion files ([`dsm_bands::companion`]), each with its style.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let metadata = metadata(self.vertical_datum());
        // The altitude comes last: its file marks a complete surface model.
        let bands = (1..BANDS.len()).into_par_iter();
        bands.try_for_each(|band| self.write_band(path, band, &metadata))?;
        self.write_band(path, ALTITUDE, &metadata)
    }

    fn write_band(&self, path: &Path, band: usize, metadata: &[(String, String)]) -> Result<()> {
        let raster = self.raster.band(band);
        let path = file_of(path, band);
        let spec = ImageSpec {
            band_descriptions: &BANDS[band..=band],
            band_units: &UNITS[band..=band],
            georeference: Some((&self.grid.transform, &self.grid.crs)),
            metadata,
            ..ImageSpec::plain(&raster)
        };
        style(band, raster.plane(0)).write(&path)?;
        write_cog(&path, &spec)
    }

    /// Surface model as a georeferenced raster of four named bands, as read from its files.
    pub fn geo_raster(&self) -> GeoRaster {
        GeoRaster {
            raster: self.raster.clone(),
            transform: self.grid.transform,
            crs: Some(self.grid.crs.clone()),
            band_names: BANDS.map(str::to_owned).to_vec(),
        }
    }

    /// Band of altitudes, metres.
    pub fn altitude(&self) -> Raster {
        self.raster.band(0)
    }
}

fn metadata(vertical_datum: &str) -> Vec<(String, String)> {
    let items = [
        ("VERTICAL_DATUM", vertical_datum),
        ("UNIT", "metre"),
        ("SOFTWARE", concat!("heliosplat ", env!("CARGO_PKG_VERSION"))),
    ];
    items.map(|(k, v)| (k.into(), v.into())).to_vec()
}

/// File of a band of a surface model; `path` is the file of the altitude.
pub fn file_of(path: &Path, band: usize) -> PathBuf {
    match band {
        ALTITUDE => path.to_owned(),
        _ => dsm_bands::companion(path, dsm_bands::COMPANIONS[band - 1].1),
    }
}

/// Names of the files of a surface model and of their styles; `name` is the file of the altitude.
pub fn files(name: &str) -> Vec<String> {
    let both = |band| ["tif", "qml"].map(|extension| file_of(Path::new(name), band).with_extension(extension));
    let paths = (0..BANDS.len()).flat_map(both);
    paths.map(|path| path.to_string_lossy().into_owned()).collect()
}

/// QGIS style of a band with these values.
pub(crate) fn style(band: usize, values: &[f32]) -> Style {
    match band {
        ALTITUDE => Style::heights(values),
        _ => Style::amounts(values),
    }
}

/// Surface model larger than memory, written to its files row by row.
pub struct StreamedDsm {
    path: PathBuf,
    files: Vec<StreamedCog>,
    rows: usize,
    /// Values of each band in a sample of the rows, from which styles are made.
    sampled: [Vec<f32>; BANDS.len()],
}

/// Most rows of a streamed surface model that are sampled for its styles.
const SAMPLED_ROWS: usize = 200;

impl StreamedDsm {
    /// Begins the files of a surface model on `grid`, with altitudes above `geoid` or the ellipsoid; `path` is the file
    /// of the altitude.
    ///
    /// # Errors
    /// When the coordinate system takes no heights, or a file cannot be written.
    pub fn create(path: &Path, grid: &GridSpec, geoid: Option<Geoid>) -> Result<Self> {
        let crs = match geoid {
            Some(geoid) => &geoid.compound(&grid.crs)?,
            None => &grid.crs,
        };
        let without_values = Raster::of_plane(grid.width, grid.height, Vec::new());
        let file = |band: usize| {
            let spec = ImageSpec {
                band_descriptions: &BANDS[band..=band],
                band_units: &UNITS[band..=band],
                georeference: Some((&grid.transform, crs)),
                metadata: &metadata(geoid.map_or(ELLIPSOID, Geoid::name)),
                ..ImageSpec::plain(&without_values)
            };
            StreamedCog::create(&file_of(path, band), &spec)
        };
        Ok(Self {
            path: path.to_owned(),
            files: (0..BANDS.len()).map(file).collect::<Result<_, _>>()?,
            rows: grid.height,
            sampled: Default::default(),
        })
    }

    /// Writes the four bands of some rows, the first of which is `row0`.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write_rows(&mut self, row0: usize, rows: &Raster) -> Result<()> {
        let step = self.rows.div_ceil(SAMPLED_ROWS).max(1);
        for (band, (file, sampled)) in self.files.iter_mut().zip(&mut self.sampled).enumerate() {
            file.write_rows(row0, &rows.band(band))?;
            let rows = rows.plane(band).chunks(rows.width).enumerate();
            let kept = rows.filter(|(row, _)| (row0 + row).is_multiple_of(step));
            sampled.extend(kept.flat_map(|(_, values)| values));
        }
        Ok(())
    }

    /// Completes the files and writes their styles, the altitude last.
    ///
    /// # Errors
    /// When a file cannot be written, which is then absent.
    pub fn finish(self) -> Result<()> {
        for (band, file) in self.files.into_iter().enumerate().rev() {
            style(band, &self.sampled[band]).write(&file_of(&self.path, band))?;
            file.finish()?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_at_a_step_are_in_more_doubt_than_level_ones() {
        let mut raster = Raster::filled(8, 5, 1, 4000.0);
        for row in 0..5 {
            raster.values[row * 8 + 7] = 4006.0;
        }
        raster.values[2 * 8] = f32::NAN;
        assert_eq!(variance_around(&raster, 2 * 8 + 2), 0.0);
        // Five of 25 cells stand 6 m higher.
        assert!((variance_around(&raster, 2 * 8 + 5) - 36.0 * 0.16).abs() < 1e-3);
    }

    #[test]
    fn altitudes_beyond_those_that_were_searched_are_unknown() {
        let mut raster = Raster::filled(4, 1, BANDS.len(), 1.0);
        raster.plane_mut(ALTITUDE).copy_from_slice(&[88.0, 99.0, 110.4, 111.0]);
        let mut dsm = Dsm {
            raster,
            grid: GridSpec {
                width: 4,
                height: 1,
                transform: heliosplat_raster::GeoTransform::north_up(0.0, 0.0, 0.5),
                crs: heliosplat_raster::Crs::from_epsg(32637).expect("UTM"),
            },
            geoid: None,
        };
        let seen_by = Witnesses {
            views: vec![2; 4],
            base_to_height: vec![0.5; 4],
        };
        dsm.keep_seen(&seen_by, 0.5, (90.0, 110.0));
        let known: Vec<bool> = dsm.raster.plane(ALTITUDE).iter().map(|z| z.is_finite()).collect();
        assert_eq!(known, [false, true, true, false]);
    }

    #[test]
    fn doubt_of_a_cell_is_shared_by_those_beside_it_and_none_is_surer_than_all_have_in_common() {
        let mut raster = Raster::filled(7, 7, BANDS.len(), 10.0);
        raster.plane_mut(DEVIATION).fill(0.0);
        raster.plane_mut(DEVIATION)[3 * 7 + 3] = 3.0;
        raster.plane_mut(DEVIATION)[0] = f32::NAN;
        widen_deviations(&mut raster, 0.5);
        let deviation = |col: usize, row: usize| raster.plane(DEVIATION)[row * 7 + col];
        assert!(deviation(0, 0).is_nan());
        assert!((deviation(6, 6) - 0.1).abs() < 1e-6);
        let shared = (1.0f32 + 0.01).sqrt();
        for (col, row) in [(3, 3), (2, 3), (4, 4)] {
            assert!((deviation(col, row) - shared).abs() < 1e-5);
        }
        assert!((deviation(1, 3) - 0.1).abs() < 1e-6);
    }
}
