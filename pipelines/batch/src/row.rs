//! Row of a unit in the table of a batch.

use super::plan::{Unit, Work};
use super::stamp::Stamp;
use heliosplat_pages::summary::{Row, State};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Path of the log of a unit.
pub fn log_of(out: &Path, unit: &Unit) -> PathBuf {
    out.join(&unit.id).join("log.txt")
}

/// Row of a unit that has not run.
pub fn pending(unit: &Unit, out: &Path) -> Row {
    Row {
        unit: unit.id.clone(),
        kind: match unit.work {
            Work::Ties(_) => "ties",
            Work::Adjust(_) => "adjust",
            Work::Tile(_) => "tile",
            Work::Colours(_) => "colours",
            Work::Mosaic(_) | Work::Joined(_) => "mosaic",
            Work::Block(_) => "block",
            Work::Refused { .. } => "refused",
        },
        mem_mb: unit.mem_mb,
        log: log_of(out, unit).display().to_string(),
        ..Row::default()
    }
}

/// Sets the state of a row, and its figures from the stamp of its unit.
pub fn finish(row: &mut Row, state: State, stamp: &Stamp) {
    let number = |pointer: &str| stamp.metrics.pointer(pointer).and_then(Value::as_f64);
    row.state = state;
    row.seconds = Some(stamp.seconds);
    row.peak_rss_bytes = Some(stamp.peak_rss_bytes);
    row.mae_m = number("/dsm/mae_m");
    row.completeness = number("/completeness");
    row.metrics = stamp.metrics.clone();
}
