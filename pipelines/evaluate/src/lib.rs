//! Errors of a result against truth: one evaluator with several named protocols; every number comes with its protocol.
//!
//! * `raw`: no registration, as a GIS user gets it. Water counts.
//! * `aligned`: the integer shift of largest normalised cross-correlation, then the mean height difference removed;
//!   water (class 9) is taken out of the prediction before both, as Sat-NeRF and EOGS do.
//! * `aligned-water`: `aligned`, but water takes part in the registration and is left out of the metric only.
//! * `subpixel`: `aligned`, with the shift refined below a pixel.
//!
//! Predictions are never clipped toward the truth.

pub mod align;
pub mod change;
pub mod edges;
pub mod error_map;
pub mod image;
pub mod metrics;
pub mod relit;
pub mod resample;
pub mod shadow;
pub mod truth;
pub mod uncertainty;

pub use self::image::{ImageScore, score_image};
pub use edges::EdgeErrors;
pub use metrics::{DsmMetrics, HeightErrors};
pub use relit::{RelitPair, RelitScore, RelitScores, score_relit};
pub use shadow::ShadowScore;
pub use uncertainty::Uncertainty;

use align::Shift;
use heliosplat::Raster;
use heliosplat_raster::{GeoRaster, RasterError, dsm_bands};
use std::path::{Path, PathBuf};

/// Water in LAS classes.
const WATER: f32 = 9.0;

/// Registration of a prediction to the truth before it is measured.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// None.
    #[default]
    Raw,
    /// Integer shift and mean height; water left out of both.
    Aligned,
    /// Integer shift and mean height; water left out of the metric.
    AlignedWater,
    /// Sub-pixel shift and mean height; water left out of both.
    Subpixel,
}

impl Protocol {
    /// Name of the protocol, given with every number.
    pub fn name(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::Aligned => "aligned",
            Self::AlignedWater => "aligned-water",
            Self::Subpixel => "subpixel",
        }
    }

    fn excludes_water(self) -> bool {
        self != Self::Raw
    }
}

/// Result of a comparison.
pub(crate) type Result<T, E = EvaluateError> = std::result::Result<T, E>;

/// Reason why two rasters cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// Rasters that cannot be compared, with the remedy.
    #[error("{0}")]
    Refused(String),
    /// No cell known in both rasters. Fields: file of the surface model, file of the truth.
    #[error("{}: has no known altitude where {} has one; they may be of different places or coordinate systems", .0.display(), .1.display())]
    Apart(PathBuf, PathBuf),
    /// A raster that cannot be read or placed.
    #[error(transparent)]
    Raster(#[from] RasterError),
}

impl EvaluateError {
    /// True if the user's input is at fault rather than the machine.
    pub fn is_input_fault(&self) -> bool {
        match self {
            Self::Raster(error) => error.is_input_fault(),
            _ => true,
        }
    }
}

/// Errors of an altitude raster against truth.
#[derive(Debug, Clone)]
pub struct DsmEvaluation {
    /// Statistics of the errors.
    pub metrics: DsmMetrics,
    /// Prediction minus truth after registration, metres, on the truth's grid; `NaN` where not measured.
    pub errors: Raster,
    /// Truth raster.
    pub truth: GeoRaster,
    /// True for cells of the truth's grid in which a complete prediction has a value.
    pub wanted: Vec<bool>,
    /// Metres per pixel of the truth's grid.
    pub gsd_m: f64,
    /// Warnings for the reader, one line each.
    pub warnings: Vec<String>,
}

impl DsmEvaluation {
    /// Adds to the metrics the share of wanted and visible (`seen`) cells that are unknown in the prediction, 0..1.
    /// `seen` has one flag for each cell of the truth's grid.
    pub fn count_seen_unknown(&mut self, seen: &[bool]) {
        let cells = seen.iter().zip(&self.wanted).zip(self.errors.plane(0));
        let cells = cells.filter(|((seen, wanted), _)| **seen && **wanted);
        let count = |(all, unknown), (_, error): (_, &f32)| (all + 1, unknown + usize::from(error.is_nan()));
        let (all, unknown) = cells.fold((0usize, 0usize), count);
        self.metrics.seen_unknown = (all > 0).then(|| unknown as f64 / all as f64);
    }
}

/// Compares two altitude rasters on disk; `classes_path` is a file of LAS codes on the truth's grid.
///
/// # Errors
/// [`EvaluateError`], naming the file at fault.
pub fn evaluate_dsm(
    prediction_path: &Path,
    truth_path: &Path,
    classes_path: Option<&Path>,
    protocol: Protocol,
) -> Result<DsmEvaluation> {
    let prediction = GeoRaster::read_surface(prediction_path)?;
    evaluate_raster((prediction_path, &prediction), truth_path, classes_path, protocol)
}

/// Compares an altitude raster in memory with one on disk. `prediction_path` names the former in errors; `classes_path`
/// is a file of LAS codes on the truth's grid.
///
/// # Errors
/// [`EvaluateError`], naming the file at fault.
pub fn evaluate_raster(
    (prediction_path, prediction): (&Path, &GeoRaster),
    truth_path: &Path,
    classes_path: Option<&Path>,
    protocol: Protocol,
) -> Result<DsmEvaluation> {
    let mut warnings = Vec::new();
    let truth = truth::read(truth_path, prediction, &mut warnings)?;
    check_vertical(prediction_path, prediction, truth_path, &truth, protocol, &mut warnings)?;
    let classes = classes_path.map(|path| truth::read_classes(path, &truth.raster));
    let classes = classes.transpose()?;
    let size = (truth.raster.width, truth.raster.height);
    let [width_m, height_m] = truth.transform.cell_m(size, truth.crs.as_ref());
    let gsd_m = (width_m * height_m).sqrt();
    let placement = resample::Placement::new(prediction, &truth)?;
    let moved = |columns: f64, rows: f64| placement.moved(columns, rows);
    let Some((errors, shift)) = register(&moved, &truth.raster, classes.as_ref(), protocol) else {
        return Err(EvaluateError::Apart(prediction_path.to_owned(), truth_path.to_owned()));
    };
    let wanted = wanted_cells(&truth.raster, classes.as_ref(), protocol);
    let shift_m = shift.metres(&truth.transform, size, truth.crs.as_ref());
    let mut metrics = DsmMetrics::new(&errors, &wanted, classes.as_ref(), protocol, shift_m);
    let deviations = |band| placement.moved_band(band, shift.columns, shift.rows);
    let deviations = prediction.band(dsm_bands::STANDARD_DEVIATION).map(deviations);
    metrics.uncertainty = deviations.and_then(|deviations| Uncertainty::of(&errors, &deviations));
    metrics.outside_truth_m = metrics::outside_truth(&errors, &wanted, &truth.raster);
    metrics.edges = edges::edges(&errors, &wanted, &truth.raster, classes.as_ref(), gsd_m);
    Ok(DsmEvaluation {
        metrics,
        errors,
        truth,
        wanted,
        gsd_m,
        warnings,
    })
}

/// Registers and subtracts: prediction minus truth on the truth's grid, and the shift that was applied. `None` when no
/// cell is known in both. `prediction` gives the prediction on the truth's grid after a move of columns and rows, so
/// that a move below a cell is interpolated once.
fn register(
    prediction: &(impl Fn(f64, f64) -> Raster + Sync),
    truth: &Raster,
    classes: Option<&Raster>,
    protocol: Protocol,
) -> Option<(Raster, Shift)> {
    let is_water = |index: usize| classes.is_some_and(|classes| classes.values[index] == WATER);
    let without_water = |mut raster: Raster| {
        for index in (0..raster.values.len()).filter(|&index| is_water(index)) {
            raster.values[index] = f32::NAN;
        }
        raster
    };
    let shift = match protocol {
        Protocol::Raw => Shift::default(),
        Protocol::Aligned => align::integer(truth, &without_water(prediction(0.0, 0.0))),
        Protocol::AlignedWater => align::integer(truth, &prediction(0.0, 0.0)),
        Protocol::Subpixel => align::subpixel(truth, &|columns, rows| without_water(prediction(columns, rows))),
    };
    let moved = match protocol {
        // Water is removed from the prediction before it is moved, as in Sat-NeRF and EOGS.
        Protocol::Aligned => align::moved(&without_water(prediction(0.0, 0.0)), shift.columns, shift.rows),
        Protocol::Raw | Protocol::AlignedWater | Protocol::Subpixel => prediction(shift.columns, shift.rows),
    };
    let mut errors = Raster::filled(truth.width, truth.height, 1, f32::NAN);
    for (index, error) in errors.values.iter_mut().enumerate() {
        if !(protocol.excludes_water() && is_water(index)) {
            *error = moved.values[index] + shift.height_m as f32 - truth.values[index];
        }
    }
    let is_known = errors.values.iter().any(|error| error.is_finite());
    is_known.then_some((errors, shift))
}

/// True for cells in which a complete prediction has a value.
fn wanted_cells(truth: &Raster, classes: Option<&Raster>, protocol: Protocol) -> Vec<bool> {
    let is_water = |index: usize| classes.is_some_and(|classes| classes.values[index] == WATER);
    let is_wanted =
        |(index, value): (usize, &f32)| value.is_finite() && !(protocol.excludes_water() && is_water(index));
    truth.plane(0).iter().enumerate().map(is_wanted).collect()
}

fn check_vertical(
    prediction_path: &Path,
    prediction: &GeoRaster,
    truth_path: &Path,
    truth: &GeoRaster,
    protocol: Protocol,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let datum = |raster: &GeoRaster| raster.crs.clone().filter(|crs| crs.has_vertical_datum());
    let (ours, theirs) = (datum(prediction), datum(truth));
    let (path, crs) = match (ours, theirs) {
        (Some(a), Some(b)) if a.wkt() == b.wkt() => return Ok(()),
        (_, Some(crs)) => (truth_path, crs),
        (Some(crs), None) => (prediction_path, crs),
        (None, None) => return Ok(()),
    };
    if protocol == Protocol::Raw {
        return Err(EvaluateError::Refused(format!(
            "{}: its heights are in {}, not ellipsoidal like the other raster's; convert it first (gdalwarp -t_srs), or use --protocol aligned",
            path.display(),
            crs.name()
        )));
    }
    let (path, name) = (path.display(), crs.name());
    warnings.push(format!(
        "{path}: its heights are in {name}; the mean difference is removed by the protocol"
    ));
    Ok(())
}

/// Name of a LAS class code in reports; `None` for classes that reports do not list.
pub fn class_name(code: f32) -> Option<&'static str> {
    Some(match code as u32 {
        2 => "ground",
        5 => "vegetation",
        6 => "building",
        9 => "water",
        11 => "road",
        17 => "bridge",
        64 => "car",
        65 => "unlabelled",
        _ => return None,
    })
}

#[cfg(test)]
mod tests;
