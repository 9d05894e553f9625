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

fn known(lines: &[Line]) -> impl Iterator<Item = &(f64, f64)> {
    let points = lines.iter().flat_map(|line| &line.points);
    points.filter(|p| p.0.is_finite() && p.1.is_finite())
}

/// A chart of some lines whose upward axis begins at zero; nothing where there are no two points to join.
pub fn lines(title: &str, across: &str, lines: &[Line]) -> String {
    let top = 1.05 * known(lines).fold(0.0f64, |top, p| top.max(p.1));
    draw(title, across, lines, (0.0, top))
}

/// The same with an upward axis that holds what the lines do and no more: of values whose zero means nothing, such as decibels.
pub fn lines_within(title: &str, across: &str, lines: &[Line]) -> String {
    let ends = (f64::INFINITY, f64::NEG_INFINITY);
    let (low, high) = known(lines).fold(ends, |(l, h), p| (l.min(p.1), h.max(p.1)));
    let room = 0.05 * (high - low).max(1.0);
    draw(title, across, lines, (low - room, high + room))
}

fn draw(title: &str, across: &str, lines: &[Line], (foot, top): (f64, f64)) -> String {
    let ends = (f64::INFINITY, f64::NEG_INFINITY);
    let (low, high) = known(lines).fold(ends, |(l, h), p| (l.min(p.0), h.max(p.0)));
    if !(high > low && top > foot) {
        return String::new();
    }
    let x = |v: f64| MARGIN.0 + (v - low) / (high - low) * (SIZE.0 - MARGIN.0 - MARGIN.1);
    let y = |v: f64| SIZE.1 - MARGIN.3 - (v - foot) / (top - foot) * (SIZE.1 - MARGIN.2 - MARGIN.3);
    let mut out = format!(
        "<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\"><text x=\"{}\" y=\"14\" font-weight=\"600\">{}</text>",
        SIZE.0,
        SIZE.1,
        escaped(title),
        MARGIN.0,
        escaped(title)
    );
    let (right, bottom) = (SIZE.0 - MARGIN.1, SIZE.1 - MARGIN.3);
    for tick in ticks(foot, top) {
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
    fn decibels_fill_their_chart() {
        let line = Line {
            name: String::new(),
            points: vec![(0.0, 25.0), (10.0, 30.0)],
        };
        let drawn = lines_within("PSNR", "step", std::slice::from_ref(&line));
        assert!(
            drawn.contains(">26</text>") && !drawn.contains(">0</text><path"),
            "{drawn}"
        );
        let heights = |drawn: &str| -> Vec<f64> {
            let points = drawn
                .split("<polyline points=\"")
                .nth(1)
                .and_then(|rest| rest.split('"').next());
            let points = points.expect("a line").split(' ');
            points
                .map(|p| p.split(',').nth(1).and_then(|y| y.parse().ok()).expect("a number"))
                .collect()
        };
        let (high, flat) = (heights(&drawn), heights(&lines("PSNR", "step", &[line])));
        assert!(
            high[0] - high[1] > 100.0 && flat[0] - flat[1] < 50.0,
            "{high:?} {flat:?}"
        );
    }

    #[test]
    fn nothing_is_drawn_of_nothing() {
        assert!(lines("a", "b", &[]).is_empty() && lines_within("a", "b", &[]).is_empty());
        let flat = Line {
            name: String::new(),
            points: vec![(1.0, 1.0)],
        };
        assert!(lines("a", "b", &[flat]).is_empty());
    }
}
