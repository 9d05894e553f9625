//! Axes, legends and labels of charts.

use super::*;

fn line(name: &str, points: &[(f64, f64)]) -> Line {
    Line {
        name: name.into(),
        points: points.to_vec(),
    }
}

fn axis(low: f64, high: f64, scale: Scale) -> Axis<'static> {
    Axis {
        label: "",
        low,
        high,
        scale,
    }
}

fn labels(axis: Axis) -> Vec<String> {
    axis.ticks().into_iter().map(|(_, label)| label).collect()
}

/// Numbers of an attribute, in the order of the document.
fn values(drawn: &str, attribute: &str) -> Vec<f64> {
    let start = format!(" {attribute}=\"");
    let parts = drawn.split(&start).skip(1);
    parts
        .map(|rest| rest.split('"').next().and_then(|v| v.parse().ok()).expect("a number"))
        .collect()
}

#[test]
fn a_line_is_drawn_and_its_name_escaped() {
    let points = [(0.0, 1.0), (10.0, f64::NAN), (20.0, 0.5)];
    let drawn = lines("<b>", "step", &[line("<i>", &points), line("b", &points)]);
    let drawn = drawn.expect("two points to join").into_string();
    assert_eq!(drawn.matches("<polyline").count(), 2);
    assert!(!drawn.contains("<b>") && !drawn.contains("<i>") && !drawn.contains("NaN"));
    assert!(drawn.contains("&lt;b&gt;") && drawn.contains("&lt;i&gt;"));
}

#[test]
fn decibels_fill_their_chart() {
    let line = [line("", &[(0.0, 25.0), (10.0, 30.0)])];
    let heights = |drawn: Option<Markup>| -> Vec<f64> {
        let drawn = drawn.expect("two points to join").into_string();
        let points = drawn.split("points=\"").nth(1).and_then(|rest| rest.split('"').next());
        let points = points.expect("a line").split(' ');
        points
            .map(|p| p.split(',').nth(1).and_then(|y| y.parse().ok()).expect("a number"))
            .collect()
    };
    let (high, flat) = (
        heights(lines_within("PSNR", "", &line)),
        heights(lines("PSNR", "", &line)),
    );
    assert!(
        high[0] - high[1] > 100.0 && flat[0] - flat[1] < 50.0,
        "{high:?} {flat:?}"
    );
}

#[test]
fn nothing_is_drawn_of_nothing() {
    assert!(lines("a", "b", &[]).is_none() && lines_within("a", "b", &[]).is_none());
    assert!(lines("a", "b", &[line("", &[(1.0, 1.0)])]).is_none());
}

#[test]
fn ticks_are_round_few_and_of_equal_digits() {
    let linear = |low, high| labels(axis(low, high, Scale::Linear));
    assert_eq!(linear(0.0, 1.0), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
    assert_eq!(
        linear(26.0, 26.1),
        ["26.00", "26.02", "26.04", "26.06", "26.08", "26.10"]
    );
    assert_eq!(linear(0.0, 400.0), ["0", "100", "200", "300", "400"]);
    assert!(linear(1.0, 1.0).is_empty() && linear(f64::NAN, 1.0).is_empty());
}

#[test]
fn logarithmic_ticks_suit_many_decades_and_less_than_one() {
    let ticks = |low, high| labels(axis(low, high, Scale::Logarithmic));
    assert_eq!(ticks(0.01, 10.0), ["0.01", "0.1", "1", "10"]);
    assert_eq!(ticks(15.0, 620.0), ["20", "50", "100", "200", "500"]);
    assert_eq!(ticks(300.0, 460.0), ["300", "350", "400", "450"]);
    assert!(ticks(0.0, 1.0).is_empty() && ticks(1.0, f64::INFINITY).is_empty());
}

#[test]
fn values_beyond_a_logarithmic_axis_lie_at_its_ends() {
    let axis = axis(0.1, 10.0, Scale::Logarithmic);
    assert_eq!((axis.share(0.0), axis.share(100.0)), (0.0, 1.0));
    assert!((axis.share(1.0) - 0.5).abs() < 1e-12);
}

#[test]
fn the_legend_stands_where_no_line_runs() {
    let legend_x = |points: &[(f64, f64)]| {
        let drawn = lines("", "", &[line("name", points)]).expect("a chart").into_string();
        let text = drawn.split("<text").find(|text| text.contains(">name<"));
        values(text.expect("a legend"), "x")[0]
    };
    let (falling, rising) = (
        [(0.0, 1.0), (1.0, 0.05), (3.0, 0.05)],
        [(0.0, 0.0), (1.0, 1.0), (3.0, 1.0)],
    );
    assert!(legend_x(&falling) < 220.0 && legend_x(&rising) > 220.0);
}

#[test]
fn a_file_of_its_own_names_its_format_and_needs_no_stylesheet() {
    let chart = Chart {
        size: (100.0, 100.0),
        title: "a & b\u{1}",
        note: "",
        across: axis(0.0, 1.0, Scale::Linear),
        up: axis(0.0, 1.0, Scale::Linear),
        reference: Some([(0.0, 0.0), (1.0, 1.0)]),
        lines: &[],
    };
    let file = chart.file();
    assert!(file.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\"") && !file.contains("var("));
    assert!(file.contains("a &amp; b\u{fffd}"));
}
