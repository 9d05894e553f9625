//! The page: fronts, points and components, in one HTML file that needs nothing else.

use super::Row;
use super::summary::{Comparison, PointSummary, Spread, Summary};
use crate::page::{STYLE, escaped, ticks};
use std::fmt::Write;

const MIB: f64 = 1_048_576.0;
/// What the page says about its own making.
#[derive(Debug, Clone)]
pub struct Making<'a> {
    /// The command that made it.
    pub command: &'a str,
    /// The machine: threads and kind.
    pub machine: &'a str,
    /// Names of the scenes.
    pub scenes: &'a [String],
}

/// The whole page.
pub fn page(summary: &Summary, rows: &[Row], making: &Making) -> String {
    let label = summary.quality.label();
    let time = plot(summary, "seconds of training, all stages", &|p| p.seconds.mean, &|p| {
        p.on_time_front
    });
    let memory = plot(summary, "most memory used, MiB", &|p| p.peak_bytes.mean / MIB, &|p| {
        p.on_memory_front
    });
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>Speed against accuracy</title><style>{STYLE}</style><h1>Speed against accuracy</h1>\
         <p>{} trainings on {}. Accuracy is: {label}. {}.</p><pre>{}</pre>\
         <h2>Time</h2>{time}<h2>Memory</h2>{memory}\
         <p class=\"faint\">Filled: presets. The line joins the points that no other point beats in both.</p>\
         <h2>Points</h2>{}<h2>What each change costs and buys</h2>{}</html>\n",
        rows.len(),
        escaped(&making.scenes.join(", ")),
        escaped(making.machine),
        escaped(making.command),
        points_table(summary),
        changes_table(summary),
    )
}

fn with_spread(spread: &Spread, digits: usize) -> String {
    let deviation = spread.deviation.map_or(String::new(), |d| format!(" ± {d:.digits$}"));
    format!("{:.digits$}{deviation}", spread.mean)
}

fn points_table(summary: &Summary) -> String {
    let mut out = format!(
        "<table><tr><th>point<th class=\"words\">asks<th>trainings<th>seconds<th>MiB<th>{}<th>shadows right, %<th>held out, dB</tr>",
        summary.quality.label()
    );
    for p in &summary.points {
        let class = if p.on_time_front { " class=\"front\"" } else { "" };
        let percent = |s: &Spread| format!("{:.1}", 100.0 * s.mean);
        let _ = write!(
            out,
            "<tr{class}><td>{}<td class=\"words\">{}<td>{}<td>{}<td>{:.0}<td>{}<td>{}<td>{}</tr>",
            escaped(&p.point.name),
            escaped(&p.point.why),
            p.trainings,
            with_spread(&p.seconds, 1),
            p.peak_bytes.mean / MIB,
            with_spread(&p.quality, 3),
            p.shadows_right.as_ref().map_or_else(String::new, percent),
            p.psnr_held_out
                .as_ref()
                .map_or_else(String::new, |s| format!("{:.2}", s.mean)),
        );
    }
    out + "</table><p class=\"faint\">Bold: on the front of time. ± is the standard deviation between trainings.</p>"
}

fn verdict(c: &Comparison, less_is_better: bool) -> &'static str {
    match c.clear {
        None => "too few seeds to say",
        Some(false) => "within noise",
        Some(true) if (c.quality.mean < 0.0) == less_is_better => "better",
        Some(true) => "worse",
    }
}

fn changes_table(summary: &Summary) -> String {
    let mut out = "<table><tr><th>change<th class=\"words\">axis<th>against<th>pairs<th>seconds more<th>MiB more<th>quality more<th class=\"words\">verdict</tr>".to_owned();
    for p in &summary.points {
        let Some(c) = &p.against_base else { continue };
        let _ = write!(
            out,
            "<tr><td>{}<td class=\"words\">{}<td>{}<td>{}<td>{:+.1}<td>{:+.0}<td>{:+.3}{}<td class=\"words\">{}</tr>",
            escaped(&p.point.name),
            escaped(&p.point.axis),
            escaped(&c.base),
            c.pairs,
            c.seconds.mean,
            c.peak_bytes.mean / MIB,
            c.quality.mean,
            c.quality.deviation.map_or(String::new(), |d| format!(" ± {d:.3}")),
            verdict(c, summary.quality.less_is_better()),
        );
    }
    out + "</table>"
}

/// Size of a plot and of its margins, in its own units.
const SIZE: (f64, f64) = (900.0, 420.0);
const MARGIN: (f64, f64, f64, f64) = (60.0, 20.0, 20.0, 50.0);

/// Where numbers lie on a plot: cost to the right on a logarithmic scale, quality upwards as its number grows.
struct Scale {
    cost: (f64, f64),
    quality: (f64, f64),
}

impl Scale {
    fn new(costs: impl Iterator<Item = f64> + Clone, qualities: impl Iterator<Item = f64> + Clone) -> Self {
        let range = |values: &mut dyn Iterator<Item = f64>| {
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            })
        };
        let (low, high) = range(&mut costs.clone());
        let (bottom, top) = range(&mut qualities.clone());
        let slack = (0.08 * (top - bottom)).max(1e-3 * top.abs()).max(1e-9);
        Self {
            cost: ((low / 1.15).max(1e-9).ln(), (high * 1.5).max(1e-6).ln()),
            quality: (bottom - slack, top + slack),
        }
    }

    fn x(&self, cost: f64) -> f64 {
        let share = (cost.ln() - self.cost.0) / (self.cost.1 - self.cost.0);
        MARGIN.0 + share * (SIZE.0 - MARGIN.0 - MARGIN.1)
    }

    fn y(&self, quality: f64) -> f64 {
        let share = (quality - self.quality.0) / (self.quality.1 - self.quality.0);
        SIZE.1 - MARGIN.3 - share * (SIZE.1 - MARGIN.2 - MARGIN.3)
    }

    /// Round costs within reach: 1, 2 and 5 times powers of ten.
    fn cost_ticks(&self) -> Vec<f64> {
        let (low, high) = (self.cost.0.exp(), self.cost.1.exp());
        (-3..8)
            .flat_map(|power| [1.0, 2.0, 5.0].map(|step| step * 10f64.powi(power)))
            .filter(|tick| (low..=high).contains(tick))
            .collect()
    }

    fn quality_ticks(&self) -> Vec<f64> {
        ticks(self.quality.0, self.quality.1)
    }
}

fn plot(
    summary: &Summary,
    cost_label: &str,
    cost: &dyn Fn(&PointSummary) -> f64,
    on_front: &dyn Fn(&PointSummary) -> bool,
) -> String {
    let points: Vec<&PointSummary> = summary
        .points
        .iter()
        .filter(|p| cost(p).is_finite() && cost(p) > 0.0 && p.quality.mean.is_finite())
        .collect();
    if points.is_empty() {
        return "<p>No point is known well enough to draw.</p>".to_owned();
    }
    let scale = Scale::new(points.iter().map(|p| cost(p)), points.iter().map(|p| p.quality.mean));
    let mut out = format!(
        "<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">",
        SIZE.0,
        SIZE.1,
        escaped(cost_label)
    );
    axes(&mut out, &scale, cost_label, summary.quality.label());
    let mut front: Vec<&&PointSummary> = points.iter().filter(|p| on_front(p)).collect();
    front.sort_by(|a, b| cost(a).total_cmp(&cost(b)));
    let line: Vec<String> = front
        .iter()
        .map(|p| format!("{:.1},{:.1}", scale.x(cost(p)), scale.y(p.quality.mean)))
        .collect();
    let _ = write!(
        out,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"var(--warm)\" stroke-width=\"2\"/>",
        line.join(" ")
    );
    for (place, p) in labelled(&points, &scale, cost) {
        let (x, y) = (scale.x(cost(p)), scale.y(p.quality.mean));
        let fill = if p.point.axis == "preset" {
            "var(--warm)"
        } else {
            "var(--paper)"
        };
        let _ = write!(
            out,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"{fill}\" stroke=\"var(--warm)\"/><text x=\"{:.1}\" y=\"{place:.1}\">{}</text>",
            x + 9.0,
            escaped(&p.point.name)
        );
    }
    out + "</svg>"
}

/// The points with the heights of their labels, moved down where they would lie on one another.
fn labelled<'p>(
    points: &[&'p PointSummary],
    scale: &Scale,
    cost: &dyn Fn(&PointSummary) -> f64,
) -> Vec<(f64, &'p PointSummary)> {
    let mut ordered: Vec<&PointSummary> = points.to_vec();
    ordered.sort_by(|a, b| scale.y(a.quality.mean).total_cmp(&scale.y(b.quality.mean)));
    let mut placed: Vec<(f64, f64, &PointSummary)> = Vec::new();
    for point in ordered {
        let x = scale.x(cost(point));
        let mut y = scale.y(point.quality.mean) + 4.0;
        while placed
            .iter()
            .any(|(px, py, _)| (px - x).abs() < 130.0 && (py - y).abs() < 13.0)
        {
            y += 2.0;
        }
        placed.push((x, y, point));
    }
    placed.into_iter().map(|(_, y, point)| (y, point)).collect()
}

fn axes(out: &mut String, scale: &Scale, cost_label: &str, quality_label: &str) {
    let (left, right, top, bottom) = (MARGIN.0, SIZE.0 - MARGIN.1, MARGIN.2, SIZE.1 - MARGIN.3);
    for tick in scale.cost_ticks() {
        let x = scale.x(tick);
        let _ = write!(
            out,
            "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{top}\" y2=\"{bottom}\" stroke=\"var(--line)\"/>\
             <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{tick}</text>",
            bottom + 18.0
        );
    }
    for tick in scale.quality_ticks() {
        let y = scale.y(tick);
        let shown = format!("{tick:.3}");
        let shown = shown.trim_end_matches('0').trim_end_matches('.');
        let _ = write!(
            out,
            "<line x1=\"{left}\" x2=\"{right}\" y1=\"{y:.1}\" y2=\"{y:.1}\" stroke=\"var(--line)\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{shown}</text>",
            left - 6.0,
            y + 4.0
        );
    }
    let _ = write!(
        out,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text><text x=\"{left}\" y=\"12\">{}</text>",
        0.5 * (left + right),
        SIZE.1 - 10.0,
        escaped(cost_label),
        escaped(quality_label)
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tradeoff::points::load;
    use crate::tradeoff::summary::summarise;

    fn rows() -> Vec<Row> {
        let trained = |point: &str, seconds: f64, mae_m: f64| Row {
            scene: "<b>".into(),
            point: point.into(),
            seed: 1,
            seconds,
            peak_bytes: seconds * MIB,
            gaussians: 1.0,
            steps: 1.0,
            mae_m: Some(mae_m),
            median_m: None,
            shadows_right: Some(0.9),
            psnr_train: None,
            psnr_held_out: None,
        };
        vec![
            trained("fast", 40.0, 0.7),
            trained("balanced", 160.0, 0.6),
            trained("no-facing", 39.0, 0.75),
        ]
    }

    #[test]
    fn the_page_shows_every_point_once_per_plot_and_escapes_what_users_name() {
        let points = load(None, &[]).expect("the built-in list");
        let summary = summarise(&points, &rows());
        let scenes = vec!["<b>".to_owned()];
        let making = Making {
            command: "heliosplat tradeoff \"a b\"",
            machine: "2 threads",
            scenes: &scenes,
        };
        let page = page(&summary, &rows(), &making);
        assert_eq!(page.matches("<circle").count(), 6);
        assert!(page.contains("&lt;b&gt;") && !page.contains("on <b>"));
        assert!(page.contains("too few seeds to say"));
        assert!(!page.contains("http"), "a page that needs the network");
    }

    #[test]
    fn cheaper_lies_left_and_ticks_lie_within() {
        let scale = Scale::new([40.0, 160.0].into_iter(), [0.6, 0.7].into_iter());
        assert!(scale.x(40.0) < scale.x(160.0) && scale.y(0.6) > scale.y(0.7));
        assert!(scale.cost_ticks().len() >= 2 && (3..=8).contains(&scale.quality_ticks().len()));
    }
}
