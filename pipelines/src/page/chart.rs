//! Lines over a common axis, as an SVG that follows the page's colours.

use super::{escaped, plain, ticks};
use std::fmt::Write;

/// Size and margins (left, right, top, bottom), in the chart's own units. Small, so that its text stays readable on a phone.
const SIZE: (f64, f64) = (440.0, 230.0);
const MARGIN: (f64, f64, f64, f64) = (52.0, 14.0, 26.0, 40.0);
const COLOURS: [&str; 4] = ["var(--warm)", "var(--cool)", "var(--faint)", "var(--text)"];

/// One line.
#[derive(Debug, Clone)]
pub struct Line {
    /// What it is.
    pub name: String,
    /// Its points, from left to right.
    pub points: Vec<(f64, f64)>,
}

/// A chart of some lines whose upward axis begins at zero; nothing where there are no two points to join.
pub fn lines(title: &str, across: &str, lines: &[Line]) -> String {
    let points = || {
        lines
            .iter()
            .flat_map(|line| &line.points)
            .filter(|p| p.0.is_finite() && p.1.is_finite())
    };
    let (low, high) = points().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p.0), h.max(p.0)));
    let top = 1.05 * points().fold(0.0f64, |top, p| top.max(p.1));
    if !(high > low && top > 0.0) {
        return String::new();
    }
    let x = |v: f64| MARGIN.0 + (v - low) / (high - low) * (SIZE.0 - MARGIN.0 - MARGIN.1);
    let y = |v: f64| SIZE.1 - MARGIN.3 - v / top * (SIZE.1 - MARGIN.2 - MARGIN.3);
    let mut out = format!(
        "<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\"><text x=\"{}\" y=\"14\" font-weight=\"600\">{}</text>",
        SIZE.0,
        SIZE.1,
        escaped(title),
        MARGIN.0,
        escaped(title)
    );
    let (right, bottom) = (SIZE.0 - MARGIN.1, SIZE.1 - MARGIN.3);
    for tick in ticks(0.0, top) {
        // Writing to a String cannot fail.
        let _ = write!(
            out,
            "<path d=\"M{0} {1:.1}H{right}\" stroke=\"var(--line)\"/><text x=\"{2:.1}\" y=\"{3:.1}\" text-anchor=\"end\">{4}</text>",
            MARGIN.0,
            y(tick),
            MARGIN.0 - 6.0,
            y(tick) + 4.0,
            plain(tick)
        );
    }
    for tick in ticks(low, high) {
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            x(tick),
            bottom + 16.0,
            plain(tick)
        );
    }
    let _ = write!(
        out,
        "<text x=\"{right}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
        SIZE.1 - 6.0,
        escaped(across)
    );
    for (place, line) in lines.iter().enumerate() {
        let colour = COLOURS[place % COLOURS.len()];
        let known = line.points.iter().filter(|p| p.0.is_finite() && p.1.is_finite());
        let joined: Vec<String> = known.map(|p| format!("{:.1},{:.1}", x(p.0), y(p.1))).collect();
        let _ = write!(
            out,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            joined.join(" ")
        );
        if lines.len() > 1 {
            let _ = write!(
                out,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" style=\"fill:{colour}\">{}</text>",
                right - 4.0,
                bottom - 8.0 - 15.0 * (lines.len() - 1 - place) as f64,
                escaped(&line.name)
            );
        }
    }
    out + "</svg>"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_drawn_and_its_name_escaped() {
        let line = |name: &str| Line {
            name: name.into(),
            points: vec![(0.0, 1.0), (10.0, f64::NAN), (20.0, 0.5)],
        };
        let drawn = lines("<b>", "step", &[line("<i>"), line("b")]);
        assert_eq!(drawn.matches("<polyline").count(), 2);
        assert!(!drawn.contains("<b>") && !drawn.contains("<i>") && !drawn.contains("NaN"));
    }

    #[test]
    fn nothing_is_drawn_of_nothing() {
        assert!(lines("a", "b", &[]).is_empty());
        let flat = Line {
            name: String::new(),
            points: vec![(1.0, 1.0)],
        };
        assert!(lines("a", "b", &[flat]).is_empty());
    }
}
