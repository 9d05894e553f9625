//! What came of a batch: a table for people and for machines.

use super::driver::log_of;
use super::plan::{Plan, Unit, Work};
use super::stamp::{Stamp, finished};
use heliosplat_products::stac;
use heliosplat_raster::RasterError;
use heliosplat_raster::write::{deliver, write_atomically};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;

/// Name of the collection of all mosaics.
pub(super) const COLLECTION: &str = "batch";

/// Where a unit stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Not begun, or interrupted.
    Pending,
    /// Running now.
    Running,
    /// Finished now.
    Done,
    /// Finished before.
    Skipped,
    /// Failed; its log says why.
    Failed,
    /// What it waits for failed.
    Blocked,
}

impl State {
    /// Its name.
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

    /// Whether its products are there.
    pub fn is_done(self) -> bool {
        matches!(self, Self::Done | Self::Skipped)
    }

    /// Whether they will not be.
    pub fn is_lost(self) -> bool {
        matches!(self, Self::Failed | Self::Blocked)
    }

    /// Whether nothing more will come of it now.
    pub fn is_final(self) -> bool {
        self.is_done() || self.is_lost()
    }
}

/// A unit in the table.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Row {
    /// The unit.
    pub unit: String,
    /// `tile`, `mosaic`, or `refused` where the scene cannot be used.
    pub kind: &'static str,
    /// Where it stands.
    pub state: State,
    /// Seconds it took, pauses not counted.
    pub seconds: Option<f64>,
    /// Most memory it used, bytes.
    pub peak_rss_bytes: Option<u64>,
    /// Memory it was expected to use, MiB.
    pub mem_mb: u64,
    /// Mean absolute error of its surface model where there is truth, metres, protocol `raw`.
    pub mae_m: Option<f64>,
    /// Share of it that is known.
    pub completeness: Option<f64>,
    /// Its log.
    pub log: String,
    /// Why it failed.
    pub error: Option<String>,
    /// What was measured.
    pub metrics: Value,
}

impl Row {
    /// A unit of which nothing is known yet.
    pub fn pending(unit: &Unit, out: &Path) -> Self {
        Self {
            unit: unit.id.clone(),
            kind: match unit.work {
                Work::Tile(_) => "tile",
                Work::Mosaic(_) => "mosaic",
                Work::Refused { .. } => "refused",
            },
            state: State::Pending,
            seconds: None,
            peak_rss_bytes: None,
            mem_mb: unit.mem_mb,
            mae_m: None,
            completeness: None,
            log: log_of(out, unit).display().to_string(),
            error: None,
            metrics: Value::Null,
        }
    }

    /// Notes what its stamp says.
    pub fn finish(&mut self, state: State, stamp: &Stamp) {
        let number = |pointer: &str| stamp.metrics.pointer(pointer).and_then(Value::as_f64);
        self.state = state;
        self.seconds = Some(stamp.seconds);
        self.peak_rss_bytes = Some(stamp.peak_rss_bytes);
        self.mae_m = number("/dsm/mae_m");
        self.completeness = number("/completeness");
        self.metrics = stamp.metrics.clone();
    }

    /// Notes that it failed.
    pub fn fail(&mut self, error: String) {
        self.state = State::Failed;
        self.error = Some(error);
    }
}

/// The table of what is finished in `out`, whoever did it.
pub fn of_stamps(plan: &Plan, out: &Path) -> Vec<Row> {
    let row = |unit: &Unit| {
        let mut row = Row::pending(unit, out);
        if let Some(stamp) = finished(out, unit) {
            row.finish(State::Done, &stamp);
        }
        row
    };
    plan.units.iter().map(row).collect()
}

/// All rows, and how many stand where.
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

/// Writes `summary.csv`, `summary.json`, `summary.html` and, where mosaics have products, `collection.json`, which is delivered with
/// them.
///
/// # Errors
/// When one cannot be written or delivered.
pub fn write(rows: &[Row], plan: &Plan, out: &Path) -> Result<(), RasterError> {
    let write = |name: &str, text: String| write_atomically(&out.join(name), text.as_bytes());
    let items = items(rows, out);
    if !items.is_empty() {
        let collection = stac::collection(COLLECTION, &items);
        write("collection.json", format!("{collection:#}\n"))?;
        if let Some(to) = plan.units.iter().find_map(|unit| unit.deliver.as_ref()) {
            let target = format!("{to}/collection.json");
            deliver(&out.join("collection.json"), Path::new(&target))?;
        }
    }
    write("summary.csv", csv(rows))?;
    write("summary.json", format!("{:#}\n", json(rows)))?;
    write("summary.html", page(rows))
}

/// The STAC items of the mosaics that are done, with their folders.
fn items(rows: &[Row], out: &Path) -> Vec<(String, Value)> {
    let done = rows
        .iter()
        .filter(|row| row.state.is_done() && row.metrics.get("products").is_some());
    done.filter_map(|row| {
        let text = heliosplat_raster::bounded::read_text(&out.join(&row.unit).join("item.json")).ok()?;
        Some((row.unit.clone(), serde_json::from_str(&text).ok()?))
    })
    .collect()
}

fn csv(rows: &[Row]) -> String {
    let mut text = "unit,kind,state,seconds,peak_mib,estimated_mib,mae_m,completeness,log,error\n".to_owned();
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    for row in rows {
        let [seconds, peak, mae, known] = numbers(row);
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{},{},{},{seconds},{peak},{},{mae},{known},{},{}",
            row.unit,
            row.kind,
            row.state.name(),
            row.mem_mb,
            quoted(&row.log),
            quoted(row.error.as_deref().unwrap_or(""))
        );
    }
    text
}

/// Seconds, most memory in MiB, mean absolute error, completeness; empty where not known.
fn numbers(row: &Row) -> [String; 4] {
    let may = |value: Option<f64>, digits: usize| value.map_or(String::new(), |v| format!("{v:.digits$}"));
    let peak = row.peak_rss_bytes.map(|bytes| bytes as f64 / f64::from(1 << 20));
    [
        may(row.seconds, 1),
        may(peak, 0),
        may(row.mae_m, 4),
        may(row.completeness, 4),
    ]
}

/// The table for people on a terminal.
pub fn table(rows: &[Row]) -> String {
    let width = rows.iter().map(|row| row.unit.len()).max().unwrap_or(4);
    let mut text = format!(
        "{:<width$}  {:<15} {:>9} {:>7} {:>8}\n",
        "unit", "state", "seconds", "MiB", "MAE m"
    );
    for row in rows {
        let [seconds, peak, mae, _] = numbers(row);
        let _ = writeln!(
            text,
            "{:<width$}  {:<15} {seconds:>9} {peak:>7} {mae:>8}",
            row.unit,
            row.state.name()
        );
        if let Some(error) = &row.error {
            let _ = writeln!(text, "{:<width$}  {error} ({})", "", row.log);
        }
    }
    text
}

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:76rem;margin:2rem auto;padding:0 1rem;color:#1b1b1b;background:#fff}\
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}th,td{text-align:right;padding:.25rem .5rem;border-bottom:1px solid #ddd}\
th:first-child,td:first-child,.words{text-align:left}.failed{background:#fde8e8}.blocked{background:#fff4d6}.faint{color:#666}";

fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    text.replace('>', "&gt;").replace('"', "&quot;")
}

fn page(rows: &[Row]) -> String {
    let count = |pick: &dyn Fn(State) -> bool| rows.iter().filter(|row| pick(row.state)).count();
    let mut body = String::new();
    for row in rows {
        let [seconds, peak, mae, known] = numbers(row);
        let class = match row.state {
            State::Failed => " class=\"failed\"",
            State::Blocked => " class=\"blocked\"",
            _ => "",
        };
        let error = row
            .error
            .as_deref()
            .map_or(String::new(), |e| format!(": {}", escaped(e)));
        let _ = writeln!(
            body,
            "<tr{class}><td>{}<td class=\"words\">{}<td class=\"words\">{}{error}<td>{seconds}<td>{peak}<td>{}<td>{mae}<td>{known}</tr>",
            escaped(&row.unit),
            row.kind,
            row.state.name(),
            row.mem_mb
        );
    }
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>Batch</title><style>{STYLE}</style><h1>Batch</h1><p>{} units: {} finished, {} failed, {} not done.</p>\
         <table><tr><th>unit<th class=\"words\">kind<th class=\"words\">state<th>seconds<th>MiB<th>estimated MiB<th>MAE, m<th>known</tr>\n{body}</table>{}\
         <p class=\"faint\">heliosplat {}. MAE: mean absolute error against truth, protocol raw.</p></html>\n",
        rows.len(),
        count(&State::is_done),
        count(&State::is_lost),
        count(&|state| !state.is_final()),
        borders(rows),
        env!("CARGO_PKG_VERSION"),
    )
}

/// The borders of the mosaics.
fn borders(rows: &[Row]) -> String {
    let mut body = String::new();
    for row in rows {
        let number = |pointer: &str| {
            let value = row.metrics.pointer(pointer).and_then(Value::as_f64);
            value.map_or(String::new(), |v| format!("{v:.3}"))
        };
        if row.metrics.pointer("/seams/border/mean_m").is_some() {
            let _ = writeln!(
                body,
                "<tr><td>{}<td>{}<td>{}<td>{}<td>{}</tr>",
                escaped(&row.unit),
                number("/seams/border/mean_m"),
                number("/seams/border_within_tiles/mean_m"),
                number("/seams/edge/mean_m"),
                number("/seams/interior/mean_m")
            );
        }
    }
    if body.is_empty() {
        return String::new();
    }
    format!(
        "<h2>Borders of tiles</h2><p>Mean step between neighbouring cells, metres: across the lines between tiles, there within each tile alone, \
         where tiles begin and end, and elsewhere.</p><table><tr><th>mosaic<th>between tiles<th>within tiles<th>at edges<th>elsewhere</tr>\n{body}</table>"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

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
            error: Some("<b>no, \"camera\"</b>".into()),
            metrics: Value::Null,
        };
        let rows = [row];
        assert!(csv(&rows).contains("failed,,,7,,,\"log \"\"x\"\".txt\",\"<b>no, \"\"camera\"\"</b>\""));
        assert!(page(&rows).contains("&lt;b&gt;no") && !page(&rows).contains("<b>no"));
        assert_eq!(json(&rows)["failed"], 1);
        assert!(table(&rows).contains("failed"));
    }
}
