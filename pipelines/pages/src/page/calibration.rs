//! Calibration plot of a DSM: standard deviations against errors.

use super::chart::{Axis, Chart, Line, Scale, range};
use heliosplat_evaluate::uncertainty::{Group, Uncertainty};

/// Draws the calibration plot with `draw`, and returns its result. Stated standard deviations are on the horizontal
/// axis, true errors on the vertical one, metres, both logarithmic; they agree on the dashed diagonal.
pub fn draw<T>(uncertainty: &Uncertainty, draw: impl Fn(&Chart) -> T) -> T {
    let groups = &uncertainty.groups;
    let values = groups.iter().flat_map(|g| [g.expected_m, g.rmse_m, g.median_m]);
    let (least, most) = range(values.chain([1.0]).filter(|v| *v > 0.0));
    let low = least.log10().floor();
    let high = most.log10().ceil().max(low + 1.0);
    let (low, high) = (10f64.powf(low), 10f64.powf(high));
    let axis = |label| Axis {
        label,
        low,
        high,
        scale: Scale::Logarithmic,
    };
    let line = |name: &str, error: fn(&Group) -> f64| Line::new(name, groups.iter().map(|g| (g.expected_m, error(g))));
    let [one, two] = [uncertainty.within_one, uncertainty.within_two].map(|share| 100.0 * share);
    let rank = format!("rank correlation {:.2}", uncertainty.spearman);
    let note = format!("{rank}, within one deviation {one:.0} %, within two {two:.0} %");
    draw(&Chart {
        size: (472.0, 486.0),
        title: "Height error of ten equal groups of cells, m",
        note: &note,
        across: axis("standard deviation, m"),
        up: axis(""),
        reference: Some([(low, low), (high, high)]),
        lines: &[line("RMSE", |g| g.rmse_m), line("median error", |g| g.median_m)],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_group_is_on_both_lines_even_one_without_error() {
        let group = |expected_m: f64, median_m: f64| Group {
            expected_m,
            rmse_m: 2.0 * expected_m,
            mae_m: expected_m,
            median_m,
        };
        let uncertainty = Uncertainty {
            spearman: 1.0,
            within_one: 0.5,
            within_two: 0.9,
            groups: vec![group(0.1, 0.0), group(0.5, 0.4), group(3.0, 2.0)],
        };
        let drawn = draw(&uncertainty, |chart| chart.file());
        // Diagonal, RMSE and median error.
        assert_eq!(drawn.matches("<polyline").count(), 3);
        assert!(drawn.contains("RMSE") && drawn.contains("within one deviation 50 %") && !drawn.contains("NaN"));
        let of_nothing = draw(
            &Uncertainty {
                groups: Vec::new(),
                ..uncertainty
            },
            |chart| chart.file(),
        );
        assert!(!of_nothing.contains("NaN") && !of_nothing.contains("inf"));
    }
}
