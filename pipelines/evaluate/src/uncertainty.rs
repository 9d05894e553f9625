//! Calibration of a surface model's standard deviations against its true errors.

use heliosplat::Raster;
use heliosplat_grid::statistics::{correlation, median};
use std::fmt::Write;

/// Groups of cells of about equal size, from the smallest standard deviations to the largest.
const GROUPS: usize = 10;
/// Fewest cells for statistics.
const FEWEST: usize = 100;

/// Calibration of standard deviations: `dsm.uncertainty` of `metrics.json`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Uncertainty {
    /// Spearman's rank correlation of standard deviation and absolute error, -1..1: 1 where the least certain cells
    /// have the largest errors.
    pub spearman: f64,
    /// Share of cells whose error is within one standard deviation, 0..1: 0.68 for normal errors with these deviations.
    pub within_one: f64,
    /// Share of cells whose error is within two standard deviations, 0..1: 0.95 for normal errors with these
    /// deviations.
    pub within_two: f64,
    /// Ten groups of equally many cells, from the most certain to the least.
    pub groups: Vec<Group>,
}

/// Cells of about the same standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Group {
    /// Root of the mean stated variance of the cells, metres.
    pub expected_m: f64,
    /// Root mean square error of the cells, metres.
    pub rmse_m: f64,
    /// Mean absolute error, metres.
    pub mae_m: f64,
    /// Median absolute error, metres.
    pub median_m: f64,
}

impl Uncertainty {
    /// Compares errors and standard deviations of the same cells, metres, `NaN` where unknown. `None` for fewer than
    /// 100 cells with both.
    pub fn of(errors: &Raster, deviations: &Raster) -> Option<Self> {
        let cells = errors.plane(0).iter().zip(deviations.plane(0));
        let known = cells.filter(|(error, deviation)| error.is_finite() && deviation.is_finite());
        let mut cells: Vec<(f64, f64)> = known
            .map(|(error, deviation)| (f64::from(*deviation), f64::from(error.abs())))
            .collect();
        if cells.len() < FEWEST {
            return None;
        }
        cells.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (deviations, errors): (Vec<f64>, Vec<f64>) = cells.iter().copied().unzip();
        let within = |times: f64| {
            let inside = cells.iter().filter(|(deviation, error)| *error <= times * deviation);
            inside.count() as f64 / cells.len() as f64
        };
        Some(Self {
            spearman: correlation(ranks(&deviations).into_iter().zip(ranks(&errors))).unwrap_or(0.0),
            within_one: within(1.0),
            within_two: within(2.0),
            groups: cells.chunks(cells.len().div_ceil(GROUPS)).map(group).collect(),
        })
    }

    /// Correlation, shares and groups as lines of text.
    pub fn table(&self) -> String {
        let mut text = format!(
            "uncertainty    rank correlation with the error {:.3}; within one deviation {:.1} %, within two {:.1} %\n",
            self.spearman,
            100.0 * self.within_one,
            100.0 * self.within_two
        );
        text.push_str("expected m     RMSE m    MAE m  median m\n");
        for group in &self.groups {
            let [expected, rmse, mae, median] = [group.expected_m, group.rmse_m, group.mae_m, group.median_m];
            let _ = writeln!(text, "{expected:<12.3} {rmse:>8.3} {mae:>8.3}  {median:>8.3}");
        }
        text
    }
}

/// Statistics of cells (deviation, absolute error).
fn group(cells: &[(f64, f64)]) -> Group {
    let mean = |value: fn(&(f64, f64)) -> f64| cells.iter().map(value).sum::<f64>() / cells.len() as f64;
    let mut errors: Vec<f64> = cells.iter().map(|(_, error)| *error).collect();
    Group {
        expected_m: mean(|(deviation, _)| deviation * deviation).sqrt(),
        rmse_m: mean(|(_, error)| error * error).sqrt(),
        mae_m: mean(|(_, error)| *error),
        median_m: median(&mut errors).unwrap_or(f64::NAN),
    }
}

/// Ranks from zero; equal values share their mean rank.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]).then(a.cmp(&b)));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    while first < order.len() {
        let is_same = |i: &&usize| values[**i] == values[order[first]];
        let same = order[first..].iter().take_while(is_same).count();
        for &i in &order[first..first + same] {
            ranks[i] = first as f64 + 0.5 * (same - 1) as f64;
        }
        first += same;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(values: Vec<f32>) -> Raster {
        Raster::of_plane(values.len(), 1, values)
    }

    /// Errors that are twice the deviations, in either direction.
    fn twice() -> (Raster, Raster) {
        let deviations: Vec<f32> = (1..=1000).map(|i| ((i * 7919) % 1009) as f32 * 1e-3).collect();
        let errors = deviations
            .iter()
            .enumerate()
            .map(|(i, d)| if i % 2 == 0 { 2.0 * d } else { -2.0 * d });
        (plane(errors.collect()), plane(deviations))
    }

    #[test]
    fn errors_that_follow_the_deviations_correlate_fully_and_the_groups_say_by_how_much() {
        let (errors, deviations) = twice();
        let found = Uncertainty::of(&errors, &deviations).expect("many cells");
        assert!((found.spearman - 1.0).abs() < 1e-9);
        assert!(found.within_one < 0.01 && found.within_two == 1.0);
        assert_eq!(found.groups.len(), GROUPS);
        assert!(
            found
                .groups
                .iter()
                .all(|g| (g.rmse_m / g.expected_m - 2.0).abs() < 1e-6)
        );
        assert!(found.table().contains("1.000"));
    }

    #[test]
    fn deviations_that_say_nothing_do_not_correlate() {
        let (errors, _) = twice();
        let same = Uncertainty::of(&errors, &plane(vec![0.3; 1000])).expect("many cells");
        assert_eq!(same.spearman, 0.0);
        let reversed: Vec<f32> = errors.values.iter().map(|e| 3.0 - e.abs()).collect();
        let reversed = Uncertainty::of(&errors, &plane(reversed)).expect("many cells");
        assert!((reversed.spearman + 1.0).abs() < 1e-9);
    }

    #[test]
    fn equal_values_share_their_rank() {
        assert_eq!(ranks(&[5.0, 1.0, 5.0, 7.0]), [1.5, 0.0, 1.5, 3.0]);
    }

    #[test]
    fn a_few_cells_say_nothing() {
        assert!(Uncertainty::of(&plane(vec![1.0; 9]), &plane(vec![1.0; 9])).is_none());
    }
}
