//! Height errors in numbers.

use super::{EdgeErrors, Protocol, Uncertainty, class_name};
use heliosplat::Raster;
use heliosplat_grid::lowest_within;
use heliosplat_grid::statistics::{median, nmad};
use std::collections::BTreeMap;

/// Statistics of height errors, metres.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct HeightErrors {
    /// Mean absolute error, metres.
    pub mae_m: f64,
    /// Root mean square error, metres.
    pub rmse_m: f64,
    /// Median absolute error, metres.
    pub median_m: f64,
    /// Normalised median absolute deviation from the median, metres: 1.4826 · median(|e − median(e)|).
    pub nmad_m: f64,
    /// Share of measured cells within 1 m, 0..1.
    pub within_1m: f64,
    /// Share of measured cells off by more than 5 m, 0..1.
    #[serde(default)]
    pub beyond_5m: f64,
    /// Share of the cells with truth that have a prediction, 0..1.
    pub completeness: f64,
}

/// Errors of a surface model: `dsm` of `metrics.json`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DsmMetrics {
    /// Statistics over all cells that count in the protocol.
    #[serde(flatten)]
    pub all: HeightErrors,
    /// Shift to the east, north and up applied to the prediction before it was measured, metres.
    pub shift_m: [f64; 3],
    /// Name of the protocol.
    pub protocol: String,
    /// Statistics by the name of the class, where classes are known.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub by_class: BTreeMap<String, HeightErrors>,
    /// Statistics of ground, roads, bridges and buildings together, where classes are known: surfaces that do not
    /// change with the season.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ground_and_buildings: Option<HeightErrors>,
    /// Share of the cells visible in at least two images (on the true surface) whose altitude is unknown in the
    /// prediction, 0..1; absent where the visibility is unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seen_unknown: Option<f64>,
    /// Mean distance of the altitudes from the interval of the true ones around them, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outside_truth_m: Option<f64>,
    /// Errors of the ground by its distance to the nearest wall, where classes are known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub edges: Vec<EdgeErrors>,
    /// Quality of the prediction's own standard deviations, where it has them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<Uncertainty>,
}

/// LAS classes of surfaces that do not change with the season: ground, buildings, roads, bridges.
const GROUND_AND_BUILDINGS: [f32; 4] = [2.0, 6.0, 11.0, 17.0];

impl DsmMetrics {
    /// Metrics of errors (prediction minus truth, metres, `NaN` where not measured). `wanted` marks the cells that
    /// should have one; `shift_m` is the shift of the registration.
    pub(super) fn new(
        errors: &Raster,
        wanted: &[bool],
        classes: Option<&Raster>,
        protocol: Protocol,
        shift_m: [f64; 3],
    ) -> Self {
        let cells = errors.plane(0).iter().zip(wanted).filter(|(_, wanted)| **wanted);
        let all = statistics(cells.map(|(error, _)| *error));
        let mut by_name: BTreeMap<String, Vec<f32>> = BTreeMap::new();
        if let Some(classes) = classes {
            let cells = classes.plane(0).iter().zip(errors.plane(0)).zip(wanted);
            for ((&class, &error), &wanted) in cells {
                if let (true, Some(name)) = (wanted, class_name(class)) {
                    by_name.entry(name.to_owned()).or_default().push(error);
                }
            }
        }
        let static_classes = classes.and_then(|classes| {
            let cells = classes.plane(0).iter().zip(errors.plane(0)).zip(wanted);
            let static_cells = cells.filter(|((class, _), wanted)| **wanted && GROUND_AND_BUILDINGS.contains(class));
            statistics(static_cells.map(|((_, error), _)| *error))
        });
        let of_class = |(name, errors): (String, Vec<f32>)| Some((name, statistics(errors.into_iter())?));
        let by_class = by_name.into_iter().filter_map(of_class).collect();
        Self {
            all: all.unwrap_or(HeightErrors {
                mae_m: f64::NAN,
                rmse_m: f64::NAN,
                median_m: f64::NAN,
                nmad_m: f64::NAN,
                within_1m: 0.0,
                beyond_5m: 0.0,
                completeness: 0.0,
            }),
            shift_m,
            protocol: protocol.name().to_owned(),
            by_class,
            ground_and_buildings: static_classes,
            seen_unknown: None,
            outside_truth_m: None,
            edges: Vec::new(),
            uncertainty: None,
        }
    }
}

/// Mean distance, metres, of the altitudes from the interval between the lowest and the highest true altitude of 3 × 3
/// cells; `None` where none is measured. Rasters of lidar interpolate between roof and ground, so a cell of truth
/// beside a wall is no better than its neighbours (S-EO, arXiv 2504.06920, publishes both bounds for this reason).
pub(super) fn outside_truth(errors: &Raster, wanted: &[bool], truth: &Raster) -> Option<f64> {
    let lowest = |sign: f32| {
        let values = truth.values.iter();
        let known = values.map(|z| if z.is_nan() { f32::MAX } else { sign * z });
        lowest_within((truth.width, truth.height), &known.collect::<Vec<_>>(), [1, 1])
    };
    let bounds = lowest(1.0).into_iter().zip(lowest(-1.0));
    let cells = errors.values.iter().zip(&truth.values).zip(wanted).zip(bounds);
    let distances: Vec<f64> = cells
        .filter(|(((error, _), wanted), _)| **wanted && error.is_finite())
        .map(|(((error, truth), _), (low, high))| {
            let altitude = error + truth;
            f64::from((low - altitude).max(altitude + high).max(0.0))
        })
        .collect();
    (!distances.is_empty()).then(|| distances.iter().sum::<f64>() / distances.len() as f64)
}

/// Statistics of the errors of the wanted cells, `NaN` where there is no prediction; `None` when none is measured.
pub(super) fn statistics(wanted: impl Iterator<Item = f32>) -> Option<HeightErrors> {
    let mut count = 0usize;
    let counted = wanted.map(f64::from).inspect(|_| count += 1);
    let errors: Vec<f64> = counted.filter(|error| error.is_finite()).collect();
    if errors.is_empty() {
        return None;
    }
    let measured = errors.len() as f64;
    let mut absolute: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
    Some(HeightErrors {
        mae_m: absolute.iter().sum::<f64>() / measured,
        rmse_m: (absolute.iter().map(|error| error * error).sum::<f64>() / measured).sqrt(),
        beyond_5m: absolute.iter().filter(|error| **error > 5.0).count() as f64 / measured,
        within_1m: absolute.iter().filter(|error| **error <= 1.0).count() as f64 / measured,
        median_m: median(&mut absolute)?,
        nmad_m: nmad(&errors)?,
        completeness: measured / count as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_altitude_between_those_beside_a_wall_is_no_error_and_one_above_all_is() {
        // Ground, a ramp of one cell, a roof; the surface has its wall one cell further.
        let truth = Raster {
            values: vec![0.0, 0.0, 4.0, 8.0, 8.0, f32::NAN],
            ..Raster::filled(6, 1, 1, 0.0)
        };
        let errors = Raster {
            values: vec![0.0, 0.5, 4.0, 0.0, 2.0, f32::NAN],
            ..Raster::filled(6, 1, 1, 0.0)
        };
        let wanted = [true, true, true, true, true, false];
        // The roof that begins a cell early is within the truth's ramp; two metres above the roof are two metres.
        assert_eq!(outside_truth(&errors, &wanted, &truth), Some(2.0 / 5.0));
        assert_eq!(outside_truth(&errors, &[false; 6], &truth), None);
    }
}
