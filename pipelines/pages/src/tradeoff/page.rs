//! `tradeoff.html`: the Pareto fronts of accuracy over time and memory, the points, and the effect of every change.

use super::Row;
use super::summary::{Comparison, PointSummary, Spread, Summary};
use crate::page::chart::{Axis, Chart, Dot, Line, Scale, range};
use crate::page::{MIB, document, number};
use maud::{Markup, html};

/// Origin of the results.
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
    let time = plot(summary, "training time, all stages, s", &|p| p.seconds.mean, &|p| {
        p.on_time_front
    });
    let memory = plot(summary, "peak memory, MiB", &|p| p.peak_bytes.mean / MIB, &|p| {
        p.on_memory_front
    });
    let body = html! {
        p {
            (rows.len()) " trainings on " (making.scenes.join(", ")) ". Accuracy: " (summary.quality.label()) ". " (making.machine) "."
        }
        pre { (making.command) }
        h2 { "Time" } (time)
        h2 { "Memory" } (memory)
        p.faint {
            "Filled: presets. The line is the Pareto front: no other point is both cheaper and more accurate. "
            "Labels without room are left out; every point is in the table."
        }
        h2 { "Points" } (points_table(summary))
        h2 { "Cost and benefit of each change" } (changes_table(summary))
    };
    document("Speed against accuracy", &body)
}

/// Mean ± half of its 95 % confidence interval.
fn with_confidence(spread: &Spread, digits: usize) -> String {
    let interval = spread
        .confidence_95
        .map_or(String::new(), |d| format!(" ± {d:.digits$}"));
    format!("{:.digits$}{interval}", spread.mean)
}

fn points_table(summary: &Summary) -> Markup {
    html! {
        div.wide { table {
            tr {
                th { "point" } th.words { "description" } th { "trainings" } th { "time, s" } th { "processor time, s" } th { "memory, MiB" } th { (summary.quality.label()) }
                th { "shadow accuracy, %" } th { "PSNR held out, dB" }
            }
            @for p in &summary.points {
                tr.front[p.on_time_front] {
                    td { (p.point.name) }
                    td.words { (p.point.why) }
                    td { (p.trainings) }
                    td { (with_confidence(&p.seconds, 1)) }
                    td { (number(Some(p.processor_s.mean).filter(|seconds| seconds.is_finite()), 1)) }
                    td { (number(Some(p.peak_bytes.mean / MIB), 0)) }
                    td { (with_confidence(&p.quality, 3)) }
                    td { (number(p.shadows_right.map(|share| 100.0 * share.mean), 1)) }
                    td { (number(p.psnr_held_out.map(|psnr| psnr.mean), 2)) }
                }
            }
        } }
        p.faint { "Bold: on the Pareto front of time. ± is half of the 95 % confidence interval of the mean over scenes (over trainings, where there is one scene)." }
    }
}

fn verdict(c: &Comparison, less_is_better: bool) -> &'static str {
    match c.clear {
        None => "too few seeds",
        Some(false) => "within noise",
        Some(true) if (c.quality.mean < 0.0) == less_is_better => "better",
        Some(true) => "worse",
    }
}

fn changes_table(summary: &Summary) -> Markup {
    let changes = summary
        .points
        .iter()
        .filter_map(|p| Some((p, p.against_base.as_ref()?)));
    html! {
        div.wide { table {
            tr {
                th { "change" } th.words { "axis" } th { "baseline" } th { "pairs" } th { "Δ time, s" } th { "Δ memory, MiB" }
                th { "Δ " (summary.quality.label()) } th.words { "verdict" }
            }
            @for (p, c) in changes {
                tr {
                    td { (p.point.name) }
                    td.words { (p.point.axis) }
                    td { (c.base) }
                    td { (c.pairs) }
                    td { (format_args!("{:+.1}", c.seconds.mean)) }
                    td { (format_args!("{:+.0}", c.peak_bytes.mean / MIB)) }
                    td { (format_args!("{:+.3}", c.quality.mean)) @if let Some(d) = c.quality.confidence_95 { (format_args!(" ± {d:.3}")) } }
                    td.words { (verdict(c, summary.quality.less_is_better())) }
                }
            }
        } }
    }
}

/// Every point with its cost on a logarithmic axis and its accuracy, and the Pareto front as a line.
fn plot(
    summary: &Summary,
    cost_label: &str,
    cost: &dyn Fn(&PointSummary) -> f64,
    on_front: &dyn Fn(&PointSummary) -> bool,
) -> Markup {
    let known = |p: &&PointSummary| cost(p).is_finite() && cost(p) > 0.0 && p.quality.mean.is_finite();
    let mut points: Vec<&PointSummary> = summary.points.iter().filter(known).collect();
    if points.is_empty() {
        return html! { p { "No point has both a cost and an accuracy." } };
    }
    let at = |p: &PointSummary| (cost(p), p.quality.mean);
    points.sort_by(|a, b| cost(a).total_cmp(&cost(b)));
    let front = Line {
        name: String::new(),
        points: points.iter().filter(|p| on_front(p)).map(|p| at(p)).collect(),
    };
    let (cheapest, dearest) = range(points.iter().map(|p| cost(p)));
    let (low, high) = range(points.iter().map(|p| p.quality.mean));
    let room = (0.08 * (high - low)).max(1e-3 * high.abs()).max(1e-9);
    // The first get their labels first: presets, then what is on the front.
    let is_preset = |p: &PointSummary| p.point.axis == "preset";
    points.sort_by_key(|p| (!is_preset(p), !on_front(p)));
    let dots: Vec<Dot> = points
        .iter()
        .map(|p| Dot {
            at: at(p),
            label: &p.point.name,
            filled: is_preset(p),
        })
        .collect();
    let chart = Chart {
        size: (900.0, 420.0),
        title: summary.quality.label(),
        note: "",
        // Room for labels, which stand to the right where they can.
        across: Axis {
            label: cost_label,
            low: cheapest / 1.15,
            high: 1.5 * dearest,
            scale: Scale::Logarithmic,
        },
        up: Axis {
            label: "",
            low: low - room,
            high: high + room,
            scale: Scale::Linear,
        },
        reference: None,
        lines: &[front],
        dots: &dots,
    };
    chart.inline()
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
            processor_s: 2.0 * seconds,
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
            trained("no-image-colour", 39.0, 0.75),
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
        assert!(page.contains("too few seeds"));
        assert!(!page.contains("http"), "a page that needs the network");
    }

    #[test]
    fn the_cheaper_lies_left_and_the_smaller_error_low() {
        let points = load(None, &[]).expect("the built-in list");
        let summary = summarise(&points, &rows());
        let drawn = plot(&summary, "", &|p| p.seconds.mean, &|p| p.on_time_front).into_string();
        let place = |name: &str| -> (f64, f64) {
            let circle = drawn
                .split("<circle")
                .find(|part| part.contains(&format!("<title>{name}<")));
            let circle = circle.expect("a dot");
            let value = |attribute: &str| {
                let rest = circle.split(&format!(" {attribute}=\"")).nth(1);
                rest.and_then(|rest| rest.split('"').next()?.parse().ok())
                    .expect("a number")
            };
            (value("cx"), value("cy"))
        };
        let (fast, balanced) = (place("fast"), place("balanced"));
        assert!(fast.0 < balanced.0 && fast.1 < balanced.1, "{fast:?} {balanced:?}");
        assert!(summarise(&points, &[]).points.is_empty());
    }
}
