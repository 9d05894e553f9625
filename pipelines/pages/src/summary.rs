//! Results of a batch as tables: for the terminal, HTML, CSV and JSON.

use crate::page::{self, MIB, document};
use crate::report::FILE as REPORT;
use maud::{Markup, html};
use serde_json::{Value, json};

/// Status of a unit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Not begun, or interrupted.
    #[default]
    Pending,
    /// Running.
    Running,
    /// Finished; in a running batch, by this call of the program.
    Done,
    /// Finished by an earlier call.
    Skipped,
    /// Failed; its log states the reason.
    Failed,
    /// A unit that it depends on failed.
    Blocked,
}

impl State {
    /// Name in the tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pending => "pending",
            Self::Running => "running",
            Self::Done => "done",
            Self::Skipped => "finished before",
            Self::Failed => "failed",
            Self::Blocked => "blocked",
        }
    }

    /// True if the unit's products exist.
    pub fn is_done(self) -> bool {
        matches!(self, Self::Done | Self::Skipped)
    }

    /// True if the unit failed or depends on a failed one.
    pub fn is_lost(self) -> bool {
        matches!(self, Self::Failed | Self::Blocked)
    }

    /// True if the status will not change again.
    pub fn is_final(self) -> bool {
        self.is_done() || self.is_lost()
    }
}

/// Row of a unit in the tables.
#[derive(Debug, Clone, Default, serde::Serialize)]
pub struct Row {
    /// Name of the unit.
    pub unit: String,
    /// `ties`, `adjust`, `tile`, `colours`, `block`, `mosaic`, or `refused` if the scene cannot be used.
    pub kind: &'static str,
    /// Status.
    pub state: State,
    /// Duration without pauses, seconds.
    pub seconds: Option<f64>,
    /// Peak memory, bytes.
    pub peak_rss_bytes: Option<u64>,
    /// Estimated peak memory, MiB.
    pub mem_mb: u64,
    /// Mean absolute error of the surface model against truth, if there is one, metres, protocol `raw`.
    pub mae_m: Option<f64>,
    /// Share of the surface model's cells that are known, 0 to 1.
    pub completeness: Option<f64>,
    /// Path of the log.
    pub log: String,
    /// Reason of a failure or block.
    pub error: Option<String>,
    /// Metrics of the unit; null until it is finished.
    pub metrics: Value,
}

impl Row {
    /// Marks the unit as failed, with the reason.
    pub fn fail(&mut self, error: String) {
        self.state = State::Failed;
        self.error = Some(error);
    }
}

/// All rows, with the number of units in each state.
pub fn json(rows: &[Row]) -> Value {
    let count = |state: State| rows.iter().filter(|row| row.state == state).count();
    json!({
        "units": rows,
        "done": count(State::Done) + count(State::Skipped),
        "skipped": count(State::Skipped),
        "failed": count(State::Failed),
        "blocked": count(State::Blocked),
        "pending": count(State::Pending),
    })
}

/// Rows as CSV, with a header line; unknown values are empty.
pub fn csv(rows: &[Row]) -> String {
    let mut text = "unit,kind,state,seconds,peak_mib,estimated_mib,mae_m,completeness,log,error\n".to_owned();
    for row in rows {
        let [seconds, peak, mae, known] = numbers(row);
        // Writing to a String cannot fail.
        let (unit, kind, state, planned) = (&row.unit, row.kind, row.state.name(), row.mem_mb);
        let [log, error] = [&row.log, row.error.as_deref().unwrap_or("")].map(page::csv_text);
        text += &format!("{unit},{kind},{state},{seconds},{peak},{planned},{mae},{known},{log},{error}\n");
    }
    text
}

/// Seconds, peak memory in MiB, mean absolute error in metres, and completeness; empty if unknown.
fn numbers(row: &Row) -> [String; 4] {
    [
        page::number(row.seconds, 1),
        page::number(row.peak_rss_bytes.map(|bytes| bytes as f64 / MIB), 0),
        page::number(row.mae_m, 4),
        page::number(row.completeness, 4),
    ]
}

/// Rows as a table of aligned text for a terminal.
pub fn table(rows: &[Row]) -> String {
    let width = rows.iter().map(|row| row.unit.len()).max().unwrap_or(4);
    let line = |unit: &str, state: &str, [seconds, peak, mae]: [&str; 3]| {
        format!("{unit:<width$}  {state:<15} {seconds:>9} {peak:>7} {mae:>8}\n")
    };
    let mut text = line("unit", "state", ["seconds", "MiB", "MAE m"]);
    for row in rows {
        let [seconds, peak, mae, _] = numbers(row);
        text += &line(&row.unit, row.state.name(), [&seconds, &peak, &mae]);
        if let Some(error) = &row.error {
            text += &format!("{:<width$}  {error} ({})\n", "", row.log);
        }
    }
    text
}

/// Document `summary.html`: counts, maps of the tiles, table of the units, height steps at tile boundaries.
pub fn page(rows: &[Row]) -> String {
    let count = |pick: &dyn Fn(State) -> bool| rows.iter().filter(|row| pick(row.state)).count();
    let body = html! {
        p {
            (rows.len()) " units: " (count(&State::is_done)) " finished, " (count(&State::is_lost)) " failed, "
            (count(&|state| !state.is_final())) " not done."
        }
        (tile_maps(rows))
        (pictures(rows))
        div.wide { table {
            tr {
                th { "unit" } th.words { "kind" } th.words { "state" } th { "time, s" } th { "peak memory, MiB" } th { "estimated, MiB" }
                th { "DSM MAE, m" } th { "completeness" }
            }
            @for row in rows {
                @let [seconds, peak, mae, completeness] = numbers(row);
                tr.failed[row.state == State::Failed].blocked[row.state == State::Blocked] {
                    td { (linked(row)) }
                    td.words { (row.kind) }
                    td.words { (row.state.name()) @if let Some(error) = &row.error { ": " (error) } }
                    td { (seconds) }
                    td { (peak) }
                    td { (row.mem_mb) }
                    td { (mae) }
                    td { (completeness) }
                }
            }
        } }
        (borders(rows))
        p.faint { "heliosplat " (env!("CARGO_PKG_VERSION")) ". MAE: mean absolute error against truth, protocol raw." }
    };
    document("Batch", &body)
}

/// Address of a finished unit's page, relative to the folder of the batch.
fn address(row: &Row) -> Option<String> {
    let within = match row.kind {
        "mosaic" | "block" => "",
        _ if row.metrics.get("gaussians").is_some() || row.metrics.pointer("/train").is_some() => "run/",
        _ => return None,
    };
    row.state.is_done().then(|| format!("./{}/{within}{REPORT}", row.unit))
}

fn linked(row: &Row) -> Markup {
    html! {
        @match address(row) {
            Some(address) => a href=(address) { (row.unit) },
            None => (row.unit),
        }
    }
}

/// Path before the tile's name, row and column of a tile, from `.../tile-r3c0`.
fn place(unit: &str) -> Option<(&str, u32, u32)> {
    let (mosaic, tile) = unit.rsplit_once("/tile-r")?;
    let (row, column) = tile.split_once('c')?;
    Some((mosaic, row.parse().ok()?, column.parse().ok()?))
}

/// Maps of each mosaic's tiles, coloured by state, with links to their pages.
fn tile_maps(rows: &[Row]) -> Markup {
    const SIDE: u32 = 28;
    let placed: Vec<_> = rows.iter().filter_map(|row| Some((place(&row.unit)?, row))).collect();
    let mut mosaics: Vec<&str> = placed.iter().map(|((mosaic, ..), _)| *mosaic).collect();
    mosaics.dedup();
    html! {
        div.grid {
            @for mosaic in mosaics {
                @let tiles = || placed.iter().filter(move |((of, ..), _)| *of == mosaic);
                @let width = SIDE * (1 + tiles().map(|((_, _, column), _)| *column).max().unwrap_or(0));
                @let height = SIDE * (1 + tiles().map(|((_, row, _), _)| *row).max().unwrap_or(0));
                figure {
                    svg.tiles viewBox=(format_args!("0 0 {width} {height}")) style={ "max-width:" (width) "px" } role="img" aria-label={ "Tiles of " (mosaic) } {
                        @for ((_, row, column), unit) in tiles() {
                            a href=[address(unit)] {
                                rect class=(class(unit.state)) x=(SIDE * column + 1) y=(SIDE * row + 1) width=(SIDE - 2) height=(SIDE - 2) {
                                    title { (unit.unit) ": " (unit.state.name()) }
                                }
                            }
                        }
                    }
                    figcaption { (mosaic) ", north up: " span.key-done { "finished" } ", " span.key-failed { "failed" } ", grey not done" }
                }
            }
        }
    }
}

/// Pictures of the finished mosaics, with links to their pages.
fn pictures(rows: &[Row]) -> Markup {
    let mosaics = || rows.iter().filter(|row| row.kind == "mosaic");
    html! {
        div.grid {
            @for (row, address) in mosaics().filter_map(|row| Some((row, address(row)?))) {
                figure {
                    a href=(address) { img loading="lazy" src={ "./" (row.unit) "/dsm.png" } alt={ "Hillshade of " (row.unit) }; }
                    figcaption { (row.unit) }
                }
            }
        }
    }
}

fn class(state: State) -> &'static str {
    match state {
        State::Done | State::Skipped => "done",
        State::Failed | State::Blocked => "lost",
        State::Pending | State::Running => "open",
    }
}

/// Height steps at the tile boundaries of the mosaics.
fn borders(rows: &[Row]) -> Markup {
    let metric = |row: &Row, key: &str| row.metrics["seams"][key]["mean_m"].as_f64();
    let is_measured = |row: &&Row| row.kind == "mosaic" && metric(row, "border").is_some();
    let mosaics: Vec<&Row> = rows.iter().filter(is_measured).collect();
    html! {
        @if !mosaics.is_empty() {
            h2 { "Tile-edge consistency" }
            p {
                "Mean height step between neighbouring cells, metres: across tile boundaries, at the same places within single tiles, "
                "where a tile's overlap ends, and elsewhere."
            }
            div.wide { table {
                tr { th { "mosaic" } th { "between tiles" } th { "within tiles" } th { "at overlap ends" } th { "elsewhere" } }
                @for row in mosaics {
                    tr {
                        td { (row.unit) }
                        @for key in ["border", "border_within_tiles", "edge", "interior"] { td { (page::number(metric(row, key), 3)) } }
                    }
                }
            } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_stand_in_their_places_and_finished_ones_have_links() {
        let row = |unit: &str, kind, state| Row {
            unit: unit.into(),
            kind,
            state,
            seconds: None,
            peak_rss_bytes: None,
            mem_mb: 0,
            mae_m: None,
            completeness: None,
            log: String::new(),
            error: None,
            metrics: serde_json::json!({"gaussians": 7}),
        };
        let page = page(&[
            row("a/b/c/tile-r0c1", "tile", State::Done),
            row("a/b/c/tile-r2c0", "tile", State::Failed),
            row("a/b/c/mosaic", "mosaic", State::Skipped),
        ]);
        assert!(page.contains("viewBox=\"0 0 56 84\""), "two columns, three rows");
        assert!(page.contains("<a href=\"./a/b/c/tile-r0c1/run/report.html\"><rect class=\"done\" x=\"29\" y=\"1\""));
        assert!(
            page.contains("<a><rect class=\"lost\" x=\"1\" y=\"57\""),
            "no page of what failed"
        );
        assert!(page.contains("<a href=\"./a/b/c/mosaic/report.html\">a/b/c/mosaic</a>"));
    }

    #[test]
    fn what_failed_stands_in_every_table_and_cannot_break_them() {
        let row = Row {
            unit: "a/b/c/tile-r0c0".into(),
            kind: "tile",
            state: State::Failed,
            seconds: None,
            peak_rss_bytes: None,
            mem_mb: 7,
            mae_m: None,
            completeness: None,
            log: "log \"x\".txt".into(),
            error: Some("=<b>no, \"camera\"</b>".into()),
            metrics: Value::Null,
        };
        let rows = [row];
        assert!(csv(&rows).contains("failed,,,7,,,\"log \"\"x\"\".txt\",\"'=<b>no, \"\"camera\"\"</b>\""));
        assert!(page(&rows).contains("&lt;b&gt;no") && !page(&rows).contains("<b>no"));
        assert_eq!(json(&rows)["failed"], 1);
        assert!(table(&rows).contains("failed"));
    }
}
