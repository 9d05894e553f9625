//! Charts as SVG: two axes with a grid, lines, a legend.
//!
//! A chart within a page takes its colours from the page's stylesheet; a chart in its own file has fixed colours.

use super::{plain, without_control_characters};
use maud::{Markup, html};
use std::ops::RangeInclusive;

/// Left, right, top and bottom margins, chart units.
const MARGIN: [f64; 4] = [52.0, 14.0, 26.0, 42.0];
/// Height of a line of text and mean width of a character at [`FONT_SIZE`], chart units.
const LINE_HEIGHT: f64 = 15.0;
const CHARACTER: f64 = 6.8;
const FONT_SIZE: f64 = 12.0;
/// Most ticks of a logarithmic axis.
const MOST_TICKS: usize = 8;
/// Colours of a chart, in CSS notation.
#[derive(Debug)]
pub struct Theme {
    /// Colour of text.
    pub text: &'static str,
    /// Colour of reference lines and frames.
    pub faint: &'static str,
    /// Colour of the grid.
    pub grid: &'static str,
    /// Colour of the background.
    pub paper: &'static str,
    /// Colours of the lines, in their order.
    pub series: [&'static str; 4],
}

/// Variables of the page's stylesheet.
const PAGE: Theme = Theme {
    text: "var(--text)",
    faint: "var(--faint)",
    grid: "var(--line)",
    paper: "var(--paper)",
    series: ["var(--warm)", "var(--cool)", "var(--faint)", "var(--text)"],
};

/// Theme of charts in their own files: the colours of light mode.
pub const FILE: Theme = Theme {
    text: "#1b1b1b",
    faint: "#666",
    grid: "#ddd",
    paper: "#fff",
    series: ["#b5561c", "#2a6f97", "#666", "#1b1b1b"],
};

/// Mapping of values to positions along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Positions proportional to the values.
    Linear,
    /// Positions proportional to the logarithms of the values, which must be above zero.
    Logarithmic,
}

/// Axis of a chart.
#[derive(Debug, Clone, Copy)]
pub struct Axis<'a> {
    /// Quantity shown, with its unit.
    pub label: &'a str,
    /// Value at its beginning.
    pub low: f64,
    /// Value at its end.
    pub high: f64,
    /// Mapping of values to positions.
    pub scale: Scale,
}

impl Axis<'_> {
    /// Position of a value along the axis: 0 at its beginning, 1 at its end; values beyond are clamped.
    fn share(&self, value: f64) -> f64 {
        let share = match self.scale {
            Scale::Linear => (value - self.low) / (self.high - self.low),
            Scale::Logarithmic => (value / self.low).ln() / (self.high / self.low).ln(),
        };
        if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) }
    }

    /// Tick values with their labels.
    fn ticks(&self) -> Vec<(f64, String)> {
        match self.scale {
            Scale::Linear => linear_ticks(self.low, self.high),
            Scale::Logarithmic => logarithmic_ticks(self.low, self.high),
        }
    }
}

/// Ticks at multiples of 1, 2 or 5 times a power of ten.
fn linear_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    let span = high - low;
    let power = 10f64.powf((span / 5.0).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * power);
    let step = steps.into_iter().find(|step| span / step <= 7.0).unwrap_or(steps[3]);
    if !(step.is_finite() && step > 0.0) {
        return Vec::new();
    }
    // As many digits as the step has; 1e-9 absorbs the rounding error of steps such as 0.1.
    let digits = (-(step.log10() + 1e-9).floor()).clamp(0.0, 12.0) as usize;
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    let ticks = (first..=last).map(|n| n as f64 * step);
    ticks.map(|tick| (tick, format!("{tick:.digits$}"))).collect()
}

/// Ticks at 1, 2 and 5 times powers of ten; only at the powers if these are too many, and evenly spaced if fewer than
/// three.
fn logarithmic_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    if !(low > 0.0 && low < high && high.is_finite()) {
        return Vec::new();
    }
    let within = |steps: &[f64]| -> Vec<f64> {
        let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
        let all = decades.flat_map(|power| steps.iter().map(move |step| step * 10f64.powi(power)));
        // Ticks at the ends of the axis stay in spite of rounding.
        let range = low * (1.0 - 1e-9)..=high * (1.0 + 1e-9);
        all.filter(|tick| range.contains(tick)).collect()
    };
    let mut ticks = within(&[1.0, 2.0, 5.0]);
    if ticks.len() > MOST_TICKS {
        ticks = within(&[1.0]);
    }
    if ticks.len() < 3 {
        return linear_ticks(low, high);
    }
    ticks.into_iter().map(|tick| (tick, plain(tick))).collect()
}

/// Polyline of a chart.
#[derive(Debug, Clone)]
pub struct Line {
    /// Name in the legend; a line with an empty name has no entry.
    pub name: String,
    /// Points (x, y) from left to right, in units of the axes; points that are not finite are left out.
    pub points: Vec<(f64, f64)>,
}

impl Line {
    /// A line through `points`.
    pub fn new(name: &str, points: impl Iterator<Item = (f64, f64)>) -> Self {
        let (name, points) = (name.into(), points.collect());
        Self { name, points }
    }
}

/// Chart with one pair of axes.
#[derive(Debug)]
pub struct Chart<'a> {
    /// Width and height, chart units; a character is about 7 units wide.
    pub size: (f64, f64),
    /// Heading.
    pub title: &'a str,
    /// Second line under the heading; empty for none.
    pub note: &'a str,
    /// Horizontal axis.
    pub across: Axis<'a>,
    /// Vertical axis; its label is not drawn, because the title names the quantity.
    pub up: Axis<'a>,
    /// Dashed reference line from the first point to the second.
    pub reference: Option<[(f64, f64); 2]>,
    /// Lines of the chart.
    pub lines: &'a [Line],
}

impl Chart<'_> {
    /// Draws the chart as part of a page.
    pub fn inline(&self) -> Markup {
        let (width, height) = self.size;
        html! {
            svg viewBox=(format_args!("0 0 {width} {height}")) role="img" aria-label=(self.title) {
                (self.draw(&PAGE))
            }
        }
    }

    /// Draws the chart as the text of an SVG file.
    pub fn file(&self) -> String {
        svg_file(self.size, &self.draw(&FILE))
    }

    fn top(&self) -> f64 {
        MARGIN[2] + if self.note.is_empty() { 0.0 } else { LINE_HEIGHT + 4.0 }
    }

    fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let (width, height) = self.size;
        let (top, bottom) = (self.top(), height - MARGIN[3]);
        (
            MARGIN[0] + self.across.share(x) * (width - MARGIN[0] - MARGIN[1]),
            bottom - self.up.share(y) * (bottom - top),
        )
    }

    fn draw(&self, theme: &Theme) -> Markup {
        let path = |points: &[(f64, f64)]| -> String {
            let known = points.iter().filter(|p| p.0.is_finite() && p.1.is_finite());
            let placed = known.map(|p| self.place(*p)).map(|(x, y)| format!("{x:.1},{y:.1}"));
            placed.collect::<Vec<_>>().join(" ")
        };
        html! {
            g font-family="system-ui,sans-serif" font-size=(FONT_SIZE) fill=(theme.text) {
                text x=(MARGIN[0]) y="14" font-weight="600" { (self.title) }
                @if !self.note.is_empty() {
                    text x=(MARGIN[0]) y=(14.0 + LINE_HEIGHT + 2.0) { (self.note) }
                }
                (self.axes(theme))
                @if let Some(ends) = &self.reference {
                    polyline points=(path(ends)) fill="none" stroke=(theme.faint) stroke-dasharray="4 4" {}
                }
                @for (line, colour) in self.lines.iter().zip(theme.series.iter().cycle()) {
                    polyline points=(path(&line.points)) fill="none" stroke=(colour) stroke-width="2" {}
                }
                (self.legend(theme))
            }
        }
    }

    /// Grid lines with their labels, and the label of the horizontal axis.
    fn axes(&self, theme: &Theme) -> Markup {
        let (width, height) = self.size;
        let (left, right, top, bottom) = (MARGIN[0], width - MARGIN[1], self.top(), height - MARGIN[3]);
        html! {
            @for (tick, label) in self.across.ticks() {
                @let x = format!("{:.1}", self.place((tick, self.up.low)).0);
                path d=(format_args!("M{x} {top}V{bottom}")) stroke=(theme.grid) {}
                text x=(x) y=(bottom + 16.0) text-anchor="middle" { (label) }
            }
            @for (tick, label) in self.up.ticks() {
                @let y = self.place((self.across.low, tick)).1;
                path d=(format_args!("M{left} {y:.1}H{right}")) stroke=(theme.grid) {}
                text x=(left - 6.0) y=(format_args!("{:.1}", y + 4.0)) text-anchor="end" { (label) }
            }
            text x=(0.5 * (left + right)) y=(height - 6.0) text-anchor="middle" { (self.across.label) }
        }
    }

    /// Names of the lines, in the corner that the lines cover least.
    fn legend(&self, theme: &Theme) -> Markup {
        let lines = || self.lines.iter().zip(theme.series.iter().cycle());
        let named = || lines().filter(|(line, _)| !line.name.is_empty());
        let count = named().count();
        let longest = named().map(|(line, _)| line.name.chars().count()).max().unwrap_or(0);
        let (width, height) = (longest as f64 * CHARACTER, count as f64 * LINE_HEIGHT);
        let (left, right) = (MARGIN[0] + 8.0, self.size.0 - MARGIN[1] - 4.0 - width);
        let (top, bottom) = (self.top() + 4.0, self.size.1 - MARGIN[3] - 6.0 - height);
        let corners = [(right, bottom), (left, top), (right, top), (left, bottom)];
        let covered = |(x, y): &(f64, f64)| self.points_within(*x..=x + width, *y..=y + height);
        // Of equal corners, the first.
        let (x, y) = corners.into_iter().min_by_key(covered).unwrap_or_default();
        html! {
            @for (row, (line, colour)) in named().enumerate() {
                text x=(format_args!("{x:.1}")) y=(format_args!("{:.1}", y + 11.0 + LINE_HEIGHT * row as f64)) fill=(colour) { (line.name) }
            }
        }
    }

    /// Number of sample points of the lines within a rectangle.
    fn points_within(&self, across: RangeInclusive<f64>, down: RangeInclusive<f64>) -> usize {
        let pieces = self.lines.iter().flat_map(|line| line.points.windows(2));
        let places = pieces.flat_map(between).map(|point| self.place(point));
        places.filter(|(x, y)| across.contains(x) && down.contains(y)).count()
    }
}

/// Evenly spaced points along a segment of a line.
fn between(ends: &[(f64, f64)]) -> impl Iterator<Item = (f64, f64)> + use<> {
    const PARTS: usize = 32;
    let ((x0, y0), (x1, y1)) = (ends[0], ends[1]);
    (0..=PARTS).map(move |part| {
        let share = part as f64 / PARTS as f64;
        (x0 + share * (x1 - x0), y0 + share * (y1 - y0))
    })
}

/// SVG file with a white background.
pub(super) fn svg_file((width, height): (f64, f64), body: &Markup) -> String {
    let file = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format_args!("0 0 {width} {height}")) width=(width) height=(height) {
            rect width="100%" height="100%" fill=(FILE.paper) {}
            (body)
        }
    };
    without_control_characters(file.into_string() + "\n")
}

/// Chart of lines whose vertical axis begins at zero; `None` if the points have no extent in x, or none is above zero.
pub fn lines(title: &str, across: &str, lines: &[Line]) -> Option<Markup> {
    let top = 1.05 * known(lines).fold(0.0f64, |top, p| top.max(p.1));
    line_chart(title, across, lines, (0.0, top))
}

/// Chart of lines whose vertical axis fits the values, for quantities without a meaningful zero, such as decibels;
/// `None` if the points have no extent in x.
pub fn lines_within(title: &str, across: &str, lines: &[Line]) -> Option<Markup> {
    let (low, high) = range(known(lines).map(|p| p.1));
    let room = 0.05 * (high - low).max(1.0);
    line_chart(title, across, lines, (low - room, high + room))
}

fn line_chart(title: &str, across: &str, lines: &[Line], (bottom, top): (f64, f64)) -> Option<Markup> {
    // Small, so that its text stays readable on a phone.
    const SIZE: (f64, f64) = (440.0, 230.0);
    let (low, high) = range(known(lines).map(|p| p.0));
    let axis = |label, low, high| Axis {
        label,
        low,
        high,
        scale: Scale::Linear,
    };
    let chart = Chart {
        size: SIZE,
        title,
        note: "",
        across: axis(across, low, high),
        up: axis("", bottom, top),
        reference: None,
        lines,
    };
    (high > low && top > bottom).then(|| chart.inline())
}

fn known(lines: &[Line]) -> impl Iterator<Item = &(f64, f64)> {
    let points = lines.iter().flat_map(|line| &line.points);
    points.filter(|p| p.0.is_finite() && p.1.is_finite())
}

/// Least and largest value; (infinity, minus infinity) without values.
pub fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let nothing = (f64::INFINITY, f64::NEG_INFINITY);
    values.fold(nothing, |(low, high), v| (low.min(v), high.max(v)))
}

#[cfg(test)]
mod tests;
